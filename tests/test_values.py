"""Scenes written as users write them, changed between calls: every `ok` is compared with an integration of our own.

The quick part always, all 500 calls with ``-m slow``.
"""

from __future__ import annotations

import functools
import math
import random

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import contactbench as cb
from contactbench.methods.base import METHODS

QUICK, ALL = 30, 500
#: a wrong program is off by far more; a method at its setting here by less
CLOSE = 2e-4

# -- what is computed: potential and gradient of q, a stiffness k and a coupling c -------------------
FORMS = {
    "quartic": (
        lambda q, k, c: k * sum(x * x for x in q) / 2 + c * sum(x**4 for x in q) / 4,
        lambda q, k, c: [k * x + c * x**3 for x in q],
    ),
    "pendulum": (
        lambda q, k, c: -k * sum(cb.math.cos(x) for x in q) + c * q[0] ** 2 / 2,
        lambda q, k, c: [k * cb.math.sin(x) + (c * x if i == 0 else 0) for i, x in enumerate(q)],
    ),
    "coupled": (
        lambda q, k, c: sum(k * x * x for x in q) / 2 + c * q[0] ** 2 * q[-1] / 10,
        lambda q, k, c: [
            k * x + (c * q[0] * q[-1] / 5 if i == 0 else 0) + (c * q[0] ** 2 / 10 if i == len(q) - 1 else 0)
            for i, x in enumerate(q)
        ],
    ),
    "well": (
        lambda q, k, c: -k * np.exp(-sum(x * x for x in q) / 2) + c * sum(x * x for x in q) / 2,
        lambda q, k, c: [k * x * np.exp(-sum(y * y for y in q) / 2) + c * x for x in q],
    ),
    "ring": (
        lambda q, k, c: sum(k * (q[i] - q[i - 1]) ** 2 / 2 for i in range(len(q))) + c * (q @ q if hasattr(q, "dot")
                                                                                       else sum(x * x for x in q)) / 2,
        lambda q, k, c: [
            k * (2 * x - q[i - 1] - q[(i + 1) % len(q)]) + c * x if len(q) > 1 else c * x
            for i, x in enumerate(q)
        ],
    ),
}  # fmt: skip
SHARED = {"k": 1.0, "c": 0.1}


class Model:
    """Stiffness and coupling as attributes, the functions as methods."""

    def __init__(self, form, k, c):
        self.form, self.k, self.c = FORMS[form], k, c

    def potential(self, q):
        return self.form[0](q, self.k, self.c)

    def gradient(self, q):
        return tuple(self.form[1](q, self.k, self.c))

    def set(self, k, c):
        self.k, self.c = k, c


def written(style, form, k, c):
    """(keywords of a scene, how its numbers are changed afterwards)."""
    V, dV = FORMS[form]
    if style == "attributes":
        model = Model(form, k, c)
        return {"potential": model.potential, "gradient": model.gradient}, model.set
    if style == "globals":
        SHARED.update(k=k, c=c)
        return (
            {"potential": lambda q: V(q, **SHARED), "gradient": lambda q: dV(q, **SHARED)},
            lambda k, c: SHARED.update(k=k, c=c),
        )
    if style == "closure":

        def change(*values):
            nonlocal k, c
            k, c = values

        def potential(q):
            def inner(x):
                return V(x, np.float64(k), c)

            return inner(q)

        return {"potential": potential, "gradient": lambda q: tuple(dV(q, k, c))}, change
    if style == "partial":
        held = [k, c]

        def force(q, held):
            return tuple(dV(q, *held))

        return (
            {"potential": lambda q: V(q, *held), "gradient": functools.partial(force, held=held)},
            lambda k, c: held.__setitem__(slice(None), [k, c]),
        )
    if style == "potential alone":
        model = Model(form, k, c)
        return {"potential": model.potential}, model.set
    return {"potential": V, "gradient": dV, "parameters": {"k": k, "c": c}}, None


