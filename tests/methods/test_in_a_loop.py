"""Compiled peers one trajectory after the other: each is the single call."""

from __future__ import annotations

import numpy as np
import pytest

import contactbench as cb


@pytest.mark.parametrize("method", ["cyrk-dop853", "cyrk-vern8", "cyrk-lsoda", "cvode-adams", "cvode-bdf"])
def test_a_compiled_loop_gives_the_single_calls(method):
    run = cb.prepare("particle", method, rtol=1e-7, carry=(), save_at=[3.0])
    starts = run.start + 0.1 * np.random.default_rng(5).normal(size=(6, len(run.start)))
    together = run.many(starts)
    np.testing.assert_array_equal(run.many(np.asfortranarray(starts)), together)
    for start, row in zip(starts, together, strict=True):
        out = run.integrate(start)
        np.testing.assert_array_equal(row[-len(start) :], out.y[-1])
        assert (row[3], row[4]) == (out.counts.steps, out.counts.evaluations)
