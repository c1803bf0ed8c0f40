"""A dozen faults that the gate must find: doctored tables, and methods that are not what they were."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import contactbench as cb
import made_up
import planted_faults
import properties
from contactbench.gate import judge, revisions
from contactbench.results.provenance import environment, save_run
from contactbench.results.schema import TABLES
from contactbench.results.store import read, write
from contactbench.splitting.tables import COMPOSITIONS

ROOT = Path(__file__).parents[2]
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
        self.results, self.scratch = results, scratch / "tables"

    def whole(self, name: str) -> Path:
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


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    return Folders(made_up.committed(tmp_path_factory.mktemp("tables")), tmp_path_factory.mktemp("folders"))


def test_the_committed_tables_against_themselves_are_green(folders):
    assert folders.judged(None, (), "nothing") == []


@pytest.mark.parametrize("fault", DOCTORED, ids=lambda fault: fault.what)
def test_doctored_tables_are_given_away(fault, folders):
    lines = folders.judged(fault.change, fault.to, fault.what.replace(" ", "-"))
    assert (fault.measure, fault.table) in [(line.measure, line.table) for line in lines]


# -- methods that are not what they were -----------------------------------------------------------
@pytest.mark.parametrize("composition", COMPOSITIONS, ids=lambda c: c.name)
def test_every_coefficient_of_a_composition_has_a_fault_of_its_own(composition):
    wrong = planted_faults.faulty(composition)
    printed = len(composition.stages) // 2 - 1 if len(composition.stages) > 5 else len(composition.stages)
    assert len(wrong) == printed + max(0, len(composition.processor) - 2)
    assert len({(each.stages, each.processor) for each in [composition, *wrong]}) == len(wrong) + 1
    for each in wrong:  # what is implied follows, and the sums do not give a long composition away
        assert properties.consistent(each) == (len(composition.stages) > 5)


def planted(call):
    """A solution of contact-strang before a fault is planted, and one after it; the registry is whole again."""

    def solution():
        return cb.solve("particle", "contact-strang", step=0.1, save_at=[20.0])

    before, whole = solution(), dict(cb.METHODS)
    try:
        getattr(planted_faults, call)()
        return before, solution()
    finally:
        cb.METHODS.clear()
        cb.METHODS.update(whole)


def test_faults_planted_by_plug_ins_are_what_they_are_called():
    error, drift = cb.LAWS["solution_error"], cb.LAWS["contact_drift"]
    before, after = planted("order_one")
    assert error(after) > 5 * error(before)  # of order h against h²: 6.9 times, measured
    before, after = planted("joints_left_apart")
    assert (before.counts.evaluations, after.counts.evaluations) == (201, 400)
    np.testing.assert_allclose(after.y, before.y, rtol=0, atol=1e-13)
    assert planted("refusal")[1].status is cb.Status.unsupported
    before, after = planted("stronger_damping")
    assert drift(before) < 1e-13
    assert drift(after) == pytest.approx(1e-9 * cb.SCENES["particle"].gamma * 20, rel=1e-3)
