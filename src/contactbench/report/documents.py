"""Markdown and figures from the CSV tables alone: nothing is solved here, no number is typed."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable
from itertools import chain
from pathlib import Path
from typing import Any

import pandas as pd

from contactbench.errors import BadInput
from contactbench.measure.analysis import cost_to_reach
from contactbench.report import figures, paper_figures
from contactbench.report.markdown import DASH, Listing, count, duration, markdown, scientific, times
from contactbench.report.stability import advice, stability_document
from contactbench.results.schema import SEPARATOR, TABLES, read, replacing

TARGETS = (1e-3, 1e-6, 1e-9, 1e-12)
DECADES = tuple(10.0**-k for k in range(3, 13))
#: at or below this a drift counts as round-off
ROUND_OFF = 1e-12
HEADLINE = "particle"
COMPILED, CALLBACKS = ("jax", "llvm"), ("python", "c+python")
ANY = COMPILED + CALLBACKS


def labels(table: str) -> dict[str, str]:
    """Column meanings of a table, for axis labels and headers."""
    return dict(TABLES[table].columns)


# -- equal error -----------------------------------------------------------------------------------
def equal_error(
    work: pd.DataFrame, scene: str, cost: str, targets: tuple[float, ...] = TARGETS
) -> pd.DataFrame:
    """Cost of each target error, one row per (method, engine); nan where a method is not as accurate.

    cost : "time_median_s", or "rhs_equivalents" (one row per method then: engines count alike).
    Column "loosest": the largest error among a method's settings; the cost of a target above it is
    that of its cheapest setting, an upper bound.
    """
    part = work[(work["scene"] == scene) & (work["status"] == "ok")]
    part = part[part["track"].isin(["fixed", "adaptive"])]
    rows: list[dict[Any, Any]] = []
    for (method, engine), line in part.groupby(["method", "engine"], sort=False):
        if cost == "rhs_equivalents" and any(row["method"] == method for row in rows):
            continue
        costs = {target: cost_to_reach(line["solution_error"], line[cost], target) for target in targets}
        rows.append({
            "method": method, "engine": engine, "loosest": line["solution_error"].max(), **costs
        })  # fmt: skip
    return pd.DataFrame(rows)


def writer(row: pd.Series, target: float, show: Callable[[float], str]) -> Callable[[float], str]:
    """How a cost of `equal_error` is written: marked where it is a bound."""
    return show if target <= row["loosest"] else lambda cost: f"≤ {show(cost)}"


def cost_text(row: pd.Series, target: float, show: Callable[[float], str]) -> str:
    return DASH if pd.isna(row[target]) else writer(row, target, show)(row[target])


def equal_error_table(frame: pd.DataFrame, show: Callable[[float], str]) -> str:
    """The table with the best of each column in bold."""
    best = {target: frame[target].min() for target in TARGETS}

    def cell(row: pd.Series, target: float) -> str:
        text = cost_text(row, target, show)
        return f"**{text}**" if row[target] == best[target] else text

    rows = [
        [f"{row['method']} ({row['engine']})", *(cell(row, target) for target in TARGETS)]
        for _, row in frame.iterrows()
    ]
    return markdown(["method (engine)", *(f"error {target:.0e}" for target in TARGETS)], rows)


def ranked(work: pd.DataFrame, scene: str, cost: str, engines: tuple[str, ...]) -> dict[float, pd.Series]:
    """Per target error the cost of every method that reaches it, cheapest first, on its best engine."""
    frame = equal_error(work[work["engine"].isin(engines)], scene, cost)
    if not len(frame):
        return {target: pd.Series(dtype=float) for target in TARGETS}
    by_method = frame.groupby("method", sort=False)
    return {target: by_method[target].min().dropna().sort_values(kind="stable") for target in TARGETS}


def winners(work: pd.DataFrame, cost: str, show: Callable[[float], str], engines: tuple[str, ...]) -> str:
    """Who is cheapest at each target error, per scene, and how far ahead of the next method."""
    rows = []
    for scene in dict.fromkeys(work["scene"]):
        cells = []
        for costs in ranked(work, scene, cost, engines).values():
            if not len(costs):
                cells.append(DASH)
                continue
            text = f"**{costs.index[0]}** {show(costs.iloc[0])}"
            if len(costs) > 1:
                text += f"; {costs.index[1]} {times(costs.iloc[1] / costs.iloc[0])}"
            cells.append(text)
        rows.append([scene, *cells])
    return markdown(["scene", *(f"error {target:.0e}" for target in TARGETS)], rows)


#: the competition, in groups whose best member counts
PEERS = {
    "diffrax": ("diffrax-tsit5", "diffrax-dopri8", "diffrax-kvaerno5"),
    "heyoka": ("heyoka-taylor",),
    "RK4": ("rk4",),
    "DOP853": ("scipy-dop853",),
    "CVODE": ("cvode-adams", "cvode-bdf"),
}


def is_ours(method: str) -> bool:
    """Whether it is one of the contact integrators."""
    return method.startswith("contact-")


def cheapest(frame: pd.DataFrame, target: float, methods: Iterable[str]) -> pd.Series | None:
    """The row of `equal_error` with the cheapest of some methods at a target error, if one reaches it."""
    part = frame[frame["method"].isin(list(methods))] if len(frame) else frame
    part = part.dropna(subset=[target]) if len(part) else part
    return part.loc[part[target].idxmin()] if len(part) else None


def decades(
    work: pd.DataFrame,
    scene: str,
    cost: str,
    show: Callable[[float], str],
    targets: tuple[float, ...] = DECADES,
) -> str:
    """The best contact method at each error, and what each group of peers costs in its units."""
    frame = equal_error(work, scene, cost, targets)
    ours = [name for name in dict.fromkeys(work["method"]) if is_ours(name)]
    rows = []
    for target in targets:
        best = cheapest(frame, target, ours)
        ratios = []
        for group in PEERS.values():
            theirs = cheapest(frame, target, group)
            if theirs is None:
                ratios.append(DASH)
                continue
            ratio = math.nan if best is None else theirs[target] / best[target]
            text = cost_text(theirs, target, show) + ("" if best is None else f" ({times(ratio)})")
            ratios.append(text if ratio >= 1 else f"**{text}**")
        mine = DASH if best is None else f"{best['method']} {cost_text(best, target, show)}"
        rows.append([f"{target:.0e}", mine, *ratios])
    return markdown(["error", "best contact method", *PEERS], rows)


def losses(work: pd.DataFrame) -> Listing:
    """Every scene and error at which a peer is cheaper than every contact method, on equal terms."""
    rows = []
    terms = (
        ("time, compiled", "time_median_s", COMPILED),
        ("time, Python callbacks", "time_median_s", CALLBACKS),
        ("evaluations", "rhs_equivalents", ANY),
    )
    for scene in dict.fromkeys(work["scene"]):
        for measure, cost, engines in terms:
            frame = equal_error(work[work["engine"].isin(engines)], scene, cost, DECADES)
            cells = []
            for target in TARGETS:
                everyone = set(frame["method"]) if len(frame) else set()
                ours = cheapest(frame, target, filter(is_ours, everyone))
                peer = cheapest(frame, target, (m for m in everyone if not is_ours(m)))
                if peer is None or (ours is not None and peer[target] >= ours[target]):
                    cells.append("")
                elif ours is None:
                    cells.append(f"{peer['method']}, alone")
                else:
                    cells.append(f"{peer['method']} {times(ours[target] / peer[target])}")
            if any(cells):
                rows.append((scene, measure, *cells))
    head = ("scene", "on equal terms of", *(f"error {target:.0e}" for target in TARGETS))
    return Listing(tuple((label, str) for label in head), tuple(rows))


LOSSES = (
    "What the contact methods cost there in units of the winner; blank where a contact method is cheapest."
)
#: why they lose: in a word, and in a sentence
REASONS = {
    "High accuracy": "heyoka's Taylor method raises its order with the digits asked for and keeps its steps "
    "long; a composition of fixed order has to shorten them.",
    "Short runs": "A compiled call has a cost of its own whatever it does, which on runs of a few hundred "
    "evaluations is most of the time; heyoka's is smaller.",
    "No structure to use": "The anisotropic body has neither a conformal factor nor a potential.",
}


def losses_section(work: pd.DataFrame) -> str:
    reasons = "\n".join(f"- **{word}.** {sentence}" for word, sentence in REASONS.items())
    return f"## Where the contact methods lose\n\n{LOSSES} Why:\n\n{reasons}\n\n{losses(work).markdown()}"


# -- documents -------------------------------------------------------------------------------------
def convergence_document(frame: pd.DataFrame) -> str:
    scenes = list(dict.fromkeys(frame["scene"]))
    methods = list(dict.fromkeys(frame["method"]))
    rows = []
    for method in methods:
        mine = frame[frame["method"] == method]
        cells = []
        for scene in scenes:
            here = mine[mine["scene"] == scene]
            if not len(here) or here["status"].iloc[0] == "unsupported":
                cells.append("unsupported" if len(here) else DASH)
                continue
            fit = here.iloc[0]
            if pd.isna(fit["order"]):
                cells.append("no asymptotic range")
            else:
                half = (fit["order_high"] - fit["order_low"]) / 2
                cells.append(f"{fit['order']:.3f} ± {half:.3f} ({int(here['in_fit'].sum())})")
        rows.append([method, int(mine["order_nominal"].iloc[0]), *cells])
    table = markdown(["method", "claimed", *scenes], rows)
    return f"""# Order of convergence

