"""States between steps: as accurate as the steps, on one side of a break, and counted."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import contactbench as cb
from contactbench.methods.hermite import newton

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
def test_a_polynomial_is_its_own_interpolant(r: int) -> None:
    """With its derivative, in unordered nodes; with fewer terms it is that through the first nodes."""
    power = np.polynomial.Polynomial(np.arange(1.0, 4 * r + 1))
    nodes = np.array([[0.5, 0.1, 1.0, -0.3]])
    data = np.stack([power.deriv(k)(nodes) if k else power(nodes) for k in range(r)], axis=2)[..., None]
    t = np.array([0.2, 0.7, -0.1])
    (less, _), (value, slope) = newton(nodes, data).at(t, np.zeros(3, dtype=int), [3 * r, 4 * r])
    assert value[:, 0] == pytest.approx(power(t), rel=1e-11)
    assert slope[:, 0] == pytest.approx(power.deriv()(t), rel=1e-10)
    ((alone, _),) = newton(nodes[:, :3], data[:, :3]).at(t, np.zeros(3, dtype=int), [3 * r])
    assert less == pytest.approx(alone, rel=1e-12)


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
