"""The tables that come with the package."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tomllib

import pandas as pd
import pytest

import contactbench as cb
from cases import REPOSITORY
from contactbench.results.schema import TABLES
from contactbench.results.shipped import shipped_folder

SHIPPED = [name for name, table in TABLES.items() if table.path(shipped_folder()).is_file()]


@pytest.mark.parametrize("name", SHIPPED)
def test_a_table_is_a_typed_frame_with_the_meaning_of_its_columns(name):
    frame = cb.results(name)
    assert len(frame)
    assert set(frame.attrs["columns"]) == set(frame.columns)
    kinds = {"number": "f", "whole": "i", "flag": "b"}
    for column, about in TABLES[name].every_column.items():
        if about.type in kinds:
            assert frame[column].dtype.kind == kinds[about.type], column


def test_the_name_is_not_lost_when_the_package_of_that_name_is_imported():
    import contactbench.results.store  # noqa: F401

    assert isinstance(cb.results("claims"), pd.DataFrame)


def test_times_come_along():
    assert cb.results("work_precision")["time_median_s"].notna().any()


def test_unknown_names_and_empty_folders_are_named(tmp_path):
    with pytest.raises(cb.BadInput, match="unknown table 'lwas': did you mean 'laws'"):
        cb.results("lwas")
    with pytest.raises(cb.BadInput, match="has no table 'laws'"):
        cb.results("laws", tmp_path)


def test_an_installed_package_has_them_beside_its_modules(tmp_path):
    """As the wheel lays them out; the project's file says that it does."""
    wheel = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"][
        "wheel"
    ]
    assert "/results/*.csv" in wheel["include"]
    assert wheel["sources"]["results"] == "contactbench/_results"
    package = tmp_path / "contactbench"
    shutil.copytree(
        REPOSITORY / "src" / "contactbench", package, ignore=shutil.ignore_patterns("__pycache__")
    )
    script = "import contactbench as cb; print(cb.__file__, len(cb.results('claims')))"

    def asked():
        return subprocess.run(
            [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=120,
            env={**os.environ, "PYTHONPATH": str(tmp_path)},
        )  # fmt: skip

    assert "no result tables in this installation" in asked().stderr
    (package / "_results").mkdir()
    for path in (REPOSITORY / "results").glob("claims*.csv"):
        shutil.copy(path, package / "_results")
    where, rows = asked().stdout.split()
    assert where.startswith(str(tmp_path))
    assert int(rows) == len(cb.results("claims"))
