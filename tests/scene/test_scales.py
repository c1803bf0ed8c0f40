"""An error is in parts of each component's own size: units of one of them change nothing."""

import numpy as np
import pytest

import contactbench as cb
from contactbench.measure.laws import errors_of
from contactbench.methods.base import METHODS
from contactbench.runs.search import Question, Search
from contactbench.runs.settings import ENDS, times
from contactbench.scene.base import Elapsed
from contactbench.scene.scales import FAINT, errors, sizes_of
from contactbench.truth.two_solvers import doubles

UNITS = (1.0, 1e3)
#: methods whose steps follow roundings in no way; by how much others' errors and counts change
EXACTLY, ALIKE = ("rk4", "rk8-7", "scipy-dop853"), 0.05
#: a turn of seven: an iteration counts what is at rest in parts of the whole state
A_TURN = 1 / 6


def two_masses(unit=1.0, **given):
    """A light mass on a heavy one, its coordinate in a unit of its own."""
    return cb.Mechanical(
        name="two_masses",
        potential=lambda q, unit: 1e5 * q[0] * q[0] + 50 * (q[1] / unit - q[0]) * (q[1] / unit - q[0]),
        parameters={"unit": unit},
        q=(0.01, 0.0),
        p=(0.0, 0.0),
        mass=(1000.0, 0.05 / unit**2),
        gamma=0.1,
        t_end=2.0,
        **given,
    )


def on_metric(unit=1.0):
    """An angle and a length: the mass is a function of q."""
    return cb.Mechanical(
        name="bead",
        mass=lambda q, unit: ((q[1] * q[1] / unit**2, 0.0), (0.0, 1 / unit**2)),
        potential=lambda q, unit: 5 * (q[1] / unit - 1) * (q[1] / unit - 1) - cb.math.cos(q[0]) * q[1] / unit,
        parameters={"unit": unit},
        q=(0.3, 1.1 * unit),
        p=(0.0, 0.2 / unit),
        gamma=0.1,
        t_end=2.0,
    )


def equations(unit=1.0):
    """Two species and a third that is not there yet, in a unit of its own."""
    return cb.Equations(
        rhs=lambda t, y, unit: (y[1] - y[0] / 10, -y[0], unit * (y[0] * y[0] - y[2] / unit)),
        y0=(1.0, 0.0, 0.0),
        parameters={"unit": unit},
        t_end=2.0,
    )


@pytest.mark.parametrize("scene", [two_masses, on_metric, equations])
@pytest.mark.parametrize(
    "method", ["rk4", "rk8-7", "contact-gauss4", "scipy-dop853", "cvode-adams", "heyoka-taylor"]
)
def test_the_unit_of_one_component_changes_neither_errors_nor_steps(scene, method):
    if METHODS[method].refuses(scene()):
        pytest.skip("a method for other scenes")
    adaptive = METHODS[method].adaptive
    for setting in [{"rtol": 1e-6}] if adaptive else [{"step": 0.004}, {"rtol": 1e-4}]:
        runs = [cb.solve(scene(unit), method, **setting, save_at=[1.0, 2.0], carry=()) for unit in UNITS]
        assert all(run.ok for run in runs)
        one, other = (cb.LAWS["solution_error"](run) for run in runs)
        assert other == pytest.approx(one, rel=ALIKE, abs=1e-12)
        counts = [run.counts.evaluations for run in runs]
        alike = A_TURN if METHODS[method].iterates else 0.0 if method in EXACTLY else ALIKE
        assert counts == pytest.approx([counts[0]] * 2, rel=alike)


def test_the_unit_of_one_component_changes_no_setting_of_a_race():
    found = []
    for unit in UNITS:
        scene = two_masses(unit)
        search = Search(
            Question(scene, cb.reference(scene, Elapsed(times(scene, ENDS)), ()), (1e-6,), 60.0), "rk8-7"
        )
        for _ in search.turns():
            pass
        best = search.best(1e-6)
        found.append((best.setting, best.evaluations))
    assert len({*found}) == 1


