"""A method that is not what it was, planted in real runs of the benchmark: the gate must find it."""

from __future__ import annotations

import pytest

import planted_faults
from cases import bench, finished
from contactbench.gate.compare import compare_folders

#: the measures that give away a coefficient of contact-strang that is a part in a thousand larger
MOVED = {"solution_error", "pairwise_order", "order", "last_slope"}


def run(results, *options):
    """The convergence and laws of two methods, in a smoke run."""
    few = "(convergence or laws) and particle and not long and not decay and (contact-strang or contact-abc)"
    finished(bench(results, few, *options))
    return results


@pytest.mark.slow
def test_a_plant_is_found_in_real_runs(tmp_path):
    fault = planted_faults.plugin(tmp_path / "fault.py", "wrong_coefficient(1)")
    moved = compare_folders(run(tmp_path / "a"), run(tmp_path / "b", "--plugin", str(fault))).moved
    assert set(moved["method"]) == {"contact-strang"}
    assert set(moved["measure"]) >= MOVED
