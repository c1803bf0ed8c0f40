"""The profiles of the benchmark, and which cells they visit."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location

import pytest

import contactbench as cb
from cases import REPOSITORY
from contactbench.claims import CLAIMS
from contactbench.claims.curves import FIGURES
from contactbench.results.schema import PROFILES
from contactbench.scene.base import EXPERIMENTS as SCENE_EXPERIMENTS
from contactbench.scenes import hard_scenes, scenes_of


def profiles():
    """The profiles of the benchmark by name."""
    spec = spec_from_file_location("bench_conftest", REPOSITORY / "bench" / "conftest.py")
    conftest = module_from_spec(spec)
    sys.modules[spec.name] = conftest
    spec.loader.exec_module(conftest)
    return conftest.PROFILES


def visited(experiment, test, profile="smoke"):
    """The cells of a test in a profile."""
    return getattr(import_module(experiment), test).cells(profiles()[profile])


def test_the_smoke_profile_visits_every_scene_method_figure_and_soon_measured_claim():
    everything = {("scene", name) for name in cb.SCENES} | {("method", name) for name in cb.METHODS}
    assert set(visited("bench_definitions", "test_definition")) == everything
    for experiment in ("laws", "convergence"):
        cells = visited(f"bench_{experiment}", f"test_{experiment}")
        assert {cell[0] for cell in cells} == {scene.name for scene in scenes_of(experiment)}
    timed = {cell[:2] for cell in visited("bench_work_precision", "test_work_precision_errors")}
    assert {name for scene, name in timed if scene == "particle"} == set(cb.METHODS)
    soon = {
        name for name, method in cb.METHODS.items() if method.engines[0] not in import_module("cells").DEAR
    }
    assert {cell[1] for cell in visited("bench_laws", "test_laws")} == soon
    assert {cell[0] for cell in visited("bench_stability", "test_stability")} == {
        s.name for s in hard_scenes()
    }
    long = set(import_module("bench_claims").LONG)
    assert long < set(CLAIMS)
    assert {cell[0] for cell in visited("bench_claims", "test_claim")} == set(CLAIMS) - long
    assert {cell[0] for cell in visited("bench_claims", "test_paper_figure")} == set(FIGURES)


EXPERIMENTS = {
    "laws": ("bench_laws", "test_laws"),
    "convergence": ("bench_convergence", "test_convergence"),
    "decay_laws": ("bench_decay", "test_decay_laws"),
    "work_precision": ("bench_work_precision", "test_work_precision_errors"),
}


def test_a_scene_that_names_its_experiments_is_run_by_these_and_no_others():
    few = {name: set(scene.experiments) for name, scene in cb.SCENES.items() if scene.experiments}
    assert few
    assert set().union(*few.values()) == set(EXPERIMENTS) == {*SCENE_EXPERIMENTS} - {"stability"}
    for experiment, (file, test) in EXPERIMENTS.items():
        cells = visited(file, test, "standard")
        assert {cell[0] for cell in cells} & set(few) == {name for name in few if experiment in few[name]}
    timed = [cell for cell in visited(*EXPERIMENTS["work_precision"], "standard") if cell[0] in few]
    assert not {engine for _, _, engine, *_ in timed} & {"jax", "python", "c+python"}  # seconds a cell


@pytest.mark.parametrize(
    "experiment", sorted(path.stem for path in (REPOSITORY / "bench").glob("bench_*.py"))
)
def test_every_cell_of_a_profile_is_one_of_the_next(experiment):
    """What `profile` in a row promises: a larger run has the rows of a smaller one."""
    assert tuple(profiles()) == PROFILES
    tests = [f for f in vars(import_module(experiment)).values() if hasattr(f, "cells")]
    assert tests
    for test in tests:
        cells = [set(test.cells(profile)) for profile in profiles().values()]
        assert cells[1]
        assert cells[0] <= cells[1] <= cells[2]