def test_an_error_of_a_light_mass_is_in_parts_of_its_own_swing():
    run = cb.solve(two_masses(), "rk8-7", rtol=1e-3, save_at=np.linspace(0.1, 2.0, 20), carry=())
    true = cb.reference(run.scene, run.t, ()).y
    own = np.abs(run.y - true).max(axis=0) / np.abs(np.vstack([run.y0, true])).max(axis=0)
    assert cb.LAWS["solution_error"](run) == pytest.approx(own.max())


def test_what_hardly_moves_is_measured_against_what_the_energy_would_let_it():
    """Two springs that know nothing of one another: one swings, E = ½, the other rests."""
    scene = cb.Mechanical(
        name="uncoupled",
        potential=lambda q: q[0] * q[0] / 2 + 50 * q[1] * q[1],
        q=(0.0, 0.0),
        p=(1.0, 0.0),
        mass=(1.0, 4.0),
        t_end=5.0,
    )
    rows = np.array([[0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 0.0, 0.0]])
    assert sizes_of(scene.recorded(), rows, ()) == pytest.approx([1.0, FAINT / 10, 1.0, FAINT * 2])


def test_coordinates_of_one_mass_share_a_scale_and_momenta_another():
    scene = cb.SCENES["particle"].with_(mass=100.0)
    start = np.array([1.0, 0.5, 0.0, 0.3])
    assert sizes_of(scene, start[None], ()) == pytest.approx([np.hypot(1.0, 0.5), 0.3])
    moved = start + np.array([3e-3, 4e-3, 0.0, 0.0])
    assert errors(scene, moved[None], start[None], start, ()) == pytest.approx(5e-3 / np.hypot(1.0, 0.5))


def test_a_users_scale_rules():
    scene = two_masses(scale=(1.0, 2.0, 5.0, 10.0))
    run = cb.solve(scene, "rk8-7", rtol=1e-6, save_at=[2.0], carry=())
    assert run.run.request.atol == pytest.approx(1e-6 * np.array(scene.scale))
    gap = run.y - cb.reference(scene, [2.0], ()).y
    assert errors_of([run]) == pytest.approx((np.abs(gap) / scene.scale).max())
    for wrong in ((1.0, 2.0), (1.0, 2.0, 0.0, 1.0), 3.0):
        with pytest.raises(cb.BadInput, match="scale"):
            two_masses(scale=wrong)


@pytest.mark.parametrize("method", ["rk4", "scipy-dop853"])
@pytest.mark.parametrize("kind", ["mechanical", "body", "sphere", "free sphere", "equations"])
def test_a_motion_at_rest_has_no_error_and_warns_of_nothing(kind, method):
    scene = {
        "mechanical": cb.SCENES["oscillator"].with_(q=(0.0,), p=(0.0,)),
        "body": cb.SCENES["rigid_body"].with_(M=(0.0, 0.0, 0.0)),
        "sphere": cb.SCENES["spherical_pendulum"].with_(q=(0.0, 0.0, -1.0), p=(0.0, 0.0, 0.0)),
        "free sphere": cb.Spheres(
            potential=lambda q: 0.0 * q[0], name="free", q=(0, 0, -1), p=(0, 0, 0), t_end=1.0
        ),
        "equations": cb.Equations(rhs=lambda t, y: (-y[0],), y0=(0.0,), t_end=1.0),
    }[kind]
    with np.errstate(all="raise"):
        setting = {"rtol": 1e-6} if METHODS[method].adaptive else {"step": 0.1}
        found = cb.solve(scene.with_(t_end=1.0), method, **setting, save_at=[1.0]).laws()
    assert found.loc["solution_error", "deviation"] == 0


def test_two_solvers_agree_on_as_many_digits_in_any_unit():
    """Of a light mass, too: its digits are those of its own swing."""
    found = (doubles(two_masses(unit).recorded(), np.array([1.0, 2.0]), (), np.inf) for unit in UNITS)
    (one, digits), (other, known) = found
    assert abs(known - digits) <= 1
    assert other / [1, UNITS[1], 1, 1 / UNITS[1]] == pytest.approx(one, rel=1e-8)
