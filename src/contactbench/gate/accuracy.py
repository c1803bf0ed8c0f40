"""The regression gate: what moved between a fresh run and the committed tables, and what got slower.

Accuracy reads two folders of tables and nothing else.  How far a column may move is its rule
(`schema.Rule`); which rows a fresh run must have, the committed rows say themselves (column
`profile`), so that one that is no longer made is noticed.  A new table is gated by its rules.
Speed is in speed.py.
"""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from contactbench.errors import BadInput
from contactbench.gate import speed
from contactbench.report.cells import DASH
from contactbench.report.markdown import grid
from contactbench.results import provenance
from contactbench.results.round_off import floor
from contactbench.results.schema import PROFILES, SPREAD, TABLES, Rule, Table
from contactbench.results.store import read

#: how far an error may move, in decades: a factor of two
DECADES = 0.3
#: how far a slope may move in the asymptotic range; other rounding moves it by 0.001
SLOPE = 0.05
#: how far a quantity that is no error may move, relatively
VALUE = 0.01
#: how far a count may move where a solver chooses its steps, as a share, and at least by one
SHARE = 0.1
#: values that move by less than this part of what is allowed are not listed
NOTABLE = 0.1
#: such values listed at most
LISTED = 20
PARTS = ("accuracy", "speed")


@dataclass(frozen=True)
class Line:
    """One thing that moved: a measure of a method on a scene, the worst of `rows` rows of a table."""

    measure: str
    before: str
    after: str
    change: str
    verdict: str
    red: bool
    scene: str = ""
    method: str = ""
    engine: str = ""
    setting: str = ""
    table: str = ""
    rows: int = 1


@dataclass(frozen=True)
class Verdict:
    """What the gate found: the lines, what was compared (one sentence a part), and what to know beside."""

    lines: tuple[Line, ...]
    compared: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def red(self) -> bool:
        return any(line.red for line in self.lines)

    def __add__(self, other: Verdict) -> Verdict:
        return Verdict(
            self.lines + other.lines, self.compared + other.compared, tuple({*self.notes, *other.notes})
        )

    def as_json(self) -> str:
        found = {"red": self.red, **asdict(self)}
        return json.dumps(found, allow_nan=False, ensure_ascii=False)

    def as_markdown(self) -> str:
        """The verdict, one table of what moved and by how much, and the notes."""
        red = sum(line.red for line in self.lines)
        title = f"# Regression gate: {f'red, {red} found' if red else 'green'}"
        listed = sorted(self.lines, key=lambda line: (not line.red, line.verdict != "inconclusive"))
        unlisted = max(0, len(listed) - max(red, LISTED))
        rows = [
            [
                line.scene or DASH, line.method or DASH, line.measure, line.engine or DASH,
                line.setting + (f" (worst of {line.rows})" if line.rows > 1 else ""),
                line.before, line.after, line.change, f"**{line.verdict}**" if line.red else line.verdict,
            ]
            for line in listed[: max(red, LISTED)]
        ]  # fmt: skip
        head = ["scene", "method", "measure", "engine", "setting", "before", "after", "change", "verdict"]
        parts = [title, "\n".join(f"- {sentence}" for sentence in self.compared)]
        parts += [grid(head, rows)] if rows else ["Nothing moved."]
        parts += [f"{unlisted} more moved within their limits."] if unlisted else []
        parts += ["\n".join(f"- {note}" for note in sorted(self.notes))] if self.notes else []
        return "\n\n".join(parts) + "\n"


# -- rules -----------------------------------------------------------------------------------------
def decades(before: np.ndarray, after: np.ndarray, floor: np.ndarray | float) -> np.ndarray:
    """|log10(after/before)| in parts of what is allowed, neither taken below the floor."""
    with np.errstate(invalid="ignore"):
        moved = np.abs(np.log10(np.maximum(after, floor) / np.maximum(before, floor))) / DECADES
    return np.where(before == after, 0.0, moved)


