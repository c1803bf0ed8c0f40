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
    monkeypatch.setattr("contactbench.cli.compare.one_core", lambda: None)


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
    line = [
        "compare",
        "particle",
        "--error",
        "1e-2,1e-3",
        "rk4",
        "--budget",
        "60s",
        "contact-strang",
        "--json",
    ]
    assert main([*line, "--set", "gamma=0.3"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {"reference", "rows"} <= found.keys()
    assert [row["error_asked"] for row in found["rows"]] == [1e-2, 1e-3] * 2
    assert all(row["time_s"] > 0 for row in found["rows"])


def test_a_race_that_measures_nothing_is_no_success(capsys):
    assert main(["compare", "particle", "contact-exact", "--error", "1e-2", "--json"]) == 1
    assert [row["status"] for row in json.loads(capsys.readouterr().out)["rows"]] == ["unsupported"]


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (["--error", "small"], "--error small: must be errors separated by commas"),
        (["--error", "2"], "error = 2.0: must be between 0 and 1"),
        (["--budget", "soon"], "--budget soon: must be a time, as in 60s or 2m"),
        (["--budget", "0"], "budget = 0.0: must be > 0"),
        (["--error", "-1e-3,1e-2"], "error = -0.001: must be between 0 and 1"),
        (["rk5"], "unknown method 'rk5': did you mean 'rk4'?"),
        (["--html", "nowhere/out.html"], "--html nowhere/out.html: cannot be written: No such file"),
        (["--plot", "out.txt"], "--plot out.txt: must end in .svg, .png, .pdf"),
    ],
)
def test_bad_values_are_one_line(line, says, capsys):
    assert main(["compare", "particle", "rk4", *line]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"contactbench: {says}")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (["compare"], "the following arguments are required: scene"),
        (["gate", "--budget", "0"], "argument --budget: seconds = 0.0: must be > 0"),
        (["gate", "--budget", "soon"], "argument --budget: could not convert"),
    ],
)
def test_bad_usage_is_one_line(line, says, capsys):
    with pytest.raises(SystemExit) as caught:
        main(line)
    err = capsys.readouterr().err
    assert (caught.value.code, err.count("\n")) == (2, 1)
    assert err.startswith(f"contactbench {line[0]}: {says}")


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
