"""Cost at equal error: what each error costs every method, who is cheapest, and up to which ratio two costs tie.

Three kinds of cost are compared and never mixed: evaluations (the engine does not matter), time of compiled engines,
and time of solvers that call back into Python.  A method is of the family its rows declare.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol, cast

import numpy as np
import pandas as pd

from contactbench.measure.statistics import (
    COUNTED,
    Verdict,
    envelope,
    interpolate,
    margin,
    process_spread,
    verdict,
)
from contactbench.report.look import CONTACT as CONTACT
from contactbench.scene.rigid_body import FREE_COST, MOMENTUM_COST
from contactbench.solution import EXACT, PILOTS

#: errors at which methods are compared
TARGETS = (1e-3, 1e-6, 1e-9, 1e-12)
#: the winner of a contest of two sides
OURS, OTHER = "ours", "other"
CALLBACKS = ("python", "c+python")
#: statuses of runs that our own limits ended: a finer setting might be more accurate
CUT = ("budget", "timeout")
#: one integrator of two makers: where engines do not matter one contestant
SAME_INTEGRATOR = {"scipy-dop853": "dop853", "cyrk-dop853": "dop853"}
#: cells of an engine timed by two processes from which on it has a spread of its own
ENOUGH = 8
#: the difference of two times is resolved where its own halves agree within this; else it is noise of what is fixed
RESOLVED = 1.5

#: the columns of a row
type Record = dict[str, Any]


@dataclass(frozen=True)
class Kind:
    """A kind of cost, declared in kinds.toml.

    cost, halves, processes : its column, those of the ratio of a cell's halves, and of a second process to the first.
    by : who sets a method to an error: an oracle, or a tolerance that each is given, contact methods by their pilots.
    resolved : neither a cost whose halves differ by more than `RESOLVED` takes part, nor a closed form.
    """

    name: str
    title: str
    cost: str
    engines: Literal["any", "compiled", "callbacks"]
    about: str
    timed: bool = True
    halves: str = "time_halves_ratio"
    processes: str = "time_process_ratio"
    resolved: bool = False
    by: Literal["oracle", "tolerance"] = "oracle"

    def compares(self, rows: pd.DataFrame) -> pd.Series:
        pilots = rows["variant"].fillna("") == PILOTS
        chosen = pilots | rows["control"].isin(["rtol", EXACT]) if self.by == "tolerance" else ~pilots
        if self.engines != "any":
            chosen &= rows["engine"].isin(CALLBACKS) == (self.engines == "callbacks")
        if self.resolved:
            halves = rows[self.halves].astype(float)
            chosen &= (rows["control"] != EXACT) & halves.between(1 / RESOLVED, RESOLVED)
        return chosen

    def process_spread(self, rows: pd.DataFrame, engine: str = "") -> float:
        """Return by what factor two processes differ on an engine; on all where few of its cells were timed twice."""
        if not self.timed:
            return COUNTED
        own = rows[rows["engine"] == engine]
        sample = own if own[self.processes].notna().sum() >= ENOUGH else rows
        return process_spread(*(sample[name].astype(float) for name in (self.processes, self.halves)))


DECLARED = tomllib.loads(Path(__file__).with_name("kinds.toml").read_text(encoding="utf-8"))
ROTATIONS = {"free": FREE_COST, "momentum": MOMENTUM_COST}
KINDS = tuple(
    Kind(name, **given | {"about": given["about"].format(**ROTATIONS)}) for name, given in DECLARED.items()
)
EVALUATIONS, COMPILED, MARGINAL, CALLED_BACK, *BY_TOLERANCE = KINDS


class Cost(Protocol):
    """A row of `costs`, read by its columns."""

    scene: str
    method: str
    error: float
    cost: float
    bound: bool
    reason: str
    fixed: float
    halves: float
    processes: float
    verdict: str


def cost_rows(frame: pd.DataFrame) -> list[Cost]:
    return cast(list[Cost], list(frame.itertuples(index=False)))


def costs(rows: pd.DataFrame, kind: Kind, keys: Sequence[str] = ("scene", "method")) -> pd.DataFrame:
    """Return the cost of each error for each method, on its best engine where times are compared.

    One row per `keys` and error, with the columns

    - family, engine; package: the library, blank where this one runs it
    - cost : nan where the error is not reached.  reason : why no finer setting was tried, blank where none would help.
    - bound : every setting is more accurate than the error; the cost is that of the cheapest.
    - fixed : the share of the cost that does not grow with the run, nan where it was not measured.
    - halves, processes : the ratios by which the halves of its visits, and two processes, differ.
    """
    part = rows[kind.compares(rows) & (rows["status"] != "unsupported")]
    spreads = {str(engine): kind.process_spread(part, engine) for engine in part["engine"].unique()}
    if not kind.timed:
        part = part.assign(method=part["method"].replace(SAME_INTEGRATOR))
        said = part.groupby(list(keys))[kind.cost].transform("count")  # by some solvers never
        part = part[said > 0]
    found: list[Record] = []
    for key, own in part.groupby(list(keys), sort=False):
        engines = [one for _, one in own.groupby("engine", sort=False)] if kind.timed else [own]
        tried = [list(_costs_on(one, kind, spreads[one["engine"].iloc[0]])) for one in engines]
        declared = {name: own[name].iloc[0] for name in ("family", "package") if name in own}
        lead = dict(zip(keys, key, strict=True)) | declared
        found += [lead | min(same, key=_preference) for same in zip(*tried, strict=True)]
    names = "family package engine error cost bound reason fixed halves processes"
    return pd.DataFrame(found, columns=list(dict.fromkeys([*keys, *names.split()])))


def _preference(row: Record) -> tuple[bool, float]:
    reached = not math.isnan(row["cost"])
    return not reached, row["cost"] if reached else not row["reason"]


def _costs_on(rows: pd.DataFrame, kind: Kind, processes: float) -> Iterator[Record]:
    ok = (rows["status"] == "ok").to_numpy(dtype=bool)
    errors, spent = (_floats(rows[name])[ok].tolist() for name in ("solution_error", kind.cost))
    front = envelope(errors, spent)
    reached = interpolate(errors, spent, front, TARGETS)
    reason = cut_off(rows) if any(map(math.isnan, reached)) else ""
    halves = _floats(rows[kind.halves])[ok].tolist() if kind.timed else [1.0] * len(errors)
    halves = interpolate(errors, [max(r, 1 / r) for r in halves], front, TARGETS)
    shares = [math.nan] * len(errors)
    if kind.timed and not kind.resolved and "fixed_s" in rows:
        shares = (_floats(rows["fixed_s"]) / _floats(rows["time_min_s"]))[ok].tolist()
    loosest = max(errors, default=math.nan)
    engine = rows["engine"][ok].iloc[0] if errors else ""
    for target, cost, own in zip(TARGETS, reached, halves, strict=True):
        reach = [(c, s) for e, c, s in zip(errors, spent, shares, strict=True) if e <= target and c == c]
        yield {
            "error": target,
            "engine": engine,
            "cost": cost,
            "bound": target > loosest,
            "reason": reason if math.isnan(cost) else "",
            "fixed": min(reach)[1] if reach else math.nan,
            "halves": own,
            "processes": processes,
        }


def cut_off(rows: pd.DataFrame) -> str:
    """Return the status of a finer setting that our own limit ended, or "": no finer one would be more accurate."""
    settings = list(zip(rows["status"], _floats(rows["value"]), _floats(rows["solution_error"]), strict=True))
    done = [(error, value) for status, value, error in settings if status == "ok"]
    best = min(done, key=lambda one: (math.isnan(one[0]), *one), default=(0.0, math.inf))[1]
    ended = [(value, str(status)) for status, value, _ in settings if status in CUT and value < best]
    return max(ended, default=(0.0, ""))[1]


def _floats(column: pd.Series) -> np.ndarray:
    return np.asarray(column.to_numpy(dtype=float, na_value=math.nan))


def pair_margin(one: Cost, other: Cost) -> float:
    return margin((one.halves, other.halves), max(one.processes, other.processes))


def standings(costs: pd.DataFrame, by: Sequence[str] = ("scene", "error")) -> pd.DataFrame:
    """Return the costs with their standing beside the least of the same scene and error, cheapest first.

    Columns beside theirs: ratio and margin, to the least; verdict: of the least *win*, or *tie* or *undecided* where
    it is not alone; of the others *tie*, *undecided* or *loss*; blank where the error is not reached.

    at_least : a column, if there is one, of the least that those cost which were cut off before they reached the error,
    else nan: where one of them may cost less than the least, nobody wins.
    """
    ranked = []
    for _, part in costs.groupby(list(by), sort=False):
        part = part.sort_values("cost", kind="stable")
        least = cost_rows(part.head(1))[0]
        ratios = part["cost"] / least.cost
        margins = [pair_margin(row, least) if row.cost == row.cost else math.nan for row in cost_rows(part)]
        pairs = zip(ratios, margins, strict=True)
        verdicts = [str(verdict(ratio, most)) if ratio == ratio else "" for ratio, most in pairs]
        if verdicts[0]:
            alike = {Verdict(v) for v in verdicts[1:] if v} - {Verdict.loss}
            verdicts[0] = str(max(alike, key=list(Verdict).index, default=Verdict.win))
        if "at_least" in part and (part["at_least"] <= least.cost).any():
            verdicts = [v if v in ("", "loss") else "undecided" for v in verdicts]
        ranked.append(part.assign(ratio=ratios, margin=margins, verdict=verdicts))
    return pd.concat(ranked, ignore_index=True) if ranked else costs.assign(ratio=[], margin=[], verdict=[])


def of_contact(costs: pd.DataFrame) -> pd.Series:
    return costs["family"] == CONTACT


def of_this_package(costs: pd.DataFrame) -> pd.Series:
    return costs["package"].fillna("") == ""


def contests(costs: pd.DataFrame, ours: Callable[[pd.DataFrame], pd.Series] = of_contact) -> pd.DataFrame:
    """Return the best method of one side beside the best other, a row per error and scene on which both sides ran.

    ours : which costs are of the side.  ratio : the other's cost over that side's, inf and 0 where one is alone.
    winner : ours, other, tie, undecided, or blank where nobody reaches the error.
    """
    rows = []
    for scene, here in costs.groupby("scene", sort=False):
        if ours(here).nunique() < 2:
            continue
        for target, part in here.groupby("error", sort=False):
            part = part[part["cost"].notna()].sort_values("cost", kind="stable")
            own = ours(part)
            pair = (next(iter(cost_rows(part[side].head(1))), None) for side in (own, ~own))
            rows.append({"scene": scene, "error": target} | _contest(*pair))
    names = "scene error ours our_cost other other_cost ratio margin winner"
    return pd.DataFrame(rows, columns=names.split())


def _contest(ours: Cost | None, theirs: Cost | None) -> Record:
    row = {"ours": ours.method, "our_cost": ours.cost} if ours else {"ours": ""}
    row |= {"other": theirs.method, "other_cost": theirs.cost} if theirs else {"other": ""}
    if ours is None or theirs is None:
        alone = (OURS, math.inf) if ours else (OTHER, 0.0) if theirs else ("", math.nan)
        return row | {"ratio": alone[1], "winner": alone[0]}
    most = pair_margin(ours, theirs)
    found = verdict(ours.cost / theirs.cost, most)
    winner = {Verdict.win: OURS, Verdict.loss: OTHER}.get(found, str(found))
    return row | {"ratio": theirs.cost / ours.cost, "margin": most, "winner": winner}
