"""What cannot be written is refused before anything is computed."""

from __future__ import annotations

from pathlib import Path

import pytest

import contactbench as cb
import made_up
from contactbench import cli
from contactbench.cli import parsing

REPOSITORY = Path(__file__).parents[2]
OPTIONS = [
    ("solve particle rk4 --step 0.1", "--out", ".csv"),
    ("solve particle rk4 --step 0.1", "--plot", ".svg"),
    ("compare particle rk4", "--csv", ".csv"),
    ("compare particle rk4", "--html", ".html"),
    ("compare particle rk4", "--plot", ".png"),
]


def places(folder):
    """Where nothing can be written, however much one may: no such folder, a file as one, a folder as a file."""
    (folder / "file").write_text("kept")
    (folder / "folder.csv").mkdir()
    return {
        "no folder": folder / "none" / "x",
        "in a file": folder / "file" / "x",
        "a folder": folder / "folder",
    }


@pytest.fixture
def idle(monkeypatch):
    """Nothing may be solved."""

    def working(*_, **__):
        raise AssertionError("the work has begun")

    monkeypatch.setattr(cb, "solve", working)
    monkeypatch.setattr(cb, "compare", working)


@pytest.mark.parametrize("place", ["no folder", "in a file", "a folder"])
@pytest.mark.parametrize(("line", "option", "suffix"), OPTIONS)
def test_an_output_that_cannot_be_written_is_refused_first(
    line, option, suffix, place, idle, tmp_path, capsys
):
    path = places(tmp_path)[place].with_suffix(suffix)
    if place == "a folder":
        path.mkdir(exist_ok=True)
    assert cli.main([*line.split(), option, str(path)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert said.startswith(f"contactbench: {option} {path}: ")


@pytest.mark.parametrize("line", ["solve particle rk4 --step 0.1", "compare particle rk4"])
def test_a_figure_that_nobody_draws_is_refused_first(line, idle, tmp_path, capsys):
    assert cli.main([*line.split(), "--plot", str(tmp_path / "x.txt")]) == 2
    assert "must end in .svg, .png, .pdf" in capsys.readouterr().err


def test_trying_a_file_changes_nothing(tmp_path):
    path = tmp_path / "there.csv"
    path.write_text("kept")
    parsing.writable("--csv", path)
    assert path.read_text() == "kept"
    parsing.writable("--csv", tmp_path / "new.csv")
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_the_system_refuses_is_refused_first(tmp_path, monkeypatch):
    def refused(*_, **__):
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(Path, "open", refused)
    with pytest.raises(cb.BadInput, match=r"--csv .*new\.csv: cannot be written: Read-only file system"):
        parsing.writable("--csv", tmp_path / "new.csv")


def test_a_report_that_cannot_be_written_is_refused_first(tmp_path, monkeypatch, capsys):
    from contactbench.report import write

    def working(*_):
        raise AssertionError("the work has begun")

    monkeypatch.setattr(write, "report", working)
    made_up.folder(tmp_path)
    readme = tmp_path / "README.md"
    readme.write_text("nothing to fill in")
    assert cli.main(["report", "--results", str(tmp_path), "--readme", str(readme)]) == 2
    assert cli.main(["report", "--results", str(tmp_path), "--readme", str(tmp_path / "none")]) == 2

    def full(**_):
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(parsing.tempfile, "NamedTemporaryFile", full)
    assert cli.main(["report", "--results", str(tmp_path)]) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 3
    assert said[-1] == f"contactbench: --results {tmp_path}: cannot be written: Read-only file system"
