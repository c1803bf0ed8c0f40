"""Functions of a user's scene that fit each other near the start and not along the motion."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

import contactbench as cb
from contactbench.scene import verify
from contactbench.scene.definition import verify_along, verify_at

SPRING = {"name": "mine", "q": (0.5,), "p": (1.0,), "t_end": 4.0}


def beyond(x, edge):
    """0 up to an edge, and smooth."""
    above = (x - edge + abs(x - edge)) / 2
    return above * above * above


def spherical(total=lambda t, h: 0, time=lambda t, h: 0):
    """The damping 2/t, its span spoilt by what is added to its parts."""
    return cb.Driven(
        potential=lambda q, t: q[0] * q[0] / 2,
        rate=lambda t: 2 / t,
        span=lambda t, h, xp: (2 * xp.log1p(h / t) + total(t, h), t * h / (t + h) + time(t, h)),
        t=1.0,
        **SPRING,
    )


def general(slope=lambda s: 0.1 + 0.2 * s, flow=None):
    """Γ = 0.1 s + 0.1 s², s' = −Γ solved by e^{−h/10}s/(1 + s(1 − e^{−h/10})); s falls from 3."""
    functions = {"damping": lambda s: 0.1 * s + 0.1 * s * s, "damping_slope": slope, "damping_flow": flow}
    return cb.GeneralDamping(potential=lambda q: q[0] * q[0] / 2, s=3.0, **functions, **SPRING)


def central(**changes):
    given = {
        "potential": lambda q: (q[0] * q[0] + q[1] * q[1]) / 2 + beyond(-q[0], 0.5),
        "gradient": lambda q: (q[0] - 3 * (beyond(-q[0], 0.5) ** 2) ** (1 / 3), q[1]),
    }
    return cb.Mechanical(name="mine", q=(1.0, 0.0), p=(0.3, 0.8), t_end=6.0, **given | changes)


def decay(s, h, xp):
    e = xp.exp(-h / 10)
    return s * e / (1 + s * (1 - e))


RIGHT = [spherical(), general(), general(flow=decay)]
WRONG = {
    "total of a span": (spherical(total=lambda t, h: h * beyond(t, 2)), "span[0]"),
    "time of a span": (spherical(time=lambda t, h: h * beyond(t, 2)), "span[1]"),
    "start of a span": (spherical(time=lambda t, h: beyond(t, 2)), "h = 0: must be 0"),
    "flow": (general(flow=lambda s, h, xp: decay(s, h, xp) - h * beyond(2 - s, 0)), "damping_flow has not"),
    "slope": (general(slope=lambda s: 0.1 + 0.2 * s + beyond(2 - s, 0)), "damping_slope is not"),
    "symmetry": (central(rotation_invariant=True), "exerts a torque"),
    "gradient": (central(gradient=lambda q: (q[0] if q[0] > -0.6 else 2 * q[0], q[1])), "gradient is not"),
}


@pytest.mark.parametrize("scene", RIGHT)
def test_a_damping_whose_parts_fit_is_taken(scene):
    verify(scene)
    verify_along(scene)


@pytest.mark.parametrize(("scene", "says"), WRONG.values(), ids=WRONG)
def test_a_part_that_is_wrong_away_from_the_start_is_refused_along_the_motion(scene, says):
    verify(scene)
    with pytest.raises(cb.BadInput, match=re.escape(says)):
        verify_along(scene)
    run = cb.prepare(scene, "scipy-dop853", rtol=1e-8, save_at=scene.t_end * np.arange(1, 9) / 8)()
    with pytest.raises(cb.BadInput, match=re.escape(says)):
        verify_at(scene, run.y)
    assert math.isfinite(run.y[-1, 0])