Slope of log error against log step with its 95 % interval, over the asymptotic range (number of
points in parentheses). The errors behind it are in `convergence.csv`.

{table}

![error against step size](figures/convergence.svg)
"""


LAW_COLUMNS = (
    "solution_error", "energy_law", "energy_law_relative", "hamiltonian_law", "momentum_law", "momentum_balance",
    "contact_drift", "distribution_drift", "attitude_drift", "energy_increases",
)  # fmt: skip


def laws_document(frame: pd.DataFrame) -> str:
    meaning = labels("laws")
    parts = [
        "# Decay laws and drifts",
        "Maxima over the saved times of each run. A dash: the law is not defined on the scene, or not measured.",
        "\n".join(f"- `{name}`: {meaning[name]}" for name in LAW_COLUMNS),
    ]
    for scene in dict.fromkeys(frame["scene"]):
        part = frame[frame["scene"] == scene]
        shown = [name for name in LAW_COLUMNS if part[name].notna().any()]
        rows = []
        for _, row in part.iterrows():
            values = (
                str(int(row[name]))
                if name == "energy_increases" and not pd.isna(row[name])
                else scientific(row[name])
                for name in shown
            )
            ending = row["status"] if row["status"] == "ok" else f"{row['status']}: {row['message']}"
            rows.append([f"{row['method']} ({row['setting']})", *values, ending])
        parts.append(f"## {scene}\n\n" + markdown(["method (setting)", *shown, "status"], rows))
        if (part["status"] == "ok").any():
            parts.append(f"![laws along time](figures/laws_{scene}.svg)")
    parts.append("![structure against accuracy](figures/structure.svg)")
    return "\n\n".join(parts) + "\n"


def nanoseconds(value: float) -> str:
    return f"{value:.2f} ns"


def kernels(frame: pd.DataFrame) -> Listing:
    """Time per gradient of our compiled kernels beside the same arithmetic as a C loop."""
    rows = []
    for _, limit in frame[(frame["track"] == "limit") & (frame["status"] == "ok")].iterrows():
        method, _, step = str(limit["setting"]).partition(" ")
        same = (frame["scene"] == limit["scene"]) & (frame["method"] == method)
        ours = frame[
            same & (frame["engine"] == "jax") & (frame["setting"] == step) & (frame["status"] == "ok")
        ]
        if len(ours):
            c, jax = (r["time_min_s"] / r["evaluations"] * 1e9 for r in (limit, ours.iloc[0]))
            rows.append((limit["scene"], method, step, limit["evaluations"], c, jax, jax / c))
    columns = (
        ("scene", str), ("method", str), ("step", str), ("gradients", str), ("C loop", nanoseconds),
        ("jax, whole call", nanoseconds), ("ratio", "{:.2f}".format),
    )  # fmt: skip
    return Listing(columns, tuple(rows))


def chosen(frame: pd.DataFrame) -> Listing:
    """What a tolerance asked of a fixed-step method gives, pilots included."""
    rows = []
    for _, row in frame[(frame["track"] == "chosen") & (frame["status"] == "ok")].iterrows():
        rtol, error = float(row["setting"].partition("=")[2]), row["solution_error"]
        cost = (row["steps"], row["rhs_equivalents"], row["time_median_s"])
        rows.append((row["scene"], row["method"], rtol, error, error / rtol, *cost))
    columns = (
        ("scene", str), ("method", str), ("rtol", "{:.0e}".format), ("error", scientific),
        ("error / rtol", "{:.2f}".format), ("steps", str), ("evaluations with pilots", count),
        ("time with pilots", duration),
    )  # fmt: skip
    return Listing(columns, tuple(rows))


KERNELS = (
    "Fastest round, per gradient, one thread. The jax column is the whole call of a prepared solver, its "
    "dispatch included."
)


def work_precision_document(frame: pd.DataFrame) -> str:
    parts = [
        "# Cost at equal error",
        "Log–log interpolation between a method's own settings; a dash where none is as accurate, ≤ where even its "
        "least accurate one is more so: what its cheapest setting costs. The error is "
        f"{labels('work_precision')['solution_error']}. Times compare "
        "engines as well as methods: compare jax with jax and python with python; evaluations compare methods.",
    ]
    parts.append(losses_section(frame))
    for scene in dict.fromkeys(frame["scene"]):
        times = equal_error(frame, scene, "time_median_s")
        if not len(times):
            continue
        evaluations = equal_error(frame, scene, "rhs_equivalents")
        part = frame[frame["scene"] == scene]
        parts += [
            f"## {scene}\n\n![cost against error](figures/work_precision_{scene}.svg)",
            "Median time per solve:\n\n" + equal_error_table(times, duration),
            "Right-hand sides or equivalents:\n\n" + equal_error_table(evaluations, count),
            "Decade by decade, in time, whatever the engine; in parentheses the peers' cost in units of the "
            "best contact method's, bold where they win:\n\n"
            + decades(frame, scene, "time_median_s", duration),
            "The same in evaluations:\n\n" + decades(frame, scene, "rhs_equivalents", count),
        ]
        refused = part[part["status"] != "ok"]
        if len(refused):
            endings = [
                [f"{r['method']} ({r['engine']})", r["setting"], r["status"], r["message"]]
                for _, r in refused.iterrows()
            ]
            parts.append(
                "Runs that did not end `ok`:\n\n"
                + markdown(["method (engine)", "setting", "status", "why"], endings)
            )
    parts += [
        f"## Compiled kernels beside a C loop\n\n{KERNELS}\n\n{kernels(frame).markdown()}",
        f"## A step chosen from a tolerance\n\n{chosen(frame).markdown()}",
    ]
    return "\n\n".join(parts) + "\n"


# -- ensembles -------------------------------------------------------------------------------------
def ensemble_document(frame: pd.DataFrame) -> str:
    frame = frame[frame["status"] == "ok"].astype({"trajectories": float, "evaluations": float})
    frame = frame.assign(each=frame["time_median_s"] / frame["trajectories"])
    frame = frame.assign(stage=frame["each"] / frame["evaluations"], a_second=1 / frame["each"])
    return f"""# Ensembles

