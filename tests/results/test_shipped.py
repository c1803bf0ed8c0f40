"""The tables that come with the package.  Those that are looked at here are made up: a clone's are those of any run."""

from __future__ import annotations

import tomllib

import pytest

import contactbench as cb
from cases import REPOSITORY
from contactbench.results import tables
from contactbench.results.schema import TABLES
from made_up import ROWS, folder


@pytest.mark.parametrize("name", ROWS)
def test_a_table_is_a_typed_frame_with_the_meaning_of_its_columns(name, tmp_path, monkeypatch):
    made = folder(tmp_path / "tables")
    monkeypatch.setattr(tables, "shipped_folder", lambda: made)
    frame, columns = cb.results(name), TABLES[name].every_column
    assert len(frame) == len(ROWS[name])
    assert set(frame.attrs["columns"]) == set(frame.columns) == set(columns)
    kinds = {"number": "f", "whole": "i", "flag": "b", "answer": "b"}
    for column in frame:
        assert frame[column].dtype.kind == kinds.get(columns[column].type, frame[column].dtype.kind), column
    assert name != "work_precision" or frame["time_median_s"].notna().sum() == 2  # times come along


def test_tables_lie_inside_an_installed_package_or_beside_the_sources(tmp_path, monkeypatch):
    """As the wheel lays them out (the project's file says that it does), and as a clone has them."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert "/results/*.csv" in wheel["include"]
    assert wheel["sources"]["results"] == "contactbench/_results"
    package = tmp_path / "src" / "contactbench"
    monkeypatch.setattr(tables, "__file__", str(package / "results" / "tables.py"))
    with pytest.raises(cb.BadInput, match="no result tables in this installation"):
        cb.results("claims")
    folder(package / "_results")
    assert cb.results("claims")["id"].tolist() == ["C01"]
    folder(tmp_path / "results", lambda which, row: {**row, "id": "C02"} if "id" in row else row)
    assert cb.results("claims")["id"].tolist() == ["C02"]
