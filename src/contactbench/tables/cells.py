"""Finished cells: a file each in ``results/.cells/PROFILE``, there as a whole or not at all, merged into the tables.

A merge rewrites the tables under a lock and only then renames the files it has read; to merge a file twice does no
harm, so that no kill loses anything.  The files stay, and say which cells are done.  Once all cells of a run
are, rows of the tables that none of them has made are dropped: their benchmark no longer exists.
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
#: of a file that is not merged yet, of one that is, and of the time at which a selection was last begun
NEW, DONE, BEGUN = ".new", ".done", ".begun"

type Cell = tuple[str, str]  #: the file of an experiment and the name of one of its cells
type Rows = list[tuple[str, Row]]  #: each with the name of its table


@dataclass(frozen=True)
class Entry:
    """The rows of a cell in a file; cell : None for rows of one that failed, which is not done."""

    path: Path
    run: str
    cell: Cell | None
    rows: Rows


class DiskFull(BadInput):
    """The disk takes no more; what was finished before is there."""


@contextlib.contextmanager
def disk() -> Iterator[None]:
    """Raise `DiskFull`, in one line, in place of any `OSError` of the body."""
    try:
        yield
    except OSError as error:
        where = f"{error.strerror} ({error.filename})" if error.filename else error.strerror
        raise DiskFull(f"{where}: finished cells are kept; make room, then --resume") from None


class Cells:
    """The cells of one run, which one or several processes finish, and those of the runs before it.

    A cell is done if it was finished since a run with this selection (empty: all) last began anew.
    """

    def __init__(self, results: Path, profile: str, run: str, selection: str = "") -> None:
        self.results, self.profile, self.run, self.selection = results, profile, run, selection
        self.folder = results / FOLDER / profile
        self.mark = self.folder / f"{_digest(selection)}{BEGUN}"

    # -- one cell ----------------------------------------------------------------------------------
    @disk()
    def save(self, rows: Iterable[tuple[Table, Row]], cell: Cell, finished: bool = True) -> None:
        """Keep the rows of a cell: no kill takes them away when this returns (a failure of power may)."""
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
        """Keep where and with what the run is made, and merge what killed runs have left."""
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
        """Put all new cells into the tables, whichever run finished them.

        expected : all cells of a whole run.  others : scenes and methods that it leaves as they are.
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
    """Return whether the tables can take the rows; of another version, or a plug-in not here, they stay aside."""
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
    """Return what a file says; None where it is damaged: its cell is run again."""
    match _load(path):
        case {"run": str(run), "cell": None | [str(), str()] as cell, "rows": list(rows)}:
            return Entry(path, run, (cell[0], cell[1]) if cell else None, rows)
    return None


def _load(path: Path) -> Any:
    with contextlib.suppress(ValueError, OSError):
        return json.loads(path.read_text(encoding="utf-8"))