Many trajectories of a scene at once. Times are medians of the whole call, from initial to final states on the
host, by the side of each other in one run.

## The same arithmetic as C loops

One core, 1024 trajectories, 20 000 steps; fastest round, per gradient and trajectory. `passes`: every flow a loop
over all trajectories; `plain`: drift and kick in one loop; `tiled`: all steps of some trajectories before the next.
A ratio below one: ours is faster than the loop.

{arithmetic_table(frame[frame["track"] == "arithmetic"])}

## A trajectory at equal error

One core; with at most this error: log–log interpolation between a method's own settings, or else the cheapest of
them that is as accurate; a dash where none is. `vmap`: every trajectory has its own steps; `shared`: those of a
tile share theirs; `batch`: a vector register of trajectories.

{trajectory_table(frame[frame["track"] == "error"])}

## With the number of trajectories

{growth_table(frame[frame["track"] == "size"], "trajectories")}

## With the number of cores

{growth_table(frame[frame["track"] == "cores"], "cores")}

![time per trajectory against error, throughput against trajectories and cores](figures/ensemble.svg)
"""


def variant(row: pd.Series) -> str:
    """The method, and the shape of its run where its setting begins with one."""
    return f"{row['method']} {row['setting'].rpartition(' ')[0]}".strip()


def arithmetic_table(frame: pd.DataFrame) -> str:
    """Ours beside each shape of the C loop of the same method."""
    frame = frame.assign(stage=frame["time_min_s"] / frame["trajectories"] / frame["evaluations"])
    loops = frame[frame["method"] == "limit-c"].set_index("setting")["stage"]
    shapes = list(dict.fromkeys(setting.split()[1] for setting in loops.index))
    rows = []
    for _, ours in frame[frame["method"] != "limit-c"].iterrows():
        c = [loops.get(f"{ours['method']} {shape} {ours['setting']}", math.nan) for shape in shapes]
        ratios = (DASH if math.isnan(t) else f"{duration(t)} ({ours['stage'] / t:.2f})" for t in c)
        rows.append([ours["method"], ours["setting"], duration(ours["stage"]), *ratios])
    return markdown(["method", "setting", "ours", *(f"C {shape} (ratio)" for shape in shapes)], rows)


def trajectory_table(frame: pd.DataFrame) -> str:
    """Time per trajectory with at most each target error, the best in bold."""

    rows: list[dict[Any, Any]] = []
    variants = [variant(row) for _, row in frame.iterrows()]
    for name, line in frame.groupby(variants, sort=False):
        errors = line["solution_error"]
        costs = {target: cost_to_reach(errors, line["each"], target) for target in TARGETS}
        rows.append({"method": name, "engine": line["engine"].iloc[0], "loosest": errors.max(), **costs})
    return equal_error_table(pd.DataFrame(rows), duration) if rows else DASH


def growth_table(frame: pd.DataFrame, by: str) -> str:
    """Throughput against the number of something, and relative to the smallest number."""
    frame = frame.sort_values(by)
    rows = []
    for method, line in frame.groupby("method", sort=False):
        for _, row in line.iterrows():
            gain = row["a_second"] / line["a_second"].iloc[0]
            stages = f"{1 / row['stage']:.3g}"
            rows.append(
                [
                    f"{method} ({row['setting']})",
                    f"{row[by]:.0f}",
                    f"{row['a_second']:.3g}",
                    stages,
                    f"{gain:.2f}",
                ]
            )
    return markdown(["method", by, "trajectories/s", "gradients/s", "relative"], rows)


# -- claims ----------------------------------------------------------------------------------------
VERDICTS = ("holds", "holds, corrected", "refuted")
MEANINGS = {
    "holds": "the measurements agree with the claim as it stands",
    "holds, corrected": "true once the stated correction is made",
    "refuted": "a number contradicts it, and what is true instead is stated",
}
CAPTIONS = {
    "repairs": "Corrected",
    "replaces": "True instead",
    "sharpens": "Stronger",
    "extends": "How far it goes",
}


def measured_list(evidence: str) -> str:
    """A row's measurements, one bullet each."""
    return "\n".join(f"- {item}" for item in evidence.replace(" fails (", " **fails** (").split(SEPARATOR))


