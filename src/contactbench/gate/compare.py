"""What moved between two folders of tables, by the rule of each column, as one table.

Which rows a fresh run must have, the rows before say themselves (column `profile`), so that one that is no longer
made is noticed.  A new table is gated by its rules.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from contactbench.errors import BadInput
from contactbench.measure.law import STRUCTURE
from contactbench.results import provenance
from contactbench.results.schema import PROFILES, SPREAD, TABLES, Rule, Table, floor
from contactbench.results.store import read

#: packages that solve nothing: runs may differ in them and be of one machine
IDLE_PACKAGES = ("contactbench", "pandas", "matplotlib", "pytest-benchmark")
#: what a row of the findings has where nothing else is given; rows : of how many values it is the worst
BLANK: dict[str, Any] = dict.fromkeys(("table", "scene", "method", "engine", "setting", "measure"), "")
BLANK |= {"before": "", "after": "", "result": "", "red": True, "rows": 1}
INCONCLUSIVE = "inconclusive"

Frames = Mapping[str, pd.DataFrame]
Runs = list[dict[str, Any]]


def rows_of(*rows: dict[str, Any]) -> pd.DataFrame:
    return pd.DataFrame([{**BLANK, **row} for row in rows], columns=[*BLANK])


@dataclass(frozen=True)
class Findings:
    """A row for each measure that moved, what was compared, what to know beside, and why it cannot be decided."""

    moved: pd.DataFrame = field(default_factory=rows_of)
    compared: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    incomplete: tuple[str, ...] = ()

    def __add__(self, other: Findings) -> Findings:
        moved = [part for part in (self.moved, other.moved) if len(part)] or [self.moved]
        texts = self.compared + other.compared, self.notes + other.notes, self.incomplete + other.incomplete
        return Findings(pd.concat(moved, ignore_index=True), *texts)

    @property
    def red(self) -> int:
        return int(self.moved["red"].sum())

    @property
    def status(self) -> int:
        return 1 if self.red else 2 if self.incomplete else 0

    def as_json(self) -> str:
        found = {"status": self.status, "red": bool(self.red), "lines": self.moved.to_dict("records")}
        found |= {"compared": self.compared, "notes": self.notes, "incomplete": self.incomplete}
        return json.dumps(found, allow_nan=False, ensure_ascii=False)

    def as_markdown(self) -> str:
        outcome = ("green", f"red, {self.red} found", INCONCLUSIVE)[self.status]
        rows = self.moved.sort_values("red", ascending=False, kind="stable")
        cells = rows.drop(columns="red").astype(str).map(escape)
        cells["result"] = cells["result"].mask(rows["red"], "**" + cells["result"] + "**")
        texts = "\n".join(f"- {escape(text)}" for text in (*self.compared, *self.incomplete, *self.notes))
        lines = [cells.columns, ["---"] * cells.shape[1], *cells.to_numpy()] if len(cells) else []
        grid = "\n".join(f"| {' | '.join(line)} |" for line in lines) or "Nothing moved."
        return f"# Regression gate: {outcome}\n\n{texts}\n\n{grid}\n"


def escape(text: str) -> str:
    return " ".join(text.replace("|", "\\|").replace("<", "&lt;").split())


# -- how far a column may move: it names its rule (`schema.Rule`), `LIMITS` has what that allows -------
#: by what factor an error may move, above its floor
FACTOR = 2.0
#: how far a slope or an order may move, and a quantity that is no error, relatively
SLOPE, VALUE = 0.05, 0.01
#: how far a count may move where a solver chooses its steps, or a run that did not end well, as a share
SHARE = 0.1
#: what a claim measures is round-off up to this share of its bound
OF_BOUND = 1e-3


def factor(before: np.ndarray, after: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """Return |log(after/before)| in parts of `FACTOR`, neither taken below the floor."""
    with np.errstate(invalid="ignore"):
        moved = np.abs(np.log(np.maximum(after, floor) / np.maximum(before, floor))) / math.log(FACTOR)
    return np.where(before == after, 0.0, moved)


def amount(before: np.ndarray, after: np.ndarray, allowed: np.ndarray | float) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(before == after, 0.0, np.abs(after - before) / allowed)


def count(before: np.ndarray, after: np.ndarray, rows: pd.DataFrame) -> np.ndarray:
    """Return |after − before|, where a solver chooses its steps in parts of a share or of twice their spread."""
    spread = rows[SPREAD].fillna(0.0).to_numpy(dtype=float) if SPREAD in rows else 0.0
    share = np.maximum(SHARE, 2 * spread) * before
    return amount(before, after, np.where(rows["control"] == "rtol", np.maximum(1.0, share), 0.0))


def point(before: np.ndarray, after: np.ndarray, rows: pd.DataFrame) -> np.ndarray:
    """Return |after − before| in parts of a share of the largest coordinate along the curve of each point."""
    curve = [rows[name] for name in ("figure", "panel", "curve")]
    largest = pd.Series(np.abs(before), rows.index).groupby(curve).transform("max").fillna(0.0).to_numpy()
    return amount(before, after, VALUE * largest + STRUCTURE)


def claim(before: np.ndarray, after: np.ndarray, rows: pd.DataFrame) -> np.ndarray:
    """Return how far what a claim measures moved: below an upper bound as an error, else as a value."""
    bound = pd.to_numeric(rows["bound"]).to_numpy(dtype=float, na_value=0.0)
    near = factor(before, after, np.maximum(STRUCTURE, OF_BOUND * np.abs(bound)))
    return np.where(rows["relation"] == "≤", near, amount(before, after, VALUE * np.abs(before)))


#: rule → how far a value moved, in parts of what is allowed, from the values before and after and the rows before
LIMITS: dict[Rule, Callable[[np.ndarray, np.ndarray, pd.DataFrame], np.ndarray]] = {
    Rule.error: lambda b, a, rows: factor(b, a, floor(Rule.error, rows)),
    Rule.structure: lambda b, a, rows: factor(b, a, floor(Rule.structure, rows)),
    Rule.count: count,
    Rule.value: lambda b, a, rows: amount(b, a, VALUE * np.abs(b)),
    Rule.order: lambda b, a, rows: amount(b, a, SLOPE),
    Rule.slope: lambda b, a, rows: np.where(rows["in_fit"], amount(b, a, SLOPE), 0.0),
    Rule.point: point,
    Rule.end: lambda b, a, rows: amount(b, a, np.where(rows["status"] == "ok", 0.0, SHARE * np.abs(b))),
    Rule.measured: claim,
}


def distance(rule: Rule, before: pd.Series, after: pd.Series, rows: pd.DataFrame, alike: bool) -> np.ndarray:
    """Return how far each value of a column moved, in parts of what its rule allows: red beyond 1."""
    if rule is Rule.same or (rule is Rule.count and alike):
        moved = np.where((before == after).to_numpy(na_value=False), 0.0, math.inf)
    elif rule is Rule.profile:
        rank = {name: k for k, name in enumerate(PROFILES)}
        first, then = (side.map(rank).fillna(math.inf) for side in (before, after))
        moved = np.where((then <= first) & (then < math.inf), 0.0, math.inf)
    else:
        old, new = (pd.to_numeric(side).to_numpy(dtype=float, na_value=math.nan) for side in (before, after))
        moved = LIMITS[rule](old, new, rows)
    blank = before.isna().to_numpy(), after.isna().to_numpy()
    moved = np.where(blank[0] & blank[1], 0.0, np.where(blank[0] ^ blank[1], math.inf, moved))
    return np.nan_to_num(moved, nan=math.inf, posinf=math.inf)


def compare(table: Table, before: pd.DataFrame, after: pd.DataFrame, alike: bool = False) -> pd.DataFrame:
    """Return what is missing from `after` or moved too far: the worst value of each measure of a method on a scene."""
    both = before.merge(after, how="left", on=list(table.key), suffixes=("", " after"), indicator="side")
    gone, both = both[both["side"] == "left_only"], both[both["side"] == "both"]
    if len(before) and both.empty:
        row = {"table": table.name, "measure": "table", "before": f"{len(before)} rows", "after": "none"}
        return rows_of(row | {"result": "missing"})
    missing = locate(table, gone).assign(measure="row", before="present", after="none", result="missing")
    parts = [missing.assign(distance=math.inf)]
    same_end = (both["status"] == both["status after"]).to_numpy() if "status" in table.columns else True
    blank = both.isna() | (both == "")
    for name, rule in table.rules.items():
        if name in table.key or blank[name].all():  # the baseline does not have it: it is new
            continue
        moved = distance(rule, both[name], both[f"{name} after"], both, alike)
        if name not in ("status", "profile"):  # the numbers of a run that ended otherwise say nothing more
            moved = np.where(same_end, moved, 0.0)
        rows, moved = both[moved > 1], moved[moved > 1]
        old, new = ([show(value) for value in rows[column]] for column in (name, f"{name} after"))
        part = locate(table, rows).assign(measure=name, before=old, after=new, result="moved", distance=moved)
        parts.append(part)
    found = pd.concat([part for part in parts if len(part)] or parts[:1])
    where = ["table", "scene", "method", "engine", "measure"]
    found["rows"] = found.groupby(where)["measure"].transform("size")
    worst = found.sort_values("distance", ascending=False, kind="stable").drop_duplicates(where)
    return worst.drop(columns="distance").sort_index()


def locate(table: Table, rows: pd.DataFrame) -> pd.DataFrame:
    found = pd.DataFrame(BLANK | {"table": table.name}, index=range(len(rows)))
    own = [name for name in ("scene", "method", "engine") if name in table.columns]
    rest = [name for name in table.key if name not in own]
    found[own] = rows[own].astype(str).to_numpy()
    found["setting"] = [" ".join(map(show, row)) for row in rows[rest].itertuples(index=False)]
    return found


def show(value: Any) -> str:
    return "" if pd.isna(value) else f"{value:.3g}" if isinstance(value, float | np.floating) else str(value)


def keys(table: Table, rows: pd.DataFrame) -> pd.MultiIndex:
    return pd.MultiIndex.from_frame(rows[list(table.key)])


def compare_folders(baseline: Path, fresh: Path) -> Findings:
    before, now = ({name: read(table, side) for name, table in TABLES.items()} for side in (baseline, fresh))
    return compare_tables(before, benchmark_runs(baseline), now, benchmark_runs(fresh), str(baseline))


def compare_tables(before: Frames, made_before: Runs, now: Frames, made_now: Runs, name: str) -> Findings:
    rank = max(PROFILES.index(run["profile"]) for run in made_now)
    larger = PROFILES[rank + 1 :]
    # a row that does not say which profile makes it is expected of every one
    expected = {table: rows[~rows["profile"].isin(larger)] for table, rows in before.items()}
    count = sum(map(len, expected.values()))
    if not count:
        raise BadInput(f"{name}: no row that a run of profile {PROFILES[rank]!r} makes")
    machines = {machine(run) for run in (*made_before, *made_now)}
    alike = len(machines) == 1 and "" not in machines
    moved, new = [], 0
    for each, table in TABLES.items():
        moved.append(Findings(compare(table, expected[each], now[each], alike)))
        new += int((~keys(table, now[each]).isin(keys(table, before[each]))).sum())
    counts = "exactly" if alike else "within a tenth: other processor or libraries"
    compared = (
        f"accuracy: {count} rows of a {PROFILES[rank]} run compared with {name}, {new} have no baseline yet",
        f"counts of adaptive methods compared {counts}",
    )
    return sum(moved, Findings(compared=compared))


def benchmark_runs(results: Path) -> Runs:
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
