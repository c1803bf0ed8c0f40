"""The paper's claims as a review: where, what was measured, the verdict that follows, what to change."""

from __future__ import annotations

import pandas as pd

from contactbench.report.cells import DASH, Cell, Head, Mark, View, number, word
from contactbench.report.drawing import Figure
from contactbench.report.figures import paper
from contactbench.report.numbers import many, names
from contactbench.report.rooms import ROOMS, Finding, Frames, Part, Room, Section, Text, slug
from contactbench.results.schema import BEYOND, SEPARATOR

VERDICTS = {
    "holds": (Mark.holds, "the measurements agree with the claim as it stands"),
    "holds, corrected": (Mark.corrected, "true once the stated correction is made"),
    "refuted": (Mark.refuted, "a number contradicts it, and what is true instead is stated"),
}
CAPTIONS = {
    "repairs": "Corrected",
    "replaces": "True instead",
    "sharpens": "Stronger",
    "extends": "How far it goes",
}
ABOUT = (
    "Each verdict follows from the numbers beside it, which are computed; whether a claim that fails is repaired or "
    "replaced by its correction is argued there. Identities are tested by automatic "
    "differentiation at random points, independently of the formulas they test; trajectories against references of 30 "
    "digits or more; orders where it matters in 50-digit arithmetic. The paper prints step and end time of its "
    "experiment; damping and initial data are ours. Of several measurements the table shows the first that fails, else "
    "the first."
)


def verdict(row: pd.Series) -> str:
    return str(row["verdict"] or row["status"])


def heading(row: pd.Series) -> str:
    return f"{row['id']} · {verdict(row)}"


def items(evidence: str) -> tuple[str, ...]:
    """A row's measurements, one each."""
    found = (item for item in evidence.split(SEPARATOR) if item)
    return tuple(item.replace(" fails (", " **fails** (") for item in found)


def more(row: pd.Series) -> tuple[tuple[str, str | tuple[str, ...]], ...]:
    """What is shown of a claim on demand."""
    parts: list[tuple[str, str | tuple[str, ...]]] = [("Measured", items(row["evidence"]))]
    if row["correction"]:
        parts.append((CAPTIONS.get(row["correction_kind"], "Corrected"), row["correction"]))
    if row["corrected_evidence"]:
        parts.append(("Measured", items(row["corrected_evidence"])))
    return (*parts, ("On", f"{row['scene']}; {row['method']}"), ("Measure it again", f"`{row['command']}`"))


def claims_view(frame: pd.DataFrame) -> View:
    rows = []
    for _, row in frame.iterrows():
        mark = VERDICTS[row["verdict"]][0] if row["verdict"] in VERDICTS else Mark.bad
        bound = (
            Cell(DASH)
            if pd.isna(row["bound"])
            else Cell(f"{row['relation']} {row['bound']:.2g}", row["bound"])
        )
        rows.append((
            word(row["id"], link=f"#{slug(heading(row))}"), word(verdict(row), mark), Cell(row["claim"],
            more=more(row)),
            word(row["where"]), word(row["quantity"]), number(row["measured"], "{:.2g}".format), bound,
        ))  # fmt: skip
    heads = (
        *(Head(label, words=True) for label in ("id", "verdict", "claim", "where in the paper", "what was measured")),
        Head("measured"), Head("needed"),
    )  # fmt: skip
    meaning = " ".join(f"*{name}*: {about}." for name, (_, about) in VERDICTS.items())
    return View("claims", "All claims", meaning, heads, tuple(rows), "claims.csv")


def claim_section(row: pd.Series, drawn: dict[str, Figure]) -> Section:
    """One claim: where, what, evidence, verdict, correction, command, figures."""
    parts: list[Part] = [Text(f"**Claim** ({row['where']}). {row['claim']}")]
    if row["status"] != "ok":
        return Section(
            heading(row), (*parts, Text(f"Not measured: {row['message']}"), Text(f"`{row['command']}`"))
        )
    parts.append(Text(f"**Measured** on {row['scene']}. Method: {row['method']}.", items(row["evidence"])))
    if row["correction"]:
        said = f"**{CAPTIONS.get(row['correction_kind'], 'Corrected')}.** {row['correction']}"
        parts.append(Text(said, items(row["corrected_evidence"])))
    parts.append(Text(f"Measure it again: `{row['command']}`"))
    parts += [
        drawn.pop(name) for name in row["figures"].split() if name in drawn
    ]  # once, where it is first needed
    return Section(heading(row), tuple(parts))


def parted(frame: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The paper's claims, and those beyond it."""
    beyond = frame["where"] == BEYOND
    return frame[~beyond], frame[beyond]


def count(frame: pd.DataFrame) -> dict[str, int]:
    return {name: int((frame["verdict"] == name).sum()) for name in VERDICTS}


def findings(frames: Frames) -> list[Finding]:
    frame = frames["claims"]
    if not len(frame):
        return []
    own, beyond = parted(frame)
    held, corrected, refuted = count(own).values()
    sentence = (
        f"Of its {len(own)} claims {held} hold, {corrected} hold once corrected, {refuted} are refuted."
    )
    if len(beyond):
        sentence += (
            f" Beyond it {count(beyond)['holds']} of {many(len(beyond), 'claim')} hold: "
            + names([row["claim"].partition(":")[0].lower() for _, row in beyond.iterrows()])
            + "."
        )
    missing = frame[~frame["verdict"].isin(VERDICTS)]
    exceptions = tuple(f"{r['id']} was not measured: {r['message']}" for _, r in missing.iterrows())
    return [Finding("claims", "The paper", sentence, f"{len(frame)} claims", exceptions)]


def sections(frames: Frames) -> list[Part]:
    frame = frames["claims"]
    drawn = {figure.name: figure for figure in paper.all_figures(frames["paper_figures"])}
    fell = frame[
        frame["verdict"].isin([name for name in VERDICTS if name != "holds"]) & (frame["correction"] != "")
    ]
    changes = tuple(
        f"[{r['id']}](#{slug(heading(r))}), {r['where']}: {r['correction']}" for _, r in fell.iterrows()
    )
    told, more_told = (
        tuple(claim_section(row, drawn) for _, row in some.iterrows()) for some in parted(frame)
    )
    return [
        Text(ABOUT),
        *([Section("What to change in the paper", (Text(items=changes),))] if changes else []),
        claims_view(frame),
        Section("Claim by claim", told),
        *([Section("Beyond the paper", more_told)] if more_told else []),
        *([Section("Other figures", tuple(drawn.values()))] if drawn else []),
    ]


ROOMS.add(
    Room("claims", "The paper's claims, measured",
         "every checkable claim of the paper with its verdict, and two beyond it", 70, ("claims", "paper_figures"),
         sections, findings, tab="Claims")
)  # fmt: skip
