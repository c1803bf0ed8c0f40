"""Decay laws and drifts: who keeps which law, at equal cost, law by law, and along time."""

from __future__ import annotations

import pandas as pd

from contactbench.report.chapters import CHAPTERS, Chapter, Frames, Part, Section, Text, once, summary
from contactbench.report.equal_cost import equal_cost_view
from contactbench.report.figures import laws as figures
from contactbench.report.figures.structure import structure as structure_figure
from contactbench.report.law_cells import LEGEND, law_label, meanings, range_cell
from contactbench.report.numbers import DASH, how_often, names, readable, scientific, times
from contactbench.report.views import Cell, Mark, Show, View, frame_of
from contactbench.results.contest import CONTACT
from contactbench.results.judgement import law_rows, laws_in, structural_laws
from contactbench.results.schema import Column, Rule
from contactbench.results.tables import LAWS_TABLE

SOURCE = "laws.csv"


def judged_rows(frames: Frames) -> dict[str, pd.DataFrame]:
    """Return the judged runs of every structural law that has any."""
    found = {law: law_rows(frames, law) for law in structural_laws()}
    return {law: rows[rows["judged"]] for law, rows in found.items() if rows["judged"].any()}


def kept_of(rows: pd.DataFrame) -> tuple[int, int]:
    """Return in how many runs a law is kept, and how many decide."""
    return int(rows["kept"].sum()), int((~rows["undecided"]).sum())


def counts(rows: pd.DataFrame) -> str:
    """Return kept of decided, and the undecided: 3 of 4 runs, 2 undecided."""
    kept, told = kept_of(rows)
    left = len(rows) - told
    return f"{kept} of {told} runs" + (f", {left} undecided" if left else "")


def answers(frames: Frames) -> pd.DataFrame:
    """Return for each law whether it is kept wherever it is claimed."""
    lines = []
    for law, rows in once(judged_rows, frames).items():
        claimed = rows[rows["claimed"]]
        if len(claimed):
            lines.append(
                (
                    f"{law_label(law)}: at round-off where claimed?",
                    how_often(*kept_of(claimed)),
                    counts(claimed),
                )
            )
    return summary(*lines)


# -- views -----------------------------------------------------------------------------------------
def claims_view(frames: Frames) -> View:
    """Return how often each law is kept: where it is claimed, by contact methods where it is not, by the others."""
    rows = []
    for law, judged in once(judged_rows, frames).items():
        contact = judged["family"] == CONTACT
        groups = (judged["claimed"], contact & ~judged["claimed"], ~contact & ~judged["claimed"])
        cells = [counts(judged[group]) if group.any() else DASH for group in groups]
        rows.append(
            (
                law_label(law),
                *cells,
                int((judged["kept"] & judged["claimed"] & (judged["clamped"] > 0)).sum()),
            )
        )
    labels = ["law", "claimed", "contact methods, not claimed", "others, not claimed", "resting on a floor"]
    legend = (
        "Runs that keep the law to round-off, of those that decide. Resting on a floor: kept runs in which the "
        "quantity all but vanishes at some times. [Why a law is not claimed](../docs/reading.md#laws)."
    )
    return View("law_claims", "Who keeps which law", frame_of(rows, labels), legend, SOURCE)


def broken_view(frames: Frames) -> View:
    """Return where a claimed law is broken, by which methods, and by how much at most."""
    rows = []
    for law, judged in once(judged_rows, frames).items():
        broken = judged[judged["claimed"] & judged["broken"]]
        for scene, own in broken.groupby("scene", sort=False):
            over = own["value"] / own["bound"]
            worst = own.loc[over.idxmax()]
            methods = names(list(dict.fromkeys(own["method"])), 3)
            held = int((own["frozen"] <= own["bound"]).sum())
            place = f"{worst['method']}, {worst['setting']}"
            rows.append(
                (law_label(law), f"`{scene}`", methods, len(own), held, over.max(), worst["value"], place)
            )
    labels = [
        "law",
        "scene",
        "methods",
        "runs",
        "kept with steps held fixed",
        "over the bound",
        "deviation",
        "worst",
    ]
    show: dict[str, Show] = {"over the bound": times, "deviation": scientific}
    legend = "Claimed, and not kept; the worst run by its deviation over the bound of round-off."
    return View("law_exceptions", "Exceptions", frame_of(rows, labels), legend, SOURCE, show)


