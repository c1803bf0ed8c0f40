"""Hard scenes and stability limits: how every method ends, and what follows for practice."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pandas as pd

from contactbench.report.contest import EVALUATIONS, NAMED, Field, standing
from contactbench.report.figures import stability as figures
from contactbench.report.laws import bounded, called, drift_cell, laws, numbers
from contactbench.report.model import (
    DASH,
    ROOMS,
    Cell,
    Finding,
    Frames,
    Head,
    Mark,
    Part,
    Room,
    Section,
    Text,
    View,
    marks,
    number,
    word,
)  # fmt: skip
from contactbench.report.numbers import count, names, scientific, upper
from contactbench.report.raw import raw
from contactbench.results.round_off import STRUCTURE
from contactbench.results.schema import Rule
from contactbench.results.tables import (
    DAMPING_RATES,
    ONE_STEP,
    STABILITY,
    STABILITY_LIMITS,
    STRONG_DAMPING,
)  # fmt: skip

#: above this condition number the round-off of a solution is more than round-off
WELL_CONDITIONED = 1e3
#: errors whose ratio is within this are as good as equal
ALIKE = 2.0
#: a method may cost this much more than the others and still be at equal cost
AFFORDABLE = 1.15
#: γh per evaluation is sorted into ranges with these borders
DAMPING_RANGES = (0.0, 0.01, 0.1, 1.0, 10.0, math.inf)
#: with which the others are compared under strong damping: a composition without steps against time
BASE = "contact-strang"
RUNGS = ("coarse", "medium", "fine")


# -- how it ends -----------------------------------------------------------------------------------
def rungs(frame: pd.DataFrame) -> list[str]:
    """Names for the settings of a ladder, coarse to fine."""
    most = int(frame.groupby(["scene", "method", "engine"]).size().max()) if len(frame) else 0
    return list(RUNGS) if most == len(RUNGS) else [f"setting {i + 1}" for i in range(most)]


def ending(row: pd.Series, digits: int = 0) -> Cell:
    """The error of a run, or how it ended; where the true motion reaches infinity, diverging is right."""
    if row["status"] == "ok":
        return number(row["solution_error"], lambda e: scientific(e, digits), hint=str(row["setting"]))
    right = row["status"] == "diverged" and not pd.isna(row["blow_up_time"])
    mark = Mark.right if right else Mark.none if row["status"] == "unsupported" else Mark.bad
    return Cell(str(row["status"]), marks=marks(mark), hint=f"{row['setting']}: {row['message']}")


def map_view(frame: pd.DataFrame) -> View:
    """Every run at a glance: methods × scenes, each with its ladder of settings."""
    scenes, steps = list(dict.fromkeys(frame["scene"])), rungs(frame)
    rows = []
    for method, mine in frame.groupby("method", sort=False):
        cells = [word(method)]
        for scene in scenes:
            runs = [ending(r) for _, r in mine[mine["scene"] == scene].iterrows()]
            cells += [*runs, *(Cell(DASH) for _ in range(len(steps) - len(runs)))]
        rows.append(tuple(cells))
    heads = (Head("method", words=True), *(Head(rung, group=scene) for scene in scenes for rung in steps))
    meaning = "Solution error at each setting of the ladder, coarse to fine, or how the run ended."
    return View(
        "how_it_ends", "How it ends", meaning, heads, tuple(rows), "stability.csv", detail=True, map=True
    )


def scene_view(frame: pd.DataFrame, scene: str) -> View:
    """One hard scene: the ladder of errors, the worst of each law, the cost of the finest run."""
    part, steps = bounded(frame[frame["scene"] == scene]), rungs(frame)
    ok = part[part["status"] == "ok"]
    shown = [law for law in laws(STABILITY, "stability") if law != "solution_error" and ok[law].notna().any()]
    rows = []
    for method, mine in part.groupby("method", sort=False):
        good = mine[mine["status"] == "ok"]
        runs = [ending(r) for _, r in mine.iterrows()]
        cells = [word(method), *runs, *(Cell(DASH) for _ in range(len(steps) - len(runs)))]
        for law in shown:
            values = good[good[law].notna()]
            cells.append(drift_cell(values.loc[values[law].idxmax()], law) if len(values) else Cell(DASH))
        cells.append(number(good["rhs_equivalents"].max() if len(good) else None, count))
        whys = dict.fromkeys(m for m in mine[mine["status"] != "ok"]["message"] if m)
        cells.append(word(shortened("; ".join(whys))))
        rows.append(tuple(cells))
    labels = (Head(called(law), STABILITY.columns[law].meaning, group="worst") for law in shown)
    heads = (
        Head("method", words=True), *(Head(rung, group="solution error") for rung in steps), *labels,
        Head("evaluations", "of the finest run that ended ok"), Head("why not ok", words=True),
    )  # fmt: skip
    return View(f"hard_{scene}", scene, condition_note(part), heads, tuple(rows), "stability.csv")


def shortened(text: str, most: int = 90) -> str:
    return text if len(text) <= most else text[: most - 1] + "…"


def condition_note(part: pd.DataFrame) -> str:
    condition = numbers(part, "condition_number").max()
    if not condition > WELL_CONDITIONED:
        return ""
    return (
        f"Condition number {scientific(condition)}: round-off alone makes an error of about "
        f"{scientific(condition * np.finfo(float).eps)}."
    )


def blow_up_view(frame: pd.DataFrame) -> View | None:
    """When a run is said to have diverged against the true time of blow-up: one line per method."""
    part = frame[frame["blow_up_time"].notna() & (frame["status"] != "unsupported")]
    if not len(part):
        return None
    rows = []
    for method, mine in part.groupby("method", sort=False):
        off = mine["end_time"] / mine["blow_up_time"] - 1
        worst, finest = off.loc[off.abs().idxmax()], off.iloc[-1]
        told = Mark.right if set(mine["status"]) == {"diverged"} else Mark.bad
        rows.append((
            word(method), word(", ".join(dict.fromkeys(mine["status"])), told),
            number(100 * finest, "{:+.3f} %".format), number(100 * worst, "{:+.3f} %".format),
        ))  # fmt: skip
    heads = (
        Head("method", words=True), Head("status", "over all settings", words=True),
        Head("off at the finest", "time told at the finest setting, relative to the true time of blow-up"),
        Head("off at worst", "the same at the setting where it is furthest off"),
    )  # fmt: skip
    scene, time = part["scene"].iloc[0], part["blow_up_time"].iloc[0]
    meaning = f"The motion of `{scene}` reaches infinity at t = {time:.10g}."
    return View("blow_up", "Blow-up", meaning, heads, tuple(rows), "stability.csv")


# -- limits ----------------------------------------------------------------------------------------
def limit_view(frame: pd.DataFrame, column: str, name: str, title: str) -> View | None:
    """Methods × damping of one limit at ω = 1; theory in parentheses beside the first loss of stability."""
    one = frame[(frame["omega"] == 1.0) & frame[column].notna()]
    if not len(one):
        return None
    gammas = sorted(one["gamma"].unique())
    rows = []
    for method, mine in one.groupby("method", sort=False):
        line = mine.set_index("gamma")
        cells = [word(method)]
        for gamma in gammas:
            if gamma not in line.index:
                cells.append(Cell(DASH))
                continue
            row = line.loc[gamma]
            theory = row["theory"] if column == "limit" else math.nan
            known = "" if pd.isna(theory) else f" ({theory:.4g})"
            gaps = Mark.exception if column == "limit" and row["windows"] else None
            value = number(row[column], "{:.4g}".format, gaps)
            cells.append(replace(value, text=value.text + known))
        rows.append(tuple(cells))
    heads = (Head("method", words=True), *(Head(f"γ = {g:g}") for g in gammas))
    meaning = f"{upper(STABILITY_LIMITS.columns[column].meaning)}; q'' + γq' + q = 0."
    if column == "limit":
        meaning += (
            " In parentheses what theory gives. Marked: larger steps are stable again, see the windows."
        )
    return View(name, title, meaning, heads, tuple(rows), "stability_limits.csv")


def windows_view(frame: pd.DataFrame) -> View | None:
    rows = [
        (
            word(r["method"]),
            number(r["gamma"], "{:g}".format),
            number(r["limit"], "{:.4g}".format),
            word(r["windows"]),
        )
        for _, r in frame[(frame["omega"] == 1.0) & (frame["windows"] != "")].iterrows()
    ]
    if not rows:
        return None
    heads = (
        Head("method", words=True), Head("γ"), Head("first loss of stability"), Head("unstable steps", words=True),
    )  # fmt: skip
    meaning = f"{upper(STABILITY_LIMITS.columns['windows'].meaning)}; ω = 1."
    return View("windows", "Windows of instability", meaning, heads, tuple(rows), "stability_limits.csv")


def limits_section(frame: pd.DataFrame, radius: pd.DataFrame) -> Iterator[Part]:
    views = (
        limit_view(frame, "limit", "limits", "First loss of stability"),
        windows_view(frame),
        limit_view(frame, "limit_kernel", "limits_kernel", "Processed methods saved at the end only"),
        limit_view(frame, "limit_saved", "limits_saved", "Processed methods saved at every step"),
    )
    yield from (view for view in views if view is not None)
    if len(frame):
        yield figures.limits(frame)
    if len(radius):
        yield figures.radius(radius)


# -- rates of damping ------------------------------------------------------------------------------
def rate_cell(rows: pd.DataFrame, column: str) -> Cell:
    if not len(rows):
        return Cell(DASH)
    row = rows.iloc[0]
    if row["status"] != "ok":
        return Cell(
            str(row["status"]), marks=marks(Mark.none if row["status"] == "unsupported" else Mark.bad)
        )
    return number(row[column], "{:.4g}".format if column == "ratio" else scientific)


def creep_views(frame: pd.DataFrame) -> Iterator[View]:
    """The slow rate of the overdamped oscillator."""
    creep = frame[frame["experiment"] == "overdamped"]
    meaning = f"{upper(DAMPING_RATES.columns['ratio'].meaning)} of the slow rate, γ = 50: one is right."
    for control, key, title in (
        ("step", "damping_per_step", "γh = {:g}"),
        ("rtol", "value", "rtol = {:.0e}"),
    ):
        part = creep[creep["control"] == control]
        if not len(part):
            continue
        columns = sorted(part[key].dropna().unique(), reverse=True)
        rows = [
            (word(method), *(rate_cell(mine[mine[key] == c], "ratio") for c in columns))
            for method, mine in part.groupby("method", sort=False)
        ]
        heads = (Head("method", words=True), *(Head(title.format(c)) for c in columns))
        kind = "fixed steps" if control == "step" else "adaptive"
        yield View(
            f"creep_{control}",
            f"Overdamped: the slow rate, {kind}",
            meaning,
            heads,
            tuple(rows),
            "damping_rates.csv",
        )


def fading_view(frame: pd.DataFrame) -> View | None:
    """The rate of weak damping at about equal cost."""
    weak = frame[frame["experiment"] == "weak"]
    if not len(weak):
        return None
    questions = list(dict.fromkeys(zip(weak["scene"], weak["t_end"], strict=True)))
    rows = []
    for method, mine in weak.groupby("method", sort=False):
        cells = [word(method)]
        for scene, span in questions:
            here = mine[(mine["scene"] == scene) & (mine["t_end"] == span)]
            spent = here["evaluations"].iloc[0] if len(here) and here["status"].iloc[0] == "ok" else None
            cells += [rate_cell(here, "rate_error"), number(spent, count)]
        rows.append(tuple(cells))
    heads = [Head("method", words=True)]
    for scene, span in questions:
        group = f"{scene}, T = {span:.0e}"
        heads += [
            Head("error", DAMPING_RATES.columns["rate_error"].meaning, group=group),
            Head("evaluations", group=group),
        ]
    meaning = (
        "|measured/true − 1| of the rate at which H0 falls, γ = 10⁻⁵, at about the same number of "
        "evaluations for every "
        "method, or as near to that as its tolerances come."
    )
    return View(
        "fading",
        "Weak damping: the rate at equal cost",
        meaning,
        tuple(heads),
        tuple(rows),
        "damping_rates.csv",
    )


# -- strong damping --------------------------------------------------------------------------------
def usable(frame: pd.DataFrame, method: str, gamma: float) -> float:
    """The largest γh per evaluation up to which the method is never worse than the base; 0 if nowhere."""
    part = frame[frame["gamma"] == gamma].pivot_table(
        index="damping_per_evaluation", columns="method", values="error", dropna=False
    )
    worse = (part[method] > part[BASE] * 1.001).to_numpy()
    grid = part.index.to_numpy()
    start = int(np.argmax(~worse)) if (~worse).any() else None
    if start is None or start > len(grid) // 2:
        return 0.0
    behind = np.flatnonzero(worse[start:])
    return float(grid[-1] if not len(behind) else grid[start + behind[0] - 1])


def strong_parts(frame: pd.DataFrame) -> Iterator[Part]:
    if BASE not in set(frame["method"]):  # all others are compared with it
        return
    gammas = sorted(frame["gamma"].unique())
    heads = tuple(Head(f"γ = {g:g}") for g in gammas)
    rows = tuple(
        (word(method), *(number(usable(frame, method, g), "{:.2g}".format) for g in gammas))
        for method in dict.fromkeys(frame["method"]) if method != BASE
    )  # fmt: skip
    yield View(
        "strong_usable", "Strong damping: where negative substeps stop paying",
        f"Damping between two evaluations, γh/evaluations, up to which a method is no less accurate than {BASE} at the "
        "same cost (oscillator, ω = 1, over the time in which the motion falls by e; 0: nowhere). "
        "Substeps against time "
        "grow by e^{γ|a|h}.", (Head("method", words=True), *heads), rows, "strong_damping.csv",
    )  # fmt: skip
    ranges = []
    for low, high in itertools.pairwise(DAMPING_RANGES):
        label = (
            f"below {high:g}"
            if low == 0
            else f"above {low:g}"
            if math.isinf(high)
            else f"{low:g} to {high:g}"
        )
        ranges.append((word(label), *(alike_cell(in_range(frame, g, low, high)) for g in gammas)))
    yield View(
        "strong_best", "Strong damping: the most accurate fixed-step method at equal cost",
        f"Median error in each range of γh per evaluation, oscillator; methods within a factor of {ALIKE:g} are named "
        f"together. {DASH}: no error below one.",
        (Head("γh per evaluation", words=True), *(Head(h.label, words=True) for h in heads)), tuple(ranges),
        "strong_damping.csv",
    )  # fmt: skip
    yield figures.strong(frame, gammas)


def in_range(frame: pd.DataFrame, gamma: float, low: float, high: float) -> pd.Series:
    """Median error of every method in a range of damping per evaluation."""
    inside = frame["damping_per_evaluation"].between(low, high, inclusive="left")
    part = frame[(frame["gamma"] == gamma) & inside].assign(error=lambda f: f["error"].fillna(np.inf))
    return part.groupby("method", sort=False)["error"].median()


def alike_cell(errors: pd.Series) -> Cell:
    """The most accurate, and those within ALIKE of it; all that is round-off is alike."""
    errors = errors[errors < 1].sort_values(kind="stable")
    if not len(errors):
        return Cell(DASH)
    first = [str(m) for m in errors.index[errors <= max(STRUCTURE, ALIKE * errors.iloc[0])]]
    tied = len(first) > 1
    text = f"tie: {names(first, NAMED)}" if tied else first[0]
    least = float(errors.iloc[0])
    return Cell(f"{text} {scientific(least)}", least, marks(Mark.tie if tied else Mark.best))


# -- which integrator for which problem ------------------------------------------------------------
#: what a scene stands for; others are known by their name alone
PROBLEMS = {
    "particle": "one short run, smooth forces",
    "particle_long": "a long run, weak damping",
    "rigid_body": "a damped rigid body",
    "kepler_drag": "close encounters, an eccentric orbit",
    "stiff_spring": "two time scales, the fast one alive",
    "needle": "a very slender body",
    "tumbling": "a body tumbling about its unstable axis",
    "overdamped": "strong damping",
    "critical": "critical damping",
    "weak_damping": "hardly any damping",
    "weak_damping_particle": "hardly any damping, several degrees of freedom",
    "saddle_edge": "at the edge of escape",
    "quadratic_damping": "damping that is quadratic in s",
}


def problem(scene: str) -> str:
    said = PROBLEMS.get(scene) or (
        "friction about some axes only" if scene.startswith("singular_damping") else ""
    )
    return f"{said} (`{scene}`)" if said else f"`{scene}`"


def rates_view(frame: pd.DataFrame) -> View:
    """Errors of damping rates at equal cost, each question with its ties."""
    rows = []
    creep = frame[(frame["experiment"] == "overdamped") & (frame["status"] == "ok")]
    for damping in sorted(creep["damping_per_step"].dropna().unique(), reverse=True):
        fixed = creep[creep["damping_per_step"] == damping]
        budget = AFFORDABLE * float(fixed["evaluations"].max())
        adaptive = creep[creep["damping_per_step"].isna() & (creep["evaluations"] <= budget)]
        rows.append(
            (
                word(f"slow rate of creep, γh = {damping:g}"),
                *at_equal_cost(pd.concat([fixed, adaptive]), budget),
            )
        )
    weak = frame[(frame["experiment"] == "weak") & (frame["status"] == "ok")]
    for (scene, span), part in weak.groupby(["scene", "t_end"], sort=False):
        steps = part[part["control"] == "step"]
        budget = AFFORDABLE * float((steps if len(steps) else part)["evaluations"].max())
        rows.append(
            (
                word(f"rate of weak damping, `{scene}`, T = {span:.0e}"),
                *at_equal_cost(part[part["evaluations"] <= budget], budget),
            )
        )
    heads = (Head("rate", words=True), Head("most accurate", words=True), Head("evaluations allowed"))
    meaning = (
        "Error of a measured damping rate. Compared at equal cost: an adaptive method takes part "
        "with its settings that "
        f"cost no more than {100 * (AFFORDABLE - 1):.0f} % above the dearest fixed-step run. Methods "
        "within a factor of "
        f"{ALIKE:g} are a tie."
    )
    return View(
        "advice_rates", "Which integrator for damping rates", meaning, heads, tuple(rows), "damping_rates.csv"
    )


def at_equal_cost(rows: pd.DataFrame, budget: float) -> tuple[Cell, Cell]:
    errors = rows.groupby("method", sort=False)["rate_error"].min()
    return alike_cell(errors.astype(float)), number(budget, count)


# -- the room --------------------------------------------------------------------------------------
def findings(frames: Frames) -> list[Finding]:
    hard = frames["stability"]
    found = []
    tried = hard[hard["status"] != "unsupported"]
    if len(tried):
        right = np.where(tried["blow_up_time"].isna(), tried["status"] == "ok", tried["status"] == "diverged")
        bad = tried[~right]
        clean = [m for m in dict.fromkeys(tried["method"]) if m not in set(bad["method"])]
        most = bad.groupby("method", sort=False).size().sort_values(ascending=False, kind="stable")
        sentence = (
            f"{len(tried) - len(bad)} of {len(tried)} runs end as the true motion does, however accurate."
        )
        sentence += (
            f" Without another ending, on the scenes they take: {names(clean)}."
            if clean
            else " No method is without another ending."
        )
        if len(most):
            sentence += f" Most other endings: {names([f'{m} {n}' for m, n in most[:3].items()])}"
            kinds = bad["status"].value_counts()
            sentence += (
                f"; by kind {names([f'{kind} {n}' for kind, n in kinds.items()])} (budget: our own limit)."
            )
        found.append(
            Finding(
                "endings",
                "Hard scenes",
                sentence,
                f"{tried['method'].nunique()} methods on {tried['scene'].nunique()} scenes",
            )
        )
    if said := standing(Field(hard, EVALUATIONS)):
        found.append(Finding("hard_cost", "Evaluations on the hard scenes", *said))
    return found


def sections(frames: Frames) -> list[Part]:
    hard = frames["stability"]
    meanings = tuple(
        f"{called(name)}: {c.meaning}" + (" (a law that is kept or not)" if c.rule is Rule.structure else "")
        for name, c in laws(STABILITY, "stability").items()
    )
    drawn, ends = figures.hard(hard), blow_up_view(hard)
    parts: list[Part] = [
        Text(
            "Every method on every hard scene at a ladder of settings, coarse to fine. Runs are isolated and limited "
            "in steps and evaluations; how each ended is part of the result. Which method is cheapest where is in "
            "[README.md](README.md)."
        ),
        *([drawn] if drawn else []),
        *([ends] if ends else []),
        map_view(hard),
    ]
    limits = tuple(limits_section(frames["stability_limits"], frames["one_step"]))
    rates = [*creep_views(frames["damping_rates"]), fading_view(frames["damping_rates"])]
    strong = tuple(strong_parts(frames["strong_damping"]))
    if limits:
        parts.append(Section("Stability limits", limits))
    if any(rates):
        parts.append(Section("Rates of damping", tuple(v for v in rates if v is not None)))
    if strong:
        parts.append(Section("Strong damping", strong))
    scenes = tuple(
        Section(scene, (scene_view(hard, scene),), choice="scene") for scene in dict.fromkeys(hard["scene"])
    )
    parts.append(Section("Scene by scene", (Text(items=meanings), *scenes)))
    tables = (STABILITY, STABILITY_LIMITS, DAMPING_RATES, ONE_STEP, STRONG_DAMPING)
    return [*parts, *(raw(t, frames[t.name]) for t in tables if len(frames[t.name]))]


ROOMS.add(
    Room(
        "stability", "Numerical stability on hard cases",
        "hard scenes, stability limits, damping rates", 50,
        ("stability", "stability_limits", "one_step", "damping_rates", "strong_damping"),
        sections, findings,
    )
)  # fmt: skip
