"""Cost at equal error: which methods are cheapest, by how much, and what is a tie.

Three kinds of comparison are made and never mixed: evaluations (the engine does not matter), time of
compiled engines, and time of solvers that call back into Python.  A method belongs to the camp its rows
declare (column `family`): contact methods, and all others.  Two costs whose ratio is within the margin
are a tie.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pandas as pd

from contactbench.measure.analysis import cost_to_reach
from contactbench.report.model import DASH, Cell, Frames, Head, Mark, View, marks, word
from contactbench.report.numbers import count, duration, names, power, times

TARGETS = (1e-3, 1e-6, 1e-9, 1e-12)
DECADES = tuple(10.0**-k for k in range(3, 13))
CONTACT = "contact"
#: rows that are no contestants: plain C loops
LIMIT = "limit"
#: costs whose ratio is no larger than this are a tie, whatever the noise measured
TIE = 1.15
#: of the repeated measurements, this part has a smaller ratio than the noise
SHARE = 0.95
CALLBACKS = ("python", "c+python")
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


EVALUATIONS = Kind(
    "evaluations", "Evaluations", "rhs_equivalents", lambda engine: ~engine.isin(UNTIMED), count,
    "Evaluations of the right-hand side or their equivalents, whatever the engine: a Taylor order counts as one, "
    "two rotations of the body, which together apply its whole vector field, count as one.", timed=False,
)  # fmt: skip
COMPILED = Kind(
    "compiled", "Time, compiled", "time_median_s", lambda engine: ~engine.isin(CALLBACKS + UNTIMED), duration,
    "Median time of a call that is compiled as a whole.",
)  # fmt: skip
CALLED_BACK = Kind(
    "callbacks", "Time, Python callbacks", "time_median_s", lambda engine: engine.isin(CALLBACKS), duration,
    "Median time of a call that evaluates the right-hand side in Python; the fixed-step methods run in Python.",
)  # fmt: skip
KINDS = (EVALUATIONS, COMPILED, CALLED_BACK)


def noise(work: pd.DataFrame) -> float:
    """How far apart two measurements of the same cell are: the ratio that 95 % of the repeats stay below.

    From `time_repeat_ratio`; 1 where nothing was repeated.
    """
    ratios = work.get("time_repeat_ratio", pd.Series(dtype=float)).astype(float).dropna()
    ratios = ratios[ratios > 0]
    return float(np.exp(np.quantile(np.abs(np.log(ratios)), SHARE))) if len(ratios) else 1.0


def margin(work: pd.DataFrame, kind: Kind) -> float:
    """The ratio within which two costs are a tie."""
    return max(TIE, noise(work)) if kind.timed else TIE


def contestants(work: pd.DataFrame) -> pd.DataFrame:
    """The rows that compete: one setting of one method, not chosen by pilots, no C loops."""
    return work[(work["family"] != LIMIT) & (work["variant"].fillna("") == "")]


def unreached(rows: pd.DataFrame, target: float) -> str:
    """Why no setting of a method reaches an error: the status of a finer one that did not end, or a dash.

    rows : of one method on one scene.  A dash: no setting tried is as accurate.
    """
    ok = rows[rows["status"] == "ok"]
    best = ok.loc[ok["solution_error"].astype(float).idxmin(), "value"] if len(ok) else math.inf
    cut = rows[(rows["value"] < best) & rows["status"].isin(["budget", "timeout"])]
    return str(cut.sort_values("value")["status"].iloc[-1]) if len(cut) else DASH


@dataclass(frozen=True)
class Cost:
    """What an error costs a method: nan with the reason where it is not reached.

    bound : every setting is more accurate than that; it is the cost of the cheapest.
    """

    value: float
    bound: bool = False
    reason: str = DASH

    @property
    def reached(self) -> bool:
        return not math.isnan(self.value)

    def text(self, show: Callable[[float], str]) -> str:
        return self.reason if not self.reached else ("≤ " if self.bound else "") + show(self.value)


def cost(rows: pd.DataFrame, column: str, target: float) -> Cost:
    """Log–log interpolation between the settings of one method (on one engine, where times are asked)."""
    ok = rows[rows["status"] == "ok"]
    errors, costs = ok["solution_error"].astype(float), ok[column].astype(float)
    value = cost_to_reach(errors, costs, target)
    if math.isnan(value):
        return Cost(value, reason=unreached(rows, target))
    return Cost(value, bound=bool(target > errors.max()))


@dataclass(frozen=True)
class Lead:
    """Who is cheapest at one error on one scene.

    costs : cost of every method that gets there, on its best engine, cheapest first.
    family : of every method.  margin : the ratio up to which two costs are a tie.
    """

    costs: dict[str, Cost]
    family: dict[str, str]
    margin: float
    missing: dict[str, Cost] = field(default_factory=dict)

    @property
    def decided(self) -> bool:
        return bool(self.costs)

    @cached_property
    def first(self) -> list[str]:
        """The cheapest, and those no dearer than the margin."""
        least = min((c.value for c in self.costs.values()), default=math.nan)
        return [m for m, c in self.costs.items() if c.value <= least * self.margin]

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
        return "win" if self.ratio > self.margin else "loss" if self.ratio < 1 / self.margin else "tie"

    def text(self, show: Callable[[float], str]) -> str:
        """**a** 12 µs; next b ×1.3, or: tie: a, b 12 µs."""
        if not self.decided:
            reasons = {c.reason for c in self.missing.values()} - {DASH}
            return ", ".join(sorted(reasons)) or DASH
        least = self.costs[self.first[0]].text(show)
        shown = f"tie: {', '.join(self.first)}" if len(self.first) > 1 else f"**{self.first[0]}**"
        after = (
            f"; {self.next} {times(self.costs[self.next].value / self.costs[self.first[0]].value)}"
            if self.next
            else ""
        )
        return f"{shown} {least}{after}"


def lead(work: pd.DataFrame, scene: str, target: float, kind: Kind, tie: float | None = None) -> Lead:
    """The contest at one error on one scene."""
    part = contestants(work)
    part = part[(part["scene"] == scene)]
    part = part[kind.engines(part["engine"])]
    found: dict[str, Cost] = {}
    missing: dict[str, Cost] = {}
    for method, rows in part.groupby("method", sort=False):
        groups = [g for _, g in rows.groupby("engine", sort=False)] if kind.timed else [rows]
        costs = [cost(g, kind.cost, target) for g in groups if (g["status"] != "unsupported").any()]
        reached = sorted((c for c in costs if c.reached), key=lambda c: c.value)
        if reached:
            found[str(method)] = reached[0]
        elif costs:
            missing[str(method)] = next((c for c in costs if c.reason != DASH), costs[0])
    ordered = dict(sorted(found.items(), key=lambda item: item[1].value))
    family = dict(zip(part["method"], part["family"], strict=True))
    return Lead(ordered, family, margin(work, kind) if tie is None else tie, missing)


def leads(
    work: pd.DataFrame, kind: Kind, targets: Iterable[float] = TARGETS
) -> dict[tuple[str, float], Lead]:
    """Every contest of a table in which both camps have a row of this kind on the scene."""
    part = contestants(work)
    part = part[kind.engines(part["engine"]) & (part["status"] != "unsupported")]
    tie = margin(work, kind)
    return {
        (scene, target): lead(work, scene, target, kind, tie)
        for scene, rows in part.groupby("scene", sort=False)
        if (rows["family"] == CONTACT).any() and (rows["family"] != CONTACT).any()
        for target in targets
    }


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


# -- views -----------------------------------------------------------------------------------------
def said(tie: float) -> str:
    return f"Costs within {100 * (tie - 1):.0f} % of each other are a tie."


DASHES = (
    f"{DASH}: no setting tried is as accurate; budget, timeout: a finer setting was cut off by our own limit. "
    "≤: every setting tried is more accurate than asked, and this is the cheapest."
)


def error_heads(targets: Iterable[float] = TARGETS) -> list[Head]:
    return [Head(f"error {power(target)}") for target in targets]


def winners_view(work: pd.DataFrame, kind: Kind, name: str, title: str, source: str) -> View:
    """Per scene and error the cheapest, those that tie with it, and the next."""
    contests = leads(work, kind)
    scenes = list(dict.fromkeys(scene for scene, _ in contests))
    rows = []
    for scene in scenes:
        cells = []
        for target in TARGETS:
            contest = contests[scene, target]
            mark = {"win": Mark.best, "tie": Mark.tie}.get(contest.outcome)
            cells.append(Cell(contest.text(kind.show), marks=marks(mark)))
        rows.append((word(scene), *cells))
    heads = (Head("scene", words=True), *(Head(h.label, words=True) for h in error_heads()))
    tie = margin(work, kind)
    meaning = f"{kind.about} The cheapest at each error, then the next beyond a tie. {said(tie)} {DASHES}"
    return View(name, title, meaning, heads, tuple(rows), source)


def costs_view(work: pd.DataFrame, scene: str, kind: Kind, source: str) -> View:
    """What each error costs each method on a scene; the cheapest in bold, ties marked."""
    contests = {target: lead(work, scene, target, kind) for target in TARGETS}
    methods = [
        m
        for m in dict.fromkeys(contestants(work)["method"])
        if any(m in c.costs or m in c.missing for c in contests.values())
    ]
    rows = []
    for method in methods:
        cells = []
        for contest in contests.values():
            own = contest.costs.get(method) or contest.missing[method]
            leading = method in contest.first
            mark = (Mark.best if len(contest.first) == 1 else Mark.tie) if leading else None
            value = own.value if own.reached else None
            cells.append(Cell(own.text(kind.show), value, marks(mark, Mark.bound if own.bound else None)))
        rows.append((word(method), *cells))
    meaning = f"{kind.about} {said(margin(work, kind))} {DASHES}"
    return View(
        f"{kind.name}_{scene}", f"{kind.title} on {scene}", meaning,
        (Head("method", words=True), *error_heads()), tuple(rows), source,
    )  # fmt: skip


def duel_view(work: pd.DataFrame, scene: str, kind: Kind, source: str) -> View | None:
    """Decade by decade the best contact method beside the best other; None if a camp has no rows there."""
    tie = margin(work, kind)
    contests = {target: lead(work, scene, target, kind, tie) for target in DECADES}
    everyone = {m for c in contests.values() for m in (*c.costs, *c.missing)}
    family = next(iter(contests.values())).family
    if len({family[m] == CONTACT for m in everyone}) < 2:
        return None
    rows = []
    for target, contest in contests.items():
        cells = []
        for contact in (True, False):
            best = contest.best(contact)
            if best is None:
                whys = {c.reason for m, c in contest.missing.items() if (family[m] == CONTACT) == contact}
                cells.append(word(", ".join(sorted(whys - {DASH})) or DASH))
            else:
                mark = {"win": Mark.best, "tie": Mark.tie, "loss": None}[contest.outcome]
                if not contact:
                    mark = {"loss": Mark.best, "tie": Mark.tie, "win": None}[contest.outcome]
                cells.append(Cell(f"{best} {contest.costs[best].text(kind.show)}", marks=marks(mark)))
        finite = math.isfinite(contest.ratio) and contest.ratio > 0
        outcome = {"win": "contact", "loss": "other", "tie": "tie", "": DASH}[contest.outcome]
        ratio = Cell(times(contest.ratio), contest.ratio) if finite else Cell(DASH)
        rows.append((word(power(target)), *cells, ratio, word(outcome)))
    heads = (
        Head("error", words=True), Head("best contact method", words=True), Head("best other method", words=True),
        Head("other / contact", "cost of the best other method in units of the best contact method"),
        Head("cheaper", words=True),
    )  # fmt: skip
    meaning = f"{kind.about} {said(tie)} {DASHES}"
    return View(f"duel_{kind.name}_{scene}", f"{kind.title} on {scene}", meaning, heads, tuple(rows), source)


def losses_view(work: pd.DataFrame, name: str, source: str) -> View:
    """Every scene and error at which another method is cheaper than every contact method, kind by kind."""
    contests = {kind: leads(work, kind) for kind in KINDS}
    rows = []
    for scene in dict.fromkeys(work["scene"]):
        for kind, found in contests.items():
            cells = []
            for target in TARGETS:
                contest = found.get((scene, target))
                if contest is None or contest.outcome != "loss":
                    cells.append(Cell(""))
                    continue
                other = str(contest.best(contact=False))
                alone = contest.ratio == 0
                text = f"{other}, alone" if alone else f"{other} {times(1 / contest.ratio)}"
                cells.append(Cell(text, None if alone else 1 / contest.ratio))
            if any(cell.text for cell in cells):
                rows.append((word(scene), word(kind.title), *cells))
    heads = (Head("scene", words=True), Head("compared", words=True), *error_heads())
    meaning = (
        "What the best contact method costs in units of the cheapest other method. Blank: a contact method is "
        "cheapest, or it is a tie, or nobody gets there. Alone: no contact method reaches the error."
    )
    return View(name, "Where the contact methods lose", meaning, heads, tuple(rows), source)


def standing(work: pd.DataFrame, kind: Kind) -> tuple[str, str] | None:
    """The tally as a sentence, and what it covers; None without contests."""
    contests = leads(work, kind)
    count_ = tally(contests.values())
    if not count_.decided:
        return None
    against = ", ".join(f"{method} {n}" for method, n in camps(contests.values()).items())
    sentence = (
        f"A contact method is cheapest in {count_.wins} of {count_.decided} pairs of scene and error, "
        f"{count_.ties} are ties, another method is cheapest in {count_.losses}"
        + (f" ({against})." if against else ".")
    )
    scenes = list(dict.fromkeys(scene for scene, _ in contests))
    won = []
    for scene in scenes:
        own = [contests[scene, t] for t in TARGETS if contests[scene, t].outcome]
        if own and all(c.outcome == "win" for c in own):
            known = [c.ratio for c in own if math.isfinite(c.ratio)]
            by = (
                f" ({times(min(known))} to {times(max(known))} ahead of the best other method)"
                if known
                else ""
            )
            won.append(f"`{scene}`{by}")
    if won:
        sentence += f" A contact method is cheapest at every error on {names(won)}."
    covers = (
        f"{len(scenes)} scenes, errors {', '.join(power(t) for t in TARGETS)}; a tie: within "
        f"{100 * (margin(work, kind) - 1):.0f} %"
        + (f"; {count_.open} pairs that nobody reaches are not counted" if count_.open else "")
    )
    return sentence, covers


def families(frames: Frames) -> dict[str, str]:
    """The family every method declares, from all tables that have one."""
    found: dict[str, str] = {}
    for frame in frames.values():
        if {"method", "family"} <= set(frame.columns):
            pairs = frame[["method", "family"]].dropna().drop_duplicates()
            found |= {str(m): str(f) for m, f in pairs.itertuples(index=False)}
    return found
