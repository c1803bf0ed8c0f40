"""The hard scenes: where integrators break, and how.

They are registered beside the standard ones and marked `hard`, so that only the stability experiment runs them.
hard.toml says what is hard about each.
"""

from __future__ import annotations

from contactbench.scenes.declared import declared
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


HARD = tuple(declared("hard.toml", globals(), {scene.name: scene for scene in STANDARD}).values())
