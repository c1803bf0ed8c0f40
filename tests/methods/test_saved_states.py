"""The states a derivative is taken of are those of the run, to the bit, whatever way they are had."""

from __future__ import annotations

import numpy as np

import contactbench as cb
from cases import pairs
from contactbench.scenes import SCENES

ADAPTIVE = [method for method in cb.METHODS.values() if method.adaptive]


@pairs(ADAPTIVE, [SCENES["central"], SCENES["rigid_body_anisotropic"]], share=2)
def test_the_states_that_are_differenced_are_those_of_the_run(method, scene):
    run = cb.prepare(scene, method, rtol=1e-5, save_at=[0.7, 2.0])
    moved = run.start * (1 + 1e-3)
    assert np.array_equal(run.saved_states(moved), run.integrate(moved).y, equal_nan=True)


def test_radau_without_wrappers_ends_where_it_ends_with_them():
    """At a singularity: numbers that are not finite are refused in the same words."""
    scene = SCENES["escape"]
    run = cb.prepare(scene, "scipy-radau", rtol=1e-6, save_at=[scene.t_end], max_steps=2000)
    plain, lean = (run._stepped(run.start, lean=lean) for lean in (False, True))
    assert (plain.status, plain.message, plain.counts) == (lean.status, lean.message, lean.counts)


def test_what_is_done_later_to_the_times_that_were_given_changes_no_run():
    times = np.array([1.0, 2.0])
    run = cb.prepare("particle", "rk4", step=0.1, save_at=times)
    times[:] = 0.5
    assert run().t.tolist() == [1.0, 2.0]
