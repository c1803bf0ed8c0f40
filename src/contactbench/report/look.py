"""How a method and a role look in every figure and on the page: colour = family, dash = order, marker = method.

The contact methods are blues, the darker the higher their order; every other family is one colour.  Any two families
are at least 14 apart (CIEDE2000) as deuteranopes and protanopes see them (Machado, Oliveira & Fernandes 2009,
severity 1), any two shades at least 6, and all stand out from white by 3:1 (WCAG 2.2, 1.4.11); a test computes them.
"""

from __future__ import annotations

import hashlib
from typing import Any, NamedTuple

from contactbench.registry import Registry

#: a curve that is not the best of its family
MUTED = "#c4c8cc"

FAMILIES = {
    "contact": "#006cd1",
    "rk4": "#000000",
    "herglotz": "#551a4d",
    "scipy": "#1a5c4c",
    "sundials": "#c77623",
    "cyrk": "#a03e00",
    "diffrax": "#819c73",
    "heyoka": "#9f7290",
    "other": "#3c2b0e",
}
#: contact methods by order; the eighth, and what has no order, is the darkest
SHADES = {1: "#0b9aeb", 2: "#0c84de", 4: FAMILIES["contact"], 6: "#0654bf", 8: "#0038ad"}


class Look(NamedTuple):
    """Family, matplotlib marker, order (None: variable, or exact); contact markers are filled, all others hollow."""

    family: str
    marker: str
    order: int | None = None

    @property
    def color(self) -> str:
        if self.family == "contact":
            return SHADES.get(self.order or 8, FAMILIES["contact"])
        return FAMILIES[self.family]


#: on and off, in line widths, by order; the eighth order and what has no fixed one are solid
DASHES: dict[int | None, tuple[float, ...]] = {
    1: (1, 1.5),
    2: (3, 1.5),
    3: (4, 1.5),
    4: (6, 2),
    5: (6, 1.5, 1, 1.5),
    6: (10, 1.5, 1.5, 1.5),
}

LOOKS = {
    "contact-printed": Look("contact", "X", 1),
    "contact-abc": Look("contact", "s", 2),
    "contact-strang": Look("contact", "o", 2),
    "contact-bm4": Look("contact", "^", 4),
    "contact-bm6": Look("contact", "v", 6),
    "contact-rkn4": Look("contact", "D", 4),
    "contact-rkn6": Look("contact", "*", 6),
    "contact-rkn8": Look("contact", "p", 8),
    "contact-o8": Look("contact", "P", 8),
    "contact-yoshida6": Look("contact", "<", 6),
    "contact-rkn6a": Look("contact", ">", 6),
    "contact-rkn8b": Look("contact", "d", 8),
    "contact-exact": Look("contact", "h"),
    "rk4": Look("rk4", "x", 4),
    "quinlan-tremaine8": Look("rk4", "o", 8),
    "quinlan-tremaine12": Look("rk4", "D", 12),
    "stormer12": Look("rk4", "v", 12),
    "gauss4": Look("rk4", "s", 4),
    "gauss6": Look("rk4", "p", 6),
    "discrete-gradient": Look("rk4", "h", 2),
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
#: markers of methods that are not listed
SPARE = ("p", "8", "s", "D", "^", "v", "H")


def look(method: str, family: str = "") -> Look:
    """Return the look of a listed method; of any other its order, and a marker free in its family."""
    if (known := LOOKS.get(method)) is not None:
        return known
    family = family if family in FAMILIES else "other"
    taken = {own.marker for own in LOOKS.values() if own.family == family}
    spare = [marker for marker in SPARE if marker not in taken]
    methods = next(registry for registry in Registry.every if registry.kind == "method")
    order = getattr(methods.get(method), "order", None)
    return Look(family, spare[hashlib.sha256(method.encode()).digest()[0] % len(spare)], order)


BLACK, BLUE, ORANGE = "#000000", "#0077BB", "#CC3311"

#: what is no method, as matplotlib line properties
ROLES: dict[str, dict[str, Any]] = {
    "truth": {"color": "#bbbbbb", "linewidth": 4.0},
    "law": {"color": ORANGE, "linestyle": ":", "linewidth": 1.6, "zorder": 3},
    "guide": {"color": "#999999", "linestyle": ":", "linewidth": 1.0},
    "criterion": {"color": BLACK, "linestyle": "--", "linewidth": 1.4, "zorder": 3},
    "conservative": {"color": BLACK, "linewidth": 0.9},
    "dissipative": {"color": BLUE, "linestyle": "--", "linewidth": 1.3},
    "flow": {"color": "#999999", "linewidth": 0.7},
    "stable": {"color": BLUE, "marker": "o"},
    "unstable": {"color": ORANGE, "marker": "X"},
    "neutral": {"color": "#888888", "marker": "s"},
}
SHADED = (BLACK, BLUE, "#33BBEE", "#009988", "#EE7733")
ROLES |= {f"shade {i}": {"color": color, "linewidth": 1.2} for i, color in enumerate(SHADED)}
