"""The saved states of a run are those of the solver itself, to the bit."""

from __future__ import annotations

import numpy as np
import pytest

import contactbench as cb
from contactbench.scenes import SCENES


@pytest.mark.parametrize("scene", ["central", "rigid_body_anisotropic"])
def test_radau_without_wrappers_gives_the_same_to_the_bit(scene):
    run = cb.prepare(scene, "scipy-radau", rtol=1e-5, save_at=[0.7, 2.0])
    plain, lean = (run._stepped(run.start, lean=lean) for lean in (False, True))
    assert np.array_equal(plain.y, lean.y)
    assert plain.counts == lean.counts
    assert np.array_equal(run.bare(run.start), lean.y[-1])


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
