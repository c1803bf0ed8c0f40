"""The compositions as data, and the loop that merges their joints."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

import contactbench as cb
import contactbench.splitting.composition
from cases import in_mp, pairs, random_state
from contactbench.splitting import flows
from contactbench.splitting.composition import advance, plan, refusal
from contactbench.splitting.flows import flows_of
from contactbench.splitting.tables import ABC, COMPOSITIONS, PRINTED, STRANG
from properties import consistent

PARTICLE, *BODIES = (cb.SCENES[name] for name in ("particle", "rigid_body", "rigid_body_anisotropic"))


def on_scenes(scenes):
    return pairs(COMPOSITIONS, scenes, lambda c, scene: refusal(c, scene) is None, ("composition", "scene"))


@pytest.mark.parametrize("composition", COMPOSITIONS, ids=lambda c: c.name)
def test_every_part_of_the_hamiltonian_is_applied_for_one_whole_step(composition):
    assert consistent(composition)


def test_the_printed_scheme_is_not_palindromic_and_its_palindromes_are():
    assert [c.palindromic for c in (PRINTED, ABC, STRANG)] == [False, True, True]
    assert [name for name, _ in PRINTED.stages] == ["kick", "damp", "drift", "kick"]


@on_scenes([PARTICLE, *BODIES])
def test_merging_joints_changes_nothing(composition, scene, mp50):
    """n steps in one run equal n runs of one step, between the halves of the processor, to 45 digits."""
    exact, x = in_mp(scene, random_state(scene, 1))
    h, kernel = mp50.mpf("0.2"), replace(composition, processor=())
    halves = [
        replace(kernel, stages=stages) for stages in (composition.processor, composition.processor[::-1])
    ]
    together, apart = advance(composition, exact, x, h, 5, mp50), x
    for one in (halves[0], *[kernel] * 5, halves[1]):
        apart = advance(one, exact, apart, h, 1, mp50) if one.stages else apart
    for a, b in zip(scene.pack(together), scene.pack(apart), strict=True):
        assert abs(a - b) < mp50.mpf(10) ** -45


@pytest.mark.parametrize("composition", COMPOSITIONS, ids=lambda c: c.name)
def test_counts_are_the_gradients_really_computed(composition):
    calls = []
    probe = PARTICLE._replaced(gradient=lambda q, **given: calls.append(q) or PARTICLE.gradient(q, **given))
    advance(composition, probe, random_state(PARTICLE), 0.1, 7, math)
    assert plan(composition, PARTICLE).count(flows_of(PARTICLE), ("gradient",), 7) == len(calls)


@on_scenes(BODIES)
@pytest.mark.parametrize(("carry", "kinds"), [(None, ("rotation", "attitude")), ((), ("rotation",))])
def test_counts_are_the_rotations_really_computed(composition, scene, carry, kinds, monkeypatch):
    calls, turned = [], flows.rotation

    def rotation(*arguments):
        calls.append(1)
        return turned(*arguments)

    def free(scene, x, *arguments):
        calls.append(flows.MOMENTUM_COST if x.R is None else flows.FREE_COST)
        return flows.free(scene, x, *arguments)

    for module in (flows, contactbench.splitting.composition):
        monkeypatch.setattr(module, "rotation", rotation)
    for table in (flows.BODY, flows.ISOTROPIC):
        monkeypatch.setitem(table, "free", table["free"]._replace(apply=free))
    advance(composition, scene, random_state(scene, carry=carry), 0.1, 7, math)
    assert plan(composition, scene).count(flows_of(scene), kinds, 7) == sum(calls)


def test_strang_costs_one_gradient_a_step():
    assert plan(STRANG, PARTICLE).count(flows_of(PARTICLE), ("gradient",), 1000) == 1001


@pytest.mark.parametrize("composition", [PRINTED, ABC, STRANG], ids=lambda c: c.name)
def test_without_damping_each_is_velocity_verlet_bit_for_bit(composition):
    """Plain velocity Verlet, written out independently, on floats."""
    scene = PARTICLE.with_(gamma=0.0)
    (q1, q2), (p1, p2) = scene.q, scene.p
    h, c = 0.1, scene.parameters["coupling"]
    half = h / 2
    x = scene.initial(())
    for _ in range(200):
        p1, p2 = p1 - half * (q1 + 2 * c * q1 * q2), p2 - half * (q2 + c * q1 * q1)
        if composition is ABC:  # two half drifts round twice
            q1, q2 = q1 + half * p1 + half * p1, q2 + half * p2 + half * p2
        else:
            q1, q2 = q1 + h * p1, q2 + h * p2
        p1, p2 = p1 - half * (q1 + 2 * c * q1 * q2), p2 - half * (q2 + c * q1 * q1)
        x = advance(composition, scene, x, h, 1, math)
        assert (*x.q, *x.p) == (q1, q2, p1, p2)
