"""What implicit steps conserve they conserve to round-off, and a step that is too long has no result."""

from __future__ import annotations

import numpy as np
import pytest
from mpmath import mp

import contactbench as cb
from contactbench.methods.implicit import gauss_tableau

GAUSS = {"gauss4": 2, "gauss6": 3}
CENTRAL = cb.SCENES["central"]


@pytest.mark.parametrize("stages", GAUSS.values())
def test_gauss_tableaus_are_collocation_of_the_highest_order_and_symplectic(stages, mp50):
    A, b = gauss_tableau(stages, mp)
    c, s = [mp.fsum(row) for row in A], range(stages)
    off = [mp.fsum(b[i] * c[i] ** k for i in s) - mp.mpf(1) / (k + 1) for k in range(2 * stages)]
    for k in s:
        off += [mp.fsum(A[i][j] * c[j] ** k for j in s) - c[i] ** (k + 1) / (k + 1) for i in s]
    off += [b[i] * A[i][j] + b[j] * A[j][i] - b[i] * b[j] for i in s for j in s]
    assert max(map(abs, off)) < mp.mpf(10) ** -48


@pytest.mark.parametrize("name", GAUSS)
def test_gauss_keeps_quadratic_invariants_and_is_symplectic_without_damping(name):
    still = CENTRAL.with_(gamma=0.0, t_end=200.0)
    solution = cb.solve(still, name, step=0.2, save_at=np.linspace(20, 200, 10))
    J = solution.q[:, 0] * solution.p[:, 1] - solution.q[:, 1] * solution.p[:, 0]
    assert np.ptp(J) < 1e-13  # measured: 2e-15
    run = cb.prepare(still, name, step=0.2, save_at=[2.0], carry=())
    M, omega = run.sensitivity(run.start)[0], np.kron([[0, 1], [-1, 0]], np.eye(2))
    np.testing.assert_allclose(M.T @ omega @ M, omega, atol=1e-13)
    turned = cb.solve("rigid_body", name, step=0.2, save_at=[20.0])
    R = turned.R[-1]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-13)


@pytest.mark.parametrize(("gamma", "step"), [(0.0, 0.1), (0.0, 0.4), (0.05, 0.4)])
def test_the_discrete_gradient_never_gains_energy(gamma, step):
    """At steps at which its phase is far off; without damping the energy stays as it is."""
    scene = CENTRAL.with_(gamma=gamma, t_end=400.0)
    solution = cb.solve(scene, "discrete-gradient", step=step)
    x = scene.unpack(solution.y.T, solution.carry)
    energy = scene.kinetic(x.p) + scene.V(x.q)
    assert solution.ok
    rises, round_off = np.diff(energy).max(), 1e-12 * energy[0]
    assert rises < round_off
    assert gamma or np.ptp(energy) < 10 * round_off


@pytest.mark.parametrize("name", [*GAUSS, "discrete-gradient"])
@pytest.mark.parametrize("engine", ["numba", "jax"])
def test_members_of_an_ensemble_stop_iterating_one_by_one(name, engine):
    q = (np.linspace(0.2, 1.4, 11), np.linspace(0.6, -0.5, 11))
    scene = CENTRAL.with_(t_end=5.0)
    found = cb.ensemble(scene, name, {"q": q}, step=0.1, engine=engine)
    for k in (0, 5, 10):
        alone = cb.prepare(scene, name, step=0.1, save_at=[5.0])(q=(q[0][k], q[1][k]))
        np.testing.assert_allclose([c[k] for c in found.final.q], alone.q[-1], rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", [*GAUSS, "discrete-gradient"])
def test_a_step_that_does_not_converge_ends_the_run(name):
    stiff = cb.SCENES["oscillator"].with_(omega=100.0, t_end=10.0)
    for engine in ("numba", "python"):
        assert cb.solve(stiff, name, step=0.5, engine=engine).status is cb.Status.diverged


@pytest.mark.parametrize("name", [*GAUSS, "discrete-gradient"])
def test_pilots_and_saved_times_are_counted_truly(name):
    whole = cb.solve("particle", name, step=0.1, save_at=[20.0]).counts
    parts = cb.solve("particle", name, step=0.1, save_at=[5.0, 10.0, 20.0]).counts
    assert abs(parts.evaluations - whole.evaluations) < 0.02 * whole.evaluations
    chosen = cb.solve("particle", name, rtol=1e-2, save_at=[20.0])
    alone = cb.solve("particle", name, step=chosen.step, save_at=[20.0])
    assert alone.counts.evaluations < chosen.counts.evaluations < 6 * alone.counts.evaluations
