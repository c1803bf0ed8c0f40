"""The hard scenes: their truths, what is known about them, and what must not break on them."""

import numpy as np
import pytest

import contactbench as cb
from cases import HARD, few_slow, mine, saved
from contactbench.scene.base import Elapsed
from contactbench.truth import blow_up_time, condition_number


@pytest.mark.parametrize("scene", HARD, ids=lambda scene: scene.name)
def test_every_hard_scene_has_a_truth(scene):
    times = saved(scene, 25)
    if scene.name == "escape":
        time, digits = blow_up_time(scene)
        assert digits >= 30
        run = cb.solve(scene, "scipy-dop853", rtol=1e-12, save_at=[scene.t_end])
        assert run.end_time == pytest.approx(float(time), abs=1e-9)  # another solver
        times = times[times < float(time)]
    truth = cb.reference(scene, Elapsed(times))
    assert truth.source in ("closed form", "frozen"), f"run python references/generate.py {scene.name}"
    assert truth.digits >= 30


# -- what is known about them ----------------------------------------------------------------------
#: dampings by what is in their kernel: the middle axis, that of least inertia, two axes
SINGULAR = {"middle": (0.5, 0.0, 0.5), "least": (0.0, 0.5, 0.5), "two": (0.0, 0.0, 0.5)}


@pytest.mark.parametrize("kernel", few_slow(SINGULAR, "least", "two"))
def test_singular_damping_ends_in_a_steady_rotation_and_contact_methods_find_it(kernel):
    scene = cb.SCENES["singular_damping_2"].with_(damping=SINGULAR[kernel])
    end = cb.reference(scene, Elapsed([scene.t_end]), ()).y[0]
    slope = np.array(scene.rhs(cb.scene.BodyState(tuple(end))).M)
    assert np.abs(end).max() > 0.1
    assert np.abs(slope).max() < 1e-3 * np.abs(end).max()
    found = cb.solve(scene, "contact-rkn4", step=0.05, save_at=[scene.t_end], carry=(), engine="python")
    np.testing.assert_allclose(found.y[0], end, rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ["saddle_edge", "tumbling"])
def test_condition_numbers_are_the_growth_of_errors(name):
    """Against the derivative of a run, by dual numbers through its steps: an independent engine and derivative."""
    scene = cb.SCENES[name]
    solution = cb.solve(scene, "rk8", step=scene.t_end / 4000, save_at=scene.begins + saved(scene, 25))
    growth = np.linalg.norm(solution.sensitivity, ord=2, axis=(1, 2)).max()
    # other times, and unit tangents instead of coordinates
    assert 0.2 * condition_number(scene) < growth < 3 * condition_number(scene)
    assert condition_number(scene.with_(gamma=0.7)) is None


@pytest.mark.slow
def test_blow_up_time_against_an_integral():
    """q'' = 3q²/2, q = 1/(t* − t)² · 4: from q(0) = 4, p(0) = 8 the end is at t = 1 exactly."""
    scene = mine(lambda q: -(q[0] ** 3) / 2, 4.0, 8.0, 3.0)
    time, digits = blow_up_time(scene)
    assert digits >= 30
    assert float(time) == 1.0
    assert blow_up_time(cb.SCENES["particle"].with_(gamma=0.3)) is None


# -- laws where numbers run out --------------------------------------------------------------------
@pytest.mark.parametrize("method", ["contact-abc", "contact-strang", "contact-rkn6", "rk4"])
def test_contact_drift_of_the_overdamped_oscillator_means_something(method):
    """e^{−γT} = e^{−5000} of terms of size 10⁻²: round-off is told from a real drift all the same."""
    solution = cb.solve("overdamped", method, step=0.05, save_at=[50.0, 100.0])
    assert solution.ok
    drift = cb.LAWS["contact_drift"](solution)
    assert drift < 1e-12 if method != "rk4" else 1e-9 < drift < 1e6


def test_a_solver_that_calls_python_steps_back_from_a_wall_as_its_compiled_twin_does():
    """In Python e^x raises where it is inf elsewhere, and the step is refused that led there."""
    wall = cb.SCENES["steep_wall"].with_(p=(0.5,))
    one, other = (cb.solve(wall, f"{library}-dop853", rtol=1e-7) for library in ("scipy", "cyrk"))
    assert one.ok
    assert one.counts.rejected
    assert one.y[-1] == pytest.approx(other.y[-1], rel=1e-9)
