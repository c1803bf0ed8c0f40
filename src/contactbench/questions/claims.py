"""The paper's claims as a review: where, what was measured, the verdict that follows, what to change."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from contactbench.questions import paper
from contactbench.report.chapters import Answer, Frames, Part, Section, Text, chapter, view
from contactbench.report.drawing import Figure
from contactbench.report.numbers import DASH, how_often
from contactbench.report.views import View, frame_of
from contactbench.tables.schema import BEYOND, SEPARATOR

CAPTIONS = {
    "repairs": "Corrected",
    "replaces": "True instead",
    "sharpens": "Stronger",
    "extends": "How far it goes",
}


#: how verdicts are counted
COUNTED = {"holds": "hold", "holds, corrected": "hold once corrected", "refuted": "refuted"}


def split_claims(frame: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    beyond = frame["where"] == BEYOND
    return frame[~beyond], frame[beyond]


def answers(frames: Frames) -> Iterator[Answer]:
    asked = "Do the paper's claims hold as printed?", "Do the claims beyond the paper hold?"
    for question, part in zip(asked, split_claims(frames["claims"]), strict=True):
        if len(part):
            verdicts = part["verdict"].value_counts()
            counts = ", ".join(f"{verdicts.get(name, 0)} {word}" for name, word in COUNTED.items())
            yield Answer(
                question, how_often(verdicts.get("holds", 0), len(part)), f"{counts}, of {len(part)}"
            )


def claims_view(frame: pd.DataFrame) -> View:
    rows = []
    for _, row in frame.iterrows():
        needed = DASH if pd.isna(row["bound"]) else f"{row['relation']} {row['bound']:.2g}"
        verdict = row["verdict"] or row["status"]
        rows.append((row["id"], verdict, *row[["claim", "where", "quantity", "measured"]], needed))
    labels = ["id", "verdict", "claim", "where in the paper", "measured", "value", "needed"]
    return view("claims", frame_of(rows, labels), {"": "{:.2g}".format})


def claim_section(row: pd.Series, drawn: dict[str, Figure]) -> Section:
    title = f"{row['id']} · {row['verdict'] or row['status']}"
    parts: list[Part] = [Text(f"**Claim** ({row['where']}). {row['claim']}")]
    if row["status"] != "ok":
        return Section(title, (*parts, Text(f"Not measured: {row['message']}. `{row['command']}`")))
    parts.append(Text(f"**Measured** on {row['scene']}. Method: {row['method']}.", items(row["evidence"])))
    if row["correction"]:
        caption = CAPTIONS.get(row["correction_kind"], "Corrected")
        parts.append(Text(f"**{caption}.** {row['correction']}", items(row["corrected_evidence"])))
    parts.append(Text(f"Measure it again: `{row['command']}`"))
    parts += [drawn.pop(name) for name in row["figures"].split() if name in drawn]
    return Section(title, tuple(parts))


def items(evidence: str) -> tuple[str, ...]:
    found = (item for item in evidence.split(SEPARATOR) if item)
    return tuple(item.replace(" fails (", " **fails** (") for item in found)


@chapter("claims", answers)
def parts(frames: Frames) -> list[Part]:
    frame = frames["claims"]
    drawn = {figure.name: figure for figure in paper.all_figures(frames["paper_figures"])}
    sections: list[Part] = []
    for title, some in zip(("Claim by claim", "Beyond the paper"), split_claims(frame), strict=True):
        sections.append(Section(title, tuple(claim_section(row, drawn) for _, row in some.iterrows())))
    return [claims_view(frame), *sections, Section("Other figures", tuple(drawn.values()))]
