"""The headline: results/README.md and the computed part of the project's README.

What was asked for stands first: the order and the decay laws of every method at equal cost.  Then the
computed sentences of all rooms, and who is cheapest where.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import pandas as pd

from contactbench.report import damping, equal_cost, work_precision
from contactbench.report.cells import View
from contactbench.report.contest import EVALUATIONS, Field, reasons
from contactbench.report.contest_views import losses_view, winners_view
from contactbench.report.rooms import ROOMS, Finding, Frames, Part, Room, Section, Text, once, rooms, spoken

UNITS = "All quantities are dimensionless, as in the paper; only times are in seconds."
SOURCES = "work_precision.csv, stability.csv"
#: the findings that stand in the project's README, and of how many sentences each there
EXCERPT = {
    "law_momentum_law": 2,
    "law_contact_drift": 2,
    "cost_evaluations": 1,
    "cost_compiled": 1,
    "claims": 1,
}
GLANCE = (
    "Every method at the same number of evaluations, or as near to it as its steps and tolerances allow; the largest "
    "deviation over the run. Bold: at round-off. How each column is taken stands "
    "[above the same table](#order-and-decay-laws-at-equal-cost)."
)
#: the scene whose figure stands here
DRAWN = "particle"


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
    "forced_oscillator": "a sinusoidal force",
    "lane_emden_5": "damping 2/t, a motion that slows down",
}


def problem(scene: str) -> str:
    said = PROBLEMS.get(scene) or (
        "friction about some axes only" if scene.startswith("singular_damping") else ""
    )
    return f"{said} (`{scene}`)" if said else f"`{scene}`"


def all_findings(frames: Frames) -> list[Finding]:
    """The sentences of every room, in their order."""
    return [
        finding
        for room in rooms(frames)
        if room.name != "headline"
        for finding in once(room.findings, frames)
    ]


def documents(frames: Frames) -> Text:
    """The list of documents."""
    others = [room for room in rooms(frames) if room.name != "headline"]
    lines = (
        f"[{room.file}]({room.file}): {room.about} ({', '.join(f'`{t}.csv`' for t in room.tables if len(frames[t]))})"
        for room in others
    )
    return Text(
        items=(*lines, "[glossary.md](glossary.md): the methods, the scenes and every column of the tables")
    )


def glance(frames: Frames) -> tuple[View, ...]:
    """The table that stands first."""
    view = once(equal_cost.overview, frames)
    return () if view is None else (view,)


def excerpt(frames: Frames) -> list[Part]:
    """What the project's README says of the results: a few sentences, then the table of the laws."""
    found = {finding.name: finding for finding in all_findings(frames)}
    brief = [
        f"**{found[name].title}.** {'. '.join(found[name].sentence.split('. ')[:first]).rstrip('.')}."
        for name, first in EXCERPT.items() if name in found
    ]  # fmt: skip
    return [
        Text(items=tuple(brief)),
        *(replace(view, meaning=GLANCE) for view in glance(frames)),
        Text(UNITS),
    ]


def fields(frames: Frames) -> list[Field]:
    """All contests: evaluations on every scene of either table, times on those that were timed."""
    work, hard = frames["work_precision"], frames["stability"]
    both = [frame for frame in (work, hard) if len(frame)]
    found = [Field(pd.concat(both, ignore_index=True), EVALUATIONS)] if both else []
    return found + [field for field in once(work_precision.fields, frames) if field.kind.timed and len(work)]


def sections(frames: Frames) -> list[Part]:
    contests, rates = fields(frames), frames["damping_rates"]
    winners: list[Part] = [
        winners_view(f, f"winners_{f.kind.name}", f.kind.title, SOURCES, problem) for f in contests
    ]
    if len(rates):
        winners.append(damping.rates_view(rates))
    parts: list[Part] = [
        documents(frames),
        Text(
            f"Every number is computed from the CSV files beside this page by `contactbench report`. {UNITS} "
            "The machine is named at the end."
        ),
        *glance(frames),
        Section("What was found", (spoken(all_findings(frames)),)),
    ]
    if contests:
        parts.append(Section("Which integrator for which problem", tuple(winners)))
        lost = losses_view(contests, "losses", SOURCES)
        parts.append(
            Section(lost.title, (Text(items=reasons(contests)), replace(lost, title="Where and by how much")))
        )
    drawn = (
        work_precision.figures.figure(frames["work_precision"], DRAWN)
        if len(frames["work_precision"])
        else None
    )
    return [*parts, drawn] if drawn else parts


def machines(runs: Sequence[Mapping[str, Any]]) -> Section:
    """Where the tables were made."""
    items = []
    for run in runs:
        packages = ", ".join(f"{k} {v}" for k, v in run.get("packages", {}).items() if k != "contactbench")
        commit = str(run.get("commit", ""))[:12] or "unknown"
        items.append(
            f"run `{run['run']}`: profile {run.get('profile', '')}, {run.get('cpu', '')}, "
            f"{run.get('cores', '')} cores, Python "
            f"{run.get('python', '')}, commit `{commit}`{' with local changes' if run.get('dirty') else ''}; {packages}"
        )
    return Section("Where this was measured", (Text(items=tuple(items)),))


ROOMS.add(
    Room(
        "headline", "Results", "what was found", 0,
        ("laws", "decay_laws", "work_precision", "convergence", "stability", "damping_rates"), sections,
        document="README.md",
    )
)  # fmt: skip
