"""Scenes with time: closed forms, orders, the contact form under γ(t), chaos; every method on all of them."""

from __future__ import annotations

import math

import numpy as np
import pytest

import contactbench as cb
from cases import by_name, pairs
from contactbench.measure.laws import laws_of, row
from contactbench.measure.precision import error_at, order_at
from contactbench.scene import Driven
from contactbench.scenes.driven import (
    DRIVEN,
    DUFFING,
    FORCED_OSCILLATOR,
    LANE_EMDEN,
    spherical,
    spherical_span,
)
from contactbench.splitting.flows import flows_of
from contactbench.testing import check_scene

CLOSED = [scene for scene in DRIVEN if scene.exact is not None]
STEPPED = [method for method in cb.METHODS.values() if method.control == "step"]
CONTACT = [method for method in STEPPED if method.contact]


def saved(scene):
    return scene.t_end * np.arange(1, 6) / 5


@by_name(DRIVEN)
def test_scene_keeps_the_rules_of_scenes(scene):
    check_scene(scene)


@by_name(CLOSED)
def test_closed_forms_are_taken_as_the_truth_with_all_their_fields(scene):
    found = cb.reference(scene, saved(scene))
    assert found.source == "closed form"
    assert found.digits >= 40


def test_closed_forms_are_those_of_the_textbook():
    """1 − t²/6, sin t/t, and 2(1 + 16 t²/3)^{−1/2}, a homologous image of (1 + t²/3)^{−1/2}."""
    for scene, theta in zip(
        LANE_EMDEN,
        (lambda t: 1 - t * t / 6, lambda t: np.sin(t) / t, lambda t: 2 * (1 + 16 * t * t / 3) ** -0.5),
        strict=True,
    ):
        found = cb.reference(scene, saved(scene)).y
        np.testing.assert_allclose(found[:, 0], theta(scene.t + saved(scene)), rtol=0, atol=1e-15)


@pytest.mark.parametrize(("index", "zero"), [(1.5, 3.65375374), (3.0, 6.89684862)])
def test_published_zeros_of_the_lane_emden_functions(index, zero):
    """Horedt, Astrophys. Space Sci. 126, 357 (1986): ξ₁ of n = 1.5 and n = 3, to all digits printed."""
    start = 0.01  # θ = 1 − t²/6 + n t⁴/120 − …, the next term is 10⁻¹³ there
    theta = 1 - start**2 / 6 + index * start**4 / 120
    slope = -start / 3 + index * start**3 / 30

    def emden(name, t_end):
        return Driven(
            name=name, potential=lambda q, t: abs(q[0]) ** (index + 1) / (index + 1),
            gradient=lambda q, t: (abs(q[0]) ** index,), rate=spherical, span=spherical_span,
            q=(theta,), p=(slope,), t=start, t_end=t_end,
        )  # fmt: skip

    end = zero - 1e-3 - start
    solution = cb.solve(
        emden("before_the_zero", end), "contact-rkn6", step=end / 4000, carry=(), engine="python"
    )
    q, p, t = solution.y[-1]
    # from there a straight line with the curvature −2p/t, the force being nothing at the zero
    d = -q / p
    found = t + d * (1 + d / t)
    assert found == pytest.approx(zero, abs=6e-9)


# -- order -----------------------------------------------------------------------------------------
@pytest.mark.parametrize("scene", [FORCED_OSCILLATOR, LANE_EMDEN[2]], ids=lambda s: s.name)
@pytest.mark.parametrize("method", CONTACT, ids=lambda m: m.name)
def test_order_at_fifty_digits(scene, method):
    assert order_at(method, scene, 2.0, 64) == pytest.approx(method.order, abs=0.1)


@pytest.mark.parametrize("name", ["rk4", "herglotz1", "herglotz2"])
def test_order_of_the_others(name):
    errors = [
        cb.LAWS["solution_error"](cb.solve(FORCED_OSCILLATOR, name, step=h, save_at=saved(FORCED_OSCILLATOR)))
        for h in (0.1, 0.05)
    ]
    assert math.log2(errors[0] / errors[1]) == pytest.approx(cb.METHODS[name].order, abs=0.25)


@by_name(DRIVEN)
@pytest.mark.parametrize("name", ["contact-abc", "contact-rkn4", "rk4", "herglotz2"])
def test_engines_agree(scene, name):
    numba, jax, python = (
        cb.solve(scene, name, step=0.1, engine=engine, save_at=[1.0, 2.0]).y
        for engine in ("numba", "jax", "python")
    )
    np.testing.assert_allclose(numba, python, rtol=0, atol=1e-13)
    np.testing.assert_allclose(numba, jax, rtol=0, atol=1e-13)


