"""Several processes share the untimed cells: what is compiled alike is in one of them."""

from __future__ import annotations

import re
from collections import defaultdict

import pytest

from cases import bench, finished
from cells import family, takes_long


@pytest.mark.slow
def test_cells_whose_programs_are_the_same_are_in_one_process(tmp_path):
    words = "(convergence or laws) and rk4 and (particle or central or quadratic)"
    workers = ("-vv", "-m", "not timed", "-n", "2")
    output = finished(bench(tmp_path, words, *workers))
    cells = re.findall(r"\[(gw\d)\].* PASSED .*::test_(?:convergence|laws)\[(\w+)-rk4\]", output)
    assert len(cells) == 8, output  # two experiments on four scenes
    processes = defaultdict(set)
    for process, scene in cells:
        processes[family((scene, "rk4"))].add(process)
    assert len(processes) == 3, processes  # particle and particle_long have the same
    assert all(len(each) == 1 for each in processes.values()), processes


def test_programs_are_the_same_for_scenes_of_one_force_and_method():
    assert family(("particle", "rk4", 30.0)) == family(("escape", "rk4")) == family(("particle_long", "rk4"))
    assert family(("weak_damping 1e+04", "rk4")) == family(("oscillator", "rk4"))
    apart = {
        family(cell)
        for cell in [("particle", "rk4"), ("particle", "herglotz1"), ("central", "rk4"), ("C01",)]
    }
    assert len(apart) == 4


def test_what_takes_long_solves_equations_or_calls_back():
    assert takes_long(("particle", "diffrax-kvaerno5", "jax"))
    assert takes_long(("weak_damping 1e+04", "scipy-radau"))
    assert not takes_long(("particle", "cyrk-radau"))
    assert not takes_long(("C01",))
