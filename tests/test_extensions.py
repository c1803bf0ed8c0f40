"""A law, and a table with a figure: each is one file, and then everywhere by the registries.

For a scene and an integrator see `test_plugins`.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from cases import REPOSITORY, bench, finished

FOLDER = Path(__file__).parent / "extensions"
FILES = [FOLDER / f"{name}.py" for name in ("law", "question")]
COMPARE = ("gate", "--only", "accuracy", "--baseline")
PLUGINS = [argument for file in FILES for argument in ("--plugin", str(file))]


def contactbench(*arguments, code=0):
    done = subprocess.run(
        [sys.executable, "-m", "contactbench", *map(str, arguments), *PLUGINS],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        timeout=240,
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout


pytestmark = pytest.mark.slow  # twenty seconds in processes of its own; `test_plugins` has a quicker one


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """The tables of a small run with both, and what the report makes of them."""
    folder = tmp_path_factory.mktemp("results")
    finished(bench(folder, "rk4 and test_laws and particle and not long", *PLUGINS))
    subprocess.run([sys.executable, FILES[-1], folder], cwd=REPOSITORY, check=True, timeout=120)
    contactbench("report", "--results", folder)
    return folder


def test_a_law_is_in_the_table_and_its_document(results):
    assert "mean_position" in contactbench("list")
    laws = pd.read_csv(results / "laws.csv")
    assert (laws["mean_position"] > 0).all()
    assert "mean q" in (results / "laws.md").read_text()
    assert "mean q" in (results / "report.html").read_text()


def test_a_question_has_its_document_its_figure_its_finding_and_a_place_on_the_page(results):
    assert "When is half of the energy gone?" in (results / "half_life.md").read_text()
    assert (results / "figures" / "half_life.svg").is_file()
    assert "Half-life of the energy" in (results / "report.html").read_text()
    assert "half_life.md" in (results / "README.md").read_text()


@pytest.mark.parametrize(("file", "column"), [("laws", "mean_position"), ("half_life", "half_life")])
def test_the_gate_sees_what_moved(results, file, column, tmp_path):
    fresh = shutil.copytree(results, tmp_path / "fresh")
    moved = pd.read_csv(fresh / f"{file}.csv")
    moved[column] *= 10
    moved.to_csv(fresh / f"{file}.csv", index=False)
    assert column in contactbench(*COMPARE, results, "--fresh", fresh, code=1)


def test_the_gate_sees_nothing_where_nothing_moved(results):
    contactbench(*COMPARE, results, "--fresh", results)
