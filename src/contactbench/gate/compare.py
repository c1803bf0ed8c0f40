"""What moved between two folders of tables, by the rule of each column.

Which rows a fresh run must have, the rows before say themselves (column `profile`), so that one that is no longer
made is noticed.  A new table is gated by its rules.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from contactbench.errors import BadInput
from contactbench.gate.findings import BLANK, Findings, rows_of
from contactbench.gate.rules import distance
from contactbench.results import provenance
from contactbench.results.schema import PROFILES, TABLES, Rule, Table
from contactbench.results.store import read

#: packages that solve nothing: runs may differ in them and be of one machine
IDLE_PACKAGES = ("contactbench", "pandas", "matplotlib", "pytest-benchmark")

Frames = Mapping[str, pd.DataFrame]
Runs = list[dict[str, Any]]


# -- one table -------------------------------------------------------------------------------------
def compare(table: Table, before: pd.DataFrame, after: pd.DataFrame, alike: bool = False) -> pd.DataFrame:
    """Return what is missing from `after` or moved too far: the worst value of each measure of a method on a scene.

    before : only rows that are expected.  alike : both were made on the same processor with the same libraries.
    """
    both = before.merge(after, how="left", on=list(table.key), suffixes=("", " after"), indicator="side")
    gone, both = both[both["side"] == "left_only"], both[both["side"] == "both"]
    if len(before) and both.empty:
        row = {"table": table.name, "measure": "table", "before": f"{len(before)} rows", "after": "none"}
        return rows_of(row | {"result": "missing"})
    missing = locate(table, gone).assign(measure="row", before="present", after="none", result="missing")
    found = [missing.assign(distance=math.inf)]
    same_end = (both["status"] == both["status after"]).to_numpy() if "status" in table.columns else True
    for name, rule in judged(table, both).items():
        moved = distance(rule, both[name], both[f"{name} after"], both, alike)
        if name not in ("status", "profile"):  # the numbers of a run that ended otherwise say nothing more
            moved = np.where(same_end, moved, 0.0)
        rows, moved = both[moved > 1], moved[moved > 1]
        old, new = ([show(value) for value in rows[column]] for column in (name, f"{name} after"))
        found.append(
            locate(table, rows).assign(measure=name, before=old, after=new, result="moved", distance=moved)
        )
    return worst(pd.concat([part for part in found if len(part)] or found[:1]))


def judged(table: Table, before: pd.DataFrame) -> dict[str, Rule]:
    """Return the rules of the columns that the baseline has; one without a value in any row is new."""
    blank = before.isna() | (before == "")
    return {
        name: rule for name, rule in table.rules.items() if name not in table.key and not blank[name].all()
    }


def locate(table: Table, rows: pd.DataFrame) -> pd.DataFrame:
    """Return a table of what moved, as far as the keys of rows say it."""
    found = pd.DataFrame({name: [value] * len(rows) for name, value in BLANK.items()})
    own = [name for name in ("scene", "method", "engine") if name in table.columns]
    rest = [name for name in table.key if name not in own]
    found[own] = rows[own].astype(str).to_numpy()
    found["setting"] = [" ".join(map(show, row)) for row in rows[rest].itertuples(index=False)]
    return found.assign(table=table.name)


def worst(found: pd.DataFrame) -> pd.DataFrame:
    """Return of each measure of a method on a scene the row that moved furthest, and of how many it is one."""
    where = ["table", "scene", "method", "engine", "measure"]
    found["rows"] = found.groupby(where)["measure"].transform("size")
    found = found.sort_values("distance", ascending=False, kind="stable").drop_duplicates(where)
    return found.drop(columns="distance").sort_index()


def show(value: Any) -> str:
    """Return a value as a cell has it."""
    return "" if pd.isna(value) else f"{value:.3g}" if isinstance(value, float | np.floating) else str(value)


def keys(table: Table, rows: pd.DataFrame) -> pd.MultiIndex:
    """Return the keys of a table's rows."""
    return pd.MultiIndex.from_frame(rows[list(table.key)])


# -- folders ---------------------------------------------------------------------------------------
def compare_folders(baseline: Path, fresh: Path) -> Findings:
    """Compare fresh tables with a folder of older ones: errors, counts, structure, status, missing rows.

    Raises `BadInput` for folders that hold no finished run, and for foreign or damaged tables.
    """
    before, now = ({name: read(table, side) for name, table in TABLES.items()} for side in (baseline, fresh))
    return compare_tables(before, benchmark_runs(baseline), now, benchmark_runs(fresh), str(baseline))


def compare_tables(before: Frames, made_before: Runs, now: Frames, made_now: Runs, name: str) -> Findings:
    """Compare tables by the runs behind them; `name` : what the older ones are called."""
    rank = max(PROFILES.index(run["profile"]) for run in made_now)
    larger = PROFILES[rank + 1 :]
    # a row that does not say which profile makes it is expected of every one
    expected = {table: rows[~rows["profile"].isin(larger)] for table, rows in before.items()}
    count = sum(map(len, expected.values()))
    if not count:
        raise BadInput(f"{name}: no row that a run of profile {PROFILES[rank]!r} makes")
    machines = {machine(run) for run in (*made_before, *made_now)}
    alike = len(machines) == 1 and "" not in machines
    moved = [compare(table, expected[each], now[each], alike) for each, table in TABLES.items()]
    counts = "exactly" if alike else "within a tenth: other processor or libraries"
    new = sum(
        int((~keys(table, now[each]).isin(keys(table, before[each]))).sum()) for each, table in TABLES.items()
    )
    compared = (
        f"accuracy: {count} rows of a {PROFILES[rank]} run compared with {name}, {new} have no baseline yet",
        f"counts of adaptive methods compared {counts}",
    )
    return sum(map(Findings, moved), Findings(compared=compared))


def benchmark_runs(results: Path) -> Runs:
    """Return the runs behind the tables of a folder.  Raises `BadInput` where there are none."""
    found = [run for run in provenance.runs(results) if run["profile"] in PROFILES]
    if not found:
        raise BadInput(f"{results / 'environment.json'}: missing; the folder holds no finished benchmark run")
    return found


def machine(run: dict[str, Any]) -> str:
    """Return what of a run's record can move counts, empty where its instructions are not known."""
    if not run.get("isa"):
        return ""
    packages = sorted((name, v) for name, v in run.get("packages", {}).items() if name not in IDLE_PACKAGES)
    return repr((run["isa"], run.get("cpu"), run.get("python"), packages))
