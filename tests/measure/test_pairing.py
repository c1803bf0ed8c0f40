"""Singular values of the tangent map come in pairs: for contact methods at any step, for others at none."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import contactbench as cb
from cases import CONTACT_SCENES, saved
from cases import pairs as of_methods
from contactbench.measure.laws import row
from contactbench.measure.pullback import pairs
from contactbench.measure.round_off import round_off_bound
from contactbench.methods.contact import contact_method
from contactbench.solution import SAFETY, Differential
from contactbench.splitting.tables import COMPOSITIONS

LAW = cb.LAWS["pairing_drift"]
MECHANICAL = [scene for scene in CONTACT_SCENES if isinstance(scene, cb.Mechanical)]
PARTICLE = cb.SCENES["particle"]


def differential(*estimates):
    """A derivative by as many estimates, at one saved time."""
    return Differential("planted", np.zeros((1, len(estimates[0]))), np.array(estimates)[:, None])


def test_pairs_are_the_products_of_the_largest_and_the_smallest_and_so_on_inwards():
    found = pairs(differential(np.diag([2.0, 7.0, 3.0, 5.0, 99.0])), 2)
    np.testing.assert_allclose(found.values, [[7 * 2, 5 * 3]], rtol=1e-15)
    np.testing.assert_allclose(found.terms, [7 * np.hypot(7, 5)], rtol=1e-15)
    assert found.uncertainty is None


def test_of_several_estimates_the_two_that_agree_best_give_the_value_and_its_error_bar():
    found = pairs(differential(*(np.diag([2.0, b, 1.0]) for b in (1.3, 1.01, 1.0, 1.1))), 1)
    np.testing.assert_allclose(found.values, [[2.02]], rtol=1e-15)
    np.testing.assert_allclose(found.uncertainty, [SAFETY * 0.02], rtol=1e-12)


@of_methods([m for m in cb.METHODS.values() if m.contact and m.control == "step"], MECHANICAL)
@pytest.mark.quick(scene="particle")
def test_contact_methods_pair_to_round_off_at_a_coarse_step(method, scene):
    scene = scene.with_(t_end=min(scene.t_end, 20.0))
    solution = cb.solve(
        scene, method.name, step=0.02 if scene.name == "kepler_drag" else 0.2, save_at=saved(scene)
    )
    columns = row(solution)
    bound = max(1e-13, round_off_bound(columns["map_growth"], solution.counts.evaluations))
    assert columns["pairing_drift"] <= bound


@pytest.mark.parametrize("method", ["rk4", "herglotz1", "herglotz2"])
def test_other_steps_pair_to_their_order_only(method):
    """The factor of a Herglotz step is another than e^{−γh}."""
    found = [LAW(cb.solve(PARTICLE, method, step=h, save_at=saved(PARTICLE))) for h in (0.05, 0.025)]
    assert found[0] > 1e-7
    assert np.log2(found[0] / found[1]) == pytest.approx(cb.METHODS[method].order, abs=0.2)


def test_a_changed_coefficient_breaks_the_pairs_by_as_much():
    """Strang with 1 + 10⁻⁶ times the damped drift: the factor is e^{−γt(1 + 10⁻⁶)}."""
    strang = next(c for c in COMPOSITIONS if c.name == "contact-strang")
    change = {"kick": Fraction(1), "drift_damp": 1 + Fraction(1, 10**6)}
    stages = tuple((name, c * change[name]) for name, c in strang.stages)
    mutant = contact_method(replace(strang, name="mutant", stages=stages))
    cb.METHODS.add(mutant)
    try:
        drift = LAW(cb.solve(PARTICLE, "mutant", step=0.1, save_at=saved(PARTICLE)))
    finally:
        del cb.METHODS["mutant"]
    assert drift == pytest.approx(1e-6 * PARTICLE.gamma * PARTICLE.t_end, rel=1e-2)
