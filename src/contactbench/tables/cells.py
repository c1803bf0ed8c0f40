"""Keep finished cells of the benchmark as files in ``results/.cells/PROFILE`` and merge them into the tables.

A merge rewrites the tables under a lock and then renames the files it has read.  Merging a file twice is harmless, so a
killed process loses nothing.  The files stay and record which cells are done.  When all cells of a run are done, rows
that none of them made are dropped, since their benchmark no longer exists.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock

from contactbench.errors import BadInput
from contactbench.files import replacing
from contactbench.tables.provenance import save_run
from contactbench.tables.schema import PROFILES, TABLES, Row, Table
from contactbench.tables.store import check, keys, merge, note, read

FOLDER = ".cells"
#: endings of files: a cell not merged yet, a merged cell, and the time at which a selection was last begun
NEW, DONE, BEGUN = ".new", ".done", ".begun"

type Cell = tuple[str, str]  #: file of an experiment, name of its cell
type Rows = list[tuple[str, Row]]  #: name of the table, row


@dataclass(frozen=True)
class Entry:
    """Hold the rows of a cell in a file; cell : None if the cell failed and is not done."""

    path: Path
    run: str
    cell: Cell | None
    rows: Rows


class DiskFull(BadInput):
    """Report a full disk; cells finished before are kept."""


@contextlib.contextmanager
def disk() -> Iterator[None]:
    """Raise `DiskFull` in place of any `OSError` of the block."""
    try:
        yield
    except OSError as error:
        where = f"{error.strerror} ({error.filename})" if error.filename else error.strerror
        raise DiskFull(f"{where}: finished cells are kept; make room, then --resume") from None


class Cells:
    """Manage the cells of a run, finished by one or several processes, and of earlier runs.

    A cell is done if it was finished after a run with the same selection (empty: all cells) last began anew.
    """

    def __init__(self, results: Path, profile: str, run: str, selection: str = "") -> None:
        self.results, self.profile, self.run, self.selection = results, profile, run, selection
        self.folder = results / FOLDER / profile
        self.mark = self.folder / f"{_digest(selection)}{BEGUN}"

    # -- one cell ----------------------------------------------------------------------------------
    @disk()
    def save(self, rows: Iterable[tuple[Table, Row]], cell: Cell, finished: bool = True) -> None:
        """Save the rows of a cell; after that a kill cannot lose them, but a power failure can."""
        named = [[table.name, dict(row)] for table, row in rows]
        entry = {"run": self.run, "cell": cell if finished else None, "rows": named}
        with replacing(self.folder / f"{_digest(*cell)}-{self.run}{NEW}", sync=False) as file:
            json.dump(entry, file, default=np.generic.item)

    def rows(self, cell: Cell) -> Rows | None:
        for name in (f"{_digest(*cell)}-{self.run}{NEW}", f"{_digest(*cell)}{DONE}"):
            path = self.folder / name
            if path.exists() and path.stat().st_mtime >= self._begun() and (entry := _read(path)):
                return entry.rows
        return None

    # -- all of them -------------------------------------------------------------------------------
    def begin(self, record: Row) -> None:
        """Save the record of the run, and merge cells left by killed runs."""
        with replacing(self._record(self.run)) as file:
            json.dump(record, file)
        self.merge()

    @disk()
    def begin_anew(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        self.mark.touch()

    def done(self) -> dict[Cell, Rows]:
        files = (path for path in self.folder.glob(f"*{DONE}") if path.stat().st_mtime >= self._begun())
        return {entry.cell: entry.rows for entry in map(_read, files) if entry and entry.cell}

    @disk()
    def merge(self, expected: Iterable[Cell] = (), others: Collection[str] = ()) -> None:
        """Merge all new cells of any run into the tables.

        expected : all cells of a whole run.  others : scenes and methods whose rows stay as they are.
        """
        (self.results / FOLDER).mkdir(parents=True, exist_ok=True)
        with FileLock(self.results / FOLDER / "lock"):
            paths = sorted((self.results / FOLDER).glob(f"*/*{NEW}"), key=lambda path: path.stat().st_mtime)
            entries = [entry for entry in map(_read, paths) if entry and _fits(entry)]
            rows = _by_table(entry.rows for entry in entries)
            whole = self._whole(set(expected), entries)
            profiles = PROFILES[: PROFILES.index(self.profile) + 1]
            for name in [each for each in TABLES if each in rows or each in whole]:
                made = keys(TABLES[name], whole[name]) if name in whole else None
                merge(TABLES[name], rows.get(name, ()), self.results, made, profiles, others)
            for run in sorted({entry.run for entry in entries} | {self.run}):
                if known := _load(self._record(run)):
                    made_by = {name for entry in entries if entry.run == run for name, _ in entry.rows}
                    # rows of a larger profile stay, and with them the run that made them
                    alone = [name for name in whole if not others and self._all_of(name, profiles)]
                    save_run(run, known, made_by, alone if run == self.run else (), self.results)
            for entry in entries:
                if entry.cell:
                    os.replace(entry.path, entry.path.with_name(f"{_digest(*entry.cell)}{DONE}"))
                else:
                    entry.path.unlink()

    def _all_of(self, name: str, profiles: Sequence[str]) -> bool:
        frame = read(TABLES[name], self.results)
        return bool(frame["profile"].isin(profiles).all()) if "profile" in frame else "standard" in profiles

    def _whole(self, expected: set[Cell], entries: Iterable[Entry]) -> dict[str, list[Row]]:
        done = self.done() if expected else {}
        done |= {e.cell: e.rows for e in entries if e.cell and e.path.parent == self.folder}
        # several experiments may make rows of one table
        return _by_table(done[cell] for cell in expected) if expected <= done.keys() else {}

    def _record(self, run: str) -> Path:
        return self.results / FOLDER / f"{run}.json"

    def _begun(self) -> float:
        return self.mark.stat().st_mtime if self.mark.exists() else 0.0


def _by_table(cells: Iterable[Rows]) -> dict[str, list[Row]]:
    found: dict[str, list[Row]] = {}
    for name, row in (each for rows in cells for each in rows):
        found.setdefault(name, []).append(row)
    return found


def _fits(entry: Entry) -> bool:
    """Return whether the tables accept the rows; rows of another version or an absent plug-in are left out."""
    try:
        for name, row in entry.rows:
            check(TABLES[name], row)
    except BadInput as error:
        note(f"{entry.path}: {error}; left out")
        return False
    return True


def _digest(*names: str) -> str:
    return hashlib.sha256("\n".join(names).encode()).hexdigest()[:24]


def _read(path: Path) -> Entry | None:
    """Return the contents of a file, or None if it is damaged, so that its cell runs again."""
    match _load(path):
        case {"run": str(run), "cell": None | [str(), str()] as cell, "rows": list(rows)}:
            return Entry(path, run, (cell[0], cell[1]) if cell else None, rows)
    return None


def _load(path: Path) -> Any:
    with contextlib.suppress(ValueError, OSError):
        return json.loads(path.read_text(encoding="utf-8"))
