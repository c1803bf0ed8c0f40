"""A tolerance asked of a fixed-step method is met: the error is near it and never far above."""

from __future__ import annotations

import numpy as np
import pytest

import contactbench as cb
from cases import pairs

FIXED = [m for m in cb.METHODS.values() if m.control == "step" and m.one_step]
SCENES = [cb.SCENES[name] for name in ("oscillator", "particle", "central", "rigid_body")]
#: by order, what is reached in a number of steps that a test can wait for
RTOLS = {1: (1e-3,), 2: (1e-3, 1e-5)}


@pairs(FIXED, SCENES)
@pytest.mark.quick(scene="oscillator")
@pytest.mark.quick(scene="rigid_body", method="contact-bm4")
def test_error_is_within_a_factor_of_ten_of_the_tolerance(method, scene):
    for rtol in RTOLS.get(method.order, (1e-3, 1e-6, 1e-8)):
        solution = cb.solve(scene, method.name, rtol=rtol, save_at=[scene.t_end], carry=())
        assert rtol / 10 < cb.LAWS["solution_error"](solution) < 2 * rtol


def test_the_pilots_are_counted():
    run = cb.prepare("particle", "contact-rkn6", rtol=1e-8, save_at=[20.0])
    solution = run()
    alone = cb.solve("particle", "contact-rkn6", step=20.0 / solution.counts.steps, save_at=[20.0])
    np.testing.assert_allclose(alone.y, solution.y, rtol=1e-12)
    assert alone.counts.evaluations < solution.counts.evaluations < 2.5 * alone.counts.evaluations
    assert solution.setting == "rtol=1e-08"


def test_other_initial_data_get_a_step_of_their_own():
    run = cb.prepare("particle", "contact-rkn6", rtol=1e-8, save_at=[20.0])
    gentle, wild = run(q=(0.01, 0.0), p=(0.0, 0.0)), run(q=(2.5, 1.0), p=(1.0, 2.0))
    assert wild.counts.steps != gentle.counts.steps
    for solution in (gentle, wild):
        assert cb.LAWS["solution_error"](solution) < 2e-8


@pytest.mark.parametrize("engine", ["jax", "python"])
def test_a_tolerance_out_of_reach_ends_as_budget(engine):
    options = {"rtol": 1e-9, "save_at": [20.0], "max_steps": 2000}
    solution = cb.solve("particle", "contact-printed", engine=engine, **options)
    assert solution.status is cb.Status.budget
    assert "rtol = 1e-09" in solution.message
    assert np.isnan(solution.y).all()


@pytest.mark.parametrize(("method", "rtol"), [("contact-o8", 1e-6), ("contact-rkn6", 1e-7), ("rk4", 1e-8)])
def test_steps_that_saved_times_shorten_are_not_taken_for_halved_ones(method, rtol):
    """On 200 saved times the pilots do not halve: by nominal steps the error was 12, 6 and 2 times the tolerance."""
    scene = cb.SCENES["particle"].with_(t_end=200.0) if method != "rk4" else cb.SCENES["oscillator"]
    solution = cb.solve(scene, method, rtol=rtol)
    true = cb.solve(scene, "heyoka-taylor", rtol=1e-15, save_at=solution.t)
    y, z = (np.hstack([s.q, s.p]) for s in (solution, true))
    assert np.linalg.norm(y - z, axis=1).max() <= rtol * np.linalg.norm(z, axis=1).max()
