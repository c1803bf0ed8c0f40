"""Collects the rows the experiments make, journals them, and folds them into the result tables."""

from __future__ import annotations

import os
import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# One thread for every engine; read when the libraries are first imported.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
import pytest

from contactbench.errors import BadInput
from contactbench.results import journal
from contactbench.results import schema as table
from contactbench.xla import jax

SHUFFLE_SEED = 20
REPOSITORY = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Profile:
    """How much of each experiment is run.

    points : settings per method; rounds, seconds : at least so many timed rounds, filling about so
    many seconds; callback_evaluations : budget of one run of a solver that calls back into Python.
    """

    name: str
    points: int
    rounds: int
    seconds: float
    callback_evaluations: int

    def choose(self, ladder: list[Any]) -> list[Any]:
        """`points` of a ladder, spread over it; a single one is among those of the standard profile."""
        if self.points >= len(ladder):
            return ladder
        if self.points == 1:
            spread = PROFILES["standard"].choose(ladder)
            return [spread[len(spread) // 3]]
        last = len(ladder) - 1
        return [ladder[round(i * last / (self.points - 1))] for i in range(self.points)]


PROFILES = {
    "smoke": Profile("smoke", 1, 5, 0.0, 40_000),  # the budget of standard: the same rows, the same ends
    "standard": Profile("standard", 6, 5, 0.02, 40_000),
    "full": Profile("full", 99, 15, 0.3, 1_000_000),
}


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("contactbench")
    group.addoption("--profile", choices=list(PROFILES), default="standard", help="how much to run")
    group.addoption("--results", type=Path, default=REPOSITORY / "results", help="where the tables go")
    group.addoption("--resume", action="store_true", help="keep the rows of a run that was killed")
    group.addoption("--report", action="store_true", help="write documents and figures at the end")


def pytest_configure(config: pytest.Config) -> None:
    config.profile = PROFILES[config.getoption("--profile")]
    worker = getattr(config, "workerinput", None)  # of pytest-xdist: its controller runs no cells
    config.controls = worker is None
    if worker or not config.getoption("numprocesses", None):
        pin_to_one_core(int(worker["workerid"].removeprefix("gw")) if worker else -1)
    run_id = worker["run_id"] if worker else table.new_run_id()
    config.journal = journal.Journal(config.getoption("--results").resolve(), run_id)


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    node.workerinput["run_id"] = node.config.journal.run_id


def pin_to_one_core(which: int) -> None:
    """XLA sizes its thread pool by the cores it may use, and handing parts of a small program to another
    thread costs more than running them (up to 70 µs a call, measured)."""
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[which % len(cores)]})
        jax.config.update("jax_num_cpu_devices", 1)  # contactbench, imported before, took one for every core


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """An experiment declares its cells as a function ``cells(profile)`` beside the test."""
    if "cell" in metafunc.fixturenames:
        cells = metafunc.function.cells(metafunc.config.profile)
        metafunc.parametrize("cell", cells, ids=["-".join(map(str, c)) for c in cells])


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Timed cells run in shuffled order, so that slow drifts of the machine hit all methods alike.

    The others are handed out by method and scene, so that a compiled program is made once.
    """
    random.Random(SHUFFLE_SEED).shuffle(items)
    items.sort(key=lambda item: item.path.name)
    for item in items:
        cell = item.callspec.params["cell"]
        if isinstance(cell, tuple):  # not so where a profile has no cells for a test
            item.add_marker(pytest.mark.xdist_group(item.function.group(cell)))


@pytest.hookimpl(tryfirst=True)  # before a worker of pytest-xdist says what it has collected
def pytest_collection_finish(session: pytest.Session) -> None:
    """What --resume leaves out; a new run takes its cells off the list of what is done."""
    config, items = session.config, session.items
    if config.getoption("collectonly"):
        return
    results, name = config.journal.results, config.profile.name
    if not config.getoption("--resume"):
        journal.begin_anew(results, name, map(_identity, items))
        return
    done = journal.done(results, name)
    config.hook.pytest_deselected(items=[item for item in items if _identity(item) in done])
    items[:] = [item for item in items if _identity(item) not in done]


def _identity(item: pytest.Item) -> journal.Cell:
    return (item.path.name, item.name)


def pytest_sessionstart(session: pytest.Session) -> None:
    config = session.config
    if not config.controls or config.getoption("collectonly"):
        return
    results = config.journal.results
    try:
        for each in table.TABLES.values():  # refused now rather than after ten minutes
            table.read(each, results)
        journal.fold_dead_runs(results)
        config.journal.open(table.environment(config.profile.name, SHUFFLE_SEED))
    except BadInput as error:
        raise pytest.UsageError(str(error)) from None


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Any:
    item.rows, finished = [], False
    try:
        result = yield
        finished = True
        return result
    finally:
        item.config.journal.append(item.rows, _identity(item) if finished else None)


def smallest_profile(request: pytest.FixtureRequest) -> str:
    """The smallest profile that has the cell of a test; the rows of a cell are the same in all."""
    cell, cells = request.node.callspec.params["cell"], request.function.cells
    return next(name for name in table.PROFILES if cell in cells(PROFILES[name]))


@pytest.fixture
def record_all(request: pytest.FixtureRequest) -> Callable[..., None]:
    """``record_all(table, rows)`` adds many rows at once."""
    profile = smallest_profile(request)
    return lambda which, rows: request.node.rows.extend((which, {**row, "profile": profile}) for row in rows)


@pytest.fixture
def record(record_all: Callable[..., None]) -> Callable[..., None]:
    """``record(table, **row)`` adds a row to a result table."""
    return lambda which, **row: record_all(which, [row])


@pytest.fixture
def profile(request: pytest.FixtureRequest) -> Profile:
    return request.config.profile


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    config = session.config
    if not config.controls or not config.journal.alive.is_locked:
        return
    config.journal.close()
    if config.getoption("--report"):
        from contactbench.report import page
        from contactbench.report.documents import report

        report(config.journal.results)
        page.write(config.journal.results)
    if exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED:  # all done, or none in this phase of the run
        session.exitstatus = pytest.ExitCode.OK
