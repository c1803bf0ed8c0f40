"""The paper's claims as a review: where each stands, its verdict, the measurements, and the correction."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from contactbench.paper import CLAIMS
from contactbench.questions import paper
from contactbench.questions.answers import evaluate
from contactbench.report.chapters import PROSE, Answer, Frames, Part, Section, chapter, view
from contactbench.report.numbers import DASH, how_often
from contactbench.report.views import View, frame_of
from contactbench.tables.schema import BEYOND

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
    says = {"where": [c.where for c in own], "claim": [c.says for c in own]}
    return rows.assign(**says, correction=[c.correction for c in own])


def claims_view(frame: pd.DataFrame) -> View:
    """Return the claims that do not hold as printed, with their corrections."""
    rows = []
    for _, row in frame[frame["verdict"] != "holds"].iterrows():
        needed = DASH if pd.isna(row["bound"]) else f"{row['relation']} {row['bound']:.2g}"
        verdict, instead = row["verdict"] or row["status"], row["correction"] or row["message"]
        rows.append((row["id"], verdict, row["claim"], row["where"], row["measured"], needed, instead))
    labels = ["id", "verdict", "claim", "where in the paper", "measured", "needed", "instead"]
    return view("claims", frame_of(rows, labels), {"": "{:.2g}".format})


def held_view(name: str, frame: pd.DataFrame) -> View:
    rows = frame[frame["verdict"] == "holds"]
    return view(name, frame_of(rows[["id", "claim", "where"]].to_numpy().tolist(), ["id", "claim", "where"]))


@chapter("claims", answers)
def parts(frames: Frames) -> list[Part]:
    frame = known(frames["claims"])
    beyond = frame["where"] == BEYOND
    held = [held_view("claims_held", frame[~beyond]), held_view("claims_beyond", frame[beyond])]
    drawn = tuple(paper.all_figures(frames["motion"]))
    return [claims_view(frame), *held, Section("The paper's figures", drawn)]
