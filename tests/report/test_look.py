"""Colours are told apart by everybody, stand out from their page, and belong to one family each."""

from __future__ import annotations

from itertools import combinations
from math import dist

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from contactbench import METHODS as SOLVERS
from contactbench.report.look import FAMILIES, METHODS, SHADES

#: linear sRGB as seen by people without one kind of cone (severity 1.0); Machado, Oliveira & Fernandes (2009),
#: "A physiologically-based model for simulation of color vision deficiency", IEEE TVCG 15(6), table 1
VISION = {
    "normal": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
}
#: linear sRGB to XYZ (IEC 61966-2-1), and the white of D65
XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
WHITE = np.array([0.95047, 1.0, 1.08883])


def linear(color: str) -> np.ndarray:
    value = np.array(to_rgb(color))
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def luminance(color: str) -> float:
    """WCAG 2.2."""
    return float(linear(color) @ (0.2126, 0.7152, 0.0722))


def contrast(one: str, other: str) -> float:
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def lab(color: str, vision: str = "normal") -> np.ndarray:
    """CIE L*a*b*, D65."""
    xyz = XYZ @ np.clip(VISION[vision] @ linear(color), 0, 1) / WHITE
    f = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


# -- Colours are told apart by everybody, stand out from their page, and belong to on --------------
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
    assert contrast(color, "#ffffff") >= 3


def test_every_solver_has_a_look_and_nobody_shares_one():
    assert set(SOLVERS) <= set(METHODS)
    own = [(item.family, item.marker) for item in METHODS.values()]
    assert len(set(own)) == len(own)


@pytest.mark.parametrize("method", METHODS)
def test_dashes_follow_the_order_of_the_method(method):
    assert METHODS[method].order == SOLVERS[method].order
