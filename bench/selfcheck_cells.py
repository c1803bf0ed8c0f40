"""Cells of the experiments, run one after another with faults planted: ``python selfcheck_cells.py JOB.json``.

A job is a list of ``[folder, call, cells]``: the tables go into the folder, `call` plants a fault by a plug-in
(`planted_faults.plugin`; empty: none), and a cell is ``[experiment, cell]`` of bench/, such as
``["convergence", ["particle", "rk4"]]``.  What one fault has registered is gone before the next.
"""

from __future__ import annotations

import importlib
import inspect
import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import contactbench as cb
from contactbench import plugins
from contactbench.errors import Registry
from contactbench.results.provenance import environment, save_run
from contactbench.results.schema import TABLES
from contactbench.results.store import merge
from planted_faults import plugin

Rows = dict[str, list[dict[str, Any]]]


@contextmanager
def planted(call: str, path: Path) -> Iterator[None]:
    """What a plug-in file at `path` registers, for as long as the block lasts."""
    whole = [(registry, dict(registry)) for registry in Registry.every]
    loaded, named = dict(plugins.LOADED), os.environ.get(plugins.VARIABLE, "")
    if call:
        plugins.load_file(plugin(path, call))
    try:
        yield
    finally:
        for registry, kept in whole:
            registry.clear()
            registry.update(kept)
        plugins.LOADED.clear()
        plugins.LOADED.update(loaded)
        os.environ[plugins.VARIABLE] = named


def rows_of(experiment: str, cell: tuple[Any, ...]) -> Rows:
    """The rows of a cell of the smoke profile by table; none where the experiment no longer has it."""
    from conftest import PROFILES

    profile, found = PROFILES["smoke"], {}
    test = getattr(importlib.import_module(f"bench_{experiment}"), f"test_{experiment}")
    if cell not in test.cells(profile):
        return {}

    def record(table: Any, **row: Any) -> None:
        family = {"family": cb.METHODS[row["method"]].family} if "family" in table.columns else {}
        found.setdefault(table.name, []).append({**family, **row, "profile": profile.name})

    given = {"cell": cell, "record": record, "profile": profile}
    with suppress(AssertionError):  # a cell that fails keeps its rows, as in a run of the benchmark
        test(**{name: given[name] for name in inspect.signature(test).parameters})
    return found


def run(folder: Path, call: str, cells: list[Any]) -> None:
    """The tables of cells in a folder, with a fault planted."""
    with planted(call, folder.with_suffix(".py")):
        rows: Rows = {}
        for experiment, cell in cells:
            for name, more in rows_of(experiment, tuple(cell)).items():
                rows.setdefault(name, []).extend(more)
        for name, made in rows.items():
            merge(TABLES[name], made, folder)
        save_run("selfcheck", environment("smoke", 0), list(rows), list(rows), folder)


if __name__ == "__main__":
    for where, call, cells in json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")):
        run(Path(where), call, cells)
