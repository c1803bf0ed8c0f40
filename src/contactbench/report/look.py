"""How a method and a role look in every figure and on the page: colour = family, dash = order, marker = method.

The families' colours are chosen so that any two are at least 15 apart (CIEDE2000) as deuteranopes and
protanopes see them (Machado, Oliveira & Fernandes 2009, severity 1), and stand out from their page by 3:1 at
least (WCAG 2.2, 1.4.11); a test computes both.
"""

from __future__ import annotations

import hashlib
from typing import Any, NamedTuple

PAPER, DARK_PAPER = "#ffffff", "#101418"
#: a curve that is not the best of its family
MUTED, DARK_MUTED = "#c4c8cc", "#4a525a"


class Family(NamedTuple):
    """A colour on white and one on the dark page."""

    light: str
    dark: str


FAMILIES = {
    "contact": Family("#1b74fa", "#2c8bff"),
    "rk4": Family("#000000", "#ffffff"),
    "herglotz": Family("#793289", "#c7a0a8"),
    "scipy": Family("#194d00", "#a8d188"),
    "sundials": Family("#c28700", "#fff318"),
    "cyrk": Family("#00a092", "#00d6ed"),
    "diffrax": Family("#000a51", "#516c2e"),
    "heyoka": Family("#ff438c", "#d155a0"),
    "other": Family("#68695f", "#847a72"),
}


class Look(NamedTuple):
    """Family, matplotlib marker, order (None: variable, or exact); contact markers are filled, all others hollow."""

    family: str
    marker: str
    order: int | None = None

    @property
    def color(self) -> str:
        return FAMILIES[self.family].light

    @property
    def dark(self) -> str:
        return FAMILIES[self.family].dark

    @property
    def filled(self) -> bool:
        return self.family == "contact"

    @property
    def dash(self) -> tuple[float, ...]:
        return DASHES.get(self.order, ())


#: on and off, in line widths, by order; the eighth order and what has no fixed one are solid
DASHES: dict[int | None, tuple[float, ...]] = {
    1: (1, 1.5), 2: (3, 1.5), 3: (4, 1.5), 4: (6, 2), 5: (6, 1.5, 1, 1.5), 6: (10, 1.5, 1.5, 1.5),
}  # fmt: skip

METHODS = {
    "contact-printed": Look("contact", "X", 1),
    "contact-abc": Look("contact", "s", 2),
    "contact-strang": Look("contact", "o", 2),
    "contact-bm4": Look("contact", "^", 4),
    "contact-bm6": Look("contact", "v", 6),
    "contact-rkn4": Look("contact", "D", 4),
    "contact-rkn6": Look("contact", "*", 6),
    "contact-rkn8": Look("contact", "p", 8),
    "contact-o8": Look("contact", "P", 8),
    "contact-adaptive": Look("contact", "8", 6),
    "contact-exact": Look("contact", "h"),
    "rk4": Look("rk4", "x", 4),
    "herglotz1": Look("herglotz", "d", 1),
    "herglotz2": Look("herglotz", "H", 2),
    "scipy-dop853": Look("scipy", "^", 8),
    "scipy-radau": Look("scipy", "v", 5),
    "cvode-adams": Look("sundials", "<"),
    "cvode-bdf": Look("sundials", ">"),
    "cyrk-dop853": Look("cyrk", "s", 8),
    "cyrk-vern8": Look("cyrk", "p", 8),
    "cyrk-tsit5": Look("cyrk", "8", 5),
    "cyrk-lsoda": Look("cyrk", "X"),
    "cyrk-radau": Look("cyrk", "h", 5),
    "diffrax-tsit5": Look("diffrax", "D", 5),
    "diffrax-dopri8": Look("diffrax", "P", 8),
    "diffrax-kvaerno5": Look("diffrax", "h", 5),
    "heyoka-taylor": Look("heyoka", "*"),
}
#: markers for methods that are not ours to know
SPARE = ("p", "8", "s", "D", "^", "v")


def look(method: str, family: str = "") -> Look:
    """The look of a method; of one unknown here it follows from its name and the family it declares."""
    known = METHODS.get(method)
    spare = SPARE[hashlib.sha256(method.encode()).digest()[0] % len(SPARE)]
    return known or Look(family if family in FAMILIES else "other", spare)


BLUE, ORANGE, GREEN, GREY, BLACK = "#0077BB", "#CC3311", "#009988", "#888888", "#000000"

#: what is no method, as matplotlib line properties
ROLES: dict[str, dict[str, Any]] = {
    "truth": {"color": "#bbbbbb", "linewidth": 4.0},
    "law": {"color": ORANGE, "linestyle": ":", "linewidth": 1.6},
    "reference": {"color": "#777777", "linewidth": 0.9},
    "guide": {"color": "#999999", "linestyle": ":", "linewidth": 1.0},
    "criterion": {"color": BLACK, "linestyle": "--", "linewidth": 1.4},
    "conservative": {"color": BLACK, "linewidth": 0.9},
    "dissipative": {"color": BLUE, "linewidth": 1.3},
    "flow": {"color": "#999999", "linewidth": 0.7},
    "stable": {"color": BLUE, "marker": "o"},
    "unstable": {"color": ORANGE, "marker": "X"},
    "neutral": {"color": GREY, "marker": "s"},
    **{
        f"shade {i}": {"color": color, "linewidth": 1.2}
        for i, color in enumerate((BLACK, BLUE, "#33BBEE", GREEN, "#EE7733"))
    },
}
