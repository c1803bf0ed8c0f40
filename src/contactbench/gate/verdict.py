"""What the gate found, as data, as JSON and as a document."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass

from contactbench.report.markdown import escaped, grid
from contactbench.report.numbers import DASH

#: lines that are not red listed at most
LISTED = 20
HEAD = ("scene", "method", "measure", "engine", "setting", "before", "after", "change", "verdict")


@dataclass(frozen=True)
class Line:
    """One thing that moved: a measure of a method on a scene, the worst of `rows` rows of a table."""

    measure: str
    before: str
    after: str
    change: str
    verdict: str
    red: bool
    scene: str = ""
    method: str = ""
    engine: str = ""
    setting: str = ""
    table: str = ""
    rows: int = 1

    def cells(self) -> list[str]:
        """What a row of the document says, in the order of `HEAD`."""
        setting = self.setting + (f" (worst of {self.rows})" if self.rows > 1 else "")
        free = [
            self.scene or DASH, self.method or DASH, self.measure, self.engine or DASH, setting,
            self.before, self.after, self.change,
        ]  # fmt: skip
        return [*map(escaped, free), f"**{self.verdict}**" if self.red else self.verdict]


@dataclass(frozen=True)
class Verdict:
    """What the gate found: the lines, what was compared (one sentence a part), and what to know beside.

    judged : how many calls were timed.  incomplete : why what was looked at is too little for a verdict.
    """

    lines: tuple[Line, ...] = ()
    compared: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    judged: int = 0
    incomplete: tuple[str, ...] = ()

    @property
    def status(self) -> int:
        """The exit status: 1 red, 2 inconclusive as a whole, 0 green."""
        return 1 if self.red else 2 if self.incomplete else 0

    @property
    def red(self) -> bool:
        return any(line.red for line in self.lines)

    @property
    def undecided(self) -> int:
        """Lines that are neither red nor cleared."""
        return sum(line.verdict == "inconclusive" for line in self.lines)

    def __add__(self, other: Verdict) -> Verdict:
        notes = dict.fromkeys((*self.notes, *other.notes))
        compared = self.compared + other.compared
        incomplete = self.incomplete + other.incomplete
        return Verdict(
            self.lines + other.lines, compared, tuple(notes), self.judged + other.judged, incomplete
        )

    def as_json(self) -> str:
        found = {"red": self.red, "inconclusive": self.undecided, **asdict(self)}
        return json.dumps(found, allow_nan=False, ensure_ascii=False)

    def title(self) -> str:
        """Red, inconclusive as a whole, green, or green but for what could not be decided."""
        red = sum(line.red for line in self.lines)
        if red:
            return f"red, {red} found" + (f", {self.undecided} inconclusive" if self.undecided else "")
        if self.incomplete:
            return f"inconclusive: {'; '.join(self.incomplete)}"
        return f"green, but {self.undecided} inconclusive" if self.undecided else "green"

    def as_markdown(self) -> str:
        """The verdict, one table of what moved and by how much, and the notes."""
        red = sum(line.red for line in self.lines)
        most = max(red + self.undecided, LISTED)
        listed = sorted(self.lines, key=lambda line: (not line.red, line.verdict != "inconclusive"))
        rows = [line.cells() for line in listed[:most]]
        parts = [f"# Regression gate: {self.title()}", "\n".join(f"- {said}" for said in self.compared)]
        parts += [grid(HEAD, rows)] if rows else ["Nothing moved."]
        parts += [f"{len(listed) - most} more moved within their limits."] if len(listed) > most else []
        parts += ["\n".join(f"- {escaped(note)}" for note in self.notes)] if self.notes else []
        return "\n\n".join(parts) + "\n"
