"""The discrete Herglotz principles, and the conformal factor every contact method claims."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

import contactbench as cb
from cases import USER, by_name, in_mp, random_state
from contactbench.scene import dot

FIXED = [method for method in cb.METHODS.values() if method.control == "step"]
HERGLOTZ = [cb.METHODS["herglotz1"], cb.METHODS["herglotz2"]]
each = pytest.mark.parametrize("method", HERGLOTZ, ids=lambda m: m.name)
SCENES = [cb.SCENES["particle"].with_(mass=1.7), cb.SCENES["oscillator"].with_(gamma=2.0), USER]


def lagrangian(name, scene, h, q0, q1, s0, s1):
    """The two discrete Lagrangians, written as in their definitions."""
    v = [(b - a) / h for a, b in zip(q0, q1, strict=True)]
    kinetic = scene.mass * dot(v, v) / 2
    if name == "herglotz1":
        return kinetic - scene.V(q0) - scene.gamma * s0
    return kinetic - (scene.V(q0) + scene.V(q1)) / 2 - scene.gamma * (s0 + s1) / 2


@each
@by_name(SCENES)
def test_steps_satisfy_the_discrete_herglotz_principle(method, scene, mp50):
    """s by its recursion and q by the discrete contact Euler–Lagrange equation, from L alone.

    (1 + h ∂L_k/∂s_k) D₂L_{k−1} / (1 − h ∂L_{k−1}/∂s_k) + D₁L_k = 0, derivatives by central
    differences; neither p nor any formula of the implementation enters.
    """
    exact, x = in_mp(scene, random_state(scene, 21))
    h, delta = mp50.mpf("0.13"), mp50.mpf(10) ** -15
    path = [x]
    for _ in range(2):
        path.append(method.step(exact, path[-1], h, mp50))
    L = lambda *a: lagrangian(method.name, exact, h, *a)  # noqa: E731

    def partial(arguments, which, i=None):
        def at(d):
            moved, own = list(arguments), arguments[which]
            moved[which] = own + d if i is None else tuple(c + d * (k == i) for k, c in enumerate(own))
            return L(*moved)

        return (at(delta) - at(-delta)) / (2 * delta)

    (a, b, c) = path
    first, second = (a.q, b.q, a.s, b.s), (b.q, c.q, b.s, c.s)
    for before, after, arguments in ((a, b, first), (b, c, second)):
        assert abs(after.s - before.s - h * L(*arguments)) < mp50.mpf(10) ** -45
    weight = (1 + h * partial(second, 2)) / (1 - h * partial(first, 3))
    for i in range(len(x.q)):
        equation = weight * partial(first, 1, i) + partial(second, 0, i)
        assert abs(equation) < mp50.mpf(10) ** -27  # differences: 10⁻³⁰ truncation, 10⁻³⁵ cancellation


@pytest.mark.parametrize(("name", "order"), [("herglotz1", 1), ("herglotz2", 2)])
def test_contact_drift_sees_the_factor_and_distribution_drift_does_not(name, order):
    """σⁿ against e^{−γt}: an error of order h, or h², in the factor alone."""
    scene = cb.SCENES["particle"]
    solutions = [cb.solve(scene, name, step=h, save_at=[5.0, 10.0]) for h in (0.1, 0.05, 0.025, 0.0125)]
    drifts = [cb.LAWS["contact_drift"](s) for s in solutions]
    assert drifts[0] > 1e-6  # γt (γh)²/12 = 8.3e-6 for the second method
    for coarse, fine in pairwise(drifts):
        assert math.log2(coarse / fine) == pytest.approx(order, abs=0.05)
    steps = 100
    expected = cb.METHODS[name].conformal_factor(scene, 0.1) ** steps / math.exp(-scene.gamma * 10.0) - 1
    assert drifts[0] == pytest.approx(abs(expected), rel=1e-9)
    # measured 3e-15; the tangents grow to about 30 on the way
    assert max(cb.LAWS["distribution_drift"](s) for s in solutions) < 1e-13


@each
def test_a_damping_it_is_not_derived_for_is_refused(method):
    solution = cb.solve(cb.SCENES["particle"].with_(kappa=0.5), method.name, step=0.1)
    assert solution.status is cb.Status.unsupported
    assert np.isnan(solution.y).all()
