"""What moved between two folders of tables, such as a fresh run and the committed tables.

How far a column may move is its rule (`schema.Rule`); which rows a fresh run must have, the rows before say
themselves (column `profile`), so that one that is no longer made is noticed.  A new table is gated by its
rules.  Which folders are compared is decided in judge.py.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype

from contactbench.errors import BadInput
from contactbench.gate.rules import change, moved, shown
from contactbench.gate.verdict import Line, Verdict
from contactbench.results import provenance
from contactbench.results.schema import PROFILES, TABLES, Rule, Table
from contactbench.results.store import read

#: values that move by less than this part of what is allowed are not listed
NOTABLE = 0.1
#: what a record may lack, or have, without being another machine: what solves nothing
IDLE_PACKAGES = ("contactbench", "pandas", "matplotlib", "pytest-benchmark")

Frames = Mapping[str, pd.DataFrame]


# -- rows ------------------------------------------------------------------------------------------
def subject(table: Table, row: pd.Series) -> dict[str, Any]:
    """Which row a line speaks of."""
    own = {name: str(row[name]) if name in table.columns else "" for name in ("scene", "method", "engine")}
    rest = [shown(row[name]) for name in table.key if name not in own]
    return {"table": table.name, **own, "setting": " ".join(rest)}


def gathered(lines: Iterable[tuple[float, Line]]) -> list[Line]:
    """One line for each measure of a method on a scene: its worst row."""
    worst: dict[tuple[Any, ...], tuple[float, Line]] = {}
    for distance, line in lines:
        key = (line.table, line.scene, line.method, line.engine, line.measure, line.red)
        seen = worst.get(key)
        rows = seen[1].rows + 1 if seen else 1
        keep = (distance, line) if seen is None or distance > seen[0] else seen
        worst[key] = (keep[0], replace(keep[1], rows=rows))
    return [line for _, line in worst.values()]


def judged(table: Table, before: pd.DataFrame) -> dict[str, Rule]:
    """The rules of the columns that the baseline has: one without a value in any row is new."""
    blank = {name for name in table.rules if name in before and is_blank(before[name]).all()}
    return {name: rule for name, rule in table.rules.items() if name not in {*blank, *table.key}}


def is_blank(values: pd.Series) -> pd.Series:
    return values.isna() if is_numeric_dtype(values.dtype) else values.isna() | (values == "")


def gone(table: Table, before: pd.DataFrame, missing: pd.DataFrame) -> Iterator[tuple[float, Line]]:
    """What is missing: the table, a whole scene or method of it, or single rows."""
    left = missing
    if len(missing) == len(before):
        line = Line(f"table {table.name}", f"{len(before)} rows", "none", "", "missing", True)
        yield math.inf, replace(line, table=table.name)
        return
    for name in ("scene", "method"):
        if name not in table.columns or not len(left):
            continue
        had, lost = before[name].value_counts(), missing[name].value_counts()
        for value in (str(value) for value in lost.index if value and lost[value] == had[value]):
            line = Line(f"{name} in {table.name}", f"{had[value]} rows", "none", "", "missing", True)
            line = replace(line, table=table.name)
            yield math.inf, replace(line, scene=value) if name == "scene" else replace(line, method=value)
            left = left[left[name] != value]
    for _, row in left.iterrows():
        line = Line(f"row of {table.name}", "present", "missing", "", "missing", True)
        yield math.inf, replace(line, **subject(table, row))


def compare(table: Table, before: pd.DataFrame, after: pd.DataFrame, alike: bool = False) -> list[Line]:
    """What is missing from `after` or moved; `before` has only rows that are expected.

    alike : both were made on the same processor with the same libraries.
    """
    if before.empty:
        return []
    key, after = list(table.key), after if len(after) else before.iloc[:0]
    both = before.merge(after, how="left", on=key, suffixes=("", " after"), indicator=True)
    found = [*gone(table, before, both[both["_merge"] == "left_only"])]
    both = both[both["_merge"] == "both"].reset_index(drop=True)
    same_end = (both["status"] == both["status after"]).to_numpy() if "status" in table.columns else True
    for name, rule in judged(table, both).items():
        distance = moved(rule, both[name], both[f"{name} after"], both, alike)
        if name not in ("status", "profile"):  # the numbers of a run that ended otherwise say nothing more
            distance = np.where(same_end, distance, 0.0)
        for i in np.flatnonzero(distance > NOTABLE):
            row, red = both.iloc[i], bool(distance[i] > 1)
            old, new = row[name], row[f"{name} after"]
            verdict = "moved" if red else "within limits"
            what = Line(name, shown(old), shown(new), change(rule, old, new), verdict, red)
            found.append((distance[i], replace(what, **subject(table, row))))
    return gathered(found)


def beyond(table: Table, before: pd.DataFrame, after: pd.DataFrame) -> int:
    """How many rows `after` has that `before` has not."""
    known = pd.MultiIndex.from_frame(before[list(table.key)])
    return int((~pd.MultiIndex.from_frame(after[list(table.key)]).isin(known)).sum())


# -- folders ---------------------------------------------------------------------------------------
def runs(results: Path) -> list[dict[str, Any]]:
    """The benchmark runs behind the tables of a folder.  Raises `BadInput` where there are none."""
    found = [run for run in provenance.runs(results) if run["profile"] in PROFILES]
    if not found:
        raise BadInput(f"{results / 'environment.json'}: missing; the folder holds no finished benchmark run")
    return found


def tables(results: Path) -> dict[str, pd.DataFrame]:
    """Every table of a folder.  Raises `BadInput` for foreign or damaged ones."""
    return {name: read(table, results) for name, table in TABLES.items()}


def accuracy(baseline: Path, fresh: Path) -> Verdict:
    """Fresh tables against a folder of older ones: errors, counts, structure, status, missing rows.

    Raises `BadInput` for folders that hold no finished run, and for foreign or damaged tables.
    """
    return against(tables(baseline), runs(baseline), tables(fresh), fresh, str(baseline))


def against(
    before: Frames, made_before: list[dict[str, Any]], now: Frames, fresh: Path, name: str
) -> Verdict:
    """The same with both sides' tables and the runs behind the older at hand; `name` : what those are called."""
    made_now = runs(fresh)
    rank = max(PROFILES.index(run["profile"]) for run in made_now)
    alike = surely_alike(made_before, made_now)
    lines: list[Line] = []
    expected_rows = new_rows = 0
    unvisited = []
    for table in TABLES.values():
        after = now[table.name]
        if before[table.name].empty and after.empty:
            continue
        # a row that does not say which profile makes it is expected of every one
        expected = before[table.name][~before[table.name]["profile"].isin(PROFILES[rank + 1 :])]
        lines += compare(table, expected, after, alike)
        expected_rows += len(expected)
        new_rows += beyond(table, before[table.name], after)
        unvisited += [f"{table.name}.{column}" for column in idle(table, before[table.name], expected)]
    if not expected_rows:
        raise BadInput(f"{name}: no row that a run of profile {PROFILES[rank]!r} makes")
    counts = "exactly" if alike else "within a tenth: other processor or libraries"
    sentence = (
        f"accuracy: {expected_rows} rows of a {PROFILES[rank]} run compared with {name}; "
        f"counts of adaptive methods compared {counts}"
    )
    notes = [f"{new_rows} rows have no baseline yet"] if new_rows else []
    if unvisited:
        notes.append(f"not seen by a {PROFILES[rank]} run: {', '.join(unvisited)}")
    return Verdict(tuple(lines), (sentence,), (*notes, *surroundings(made_before, made_now)))


