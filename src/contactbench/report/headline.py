"""The headline: results/README.md and the computed part of the project's README.

What was asked for stands first: the order and the decay laws of every method at equal cost.  Then the
computed sentences of all rooms, and who is cheapest where.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from contactbench.report import laws, stability
from contactbench.report.contest import KINDS, Field, duel_view, losses_view, winners_view
from contactbench.report.model import (
    ROOMS, Finding, Frames, Part, Room, Section, Text, View, figures, rooms,
)  # fmt: skip
from contactbench.report.work_precision import SOURCE, reasons

UNITS = "All quantities are dimensionless, as in the paper; times are of the machine named below."
#: scenes whose costs stand in the project's README
DUELS = ("particle_long", "rigid_body")
#: the figure beside the comparison of costs
DRAWN = "work_precision_particle"


def all_findings(frames: Frames) -> list[Finding]:
    """The sentences of every room, in their order."""
    return [finding for room in rooms(frames) if room.name != "headline" for finding in room.findings(frames)]


def spoken(found: list[Finding], exceptions: bool = True) -> Text:
    """Findings as a list: sentence, exceptions, what it covers."""
    items = []
    for finding in found:
        said = f"**{finding.title}.** {finding.sentence}"
        if exceptions and finding.exceptions:
            said += f" Exceptions: {'; '.join(finding.exceptions)}."
        items.append(f"{said} *({finding.covers}.)*")
    return Text(items=tuple(items))


def documents(frames: Frames) -> Text:
    """The list of documents."""
    others = [room for room in rooms(frames) if room.name != "headline"]
    lines = (f"[{room.file}]({room.file}): {room.about} ({', '.join(f'`{t}.csv`' for t in room.tables if len(frames[t]))})" for room in others)  # fmt: skip
    return Text(items=(*lines, "[glossary.md](glossary.md): the methods, the scenes and every column of the tables"))


def glance(frames: Frames) -> tuple[View, ...]:
    """The table that stands first."""
    view = laws.overview(frames)
    return () if view is None else (view,)


def excerpt(frames: Frames) -> list[Part]:
    """What the project's README says of the results."""
    work = frames["work_precision"]
    parts: list[Part] = [*glance(frames), Text(UNITS), spoken(all_findings(frames))]
    for kind in KINDS[:2]:
        field = Field(work, kind) if len(work) else None
        parts += [duel_view(field, s, SOURCE) for s in DUELS if field is not None and s in field.contested]
    return parts


def sections(frames: Frames) -> list[Part]:
    work = frames["work_precision"]
    fields = [Field(work, kind) for kind in KINDS] if len(work) else []
    drawn = [f for f in figures(ROOMS["work_precision"].sections(frames)) if f.name == DRAWN] if len(work) else []
    advised = list(stability.advice(frames))
    parts: list[Part] = [
        documents(frames),
        Text(f"Every number is computed from the CSV files beside this page by `contactbench report`. {UNITS}"),
        *glance(frames),
        Section("What was found", (spoken(all_findings(frames)),)),
    ]
    if fields:
        views = (winners_view(f, f"headline_{f.kind.name}", f.kind.title, SOURCE) for f in fields)
        parts.append(Section("Cheapest at equal error", (*views, *drawn)))
        lost = losses_view(fields, "headline_losses", SOURCE)
        parts.append(Section("Where the contact methods lose", (Text(items=reasons(fields)), lost)))
    if advised:
        parts.append(Section("Which integrator for which problem", tuple(advised)))
    return parts


def machines(runs: Mapping[str, Mapping[str, Any]]) -> Section:
    """Where the tables were made."""
    items = []
    for name, run in sorted(runs.items()):
        packages = ", ".join(f"{k} {v}" for k, v in run.get("packages", {}).items() if k != "contactbench")
        commit = str(run.get("commit", ""))[:12] or "unknown"
        items.append(
            f"run `{name}`: profile {run.get('profile', '')}, {run.get('cpu', '')}, {run.get('cores', '')} cores, Python "
            f"{run.get('python', '')}, commit `{commit}`{' with local changes' if run.get('dirty') else ''}; {packages}"
        )
    return Section("Where this was measured", (Text(items=tuple(items)),))


ROOMS.add(
    Room(
        "headline", "Results", "what was found", 0,
        ("laws", "decay_laws", "work_precision", "convergence", "stability", "claims"), sections, document="README.md",
    )
)  # fmt: skip
