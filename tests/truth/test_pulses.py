"""No reference of a driven scene is wrong: pulses, steps and ramps in time at random, against an own DOP853."""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import DOP853

import contactbench as cb
from contactbench.numbers.functions import cos, cosh, exp, sin, tanh

#: of all seeds those that are quick, one of each kind, and a jump reached by steps that sum up to a little more
QUICK, ALL = (0, 1, 2, 3, 5, 6, 11, 73), 240


def bell(x):
    return exp(-(x * x))


def hump(x):
    return 1 / (1 + x * x) ** 4


def soliton(x):
    return 1 / cosh(0.5 * tanh(x / 100) * 200) ** 2  # x/100 keeps cosh within the range of floats


SHAPES = {"bell": (bell, 7.0), "hump": (hump, 60.0), "soliton": (soliton, 25.0)}
WELLS = {
    "free": (lambda q: 0.0 * q, lambda q: 0.0 * q),
    "spring": (lambda q: q * q / 2, lambda q: q),
    "pendulum": (lambda q: -cos(q), sin),
    "double well": (lambda q: q * q * (q * q / 4 - 0.5), lambda q: q * (q * q - 1)),
}


def scene(seed):
    """Return a driven scene, its force and damping once more in floats, and where which steps resolve them."""
    rng = np.random.default_rng(seed)
    kind = ("pulse", "pulse", "step", "jump", "ramp", "moving", "damping")[seed % 7]
    t_end = float(rng.uniform(5, 40 if kind != "moving" else 10))
    well, slope = WELLS[rng.choice([*WELLS])]
    start = (0.0, 0.0) if rng.random() < 0.4 else tuple(rng.uniform(-1, 1, 2).tolist())
    gamma, size = float(rng.uniform(0, 0.3)), float(rng.uniform(0.1, 3) * rng.choice([-1, 1]))
    count = int(rng.integers(1, 4)) if kind == "pulse" else 1
    at = np.sort(rng.uniform(0, t_end, count)).tolist()
    least = {"pulse": 1e-3, "step": 1e-4, "ramp": t_end / 20, "damping": 3e-3}.get(kind, 1e-2)
    width = float(np.exp(rng.uniform(math.log(least), math.log(max(1.0, 4 * least)))))
    shape, reach = SHAPES[rng.choice([*SHAPES])]
    more, rate = {}, None
    if kind in ("pulse", "damping"):
        profile = lambda t: sum(shape((t - c) / width) for c in at)  # noqa: E731
    elif kind == "jump":
        profile, reach = lambda t: 1.0 if t < at[0] else -0.5, 0.0
        more = {"breaks": tuple(at)}
    else:
        profile, reach = lambda t: tanh((t - at[0]) / width), 20.0
    V = lambda q, t: well(q[0]) - size * q[0] * profile(t)  # noqa: E731
    force = lambda q, t: size * profile(t) - slope(q)  # noqa: E731
    if kind == "moving":
        width, slow = 0.02, float(rng.uniform(0.5, 1.5))
        V = lambda q, t: q[0] * q[0] / 2 - 0.3 * bell((q[0] - 3 * sin(slow * t)) / width)  # noqa: E731
        force = lambda q, t: (  # noqa: E731
            -q - 0.6 * (x := (q - 3 * sin(slow * t)) / width) / width * bell(x)
        )
    if kind == "damping":
        gamma, rate = 0.0, lambda t: 0.1 + abs(size) / width**0.5 * profile(t)
        V, force = (lambda q, t: well(q[0]) - q[0]), (lambda q, t: 1 - slope(q))
    made = cb.Driven(
        name=f"{kind} {seed}",
        potential=V,
        gradient=(lambda q, t: (-force(q[0], t),)) if kind == "jump" else None,
        gamma=gamma,
        rate=rate,
        q=start[:1],
        p=start[1:],
        t_end=t_end,
        **more,
    )
    return made, force, rate or (lambda t: gamma), [(c, width, reach * width) for c in at]


def followed(scene, force, rate, places):
    """Return (q, p) at the end by DOP853, whose steps are short wherever something happens."""
    bounds = {0.0, scene.t_end, *(c + side * reach for c, _, reach in places for side in (-1, 1))}
    bounds = sorted(b for b in bounds if 0 <= b <= scene.t_end)
    y = [scene.q[0], scene.p[0]]
    for a, b in itertools.pairwise(bounds):

        def slope(t, y, a=a, b=b):  # within the piece, also where it ends
            t = min(max(t, math.nextafter(a, b)), math.nextafter(b, a))
            return y[1], force(y[0], t) - rate(t) * y[1]

        near = [w for c, w, reach in places if c - reach <= (a + b) / 2 <= c + reach]
        longest = 1e-3 if scene.name.startswith("moving") else min([0.1, *(w / 2 for w in near)])
        solver = DOP853(slope, a, y, b, rtol=1e-12, atol=1e-13, max_step=longest)
        while solver.status == "running":
            solver.step()
        y = solver.y
    return y


@pytest.mark.parametrize(
    "seed", [pytest.param(n, marks=[pytest.mark.slow] * (n not in QUICK)) for n in range(ALL)]
)
def test_no_reference_of_a_driven_scene_is_wrong(seed):
    made, *known = scene(seed)
    found, true = cb.reference(made, [made.t_end], ()), followed(made, *known)
    # round-off of DOP853, which grows with the motion
    assert np.abs(found.y[0, :2] - true).max() <= 1e-8 * max(1.0, np.abs(true).max())
