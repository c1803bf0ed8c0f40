"""Colours are told apart by everybody, stand out from their page, and belong to one family each."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from colour_vision import VISION, ciede2000, contrast, lab
from contactbench import METHODS as SOLVERS
from contactbench.report.look import DARK_PAPER, FAMILIES, METHODS, PAPER, look

PAGES = {"light": PAPER, "dark": DARK_PAPER}


@pytest.mark.parametrize("page", PAGES)
@pytest.mark.parametrize("vision", VISION)
def test_any_two_families_are_told_apart(page, vision):
    seen = {name: lab(getattr(own, page), vision) for name, own in FAMILIES.items()}
    apart = {pair: ciede2000(seen[pair[0]], seen[pair[1]]) for pair in combinations(seen, 2)}
    assert min(apart.values()) >= 15, min(apart, key=apart.get)


@pytest.mark.parametrize("page", PAGES)
@pytest.mark.parametrize("family", FAMILIES)
def test_a_family_stands_out_from_its_page(page, family):
    assert contrast(getattr(FAMILIES[family], page), PAGES[page]) >= 3


def test_colour_differences_are_those_of_the_paper():
    """Pairs 1, 7, 17 and 25 of table 1 of Sharma, Wu & Dalal (2005)."""
    for one, other, expected in (
        ((50, 2.6772, -79.7751), (50, 0, -82.7485), 2.0425),
        ((50, 0, 0), (50, -1, 2), 2.3669),
        ((50, 2.5, 0), (73, 25, -18), 27.1492),
        ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ):
        assert ciede2000(np.array(one), np.array(other)) == pytest.approx(expected, abs=1e-4)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=5e-3)  # WCAG's own example
    assert (
        ciede2000(lab("#66c2a5", "deuteranopia"), lab("#b3b3b3", "deuteranopia")) < 15
    )  # a usual palette fails


def test_every_solver_has_a_look_and_nobody_shares_one():
    assert set(SOLVERS) <= set(METHODS)
    own = [(item.family, item.marker) for item in METHODS.values()]
    assert len(set(own)) == len(own)


@pytest.mark.parametrize("method", METHODS)
def test_dashes_follow_the_order_of_the_method(method):
    solver = SOLVERS[method]
    assert METHODS[method].order == solver.order
    assert METHODS[method].filled == method.startswith("contact")


def test_the_look_of_an_unknown_method_depends_on_its_name_and_family_alone():
    first = {name: look(name) for name in ("mine", "yours", "theirs")}
    assert {name: look(name) for name in reversed(first)} == first
    assert {own.family for own in first.values()} == {"other"}
    assert look("mine", "contact").family == "contact"
    assert look("mine", "established").family == "other"
