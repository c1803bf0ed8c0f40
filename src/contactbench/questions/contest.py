"""Cost at equal error: what each error costs every method, who is within a quarter of the least, and who leads alone.

Evaluations (the engine does not matter), times of compiled engines and times of solvers that call back into Python
are never mixed.  The counts in the documents call the functions without an underscore.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import wraps
from itertools import pairwise
from typing import Any, Protocol, cast

import numpy as np
import pandas as pd

from contactbench.measure.statistics import (
    WIDEST,
    Verdict,
    costs_to_reach,
    envelope,
    interpolate,
    margin,
    process_spread,
    verdict,
)
from contactbench.report.look import CONTACT as CONTACT
from contactbench.scenes import SCENES
from contactbench.solution import EXACT

#: errors at which methods are compared
TARGETS = (1e-3, 1e-6, 1e-9, 1e-12)
CALLBACKS = ("python", "c+python")
#: statuses of runs that our own limits ended: a finer setting might be more accurate
CUT = ("budget", "timeout")
#: cells of an engine timed by two processes from which on it has a spread of its own
ENOUGH = 8
#: what a row of runs.csv and one of times.csv have in common
KEY = ["scene", "method", "engine", "control", "setting", "saved"]
#: engines of libraries that call a right-hand side by its address, which ours inlines; the seconds that a call costs,
#: as 10.96 and 4.84 ns an evaluation of particle by the same tableau differ, measured once on an Emerald Rapids Xeon
BY_ADDRESS, CALL = ("c", "c++"), 6.1e-9
#: results kept for each function that several questions call
KEPT = 32
#: how far the energy left in the ring may be off, and the part of its run that is timed
ALLOWED, TIMED_SPAN = 0.01, 500.0

#: the columns of a row
type Record = dict[str, Any]


class Cost(Protocol):
    """A row of `costs`, read by its columns."""

    scene: str
    method: str
    error: float
    cost: float
    bound: bool
    reason: str
    halves: float
    processes: float
    ratio: float
    verdict: str


def once[**P, R](function: Callable[P, R]) -> Callable[P, R]:
    """Have a function of tables, which many questions call, compute what it finds of the same tables once."""
    found: dict[tuple[object, ...], tuple[object, R]] = {}

    @wraps(function)
    def call(*given: P.args, **which: P.kwargs) -> R:
        key = (*(id(one) if isinstance(one, pd.DataFrame) else one for one in given), *sorted(which.items()))
        if key not in found:
            if len(found) >= KEPT:
                found.pop(next(iter(found)))
            found[key] = given, function(*given, **which)  # tables that are kept keep their identity
        return found[key][1]

    return call


def cost_rows(frame: pd.DataFrame) -> list[Cost]:
    return cast(list[Cost], list(frame.itertuples(index=False)))


def floats(column: pd.Series) -> np.ndarray:
    return np.asarray(column.to_numpy(dtype=float, na_value=math.nan))


# -- what an error costs ---------------------------------------------------------------------------
def by_pilots(runs: pd.DataFrame) -> pd.Series:
    """Return which rows are of a method with fixed steps that is given a tolerance: it chooses its step by pilots."""
    fixed = runs["method"][runs["control"].isin(["step", "growing"])]
    return (runs["control"] == "rtol") & runs["method"].isin(fixed)


def comparable(
    runs: pd.DataFrame,
    times: pd.DataFrame | None = None,
    tolerance: bool = False,
    callbacks: bool = False,
    saved: int = 1,
) -> pd.DataFrame:
    """Return the runs that meet in one contest, with a column `spent`: evaluations, or seconds where `times` is given.

    tolerance : every method is given a tolerance; else an oracle picks every setting.  callbacks : of times, those of
    solvers that call back into Python; else those of compiled ones.
    """
    pilots = by_pilots(runs)
    chosen = runs["control"].isin(["rtol", EXACT]) if tolerance else ~pilots
    rows = runs[chosen & (runs["saved"] == saved) & (runs["status"] != "unsupported")]
    if times is None:
        counted = rows.groupby(["scene", "method"])["evaluations"].transform("count")  # by some solvers never
        return rows[counted > 0].assign(spent=rows["evaluations"])
    rows = rows[rows["engine"].isin(CALLBACKS) == callbacks].merge(times, on=KEY, how="left")
    return rows.assign(spent=rows["least_s"])


@once
def credited(times: pd.DataFrame, runs: pd.DataFrame) -> pd.DataFrame:
    """Return the times without the calls of right-hand sides by their address, and without fixed costs.

    The fixed cost of a method on a scene is its time without evaluations: the intercept of the line
    with the least relative errors, at least 0, and at most nine tenths of its shortest time.
    """
    rows = times.merge(runs[[*KEY, "evaluations"]], on=KEY, how="left")
    called = rows["evaluations"].where(rows["engine"].isin(BY_ADDRESS), 0).fillna(0)
    rows["least_s"] -= CALL * called.astype(float)
    for _, own in rows.groupby(["scene", "method", "engine", "saved"]):
        known = own[["evaluations", "least_s"]].dropna().astype(float)
        if known["evaluations"].nunique() < 3:
            continue
        lines = np.stack([np.ones(len(known)), known["evaluations"]], axis=1)
        seconds = known["least_s"].to_numpy()
        fixed = np.linalg.lstsq(lines / seconds[:, None], np.ones(len(known)))[0][0]
        rows.loc[own.index, "least_s"] -= np.clip(fixed, 0.0, 0.9 * seconds.min())
    return rows[times.columns]


@once
def costs(runs: pd.DataFrame, times: pd.DataFrame | None = None, **which: Any) -> pd.DataFrame:
    """Return the cost of each error for each method and scene, on its best engine where times are compared.

    which : as in `comparable`.  Columns beside scene, method, family, engine and error:

    - cost : nan where the error is not reached.  reason : why no finer setting was tried, blank where none would help.
    - bound : every setting is more accurate than the error; the cheapest gives the cost.
    - halves, processes : the ratios by which the halves of its visits, and two processes, differ; 1 of evaluations.
    """
    part, timed = comparable(runs, times, **which), times is not None
    numbers = ["error", "spent", "setting", *(["halves", "process"] if timed else [])]
    # groups of few columns and plain numbers: those of whole tables are slow to take
    part = part[["scene", "method", "family", "engine", "status"]].assign(
        **{name: floats(part[name]) for name in numbers}
    )
    engines = part["engine"].unique() if timed else ()
    spreads = {engine: _process_spread(part, engine) for engine in engines}
    found: list[Record] = []
    for (scene, method), own in part.groupby(["scene", "method"], sort=False):
        each = [one for _, one in own.groupby("engine", sort=False)] if timed else [own]
        tried = [list(_costs_on(one, spreads.get(one["engine"].iloc[0]))) for one in each]
        lead = {"scene": scene, "method": method, "family": own["family"].iloc[0]}
        found += [lead | min(same, key=_preference) for same in zip(*tried, strict=True)]
    names = "scene method family engine error cost bound reason halves processes"
    return pd.DataFrame(found, columns=names.split())


def _process_spread(rows: pd.DataFrame, engine: str) -> float:
    """Return by what factor two processes differ on an engine; on all where few of its cells were timed twice."""
    own = rows[rows["engine"] == engine]
    sample = own if own["process"].notna().sum() >= ENOUGH else rows
    return process_spread(*(sample[name].astype(float) for name in ("process", "halves")))


def _preference(row: Record) -> tuple[bool, float]:
    reached = not math.isnan(row["cost"])
    return not reached, row["cost"] if reached else not row["reason"]


def _costs_on(rows: pd.DataFrame, processes: float | None) -> Iterator[Record]:
    ok = (rows["status"] == "ok").to_numpy(dtype=bool)
    errors, spent = (floats(rows[name])[ok].tolist() for name in ("error", "spent"))
    front = envelope(errors, spent)
    reached = interpolate(errors, spent, front, TARGETS)
    reason = cut_off(rows) if any(map(math.isnan, reached)) else ""
    halves = floats(rows["halves"])[ok].tolist() if processes else [1.0] * len(errors)
    halves = interpolate(errors, [max(r, 1 / r) for r in halves], front, TARGETS)
    loosest = max(errors, default=math.nan)
    engine = rows["engine"][ok].iloc[0] if errors else ""
    for target, cost, own in zip(TARGETS, reached, halves, strict=True):
        yield {
            "error": target,
            "engine": engine,
            "cost": cost,
            "bound": target > loosest,
            "reason": reason if math.isnan(cost) else "",
            "halves": own,
            "processes": processes or 1.0,
        }


def cut_off(rows: pd.DataFrame) -> str:
    """Return the status of a finer setting that our own limit ended, or "": no finer one would be more accurate."""
    settings = list(zip(rows["status"], floats(rows["setting"]), floats(rows["error"]), strict=True))
    done = [(error, value) for status, value, error in settings if status == "ok"]
    best = min(done, key=lambda one: (math.isnan(one[0]), *one), default=(0.0, math.inf))[1]
    ended = [(value, str(status)) for status, value, _ in settings if status in CUT and value < best]
    return max(ended, default=(0.0, ""))[1]


# -- who is near the least, and who leads ----------------------------------------------------------
def standings(
    costs: pd.DataFrame, by: Sequence[str] = ("scene", "error"), within: float = WIDEST
) -> pd.DataFrame:
    """Return the costs with their standing beside the least of the same scene and error, cheapest first.

    within : no lead is smaller; 1 of evaluations, which have their exact order.

    Columns beside theirs: ratio and margin, to the least; verdict: of the least *win*, or *tie* or *undecided* where
    it is not alone; of the others *tie*, *undecided* or *loss*; blank where the error is not reached.

    at_least : a column, if there is one, of the least that those cost which were cut off before they reached the error,
    else nan: where one of them may cost less than the least, nobody wins.
    """
    contest = costs.groupby(list(by), sort=False).ngroup()
    order = np.lexsort([floats(costs["cost"]), contest])  # who does not reach the error comes last
    ranked = costs.iloc[order].reset_index(drop=True)
    spent, halves, processes = (floats(ranked[name]).tolist() for name in ("cost", "halves", "processes"))
    at_least = floats(ranked["at_least"]) if "at_least" in ranked else np.full(len(ranked), math.nan)
    columns: dict[str, list[Any]] = {"ratio": [], "margin": [], "verdict": []}
    for first, end in pairwise([*np.flatnonzero(np.diff(contest.iloc[order], prepend=-1)), len(ranked)]):
        least, verdicts = spent[first], []
        for i in range(first, end):
            reached, ratio = not math.isnan(spent[i]), spent[i] / least
            most = margin((halves[i], halves[first]), max(processes[i], processes[first]), within)
            columns["ratio"].append(ratio)
            columns["margin"].append(most if reached else math.nan)
            verdicts.append(str(verdict(ratio, most)) if reached else "")
        if verdicts[0]:
            alike = {Verdict(v) for v in verdicts[1:] if v} - {Verdict.loss}
            verdicts[0] = str(max(alike, key=list(Verdict).index, default=Verdict.win))
        if (at_least[first:end] <= least).any():
            verdicts = [v if v in ("", "loss") else "undecided" for v in verdicts]
        columns["verdict"] += verdicts
    return ranked.assign(**columns)


def ranked(runs: pd.DataFrame, times: pd.DataFrame | None = None, **which: Any) -> pd.DataFrame:
    """Return the standings of every contest of a kind; which : as in `comparable`."""
    return standings(costs(runs, times, **which), within=1.0 if times is None else WIDEST)


def of_contact(costs: pd.DataFrame) -> pd.Series:
    return costs["family"] == CONTACT


@once
def contests(runs: pd.DataFrame, times: pd.DataFrame | None = None, **which: Any) -> pd.DataFrame:
    """Return the best contact method beside the best other, a row for each scene and error that anybody reaches.

    which : as in `comparable`.  ratio : the contact method's cost over the other's, 0 and inf where one is alone.
    margin : by so much either must lead to lead alone.
    """
    return sides(costs(runs, times, **which), within=1.0 if times is None else WIDEST)


def sides(
    costs: pd.DataFrame,
    keys: Sequence[str] = ("scene", "error"),
    ours: Callable[[pd.DataFrame], pd.Series] = of_contact,
    within: float = WIDEST,
) -> pd.DataFrame:
    """Return the best of one side beside the best other, of all `keys` on which both sides run; as `contests`."""
    own, runs = ours(costs), [costs[key] for key in keys if key != "error"]
    both = own.groupby(runs).transform("nunique") == 2
    reached = costs[both & costs["cost"].notna()].sort_values("cost", kind="stable")
    first = [
        reached[side[reached.index]].groupby(list(keys), sort=False).head(1).set_index(list(keys))
        for side in (own, ~own)
    ]
    found = first[0].add_suffix("_ours").join(first[1].add_suffix("_other"), how="outer")
    cost, halves, processes = (
        [found[f"{name}_{side}"].where(found[f"cost_{side}"].notna(), none) for side in ("ours", "other")]
        for name, none in (("cost", math.inf), ("halves", 1.0), ("processes", 1.0))
    )
    pairs = zip(*halves, np.maximum(*processes), strict=True)
    margins = [margin(pair, most, within) for *pair, most in pairs]
    made = found[["method_ours", "method_other"]].set_axis(["ours", "other"], axis=1).fillna("")
    return made.assign(ratio=(cost[0] / cost[1]).astype(float), margin=margins).reset_index()


# -- other tables ----------------------------------------------------------------------------------
@once
def families(runs: pd.DataFrame) -> dict[str, str]:
    return dict(zip(runs["method"], runs["family"], strict=True))


def with_family(rows: pd.DataFrame, runs: pd.DataFrame) -> pd.DataFrame:
    known = families(runs)
    return rows.assign(family=[known.get(name, "") for name in rows["method"]])


@once
def drawn(population: pd.DataFrame, problems: pd.DataFrame, hard: str = "") -> pd.DataFrame:
    """Return the rows of the random problems of a hard kind, or not hard, with what a pilot says of each problem."""
    usual = problems[problems["hard"] == hard].rename(columns={"cost": "force"})
    return population.merge(usual, on=["seed", "scene"])


@once
def random_contests(
    population: pd.DataFrame, problems: pd.DataFrame, runs: pd.DataFrame, cost: str, hard: str = ""
) -> pd.DataFrame:
    """Return the best contact method beside the best other on each random problem; as `contests`.

    cost : evaluations, or time_s.  hard : a kind of hard problems, blank for those that are not hard.
    """
    rows = with_family(drawn(population, problems, hard), runs).assign(halves=1.0, processes=1.0)
    rows["cost"] = rows[cost].where(rows["status"] == "ok")
    within = WIDEST if cost == "time_s" else 1.0
    return sides(rows, ("seed", "scene", "error"), within=within).merge(problems, on=["seed", "scene"])


def hard_runs(runs: pd.DataFrame) -> pd.DataFrame:
    """Return the runs of the hard scenes that were started."""
    hard = [name for name in runs["scene"].unique() if name in SCENES and SCENES[name].hard]
    skipped = (runs["status"] == "budget") & runs["end_time"].isna()
    return runs[runs["scene"].isin(hard) & (runs["status"] != "unsupported") & ~skipped]


def ring_runs(ring: pd.DataFrame, times: pd.DataFrame) -> pd.DataFrame:
    """Return the runs of the ring with the time of a whole run, `run_s`, extrapolated from its beginning."""
    begun = times[times["scene"].isin(ring["scene"])][["scene", "method", "control", "setting", "least_s"]]
    rows = ring.merge(begun, on=["scene", "method", "control", "setting"], how="left")
    return rows.assign(run_s=rows["least_s"] / TIMED_SPAN * rows["t_end"])


@once
def ring_costs(ring: pd.DataFrame, times: pd.DataFrame, cost: str = "run_s") -> pd.Series:
    """Return what the energy left in the ring to `ALLOWED` costs, by γ, span and method."""
    good = ring_runs(ring, times).query("status == 'ok'")
    found = {
        key: costs_to_reach(floats(own["energy_error"]).tolist(), floats(own[cost]).tolist(), (ALLOWED,))[0]
        for key, own in good.groupby(["gamma", "t_end", "method"])
    }
    index = pd.MultiIndex.from_tuples(found, names=["gamma", "t_end", "method"])
    return pd.Series(list(found.values()), index, dtype=float).sort_index()
