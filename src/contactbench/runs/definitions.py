"""What was run?  One cell: a scene or a method, with a digest of it that does not depend on the machine.

A scene is its numbers and its functions at a few points, a method one and two of its steps, all with 50 decimal
digits, of which 30 enter; of a solver of a library, what it declares.
"""

from __future__ import annotations

import dataclasses
import hashlib
from types import NoneType
from typing import TYPE_CHECKING

import numpy as np

from contactbench.measure.order import DIGITS, march
from contactbench.methods.base import METHODS, Method
from contactbench.methods.contact_exact import ExactMethod
from contactbench.methods.contact_log import Logarithmic
from contactbench.methods.fixed_step import FixedStep
from contactbench.runs.experiment import Cell, Profile, Recorded, experiment
from contactbench.scene import Scene
from contactbench.scenes import SCENES
from contactbench.tables.declared import DEFINITIONS
from contactbench.truth import decimal_context, with_decimals

if TYPE_CHECKING:
    from mpmath import MPContext

#: digits of a number that enter a digest
SHOWN = 30
#: scenes a method's steps are looked at, and the step
STEPPED, STEP = ("particle", "quadratic_damping", "rigid_body", "rigid_body_anisotropic"), "0.25"
#: and one on which steps follow the motion
FOLLOWED = "kepler"
#: how far the points lie from the initial state at which a scene's functions are looked at
OFFSETS = (0, 1, -2)
#: what says nothing of what a scene or a method does
WORDS = ("about", "hard", "experiments")


def digits_of(value: object, context: MPContext) -> str:
    if isinstance(value, list | tuple | np.ndarray):
        return f"[{' '.join(digits_of(each, context) for each in value)}]"
    return str(value) if value is None else context.nstr(context.mpf(value), SHOWN)


def declarations(item: Scene | Method) -> list[str]:
    data = bool, int, float, str, tuple, dict, NoneType
    fields = dataclasses.fields(item) if dataclasses.is_dataclass(item) else ()
    named = {field.name: getattr(item, field.name) for field in fields if field.init}
    return [f"{n}={value!r}" for n, value in named.items() if n not in WORDS and isinstance(value, data)]


def scene_lines(scene: Scene) -> list[str]:
    context = decimal_context(DIGITS)
    twin = with_decimals(scene, context.mpf)
    lines = [*declarations(scene), repr(scene.numbers())]
    start = twin.pack(twin.initial(scene.carry()))
    for offset in OFFSETS:
        y = [a + context.mpf(offset * (k + 1)) / 64 for k, a in enumerate(start)]
        x = twin.unpack(y, scene.carry())
        contact = [twin.hamiltonian_at(x)] if scene.is_contact else []
        values = [twin.pack(twin.rhs(x)), [twin.energy(x)], contact, twin.momentum_at(x), twin.jacobian(x)]
        lines += [digits_of(value, context) for value in values]
    return lines


def method_lines(method: Method) -> list[str]:
    lines = declarations(method)
    if not isinstance(method, FixedStep | Logarithmic | ExactMethod):
        return lines
    context = decimal_context(DIGITS)
    for name in (FOLLOWED,) if method.follows else STEPPED:
        if method.refuses(SCENES[name]) is None:
            ends = (march(method, SCENES[name], STEP, n, context) for n in (1, 2))
            lines += [f"{name} {digits_of(end, context)}" for end in ends]
    return lines


def row(item: Scene | Method) -> dict[str, str]:
    if isinstance(item, Scene):
        names, lines = {"scene": item.name, "method": ""}, scene_lines(item)
    else:
        names, lines = {"scene": "", "method": item.name}, method_lines(item)
    declared = "; ".join(line for line in declarations(item) if not line.endswith("=None"))
    digest = hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]
    return {**names, "declared": declared, "digest": digest}


@experiment(lambda profile: [("scene", name) for name in SCENES] + [("method", name) for name in METHODS])
def definition(cell: Cell, profile: Profile) -> Recorded:
    kind, name = cell
    yield DEFINITIONS, row(SCENES[name] if kind == "scene" else METHODS[name])
