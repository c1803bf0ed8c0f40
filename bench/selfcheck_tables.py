"""The self-check of what the gate does with tables: doctored ones, and the record of the runs behind them.

The committed tables are base, head and, as far as the smoke profile makes them, the fresh run; then one or two of
these are doctored.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Lock
from time import perf_counter

import pandas as pd

from contactbench.gate import judge, revisions
from contactbench.results.provenance import environment, save_run
from contactbench.results.schema import TABLES
from contactbench.results.store import read, write
from selfcheck_faults import AS_IT_WAS, ROOT, Judgement, Task, said

BASE, HEAD, FRESH = "base", "head", "fresh"
MINE = "contact-strang"
#: what is looked at, of every kind a table
TABLES_USED = ("laws", "convergence", "stability", "claims")


@dataclass(frozen=True)
class Doctored:
    """What is done to the folders named, and the table and measure of the line that must give it away."""

    what: str
    to: tuple[str, ...]
    change: Callable[[Path], None]
    measure: str
    table: str = ""


def rewritten(name: str, change: Callable[[pd.DataFrame], pd.DataFrame]) -> Callable[[Path], None]:
    """A table of a folder changed."""
    return lambda folder: write(change(read(TABLES[name], folder)), TABLES[name], folder)


def of(frame: pd.DataFrame, method: str = MINE) -> pd.Series:
    return (frame["scene"] == "particle") & (frame["method"] == method)


def stub(folder: Path) -> None:
    """A record that says nothing but which profile made which table."""
    path = folder / "environment.json"
    record = json.loads(path.read_text(encoding="utf-8"))
    runs = [{name: run[name] for name in ("run", "profile", "tables")} for run in record["runs"]]
    path.write_text(json.dumps(record | {"runs": runs}), encoding="utf-8")


def older_commit(folder: Path) -> None:
    path = folder / "environment.json"
    record = json.loads(path.read_text(encoding="utf-8"))
    for run in record["runs"]:
        run["commit"] = "0" * 40
    path.write_text(json.dumps(record), encoding="utf-8")


DOCTORED = (
    Doctored(
        "a table removed", (HEAD,), lambda folder: (folder / "laws.csv").unlink(), "committed table laws", "laws"
    ),
    Doctored(
        "profile edited from smoke to full", (HEAD,),
        rewritten("laws", lambda f: f.assign(profile=f["profile"].replace("smoke", "full"))),
        "committed profile", "laws",
    ),
    Doctored(
        "profiles blanked", (HEAD,), rewritten("laws", lambda f: f.assign(profile="")), "committed profile", "laws",
    ),
    Doctored(
        "the same rows dropped on both sides", (HEAD, FRESH), rewritten("convergence", lambda f: f[~of(f)]),
        "committed row of convergence", "convergence",
    ),
    Doctored(
        "both sides set to one broken value", (HEAD, FRESH),
        rewritten("convergence", lambda f: f.assign(solution_error=f["solution_error"].mask(of(f), 1.0))),
        "committed solution_error", "convergence",
    ),
    Doctored("environment.json reduced to a stub", (HEAD,), stub, "record of the runs"),
    Doctored("a fresh run of another commit", (FRESH,), older_commit, "commit of the fresh run"),
    Doctored(
        "a dropped row: a setting is gone", (FRESH,),
        rewritten("convergence", lambda f: f[~(of(f) & (f["step"] == f.loc[of(f), "step"].min()))]),
        "row of convergence", "convergence",
    ),
    Doctored(
        "a dropped table", (FRESH,), lambda folder: (folder / "stability.csv").unlink(), "table stability", "stability"
    ),
)  # fmt: skip


class Folders:
    """Base, head and fresh run as copies of the committed tables, made when they are first asked for."""

    def __init__(self, results: Path, scratch: Path) -> None:
        self.results, self.scratch, self.lock = results, scratch / "tables", Lock()

    def whole(self, name: str) -> Path:
        with self.lock:
            folder = self.scratch / name
            if folder.exists():
                return folder
            folder.mkdir(parents=True)
            frames = {one: read(TABLES[one], self.results) for one in TABLES_USED}
            if name == FRESH:
                frames = {one: frame[frame["profile"] == "smoke"] for one, frame in frames.items()}
            for one, frame in frames.items():
                write(frame, TABLES[one], folder)
            save_run(
                name,
                environment("smoke" if name == FRESH else "standard", 0),
                TABLES_USED,
                TABLES_USED,
                folder,
            )
            return folder

    def judged(self, change: Callable[[Path], None] | None, to: tuple[str, ...], name: str) -> list:
        """The red lines with a change made to copies of some of the folders."""
        at = {side: self.whole(side) for side in (BASE, HEAD, FRESH)}
        for side in to:
            at[side] = Path(shutil.copytree(at[side], self.scratch / name / side))
            change(at[side])
        question = judge.Question(ROOT, fresh=at[FRESH])
        commit = revisions.commit_of(ROOT, "HEAD")
        verdict = judge.tables_against(question, ROOT, commit, at[HEAD], at[BASE], self.scratch / "none")
        return [line for line in verdict.lines if line.red]


def unchanged(folders: Folders) -> list[Judgement]:
    start = perf_counter()
    lines = folders.judged(None, (), "nothing")
    words, taken = said(lines[0]) if lines else "", perf_counter() - start
    return [
        Judgement("accuracy", "nothing in the committed tables", AS_IT_WAS, "none", bool(lines), words, taken)
    ]


def doctored(one: Doctored, folders: Folders, name: str) -> list[Judgement]:
    start = perf_counter()
    lines = [
        line
        for line in folders.judged(one.change, one.to, name)
        if (line.measure, line.table) == (one.measure, one.table)
    ]
    words, taken = said(lines[0]) if lines else "", perf_counter() - start
    return [Judgement("accuracy", one.what, AS_IT_WAS, "all", bool(lines), words, taken)]


def tasks(results: Path, scratch: Path) -> list[Task]:
    folders = Folders(results, scratch)
    return [
        Task("committed tables", 3, partial(unchanged, folders)),
        *(
            Task(one.what, 3, partial(doctored, one, folders, f"doctored-{k}"))
            for k, one in enumerate(DOCTORED)
        ),
    ]
