"""What a run has made so far: safe from kills, and from other runs into the same folder.

Every process of a run appends to a file of its own in ``results/.journal/RUN``, one line per finished
cell with all of its rows, so that a cell is there as a whole or not at all.  Folding merges the rows
into the CSV tables under a lock and notes which cells are done and the keys of their rows; the lines go
only after that, and folding them twice does no harm.  A run holds a lock while it lives: what a dead run
left behind is folded by the next one.

Once all cells of an experiment are done, the rows of its tables that none of them has made are removed:
their benchmark no longer exists.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import pandas as pd
from filelock import FileLock, Timeout

from contactbench.results.provenance import save_run
from contactbench.results.schema import PROFILES, TABLES, Table
from contactbench.results.store import forget, index, keys, merge, read, replacing

Cell = tuple[str, ...]  #: the file of an experiment and the name of one of its cells
Made = dict[Cell, dict[str, list[list[Any]]]]  #: for each cell that is done, table → keys of its rows
FOLDER = ".journal"
#: how often a journal is forced to disk, at most
SYNC_SECONDS = 1.0


class Journal:
    """The journal of one run, written to by one or several processes.

    record : where and with what the run is made (`provenance.environment`); its "profile" says which cells
    count as done for `--resume`.
    """

    def __init__(self, results: Path, run_id: str) -> None:
        self.results, self.run_id = results, run_id
        self.folder = results / FOLDER / run_id
        self.alive = FileLock(self.folder / "alive")
        self.synced = -math.inf

    def open(self, record: Mapping[str, Any]) -> None:
        """Begin the run."""
        self.folder.mkdir(parents=True, exist_ok=True)
        self.alive.acquire()
        with replacing(self.folder / "run.json") as file:
            json.dump(record, file)

    def append(self, rows: Iterable[tuple[Table, Mapping[str, Any]]], cell: Cell | None = None) -> None:
        """Add the rows of a cell, which no kill takes away when this returns; without a cell, rows of one that failed.

        A failure of power may take the last `SYNC_SECONDS`: waiting for the disk costs more than a short cell.
        """
        entry = {"cell": cell, "rows": [[table.name, dict(row)] for table, row in rows]}
        with (self.folder / f"{os.getpid()}.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps(entry, default=_plain) + "\n")
            file.flush()
            if monotonic() - self.synced > SYNC_SECONDS:
                os.fsync(file.fileno())
                self.synced = monotonic()

    def expect(self, cells: Iterable[Cell]) -> None:
        """All cells of the experiments that are run as a whole."""
        with replacing(self.folder / "expected.json") as file:
            json.dump(sorted(set(cells)), file)

    def close(self) -> None:
        """Fold the run into the tables and end it."""
        with folding(self.results):
            _fold(self.folder)
        self.alive.release()
        shutil.rmtree(self.folder)


@contextlib.contextmanager
def folding(results: Path) -> Iterator[None]:
    """One process at a time changes the tables."""
    (results / FOLDER).mkdir(parents=True, exist_ok=True)
    with FileLock(results / FOLDER / "folding"):
        yield


def fold_dead_runs(results: Path) -> None:
    """Merge what killed runs left behind: good rows, every one."""
    with folding(results):
        for folder in sorted(path for path in (results / FOLDER).iterdir() if path.is_dir()):
            lock = FileLock(folder / "alive")
            try:
                lock.acquire(blocking=False)
            except Timeout:
                continue  # it lives
            _fold(folder)
            lock.release()
            shutil.rmtree(folder)


def entries(folder: Path) -> Iterator[dict[str, Any]]:
    """The finished lines of a run; one cut short by a kill does not count."""
    for path in sorted(folder.glob("*.jsonl")):
        for line in path.read_text(encoding="utf-8").split("\n"):
            with contextlib.suppress(json.JSONDecodeError):
                yield json.loads(line)


def _fold(folder: Path) -> None:
    results = folder.parents[1]
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in TABLES}
    lines = list(entries(folder))
    for entry in lines:
        for name, row in entry["rows"]:
            rows[name].append(row)
    known_by = {name: iter(keys(TABLES[name], each)) for name, each in rows.items()}
    made: Made = {}
    for entry in lines:
        mine: dict[str, set[tuple[Any, ...]]] = {}
        for name, _ in entry["rows"]:
            mine.setdefault(name, set()).add(next(known_by[name]))
        if entry["cell"]:
            made[tuple(entry["cell"])] = {name: sorted(map(list, those)) for name, those in mine.items()}
    run = folder / "run.json"
    if not run.exists():  # killed before it began
        return
    record = json.loads(run.read_text(encoding="utf-8"))
    profile = record["profile"]
    for name, new in rows.items():
        if new:
            merge(TABLES[name], new, results)
    whole = _whole(folder, _done(results, profile) | made)
    profiles = PROFILES[: PROFILES.index(profile) + 1]
    for name, known in whole.items():
        forget(TABLES[name], known, profiles, results)
    # rows of a larger profile stay, and with them the run that made them
    alone = [name for name in whole if read(TABLES[name], results)["profile"].isin(profiles).all()]
    save_run(folder.name, record, [name for name in rows if rows[name]], alone, results)
    _save_done(results, profile, made)


def _whole(folder: Path, made: Made) -> dict[str, set[tuple[Any, ...]]]:
    """The tables of experiments whose cells are all done, and the keys of all rows those cells made.

    An experiment is a file; every table is made by one file.
    """
    path = folder / "expected.json"
    expected = [tuple(cell) for cell in json.loads(path.read_text(encoding="utf-8"))] if path.exists() else []
    unfinished = {cell[0] for cell in expected if cell not in made}
    tables: dict[str, set[tuple[Any, ...]]] = {}
    for cell in expected:
        if cell[0] not in unfinished:
            for name, known in made[cell].items():
                tables.setdefault(name, set()).update(map(tuple, known))
    return tables


# -- which cells are done ------------------------------------------------------------------------------
def done(results: Path, profile: str, selection: str = "") -> set[Cell]:
    """The cells of a profile that have been folded since a run with this selection last began anew."""
    since = _profile(results, profile)["begun"].get(selection, 0)
    return {tuple(cell) for cell, _, number in _profile(results, profile)["cells"] if number >= since}


def rows_of(table: Table, cells: set[Cell], results: Path, profile: str) -> dict[Cell, dict[str, Any]]:
    """The rows of cells that have made one each, as they stand in the table, without what is blank."""
    made = {cell: known[table.name] for cell, known in _done(results, profile).items() if table.name in known}
    frame = read(table, results)
    rows = dict(zip(index(frame, list(table.key)), frame.to_dict("records"), strict=True))
    return {
        cell: {name: value for name, value in rows[tuple(known[0])].items() if not pd.isna(value)}
        for cell, known in made.items()
        if cell in cells and len(known) == 1
    }


def begin_anew(results: Path, profile: str, cells: Iterable[Cell], selection: str = "") -> None:
    """Cells that are about to be run are not done, whatever an earlier run says.

    selection : what was asked for.  A run in several goes (first what is not timed, then, resumed, what is)
    begins with the first of them: what was done before that is not done for the goes that follow.
    """
    with folding(results):
        state, anew = _profile(results, profile), set(cells)
        state["begun"][selection] = state["number"] = state["number"] + 1
        state["cells"] = [entry for entry in state["cells"] if tuple(entry[0]) not in anew]
        _save(results, profile, state)


def _profile(results: Path, profile: str) -> dict[str, Any]:
    """number : of runs begun anew; begun : selection → its last one; cells : [cell, keys of its rows, number]."""
    path = results / FOLDER / "done.json"
    profiles = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    state = profiles.get(profile)
    # a bare list is of an older version: nothing is known of the rows of its cells
    return state if isinstance(state, dict) else {"number": 0, "begun": {}, "cells": []}


def _done(results: Path, profile: str) -> Made:
    return {tuple(cell): known for cell, known, _ in _profile(results, profile)["cells"]}


def _save_done(results: Path, profile: str, made: Made) -> None:
    """Note cells as done now."""
    state = _profile(results, profile)
    cells = {tuple(cell): [cell, known, number] for cell, known, number in state["cells"]}
    cells |= {cell: [cell, known, state["number"]] for cell, known in made.items()}
    state["cells"] = [cells[cell] for cell in sorted(cells)]
    _save(results, profile, state)


def _save(results: Path, profile: str, state: dict[str, Any]) -> None:
    path = results / FOLDER / "done.json"
    profiles = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    with replacing(path) as file:
        json.dump(profiles | {profile: state}, file)


def _plain(value: Any) -> Any:
    """NumPy scalars and enums as what JSON knows."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{value!r} cannot be put in a table")