def claim_section(row: pd.Series, drawn: set[str]) -> str:
    """One claim: where, what, evidence, verdict, correction, command, figures."""
    parts = [
        f"### {row['id']} · {row['verdict'] or row['status']}",
        f"**Claim** ({row['where']}). {row['claim']}",
    ]
    if row["status"] != "ok":
        return "\n\n".join([*parts, f"Not measured: {row['message']}", f"`{row['command']}`"])
    where = f"{row['scene']}. Method: {row['method']}."
    parts.append(f"**Measured** on {where}\n\n{measured_list(row['evidence'])}")
    if row["correction"]:
        parts.append(f"**{CAPTIONS.get(row['correction_kind'], 'Corrected')}.** {row['correction']}")
    if row["corrected_evidence"]:
        parts.append(measured_list(row["corrected_evidence"]))
    parts.append(f"Measure it again: `{row['command']}`")
    shown = [name for name in row["figures"].split() if name in drawn]
    parts += [f"![{name} for {row['id']}](figures/{name}.png)" for name in shown]
    return "\n\n".join(parts)


def claims_document(frame: pd.DataFrame, drawn: set[str]) -> str:
    """The claims as a review of the paper; `drawn`: the figures there are."""
    numbers = ("measured", "bound", "corrected_measured", "corrected_bound")
    text = [name for name in frame if name not in numbers]
    frame = frame.assign(**{name: frame[name].astype(object).where(frame[name].notna(), "") for name in text})
    count = frame["verdict"].value_counts()
    summary = ", ".join(f"**{count.get(name, 0)}** {name}" for name in VERDICTS)
    undecided = int((frame["status"] != "ok").sum())
    rows = [
        [f"[{r['id']}](#{anchor(r)})", r["where"], r["quantity"].replace("|", "\\|"), f"{r['measured']:.2g}",
         f"{r['relation']} {r['bound']:.2g}", r["verdict"] or r["status"]]
        for _, r in frame.iterrows()
    ]  # fmt: skip
    header = ["claim", "where", "quantity", "measured", "needed", "verdict"]
    changes = [
        f"- [{r['id']}](#{anchor(r)}), {r['where']}: {r['correction']}"
        for _, r in frame[frame["verdict"].isin(VERDICTS[1:])].iterrows()
    ]
    sections = [claim_section(row, drawn) for _, row in frame.iterrows()]
    meanings = "\n".join(f"- *{name}*: {meaning}" for name, meaning in MEANINGS.items())
    return (
        "\n\n".join(
            [
                "# The paper's claims, measured",
                f"Of {len(frame)} claims {summary}{f', {undecided} not measured' if undecided else ''}.",
                "Each verdict is computed from the numbers beside it, none is typed in. Identities are tested by "
                "automatic differentiation at random points, independently of the formulas they test; "
                "trajectories against references of 30 digits or more; orders where it matters in 50-digit "
                "arithmetic. The paper prints step and end time of its experiment; damping and initial data are "
                "ours. All quantities are dimensionless, as in the paper. Of several measurements the table shows "
                "the first that fails, else the first.",
                meanings,
                "## What to change in the paper\n\n" + "\n".join(changes),
                "## All claims\n\n" + markdown(header, rows),
                "## Claim by claim",
                *sections,
            ]
        )
        + "\n"
    )


