"""The compositions as data, the loop that merges their joints, and the subflows they are made of."""

import math
from dataclasses import replace

import numpy as np
import pytest
from mpmath import mp

import contactbench as cb
import contactbench.splitting.composition
from cases import in_mp, pairs, random_state
from contactbench.scene import rigid_body
from contactbench.scene.flow import damped_time
from contactbench.splitting.composition import advance, plan, refusal
from contactbench.splitting.tables import COMPOSITIONS
from contactbench.xla import jax, jnp
from properties import flowed

PARTICLE, *BODIES = (cb.SCENES[name] for name in ("particle", "rigid_body", "rigid_body_anisotropic"))


def on_scenes(scenes):
    return pairs(COMPOSITIONS, scenes, lambda c, scene: refusal(c, scene) is None, ("composition", "scene"))


@on_scenes([PARTICLE, *BODIES])
def test_merging_joints_changes_nothing(composition, scene, mp50):
    """n steps in one run equal n runs of one step, between the halves of the processor, to 45 digits."""
    exact, x = in_mp(scene, random_state(scene, 1))
    h, kernel = mp50.mpf("0.2"), replace(composition, processor=())
    processor = composition.processor
    halves = [replace(kernel, stages=stages) for stages in (processor, processor[::-1])]
    together, apart = advance(composition, exact, x, h, 5, mp50), x
    for one in (halves[0], *[kernel] * 5, halves[1]):
        apart = advance(one, exact, apart, h, 1, mp50) if one.stages else apart
    for a, b in zip(scene.pack(together), scene.pack(apart), strict=True):
        assert abs(a - b) < mp50.mpf(10) ** -45


@on_scenes(BODIES)
@pytest.mark.parametrize(("carry", "kinds"), [(None, ("rotation", "attitude")), ((), ("rotation",))])
def test_counts_are_the_rotations_really_computed(composition, scene, carry, kinds, monkeypatch):
    calls, turned = [], rigid_body.rotation

    def rotation(*arguments):
        calls.append(1)
        return turned(*arguments)

    def free(scene, x, *arguments):
        calls.append(rigid_body.MOMENTUM_COST if x.R is None else rigid_body.FREE_COST)
        return rigid_body.free(scene, x, *arguments)

    for module in (rigid_body, contactbench.splitting.composition):
        monkeypatch.setattr(module, "rotation", rotation)
    for table in (rigid_body.BODY, rigid_body.ISOTROPIC):
        monkeypatch.setitem(table, "free", table["free"]._replace(apply=free))
    advance(composition, scene, random_state(scene, carry=carry), 0.1, 7, math)
    begin, each, back = plan(composition, scene).costs(scene.flows, kinds)
    assert begin + 7 * each + back == sum(calls)


# -- kinetic energy and Γ = γs + ½κs² together -----------------------------------------------------
#: how often rounding errors of one unit occur in the flow, at most: each is amplified by the condition below
UNITS = 12


def merged_flow(scene, y, h, xp):
    """The packed flow of a packed state (q, p, s)."""
    return flowed(scene, "drift_damp", scene.unpack(list(y), ("s",)), h, xp)


def line(**numbers):
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
    for numbers, h in random_flows(800, 41):
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
    assert 16 < ended < 400


@pytest.mark.parametrize("kappa", [0.8, -0.8])
def test_merged_flow_has_a_derivative_where_the_path_is_straight(kappa):
    """jit and jvp, no nan at T = 0; against differences of the closed form at 50 digits."""
    scene = line(kappa=kappa, gamma=0.2, s=0.4)
    derivative = jax.jit(jax.jacfwd(lambda y: jnp.stack(merged_flow(scene, y, 0.5, jnp))))
    for p in (0.0, 1e-170, 1e-9, 0.7):
        own = scene.with_(p=(p,))
        slope = derivative(jnp.array(own.pack(own.initial(("s",)))))
        with mp.workdps(50):
            exact, x = in_mp(own, own.initial(("s",)))
            half, delta, y = mp.mpf("0.5"), mp.mpf(10) ** -20, exact.pack(x)
            for i in range(3):
                moved = ([c + d * (i == j) for j, c in enumerate(y)] for d in (delta, -delta))
                ahead, behind = (merged_flow(exact, each, half, mp) for each in moved)
                truth = [float((a - b) / (2 * delta)) for a, b in zip(ahead, behind, strict=True)]
                np.testing.assert_allclose(slope[:, i], truth, rtol=1e-14, atol=1e-15)
