"""Rows of the ring: the energy that is left, the measured damping rate, where a ladder begins and ends."""

import pytest

import contactbench as cb
from contactbench.runs import ring
from contactbench.tables.declared import RING

GAMMA, SPAN = 1e-3, 200.0


@pytest.fixture(autouse=True)
def few(monkeypatch):
    monkeypatch.setattr(ring, "STARTS", 2)


def row(method, value, gamma=GAMMA, span=SPAN):
    made = ring.row_of(method, gamma, span, value)
    assert set(made) <= {*RING.columns}
    return made


def test_the_energy_left_is_that_of_the_scene_without_its_centre_of_mass():
    scene = ring.ring(GAMMA, SPAN)
    energy = scene.energy(scene.initial(()))
    assert ring.energy_left(*ring.starts()[0]) == pytest.approx(energy - ring.N * 0.3**2 / 2)


def test_errors_fall_with_the_step_and_so_does_that_of_the_damping_rate():
    coarse, fine = row("contact-strang", 0.2), row("contact-strang", 0.1)
    assert 2e-3 < coarse["energy_error"] < 1e-2
    assert fine["energy_error"] < coarse["energy_error"] / 2
    assert coarse["low"] <= coarse["energy_error"] <= coarse["high"]
    assert fine["floor"] < 1e-6
    assert coarse["evaluations"] == pytest.approx(5.1)  # a kick more at each of 20 saved times
    assert 0 < fine["rate_error"] < 0.05


def test_weaker_damping_costs_a_method_without_structure_its_rate_and_no_contact_method():
    rk4 = [row("rk4", 0.1, gamma, 2000.0)["rate_error"] for gamma in (1e-4, 1e-5)]
    assert rk4[1] > 5 * rk4[0] > 0.1
    assert row("contact-rkn4", 0.4, 1e-5, 2000.0)["rate_error"] < 0.02 * rk4[1]


def test_a_step_that_loses_the_motion_has_a_row_without_numbers():
    lost = row("contact-strang", 0.8)
    assert (lost["status"], "energy_error" in lost) == ("diverged", False)
    assert ring.is_lost(lost)


@pytest.mark.parametrize("name", ["contact-strang", "rk4", "cyrk-dop853"])
def test_a_ladder_begins_where_the_motion_is_not_lost_and_ends_at_the_error(name):
    method = cb.METHODS[name]
    *coarse, last = ring.rungs(method, GAMMA, SPAN, 3e-3)
    assert all(3e-3 < each["energy_error"] < ring.LOST for each in coarse)
    assert last["energy_error"] <= 3e-3


def test_long_runs_are_made_at_the_settings_around_the_error_allowed(monkeypatch):
    monkeypatch.setattr(ring, "SPAN", SPAN)
    rows = sorted(
        ring.long_rungs(cb.METHODS["contact-strang"], GAMMA, 5 * SPAN), key=lambda row: -row["setting"]
    )
    assert [each["energy_error"] <= ring.ALLOWED for each in rows] == [False] * (len(rows) - 1) + [True]


def test_who_runs_has_forces_alone_or_is_a_compiled_solver_for_what_is_not_stiff():
    names = {method.name for method in ring.methods()}
    assert names > {
        "contact-strang",
        "herglotz2",
        "rkn12",
        "rk4",
        "cyrk-dop853",
        "cvode-adams",
        "heyoka-taylor",
    }
    assert not names & {
        "rk8",
        "scipy-dop853",
        "cvode-bdf",
        "diffrax-tsit5",
        "contact-exact",
        "contact-gauss4",
    }
