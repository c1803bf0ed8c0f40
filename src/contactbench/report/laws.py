"""Decay laws and drifts: law by law over all settings, at equal cost, and along time."""

from __future__ import annotations

from contactbench.measure.round_off import DECIDABLE
from contactbench.report.cells import DASH, Cell, Head, Mark, View, marks, word
from contactbench.report.equal_cost import equal_cost_view
from contactbench.report.figures import laws as figures
from contactbench.report.kept import DAGGER, DOUBLE_DAGGER, FROZEN, MEANINGS, called, laws, measured
from contactbench.report.law_findings import findings
from contactbench.report.numbers import readable, scientific, upper
from contactbench.report.raw import raw
from contactbench.report.rooms import ROOMS, Frames, Part, Room, Section, Text
from contactbench.results.schema import Column, Rule
from contactbench.results.tables import LAWS_TABLE


def law_view(frames: Frames, law: str, column: Column) -> View | None:
    """Methods × scenes of one law: the range over the settings, or that it is kept."""
    frame = frames["laws"]
    rows = measured({"laws": frame}, law)
    if not len(rows):
        return None
    structure = column.rule is Rule.structure
    scenes = [s for s in dict.fromkeys(frame["scene"]) if s in set(rows["scene"])]
    lines, by_pair = [], dict(list(rows.groupby(["method", "scene"], sort=False)))
    for method in dict.fromkeys(rows["method"]):
        cells = [word(method)]
        for scene in scenes:
            if (method, scene) not in by_pair:
                cells.append(Cell(DASH))
                continue
            here = by_pair[method, scene]
            low, high = here["value"].min(), here["value"].max()
            judged = here[here["judged"]]
            kept = structure and len(judged) > 0 and bool(judged["kept"].all())
            ill = structure and bool((here["undecided"] & (here["bound"] > DECIDABLE)).any())
            clamped, vague = bool((here["clamped"] > 0).any()), bool(here["unsure"].any())
            whole = column.type == "whole"
            show = readable if whole else scientific
            text = show(high) if kept or low == high else f"{show(low)} … {show(high)}"
            text = ("≤ " if vague and not kept else "") + text
            cells.append(
                Cell(text + (DAGGER if clamped else "") + (DOUBLE_DAGGER if ill else ""), high,
                     marks(Mark.kept if kept else None, Mark.clamped if clamped else None))
            )  # fmt: skip
        lines.append(tuple(cells))
    label = called(law)
    meaning = f"{column.meaning}. {upper(MEANINGS['range'])}."
    if structure:
        meaning += f" {upper(MEANINGS['kept'])}. {MEANINGS['undecided']}."
    if f"{law}_clamped" in frame:
        meaning += f" {MEANINGS['dagger']}."
    if f"{law}{FROZEN}" in frame:
        meaning += (
            " That of the map itself; of adaptive methods not with their steps held fixed. ≤: "
            "no more than an upper bound."
        )
    heads = (Head("method", words=True), *map(Head, scenes))
    return View(f"law_{law}", label, meaning, heads, tuple(lines), "laws.csv")


def sections(frames: Frames) -> list[Part]:
    parts: list[Part] = [
        Text(items=tuple(f"`{name}` ({called(name)}): {c.meaning}" for name, c in laws(LAWS_TABLE).items()))
    ]
    equal = frames["decay_laws"]
    if len(equal):
        costs = equal.groupby(["scene", "cost"], sort=False)
        parts.append(Section("At equal cost", tuple(equal_cost_view(part, frames) for _, part in costs)))
    views = (law_view(frames, law, column) for law, column in laws(LAWS_TABLE).items())
    ranges: list[Part] = [view for view in views if view is not None]
    drawn = figures.structure(frames["laws"])
    parts.append(Section("Law by law, over all settings", (*ranges, *([drawn] if drawn else []))))
    time = frames["laws_time"]
    scenes = dict.fromkeys(time[time["status"] == "ok"]["scene"]) if len(time) else {}
    along = [
        Section(str(s), (figures.along_time(time, s),), choice="scene", anchor=f"along-time-{s}")
        for s in scenes
    ]
    parts += [Section("Along time", tuple(along))] if along else []
    return [*parts, raw(LAWS_TABLE, frames["laws"])]


ROOMS.add(
    Room(
        "laws", "Decay laws and drifts", "which methods preserve the laws, law by law and at equal cost", 20,
        ("laws", "decay_laws", "laws_time", "convergence", "stability"), sections, findings, tab="Laws",
    )
)  # fmt: skip
