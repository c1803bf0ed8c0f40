"""What the scenes and methods of the tables were when the tables were made."""

from __future__ import annotations

import pandas as pd

from contactbench.report.cells import Head, View, word
from contactbench.report.rooms import ROOMS, Frames, Part, Room, Text

ABOUT = (
    "What every scene and every method declared when the tables were made, and a digest of what it does: of a scene's "
    "functions at a few points, of a method's first steps, in 50-digit arithmetic and the same on every machine. "
    "Two runs with the same digest are runs of the same thing; the regression gate compares digests exactly. "
    "A library's solver has no steps to look at: its digest is of what it is asked for, its version is in "
    "`environment.json`."
)


def definitions_view(frame: pd.DataFrame, kind: str) -> View:
    """The rows that name a scene, or a method."""
    mine = frame[frame[kind].fillna("") != ""]
    rows = tuple(
        (word(r[kind]), word(f"`{r['digest']}`"), word(f"`{r['declared']}`")) for _, r in mine.iterrows()
    )
    heads = (Head(kind, words=True), Head("digest", words=True), Head("declared", words=True))
    return View(f"defined_{kind}s", f"{kind.capitalize()}s", "", heads, rows, "definitions.csv")


def sections(frames: Frames) -> list[Part]:
    frame = frames["definitions"]
    return [Text(ABOUT), *(definitions_view(frame, kind) for kind in ("scene", "method"))]


ROOMS.add(
    Room("definitions", "Definitions", "what every scene and method was when the tables were made", 85,
         ("definitions",), sections)
)  # fmt: skip
