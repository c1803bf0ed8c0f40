"""Rejected steps: every adaptive method counts them, or is known not to tell."""

from __future__ import annotations

import pytest

import contactbench as cb
from cases import few_slow

#: solvers that tell their steps and not their attempts, and take no fixed number of evaluations for one
SILENT = {
    ("scipy-radau", "python"), ("cyrk-radau", "c++"), ("cyrk-lsoda", "c++"),
    ("cvode-adams", "c+python"), ("cvode-bdf", "c+python"),
}  # fmt: skip
CASES = [(m, e) for m in cb.METHODS.values() if m.adaptive for e in m.engines if "jax" not in m.engines[1:]]
#: takes six seconds
KVAERNO = (cb.METHODS["diffrax-kvaerno5"], "jax")


@pytest.mark.parametrize(
    ("method", "engine"), few_slow(CASES, KVAERNO), ids=[f"{m.name}-{e}" for m, e in CASES]
)
def test_rejected_steps_are_counted_or_said_not_to_be(method, engine):
    scene = next(s for s in (cb.SCENES["particle"], cb.SCENES["rigid_body"]) if method.refuses(s) is None)
    options = {"rtol": 1e-5} if getattr(method, "control", "rtol") == "rtol" else {}
    run = cb.prepare(scene, method.name, save_at=[scene.t_end], engine=engine, **options)
    rejected = run.count(run().counts).rejected
    assert (rejected is None) == ((method.name, engine) in SILENT)
    if rejected is not None:
        assert rejected >= 0