def keepers_view(frames: Frames) -> View:
    """Return in how many runs each method keeps each law."""
    laws = once(judged_rows, frames)
    order = [m for frame in (frames["laws"], frames["stability"]) for m in frame["method"]]
    judged = {method for rows in laws.values() for method in rows["method"]}
    rows = []
    for method in dict.fromkeys(m for m in order if m in judged):
        cells = []
        for own in (rows_of[rows_of["method"] == method] for rows_of in laws.values()):
            kept, told = kept_of(own)
            always = Mark.kept if told and kept == told else None
            cells.append(Cell(f"{kept} of {told}", kept / told, always) if told else Cell(DASH))
        rows.append((method, *cells))
    legend = "Runs that keep the law to round-off, of those that decide, claimed or not. Bold: all of them."
    frame = frame_of(rows, ["method", *map(law_label, laws)])
    return View("law_keepers", "Method by method", frame, legend, SOURCE, meanings=meanings(list(laws)))


def modified_view(frames: Frames) -> View | None:
    """Return how much nearer the modified Hamiltonian is to its decay than H itself, in the same runs."""
    both = [law_rows(frames, law) for law in ("hamiltonian_law", "modified_hamiltonian")]
    keys = ["scene", "method", "setting"]
    pairs = both[0].merge(both[1], on=keys, suffixes=("", "_modified"))
    pairs = pairs[pairs["value"] > 10 * pairs["bound"]]
    if not len(pairs):
        return None
    gain = (pairs["value"] / pairs["value_modified"]).groupby(pairs["method"], sort=False)
    frame = gain.agg(["size", "min", "median", "max"]).reset_index()
    frame.columns = pd.Index(["method", "runs", "least", "median", "largest"])
    show = dict.fromkeys(("least", "median", "largest"), times)
    legend = "How many times nearer to e^{−γt} the modified Hamiltonian is than H, in runs in which H is off."
    return View("modified", "The modified Hamiltonian", frame, legend, SOURCE, show)


def law_view(frames: Frames, law: str, column: Column) -> View | None:
    """Return the range of one law over the settings, methods × scenes."""
    rows = law_rows({"laws": frames["laws"]}, law)
    if not len(rows):
        return None
    scenes = list(dict.fromkeys(rows["scene"]))
    show = readable if column.type == "whole" else scientific
    by_pair = dict(list(rows.groupby(["method", "scene"], sort=False)))
    structural = column.rule is Rule.structure
    lines = [
        (
            m,
            *(
                range_cell(by_pair[m, s], structural, show) if (m, s) in by_pair else Cell(DASH)
                for s in scenes
            ),
        )
        for m in dict.fromkeys(rows["method"])
    ]
    return View(
        f"law_{law}", law_label(law), frame_of(lines, ["method", *scenes]), f"{column.meaning}.", SOURCE
    )


def parts(frames: Frames) -> list[Part]:
    found = [claims_view(frames), broken_view(frames), keepers_view(frames), modified_view(frames)]
    structure = structure_figure(frames["laws"])
    equal = frames["decay_laws"]
    costs = [equal_cost_view(part, frames) for _, part in equal.groupby(["scene", "cost"], sort=False)]
    ranges = [law_view(frames, law, column) for law, column in laws_in(LAWS_TABLE).items()]
    time = frames["laws_time"]
    along = [
        Section(str(scene), (figures.along_time(time, scene, frames["laws"]),), choice="scene")
        for scene in dict.fromkeys(time[time["status"] == "ok"]["scene"])
    ]
    return [
        *(view for view in found[:2] if view is not None),
        *([structure] if structure else []),
        *(view for view in found[2:] if view is not None),
        *([Section("At equal cost", (Text(LEGEND), *costs))] if costs else []),
        Section(
            "Law by law, smallest … largest over all settings", (Text(LEGEND), *(v for v in ranges if v))
        ),
        *([Section("Along time", tuple(along))] if along else []),
    ]


CHAPTERS.add(
    Chapter(
        "laws",
        "Decay laws and drifts",
        "Which methods keep the laws of the motion?",
        20,
        ("laws", "decay_laws", "laws_time", "convergence", "stability"),
        parts,
        answers,
    )
)
