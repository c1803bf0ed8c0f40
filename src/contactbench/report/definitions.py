"""The scenes and methods of the tables as they were when the tables were made."""

from __future__ import annotations

import pandas as pd

from contactbench.report.chapters import CHAPTERS, Chapter, Frames, Part
from contactbench.report.views import View

LEGEND = "Declared, and a digest of what it does, in 50-digit arithmetic: the same on every machine."


def definitions_view(frame: pd.DataFrame, kind: str) -> View:
    """Return the rows that name a scene, or a method."""
    own = frame[frame[kind].fillna("") != ""]
    code = {name: "`" + own[name] + "`" for name in ("digest", "declared")}
    table = pd.DataFrame({kind: own[kind], **code})
    return View(f"defined_{kind}s", f"{kind.capitalize()}s", table, LEGEND, "definitions.csv")


def parts(frames: Frames) -> list[Part]:
    return [definitions_view(frames["definitions"], kind) for kind in ("scene", "method")]


QUESTION = "What was every scene and method when the tables were made?"
CHAPTERS.add(Chapter("definitions", "Definitions", QUESTION, 85, ("definitions",), parts))