STYLES = ["attributes", "globals", "closure", "partial", "potential alone", "parameters"]
METHOD_NAMES = [
    "contact-strang", "contact-rkn6", "contact-bm4", "rk4", "contact-adaptive", "scipy-dop853", "scipy-radau",
    "cvode-adams", "cvode-bdf", "cyrk-dop853", "heyoka-taylor", "heyoka-taylor", "scipy-dop853", "rk4",
]  # fmt: skip


def own(form, k, c, gamma, mass, q, p, t_end):
    """The end of the motion by SciPy on NumPy vectors, sharing nothing with the scene but the formula."""
    n = len(q)

    def slope(t, y):
        return np.concatenate([y[n:] / mass, -np.array(FORMS[form][1](y[:n], k, c)) - gamma * y[n:]])

    return solve_ivp(slope, (0, t_end), [*q, *p], "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]


def asked(call, scene, method, options, t_end):
    """The end (q, p) by one of the public calls, or None where it says that it cannot."""
    if call == "run":
        found = cb.prepare(scene, method, save_at=[t_end], **options)()
    elif call == "laws":
        found = cb.solve(scene, method, save_at=[t_end], **options)
        if found.ok:
            assert found.laws().loc["solution_error", "deviation"] < CLOSE
    elif call == "ensemble":
        many = {"q": tuple(np.full(2, x) for x in scene.q)}
        found = cb.ensemble(scene, "contact-rkn6", many, step=0.05, progress=False)
        return np.array([*(x[1] for x in found.final.q), *(x[1] for x in found.final.p)])
    elif call == "step":
        step = cb.step_map(scene, "contact-rkn6", carry=())
        y, n = step.start, math.ceil(t_end / 0.05)
        for _ in range(n):
            y = step(y, t_end / n)
        return np.array(y)
    elif call == "reference":
        return cb.reference(scene, [t_end], carry=()).y[0]
    else:
        found = cb.solve(scene, method, **options)
    return found.y[-1][: 2 * len(scene.q)] if found.ok else None


def wrong(seed):
    """Calls that were answered, and those of them that were wrong, of one seed: two problems in one scene."""
    rng = random.Random(seed)
    form, style = rng.choice(list(FORMS)), STYLES[seed % len(STYLES)]
    n, gamma, mass = rng.choice([1, 1, 2, 3]), rng.choice([0.0, 0.1, 0.4]), rng.choice([1.0, 1.0, 2.5])
    q, p = [[round(rng.uniform(-1, 1), 2) for _ in range(n)] for _ in range(2)]
    t_end = rng.choice([1.0, 2.0, 3.0])
    numbers = [(round(rng.uniform(0.5, 3), 2), round(rng.uniform(0.0, 1), 2)) for _ in range(2)]
    given, change = written(style, form, *numbers[0])
    scene = cb.Mechanical(name=f"fuzz{seed}", gamma=gamma, mass=mass, q=q, p=p, t_end=t_end, **given)
    method = rng.choice(METHOD_NAMES)
    options = {"rtol": 1e-8} if METHODS[method].adaptive else {"step": 0.01}
    call = rng.choice(["solve", "solve", "run", "laws", "ensemble", "step", "reference"])
    answered, failures = 0, []
    for k, c in (*numbers, numbers[0]):
        if change is None:
            scene = scene.with_(k=k, c=c)
        else:
            change(k, c)
        found = asked(call, scene, method, options, t_end)
        if found is None:
            continue
        answered += 1
        off = np.abs(found - own(form, k, c, gamma, mass, q, p, t_end)).max()
        if not off < CLOSE:
            failures.append((seed, form, style, call, method, k, c, off))
    return answered, failures


def outcome(seeds):
    pairs = [wrong(seed) for seed in seeds]
    return sum(answered for answered, _ in pairs), [failure for _, found in pairs for failure in found]


def test_no_ok_is_wrong():
    answered, failures = outcome(range(QUICK // 3))
    assert failures == []
    assert answered >= QUICK - 3


@pytest.mark.slow
@pytest.mark.parametrize("part", range(5))
def test_no_ok_is_wrong_in_five_hundred_calls(part):
    answered, failures = outcome(range(part, (ALL + 3) // 3 + 10, 5))
    assert failures == []
    assert answered >= ALL / 5
