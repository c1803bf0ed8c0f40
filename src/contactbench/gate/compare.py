"""Compare two folders of tables by the rule of each column and list what moved too far."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from contactbench.errors import BadInput
from contactbench.measure.law import STRUCTURE
from contactbench.methods import METHODS
from contactbench.report.chapters import discovered
from contactbench.report.markdown import escaped
from contactbench.tables import provenance
from contactbench.tables.schema import PROFILES, TABLES, Rule, Table, floor
from contactbench.tables.store import OldTable, read, set_types

#: packages that solve nothing; two runs with other versions of them still count as one machine
IDLE_PACKAGES = ("contactbench", "pandas", "matplotlib", "pytest-benchmark")
#: a finding; "between" names the two sides, "rows" counts the values that moved; the worst of them is shown
type Row = dict[str, object]
TEXTS = ("between", "table", "scene", "method", "engine", "setting", "measure", "before", "after", "result")
BLANK: Row = {**dict.fromkeys(TEXTS, ""), "red": True, "rows": 1}
INCONCLUSIVE = "inconclusive"
type Frames = Mapping[str, pd.DataFrame]


def rows_of(*rows: Mapping[str, object]) -> pd.DataFrame:
    return pd.DataFrame([{**BLANK, **row} for row in rows], columns=[*BLANK])


@dataclass(frozen=True)
class Findings:
    """Hold the result of a comparison.

    moved : one row per measure that moved too far.  notes : remarks for the reader.  incomplete : reasons why part of
    the comparison is undecided.
    """

    moved: pd.DataFrame = field(default_factory=rows_of)
    notes: tuple[str, ...] = ()
    incomplete: tuple[str, ...] = ()

    def __add__(self, other: Findings) -> Findings:
        moved = [part for part in (self.moved, other.moved) if len(part)] or [self.moved]
        texts = self.notes + other.notes, self.incomplete + other.incomplete
        return Findings(pd.concat(moved, ignore_index=True), *texts)

    @property
    def red(self) -> int:
        return int(self.moved["red"].sum())

    @property
    def status(self) -> int:
        return 1 if self.red else 2 if self.incomplete else 0

    def as_json(self) -> str:
        found = {"status": self.status, "red": bool(self.red), "lines": self.moved.to_dict("records")}
        found |= {"notes": self.notes, "incomplete": self.incomplete}
        return json.dumps(found, allow_nan=False, ensure_ascii=False)

    def as_markdown(self) -> str:
        outcome = ("green", f"red, {self.red} found", INCONCLUSIVE)[self.status]
        rows = self.moved.sort_values("red", ascending=False, kind="stable")
        cells = rows.drop(columns="red").astype(str).map(escaped)
        cells["result"] = cells["result"].mask(rows["red"], "**" + cells["result"] + "**")
        texts = "\n".join(f"- {escaped(text)}" for text in (*self.incomplete, *self.notes))
        lines = [cells.columns, ["---"] * cells.shape[1], *cells.to_numpy()] if len(cells) else []
        grid = "\n".join(f"| {' | '.join(line)} |" for line in lines) or "Nothing moved."
        return f"# Regression gate: {outcome}\n\n{texts}\n\n{grid}\n"


# -- the moves that each rule (`schema.Rule`) allows --------------------------------------------------
#: largest factor between two errors above their floor
ERROR_FACTOR = 2.0
#: largest absolute change of a fitted order, and largest relative change of other values
ORDER_CHANGE, VALUE_CHANGE = 0.05, 0.01
#: largest relative change of counts with adaptive steps, and of the end of a run that failed
ADAPTIVE_SHARE = 0.1
#: largest relative change of counts where rounding decides when an iteration stops
ITERATION_SHARE = 0.05
#: a measured claim below this share of its bound counts as round-off
OF_BOUND = 1e-3


def distance(name: str, rule: Rule, rows: pd.DataFrame, alike: bool) -> np.ndarray:
    """Return the change of each value of a column in units of the allowed change; more than 1 is red."""
    before, after = rows[name], rows[f"{name} after"]
    if rule is Rule.same:
        moved = np.where((before == after).to_numpy(na_value=False), 0.0, math.inf)
    elif rule is Rule.profile:
        rank = {name: k for k, name in enumerate(PROFILES)}
        first, then = (side.map(rank).fillna(math.inf) for side in (before, after))
        moved = np.where((then <= first) & (then < math.inf), 0.0, math.inf)
    else:
        old, new = (pd.to_numeric(side).to_numpy(dtype=float, na_value=math.nan) for side in (before, after))
        with np.errstate(divide="ignore", invalid="ignore"):
            far = np.abs(new - old) / allowed(rule, old, rows, alike)
            least = floor(rule, rows)
            if rule is Rule.measured:  # an error if its claim is an upper bound, else a value
                own = name.removesuffix("measured")
                bound = rows[f"{own}bound"].abs().fillna(0.0).to_numpy()
                least = np.where(rows[f"{own}relation"] == "≤", np.maximum(STRUCTURE, OF_BOUND * bound), 0.0)
            ratio = np.abs(np.log(np.maximum(new, least) / np.maximum(old, least))) / math.log(ERROR_FACTOR)
        moved = np.where(old == new, 0.0, np.where(least > 0, ratio, far))
    blank = before.isna().to_numpy(), after.isna().to_numpy()
    moved = np.where(blank[0] & blank[1], 0.0, np.where(blank[0] ^ blank[1], math.inf, moved))
    return np.nan_to_num(moved, nan=math.inf, posinf=math.inf)


def allowed(rule: Rule, old: np.ndarray, rows: pd.DataFrame, alike: bool) -> np.ndarray | float:
    """Return the allowed change of values that are no errors."""
    size = np.abs(old)
    match rule:
        case Rule.order:
            return ORDER_CHANGE
        case Rule.end:
            return np.where(rows["status"] == "ok", 0.0, ADAPTIVE_SHARE * size)
        case Rule.point:
            curve = [rows[name] for name in ("figure", "panel", "curve")]
            largest = pd.Series(size, rows.index).groupby(curve).transform("max").fillna(0.0)
            return np.asarray(VALUE_CHANGE * largest + STRUCTURE)
        case Rule.count if alike:
            return 0.0
        case Rule.count:
            known = [METHODS.get(name) for name in rows["method"]]
            control = rows["control"] if "control" in rows else [getattr(m, "control", "") for m in known]
            iterates = [method is not None and method.iterates for method in known]
            share = np.select([np.array(control) == "rtol", iterates], [ADAPTIVE_SHARE, ITERATION_SHARE], 0.0)
            return np.where(share > 0, np.maximum(1.0, share * size), 0.0)
    return VALUE_CHANGE * size


def compare(table: Table, before: pd.DataFrame, after: pd.DataFrame, alike: bool = False) -> pd.DataFrame:
    """Return the rows missing from `after` and the worst move of each measure per method and scene."""
    if before.empty or before.equals(after):
        return rows_of()
    if after.empty:
        row = {"table": table.name, "measure": "table", "before": f"{len(before)} rows", "after": "none"}
        return rows_of(row | {"result": "missing"})
    both = before.merge(after, how="left", on=list(table.key), suffixes=("", " after"), indicator="side")
    gone, both = both[both["side"] == "left_only"], both[both["side"] == "both"]
    missing = locate(table, gone).assign(measure="row", before="present", after="none", result="missing")
    parts = [missing.assign(distance=math.inf)]
    same_end = (both["status"] == both["status after"]).to_numpy() if "status" in table.columns else True
    blank = both.isna() | (both == "")
    for name, rule in table.rules.items():
        if name in table.key or blank[name].all():
            continue  # a blank column of the baseline is new
        moved = distance(name, rule, both, alike)
        if name not in ("status", "profile"):  # a changed ending is red already; skip its numbers
            moved = np.where(same_end, moved, 0.0)
        if not (moved > 1).any():
            continue
        rows, moved = both[moved > 1], moved[moved > 1]
        old, new = ([show(value) for value in rows[column]] for column in (name, f"{name} after"))
        part = locate(table, rows).assign(measure=name, before=old, after=new, result="moved", distance=moved)
        parts.append(part)
    return worst(pd.concat([part for part in parts if len(part)] or parts[:1]))


def worst(found: pd.DataFrame) -> pd.DataFrame:
    where = ["table", "scene", "method", "engine", "measure"]
    found["rows"] = found.groupby(where)["measure"].transform("size")
    found = found.sort_values("distance", ascending=False, kind="stable").drop_duplicates(where)
    return found.drop(columns="distance").sort_index()


def locate(table: Table, rows: pd.DataFrame) -> pd.DataFrame:
    found = pd.DataFrame(BLANK | {"table": table.name}, index=range(len(rows)))
    own = [name for name in ("scene", "method", "engine") if name in table.columns]
    rest = [name for name in table.key if name not in own]
    found[own] = rows[own].astype(str).to_numpy()
    found["setting"] = [" ".join(map(show, row)) for row in rows[rest].itertuples(index=False)]
    return found


def show(value: object) -> str:
    return "" if pd.isna(value) else f"{value:.3g}" if isinstance(value, float | np.floating) else str(value)


def keys(table: Table, rows: pd.DataFrame) -> pd.MultiIndex:
    return pd.MultiIndex.from_frame(rows[list(table.key)])


def between(which: str, *parts: pd.DataFrame, listed: bool | None = None) -> Findings:
    """Label findings with the two sides compared; listed : whether a commit announces them, None if it cannot."""
    moved = sum(map(Findings, parts), Findings()).moved.assign(between=which)
    if listed is not None:
        moved["result"] += ", listed" if listed else ", not listed"
        moved["red"] = not listed
    return Findings(moved)


# -- two folders -------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Runs:
    """Describe the benchmark runs behind two folders of tables.

    profile : the largest profile of the second folder.  made : the largest profile of the first folder, by table.
    alike : whether one machine made both.
    """

    profile: str
    made: Mapping[str, str]
    alike: bool

    @classmethod
    def of(cls, before: Path, fresh: Path) -> Runs:
        runs, old = provenance.runs(fresh), provenance.runs(before)
        if not largest(runs):
            missing = "missing; the folder holds no finished benchmark run"
            raise BadInput(f"{fresh / 'environment.json'}: {missing}")
        machines = {machine(run) for run in (*old, *runs)}
        made = {name: largest(run for run in old if name in run["tables"]) for name in TABLES}
        return cls(largest(runs), made, len(machines) == 1 and "" not in machines)

    def expected(self, table: Table, rows: pd.DataFrame, now: pd.DataFrame) -> pd.DataFrame:
        """Return the rows that the fresh run made or had to make.

        It has to make every row of its own profile or a smaller one.  A table without a profile column is due as a
        whole unless a larger profile made it.  Times are never due, since a run may have no clock.
        """
        larger = PROFILES[PROFILES.index(self.profile) + 1 :]
        made = keys(table, rows).isin(keys(table, now))
        if "profile" in rows:
            return rows[~rows["profile"].isin(larger) | made]
        timed = {*table.columns} == {*table.key, *table.timed}
        return rows[made] if timed or self.made[table.name] in larger else rows


def largest(runs: Iterable[Mapping[str, Any]]) -> str:
    return max((run["profile"] for run in runs if run["profile"] in PROFILES), key=PROFILES.index, default="")


def machine(run: Mapping[str, Any]) -> str:
    """Return the processor and packages of a run, which decide its counts; empty if unknown."""
    if not run.get("isa"):
        return ""
    packages = sorted((name, v) for name, v in run.get("packages", {}).items() if name not in IDLE_PACKAGES)
    return repr((run["isa"], run.get("cpu"), run.get("python"), packages))


def readable(folder: Path) -> tuple[Frames, list[str]]:
    """Return the tables of a folder, and the names of the tables that it has in another layout."""
    discovered()  # questions may declare tables of their own
    frames, others = {}, []
    for name in TABLES:
        try:
            frames[name] = read(TABLES[name], folder)
        except OldTable:
            frames[name] = set_types(pd.DataFrame(columns=[*TABLES[name].columns]), TABLES[name])
            others.append(name)
    return frames, others


def compare_folders(baseline: Path, fresh: Path) -> Findings:
    (before, _), now = readable(baseline), {name: read(table, fresh) for name, table in TABLES.items()}
    found = compare_runs(before, now, Runs.of(baseline, fresh), "base → fresh")
    if not found.notes:
        raise BadInput(f"{baseline}: no row that a run of this profile makes")
    return found


def compare_runs(before: Frames, now: Frames, runs: Runs, which: str) -> Findings:
    """Compare a fresh run with the rows of a folder that it had to make; add a note unless there are none."""
    expected = {name: runs.expected(table, before[name], now[name]) for name, table in TABLES.items()}
    moved = [compare(table, expected[name], now[name], runs.alike) for name, table in TABLES.items()]
    count = sum(map(len, expected.values()))
    new = sum(int((~keys(t, now[n]).isin(keys(t, before[n]))).sum()) for n, t in TABLES.items())
    how = "exactly" if runs.alike else "within 10 % (iterations 5 %): another processor or other libraries"
    text = f"{which}: {count} rows of a {runs.profile} run compared, {new} have no baseline yet; counts {how}"
    return between(which, *moved) + Findings(notes=(text,) * (count > 0))
