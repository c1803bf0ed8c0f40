"""Rows of the cost of a derivative: its truth, the setting that reaches an error, and what a run taken back is off."""

import numpy as np
import pytest

import contactbench as cb
from contactbench.results.tables import GRADIENTS, REVERSIBILITY
from contactbench.study import gradient, reversibility


def test_the_truth_is_the_derivative_of_the_loss_by_differences():
    def loss(gamma, coupling, *y):
        scene = cb.SCENES["particle"].with_(gamma=gamma, coupling=coupling, q=y[:2], p=y[2:])
        q = cb.solve(scene, "scipy-dop853", rtol=1e-13, save_at=[3.0], carry=()).q[-1]
        return np.sum((q - datum) ** 2) / 2

    x, datum = gradient.arguments("particle")
    differences = [(loss(*(x + e)) - loss(*(x - e))) / 2e-4 for e in 1e-4 * np.eye(len(x))]
    np.testing.assert_allclose(gradient.truth("particle", 3.0), differences, rtol=0, atol=1e-7)


def test_a_row_has_the_coarsest_setting_with_the_error_asked_for(monkeypatch):
    monkeypatch.setattr(gradient, "ERRORS", (1e-3,))
    cell = ("particle", "contact-strang", gradient.FORWARD, 3.0, 1e-3)
    row = gradient.errors(cell)
    assert set(row) <= {*GRADIENTS.columns}
    assert 5e-4 < row["gradient_error"] <= 1e-3  # of order two, at steps a twelfth apart
    assert row["value"] == pytest.approx(3.0 / row["steps"])
    assert row["memory_kB"] > 0
    assert gradient.call(cell, row["value"])[1].warm_up() > 0


@pytest.mark.parametrize(("rate", "force", "least", "most"), [(0, 0.3, 1e-13, 1e-10), (1, 0.0, 1e-11, 1e-7)])
@pytest.mark.quick(rate=1)
def test_round_off_of_a_run_taken_back_grows_as_its_motion_does(rate, force, least, most):
    """γT = 20: about e^{γT/2} ε = 5e-12 where a force keeps an oscillation up, e^{γT} ε = 1e-7 at most overdamped."""
    row = reversibility.taken_back(*reversibility.RATES[rate], force, 20)
    assert set(row) <= {*REVERSIBILITY.columns}
    assert least < row["start_error"] < most
    assert row["gradient_error"] < row["start_error"]