def anchor(row: pd.Series) -> str:
    """The anchor GitHub gives a claim's heading."""
    heading = f"{row['id']} · {row['verdict'] or row['status']}".lower()
    return "".join(c for c in heading if c.isalnum() or c in " -").replace(" ", "-")


#: what the headline shows of structure: scene and law
STRUCTURE = {
    "J law, central": ("central", "momentum_law"),
    "J law, body": ("rigid_body", "momentum_law"),
    "contact drift, central": ("central", "contact_drift"),
    "attitude drift, body": ("rigid_body", "attitude_drift"),
}


def structure_ranges(laws: pd.DataFrame) -> dict[str, dict[str, tuple[float, float]]]:
    """Per method and entry of `STRUCTURE`: smallest and largest value over its settings, or nan."""
    ok = laws[laws["status"] == "ok"]
    return {
        method: {
            label: (values.min(), values.max())
            for label, (scene, law) in STRUCTURE.items()
            for values in [ok[(ok["method"] == method) & (ok["scene"] == scene)][law]]
        }
        for method in dict.fromkeys(laws["method"])
    }


def keepers(laws: pd.DataFrame) -> tuple[list[str], list[str], float]:
    """Methods that keep every law they were measured on to round-off, the others, and the others' least drift."""
    kept, others, least = [], [], math.inf
    for method, ranges in structure_ranges(laws).items():
        high = [pair[1] for pair in ranges.values() if not pd.isna(pair[1])]
        low = [pair[0] for pair in ranges.values() if not pd.isna(pair[0])]
        if high and max(high) <= ROUND_OFF:
            kept.append(method)
        elif high:
            others.append(method)
            least = min(least, *low)
    return kept, others, least


