"""The profiles of the benchmark, and which cells they visit."""

from __future__ import annotations

from importlib import import_module

import pytest

import contactbench as cb
from bench_claims import LONG
from cases import REPOSITORY
from cells import DEAR
from conftest import PROFILES
from contactbench.claims import CLAIMS
from contactbench.claims.curves import FIGURES
from contactbench.results.schema import PROFILES as NAMES
from contactbench.scenes import scenes_of


def visited(experiment, test, profile="smoke"):
    """The cells of a test in a profile."""
    return getattr(import_module(experiment), test).cells(PROFILES[profile])


def test_the_smoke_profile_visits_every_scene_method_figure_and_soon_measured_claim():
    everything = {("scene", name) for name in cb.SCENES} | {("method", name) for name in cb.METHODS}
    assert set(visited("bench_definitions", "test_definition")) == everything
    timed = {cell[:2] for cell in visited("bench_work_precision", "test_work_precision_errors")}
    assert {name for scene, name in timed if scene == "particle"} == set(cb.METHODS)
    soon = {name for name, method in cb.METHODS.items() if method.engines[0] not in DEAR}
    assert {cell[1] for cell in visited("bench_laws", "test_laws")} == soon
    hard = {cell[0] for cell in visited("bench_stability", "test_stability")}
    assert hard == {scene.name for scene in scenes_of("stability")}
    assert set(LONG) < set(CLAIMS)
    assert {cell[0] for cell in visited("bench_claims", "test_claim")} == set(CLAIMS) - set(LONG)
    assert {cell[0] for cell in visited("bench_claims", "test_paper_figure")} == set(FIGURES)


EXPERIMENTS = {
    "laws": ("bench_laws", "test_laws"),
    "convergence": ("bench_convergence", "test_convergence"),
    "decay_laws": ("bench_decay", "test_decay_laws"),
    "work_precision": ("bench_work_precision", "test_work_precision_errors"),
}


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_a_scene_that_names_its_experiments_is_run_by_these_and_no_others(experiment):
    few = {name for name, scene in cb.SCENES.items() if scene.experiments}
    cells = visited(*EXPERIMENTS[experiment], "standard")
    assert {cell[0] for cell in cells} & few == {
        name for name in few if experiment in cb.SCENES[name].experiments
    }


@pytest.mark.parametrize(
    "experiment", sorted(path.stem for path in (REPOSITORY / "bench").glob("bench_*.py"))
)
def test_every_cell_of_a_profile_is_one_of_the_next(experiment):
    """What `profile` in a row promises: a larger run has the rows of a smaller one."""
    assert tuple(PROFILES) == NAMES
    tests = [test for test in vars(import_module(experiment)).values() if hasattr(test, "cells")]
    assert tests
    for test in tests:
        smoke, standard, full = (set(test.cells(profile)) for profile in PROFILES.values())
        assert standard
        assert smoke <= standard <= full
