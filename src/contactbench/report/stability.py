"""The stability tables as markdown, and what follows from them: which integrator for which problem."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np
import pandas as pd

from contactbench.measure.analysis import cost_to_reach
from contactbench.report.markdown import DASH, duration, markdown, scientific
from contactbench.results.schema import STABILITY

Frames = dict[str, pd.DataFrame]

#: error at which speeds are compared
TARGET = 1e-6
STRANG = "contact-strang"
#: γh per evaluation is sorted into ranges with these borders
DAMPING_RANGES = (0.0, 0.01, 0.1, 1.0, 10.0, math.inf)
#: at or below this a law is kept to round-off
ROUND_OFF = 1e-12
#: above this condition number round-off of Φ*η is more than round-off
WELL_CONDITIONED = 1e3
SHOWN = (
    "solution_error", "end_error", "energy_law", "hamiltonian_law", "momentum_law", "contact_drift",
    "attitude_drift",
)  # fmt: skip


def stability_document(tables: Frames) -> str:
    frame = tables["stability"]
    parts = [
        "# Numerical stability on hard cases",
        "Every method on every hard scene at a ladder of settings: for fixed steps equal numbers of evaluations, "
        "for adaptive methods equal tolerances. Runs are isolated and limited in steps, evaluations and time; "
        "how each ended is part of the result.",
        "## How it ends\n\nSolution error at each setting, coarse to fine, or how the run ended.\n\n"
        + endings(frame),
        "![error against evaluations on the hard scenes](figures/hard_scenes.svg)",
        *escape_section(frame),
        *limits_section(tables["stability_limits"]),
        *rates_sections(tables["damping_rates"]),
        *strong_section(tables["strong_damping"]),
        "## Scene by scene",
        "\n".join(f"- `{name}`: {STABILITY.columns[name]}" for name in SHOWN),
        *(scene_section(frame, scene) for scene in dict.fromkeys(frame["scene"])),
    ]
    return "\n\n".join(parts) + "\n"


def endings(frame: pd.DataFrame) -> str:
    """Scenes down, methods across would be too wide: methods down, scenes across in two tables."""
    scenes, methods = list(dict.fromkeys(frame["scene"])), list(dict.fromkeys(frame["method"]))
    cells = {
        key: " / ".join(
            scientific(row["solution_error"], 0) if row["status"] == "ok" else row["status"]
            for _, row in rows.iterrows()
        )
        for key, rows in frame.groupby(["scene", "method"], sort=False)
    }
    cells = {
        key: "unsupported" if set(text.split(" / ")) == {"unsupported"} else text
        for key, text in cells.items()
    }
    tables = []
    for start in range(0, len(scenes), 4):
        part = scenes[start : start + 4]
        rows = [[method, *(cells.get((scene, method), DASH) for scene in part)] for method in methods]
        tables.append(markdown(["method", *part], rows))
    return "\n\n".join(tables)


def escape_section(frame: pd.DataFrame) -> Iterator[str]:
    """When a run is said to have diverged, against the true time of blow-up."""
    part = frame[frame["blow_up_time"].notna()]
    if not len(part):
        return
    rows = [
        [f"{r['method']} ({r['setting']})", r["status"], f"{r['end_time']:.6g}",
         f"{100 * (r['end_time'] / r['blow_up_time'] - 1):+.3f} %"]
        for _, r in part.iterrows() if r["status"] != "unsupported"
    ]  # fmt: skip
    true = part["blow_up_time"].iloc[0]
    yield (
        f"## Blow-up\n\nThe motion of `{part['scene'].iloc[0]}` reaches infinity at t = {true:.10g}.\n\n"
        + markdown(["method (setting)", "status", "time told", "off by"], rows)
    )


def limits_section(frame: pd.DataFrame) -> Iterator[str]:
    if not len(frame):
        return
    one = frame[frame["omega"] == 1.0]
    gammas = sorted(one["gamma"].unique())
    rows = []
    for method in dict.fromkeys(one["method"]):
        mine = one[one["method"] == method].set_index("gamma")
        cells = []
        for gamma in gammas:
            limit, theory = mine.loc[gamma, "limit"], mine.loc[gamma, "theory"]
            cells.append(f"{limit:.4g}" + ("" if pd.isna(theory) else f" ({theory:.4g})"))
        rows.append([method, *cells])
    yield (
        "## Stability limits\n\nFirst loss of stability with growing step on q'' + γq' + q = 0, from trace and "
        "determinant of the one-step map; in parentheses what theory gives. It may be a narrow window, beyond which "
        "orbits are bounded again (columns `windows` and `last` of `stability_limits.csv`). Of a processed method the "
        "kernel decides, as where only the end is saved (`limit_saved`: where every step is). Divide by the "
        "evaluations per step to compare costs.\n\n"
        + markdown(["method", *(f"γ = {g:g}" for g in gammas)], rows)
    )
    yield "![stability limits over damping](figures/stability_map.svg)"
    yield "![spectral radius of the one-step map](figures/one_step.svg)"


def rates_sections(frame: pd.DataFrame) -> Iterator[str]:
    creep = frame[frame["experiment"] == "overdamped"]
    if len(creep):
        fixed = creep[creep["damping_per_step"].notna()]
        columns = sorted(fixed["damping_per_step"].unique())
        rows = [
            [method, *(
                ratio(mine[mine["damping_per_step"] == d]) for d in columns
            )] for method, mine in fixed.groupby("method", sort=False)
        ]  # fmt: skip
        yield (
            "## Overdamped: the slow rate\n\nMeasured rate of creep over the true one, γ = 50: one is right.\n\n"
            + markdown(["method", *(f"γh = {d:g}" for d in columns)], rows)
        )
        adaptive = creep[creep["damping_per_step"].isna()]
        settings = list(dict.fromkeys(adaptive["setting"]))
        rows = [
            [method, *(ratio(mine[mine["setting"] == s], True) for s in settings)]
            for method, mine in adaptive.groupby("method", sort=False)
        ]
        yield markdown(["method", *settings], rows)
    weak = frame[frame["experiment"] == "weak"]
    if len(weak):
        questions = list(dict.fromkeys(zip(weak["scene"], weak["t_end"], strict=True)))
        rows = []
        for method in dict.fromkeys(weak["method"]):
            cells = []
            for scene, span in questions:
                here = weak[(weak["method"] == method) & (weak["scene"] == scene) & (weak["t_end"] == span)]
                cells.append(error_and_cost(here))
            rows.append([method, *cells])
        yield (
            "## Weak damping: the rate at equal cost\n\n|measured/true − 1| of the rate at which H0 falls, γ = 10⁻⁵, "
            "about eight evaluations per unit of time for every method, or as near to that as its tolerances come "
            "(evaluations in parentheses).\n\n"
            + markdown(["method", *(f"{scene}, T = {span:.0e}" for scene, span in questions)], rows)
        )


def ratio(rows: pd.DataFrame, precise: bool = False) -> str:
    if not len(rows):
        return DASH
    row = rows.iloc[0]
    if row["status"] != "ok":
        return str(row["status"])
    return f"{row['ratio']:.6f}" if precise else f"{row['ratio']:.4g}"


def error_and_cost(rows: pd.DataFrame) -> str:
    if not len(rows):
        return DASH
    row = rows.iloc[0]
    if row["status"] != "ok":
        return str(row["status"])
    cost = DASH if pd.isna(row["evaluations"]) else f"{row['evaluations']:.2g}"
    return f"{scientific(row['rate_error'])} ({cost})"


# -- strong damping --------------------------------------------------------------------------------
def strong_section(frame: pd.DataFrame) -> Iterator[str]:
    if STRANG not in set(frame["method"]):  # all others are compared with it
        return
    gammas = sorted(frame["gamma"].unique())
    rows = [
        [method, *(f"{usable(frame, method, gamma):.2g}" for gamma in gammas)]
        for method in dict.fromkeys(frame["method"]) if method != STRANG
    ]  # fmt: skip
    yield (
        "## Strong damping: where negative substeps stop paying\n\nDamping between two evaluations, γh/evaluations, up "
        f"to which a method is no less accurate than {STRANG} at the same cost (oscillator, ω = 1, over the time in "
        "which the motion falls by e; 0: nowhere). Substeps against time grow by e^{γ|a|h}.\n\n"
        + markdown(["method", *(f"γ = {g:g}" for g in gammas)], rows)
    )
    yield (
        "What to take for which damping between two evaluations, computed from the same table:\n\n"
        + by_damping(frame)
    )
    yield "![error against damping per evaluation](figures/strong_damping.svg)"


def usable(frame: pd.DataFrame, method: str, gamma: float) -> float:
    """The largest γh per evaluation below which the method is never worse than Strang; 0 if nowhere."""
    part = frame[frame["gamma"] == gamma].pivot_table(
        index="damping_per_evaluation", columns="method", values="error", dropna=False
    )
    worse = (part[method] > part[STRANG] * 1.001).to_numpy()
    grid = part.index.to_numpy()
    start = int(np.argmax(~worse)) if (~worse).any() else None
    if start is None or start > len(grid) // 2:
        return 0.0
    behind = np.flatnonzero(worse[start:])
    return float(grid[-1] if not len(behind) else grid[start + behind[0] - 1])


def by_damping(frame: pd.DataFrame) -> str:
    """The most accurate fixed-step method in each range of γh per evaluation, by γ."""
    gammas = sorted(frame["gamma"].unique())
    rows = []
    for low, high in itertools.pairwise(DAMPING_RANGES):
        label = (
            f"below {high:g}"
            if low == 0
            else f"above {low:g}"
            if math.isinf(high)
            else f"{low:g} to {high:g}"
        )
        cells = []
        for gamma in gammas:
            method, error = best_in(frame, gamma, low, high)
            cells.append(f"{method} {scientific(error)}" if method else DASH)
        rows.append([label, *cells])
    return markdown(["γh per evaluation", *(f"γ = {g:g}" for g in gammas)], rows)


def best_in(frame: pd.DataFrame, gamma: float, low: float, high: float) -> tuple[str, float]:
    """The method with the smallest median error in a range, and that error; nothing above an error of one."""
    inside = frame["damping_per_evaluation"].between(low, high, inclusive="left")
    part = frame[(frame["gamma"] == gamma) & inside].assign(error=lambda f: f["error"].fillna(np.inf))
    if not len(part):
        return "", math.nan
    median = part.groupby("method", sort=False)["error"].median()
    best = str(median.idxmin())
    return (best, float(median[best])) if median[best] < 1 else ("", math.nan)


# -- scene by scene --------------------------------------------------------------------------------
def scene_section(frame: pd.DataFrame, scene: str) -> str:
    part = frame[(frame["scene"] == scene)]
    shown = [name for name in SHOWN if part[name].notna().any()]
    rows = []
    for _, row in part.iterrows():
        ending = row["status"] if row["status"] == "ok" else f"{row['status']}: {row['message']}"
        cost = DASH if pd.isna(row["rhs_equivalents"]) else f"{row['rhs_equivalents']:.0f}"
        values = (scientific(row[name]) for name in shown)
        rows.append([f"{row['method']} ({row['setting']})", *values, cost, duration(row["time_s"]), ending])
    condition = part["condition_number"].max()
    note = ""
    if condition > WELL_CONDITIONED:
        note = (
            f"\n\nCondition number {scientific(condition)}: round-off alone makes an error of about "
            f"{scientific(condition * 2.2e-16)}."
        )
    head = ["method (setting)", *shown, "evaluations", "time", "status"]
    return f"### {scene}{note}\n\n" + markdown(head, rows)


# -- which integrator for which problem ------------------------------------------------------------
def advice(tables: Frames) -> str:
    """A section for practitioners; empty without the stability tables."""
    rows = [row for row in recommendations(tables) if row is not None]
    if not rows:
        return ""
    return (
        "\n## Which integrator for which problem\n\nComputed from the tables; `contact-*` and `herglotz*` are of this "
        "suite, all others are peers. Speeds are medians or fastest rounds of compiled engines at an error of "
        f"{TARGET:.0e}; the second column is the best of them all, the last the best of the other camp.\n\n"
        + markdown(["problem", "take", "measured", "best of the other camp"], rows)
        + "\n\nDetails: [stability.md](stability.md).\n"
    )


Recommendation = tuple[str, str, str, str] | None


def recommendations(tables: Frames) -> Iterator[Recommendation]:
    work, hard = tables["work_precision"], tables["stability"]
    compiled = work[work["engine"].isin(["jax", "llvm"]) & work["track"].isin(["fixed", "adaptive"])]
    for problem, scene in (
        ("one short run, smooth forces", "particle"),
        ("a long run, weak damping", "particle_long"),
        ("a damped rigid body", "rigid_body"),
    ):
        yield fastest(f"{problem} (`{scene}`)", compiled[compiled["scene"] == scene], "time_median_s")
    if not len(hard):
        return
    quick = hard[hard["engine"].isin(["jax", "llvm"])]
    for problem, scene in (
        ("close encounters, eccentric orbits", "kepler_drag"),
        ("two time scales, the fast one alive", "stiff_spring"),
        ("very slender bodies", "needle"),
    ):
        yield fastest(f"{problem} (`{scene}`)", quick[quick["scene"] == scene], "time_s")
    yield creeping(tables["damping_rates"])
    yield fading(tables["damping_rates"])
    yield most_accurate("friction about some axes only", hard, "singular_damping", "end_error")
    yield most_accurate("at the edge of escape", hard, "saddle_edge", "solution_error")
    yield keepers(hard)


def ours(method: str) -> bool:
    return method.startswith(("contact-", "herglotz"))


def ranked(problem: str, scores: dict[str, float], show: str) -> Recommendation:
    """The best of all with its score, and the best of the other camp."""
    order = sorted((value, method) for method, value in scores.items() if not math.isnan(value))
    if not order:
        return None
    best, method = order[0]
    write = duration if show == "time" else scientific
    other = next(((v, m) for v, m in order if ours(m) != ours(method)), None)
    return problem, f"**{method}**", write(best), f"{other[1]} {write(other[0])}" if other else DASH


def fastest(problem: str, frame: pd.DataFrame, cost: str) -> Recommendation:
    part = frame[frame["status"] == "ok"]
    scores = {
        str(method): cost_to_reach(rows["solution_error"], rows[cost], TARGET)
        for method, rows in part.groupby("method", sort=False)
    }
    return ranked(problem, scores, "time")


def most_accurate(problem: str, hard: pd.DataFrame, scene: str, measure: str) -> Recommendation:
    """At the finest setting, the largest over the scenes whose names begin so."""
    part = hard[hard["scene"].str.startswith(scene) & (hard["status"] == "ok")]
    best = part.groupby(["method", "scene"])[measure].min().groupby("method")
    complete = hard[hard["scene"].str.startswith(scene)]["scene"].nunique()
    scores = {str(m): float(v.max()) for m, v in best if len(v) == complete}
    return ranked(f"{problem} (`{scene}`): smallest error", scores, "error")


def creeping(rates: pd.DataFrame) -> Recommendation:
    """Overdamped at γh = 25: how far the rate of creep is off."""
    part = rates[(rates["experiment"] == "overdamped") & (rates["status"] == "ok")]
    coarse = part[part["damping_per_step"] == part["damping_per_step"].max()]
    scores = {str(r["method"]): float(r["rate_error"]) for _, r in coarse.iterrows()}
    for method, rows in part[part["damping_per_step"].isna()].groupby("method"):
        cheap = coarse["evaluations"].min()  # an adaptive method no dearer than ten times that
        affordable = rows[rows["evaluations"] <= 10 * cheap]
        if len(affordable):
            scores[str(method)] = float(affordable["rate_error"].min())
    return ranked(
        "strong damping, γh = 25 (adaptive: up to ten times the evaluations): error of the slow rate",
        scores,
        "error",
    )


def fading(rates: pd.DataFrame) -> Recommendation:
    """Weak damping: the largest error of the rate over the questions, at equal cost."""
    part = rates[(rates["experiment"] == "weak") & (rates["status"] == "ok")]
    questions = part[["scene", "t_end"]].drop_duplicates()
    scores = {
        str(method): float(rows["rate_error"].max())
        for method, rows in part.groupby("method")
        if len(rows) == len(questions)
    }
    return ranked(
        "damping rates of 10⁻⁵, eight evaluations per unit of time: error of the rate", scores, "error"
    )


def keepers(hard: pd.DataFrame) -> Recommendation:
    """Who keeps J and η to round-off on every hard scene at every setting that ended.

    η only where the motion itself does not magnify round-off; J does not care.
    """
    ended = hard[hard["status"] == "ok"]
    calm = ended[ended["condition_number"].fillna(1) < WELL_CONDITIONED]
    worst = pd.concat(
        [
            ended.groupby("method", sort=False)["momentum_law"].max(),
            calm.groupby("method", sort=False)["contact_drift"].max(),
        ],
        axis=1,
    )
    worst = worst.dropna().max(axis=1)
    keep = [str(method) for method, value in worst.items() if value <= ROUND_OFF]
    if not keep:
        return None
    peers = worst[[not ours(str(method)) for method in worst.index]]
    names = ", ".join(f"**{name}**" for name in keep)
    best = f"{peers.idxmin()} {scientific(peers.min())}" if len(peers) else DASH
    return "J and η kept whatever the step (hard scenes)", names, scientific(float(worst[keep].max())), best
