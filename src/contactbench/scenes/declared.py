"""Scenes declared in data files: their numbers, and the names of their functions.

An entry is a scene's name.  of : its class, or the scene of which it is a change.  A function is named as in the
module that asks; a potential NAME has the gradient NAME_gradient and the Hessian NAME_hessian, where there are such.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from contactbench.scene import HeavyTop, Mechanical, RigidBody, Scene
from contactbench.scene.many import Lattice

KINDS: dict[str, Any] = {kind.__name__: kind for kind in (Mechanical, RigidBody, HeavyTop, Lattice)}
FUNCTIONS = ("potential", "gradient", "hessian", "exact", "onsite", "bond", "q", "p")


def declared(file: str, functions: Mapping[str, Any], known: Mapping[str, Scene]) -> dict[str, Scene]:
    """Return the scenes of a file by name; known : those that they may be changes of, beside those before them."""
    found: dict[str, Scene] = {}
    entries = tomllib.loads(files(__package__).joinpath(file).read_text(encoding="utf-8"))
    for name, entry in entries.items():
        given: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in entry.items()}
        of, potential = given.pop("of"), given.get("potential")
        derivatives = {part: f"{potential}_{part}" for part in ("gradient", "hessian")}
        given |= {part: function for part, function in derivatives.items() if function in functions}
        given |= {key: functions[given[key]] for key in FUNCTIONS if isinstance(given.get(key), str)}
        given |= {"name": name, "about": " ".join(given["about"].split())}
        found[name] = KINDS[of](**given) if of in KINDS else {**known, **found}[of].with_(**given)
    return found
