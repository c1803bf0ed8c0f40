"""Cost at equal error: which methods are cheapest, by how much, and what is a tie.

Three kinds of comparison are made and never mixed: evaluations (the engine does not matter), time of
compiled engines, and time of solvers that call back into Python.  A method belongs to the camp its rows
declare (column `family`): contact methods, and all others.  Two costs whose ratio is within the margin
are a tie, each pair with a margin of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from statistics import median

import pandas as pd

from contactbench.measure.statistics import (
    WIDEST,
    Verdict,
    envelope,
    interpolate,
    margin,
    process_spread,
    verdict,
)
from contactbench.report.cells import DASH
from contactbench.report.numbers import count, duration, many, names, percent, power, times
from contactbench.report.rooms import Frames
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
WHOLE = ("time_min_s", "each")
#: of those that tie, so many are named
NAMED = 3
#: endings that are our doing: a finer setting might be more accurate
CUT = ("budget", "timeout")
#: one integrator in two shapes: where engines do not matter one contestant, in the cheaper of them
ONE = {"scipy-dop853": "dop853", "cyrk-dop853": "dop853"}
#: engines at extended precision, never timed
UNTIMED = ("mpmath",)


#: two numbers of evaluations are a tie up to this ratio: counts repeat, but between two settings they are interpolated
COUNTED = 1.15


#: cells of an engine timed by two processes from which it has a spread of its own
ENOUGH = 8


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
    #: columns of the cell's own halves, and of a second process over the first
    halves: str = "time_halves_ratio"
    processes: str = "time_process_ratio"
    #: whether a closed form, which costs the same for any span, takes part
    exact: bool = True
    #: whether a cost without halves is not resolved, and takes no part
    resolved: bool = False
    #: what else than the methods differs
    caveat: str = ""

    def compares(self, rows: pd.DataFrame) -> pd.Series:
        """The rows that take part."""
        chosen = self.engines(rows["engine"])
        if not self.exact:
            chosen &= rows["control"] != "exact"
        return chosen & rows[self.halves].notna() if self.resolved else chosen

    def process_spread(self, rows: pd.DataFrame, engine: str = "") -> float:
        """Return by what factor two processes differ on an engine; on all of them where few of its cells were timed
        twice."""
        if not self.timed:
            return COUNTED
        own = rows[rows["engine"] == engine]
        sample = own if own[self.processes].notna().sum() >= ENOUGH else rows
        return process_spread(*(sample[name].astype(float) for name in (self.processes, self.halves)))


EVALUATIONS = Kind(
    "evaluations", "Evaluations", "rhs_equivalents", lambda engine: ~engine.isin(UNTIMED), count,
    "Evaluations of the right-hand side or their equivalents, whatever the engine: a Taylor order counts as one, "
    "two rotations of the body, which together apply its whole vector field, count as one; its free flow in closed "
    f"form counts as {FREE_COST} rotations, as {MOMENTUM_COST} where the attitude is not carried. Jacobians are not "
    f"counted. {' and '.join(ONE)} are one contestant.",
    timed=False,
)  # fmt: skip
COMPILED = Kind(
    "compiled", "Time, compiled", "time_min_s", lambda engine: ~engine.isin(CALLBACKS + UNTIMED), duration,
    "Time of a call (least round) that is compiled as a whole.",
)  # fmt: skip
CALLED_BACK = Kind(
    "callbacks", "Time, Python callbacks", "time_min_s", lambda engine: engine.isin(CALLBACKS), duration,
    "Time of a call (least round) whose right-hand side is evaluated in Python: SciPy and scikit-sundae call it back, "
    "the methods of this suite run a Python loop it is written into, which favours them.",
    caveat="The engines differ: the right-hand side is written into the loops of this suite, SciPy and "
    "scikit-sundae call it back.",
)  # fmt: skip
MARGINAL = Kind(
    "marginal", "Marginal time, compiled", "marginal_s", COMPILED.engines, duration,
    "What one more unit of the scene's time takes, without what a call takes however short the run: from compiled "
    "runs over a fifth of the span and all of it, at the same setting. A closed form costs the same for any span: it "
    "has no marginal time and takes no part; nor does a time that either half of the visits finds no larger than 0.",
    halves="marginal_halves_ratio", processes="marginal_process_ratio", exact=False, resolved=True,
)  # fmt: skip
KINDS = (EVALUATIONS, COMPILED, MARGINAL, CALLED_BACK)


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
    halves : by what factor the halves of its visits differ, 1 for a count, nan where that was not measured.
    processes : by what factor two processes differ on its engine.
    """

    value: float
    bound: bool = False
    reason: str = DASH
    share: float = math.nan
    halves: float = 1.0
    processes: float = 1.0

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


