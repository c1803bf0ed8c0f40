"""What a run returns, as its user meets it: a frame, a line, its laws."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest

import contactbench as cb
from contactbench.measure.laws import LAWS, laws_of


def test_a_solution_is_a_frame():
    solution = cb.solve("particle", "contact-strang", step=0.1)
    frame = solution.to_frame()
    assert list(frame.columns) == ["t", "q1", "q2", "p1", "p2", "s"]
    np.testing.assert_array_equal(frame["t"], solution.t)
    np.testing.assert_array_equal(frame[["p1", "p2"]], solution.p)
    np.testing.assert_array_equal(frame["s"], solution.s)


def test_a_body_is_a_frame_of_momentum_and_attitude():
    frame = cb.solve("rigid_body", "contact-strang", step=0.5, carry=("R",)).to_frame()
    assert list(frame.columns) == ["t", "M1", "M2", "M3", "R_w", "R_x", "R_y", "R_z"]


@pytest.mark.parametrize(
    ("scene", "carry"), [("central", ("s",)), ("central", ()), ("rigid_body_anisotropic", ())]
)
def test_its_laws_are_all_that_apply(scene, carry):
    solution = cb.solve(scene, "contact-strang", step=0.5, save_at=[5.0, 10.0], carry=carry)
    laws = solution.laws()
    fields = cb.SCENES[scene].optional
    expected = [
        law.name for law in laws_of(cb.SCENES[scene]) if {n for n in law.needs if n in fields} <= set(carry)
    ]
    assert list(laws.index) == expected
    for name in expected:
        np.testing.assert_equal(laws.loc[name, "deviation"], LAWS[name](solution))
        assert laws.loc[name, "definition"] == LAWS[name].definition
    assert (laws["note"] == "").all()


def test_a_law_without_a_number_says_why():
    short = cb.solve("particle", "rk4", step=0.1, max_steps=10).laws()
    assert short["deviation"].isna().all()
    assert set(short["note"]) == {"budget"}
    rest = cb.SCENES["quadratic_damping"].with_(q=(0.0, 0.0), p=(0.0, 0.0), s=0.0)
    laws = cb.solve(rest, "rk4", step=0.1, save_at=[1.0]).laws()
    assert math.isnan(laws.loc["hamiltonian_law", "deviation"])
    assert "H(0) = 0" in laws.loc["hamiltonian_law", "note"]


def test_the_command_line_writes_run_and_plot_and_prints_laws(tmp_path, capsys, monkeypatch):
    from contactbench.cli import main

    monkeypatch.chdir(tmp_path)
    line = ["solve", "central", "contact-strang", "--step", "0.1", "--t-end", "2"]
    assert main([*line, "--laws", "--plot", "run.svg", "--out", "run.csv"]) == 0
    out = capsys.readouterr().out
    assert "momentum_law" in out
    assert "contact_drift" in out
    run = pd.read_csv("run.csv")
    assert run["t"].iloc[-1] == 2.0
    assert len(run) == 21
    assert (tmp_path / "run.svg").read_text().count("<path") > 10
    assert main([*line, "--laws", "--json"]) == 0
    assert '"momentum_law":' in capsys.readouterr().out
