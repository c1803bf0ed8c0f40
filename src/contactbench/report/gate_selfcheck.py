"""How far the regression gate can be trusted: its false-alarm rate and its sensitivity."""

from __future__ import annotations

import pandas as pd

from contactbench.report.cells import Head, Mark, View, number, word
from contactbench.report.numbers import count, duration, upper
from contactbench.report.rooms import ROOMS, Finding, Frames, Part, Room, Text

ABOUT = (
    "The gate compares a version of the code with the one before: its errors, counts and structure with the committed "
    "tables, its speed with the older revision, in turns. Here it judged identical code, which "
    "should never be red, and "
    "code with faults planted in it, which always should. Loaded: with a busy loop on all cores but "
    "one. A fault counts "
    "as found when a red line names the method and the measure. "
    "What is wanted *not seen* is smaller than the gate's limits and planted to show them."
)


#: wanted of what lies within the gate's limits: told, not counted
UNSEEN = "not seen"


def rates(frame: pd.DataFrame) -> tuple[int, int, int, int]:
    """False alarms, judgements of identical code, faults found, faults planted."""
    alarms, faults = frame[frame["wanted"] == "none"], frame[~frame["wanted"].isin(["none", UNSEEN])]
    return tuple(
        int(v) for v in (alarms["red"].sum(), alarms["runs"].sum(), faults["red"].sum(), faults["runs"].sum())
    )  # type: ignore[return-value]


def part_view(frame: pd.DataFrame, part: str) -> View:
    mine = frame[frame["part"] == part].sort_values("wanted", key=lambda w: w != "none", kind="stable")
    alarms, judged, found, planted = rates(mine)
    rows = []
    for _, r in mine.iterrows():
        good = r["red"] == 0 if r["wanted"] in ("none", UNSEEN) else r["red"] == r["runs"]
        rows.append((
            word(r["planted"]), word(r["condition"]), word(r["wanted"]), number(r["runs"], count),
            number(r["red"], count, None if good else Mark.exception), number(r["seconds"], duration),
            word(r["example"]),
        ))  # fmt: skip
    heads = (
        *(Head(label, words=True) for label in ("planted", "condition", "wanted red")), Head("judged"), Head("red"),
        Head("a run took"), Head("for example", words=True),
    )  # fmt: skip
    meaning = f"**{alarms} false alarms in {judged} judgements; {found} of {planted} planted faults found.**"
    return View(f"gate_{part}", upper(part), meaning, heads, tuple(rows), "gate_selfcheck.csv")


def findings(frames: Frames) -> list[Finding]:
    frame = frames["gate_selfcheck"]
    if not len(frame):
        return []
    alarms, judged, found, planted = rates(frame)
    sentence = (
        f"{alarms} false alarms in {judged} judgements of identical code; {found} of {planted} "
        "planted faults found."
    )
    unseen = frame.loc[frame["wanted"] == UNSEEN, "planted"]
    if len(unseen):
        sentence += f" It does not see: {', '.join(unseen)}."
    missed = frame[~frame["wanted"].isin(["none", UNSEEN]) & (frame["red"] < frame["runs"])]
    exceptions = tuple(
        f"{r['part']}, {r['planted']} ({r['condition']}): {r['red']} of {r['runs']} found"
        for _, r in missed.iterrows()
    )
    return [Finding("gate", "The regression gate", sentence, f"{len(frame)} conditions", exceptions)]


def sections(frames: Frames) -> list[Part]:
    frame = frames["gate_selfcheck"]
    return [Text(ABOUT), *(part_view(frame, part) for part in dict.fromkeys(frame["part"]))]


ROOMS.add(
    Room("gate_selfcheck", "The regression gate, checked", "its false-alarm rate and its sensitivity", 80,
         ("gate_selfcheck",), sections, findings, tab="Gate")
)  # fmt: skip
