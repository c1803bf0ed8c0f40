"""How a method, a role and a mark look: one colour and marker per method in every figure and on the page."""

from __future__ import annotations

import hashlib
from typing import Any, NamedTuple


class Look(NamedTuple):
    """A colour (#rrggbb), a matplotlib marker, and whether the marker is filled."""

    color: str
    marker: str
    filled: bool = True


# Okabe–Ito and Tol's vibrant set: distinguishable with the common colour-vision deficiencies, and never by
# colour alone: each method has its own marker; contact methods are filled, all others hollow.
METHODS = {
    "contact-printed": Look("#882255", "X"),
    "contact-abc": Look("#0077BB", "s"),
    "contact-strang": Look("#33BBEE", "o"),
    "contact-bm4": Look("#004488", "^"),
    "contact-bm6": Look("#004488", "v"),
    "contact-rkn4": Look("#228833", "D"),
    "contact-rkn6": Look("#4477AA", "*"),
    "contact-rkn8": Look("#CC6677", "p"),
    "contact-o8": Look("#AA3377", "P"),
    "contact-adaptive": Look("#BB5566", "8"),
    "contact-exact": Look("#225555", "h"),
    "rk4": Look("#000000", "x", False),
    "herglotz1": Look("#661100", "d", False),
    "herglotz2": Look("#6699CC", "H", False),
    "scipy-dop853": Look("#CC3311", "^", False),
    "scipy-radau": Look("#EE7733", "v", False),
    "cvode-adams": Look("#AA4499", "<", False),
    "cvode-bdf": Look("#DDAA33", ">", False),
    "cyrk-dop853": Look("#8C2D19", "s", False),
    "cyrk-vern8": Look("#5B2C83", "p", False),
    "cyrk-tsit5": Look("#2F7F6B", "8", False),
    "cyrk-lsoda": Look("#8A6D1B", "X", False),
    "cyrk-radau": Look("#C06000", "h", False),
    "diffrax-tsit5": Look("#009988", "D", False),
    "diffrax-dopri8": Look("#117733", "P", False),
    "diffrax-kvaerno5": Look("#999933", "h", False),
    "heyoka-taylor": Look("#EE3377", "*", False),
}
#: for methods that are not ours to know; which one depends on the name alone
SPARE = (
    Look("#332288", "p"), Look("#888888", "8"), Look("#44AA99", "p"), Look("#A6761D", "8"), Look("#D95F82", "p"),
)  # fmt: skip


def look(method: str) -> Look:
    """The look of a method; of one unknown here it is a function of its name."""
    known = METHODS.get(method)
    return known or SPARE[hashlib.sha256(method.encode()).digest()[0] % len(SPARE)]


BLUE, ORANGE, GREEN, GREY, BLACK = "#0077BB", "#CC3311", "#009988", "#888888", "#000000"

#: what is no method, as matplotlib line properties
ROLES: dict[str, dict[str, Any]] = {
    "truth": {"color": "#bbbbbb", "linewidth": 4.0},
    "law": {"color": ORANGE, "linestyle": ":", "linewidth": 1.6},
    "reference": {"color": "#777777", "linewidth": 0.9},
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