def headline_order(convergence: pd.DataFrame, method: str) -> float | None:
    """The fitted order of a method on the headline scene, None for an adaptive one."""
    fitted = convergence[(convergence["method"] == method) & (convergence["scene"] == HEADLINE)]
    return float(fitted["order"].iloc[0]) if len(fitted) else None


def gate_document(frame: pd.DataFrame) -> str:
    """How far the regression gate can be trusted."""
    parts = [
        "# The regression gate, checked",
        "The gate compares a version of the code with the one before: its errors, counts and structure with the "
        "committed tables, its speed with the older revision, in turns. Here it judged identical code, which should "
        "never be red, and code with faults planted in it, which always should. Loaded: with a busy loop on all cores "
        "but one. A fault counts as found when a red line names the method and the measure.",
    ]
    for part in dict.fromkeys(frame["part"]):
        mine = frame[frame["part"] == part].sort_values("wanted", key=lambda w: w != "none", kind="stable")
        same = mine["wanted"] == "none"
        alarms, faults = mine[same], mine[~same]
        parts.append(
            f"## {part.capitalize()}\n\n**{alarms['red'].sum()} false alarms in {alarms['runs'].sum()} judgements; "
            f"{faults['red'].sum()} of {faults['runs'].sum()} planted faults found.**"
        )
        rows = [
            [r["planted"], r["condition"], r["wanted"], r["runs"], r["red"], duration(r["seconds"]),
             DASH if pd.isna(r["example"]) else str(r["example"]).replace("|", "\\|")]
            for _, r in mine.iterrows()
        ]  # fmt: skip
        parts.append(
            markdown(
                ["planted", "condition", "wanted red", "judged", "red", "a run took", "for example"], rows
            )
        )
    return "\n\n".join(parts) + "\n"


def structure_table(laws: pd.DataFrame, convergence: pd.DataFrame) -> str:
    """Per method: measured order on the headline scene, and the worst drift over all settings."""

    def cell(low: float, high: float) -> str:
        if pd.isna(high):
            return DASH
        return f"**{scientific(high)}**" if high <= ROUND_OFF else f"{scientific(low)} … {scientific(high)}"

    rows = []
    for method, ranges in structure_ranges(laws).items():
        order = headline_order(convergence, method)
        shown = "adaptive" if order is None else f"{order:.2f}"
        rows.append([method, shown, *(cell(*both) for both in ranges.values())])
    return markdown(["method", f"order on {HEADLINE}", *STRUCTURE], rows)


def claims_line(frame: pd.DataFrame) -> str:
    """The claims table in the list of tables, with its count of verdicts."""
    if not len(frame):
        return ""
    count = frame["verdict"].value_counts()
    summary = ", ".join(f"{count.get(name, 0)} {name}" for name in VERDICTS)
    files = "`claims.csv`, figures `paper_figures.csv`"
    return f"- [claims.md](claims.md): the paper's {len(frame)} claims: {summary} ({files})\n"


def gate_line(frame: pd.DataFrame) -> str:
    """The gate's own check in the list of tables."""
    if not len(frame):
        return ""
    alarms = frame[frame["planted"] == "nothing"]  # whole runs of the gate
    summary = f"{alarms['red'].sum()} false alarms in {alarms['runs'].sum()} runs of identical code"
    return f"- [gate_selfcheck.md](gate_selfcheck.md): the regression gate, checked: {summary} (`gate_selfcheck.csv`)\n"


