"""The committed tables against those of the base revision: what a change does to the baseline itself.

A fresh run is compared with the tables of the base revision, read through git, so that no edit of the tree
that is judged can move its own goal.  A change that means to change tables says so, in the message of one
of its commits,

    Tables-changed: laws, convergence

or with ``--tables-changed``; ``all`` names every table.  Tables that are named are judged by what the tree
has, and the verdict lists what became of them, for a reviewer to see.  What else differs is red: a row, a
scene, a method or a table that is gone, and a number that moved further than its rule allows.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from contactbench.errors import BadInput
from contactbench.gate.accuracy import beyond, compare
from contactbench.gate.verdict import Line
from contactbench.results import provenance
from contactbench.results.schema import PROFILES, TABLES, Table
from contactbench.results.store import OldTable, index, read

TRAILER = re.compile(r"^Tables-changed:(.*)$", re.MULTILINE | re.IGNORECASE)
ALL = "all"
#: what the record of a run has that says on what it was made
SAID = ("cpu", "python", "packages", "references", "commit", "utc", "tables")


def listed(messages: str, option: Iterable[str] = (), results: Path | None = None) -> set[str]:
    """The tables that a change says it changes; `results` may have new ones.  Raises `BadInput` for other names."""
    named = {
        name
        for part in (*TRAILER.findall(messages), *option)
        for name in re.split(r"[\s,]+", part.strip())
        if name
    }
    new = {path.stem for path in results.glob("*.csv")} if results else set()
    unknown = sorted(named - {ALL, *TABLES} - new)
    if unknown:
        raise BadInput(f"tables changed: {', '.join(unknown)}: no such table; {', '.join(TABLES)} or {ALL}")
    return set(TABLES) if ALL in named else named


def readable(folder: Path, changed: set[str]) -> tuple[dict[str, pd.DataFrame], list[Line]]:
    """The tables of a folder, and a line for each whose columns mean something else than here.

    Those of a listed table may be of another version: they are not compared.
    """
    frames, lines = {}, []
    for name, table in TABLES.items():
        try:
            frames[name] = read(table, folder)
        except OldTable:
            frames[name] = read(table, folder / "none")
            if name not in changed:
                words = (f"version of {name}", "another", str(table.version), "", "not listed")
                lines.append(Line(*words, red=True, table=name))
    return frames, lines


def differences(table: Table, before: pd.DataFrame, after: pd.DataFrame, changed: bool) -> list[Line]:
    """What the tree's table lacks of the base's, and what moved too far in it; nothing if that is listed."""
    if changed:
        return []
    words = {"missing": "gone, not listed", "moved": "changed, not listed"}
    lines = (line for line in compare(table, before, after) if line.red)
    return [replace(line, measure=f"committed {line.measure}", verdict=words[line.verdict]) for line in lines]


def described(table: Table, before: pd.DataFrame, after: pd.DataFrame) -> str:
    """What became of a table in a few words; empty where its rows are what they were."""
    if before.equals(after):
        return ""
    gone, new = beyond(table, after, before), beyond(table, before, after)
    kept = before[index(before, list(table.key)).isin(index(after, list(table.key)))]
    moved = [line for line in compare(table, kept, after) if line.red]
    parts = [f"{gone} rows gone" if gone else "", f"{new} new" if new else ""]
    parts += [f"{name} gone" for name in lost(table, before, after)]
    for line in moved[:3]:
        where = " ".join(filter(None, (line.scene, line.method)))
        parts.append(f"{line.measure} of {where or line.setting} {line.before} → {line.after}")
    parts += [f"{len(moved) - 3} more beyond their limits"] if len(moved) > 3 else []
    return f"{table.name} ({'; '.join(filter(None, parts)) or 'numbers within their limits'})"


def lost(table: Table, before: pd.DataFrame, after: pd.DataFrame) -> list[str]:
    """The scenes and methods that no row has any more."""
    names = [name for name in ("scene", "method") if name in table.columns]
    return [f"{name} {value}" for name in names for value in sorted(set(before[name]) - set(after[name]))]


def taken_out(table: Table, before: pd.DataFrame, head: pd.DataFrame, fresh: pd.DataFrame) -> list[Line]:
    """Rows of the base that the tree's table lacks although its code still makes them: red even if listed."""
    key = list(table.key)
    made = before[index(before, key).isin(index(fresh, key))]
    out = made[~index(made, key).isin(index(head, key))]
    if not len(out):
        return []
    line = Line(
        f"rows of {table.name}", f"{len(out)} rows", "none", "", "taken out, but still made", red=True
    )
    return [replace(line, table=table.name)]


# -- records ---------------------------------------------------------------------------------------
def record_lines(results: Path, frames: dict[str, pd.DataFrame]) -> list[Line]:
    """Red where environment.json does not say where, when and with what the tables were made."""
    runs = provenance.runs(results)
    found = [
        f"{run.get('run', 'a run')} without {name}" for run in runs for name in SAID if not run.get(name)
    ]
    found += [f"{run.get('run', 'a run')} of profile {run['profile']!r}" for run in runs if not known(run)]
    made = {name for run in runs for name in run["tables"]}
    found += [f"no run made {name}" for name, frame in frames.items() if len(frame) and name not in made]
    words = ("record of the runs", "complete", "; ".join(found[:4]), "", "damaged")
    return [Line(*words, red=True, setting="environment.json", rows=len(found))] if found else []


def known(run: dict[str, Any]) -> bool:
    """Whether the profile of a run is one."""
    return run["profile"] in PROFILES


def commit_lines(results: Path, head: str, clean: bool) -> list[Line]:
    """Red where a fresh run was not made by the code that is judged."""
    lines = []
    for run in provenance.runs(results):
        made, wanted = str(run.get("commit", "")), head
        if made != wanted:
            words = ("commit of the fresh run", wanted[:12], made[:12] or "none", "", "another commit")
            lines.append(Line(*words, red=True))
        elif clean and run.get("dirty"):
            words = ("commit of the fresh run", f"{wanted[:12]}", "with local changes", "", "another tree")
            lines.append(Line(*words, red=True))
    return lines[:1]
