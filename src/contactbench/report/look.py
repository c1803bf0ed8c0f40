"""How a method and a role look in every figure: colour = family, dash = order, marker = method.

The contact methods are blues, the darker the higher their order; every other family is one colour.  Any two families
are at least 14 apart (CIEDE2000) as deuteranopes and protanopes see them (Machado, Oliveira & Fernandes 2009,
severity 1), any two shades at least 6, and all stand out from white by 3:1 (WCAG 2.2, 1.4.11); a test computes them.
"""

from __future__ import annotations

import hashlib
import tomllib
from importlib.resources import files
from typing import NamedTuple

from contactbench.registry import Registry

#: the family of the contact methods
CONTACT = "contact"
LOOK = tomllib.loads(files(__package__).joinpath("looks.toml").read_text(encoding="utf-8"))
FAMILIES: dict[str, str] = LOOK["families"]
#: groups of methods; every figure draws the best of each group
CONTESTANTS: list[list[str]] = LOOK["contestants"]
#: colours of contact methods, and dashes of all, by order
SHADES: dict[int, str] = {int(order): color for order, color in LOOK["shades"].items()}
DASHES = {int(order): tuple(lengths) for order, lengths in LOOK["dashes"].items()}
#: looks of curves that belong to no method, as matplotlib line properties
ROLES: dict[str, dict[str, object]] = LOOK["roles"]


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


LOOKS = {
    method: Look(family, *given)
    for family, methods in LOOK["methods"].items()
    for method, given in methods.items()
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
