"""Methods that are not what they were, planted in real runs of the benchmark: the gate must find each of them."""

from __future__ import annotations

import pytest

import planted_faults
from cases import bench, finished
from contactbench.gate.compare import compare_folders

#: what is planted in contact-strang, and the measures that give it away
PLANTS = {
    "wrong_coefficient(1)": {"solution_error", "pairwise_order", "order", "last_slope"},
    "order_one()": {"solution_error", "pairwise_order", "order", "last_slope"},
    "joints_left_apart()": {"evaluations"},
    "refusal()": {"status"},
    "stronger_damping()": {"contact_drift"},
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return run(tmp_path_factory.mktemp("plants") / "whole")


def run(results, *options):
    """The convergence and laws of two methods, in a smoke run."""
    few = "(convergence or laws) and particle and not long and not decay and (contact-strang or contact-abc)"
    finished(bench(results, few, *options))
    return results


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.slow
def test_a_plant_is_found_in_real_runs(plant, whole, tmp_path):
    fault = planted_faults.plugin(tmp_path / "fault.py", plant)
    moved = compare_folders(whole, run(tmp_path / "planted", "--plugin", str(fault))).moved
    assert set(moved["method"]) == {"contact-strang"}
    assert PLANTS[plant] <= set(moved["measure"])
