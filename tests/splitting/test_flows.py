"""Each subflow against its own equations, the contact form, and itself at fifty digits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mpmath import mp

import contactbench as cb
import properties
from cases import CONTACT_SCENES, USER, in_mp, random_state
from contactbench.splitting.flows import damped_time, flows_of
from contactbench.xla import jax, jnp

DAMPINGS = [
    USER.with_(name="undamped", gamma=0.0),
    USER.with_(name="quadratic damping", gamma=0.0, kappa=0.6),
    USER.with_(name="both dampings", kappa=0.6),
    USER.with_(name="negative kappa", kappa=-0.6),
    USER.with_(name="antidamped", gamma=-0.4),
]


def flowed(scene, name, x, h, xp):
    flow = flows_of(scene)[name]
    return flow.apply(scene, x, flow.constants(scene, h, xp), xp)


@pytest.mark.parametrize("scene", DAMPINGS, ids=lambda scene: scene.name)
def test_every_subflow_solves_its_own_equations(scene, mp50):
    assert properties.mechanical_flows_solve_their_equations([scene])


@pytest.mark.parametrize("scene", [*CONTACT_SCENES, *DAMPINGS[1:]], ids=lambda scene: scene.name)
def test_every_subflow_is_a_conformal_contact_map(scene):
    """Φ*η = c η, with c = e^{−γh} for the flows that damp and 1 for the others (κ: c depends on s)."""
    x = random_state(scene, 10)
    start, basis = jnp.array(scene.pack(x)), scene.tangents(x)
    form = np.array([scene.contact_form(x, v) for v in basis], dtype=float)

    def unpack(y):
        return scene.unpack(list(y), scene.optional)

    for name, flow in flows_of(scene).items():

        def packed_flow(y, name=name):
            return jnp.stack(scene.pack(flowed(scene, name, unpack(y), 0.3, jnp)))

        pulled = []
        for v in basis:
            y, slope = jax.jvp(packed_flow, (start,), (jnp.array(scene.pack(v)),))
            pulled.append(float(scene.contact_form(unpack(y), unpack(slope))))
        factor = pulled[-1]  # η(∂_s) = 1
        assert factor == pytest.approx(math.exp(flow.log_factor(scene, x, 0.3, math)), rel=1e-14)
        if "damp" not in name:
            assert abs(factor - 1) < 1e-15
        elif not getattr(scene, "nonlinear_damping", False):
            assert abs(factor - math.exp(-scene.conformal_rate * 0.3)) < 1e-15
        np.testing.assert_allclose(pulled, factor * form, rtol=0, atol=2e-14, err_msg=name)


# -- kinetic energy and Γ = γs + ½κs² together -----------------------------------------------------
#: how often rounding errors of one unit occur in the flow, at most: each is amplified by the condition below
UNITS = 12


def merged_flow(scene, y, h, xp):
    """The packed flow of a packed state (q, p, s)."""
    return scene.pack(flowed(scene, "drift_damp", scene.unpack(list(y), ("s",)), h, xp))


def line(**numbers):
    """A free particle on a line."""
    given = {"q": (0.3,), "p": (0.5,), "t_end": 1.0} | numbers
    return cb.Mechanical(name="line", potential=lambda q: 0 * q[0], gradient=lambda q: (0 * q[0],), **given)


def random_flows(n, seed):
    """Numbers, states and steps over many orders of magnitude: κ, T and γ down to zero, all signs."""
    rng = np.random.default_rng(seed)

    def spread(low, high):
        return float(rng.choice([-1, 1]) * 10.0 ** rng.uniform(low, high))

    for _ in range(n):
        zero = rng.random(3) < 0.1
        numbers = {"kappa": spread(-1 if rng.random() < 0.5 else -14, 1.5), "mass": abs(spread(-1, 1))}
        numbers["gamma"] = 0.0 if zero[0] else spread(-12, 0.5)
        numbers["q"] = (spread(-1, 1),)
        numbers["p"] = (0.0 if zero[1] else spread(-12, 1.5),)
        numbers["s"] = 0.0 if zero[2] else spread(-3, 1.5)
        yield numbers, spread(-2, 0.5)


def test_merged_flow_is_that_of_fifty_digits_to_round_off_over_random_states(mp50):
    """Within UNITS roundings, each amplified by (‖(1, ks)‖² + b²)/y: what data of 16 digits leave near blow-up."""
    worst, ended = 0.0, 0
    for numbers, h in random_flows(3_000, 41):
        scene = line(**numbers)
        mine = merged_flow(scene, scene.pack(scene.initial(("s",))), h, math)
        exact, x = in_mp(scene, scene.initial(("s",)))
        truth = merged_flow(exact, exact.pack(x), mp50.mpf(repr(h)), mp50)
        if not all(map(mp50.isfinite, truth)):
            ended += 1
            assert not np.isfinite(mine).all()
            continue
        phi = damped_time(scene.gamma, h, math)
        k, T = scene.kappa * phi / 2, scene.kinetic(scene.p)
        square, a = abs(k * phi * T), 1 + k * scene.s
        y = abs(a * a + math.copysign(square, k * phi))
        growth = ((1 + abs(k * scene.s)) ** 2 + square) / y
        sizes = (
            abs(scene.q[0]) + abs(float(truth[0])) + abs(phi * scene.p[0] / scene.mass) * growth,
            abs(float(truth[1])) * growth,
            (abs(a * scene.s) + abs(phi * T)) * math.exp(-scene.gamma * h) / y * growth,
        )
        for one, other, size in zip(mine, truth, sizes, strict=True):
            worst = max(worst, float(abs(one - other)) / (size * 2.0**-53 + 1e-300))
    assert worst < UNITS
    assert 60 < ended < 1500


@pytest.mark.parametrize("kappa", [0.8, -0.8])
@pytest.mark.parametrize("p", [0.0, 1e-170, 1e-9, 0.7])
def test_merged_flow_has_a_derivative_where_the_path_is_straight(kappa, p):
    """jit and jvp, no nan at T = 0; against differences of the closed form at 50 digits."""
    scene = line(kappa=kappa, gamma=0.2, p=(p,), s=0.4)
    start = scene.pack(scene.initial(("s",)))
    slope = jax.jit(jax.jacfwd(lambda y: jnp.stack(merged_flow(scene, y, 0.5, jnp))))(jnp.array(start))
    with mp.workdps(50):
        exact, x = in_mp(scene, scene.initial(("s",)))
        half, delta = mp.mpf("0.5"), mp.mpf(10) ** -20
        for i in range(3):
            sides = [
                merged_flow(exact, [c + d * (i == j) for j, c in enumerate(exact.pack(x))], half, mp)
                for d in (delta, -delta)
            ]
            truth = [float((a - b) / (2 * delta)) for a, b in zip(*sides, strict=True)]
            np.testing.assert_allclose(slope[:, i], truth, rtol=1e-14, atol=1e-15)
