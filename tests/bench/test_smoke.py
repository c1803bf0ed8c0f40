"""The smoke profile meets every column, scene, method and law of the tables, but for what is listed here."""

from __future__ import annotations

import pytest

from cases import REPOSITORY
from contactbench.results.schema import TABLES
from contactbench.results.store import read
from contactbench.results.tables import WORK_PRECISION

#: why a run did not end well: its own few do
COLUMNS = {("convergence", "message"), ("damping_rates", "message")}
#: 10⁴ units of time of it are run on the weakly damped oscillator
SCENES = {("damping_rates", "weak_damping_particle")}
#: whose scenes are named in words
WORDS = ("claims",)
MADE = [table for table in TABLES.values() if table.name != "gate_selfcheck"]  # made by a run of its own


def rows(table):
    """The committed rows of a table, and those of them that a smoke run makes."""
    every = read(table, REPOSITORY / "results")
    return every, every[every["profile"] == "smoke"]


def given(frame):
    """Columns that are not blank throughout."""
    return {name for name in frame if (frame[name].notna() & (frame[name].astype(str) != "")).any()}


@pytest.mark.parametrize("table", MADE, ids=lambda table: table.name)
def test_every_column_of_a_table_is_met(table):
    every, smoke = rows(table)
    assert len(smoke)
    assert {(table.name, name) for name in given(every) - given(smoke)} <= COLUMNS


@pytest.mark.parametrize(
    "table", [t for t in MADE if "scene" in t.key and t.name not in WORDS], ids=lambda table: table.name
)
def test_every_scene_of_a_table_is_met(table):
    every, smoke = rows(table)
    assert {(table.name, name) for name in {*every["scene"]} - {*smoke["scene"]}} <= SCENES


def test_every_method_is_timed_on_every_engine():
    every, smoke = (set(zip(f["method"], f["engine"], strict=True)) for f in rows(WORK_PRECISION))
    assert every == smoke