def idle(table: Table, before: pd.DataFrame, expected: pd.DataFrame) -> list[str]:
    """The compared columns that have values, but none in a row that is expected."""
    return [name for name in judged(table, before) if is_blank(expected[name]).all()]


# -- machines --------------------------------------------------------------------------------------
def libraries(run: Any) -> str:
    solving = {k: v for k, v in run.get("packages", {}).items() if k not in IDLE_PACKAGES}
    return " ".join(f"{k} {v}" for k, v in sorted(solving.items()))


#: in what runs can differ that moves numbers
SURROUNDINGS: dict[str, Callable[[Any], str]] = {
    "processor": lambda run: " ".join(filter(None, (run.get("cpu", ""), run.get("isa", "")))),
    "Python": lambda run: run.get("python", ""),
    "references": lambda run: run.get("references", "")[:12],
    "packages": libraries,
}


def said(runs: list[dict[str, Any]], of: Callable[[Any], str]) -> str:
    return ", ".join(sorted({of(run) for run in runs}))


def surroundings(before: list[dict[str, Any]], now: list[dict[str, Any]]) -> list[str]:
    """In what two sets of runs differ that can move numbers."""
    pairs = [(name, said(before, of), said(now, of)) for name, of in SURROUNDINGS.items()]
    return [f"{name}: baseline {old}, fresh {new}" for name, old, new in pairs if old != new]


def surely_alike(before: list[dict[str, Any]], now: list[dict[str, Any]]) -> bool:
    """Whether all runs are of one processor, whose instructions are known, with the same libraries."""
    return all(run.get("isa") for run in (*before, *now)) and not surroundings(before, now)
