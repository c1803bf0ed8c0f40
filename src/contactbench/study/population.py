"""What does an error cost on problems nobody chose?  One cell: the problems of a family and a seed.

Each method goes from a coarse setting towards each error by its own slope; what an error costs is interpolated between
the settings around it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from time import perf_counter

import numpy as np

from contactbench.measure.clock import Call
from contactbench.measure.statistics import costs_to_reach
from contactbench.methods.base import METHODS, Method, prepare
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.prepared import Prepared
from contactbench.peers.heyoka import SHARED
from contactbench.results.advice import WORST
from contactbench.results.tables import POPULATION, POPULATION_HARD, POPULATION_PROBLEMS
from contactbench.solution import Solution, Status, keywords
from contactbench.study.experiment import Cell, Profile, Recorded, Row, experiment
from contactbench.study.features import Features, features
from contactbench.study.problems import (
    COUNT,
    FAMILIES,
    HARD,
    HARD_COUNT,
    REPLICATE,
    REPLICATED,
    SEED,
    Problem,
    draw,
)
from contactbench.study.search import Question
from contactbench.study.settings import carry_of
from contactbench.truth import Reference

#: those that are best anywhere in the tables, the classical ones, and what libraries compile soon; first those by whose
#: cost others are given up
RACED = (
    *("rkn12-10", "rkn8", "rk8-7", "rkn8-6", "rkn12", "rk8", "contact-rkn8", "contact-rkn6", "contact-rkn4"),
    *(
        "contact-o8",
        "contact-bm6",
        "contact-strang",
        "contact-exact",
        "contact-log8",
        "rk4",
        "quinlan-tremaine12",
        "stormer12",
    ),
    *("gauss6", "cvode-adams", "cyrk-dop853", "cyrk-vern8", "cyrk-lsoda", "heyoka-taylor"),
)
#: what runs under a name, where it is not what is registered
ALIKE = {SHARED.name: SHARED}
#: of what compiles for every tolerance, the only ones
RUNGS = {SHARED.name: (1e-3, 1e-5, 1e-8, 1e-11, 2.3e-16)}
ERRORS = (1e-3, 1e-6, 1e-9)
#: ends of runs whose largest error counts, in parts of the span
ENDS = (0.5, 1.0)
#: what a run may take, in additions; what an evaluation takes beside them; and settings of a method for one error
LONGEST, BESIDE, TRIES = 3e7, 20.0, 5
#: evaluations of an adaptive step, about: of one-step methods, and of those that choose their order, whose own work is
#: worth so many additions an evaluation
TYPICAL, VARIABLE, OWN_WORK = 12.0, 2.0, 150.0
#: the error aimed at, in parts of that asked for; near enough to it; and settings between which is interpolated
AIM, NEAR, APART = 0.5, 8.0, 1.6
#: by how much a step changes at most from one setting to the next, a tolerance by its square
LEAP = 24.0
#: truth: an error is asked for that is so many times what two solvers differ by
CLEAR = 10.0
#: the coarsest step in 1/ω for each evaluation it takes, and the loosest tolerance to begin with
FIRST_STEP, FIRST_TOLERANCE = 0.25, 1e-4
#: visits of a call, and how many times slower than the fastest it may be to be visited again
VISITS, SLOWER = 3, 10.0
#: of hard problems: the tolerance, what is wrong, and steps in a period of what takes no tolerance
TOLERANCE, WRONG, HARD_STEPS = 1e-6, 1e3, 1000
#: the seed that `--seed` gives; None: the two of the repository
OWN_SEED: list[int] = []


@dataclass(frozen=True)
class Tried:
    """A setting of a method: how it ended, its error, its cost."""

    value: float
    status: Status
    message: str
    error: float
    evaluations: float
    run: Prepared
    #: of the whole run, once: what its parts say
    seconds: float

    @property
    def ok(self) -> bool:
        return self.status is Status.ok and math.isfinite(self.error)


@dataclass
class Trial:
    """One method on one problem: the settings tried."""

    question: Question
    method: Method
    known: Features
    #: evaluations that a run may make
    limit: float = math.inf
    tried: list[Tried] = field(default_factory=list)

    def attempt(self, value: float, control: str = "") -> Tried:
        scene, carry = self.question.scene, carry_of(self.question.scene)
        beside = OWN_WORK if self.stages == VARIABLE else BESIDE
        most = max(100, int(min(self.limit, LONGEST / (self.known.cost + beside)) / self.stages))
        runs = []
        for part in ENDS:
            end = part * scene.t_end
            given = keywords(control or self.method.control, value)
            runs.append(prepare(scene, self.method, save_at=[end], carry=carry, max_steps=most, **given))
        solutions: list[Solution] = []
        seconds = math.inf
        for part, run in zip(ENDS, runs, strict=True):
            begun = perf_counter()
            solutions.append(run())
            seconds = min(seconds, (perf_counter() - begun) / part)
            if not solutions[-1].ok:
                break
        last = solutions[-1]
        error = self.question.error(solutions) if last.ok else math.nan
        count = last.counts.rhs_equivalents
        self.tried.append(
            Tried(
                value,
                last.status,
                last.message,
                error,
                math.nan if count is None else count,
                runs[-1],
                seconds,
            )
        )
        return self.tried[-1]

    @property
    def stages(self) -> float:
        """Return the evaluations of a step, about."""
        each = self.method.per_step(self.question.scene) if isinstance(self.method, FixedStep) else 0
        return float(each or (TYPICAL if self.method.order else VARIABLE))

    # -- the next setting ------------------------------------------------------------------------------
    def allowed(self, value: float) -> float:
        if self.method.name in RUNGS:
            return min(RUNGS[self.method.name], key=lambda rung: abs(math.log(rung / value)))
        if self.method.adaptive:
            low, high = self.method.rtol_range
            return float(f"{min(max(value, low), high):.3g}")
        end = self.question.scene.t_end  # a step ends at both ends
        return end / (2 * max(1, round(end / value / 2)))

    def first(self) -> float:
        if self.method.adaptive:
            return self.allowed(FIRST_TOLERANCE)
        return self.allowed(FIRST_STEP * self.stages / self.known.omega)

    def next(self, target: float) -> float:
        """Return the setting at which the slope of the error reaches a little less than the target."""
        good = [one for one in self.tried if one.ok and one.error > 0]
        if not good:
            return self.allowed(min(one.value for one in self.tried) / 4)
        off = lambda one: abs(math.log(one.error / target))  # noqa: E731
        near, *others = sorted(good, key=off)
        slope = order = 1.0 if self.method.adaptive else float(self.method.order or 1)
        for other in others[:1]:
            if other.value != near.value and other.error != near.error:
                found = math.log(other.error / near.error) / math.log(other.value / near.value)
                slope = min(max(found, order / 2), 1.5 * order)
        leap = LEAP**2 if self.method.adaptive else LEAP
        ratio = min(max((AIM * target / near.error) ** (1 / slope), 1 / leap), leap)
        value = near.value * ratio
        bad = [one.value for one in self.tried if not one.ok and one.value > near.value]
        return self.allowed(math.sqrt(near.value * min(bad)) if bad and value >= min(bad) else value)

    def finer(self, value: float) -> float:
        """Return the next setting below one."""
        if self.method.name in RUNGS:
            return max((rung for rung in RUNGS[self.method.name] if rung < value), default=value)
        return self.allowed(value / 2)

    def enclosed(self, target: float) -> bool:
        good = [one for one in self.tried if one.ok]
        reach = [one for one in good if one.error <= target]
        if any(one.error >= target / NEAR for one in reach):
            return True
        miss = [one for one in good if one.error > target]
        fewest = min((one.evaluations for one in reach), default=math.nan)
        return bool(miss) and fewest <= APART * max(one.evaluations for one in miss)

    def search(self, targets: Sequence[float], least: dict[float, float]) -> None:
        """Try settings for each error; least : evaluations that it has cost any method so far, which are kept."""
        if self.method.exact:
            self.attempt(0.0)
            return
        last = self.attempt(self.first())
        for target in targets:
            self.limit = WORST * least.get(target, math.inf)
            for _ in range(TRIES):
                if last.status is Status.unsupported or self.enclosed(target):
                    break
                value, known = self.next(target), [one.value for one in self.tried]
                if value in known and self.best(target) is None:
                    value = self.finer(min(known))
                if value in known:
                    break
                last = self.attempt(value)
                if last.status is Status.budget and value < min(one.value for one in self.tried[:-1]):
                    return
            if (best := self.best(target)) is not None:
                least[target] = min(least.get(target, math.inf), best.evaluations)

    # -- what came out -----------------------------------------------------------------------------------
    def best(self, target: float) -> Tried | None:
        reach = (one for one in self.tried if one.ok and one.error <= target)
        return min(reach, key=lambda one: one.evaluations, default=None)

    def rows(self, targets: Sequence[float], seconds: dict[int, float]) -> Iterator[Row]:
        good = [one for one in self.tried if one.ok]
        errors = [max(one.error, 1e-300) for one in good]
        costs = costs_to_reach(errors, [one.evaluations for one in good], targets)
        for target, cost in zip(targets, costs, strict=True):
            best, finest = self.best(target), min(self.tried, key=lambda one: one.value)
            row: Row = {"error": target, "control": self.method.control, "engine": finest.run.request.engine}
            if best is None or math.isnan(cost):
                ended = finest.status is not Status.ok
                why = str(finest.status) if ended else "unreached"
                yield row | {"status": why, "message": finest.message or "no setting tried is as accurate"}
                continue
            share = cost / best.evaluations if best.evaluations else 1.0
            order = 1.0 if self.method.adaptive else float(self.method.order or 1)
            value = best.value * (
                (target / max(best.error, target * AIM)) ** (1 / order) if share < 1 else 1.0
            )
            yield row | {
                "status": "ok",
                "message": "",
                "value": value,
                "evaluations": cost,
                "error_reached": best.error,
                "time_s": seconds.get(id(best), math.nan) * share,
            }


# -- the truth ---------------------------------------------------------------------------------------
#: pairs are tried until one is refused by neither
TIGHT = (("rkn12-10", 1e-14), ("rk8-7", 1e-14))


def truth_of(problem: Problem) -> tuple[Reference | None, str]:
    """Return what two solvers agree on at the ends, and which; None where either fails."""
    scene, carry = problem.scene, carry_of(problem.scene)
    ends = [part * scene.t_end for part in ENDS]
    method, rtol = next(each for each in TIGHT if METHODS[each[0]].refuses(scene) is None)
    solvers: list[tuple[Method | str, float]] = [(SHARED, SHARED.rtol_range[0])]
    solvers.append((method, max(rtol, METHODS[method].rtol_range[0])))
    found = [prepare(scene, one, save_at=ends, carry=carry, rtol=tight)() for one, tight in solvers]
    source = f"heyoka-taylor, {method}"
    if not all(one.ok for one in found):
        return None, next(f"{one.method}: {one.message}" for one in found if not one.ok)
    y, other = (one.y for one in found)
    gap = float(np.abs(y - other).max() / np.abs(y).max())
    digits = max(0, math.floor(-math.log10(max(gap, 1e-16))))
    return Reference(scene, carry, np.array(ends), y, [], digits, "two solvers"), source


# -- rows ----------------------------------------------------------------------------------------------
def problem_row(problem: Problem, known: Features, digits: int, source: str) -> Row:
    return {
        "seed": problem.seed,
        "scene": problem.scene.name,
        "structure": problem.family,
        "hard": problem.hard,
        "t_end": problem.scene.t_end,
        "digits": digits,
        "source": source,
    } | known.row()


def raced() -> dict[str, Method]:
    return {name: ALIKE.get(name, METHODS[name]) for name in RACED}


def cost_rows(problem: Problem) -> Recorded:
    known = features(problem.scene)
    truth, source = truth_of(problem)
    yield POPULATION_PROBLEMS, problem_row(problem, known, truth.digits if truth else 0, source)
    if truth is None:
        return
    targets = [error for error in ERRORS if error >= CLEAR * 10.0**-truth.digits]
    question = Question(problem.scene, truth, ERRORS, math.inf)
    trials = [
        Trial(question, method, known) for method in raced().values() if not method.refuses(problem.scene)
    ]
    least: dict[float, float] = {}
    with np.errstate(all="ignore"):
        for trial in trials:
            trial.search(targets, least)
        seconds = visited([a for trial in trials for error in targets if (a := trial.best(error))])
    for trial in trials:
        for row in trial.rows(targets, seconds):
            name = {"seed": problem.seed, "scene": problem.scene.name, "method": trial.method.name}
            yield POPULATION, name | row


def visited(tried: Sequence[Tried]) -> dict[int, float]:
    """Return the least time of the bare call of each setting, all visited in turns; of slow ones that of its run."""
    seconds = {id(one): one.seconds for one in tried}
    most = SLOWER * min(seconds.values(), default=0.0)
    runs = {id(one): one.run for one in tried if one.seconds <= most}
    calls = {name: Call(partial(run.bare, run.start), round_seconds=1e-4) for name, run in runs.items()}
    for _ in range(VISITS):
        for call in calls.values():
            call.visit(1)
    return seconds | {name: call.once[0] for name, call in calls.items()}


def hard_rows(problem: Problem) -> Recorded:
    """Yield how each method ends that is given a tolerance, or a step where it takes none."""
    known = features(problem.scene)
    truth, source = truth_of(problem)
    yield POPULATION_PROBLEMS, problem_row(problem, known, truth.digits if truth else 0, source)
    if truth is None or 10.0**-truth.digits * CLEAR > TOLERANCE * WRONG:
        return
    question = Question(problem.scene, truth, ERRORS, math.inf)
    for name, method in raced().items():
        if method.refuses(problem.scene):
            continue
        steps = method.control == "step" and not (method.one_step or method.follows)
        control = "exact" if method.exact else "step" if steps else "rtol"
        value = 2 * math.pi / known.omega / HARD_STEPS if steps else TOLERANCE
        with np.errstate(all="ignore"):
            one = Trial(question, method, known).attempt(0.0 if method.exact else value, control)
        row = {"seed": problem.seed, "scene": problem.scene.name, "hard": problem.hard, "method": name}
        row |= {"control": control, "value": one.value, "status": str(one.status), "message": one.message}
        yield (
            POPULATION_HARD,
            row
            | {
                "engine": one.run.request.engine,
                "error_reached": one.error,
                "evaluations": one.evaluations,
                "right": one.error <= TOLERANCE * WRONG if one.ok else None,
            },
        )


# -- cells ---------------------------------------------------------------------------------------------
#: of the smoke profile the first problem of these
SMOKE = ("pendulum", "toda-2")


def cells(profile: Profile) -> list[Cell]:
    """Return family, seed, and the first and last of its problems, or kind of hard problem and seed."""
    seeds = {seed: REPLICATED if seed == REPLICATE else COUNT for seed in OWN_SEED or (SEED, REPLICATE)}
    found: list[Cell] = [(family, seed, 0, 1) for seed in seeds for family in SMOKE if seed != REPLICATE]
    if not profile.brief:
        for seed, count in seeds.items():
            first = [int((family, seed, 0, 1) in found) for family in FAMILIES]
            found += [(f, seed, k, count) for f, k in zip(FAMILIES, first, strict=True)]
    return found


def hard_cells(profile: Profile) -> list[Cell]:
    seeds = OWN_SEED or [SEED]
    return [] if profile.brief else [(kind, seed) for seed in seeds for kind in HARD]


@experiment(cells)
def population(cell: Cell, profile: Profile) -> Recorded:
    family, seed, low, high = cell
    for number in range(low, high):
        yield from cost_rows(draw(seed, family, number))


@experiment(hard_cells)
def population_hard(cell: Cell, profile: Profile) -> Recorded:
    kind, seed = cell
    for number in range(HARD_COUNT):
        families = HARD[kind].families
        yield from hard_rows(draw(seed, families[number % len(families)], number, kind))