def ensemble_line(frame: pd.DataFrame) -> str:
    """The ensembles in the list of tables."""
    return "- [ensemble.md](ensemble.md): throughput of ensembles (`ensemble.csv`)\n" if len(frame) else ""


def stability_line(frame: pd.DataFrame) -> str:
    """The stability tables in the list of tables."""
    if not len(frame):
        return ""
    files = (
        "`stability.csv`, `stability_limits.csv`, `one_step.csv`, `damping_rates.csv`, `strong_damping.csv`"
    )
    return f"- [stability.md](stability.md): {frame['scene'].nunique()} hard scenes, stability limits ({files})\n"


def headline_document(tables: dict[str, pd.DataFrame], runs: dict[str, dict]) -> str:
    work = tables["work_precision"]
    machines = []
    for name, run in sorted(runs.items()):
        packages = ", ".join(f"{k} {v}" for k, v in run["packages"].items() if k != "contactbench")
        machines.append(
            f"- run `{name}`: profile {run['profile']}, {run['cpu']}, {run['cores']} cores, Python {run['python']}, "
            f"commit `{run['commit'][:12] or 'unknown'}`{' with local changes' if run['dirty'] else ''}; {packages}"
        )
    return f"""# Results

Every number below is computed from the CSV files beside this page by `contactbench report`.

{findings(tables)}

## Who keeps the laws

Bold: kept to round-off (≤ {ROUND_OFF:.0e}) at every step size tried, however inaccurate the solution.
Otherwise the range over the settings tried. The printed scheme is first order; what it means is second.

{structure_table(tables["laws"], tables["convergence"])}

## Who is most accurate per second

The fastest at each error, and the next method. Log–log interpolation between a method's own settings; one that is
more accurate even at its least accurate setting is entered with what its cheapest one costs. Compiled engines:

{winners(work, "time_median_s", duration, COMPILED)}

Solvers that call back into Python, and our methods in plain Python:

{winners(work, "time_median_s", duration, CALLBACKS)}

## Who is most accurate per evaluation

Right-hand sides or equivalents, whatever the engine (a Taylor order counts as one; two rotations of the
body, which together apply its whole vector field, count as one):

{winners(work, "rhs_equivalents", count, ANY)}

![cost against error on the {HEADLINE}](figures/work_precision_{HEADLINE}.svg)
{advice(tables)}
{losses_section(work)}

## Tables

- [work_precision.md](work_precision.md): cost at equal error, scene by scene (`work_precision.csv`)
- [convergence.md](convergence.md): measured orders (`convergence.csv`)
- [laws.md](laws.md): decay laws and drifts (`laws.csv`, along time `laws_time.csv`)
{stability_line(tables["stability"])}{ensemble_line(tables["ensemble"])}{claims_line(tables["claims"])}{gate_line(tables["gate_selfcheck"])}
## Where this was measured

{chr(10).join(machines)}
"""


README_PART = ("<!-- computed from results/: begin -->\n", "<!-- computed from results/: end -->")


def findings(tables: dict[str, pd.DataFrame]) -> str:
    """What the tables say, in a few sentences; what they do not say is left out."""
    laws, work, convergence, claims = (
        tables[name] for name in ("laws", "work_precision", "convergence", "claims")
    )
    sentences = []
    kept, others, least = keepers(laws)
    if kept:
        contact = [method for method in dict.fromkeys(laws["method"]) if is_ours(method)]
        who = (
            "Every contact method, and no other, keeps" if kept == contact else f"Kept by {', '.join(kept)}:"
        )
        rest = f" The least drift of any other method at any setting: {scientific(least)}." if others else ""
        sentences.append(
            f"**Structure.** {who} every law measured (momentum map, contact form, attitude) to round-off at every "
            f"step size tried, however inaccurate the solution.{rest}"
        )
    printed, meant = (headline_order(convergence, name) for name in ("contact-printed", "contact-abc"))
    if printed is not None and meant is not None:
        highest = convergence[convergence["method"].map(is_ours)]["order_nominal"].max()
        sentences.append(
            f"**Order.** The paper's scheme as printed is of order {printed:.2f}; as the palindrome it means, of "
            f"order {meant:.2f}. Merging kinetic and damping flow gives orders up to {highest:.0f} with the structure "
            "kept."
        )
    for title, cost, engines in (
        ("Time at equal error, compiled engines", "time_median_s", COMPILED),
        ("Evaluations at equal error", "rhs_equivalents", ANY),
    ):
        if said := standing(work, cost, engines):
            sentences.append(f"**{title}.** {said}")
    if len(claims):
        verdicts = claims["verdict"].value_counts()
        sentences.append(
            f"**The paper.** Of its {len(claims)} claims {verdicts.get(VERDICTS[0], 0)} hold, "
            f"{verdicts.get(VERDICTS[1], 0)} hold once corrected, {verdicts.get(VERDICTS[2], 0)} are refuted."
        )
    return "\n".join(f"- {sentence}" for sentence in sentences)