@pytest.mark.parametrize("scene", [FORCED_OSCILLATOR, LANE_EMDEN[1]], ids=lambda s: s.name)
@pytest.mark.parametrize(
    "name", ["scipy-dop853", "scipy-radau", "cvode-adams", "cvode-bdf", "cyrk-dop853", "heyoka-taylor"]
)
def test_solvers_with_a_tolerance_solve_them(scene, name):
    errors = [
        cb.LAWS["solution_error"](cb.solve(scene, name, rtol=rtol, save_at=saved(scene)))
        for rtol in (1e-4, 1e-8)
    ]
    assert errors[1] < min(1e-5, errors[0] / 10)


# -- contact form ----------------------------------------------------------------------------------
@pairs(CONTACT, DRIVEN)
def test_contact_methods_keep_the_contact_form_at_a_coarse_step(method, scene):
    solution = cb.solve(scene, method.name, step=0.2, save_at=saved(scene))
    columns = row(solution)
    for law in laws_of(scene):
        if law.gate.value == "structure" and "attitude" not in law.name:
            assert columns[law.name] < 1e-12, law.name


def test_the_factor_under_a_damping_that_changes_is_that_of_the_integral():
    """e^{−G} = (t₀/t)² for γ = 2/t."""
    scene = LANE_EMDEN[1]
    solution = cb.solve(scene, "contact-strang", step=0.2, save_at=saved(scene))
    expected = 2 * np.log(scene.t / (scene.t + saved(scene)))
    np.testing.assert_allclose(solution.log_factor(), expected, rtol=1e-13)
    derivative = solution.differential.value[:, :2, :2]
    np.testing.assert_allclose(np.linalg.det(derivative), np.exp(expected), rtol=1e-12)


def test_pairs_on_the_chaotic_scene_at_any_step_and_not_for_others():
    law = cb.LAWS["pairing_drift"]
    for h in (0.4, 0.1):
        assert law(cb.solve(DUFFING, "contact-rkn4", step=h, save_at=saved(DUFFING))) < 1e-12
    assert law(cb.solve(DUFFING, "rk4", step=0.1, save_at=saved(DUFFING))) > 1e-7
    assert law(cb.solve(DUFFING, "heyoka-taylor", rtol=1e-8, save_at=saved(DUFFING))) > 1e-12


def test_laws_of_h_are_not_claimed_where_time_is_in_it():
    names = {law.name for scene in DRIVEN for law in laws_of(scene)}
    assert not names & {"hamiltonian_law", "modified_hamiltonian", "momentum_law", "energy_increases"}
    assert {law.name for law in laws_of(FORCED_OSCILLATOR)} >= {
        "contact_drift",
        "pairing_drift",
        "solution_error",
    }


# -- mutants ---------------------------------------------------------------------------------------
def test_a_clock_that_lags_loses_the_order(monkeypatch):
    def lagging(scene, x, h, xp):
        return right(scene, x, h, xp)._replace(t=x.t + h[0] * (1 - 1e-3))

    table = flows_of(FORCED_OSCILLATOR)
    right = table["drift_damp"].apply
    monkeypatch.setitem(table, "drift_damp", table["drift_damp"]._replace(apply=lagging))
    coarse, fine = (error_at(cb.METHODS["contact-rkn4"], FORCED_OSCILLATOR, 2.0, n) for n in (32, 64))
    assert coarse / fine < 2


# -- bad input -------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"kappa": 0.1}, "without time"),
        ({"gamma": 0.1}, "has it in it"),
        ({"span": None}, "needs both"),
        ({"t": math.nan}, "t = nan"),
    ],
)
def test_what_does_not_fit_is_refused(changes, said):
    with pytest.raises(cb.BadInput, match=said):
        LANE_EMDEN[0].with_(**changes)


@pytest.mark.parametrize("gamma", [0.0, 2.0])
def test_the_forced_oscillator_has_its_closed_form_without_damping_and_at_critical_damping(gamma):
    scene = FORCED_OSCILLATOR.with_(gamma=gamma)
    assert cb.solve(scene, "scipy-dop853", rtol=1e-12, save_at=saved(scene)).laws().loc[
        "solution_error", "deviation"
    ] == pytest.approx(0, abs=1e-10)
