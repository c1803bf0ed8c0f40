"""``contactbench compare``, and the line without a command."""

from __future__ import annotations

import json
from importlib import metadata

import pandas as pd
import pytest

import contactbench as cb
from contactbench.cli import main

RACE = ["compare", "particle", "rk4", "contact-strang", "--error", "1e-2,1e-3", "--budget", "60s"]


@pytest.fixture(autouse=True)
def cores(monkeypatch):
    """The tests keep their cores."""
    monkeypatch.setattr("contactbench.cli.runs.one_core", lambda: None)


def test_it_prints_tables_and_writes_only_what_it_is_told(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main([*RACE, "--csv", "out.csv", "--html", "out.html", "--plot", "out.svg"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("Compiled")
    assert "at round-off" in out
    assert err == ""  # no terminal, no progress
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.csv", "out.html", "out.svg"]
    rows = pd.read_csv("out.csv")
    assert list(rows["method"]) == ["rk4", "rk4", "contact-strang", "contact-strang"]
    assert (rows["status"] == "ok").all()


def test_json_is_one_object_with_the_rows(capsys):
    """Methods may follow an option."""
    line = "compare particle --error 1e-2,1e-3 rk4 --budget 60s contact-strang --json --set gamma=0.3"
    assert main(line.split()) == 0
    found = json.loads(capsys.readouterr().out)
    assert {"reference", "rows"} <= found.keys()
    assert [row["error_asked"] for row in found["rows"]] == [1e-2, 1e-3] * 2
    assert all(row["time_s"] > 0 for row in found["rows"])


def test_a_race_that_measures_nothing_is_no_success(capsys):
    assert main(["compare", "particle", "contact-exact", "--error", "1e-2", "--json"]) == 1
    assert [row["status"] for row in json.loads(capsys.readouterr().out)["rows"]] == ["unsupported"]


def test_an_interrupted_race_prints_what_it_has(capsys, monkeypatch):
    def stopped(self):
        raise KeyboardInterrupt

    monkeypatch.setattr("contactbench.race.comparison.Comparison.time", stopped)
    assert main(RACE) == 130
    out = capsys.readouterr().out
    assert "not timed" in out
    assert "Interrupted" in out


def test_version_and_help_without_a_command(capsys):
    assert main(["--version"]) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first == f"contactbench {cb.__version__}"
    assert f"heyoka {metadata.version('heyoka')}, cyrk {metadata.version('cyrk')}" in second
    assert main([]) == 0
    out = capsys.readouterr().out
    assert out.startswith("usage: contactbench")
    assert "compare" in out
