"""What a scene and a method are, in a digest that does not depend on the machine.

A scene is its numbers and its functions at a few points, a method one and two of its steps, all with 50
decimal digits and from the digits that are printed: no processor and no library rounds them otherwise, and
a change of any coefficient shows in the first 30.  A solver of a library has no steps to look at: what it is
asked for is in its digest, and its version in the record of the run.
"""

from __future__ import annotations

import dataclasses
import hashlib
from types import NoneType
from typing import Any

import numpy as np

from contactbench.measure.order import DIGITS, march
from contactbench.scene import Scene
from contactbench.scenes import SCENES
from contactbench.truth import decimal_context, with_decimals

#: digits of a number that enter a digest
SHOWN = 30
#: scenes a method's steps are looked at, and the step
STEPPED, STEP = ("particle", "quadratic_damping", "rigid_body", "rigid_body_anisotropic"), "0.25"
#: how far the points lie from the initial state at which a scene's functions are looked at
OFFSETS = (0, 1, -2)
#: what says nothing of what a scene or a method does
WORDS = ("about", "hard", "experiments")


def digits_of(value: Any, context: Any) -> str:
    if isinstance(value, list | tuple | np.ndarray):
        return f"[{' '.join(digits_of(each, context) for each in value)}]"
    return str(value) if value is None else context.nstr(context.mpf(value), SHOWN)


def declarations(item: Any) -> list[str]:
    data = bool, int, float, str, tuple, dict, NoneType
    named = {field.name: getattr(item, field.name) for field in dataclasses.fields(item) if field.init}
    return [f"{n}={value!r}" for n, value in named.items() if n not in WORDS and isinstance(value, data)]


def scene_lines(scene: Scene) -> list[str]:
    context = decimal_context(DIGITS)
    twin = with_decimals(scene, context.mpf)
    lines = [*declarations(scene), repr(scene.numbers())]
    start = twin.pack(twin.initial(scene.carry()))
    for offset in OFFSETS:
        y = [a + context.mpf(offset * (k + 1)) / 64 for k, a in enumerate(start)]
        x = twin.unpack(y, scene.carry())
        contact = [twin.hamiltonian(x)] if scene.is_contact else []
        values = [twin.pack(twin.rhs(x)), [twin.energy(x)], contact, twin.momentum(x), twin.jacobian(x)]
        lines += [digits_of(value, context) for value in values]
    return lines


def method_lines(method: Any) -> list[str]:
    lines = declarations(method)
    if not hasattr(method, "advance"):
        return lines
    context = decimal_context(DIGITS)
    for name in STEPPED:
        if method.refuses(SCENES[name]) is None:
            ends = (march(method, SCENES[name], STEP, n, context) for n in (1, 2))
            lines += [f"{name} {digits_of(end, context)}" for end in ends]
    return lines


def row(item: Any) -> dict[str, str]:
    is_scene = isinstance(item, Scene)
    lines = scene_lines(item) if is_scene else method_lines(item)
    return {
        "scene": item.name if is_scene else "",
        "method": "" if is_scene else item.name,
        "declared": "; ".join(line for line in declarations(item) if not line.endswith("=None")),
        "digest": hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16],
    }
