"""Colours are told apart by everybody, stand out from their page, and belong to one family each."""

from __future__ import annotations

from itertools import combinations
from math import dist

import pytest

from colour_vision import VISION, contrast, lab
from contactbench import METHODS as SOLVERS
from contactbench.report.look import FAMILIES, METHODS, PAPER, SHADES, look

OTHERS = {name: color for name, color in FAMILIES.items() if name != "contact"}


@pytest.mark.parametrize("vision", VISION)
def test_any_two_families_and_any_two_shades_are_told_apart(vision):
    """By ΔE*ab (CIE 1976)."""

    def apart(one, other):
        return dist(lab(one, vision), lab(other, vision))

    assert min(apart(a, b) for a, b in combinations(OTHERS.values(), 2)) >= 18
    assert min(apart(shade, other) for shade in SHADES.values() for other in OTHERS.values()) >= 30
    assert min(apart(a, b) for a, b in combinations(SHADES.values(), 2)) >= 8


@pytest.mark.parametrize("color", sorted({*FAMILIES.values(), *SHADES.values()}))
def test_a_colour_stands_out_from_its_page(color):
    assert contrast(color, PAPER) >= 3


def test_a_higher_order_is_a_darker_shade():
    lightness = [lab(SHADES[order])[0] for order in sorted(SHADES)]
    assert lightness == sorted(lightness, reverse=True)


def test_every_solver_has_a_look_and_nobody_shares_one():
    assert set(SOLVERS) <= set(METHODS)
    own = [(item.family, item.marker) for item in METHODS.values()]
    assert len(set(own)) == len(own)


@pytest.mark.parametrize("method", METHODS)
def test_dashes_follow_the_order_of_the_method(method):
    assert METHODS[method].order == SOLVERS[method].order


def test_the_look_of_an_unknown_method_depends_on_its_name_and_family_alone():
    first = {name: look(name) for name in ("mine", "yours", "theirs")}
    assert {name: look(name) for name in reversed(first)} == first
    assert {own.family for own in first.values()} == {"other"}
    assert look("mine", "contact").family == "contact"
    assert look("mine", "established").family == "other"
