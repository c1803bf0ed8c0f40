"""The hard scenes: where integrators break, and how.

They are registered beside the standard ones and marked `hard`, so that only the stability experiment runs them.
hard.toml says what is hard about each.
"""

from __future__ import annotations

import tomllib
from importlib.resources import files
from typing import Any

from contactbench.scene import Mechanical, Scene
from contactbench.scenes.standard import STANDARD


def two_scales(q, omega, coupling):
    """V = ½ q1² + ½ ω² q2² + c q1² q2: a slow and a fast oscillation, coupled."""
    x, y = q
    return (x * x + omega * omega * y * y) / 2 + coupling * x * x * y


def two_scales_gradient(q, omega, coupling):
    x, y = q
    return (x + 2 * coupling * x * y, omega * omega * y + coupling * x * x)


def two_scales_hessian(q, omega, coupling):
    x, y = q
    mixed = 2 * coupling * x
    return ((1 + 2 * coupling * y, mixed), (mixed, omega * omega + 0 * y))


def kepler(q, strength):
    """V = −k/‖q‖."""
    x, y = q
    return -strength * (x * x + y * y) ** -0.5


def kepler_gradient(q, strength):
    x, y = q
    inverse = (x * x + y * y) ** -0.5
    pull = strength * inverse * inverse * inverse
    return (pull * x, pull * y)


def kepler_hessian(q, strength):
    x, y = q
    inverse = (x * x + y * y) ** -0.5
    square = inverse * inverse
    pull = strength * inverse * square
    mixed = -3 * pull * square * x * y
    return ((pull * (1 - 3 * square * x * x), mixed), (mixed, pull * (1 - 3 * square * y * y)))


STIFF_SPRING = Mechanical(
    name="stiff_spring",
    potential=two_scales,
    gradient=two_scales_gradient,
    hessian=two_scales_hessian,
    parameters={"omega": 100.0, "coupling": 0.1},
    gamma=0.1,
    q=(1.0, 0.01),
    p=(0.0, 0.3),
    t_end=20.0,
)

KEPLER_DRAG = Mechanical(
    name="kepler_drag",
    potential=kepler,
    gradient=kepler_gradient,
    hessian=kepler_hessian,
    rotation_invariant=True,
    parameters={"strength": 1.0},
    gamma=1e-3,
    q=(0.1, 0.0),
    p=(0.0, 4.358898943540674),
    t_end=100.0,
)

#: the scenes that others are changes of
OF = {scene.name: scene for scene in (*STANDARD, STIFF_SPRING, KEPLER_DRAG)}


def declare(name: str, of: str, about: str, **changes: Any) -> Scene:
    """Return a scene from its entry in hard.toml."""
    given = {key: tuple(value) if isinstance(value, list) else value for key, value in changes.items()}
    return OF[of].with_(name=name, hard=True, about=" ".join(about.split()), **given)


DECLARED = tomllib.loads(files(__package__).joinpath("hard.toml").read_text(encoding="utf-8"))
HARD = tuple(declare(name, **entry) for name, entry in DECLARED.items())
