"""The paper's claims as a review: where, what was measured, the verdict that follows, what to change."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from contactbench.paper import CLAIMS
from contactbench.questions import paper
from contactbench.questions.answers import evaluate
from contactbench.report.chapters import PROSE, Answer, Frames, Part, Section, Text, chapter, view
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
QUERY = "claims[claims.id.str.startswith('C')].verdict.value_counts()"


def answers(frames: Frames) -> Iterator[Answer]:
    verdicts = evaluate(QUERY, frames)
    if whole := int(verdicts.sum()):
        counts = ", ".join(f"{verdicts.get(name, 0)} {word}" for name, word in COUNTED.items())
        share = how_often(int(verdicts.get("holds", 0)), whole)
        yield Answer(PROSE["claims"]["asked"], share, f"{counts}, of {whole}", (QUERY,))


def known(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of the claims that this version has, with what the ledger says of each beside the numbers."""
    rows = frame[frame["id"].isin([*CLAIMS])]
    own = [CLAIMS[name] for name in rows["id"]]
    says = {"where": [c.where for c in own], "claim": [c.says for c in own], "scene": [c.scene for c in own]}
    says |= {"method": [c.method for c in own], "correction": [c.correction for c in own]}
    return rows.assign(**says, figures=[c.figures for c in own])


def claims_view(frame: pd.DataFrame) -> View:
    """Return the claims that do not hold as printed."""
    rows = []
    for _, row in frame[frame["verdict"] != "holds"].iterrows():
        needed = DASH if pd.isna(row["bound"]) else f"{row['relation']} {row['bound']:.2g}"
        verdict = row["verdict"] or row["status"]
        rows.append((row["id"], verdict, row["claim"], row["where"], row["measured"], needed))
    labels = ["id", "verdict", "claim", "where in the paper", "measured", "needed"]
    return view("claims", frame_of(rows, labels), {"": "{:.2g}".format})


def claim_section(row: pd.Series, drawn: dict[str, Figure]) -> Section:
    title = f"{row['id']} · {row['verdict'] or row['status']}"
    parts: list[Part] = [Text(f"**Claim** ({row['where']}). {row['claim']}")]
    if row["status"] != "ok":
        return Section(title, (*parts, Text(f"Not measured: {row['message']}")))
    method = "" if row["method"].startswith("none") else f", {row['method']}"
    parts.append(Text(f"**Measured** on {row['scene']}{method}.", items(row["evidence"])))
    if row["correction"]:
        caption = CAPTIONS.get(row["correction_kind"], "Corrected")
        parts.append(Text(f"**{caption}.** {row['correction']}", items(row["corrected_evidence"])))
    parts += [drawn.pop(name) for name in row["figures"] if name in drawn]
    return Section(title, tuple(parts))


def items(evidence: str) -> tuple[str, ...]:
    found = (item for item in evidence.split(SEPARATOR) if item)
    return tuple(item.replace(" fails (", " **fails** (") for item in found)


@chapter("claims", answers)
def parts(frames: Frames) -> list[Part]:
    frame = known(frames["claims"])
    drawn = {figure.name: figure for figure in paper.all_figures(frames["motion"])}
    sections: list[Part] = []
    beyond = frame["where"] == BEYOND
    for title, some in (("Claim by claim", frame[~beyond]), ("Beyond the paper", frame[beyond])):
        sections.append(Section(title, tuple(claim_section(row, drawn) for _, row in some.iterrows())))
    return [claims_view(frame), *sections, Section("Other figures", tuple(drawn.values()))]
