"""Shared by the tests: scenes to run on, random states, high-precision twins."""

from __future__ import annotations

import numpy as np
import pytest
from mpmath import mp

import contactbench as cb


def user_scene() -> cb.Mechanical:
    """A scene a user might bring: three degrees of freedom, mass 2, no Hessian."""

    def potential(q):  # its constants are binary fractions, exact in every precision
        x, y, z = q
        return x * x / 2 + y * y + z * z + x * y * z / 4

    def gradient(q):
        x, y, z = q
        return (x + y * z / 4, 2 * y + x * z / 4, 2 * z + x * y / 4)

    return cb.Mechanical(
        name="user", potential=potential, gradient=gradient, gamma=0.2, mass=2.0,
        q=(0.3, -0.2, 0.5), p=(0.1, 0.4, -0.6), s=0.2, t_end=2.0,
    )  # fmt: skip


USER = user_scene()
#: a full symmetric D, whose axes are not the body's
TILTED = cb.SCENES["rigid_body_anisotropic"].with_(
    name="tilted", damping=((0.3, 0.1, 0.0), (0.1, 0.2, 0.05), (0.0, 0.05, 0.1))
)
#: every registered scene, and the shapes the registry does not have
ALL_SCENES = [*cb.SCENES.values(), USER, TILTED]
CONTACT_SCENES = [scene for scene in ALL_SCENES if scene.conformal_rate is not None]


def by_name(items):
    return pytest.mark.parametrize("scene", items, ids=lambda scene: scene.name)


def random_state(scene, seed: int = 0, carry=None):
    """A generic state of a scene, its attitude a unit quaternion."""
    rng = np.random.default_rng(seed)
    carry = scene.carry(carry)
    y = rng.normal(size=len(scene.labels(carry)))
    if "R" in carry:
        y[3:7] /= np.linalg.norm(y[3:7])
    return scene.unpack(y.tolist(), carry)


def in_mp(scene, x):
    """Scene and state with 50-digit numbers (the floats' decimal representations)."""
    exact = scene.with_numbers([mp.mpf(repr(v)) for v in scene.numbers()])
    carry = [f for f in scene.optional if getattr(x, f) is not None]
    return exact, scene.unpack([mp.mpf(repr(v)) for v in scene.pack(x)], carry)
