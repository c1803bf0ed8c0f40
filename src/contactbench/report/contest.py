"""Cost at equal error: which methods are cheapest, by how much, and what is a tie.

Three kinds of comparison are made and never mixed: evaluations (the engine does not matter), time of
compiled engines, and time of solvers that call back into Python.  A method belongs to the camp its rows
declare (column `family`): contact methods, and all others.  Two costs whose ratio is within the margin
are a tie.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from contactbench.report.cells import DASH
from contactbench.report.numbers import count, duration, many, names, power, times
from contactbench.report.rooms import Frames
from contactbench.results.statistics import TIE, costs_to_reach, noise, verdict
from contactbench.splitting.flows import FREE_COST, MOMENTUM_COST

TARGETS = (1e-3, 1e-6, 1e-9, 1e-12)
DECADES = tuple(10.0**-k for k in range(3, 13))
#: families that methods declare
CONTACT = "contact"
ESTABLISHED = "established"
#: rows that are no contestants: plain C loops
LIMIT = "limit"
CALLBACKS = ("python", "c+python")
#: what marks a cost that is mostly fixed
FIXED = " °"
#: costs of whole calls, their fixed part included: of a call, and of each of its trajectories
WHOLE = ("time_median_s", "each")
#: of those that tie, so many are named
NAMED = 3
#: endings that are our doing: a finer setting might be more accurate
CUT = ("budget", "timeout")
#: one integrator in two shapes: where engines do not matter one contestant, in the cheaper of them
ONE = {"scipy-dop853": "dop853", "cyrk-dop853": "dop853"}
#: engines at extended precision, never timed
UNTIMED = ("mpmath",)


@dataclass(frozen=True)
class Kind:
    """A kind of comparison: its cost, whose engines it compares, how a cost is written."""

    name: str
    title: str
    cost: str
    engines: Callable[[pd.Series], pd.Series]
    show: Callable[[float], str]
    about: str
    timed: bool = True
    #: column of the second measurement over the first
    repeat: str = "time_repeat_ratio"
    #: whether a closed form, which costs the same for any span, takes part
    exact: bool = True
    #: column of the spread over rounds: a cost no larger is not resolved, and takes no part
    spread: str = ""
    #: what else than the methods differs
    caveat: str = ""

    def compares(self, rows: pd.DataFrame) -> pd.Series:
        """The rows that take part."""
        chosen = self.engines(rows["engine"])
        if not self.exact:
            chosen &= rows["control"] != "exact"
        return chosen & resolved(rows, self.cost, self.spread) if self.spread in rows else chosen


def resolved(rows: pd.DataFrame, cost: str, spread: str) -> pd.Series:
    """Which costs are larger than their spread over rounds, as far as that is known."""
    return ~(rows[cost].astype(float) <= rows[spread].astype(float))


EVALUATIONS = Kind(
    "evaluations", "Evaluations", "rhs_equivalents", lambda engine: ~engine.isin(UNTIMED), count,
    "Evaluations of the right-hand side or their equivalents, whatever the engine: a Taylor order counts as one, "
    "two rotations of the body, which together apply its whole vector field, count as one; its free flow in closed "
    f"form counts as {FREE_COST} rotations, as {MOMENTUM_COST} where the attitude is not carried. Jacobians are not "
    f"counted. {' and '.join(ONE)} are one contestant.",
    timed=False,
)  # fmt: skip
COMPILED = Kind(
    "compiled", "Time, compiled", "time_median_s", lambda engine: ~engine.isin(CALLBACKS + UNTIMED), duration,
    "Median time of a call that is compiled as a whole.",
)  # fmt: skip
CALLED_BACK = Kind(
    "callbacks", "Time, Python callbacks", "time_median_s", lambda engine: engine.isin(CALLBACKS), duration,
    "Median time of a call whose right-hand side is evaluated in Python: SciPy and scikit-sundae call it back, the "
    "methods of this suite run a Python loop it is written into, which favours them.",
    caveat="The engines differ: the right-hand side is written into the loops of this suite, SciPy and "
    "scikit-sundae call it back.",
)  # fmt: skip
MARGINAL = Kind(
    "marginal", "Marginal time, compiled", "marginal_s", COMPILED.engines, duration,
    "What one more unit of the scene's time takes, without what a call takes however short the run: from compiled "
    "runs over a fifth of the span and all of it, at the same setting. A closed form costs the same for any span: it "
    "has no marginal time and takes no part; nor does a time that is no larger than its spread over rounds.",
    repeat="marginal_repeat_ratio", spread="marginal_iqr_s", exact=False,
)  # fmt: skip
KINDS = (EVALUATIONS, COMPILED, MARGINAL, CALLED_BACK)


def margin(work: pd.DataFrame, kind: Kind) -> float:
    """The ratio within which two costs are a tie."""
    return max(TIE, noise(work, kind.repeat)) if kind.timed else TIE


def contestants(work: pd.DataFrame) -> pd.DataFrame:
    """The rows that compete: one setting of one method, not chosen by pilots, no C loops."""
    return work[(work["family"] != LIMIT) & (work["variant"].fillna("") == "")]


def unreached(rows: pd.DataFrame) -> str:
    """Why no setting of a method is more accurate: the status of a finer one that we cut off, or a dash.

    rows : of one method on one scene.  A dash: no setting tried is more accurate.
    """
    runs = list(zip(rows["value"], rows["status"], rows["solution_error"].astype(float), strict=True))
    best = min(
        ((error, value) for value, status, error in runs if status == "ok"), default=(math.inf, math.inf)
    )
    cut = [(value, status) for value, status, _ in runs if status in CUT and value < best[1]]
    return str(max(cut)[1]) if cut else DASH


@dataclass(frozen=True)
class Cost:
    """What an error costs a method: nan with the reason where it is not reached.

    bound : every setting is more accurate than that; it is the cost of the cheapest.
    share : how much of it does not grow with the run, nan where that was not measured.
    """

    value: float
    bound: bool = False
    reason: str = DASH
    share: float = math.nan

    @property
    def fixed(self) -> bool:
        """Whether more than half of it does not grow with the length of the run, or the number of trajectories."""
        return self.share > 0.5

    @property
    def reached(self) -> bool:
        return not math.isnan(self.value)

    def text(self, show: Callable[[float], str]) -> str:
        if not self.reached:
            return self.reason
        return f"{'≤ ' if self.bound else ''}{show(self.value)}{FIXED if self.fixed else ''}"


def costs(rows: pd.DataFrame, column: str, targets: Sequence[float]) -> list[Cost]:
    """Log–log interpolation between the settings of one method (on one engine, where times are asked)."""
    ok = (rows["status"] == "ok").to_numpy()
    errors, spent = (
        rows[name].to_numpy(dtype=float, na_value=math.nan)[ok].tolist()
        for name in ("solution_error", column)
    )
    loosest, reason = max(errors, default=math.nan), unreached(rows)
    fixed = np.full(len(ok), math.nan)
    if column in WHOLE and "fixed_s" in rows:
        fixed = (rows["fixed_s"].astype(float) / rows["time_median_s"].astype(float)).to_numpy(dtype=float)
    shares = fixed[ok].tolist()
    return [
        Cost(value, target > loosest, reason, _fixed(errors, spent, shares, target))
        for target, value in zip(targets, costs_to_reach(errors, spent, targets), strict=True)
    ]


def _fixed(errors: list[float], spent: list[float], shares: list[float], target: float) -> float:
    """How much the cheapest setting that reaches an error spends on what does not grow."""
    reach = [
        (s, f) for e, s, f in zip(errors, spent, shares, strict=True) if e <= target and math.isfinite(s)
    ]
    return min(reach)[1] if reach else math.nan


@dataclass(frozen=True)
class Lead:
    """Who is cheapest at one error on one scene.

    costs : cost of every method that gets there, on its best engine, cheapest first.
    family : of every method.  margin : the ratio up to which two costs are a tie.
    """

    costs: dict[str, Cost]
    family: dict[str, str]
    margin: float
    missing: dict[str, Cost]

    @property
    def decided(self) -> bool:
        return bool(self.costs)

    @cached_property
    def first(self) -> list[str]:
        """The cheapest, and those no dearer than the margin."""
        least = min((c.value for c in self.costs.values()), default=math.nan)
        return [m for m, c in self.costs.items() if c.value <= least * self.margin]

    @property
    def tied(self) -> list[str]:
        """Those that tie for the first place, the best of each camp before the others."""
        bests = [m for m in (self.best(True), self.best(False)) if m in self.first]
        return list(dict.fromkeys([*sorted(bests, key=self.first.index), *self.first]))

    @cached_property
    def next(self) -> str | None:
        """The cheapest of those beyond the margin."""
        return next((m for m in self.costs if m not in self.first), None)

    def best(self, contact: bool) -> str | None:
        """The cheapest of a camp."""
        return next((m for m in self.costs if (self.family[m] == CONTACT) == contact), None)

    @cached_property
    def ratio(self) -> float:
        """Best cost of the others over the best of the contact methods; inf, 0 where one camp is alone, or nan."""
        ours, theirs = self.best(True), self.best(False)
        if ours is None and theirs is None:
            return math.nan
        if ours is None or theirs is None:
            return math.inf if theirs is None else 0.0
        return self.costs[theirs].value / self.costs[ours].value

    @property
    def outcome(self) -> str:
        """For the contact methods: win, tie, loss, or "" where nobody gets there."""
        if math.isnan(self.ratio):
            return ""
        if math.isinf(self.ratio) or self.ratio == 0:
            return "win" if self.ratio else "loss"
        return verdict(1 / self.ratio, self.margin)

    def text(self, show: Callable[[float], str]) -> str:
        """**a** 12 µs; next b ×1.3, or: tie: a, b 12 µs."""
        if not self.decided:
            reasons = {c.reason for c in self.missing.values()} - {DASH}
            return ", ".join(sorted(reasons)) or DASH
        least = self.costs[self.first[0]].text(show)
        shown = f"tie: {names(self.tied, NAMED)}" if len(self.first) > 1 else f"**{self.first[0]}**"
        after = (
            f"; {self.next} {times(self.costs[self.next].value / self.costs[self.first[0]].value)}"
            if self.next
            else ""
        )
        return f"{shown} {least}{after}"


class Field:
    """All contests of a table of one kind: every scene, every error of DECADES.

    leads : by scene and error.  scenes : all of them.  contested : those where both camps have a row.
    """

    def __init__(self, work: pd.DataFrame, kind: Kind) -> None:
        self.kind, self.margin = kind, margin(work, kind)
        part = contestants(work)
        part = part[kind.compares(part) & (part["status"] != "unsupported")]
        told = ["scene", "method", "family", "engine", "value", "status", "solution_error", "fixed_s"]
        part = part.reindex(columns=[*told, kind.cost])
        if not kind.timed:
            part["method"] = part["method"].replace(ONE)
        family = dict(zip(part["method"], part["family"], strict=True))
        self.methods = list(family)
        self.scenes, self.contested = list(dict.fromkeys(part["scene"])), []
        self.leads: dict[tuple[str, float], Lead] = {}
        for scene, here in part.groupby("scene", sort=False):
            known = {m: self.cheapest(rows) for m, rows in here.groupby("method", sort=False)}
            if len({family[m] == CONTACT for m in known}) == 2:
                self.contested.append(scene)
            for i, target in enumerate(DECADES):
                reached = {str(m): c[i] for m, c in known.items() if c[i].reached}
                missing = {str(m): c[i] for m, c in known.items() if not c[i].reached}
                ordered = dict(sorted(reached.items(), key=lambda item: item[1].value))
                self.leads[str(scene), target] = Lead(ordered, family, self.margin, missing)

    def cheapest(self, rows: pd.DataFrame) -> list[Cost]:
        """What every error costs a method on a scene, on its best engine where times are asked."""
        groups = [g for _, g in rows.groupby("engine", sort=False)] if self.kind.timed else [rows]
        tried = zip(*(costs(g, self.kind.cost, DECADES) for g in groups), strict=True)
        return [
            min(t, key=lambda c: (not c.reached, c.value if c.reached else c.reason == DASH)) for t in tried
        ]

    def contests(self) -> dict[tuple[str, float], Lead]:
        """Those that count: both camps have a row, errors of TARGETS."""
        return {(s, t): self.leads[s, t] for s in self.contested for t in TARGETS}


@dataclass(frozen=True)
class Tally:
    """Wins, ties and losses of the contact methods over some contests; open: nobody reaches the error."""

    wins: int
    ties: int
    losses: int
    open: int

    @property
    def decided(self) -> int:
        return self.wins + self.ties + self.losses


def tally(contests: Iterable[Lead]) -> Tally:
    outcomes = [contest.outcome for contest in contests]
    return Tally(*(outcomes.count(name) for name in ("win", "tie", "loss", "")))


def camps(contests: Iterable[Lead]) -> dict[str, int]:
    """How often each method outside the contact camp leads it where that camp wins; most often first."""
    wins: dict[str, int] = {}
    for contest in contests:
        if contest.outcome == "loss":
            best = str(contest.best(contact=False))
            wins[best] = wins.get(best, 0) + 1
    return dict(sorted(wins.items(), key=lambda item: -item[1]))


def reasons(fields: Iterable[Field]) -> tuple[str, ...]:
    """What the table shows of where the contact methods lose: at which errors, on which scenes, how often."""
    said = []
    for field in fields:
        contests = field.contests()
        lost = {key: c for key, c in contests.items() if c.outcome == "loss"}
        if not lost:
            continue
        errors = {t: sum(target == t for _, target in lost) for t in TARGETS}
        by_error = ", ".join(f"{n} at {power(t)}" for t, n in errors.items() if n)
        always = [
            f"`{scene}`" for scene in field.contested
            if {contests[scene, t].outcome for t in TARGETS} - {""} == {"loss"}
        ]  # fmt: skip
        pairs = tally(contests.values()).decided
        sentence = f"**{field.kind.title}**: {len(lost)} of {pairs} pairs of scene and error lost, {by_error}"
        said.append(sentence + (f"; at every error on {names(always)}." if always else "."))
    return tuple(said)


def standing(field: Field) -> tuple[str, str] | None:
    """The tally as a sentence, and what it covers; None without contests."""
    contests = field.contests()
    counted = tally(contests.values())
    if not counted.decided:
        return None
    against = ", ".join(f"{method} {n}" for method, n in camps(contests.values()).items())
    sentence = (
        f"A contact method is cheapest in {counted.wins} of {counted.decided} pairs of scene and error, "
        f"{counted.ties} are ties, another method is cheapest in {counted.losses}"
        + (f" ({against})." if against else ".")
    )
    won = []
    for scene in field.contested:
        own = [contests[scene, t] for t in TARGETS if contests[scene, t].outcome]
        if own and all(c.outcome == "win" for c in own):
            known = [c.ratio for c in own if math.isfinite(c.ratio)]
            by = f" (the best other method costs {times(min(known))} to {times(max(known))})" if known else ""
            won.append(f"`{scene}`{by}")
    if won:
        sentence += f" A contact method is cheapest at every error on {names(won)}."
    if field.kind.caveat:
        sentence += f" {field.kind.caveat}"
    covers = (
        f"{len(field.contested)} scenes, errors {', '.join(power(t) for t in TARGETS)}; a tie: within "
        f"{100 * (field.margin - 1):.0f} %"
    )
    if counted.open:
        covers += f"; not counted: {many(counted.open, 'pair')} that no method reaches"
    return sentence, covers


def families(frames: Frames) -> dict[str, str]:
    """The family every method declares, from all tables that have one."""
    found: dict[str, str] = {}
    for frame in frames.values():
        if {"method", "family"} <= set(frame.columns):
            pairs = frame[["method", "family"]].drop_duplicates()
            found |= {str(m): str(f) for m, f in pairs.itertuples(index=False)}
    return found