def costs(
    rows: pd.DataFrame, column: str, targets: Sequence[float], halves: str = "", processes: float = 1.0
) -> list[Cost]:
    """Log–log interpolation between the settings of one method (on one engine, where times are asked).

    halves : the column of the halves of the visits; none for a count.  processes : as in `Cost`.
    """
    reason, rows = unreached(rows), rows[rows["status"] == "ok"]
    errors, spent = (numbers(rows[name]) for name in ("solution_error", column))
    loosest = max(errors, default=math.nan)
    shares = [math.nan] * len(rows)
    if column in WHOLE and "fixed_s" in rows:
        shares = numbers(rows["fixed_s"] / rows["time_min_s"])
    front = envelope(errors, spent)
    values = interpolate(errors, spent, front, targets)
    apart = [1.0] * len(targets)
    if halves:
        apart = interpolate(errors, [max(r, 1 / r) for r in numbers(rows[halves])], front, targets)
    return [
        Cost(value, target > loosest, reason, _fixed(errors, spent, shares, target), h, processes)
        for target, value, h in zip(targets, values, apart, strict=True)
    ]


def numbers(column: pd.Series) -> list[float]:
    return column.to_numpy(dtype=float, na_value=math.nan).tolist()


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
    family : of every method.
    """

    costs: dict[str, Cost]
    family: dict[str, str]
    missing: dict[str, Cost]

    @property
    def decided(self) -> bool:
        return bool(self.costs)

    def margin(self, a: str, b: str) -> float:
        """Return the ratio up to which two methods cannot be told apart."""
        first, second = self.costs[a], self.costs[b]
        return margin((first.halves, second.halves), max(first.processes, second.processes))

    def verdict(self, a: str, b: str) -> Verdict:
        """Return what a method's cost is beside another's."""
        return verdict(self.costs[a].value / self.costs[b].value, self.margin(a, b))

    @cached_property
    def verdicts(self) -> dict[str, Verdict]:
        """Every method beside the cheapest, which ties with itself."""
        least = next(iter(self.costs))
        return {m: Verdict.tie if m == least else self.verdict(m, least) for m in self.costs}

    @cached_property
    def first(self) -> list[str]:
        """The cheapest, and those that cannot be told from it."""
        return [m for m in self.costs if self.verdicts[m] is not Verdict.loss]

    @property
    def alike(self) -> tuple[Verdict, float]:
        """Whether those that stand first tie or are undecided, and the widest of their margins."""
        least, *others = self.first
        verdicts = {self.verdicts[m] for m in others}
        return max(verdicts, key=list(Verdict).index), max(self.margin(least, m) for m in others)

    @property
    def tied(self) -> list[str]:
        """Those that stand first, the best of each camp before the others."""
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
    def outcome(self) -> Verdict | None:
        """For the contact methods; None where nobody gets there."""
        ours, theirs = self.best(True), self.best(False)
        if ours is None or theirs is None:
            return None if ours == theirs else Verdict.win if ours else Verdict.loss
        return self.verdict(ours, theirs)

    def text(self, show: Callable[[float], str]) -> str:
        """**a** 12 µs; next b ×1.3, or: tie (5 %): a, b 12 µs."""
        if not self.decided:
            reasons = {c.reason for c in self.missing.values()} - {DASH}
            return ", ".join(sorted(reasons)) or DASH
        least = self.costs[self.first[0]].text(show)
        shown = f"**{self.first[0]}**"
        if len(self.first) > 1:
            shown = f"{within(*self.alike)}: {names(self.tied, NAMED)}"
        after = (
            f"; {self.next} {times(self.costs[self.next].value / self.costs[self.first[0]].value)}"
            if self.next
            else ""
        )
        return f"{shown} {least}{after}"


def within(verdict: Verdict, margin: float) -> str:
    """tie (5 %), undecided (×1.60), undecided where nothing is known of the margin."""
    if math.isinf(margin):
        return str(verdict)
    return f"{verdict} ({percent(margin) if margin <= WIDEST else times(margin)})"


class Field:
    """All contests of a table of one kind: every scene, every error of DECADES.

    leads : by scene and error.  scenes : all of them.  contested : those where both camps have a row.
    """

    def __init__(self, work: pd.DataFrame, kind: Kind) -> None:
        self.kind = kind
        part = contestants(work)
        part = part[kind.compares(part) & (part["status"] != "unsupported")]
        #: by what factor two processes differ, by engine
        self.processes = {
            str(engine): kind.process_spread(part, engine) for engine in part["engine"].unique()
        }
        if not kind.timed:
            part = part.assign(method=part["method"].replace(ONE))
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
                self.leads[str(scene), target] = Lead(ordered, family, missing)

    def cheapest(self, rows: pd.DataFrame) -> list[Cost]:
        """What every error costs a method on a scene, on its best engine where times are asked."""
        groups = [g for _, g in rows.groupby("engine", sort=False)] if self.kind.timed else [rows]
        halves = self.kind.halves if self.kind.timed else ""
        tried = zip(
            *(costs(g, self.kind.cost, DECADES, halves, self.processes[g["engine"].iloc[0]]) for g in groups),
            strict=True,
        )
        return [
            min(t, key=lambda c: (not c.reached, c.value if c.reached else c.reason == DASH)) for t in tried
        ]

    def contests(self) -> dict[tuple[str, float], Lead]:
        """Those that count: both camps have a row, errors of TARGETS."""
        return {(s, t): self.leads[s, t] for s in self.contested for t in TARGETS}

    @property
    def margins(self) -> list[float]:
        """Return the margins of the contests that both camps reach, in order."""
        pairs = [(c, c.best(True), c.best(False)) for c in self.contests().values()]
        return sorted(c.margin(a, b) for c, a, b in pairs if a is not None and b is not None)


@dataclass(frozen=True)
class Tally:
    """Wins, ties and losses of the contact methods over some contests, and those too noisy to judge.

    open : nobody reaches the error.
    """

    wins: int
    ties: int
    losses: int
    undecided: int
    open: int

    @property
    def judged(self) -> int:
        return self.wins + self.ties + self.losses + self.undecided


def tally(contests: Iterable[Lead]) -> Tally:
    outcomes = [contest.outcome for contest in contests]
    return Tally(*(outcomes.count(outcome) for outcome in (*Verdict, None)))


def camps(contests: Iterable[Lead]) -> dict[str, int]:
    """How often each method outside the contact camp leads it where that camp wins; most often first."""
    wins: dict[str, int] = {}
    for contest in contests:
        if contest.outcome is Verdict.loss:
            best = str(contest.best(contact=False))
            wins[best] = wins.get(best, 0) + 1
    return dict(sorted(wins.items(), key=lambda item: -item[1]))


def reasons(fields: Iterable[Field]) -> tuple[str, ...]:
    """What the table shows of where the contact methods lose: at which errors, on which scenes, how often."""
    said = []
    for field in fields:
        contests = field.contests()
        lost = {key: c for key, c in contests.items() if c.outcome is Verdict.loss}
        if not lost:
            continue
        errors = {t: sum(target == t for _, target in lost) for t in TARGETS}
        by_error = ", ".join(f"{n} at {power(t)}" for t, n in errors.items() if n)
        always = [
            f"`{scene}`" for scene in field.contested
            if {contests[scene, t].outcome for t in TARGETS} - {None} == {Verdict.loss}
        ]  # fmt: skip
        pairs = tally(contests.values()).judged
        sentence = f"**{field.kind.title}**: {len(lost)} of {pairs} pairs of scene and error lost, {by_error}"
        said.append(sentence + (f"; at every error on {names(always)}." if always else "."))
    return tuple(said)


def standing(field: Field) -> tuple[str, str] | None:
    """The tally as a sentence, and what it covers; None without contests."""
    contests = field.contests()
    counted = tally(contests.values())
    if not counted.judged:
        return None
    against = ", ".join(f"{method} {n}" for method, n in camps(contests.values()).items())
    sentence = (
        f"A contact method is cheapest in {counted.wins} of {counted.judged} pairs of scene and error, "
        f"{counted.ties} are ties ({ties(field)}), another method is cheapest in {counted.losses}"
        + (f" ({against})" if against else "")
        + (f", {counted.undecided} are too noisy to judge." if counted.undecided else ".")
    )
    won = []
    for scene in field.contested:
        own = [contests[scene, t] for t in TARGETS if contests[scene, t].outcome]
        if own and all(c.outcome is Verdict.win for c in own):
            known = [c.ratio for c in own if math.isfinite(c.ratio)]
            by = f" (the best other method costs {times(min(known))} to {times(max(known))})" if known else ""
            won.append(f"`{scene}`{by}")
    if won:
        sentence += f" A contact method is cheapest at every error on {names(won)}."
    if field.kind.caveat:
        sentence += f" {field.kind.caveat}"
    covers = f"{len(field.contested)} scenes, errors {', '.join(power(t) for t in TARGETS)}"
    if counted.open:
        covers += f"; not counted: {many(counted.open, 'pair')} that no method reaches"
    return sentence, covers


def ties(field: Field) -> str:
    """within 15 %; of times, within 4 % to 8 %, half of the pairs within 5 %."""
    known = [m for m in field.margins if m <= WIDEST] or [WIDEST]
    low, high = percent(known[0]), percent(known[-1])
    if low == high:
        return f"within {low}"
    return f"within {low} to {high}, half of the pairs within {percent(median(known))}"


def families(frames: Frames) -> dict[str, str]:
    """The family every method declares, from all tables that have one."""
    found: dict[str, str] = {}
    for frame in frames.values():
        if {"method", "family"} <= set(frame.columns):
            pairs = frame[["method", "family"]].drop_duplicates()
            found |= {str(m): str(f) for m, f in pairs.itertuples(index=False)}
    return found
