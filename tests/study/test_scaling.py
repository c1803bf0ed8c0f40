"""Rows of cost against size: the same motion at every size, the same steps as a C loop, memory at its peak."""

import math

import numpy as np
import pytest

import contactbench as cb
from contactbench.results.tables import SCALING
from contactbench.study import scaling
from contactbench.study.c_loops import ring_kernel

pytestmark = pytest.mark.usefixtures("threads")  # a cell says how many it takes


def row(n, method="contact-strang", engine="numba"):
    made = scaling.errors(("fput", method, engine, n, 1))
    assert set(made) <= {*SCALING.columns}
    return made


def test_a_method_has_the_same_steps_and_the_same_error_at_every_size():
    short, long = row(16), row(128)
    assert 5e-7 < short["solution_error"] <= 1e-6
    assert long["solution_error"] == pytest.approx(short["solution_error"], rel=1e-6)
    assert [long[name] for name in ("n", "value", "steps")] == [128, short["value"], short["steps"]]
    assert scaling.call(("fput", "contact-strang", "numba", 128, 1), long["value"])[1].warm_up() > 0


@pytest.mark.parametrize("method", ["contact-strang", "contact-rkn6"])
def test_the_loop_in_c_computes_what_the_method_does(method):
    scene = scaling.sized("fput", 48)
    made = ring_kernel(method, scene, 0.1)
    if isinstance(made, str):
        pytest.skip(made)
    run, evaluations = made
    solution = cb.solve(scene, method, step=0.1, carry=(), save_at=[scene.t_end])
    np.testing.assert_allclose(run(), solution.y[-1], rtol=0, atol=1e-12)
    assert evaluations == solution.counts.evaluations


def test_a_method_that_does_not_go_so_far_has_a_row_that_says_so():
    made = row(1024, "scipy-radau", "python")
    assert made["status"] == "unsupported"
    assert "dense" in made["message"]


def test_the_peak_of_memory_is_that_of_the_call():
    peak = scaling.peak_memory(lambda: np.ones(5_000_000).sum())
    if math.isnan(peak):
        pytest.skip("the system does not say")
    assert 3.9e7 < peak < 5e7  # the system counts pages in batches
