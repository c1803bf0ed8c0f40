"""The compositions as data, and the loop that merges their joints."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction

import pytest

import contactbench as cb
import contactbench.splitting.composition
from cases import in_mp, pairs, random_state
from contactbench.splitting import flows
from contactbench.splitting.composition import advance, log_factor, plan, refusal
from contactbench.splitting.flows import flows_of
from contactbench.splitting.tables import ABC, COMPOSITIONS, PRINTED, STRANG
from properties import parts_applied

SCENES = [cb.SCENES[name] for name in ("particle", "rigid_body", "rigid_body_anisotropic")]
each = pytest.mark.parametrize("composition", COMPOSITIONS, ids=lambda c: c.name)
each_on_its_scenes = pairs(
    COMPOSITIONS,
    SCENES,
    lambda composition, scene: refusal(composition, scene) is None,
    ("composition", "scene"),
)


@each
def test_every_part_of_the_hamiltonian_is_applied_for_one_whole_step(composition):
    assert parts_applied(composition) == {"kick": 1, "drift": 1, "damp": 1}


@pytest.mark.parametrize("composition", [c for c in COMPOSITIONS if not c.processor], ids=lambda c: c.name)
def test_the_factor_of_three_steps_is_the_product_of_each(composition):
    """Under a damping that follows s, which every flow moves."""
    scene = cb.SCENES["quadratic_damping"]
    x = random_state(scene, 3)
    whole, parts = log_factor(composition, scene, x, 0.25, 3, math), 0.0
    for _ in range(3):
        parts += log_factor(composition, scene, x, 0.25, 1, math)
        x = advance(composition, scene, x, 0.25, 1, math)
    assert whole == pytest.approx(parts, rel=1e-12)


def test_the_printed_scheme_is_not_palindromic_and_what_it_means_is():
    assert not PRINTED.palindromic
    assert ABC.palindromic
    assert STRANG.palindromic
    assert [name for name, _ in PRINTED.stages] == ["kick", "damp", "drift", "kick"]


@each_on_its_scenes
def test_merging_joints_changes_nothing(composition, scene, mp50):
    """n steps in one run equal n runs of one step, between the halves of the processor, to 45 digits."""
    exact, x = in_mp(scene, random_state(scene, 1))
    h, kernel = mp50.mpf("0.2"), replace(composition, processor=())
    before = replace(kernel, stages=composition.processor)
    after = replace(kernel, stages=composition.processor[::-1])
    together, apart = advance(composition, exact, x, h, 5, mp50), x
    for one in (before, *[kernel] * 5, after):
        if one.stages:
            apart = advance(one, exact, apart, h, 1, mp50)
    for a, b in zip(scene.pack(together), scene.pack(apart), strict=True):
        assert abs(a - b) < mp50.mpf(10) ** -45


@each_on_its_scenes
def test_counts_are_the_calls_really_made(composition, scene, monkeypatch):
    calls = [0]
    if isinstance(scene, cb.Mechanical):
        kind, gradient = "gradient", scene.gradient

        def counted(q, **parameters):
            calls[0] += 1
            return gradient(q, **parameters)

        probe = scene._replaced(gradient=counted)
        advance(composition, probe, random_state(scene), 0.1, 7, math)
        assert plan(composition, scene).count(flows_of(scene), (kind,), 7) == calls[0]
    else:
        turned = flows.rotation

        def counting(*arguments):
            calls[0] += 1
            return turned(*arguments)

        def counting_free(scene, x, *arguments):
            calls[0] += flows.MOMENTUM_COST if x.R is None else flows.FREE_COST
            return flows.free(scene, x, *arguments)

        for module in (flows, contactbench.splitting.composition):
            monkeypatch.setattr(module, "rotation", counting)
        for table in (flows.BODY, flows.ISOTROPIC):
            monkeypatch.setitem(table, "free", table["free"]._replace(apply=counting_free))
        for carry, kinds in ((None, ("rotation", "attitude")), ((), ("rotation",))):
            calls[0] = 0
            advance(composition, scene, random_state(scene, carry=carry), 0.1, 7, math)
            assert plan(composition, scene).count(flows_of(scene), kinds, 7) == calls[0]
            if composition.name in cb.METHODS:
                assert cb.METHODS[composition.name].counts(scene, 7, carry) == calls[0]


def test_strang_costs_one_gradient_a_step():
    scene = cb.SCENES["particle"]
    assert plan(STRANG, scene).count(flows_of(scene), ("gradient",), 1000) == 1001


@pytest.mark.parametrize("composition", [PRINTED, ABC, STRANG], ids=lambda c: c.name)
def test_without_damping_each_is_velocity_verlet_bit_for_bit(composition):
    """Plain velocity Verlet, written out independently, on floats."""
    scene = cb.SCENES["particle"].with_(gamma=0.0)
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


def test_coefficients_are_exact_numbers():
    assert all(isinstance(c, Fraction) for composition in COMPOSITIONS for _, c in composition.run(1))
