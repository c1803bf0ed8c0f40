"""What the smoke profile leaves out of the tables: every column, scene and method is met, but for what is listed here.

``python bench/smoke_coverage.py [RESULTS]`` prints what is missing, a line each, and exits with 1 if it is
anything else.  The rows of a standard run say which of them a smoke run makes too.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd

from contactbench.results.schema import TABLES, Table
from contactbench.results.store import read
from contactbench.results.tables import WORK_PRECISION

#: (table, column or scene): why it is not met
EXCEPTIONS = {
    ("convergence", "message"): "why a run did not end well; those of a smoke run do",
    ("damping_rates", "message"): "why a run did not end well; those of a smoke run do",
    ("damping_rates", "weak_damping_particle"): "takes 10⁴ units of time",
    **{
        (table, column): "of a sample of the cells"
        for table in ("ensemble", "work_precision")
        for column in ("time_process_ratio", "marginal_process_ratio")
    },
}
#: whose scenes are named in words
IN_WORDS = ("claims",)
#: the second of these engines gives the numbers of the first once more: some of its methods are enough
CROSS_CHECK = ("numba", "jax")


def given(rows: pd.DataFrame) -> set[str]:
    """Columns that are not blank throughout."""
    return {name for name in rows if (rows[name].notna() & (rows[name].astype(str) != "")).any()}


def pairs(rows: pd.DataFrame) -> set[str]:
    """Methods on engines, but for those on the engine that cross-checks another they run on."""
    first, again = CROSS_CHECK
    twice = rows["method"].isin(rows["method"][rows["engine"] == first]) & (rows["engine"] == again)
    return set((rows["method"] + " on " + rows["engine"])[~twice])


def missing(table: Table, rows: pd.DataFrame) -> set[tuple[str, str]]:
    """(table, what): columns, scenes, timed methods and their engines that rows of other profiles alone have."""
    smoke = rows[rows["profile"] == "smoke"]
    lost = given(rows) - given(smoke)
    if "scene" in table.key and table.name not in IN_WORDS:
        lost |= {*rows["scene"]} - {*smoke["scene"]}
    if table.name == WORK_PRECISION.name:
        lost |= pairs(rows) - pairs(smoke)
    return {(table.name, what) for what in lost}


def main(results: Path) -> int:
    lost = set[tuple[str, str]]()
    for table in TABLES.values():
        lost |= missing(table, read(table, results))
    for table_name, what in sorted(lost):
        print(f"{table_name}: {what}: {EXCEPTIONS.get((table_name, what), 'not met by the smoke profile')}")
    return int(not lost <= EXCEPTIONS.keys())


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else "results")))
