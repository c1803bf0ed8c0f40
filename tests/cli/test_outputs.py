"""What cannot be written is refused before anything is computed."""

from __future__ import annotations

from pathlib import Path

import pytest

import contactbench as cb
import made_up
from contactbench import cli
from contactbench.cli import parsing
from contactbench.report import write

OPTIONS = [
    ("solve particle rk4 --step 0.1", "--out", ".csv"),
    ("solve particle rk4 --step 0.1", "--plot", ".svg"),
    ("compare particle rk4", "--csv", ".csv"),
    ("compare particle rk4", "--html", ".html"),
    ("compare particle rk4", "--plot", ".png"),
]


def work(*_, **__):
    raise AssertionError("the work has begun")


def full(*_, **__):
    raise OSError(30, "Read-only file system")


@pytest.fixture
def idle(monkeypatch):
    """Nothing may be solved."""
    monkeypatch.setattr(cb, "solve", work)
    monkeypatch.setattr(cb, "compare", work)


@pytest.mark.usefixtures("idle")
@pytest.mark.parametrize("place", ["none/x", "file/x", "folder"])
@pytest.mark.parametrize(("line", "option", "suffix"), OPTIONS)
def test_an_output_that_cannot_be_written_is_refused_first(line, option, suffix, place, tmp_path, capsys):
    """In no folder, in a file, in place of a folder."""
    path = (tmp_path / place).with_suffix(suffix)
    (tmp_path / "file").write_text("kept")
    (tmp_path / "folder").with_suffix(suffix).mkdir()
    assert cli.main([*line.split(), option, str(path)]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert err.startswith(f"contactbench: {option} {path}: ")


def test_trying_a_file_changes_nothing(tmp_path):
    path = tmp_path / "there.csv"
    path.write_text("kept")
    parsing.writable("--csv", path)
    assert path.read_text() == "kept"
    parsing.writable("--csv", tmp_path / "new.csv")
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_the_system_refuses_is_refused_first(tmp_path, monkeypatch):
    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(cb.BadInput, match=r"--csv .*new\.csv: cannot be written: Read-only file system"):
        parsing.writable("--csv", tmp_path / "new.csv")


def test_a_report_that_cannot_be_written_is_refused_first(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(write, "report", work)
    made_up.folder(tmp_path)
    readme = tmp_path / "README.md"
    readme.write_text("nothing to fill in")
    assert cli.main(["report", "--results", str(tmp_path), "--readme", str(readme)]) == 2
    assert cli.main(["report", "--results", str(tmp_path), "--readme", str(tmp_path / "none")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 2
