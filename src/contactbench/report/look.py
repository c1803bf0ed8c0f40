"""How a method and a role look in every figure and on the page: colour = family, dash = order, marker = method.

The contact methods are blues, the darker the higher their order; every other family is one colour.  Any two families
are at least 14 apart (CIEDE2000) as deuteranopes and protanopes see them (Machado, Oliveira & Fernandes 2009,
severity 1), any two shades at least 6, and all stand out from white by 3:1 (WCAG 2.2, 1.4.11); a test computes them.
"""

from __future__ import annotations

import hashlib
import tomllib
from importlib.resources import files
from typing import Any, NamedTuple

#: a curve that is not the best of its family
MUTED = "#c4c8cc"

DECLARED = tomllib.loads(files(__package__).joinpath("looks.toml").read_text(encoding="utf-8"))
FAMILIES: dict[str, str] = DECLARED["families"]
#: contact methods by order; the eighth, and what has no order, is the darkest
SHADES = {int(order): color for order, color in DECLARED["shades"].items()}


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


#: on and off, in line widths, by order
DASHES: dict[int | None, tuple[float, ...]] = {int(k): tuple(v) for k, v in DECLARED["dashes"].items()}
METHODS = {name: Look(*own) for name, own in DECLARED["methods"].items()}
#: markers for methods that are not ours to know
SPARE = ("p", "8", "s", "D", "^", "v")


def look(method: str, family: str = "") -> Look:
    known = METHODS.get(method)
    spare = SPARE[hashlib.sha256(method.encode()).digest()[0] % len(SPARE)]
    return known or Look(family if family in FAMILIES else "other", spare)


#: what is no method, as matplotlib line properties
ROLES: dict[str, dict[str, Any]] = DECLARED["roles"]
SHADED = ("#000000", "#0077BB", "#33BBEE", "#009988", "#EE7733")
ROLES |= {f"shade {i}": {"color": color, "linewidth": 1.2} for i, color in enumerate(SHADED)}
