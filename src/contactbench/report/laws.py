"""Decay laws and drifts: who keeps which law, at equal cost, law by law, and along time."""

from __future__ import annotations

import pandas as pd

from contactbench.report.chapters import CHAPTERS, Chapter, Frames, Part, Section, Text, once, summary
from contactbench.report.equal_cost import equal_cost_view
from contactbench.report.figures import laws as figures
from contactbench.report.figures.structure import structure
from contactbench.report.law_cells import LEGEND, law_label, range_cell
from contactbench.report.numbers import DASH, how_often, names, readable, scientific, times
from contactbench.report.views import Cell, Mark, Show, View, frame_of, matrix
from contactbench.results.contest import CONTACT
from contactbench.results.judgement import law_rows, laws_in, structural_laws
from contactbench.results.schema import Column, Rule
from contactbench.results.tables import LAWS_TABLE

SOURCE = "laws.csv"


def judged_rows(frames: Frames) -> pd.DataFrame:
    """Return the judged runs of every structural law, with its name in a column."""
    rows = pd.concat([law_rows(frames, law).assign(law=law) for law in structural_laws()], ignore_index=True)
    return rows[rows["judged"]].assign(label=lambda rows: rows["law"].map(law_label))


def kept_of(rows: pd.DataFrame) -> tuple[int, int]:
    """Return in how many runs a law is kept, and how many decide."""
    return int(rows["kept"].sum()), int((~rows["undecided"]).sum())


def counts(rows: pd.DataFrame) -> str:
    """Return kept of decided, and the undecided beside them: 3 of 4 runs (2 more undecided)."""
    kept, decided = kept_of(rows)
    left = len(rows) - decided
    return f"{kept} of {decided} runs" + (f" ({left} more undecided)" if left else "")


def answers(frames: Frames) -> pd.DataFrame:
    """Return for each law whether it is kept wherever it is claimed."""
    rows = once(judged_rows, frames)
    return summary(
        *(
            (f"{label}: at round-off where claimed?", how_often(*kept_of(own)), counts(own))
            for label, own in rows[rows["claimed"]].groupby("label", sort=False)
        )
    )


# -- views -----------------------------------------------------------------------------------------
def claims_view(rows: pd.DataFrame) -> View:
    """Return how often each law is kept: where it is claimed, by contact methods where it is not, by the others."""
    groups = (
        rows["family"].eq(CONTACT).map({True: "contact methods, not claimed", False: "others, not claimed"})
    )
    rows = rows.assign(who=groups.where(~rows["claimed"], "claimed")).rename(columns={"label": "what"})
    frame = matrix(
        rows.sort_values("who", key=lambda who: who != "claimed", kind="stable"), "what", "who", counts
    )
    legend = (
        "Runs that keep the law to round-off, of those that decide. "
        "[Why a law is not claimed](../docs/reading.md#laws)."
    )
    return View("law_claims", "Who keeps which law", frame.rename(columns={"what": "law"}), legend, SOURCE)


def broken_view(rows: pd.DataFrame) -> View:
    """Return where a claimed law is broken, by which methods, and by how much at most."""
    broken = rows[rows["claimed"] & rows["broken"]]
    lines = []
    for (label, scene), own in broken.groupby(["label", "scene"], sort=False):
        over = own["value"] / own["bound"]
        worst = own.loc[over.idxmax()]
        held = int((own["frozen"] <= own["bound"]).sum())
        methods, place = (
            names(list(dict.fromkeys(own["method"])), 3),
            f"{worst['method']}, {worst['setting']}",
        )
        lines.append((label, f"`{scene}`", methods, len(own), held, over.max(), worst["value"], place))
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
    return View("law_exceptions", "Exceptions", frame_of(lines, labels), legend, SOURCE, show)


def keepers_view(rows: pd.DataFrame) -> View:
    """Return in how many runs each method keeps each law."""

    def cell(own: pd.DataFrame) -> Cell:
        kept, decided = kept_of(own)
        share = f"{kept} of {decided}"
        return Cell(share, kept / decided, Mark.kept if kept == decided else None) if decided else Cell(DASH)

    legend = "Runs that keep the law to round-off, of those that decide, claimed or not. Bold: all of them."
    return View("law_keepers", "Method by method", matrix(rows, "method", "label", cell), legend, SOURCE)


def modified_view(frames: Frames) -> View:
    """Return how much nearer the modified Hamiltonian is to its decay than H itself, in the same runs."""
    plain, modified = (law_rows(frames, law) for law in ("hamiltonian_law", "modified_hamiltonian"))
    pairs = plain.merge(modified, on=["scene", "method", "setting"], suffixes=("", "_modified"))
    pairs = pairs[pairs["value"] > 10 * pairs["bound"]]
    gain = (pairs["value"] / pairs["value_modified"]).groupby(pairs["method"], sort=False)
    frame = gain.agg(["size", "min", "median", "max"]).reset_index()
    frame.columns = pd.Index(["method", "runs", "least", "median", "largest"])
    legend = "How many times nearer to e^{−γt} the modified Hamiltonian is than H, in runs in which H is off."
    show = dict.fromkeys(("least", "median", "largest"), times)
    return View("modified", "The modified Hamiltonian", frame, legend, SOURCE, show)


def law_view(frames: Frames, law: str, column: Column) -> View:
    """Return the range of one law over the settings, methods × scenes."""
    rows = law_rows({"laws": frames["laws"]}, law)
    show = readable if column.type == "whole" else scientific
    structural = column.rule is Rule.structure
    frame = matrix(rows, "method", "scene", lambda own: range_cell(own, structural, show))
    return View(f"law_{law}", law_label(law), frame, f"{column.meaning}.", SOURCE)


def parts(frames: Frames) -> list[Part]:
    rows, time = once(judged_rows, frames), frames["laws_time"]
    drawn = structure(frames["laws"])
    equal = frames["decay_laws"].groupby(["scene", "cost"], sort=False)
    ranges = [law_view(frames, law, column) for law, column in laws_in(LAWS_TABLE).items()]
    scenes = dict.fromkeys(time[time["status"] == "ok"]["scene"])
    along = (Section(s, (figures.along_time(time, s, frames["laws"]),), "scene") for s in scenes)
    modified = modified_view(frames)
    return [
        claims_view(rows),
        broken_view(rows),
        *([drawn] if drawn else []),
        keepers_view(rows),
        *([modified] if len(modified.frame) else []),
        Section("At equal cost", (Text(LEGEND), *(equal_cost_view(part, frames) for _, part in equal))),
        Section(
            "Law by law", (Text(f"Smallest … largest over all settings. {LEGEND}"), *filter(has_rows, ranges))
        ),
        Section("Along time", tuple(along)),
    ]


def has_rows(view: View) -> bool:
    return len(view.frame) > 0


TITLE, QUESTION = "Decay laws and drifts", "Which methods keep the laws of the motion?"
TABLES = ("laws", "decay_laws", "laws_time", "convergence", "stability")
CHAPTERS.add(Chapter("laws", TITLE, QUESTION, 20, TABLES, parts, answers))
