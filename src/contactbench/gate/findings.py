"""What the gate found: one table of what moved, as JSON and as a document."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Any

import pandas as pd

#: what a row of the table has where nothing else is given; rows : of how many values it is the worst
BLANK: dict[str, Any] = dict.fromkeys(("table", "scene", "method", "engine", "setting", "measure"), "")
BLANK |= {"before": "", "after": "", "result": "", "red": True, "rows": 1}
INCONCLUSIVE = "inconclusive"


def rows_of(*rows: dict[str, Any]) -> pd.DataFrame:
    """Return a table of what moved from its rows, blanks filled in."""
    return pd.DataFrame([{**BLANK, **row} for row in rows], columns=[*BLANK])


@dataclass(frozen=True)
class Findings:
    """What the gate found.

    moved : a row for each measure of a method on a scene.  compared : one sentence a part.  notes : what to know
    beside.  incomplete : why what was looked at is too little to decide.
    """

    moved: pd.DataFrame = field(default_factory=rows_of)
    compared: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    incomplete: tuple[str, ...] = ()

    def __add__(self, other: Findings) -> Findings:
        moved = [part for part in (self.moved, other.moved) if len(part)] or [self.moved]
        texts = self.compared + other.compared, self.notes + other.notes, self.incomplete + other.incomplete
        return Findings(pd.concat(moved, ignore_index=True), *texts)

    @property
    def red(self) -> int:
        """How many rows are red."""
        return int(self.moved["red"].sum())

    @property
    def status(self) -> int:
        """The exit status: 1 red, 2 inconclusive as a whole, 0 green."""
        return 1 if self.red else 2 if self.incomplete else 0

    def as_json(self) -> str:
        found = {"status": self.status, "red": bool(self.red), "lines": self.moved.to_dict("records")}
        found |= {"compared": self.compared, "notes": self.notes, "incomplete": self.incomplete}
        return json.dumps(found, allow_nan=False, ensure_ascii=False)

    def as_markdown(self) -> str:
        """Return the outcome, the table of what moved with the red rows first, and the notes."""
        outcome = ("green", f"red, {self.red} found", INCONCLUSIVE)[self.status]
        rows = self.moved.sort_values("red", ascending=False, kind="stable")
        cells = rows.drop(columns="red").astype(str).map(escape)
        cells["result"] = cells["result"].mask(rows["red"], "**" + cells["result"] + "**")
        texts = "\n".join(f"- {escape(text)}" for text in (*self.compared, *self.incomplete, *self.notes))
        lines = [cells.columns, ["---"] * cells.shape[1], *cells.to_numpy()] if len(cells) else []
        grid = "\n".join(f"| {' | '.join(line)} |" for line in lines) or "Nothing moved."
        return f"# Regression gate: {outcome}\n\n{texts}\n\n{grid}\n"


def escape(text: str) -> str:
    """Return text that stays within its cell of a markdown table."""
    return " ".join(text.replace("|", "\\|").replace("<", "&lt;").split())
