"""States between steps: as accurate as the steps, on one side of a break, and counted."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import contactbench as cb
from contactbench.methods.hermite import FEWER, NODES, Components, interpolate

METHODS = {
    "contact-rkn4": {"step": 0.25},
    "contact-bm6": {"step": 0.5},
    "rk8": {"step": 0.8},
    "rkn8": {"step": 0.8},
    "herglotz2": {"step": 0.05},
    "contact-gauss4": {"step": 0.25},
    "quinlan-tremaine8": {"step": 0.2},
    "rk8-7": {"rtol": 1e-7},
    "rkn8-6": {"rtol": 1e-7},
}
TIMES = np.sort(np.random.default_rng(3).uniform(0.05, 19.9, 150))


@cache
def truth(scene: str, *times: float) -> np.ndarray:
    return cb.solve(scene, "rk8-7", rtol=1e-13, save_at=times, carry=(), dense=False).y


def error(run: cb.Solution) -> float:
    true = truth(run.scene.name, *run.t)
    return float(np.abs(run.y[:, : true.shape[1]] - true).max())


@pytest.mark.parametrize("r", [2, 3])
@pytest.mark.parametrize("n", [5, 8, 20])
def test_a_polynomial_is_its_own_interpolant(n: int, r: int) -> None:
    """Its slope is that of another component, and polynomials of a lower degree have no error."""
    power = np.polynomial.Polynomial(np.random.default_rng(n).uniform(-1, 1, r * (min(n, NODES) - FEWER)))
    t = np.linspace(-1.0, 1.0, n)
    data = np.stack([(power.deriv(k) if k else power)(t) for k in range(r)], axis=1)[:, :, None]
    data = np.pad(data, [(0, 0), (0, 3 - r), (0, 1)], constant_values=np.nan)
    components = Components(np.array([r, 0.0]), np.zeros(2), np.array([0.0, 0.5]))
    saved = np.sort(np.random.default_rng(r).uniform(-0.99, 0.99, 30))
    where, y, error = interpolate(t, np.zeros(n), data, components, saved)
    assert ((t[where] <= saved) & (saved < t[where + 1])).all()
    assert y[:, 0] == pytest.approx(power(saved), abs=1e-12)
    assert y[:, 1] == pytest.approx(power.deriv()(saved) / 2, abs=1e-11)
    assert error.max() < 1e-11


def test_an_error_is_that_of_fewer_nodes() -> None:
    t = np.arange(9.0)
    data = np.stack([np.sin(2 * t), 2 * np.cos(2 * t), -4 * np.sin(2 * t)], axis=1)[:, :, None]
    components, saved = Components(np.array([3.0]), np.zeros(1), np.zeros(1)), np.array([3.3, 3.7])
    (_, y, error), (_, less, _) = (
        interpolate(t[part], np.zeros(n), data[part], components, saved)
        for n, part in ((8, slice(0, 8)), (6, slice(1, 7)))
    )
    assert error == pytest.approx(np.abs(y - less), rel=1e-6)
    assert 1e-12 < error.max() < 1e-5


def test_no_polynomial_has_nodes_of_two_pieces() -> None:
    t, piece = np.array([0.0, 1, 2, 3, 3, 4, 5, 6]), np.repeat([0.0, 1.0], 4)
    value = np.where(piece == 0, t**2, 7.0)
    data = np.stack([value, np.where(piece == 0, 2 * t, 0.0), np.where(piece == 0, 2.0, 0.0)], axis=1)
    saved = np.array([0.5, 2.9, 3.1, 5.5])
    components = Components(np.array([3.0]), np.zeros(1), np.zeros(1))
    _, y, _ = interpolate(t, piece, data[:, :, None], components, saved)
    assert y[:, 0] == pytest.approx([0.25, 2.9**2, 7.0, 7.0], rel=1e-13)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "scene", ["particle", "rigid_body", "spherical_pendulum", "forced_oscillator", "double_pendulum"]
)
def test_interpolated_states_are_as_accurate_as_steps(scene: str, method: str) -> None:
    if cb.METHODS[method].refuses(cb.SCENES[scene]):
        return
    setting = METHODS[method]
    many = cb.solve(scene, method, save_at=np.append(TIMES, 20.0), **setting)
    steps = cb.solve(scene, method, save_at=np.append(TIMES[::10], 20.0), dense=False, **setting)
    end = cb.solve(scene, method, save_at=[20.0], **setting)
    assert many.ok
    assert many.interpolated.sum() > 100
    assert not steps.interpolated.any()
    allowed = max(8 * error(steps), 4 * error(end), setting.get("rtol", 0.0), 1e-10)
    assert error(many) < allowed
    assert many.y[-1] == pytest.approx(end.y[-1], rel=1e-10, abs=1e-10)
    assert end.counts.evaluations < many.counts.evaluations < 3 * end.counts.evaluations


def test_no_polynomial_crosses_a_break() -> None:
    """A force that jumps: states next to the jump are as exact as others."""
    jump = 3.3
    scene = cb.Driven(
        name="jump",
        potential=lambda q, t: q[0] * cb.math.where(t < jump, 1.0, -2.0),
        q=(0.0,),
        p=(1.0,),
        breaks=(jump,),
        t_end=6.0,
    )
    t = np.linspace(0.05, 6.0, 300)
    run = cb.solve(scene, "rkn8", step=0.5, save_at=t)
    late = np.maximum(t - jump, 0.0)
    exact = 1.0 * t - t**2 / 2 + 1.5 * late**2
    assert run.interpolated.sum() > 200
    assert run.q[:, 0] == pytest.approx(exact, abs=1e-12)
    assert run.p[:, 0] == pytest.approx(1 - t + 3 * late, abs=1e-12)


@pytest.mark.parametrize("scene", ["rigid_body", "spherical_pendulum"])
def test_interpolated_states_are_on_the_manifold(scene: str) -> None:
    run = cb.solve(scene, "contact-bm6", step=0.5, save_at=TIMES)
    points = run.quaternion if run.quaternion is not None else run.q
    assert run.interpolated.sum() > 100
    assert np.linalg.norm(points, axis=1) == pytest.approx(1.0, abs=4e-15)


def test_structure_is_judged_at_ends_of_steps() -> None:
    run = cb.solve("particle", "contact-rkn6", step=0.5, save_at=TIMES)
    assert not run.at_steps.interpolated.any()
    assert cb.LAWS["contact_drift"].measured(run.at_steps).value < 1e-13


def test_engines_interpolate_alike() -> None:
    for method in ("contact-rkn4", "quinlan-tremaine8", "rkn8-6"):
        one, other = (
            cb.solve("particle", method, save_at=TIMES, engine=e, **METHODS[method])
            for e in ("llvm", "python")
        )
        assert other.y == pytest.approx(one.y, abs=1e-10)
        assert other.counts == one.counts


def test_steps_that_are_too_long_are_divided() -> None:
    """The error of states between steps of a length at which no polynomial follows the motion."""
    run = cb.solve("particle", "rkn12", step=4.0, save_at=TIMES)
    steps = cb.solve("particle", "rkn12", step=4.0, save_at=[4.0, 8.0, 12.0, 16.0, 20.0])
    assert error(run) < 4 * error(steps)


def test_few_saved_times_have_steps_of_their_own() -> None:
    run = cb.solve("particle", "contact-rkn6", step=0.5, save_at=[0.7, 20.0])
    assert not run.interpolated.any()
    assert run.y == pytest.approx(
        cb.solve("particle", "contact-rkn6", step=0.1, save_at=[0.7, 20.0]).y, abs=1e-6
    )


@pytest.mark.parametrize(("scene", "rtol"), [("particle", 1e-6), ("forced_oscillator", 1e-4)])
def test_every_component_between_steps_meets_the_tolerance(scene: str, rtol: float) -> None:
    """The action too, whose second derivative is not known where the potential depends on the time."""
    times = np.linspace(0.0, 20.0, 1001)
    many = cb.solve(scene, "rkn12-10", rtol=rtol, save_at=times)
    true = cb.solve(scene, "rk8-7", rtol=1e-12, save_at=times, dense=False)
    assert many.interpolated.sum() > 900
    assert np.abs(many.y - true.y).max() < rtol


@pytest.mark.parametrize(("method", "setting"), [("rk8-7", {"rtol": 1e-6}), ("rk8", {"step": 0.5})])
def test_other_data_give_the_run_of_a_scene_with_them(method: str, setting: dict[str, float]) -> None:
    """Its default atol follows their scale."""
    times = np.linspace(0.0, 20.0, 301)
    scene = cb.SCENES["oscillator"]
    run = cb.prepare(scene, method, save_at=times, **setting)(q=(3e5,))
    same = cb.solve(scene.with_(q=(3e5,)), method, save_at=times, **setting)
    assert run.interpolated.any()
    assert run.counts == same.counts
    assert np.array_equal(run.y, same.y)


@pytest.mark.parametrize("count", [201, 1001])
def test_a_step_that_pilots_choose_is_not_shortened_by_saved_times(count: int) -> None:
    times = np.linspace(0.0, 20.0, count)
    run = cb.solve("particle", "contact-rkn6", rtol=1e-6, save_at=times)
    end = cb.solve("particle", "contact-rkn6", rtol=1e-6, save_at=[20.0])
    assert run.ok
    assert run.interpolated.sum() > 0.8 * count
    assert cb.LAWS["solution_error"](run) < 1e-6
    assert run.step_chosen > 0.1
    assert run.counts.evaluations < 3 * end.counts.evaluations


def test_laws_that_ran_out_of_time_are_measured_again() -> None:
    run = cb.solve("particle", "rk8-7", rtol=1e-8, save_at=np.linspace(0.0, 20.0, 101))
    assert run.interpolated.any()
    assert np.isnan(run.laws(seconds=1e-9).loc["contact_drift", "deviation"])
    assert run.laws().loc["contact_drift", "deviation"] < 1e-5


@pytest.mark.parametrize(
    "method",
    [
        "contact-rkn6",
        "contact-gauss4",
        "rk8-7",
        "quinlan-tremaine8",
        "scipy-dop853",
        "cyrk-dop853",
        "cvode-adams",
        "heyoka-taylor",
        "diffrax-dopri8",
    ],
)
@pytest.mark.parametrize("scene", ["particle", "forced_oscillator"])
def test_a_timed_call_returns_all_saved_states(scene: str, method: str) -> None:
    if cb.METHODS[method].refuses(cb.SCENES[scene]):
        return
    setting = METHODS.get(method, {"step": 0.5} if cb.METHODS[method].control == "step" else {"rtol": 1e-7})
    times = np.linspace(0.5, 20.0, 160)
    run = cb.prepare(scene, method, save_at=times, **setting)
    saved = run.bare_call()()
    assert saved.shape == (len(times), len(run.start))
    assert saved[:, :2] == pytest.approx(run().y[:, :2], abs=1e-3)
    alone = cb.prepare(scene, method, save_at=times[-1:], **setting)
    assert alone.bare_call()().shape == run.start.shape


@pytest.mark.parametrize(
    ("scene", "method", "ratio"),
    [
        ("particle", "contact-rkn8", 2.7),
        ("forced_oscillator", "contact-rkn8", 5.0),
        ("particle", "contact-linear2", 2.0),
        ("particle", "contact-gauss8", 1.2),
    ],
)
def test_a_saved_state_is_the_end_of_an_uninterrupted_run(scene: str, method: str, ratio: float) -> None:
    """Neither a processor nor the iteration begins anew there."""
    end, many = (cb.solve(scene, method, step=0.25, save_at=t) for t in ([20.0], np.append(TIMES, 20.0)))
    assert many.y[-1] == pytest.approx(end.y[-1], rel=1e-13, abs=1e-14)
    assert many.counts.evaluations < ratio * end.counts.evaluations


def test_a_time_beside_the_end_of_a_step_has_a_state_of_its_own() -> None:
    beside = 1e-10
    run = cb.solve(
        "oscillator", "rkn12", step=0.2, save_at=np.append(TIMES[TIMES < 10], [10.0, 10.0 + beside])
    )
    assert run.interpolated[:-2].sum() > 50
    moved, expected = run.q[-1] - run.q[-2], run.p[-2] * beside
    assert moved == pytest.approx(expected, abs=4e-15)
    assert abs(expected[0]) > 1e-11
