"""What moved between two folders of tables, by the rule of each column, as one table."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from contactbench.errors import BadInput
from contactbench.gate.removed import Removed
from contactbench.measure.law import STRUCTURE
from contactbench.methods import METHODS
from contactbench.report.markdown import escaped
from contactbench.tables import provenance
from contactbench.tables.schema import PROFILES, SPREAD, TABLES, Rule, Table, floor
from contactbench.tables.store import read

#: packages that solve nothing: runs may differ in them and be of one machine
IDLE_PACKAGES = ("contactbench", "pandas", "matplotlib", "pytest-benchmark")
#: what a row of the findings has where nothing else is given; rows : of how many values it is the worst
#: between : which two were compared
type Row = dict[str, object]
TEXTS = ("between", "table", "scene", "method", "engine", "setting", "measure", "before", "after", "result")
BLANK: Row = {**dict.fromkeys(TEXTS, ""), "red": True, "rows": 1}
INCONCLUSIVE = "inconclusive"

#: the record of a run, as `provenance` has it
type Run = dict[str, Any]
type Frames = Mapping[str, pd.DataFrame]


def rows_of(*rows: Mapping[str, object]) -> pd.DataFrame:
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
        cells = rows.drop(columns="red").astype(str).map(escaped)
        cells["result"] = cells["result"].mask(rows["red"], "**" + cells["result"] + "**")
        texts = "\n".join(f"- {escaped(text)}" for text in (*self.compared, *self.incomplete, *self.notes))
        lines = [cells.columns, ["---"] * cells.shape[1], *cells.to_numpy()] if len(cells) else []
        grid = "\n".join(f"| {' | '.join(line)} |" for line in lines) or "Nothing moved."
        return f"# Regression gate: {outcome}\n\n{texts}\n\n{grid}\n"


# -- how far a column may move: it names its rule (`schema.Rule`), `LIMITS` has what that allows -------
#: by what factor an error may move, above its floor
FACTOR = 2.0
#: how far a slope or an order may move, and a quantity that is no error, relatively
SLOPE, VALUE = 0.05, 0.01
#: how far a count may move where a solver chooses its steps, or a run that did not end well, as a share; and where a
#: method iterates until nothing changes, which rounding decides
SHARE, ITERATIONS = 0.1, 0.05
#: what a claim measures is round-off up to this share of its bound
OF_BOUND = 1e-3
#: by what factor the times of a method may move against those of its table: the median of at least so many rows;
#: a table with fewer pairs than `PAIRS` is not judged
TIMES, ROWS, PAIRS = 2.0, 3, 8


def factor(before: np.ndarray, after: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """Return |log(after/before)| in parts of `FACTOR`, neither taken below the floor."""
    with np.errstate(invalid="ignore"):
        moved = np.abs(np.log(np.maximum(after, floor) / np.maximum(before, floor))) / math.log(FACTOR)
    return np.where(before == after, 0.0, moved)


def amount(before: np.ndarray, after: np.ndarray, allowed: np.ndarray | float) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(before == after, 0.0, np.abs(after - before) / allowed)


def count(before: np.ndarray, after: np.ndarray, rows: pd.DataFrame) -> np.ndarray:
    """Return |after − before|, in parts of a share where a solver chooses its steps, or how often it iterates.

    The share of chosen steps is at least twice their spread.
    """
    spread = rows[SPREAD].fillna(0.0).to_numpy(dtype=float) if SPREAD in rows else 0.0
    share = np.maximum(SHARE, 2 * spread) * before
    iterates = rows["method"].map(lambda name: name in METHODS and METHODS[name].iterates)
    allowed = np.where(iterates, np.maximum(1.0, ITERATIONS * before), 0.0)
    return amount(before, after, np.where(rows["control"] == "rtol", np.maximum(1.0, share), allowed))


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


def compare(
    table: Table, before: pd.DataFrame, after: pd.DataFrame, alike: bool = False, only: Collection[Rule] = ()
) -> pd.DataFrame:
    """Return what is missing from `after` or moved too far: the worst value of each measure of a method on a scene.

    only : the rules of the columns to compare, missing rows left out; all of both where none is given.
    """
    both = before.merge(after, how="left", on=list(table.key), suffixes=("", " after"), indicator="side")
    gone, both = both[both["side"] == "left_only"], both[both["side"] == "both"]
    if len(before) and after.empty and not only:
        row = {"table": table.name, "measure": "table", "before": f"{len(before)} rows", "after": "none"}
        return rows_of(row | {"result": "missing"})
    missing = locate(table, gone[:0] if only else gone)
    missing = missing.assign(measure="row", before="present", after="none", result="missing")
    parts = [missing.assign(distance=math.inf)]
    same_end = (both["status"] == both["status after"]).to_numpy() if "status" in table.columns else True
    blank = both.isna() | (both == "")
    for name, rule in table.rules.items():
        if rule is Rule.time or (only and rule not in only) or name in table.key or blank[name].all():
            continue  # a column that the baseline does not have is new
        moved = distance(rule, both[name], both[f"{name} after"], both, alike)
        if name not in ("status", "profile"):  # the numbers of a run that ended otherwise say nothing more
            moved = np.where(same_end, moved, 0.0)
        rows, moved = both[moved > 1], moved[moved > 1]
        old, new = ([show(value) for value in rows[column]] for column in (name, f"{name} after"))
        part = locate(table, rows).assign(measure=name, before=old, after=new, result="moved", distance=moved)
        parts.append(part)
    found = pd.concat([part for part in parts if len(part)] or parts[:1])
    return worst(found)


def worst(found: pd.DataFrame) -> pd.DataFrame:
    where = ["table", "scene", "method", "engine", "measure"]
    found["rows"] = found.groupby(where)["measure"].transform("size")
    found = found.sort_values("distance", ascending=False, kind="stable").drop_duplicates(where)
    return found.drop(columns="distance").sort_index()


def compare_times(table: Table, before: pd.DataFrame, after: pd.DataFrame) -> pd.DataFrame:
    """Return the methods whose times moved against those of the other methods of a table."""
    both, found = before.merge(after, on=list(table.key), suffixes=("", " after")), []
    for name in [name for name, rule in table.rules.items() if rule is Rule.time]:
        pairs = [both[column].to_numpy(dtype=float, na_value=math.nan) for column in (name, f"{name} after")]
        old, new = (np.where(times > 0, times, math.nan) for times in pairs)
        moved = pd.Series(np.log(new / old), both.index).dropna()
        if len(moved) < PAIRS:
            continue
        where = [both.loc[moved.index, key] for key in ("method", "engine")]
        ratios = (moved - moved.median()).groupby(where).agg(["median", "size"])
        moved = (ratios["median"].abs() > math.log(TIMES)) & (ratios["size"] >= ROWS)
        for (method, engine), (ratio, count) in ratios[moved].iterrows():
            row = {"table": table.name, "method": method, "engine": engine, "measure": name, "before": "×1"}
            found.append(row | {"after": f"×{math.exp(ratio):.2f}", "result": "moved", "rows": int(count)})
    return rows_of(*found)


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
    """Return what moved between two; listed : whether the change is meant, None where that is no excuse."""
    moved = sum(map(Findings, parts), Findings()).moved.assign(between=which)
    if listed is not None:
        moved["result"] += ", listed" if listed else ", not listed"
        moved["red"] = not listed
    return Findings(moved)


@dataclass(frozen=True)
class Runs:
    """What two folders of tables were made by: the profile of the second, and whether both are of one machine."""

    profile: str
    alike: bool

    @classmethod
    def of(cls, before: Path, fresh: Path) -> Runs:
        made = [run for run in provenance.runs(fresh) if run["profile"] in PROFILES]
        if not made:
            missing = "missing; the folder holds no finished benchmark run"
            raise BadInput(f"{fresh / 'environment.json'}: {missing}")
        machines = {machine(run) for run in (*provenance.runs(before), *made)}
        profile = max((run["profile"] for run in made), key=PROFILES.index)
        return cls(profile, len(machines) == 1 and "" not in machines)

    def expected(self, table: Table, rows: pd.DataFrame, now: pd.DataFrame) -> pd.DataFrame:
        """Return the rows that a run has to make: those of its profile, or of none, and those it did make."""
        larger = PROFILES[PROFILES.index(self.profile) + 1 :]
        return rows[~rows["profile"].isin(larger) | keys(table, rows).isin(keys(table, now))]


def compare_folders(baseline: Path, fresh: Path) -> Findings:
    removed = Removed.read(fresh)
    before = {name: removed.take_out(table, read(table, baseline)) for name, table in TABLES.items()}
    now = {name: read(table, fresh) for name, table in TABLES.items()}
    return compare_fresh(before, now, Runs.of(baseline, fresh), str(baseline))


def compare_fresh(before: Frames, now: Frames, runs: Runs, name: str) -> Findings:
    """Compare a fresh run with the rows of a baseline that it has to make."""
    expected = {each: runs.expected(table, before[each], now[each]) for each, table in TABLES.items()}
    count = sum(map(len, expected.values()))
    if not count:
        raise BadInput(f"{name}: no row that a run of profile {runs.profile!r} makes")
    moved = (compare(table, expected[n], now[n], runs.alike) for n, table in TABLES.items())
    new = sum(int((~keys(t, now[n]).isin(keys(t, before[n]))).sum()) for n, t in TABLES.items())
    counts = (
        "exactly" if runs.alike else "within a tenth, of iterations a twentieth: other processor or libraries"
    )
    texts = (
        f"accuracy: {count} rows of a {runs.profile} run compared with {name}, {new} have no baseline yet",
        f"counts of adaptive methods compared {counts}",
    )
    return between("base → fresh", *moved) + Findings(compared=texts)


def machine(run: Run) -> str:
    """Return what of a run's record can move counts, empty where its instructions are not known."""
    if not run.get("isa"):
        return ""
    packages = sorted((name, v) for name, v in run.get("packages", {}).items() if name not in IDLE_PACKAGES)
    return repr((run["isa"], run.get("cpu"), run.get("python"), packages))