def standing(work: pd.DataFrame, cost: str, engines: tuple[str, ...]) -> str:
    """Who is cheapest in how many pairs of scene and error, and where a contact method always is; or ""."""
    wins: dict[str, int] = {}
    always = []
    for scene in dict.fromkeys(work["scene"]):
        leads = []
        for costs in ranked(work, scene, cost, engines).values():
            if not len(costs):
                continue
            camp = "a contact method" if is_ours(costs.index[0]) else str(costs.index[0])
            wins[camp] = wins.get(camp, 0) + 1
            peers = costs[[not is_ours(method) for method in costs.index]]
            leads.append(math.inf if not len(peers) else peers.iloc[0] / costs.iloc[0])
        if leads and min(leads) > 1:
            known = [lead for lead in leads if math.isfinite(lead)]
            by = f" ({times(min(known))} to {times(max(known))} ahead of the best peer)" if known else ""
            always.append(f"`{scene}`{by}")
    if not wins:
        return ""
    order = sorted(wins.items(), key=lambda item: -item[1])
    said = f"Cheapest in {sum(wins.values())} pairs of scene and error: "
    said += ", ".join(f"{camp} in {n}" for camp, n in order) + "."
    return said + (f" A contact method always is on {', '.join(always)}." if always else "")


def excerpt(tables: dict[str, pd.DataFrame]) -> str:
    """What the project's README says of the results."""
    work, long = tables["work_precision"], "particle_long"
    return f"""{findings(tables)}

Who keeps the laws (bold: to round-off, at every step size tried, however inaccurate the solution):

{structure_table(tables["laws"], tables["convergence"])}

Time for `{long}`, three hundred oscillations with little damping, at equal error; in parentheses the peers'
time in units of the best contact method's, bold where the peer wins. DOP853 and CVODE call back into Python, all
others are compiled:

{decades(work, long, "time_median_s", duration, TARGETS)}

The same on the rigid body, with its attitude:

{decades(work, "rigid_body", "time_median_s", duration, TARGETS)}
"""


def into_readme(readme: Path, results: Path) -> None:
    """Write the excerpt between the two marks of a README.  Raises `BadInput` if it has none."""
    text = readme.read_text(encoding="utf-8")
    begin, end = README_PART
    if text.count(begin) != 1 or text.count(end) != 1:
        raise BadInput(f"{readme}: needs the lines {begin.strip()!r} and {end!r}, once each")
    tables = {name: read(table, results) for name, table in TABLES.items()}
    before, after = text.partition(begin)[0], text.partition(end)[2]
    with replacing(readme) as file:
        file.write(f"{before}{begin}\n{excerpt(tables)}\n{end}{after}")


def report(results: Path) -> list[Path]:
    """Write every markdown document and figure the tables in `results` allow; returns the paths."""
    tables = {name: read(table, results) for name, table in TABLES.items()}
    path = results / "environment.json"
    runs = json.loads(path.read_text()) if path.exists() else {}
    documents = {}
    if len(tables["convergence"]):
        documents["convergence.md"] = convergence_document(tables["convergence"])
    if len(tables["laws"]):
        documents["laws.md"] = laws_document(tables["laws"])
    if len(tables["work_precision"]):
        documents["work_precision.md"] = work_precision_document(tables["work_precision"])
    if (tables["ensemble"]["status"] == "ok").any():
        documents["ensemble.md"] = ensemble_document(tables["ensemble"])
    if len(tables["stability"]):
        documents["stability.md"] = stability_document(tables)
    if len(tables["claims"]):
        documents["claims.md"] = claims_document(tables["claims"], set(tables["paper_figures"]["figure"]))
    if len(tables["gate_selfcheck"]):
        documents["gate_selfcheck.md"] = gate_document(tables["gate_selfcheck"])
    if all(len(tables[name]) for name in ("work_precision", "laws", "convergence")):
        documents["README.md"] = headline_document(tables, runs)
    written = []
    for name, text in documents.items():
        with replacing(results / name) as file:
            file.write(text)
        written.append(results / name)
    drawn = chain(figures.figures(tables, labels), paper_figures.figures(tables["paper_figures"]))
    for name, figure in drawn:  # saved and closed one by one
        figures.save(figure, results / "figures", name)
        written.append(results / "figures" / f"{name}.svg")
    return written