def counts(before: np.ndarray, after: np.ndarray, rows: pd.DataFrame) -> np.ndarray:
    """How far counts moved in parts of what is allowed: twice what roundings of the initial data do to them
    where that was measured to be more."""
    chosen = (rows["control"] == "rtol").to_numpy()
    spread = rows[SPREAD].fillna(0.0).to_numpy() if SPREAD in rows else 0.0
    allowed = np.where(chosen, np.maximum(1.0, np.maximum(SHARE, 2 * spread) * before), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(before == after, 0.0, np.abs(after - before) / allowed)


def values(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Relative change in parts of what is allowed; a limit may be infinite."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(before == after, 0.0, np.abs(after / before - 1) / VALUE)


MOVED: dict[Rule, Callable[[np.ndarray, np.ndarray, pd.DataFrame], np.ndarray]] = {
    Rule.error: lambda before, after, rows: decades(before, after, floor(Rule.error, rows)),
    Rule.structure: lambda before, after, rows: decades(before, after, floor(Rule.structure, rows)),
    Rule.count: counts,
    Rule.value: lambda before, after, rows: values(before, after),
    Rule.slope: lambda before, after, rows: np.where(rows["in_fit"], np.abs(after - before) / SLOPE, 0.0),
}


def moved(rule: Rule, before: pd.Series, after: pd.Series, rows: pd.DataFrame) -> np.ndarray:
    """How far each value of a column moved, in parts of what its rule allows: red beyond 1.

    rows : the rows before.  A value that is blank on one side only moved beyond all limits.
    """
    blank = before.isna().to_numpy(), after.isna().to_numpy()
    if rule is Rule.same:
        distance = np.where((before == after).to_numpy(na_value=False), 0.0, math.inf)
    else:
        old, new = (pd.to_numeric(side).to_numpy(dtype=float, na_value=math.nan) for side in (before, after))
        distance = MOVED[rule](old, new, rows)
    distance = np.where(blank[0] & blank[1], 0.0, np.where(blank[0] ^ blank[1], math.inf, distance))
    return np.nan_to_num(distance, nan=math.inf, posinf=math.inf)


def change(rule: Rule, before: Any, after: Any) -> str:
    """By how much, in words that fit the measure."""
    if rule is Rule.same or pd.isna(before) or pd.isna(after):
        return ""
    if rule in (Rule.error, Rule.structure):
        return f"×{after / before:.3g}" if before else "from 0"
    return f"{after - before:+.3g}"


def shown(value: Any) -> str:
    if pd.isna(value):
        return DASH
    return f"{value:.3g}" if isinstance(value, float | np.floating) else str(value)


# -- accuracy --------------------------------------------------------------------------------------
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
    return values.isna() | (values == "")


def compare(table: Table, before: pd.DataFrame, after: pd.DataFrame) -> list[Line]:
    """What is missing from `after` or moved; `before` has only rows that are expected."""
    if before.empty:
        return []
    key, after = list(table.key), after if len(after) else before.iloc[:0]
    both = before.merge(after, how="left", on=key, suffixes=("", " after"), indicator=True)
    found: list[tuple[float, Line]] = []
    for _, row in both[both["_merge"] == "left_only"].iterrows():
        what = Line(f"row of {table.name}", "present", "missing", "", "missing", red=True)
        found.append((math.inf, replace(what, **subject(table, row))))
    both = both[both["_merge"] == "both"].reset_index(drop=True)
    same_end = (both["status"] == both["status after"]).to_numpy() if "status" in table.columns else True
    for name, rule in judged(table, both).items():
        distance = moved(rule, both[name], both[f"{name} after"], both)
        if name != "status":  # the numbers of a run that ended otherwise say nothing more
            distance = np.where(same_end, distance, 0.0)
        for i in np.flatnonzero(distance > NOTABLE):
            row, red = both.iloc[i], bool(distance[i] > 1)
            old, new = row[name], row[f"{name} after"]
            verdict = "moved" if red else "within limits"
            what = Line(name, shown(old), shown(new), change(rule, old, new), verdict, red)
            found.append((distance[i], replace(what, **subject(table, row))))
    return gathered(found)


def runs(results: Path) -> list[dict[str, Any]]:
    """The benchmark runs behind the tables of a folder.  Raises `BadInput` where there are none."""
    found = [run for run in provenance.runs(results) if run["profile"] in PROFILES]
    if not found:
        raise BadInput(f"{results / 'environment.json'}: missing; the folder holds no finished benchmark run")
    return found


def accuracy(baseline: Path, fresh: Path) -> Verdict:
    """Fresh tables against a baseline: errors, counts, structure, status, missing rows.

    Raises `BadInput` for folders that hold no finished run, and for foreign or corrupted tables.
    """
    made_before, made_now = runs(baseline), runs(fresh)
    rank = max(PROFILES.index(run["profile"]) for run in made_now)
    lines: list[Line] = []
    expected_rows = new_rows = 0
    for table in TABLES.values():
        before, after = read(table, baseline), read(table, fresh)
        expected = before[before["profile"].isin(PROFILES[: rank + 1])]
        lines += compare(table, expected, after)
        expected_rows += len(expected)
        known = pd.MultiIndex.from_frame(before[list(table.key)])
        new_rows += int((~pd.MultiIndex.from_frame(after[list(table.key)]).isin(known)).sum())
    if not expected_rows:
        raise BadInput(f"{baseline}: no row that a run of profile {PROFILES[rank]!r} makes")
    sentence = f"accuracy: {expected_rows} rows of a {PROFILES[rank]} run compared with {baseline}"
    new = (f"{new_rows} rows have no baseline yet",) if new_rows else ()
    return Verdict(tuple(lines), (sentence,), (*new, *surroundings(made_before, made_now)))


def surroundings(before: list[dict[str, Any]], now: list[dict[str, Any]]) -> list[str]:
    """In what two sets of runs differ that can move numbers."""

    def said(runs: list[dict[str, Any]], of: Callable[[Any], str]) -> str:
        return ", ".join(sorted({of(run) for run in runs}))

    def packages(run: Any) -> str:
        return " ".join(f"{k} {v}" for k, v in sorted(run.get("packages", {}).items()) if k != "contactbench")

    asked: dict[str, Callable[[Any], str]] = {
        "processor": lambda run: run.get("cpu", ""),
        "Python": lambda run: run.get("python", ""),
        "references": lambda run: run.get("references", "")[:12],
        "packages": packages,
    }
    pairs = [(name, said(before, of), said(now, of)) for name, of in asked.items()]
    return [f"{name}: baseline {old}, fresh {new}" for name, old, new in pairs if old != new]


def fresh_run(root: Path, results: Path) -> list[Line]:
    """Run the smoke profile of the benchmark in `root`, untimed and on all cores; a line if a cell failed.

    Raises `BadInput` when the benchmark cannot run at all.
    """
    if not (root / "bench" / "conftest.py").exists():
        raise BadInput(f"{root}: no benchmark there; run the gate where bench/ is, or give --fresh DIR")
    command = [
        sys.executable, "-m", "pytest", "bench", "--profile", "smoke", "--results", str(results),
        "-v", "-n", "auto", "--dist", "loadgroup", "--benchmark-disable", "-p", "no:cacheprovider",
    ]  # fmt: skip
    lines, status = followed(command, root)
    last = next(filter(None, (line.strip() for line in reversed(lines))), "no output")
    if status > 1:
        raise BadInput(f"the benchmark did not run (pytest exit {status}): {last}")
    if status == 0:
        return []
    failed = "; ".join(line[7:160] for line in lines if line.startswith("FAILED "))
    return [Line("benchmark run", "passed", "failed", failed or last, "failed", red=True)]


def followed(command: list[str], root: Path) -> tuple[list[str], int]:
    """What pytest printed and its exit status; a terminal is shown how far it is."""
    from tqdm import tqdm

    lines = []
    with (
        subprocess.Popen(
            command, cwd=root, env=speed.environment(root), text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        ) as run,
        tqdm(total=100, desc="smoke run", unit="%", disable=None) as bar,
    ):  # fmt: skip
        assert run.stdout is not None
        for line in run.stdout:
            lines.append(line)
            done = re.match(r"\[gw\d+\] \[ *(\d+)%\]", line)
            bar.update(int(done[1]) - bar.n if done else 0)
    return lines, run.returncode


# -- speed -----------------------------------------------------------------------------------------
def slower(root: Path, baseline: Path, revision: str | None) -> Verdict:
    """The working tree in `root` against a revision of it, on cells of the baseline's work–precision table."""
    cells = speed.workload(read(TABLES["work_precision"], baseline))
    if not cells:
        raise BadInput(f"{baseline}: no timed rows to choose from; run the benchmark first (tox -e bench)")
    found = speed.compare_revisions(root, revision, cells)
    lines = [
        Line(
            "time", "×1", f"×{ratio.ratio:.2f}", f"×{ratio.low:.2f} … ×{ratio.high:.2f}", verdict,
            verdict == "slower", cell.scene, cell.method, cell.engine, cell.setting,
        )
        for cell, ratio, verdict in found.judged
        if verdict != "pass"
    ]  # fmt: skip
    middle = float(np.median([ratio.ratio for _, ratio, _ in found.judged]))
    sentence = (
        f"speed: {len(found.judged)} cells of {found.head} against {found.base}, median ratio {middle:.3f}; "
        f"red when the whole 95 % interval is above {speed.LIMIT} twice, in fresh processes"
    )
    notes = [f"{cell.scene} {cell.method} ({cell.engine}) not timed: {why}" for cell, why in found.refused]
    return Verdict(tuple(lines), (sentence,), tuple(notes))


def gate(
    root: Path, baseline: Path, fresh: Path | None, revision: str | None, parts: Iterable[str] = PARTS
) -> Verdict:
    """Run the parts asked for; see the command line's help."""
    verdict = Verdict((), ())
    if "speed" in parts:  # what cannot run is said before minutes are spent
        speed.resolved(speed.repository(root), revision)
    if "accuracy" in parts:
        runs(baseline)
        if fresh is not None:
            verdict += accuracy(baseline, fresh)
        else:
            with tempfile.TemporaryDirectory(prefix="contactbench-gate-") as scratch:
                failed = fresh_run(root, Path(scratch))
                verdict += Verdict(tuple(failed), ()) + accuracy(baseline, Path(scratch))
    if "speed" in parts:
        verdict += slower(root, baseline, revision)
    return verdict
