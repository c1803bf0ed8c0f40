"""Rows of what structure buys: the energy that is left, the measured damping rate."""

import pytest

import contactbench as cb
from contactbench.runs import structure
from contactbench.tables.declared import STRUCTURE_BUYS

SHORT = ("chaotic_ring", 1e-3, 200.0)


@pytest.fixture(autouse=True)
def few(monkeypatch):
    monkeypatch.setattr(structure, "STARTS", 2)


def row(method, value, case=SHORT):
    made = structure.errors((case[0], method, cb.METHODS[method].engines[0], *case[1:], value))
    assert set(made) <= {*STRUCTURE_BUYS.columns}
    return made


def test_the_energy_left_is_that_of_the_scene_without_its_centre_of_mass():
    scene = structure.ring_of(*SHORT)
    energy = scene.energy(scene.initial(()))
    assert structure.energy_left(*structure.starts()[0]) == pytest.approx(energy - structure.N * 0.3**2 / 2)


def test_errors_fall_with_the_step_and_so_does_that_of_the_damping_rate():
    coarse, fine = row("contact-strang", 0.2), row("contact-strang", 0.1)
    assert 2e-3 < coarse["energy_error"] < 1e-2
    assert fine["energy_error"] < coarse["energy_error"] / 2
    assert coarse["energy_error_least"] <= coarse["energy_error"] <= coarse["energy_error_most"]
    assert fine["floor"] < 1e-6
    assert coarse["starts"] == 2
    assert coarse["evaluations_per_time"] == pytest.approx(5.1)  # a kick more at each of 20 saved times
    assert 0 < fine["rate_error"] < 0.05


def test_weaker_damping_costs_a_method_without_structure_its_rate_and_no_contact_method():
    weak, weaker = ((SHORT[0], gamma, 2000.0) for gamma in (1e-4, 1e-5))
    rk4 = [row("rk4", 0.1, case)["rate_error"] for case in (weak, weaker)]
    assert rk4[1] > 5 * rk4[0] > 0.1
    assert row("contact-rkn4", 0.4, weaker)["rate_error"] < 0.02 * rk4[1]


def test_a_step_that_loses_the_motion_has_a_row_without_numbers():
    lost = row("contact-strang", 0.8)
    assert (lost["status"], "energy_error" in lost) == ("diverged", False)
