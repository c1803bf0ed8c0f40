"""Keeps the rows of every cell as it is finished, and merges them into the result tables."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

# One thread for every engine; read when the libraries are first imported.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
import pytest

from clock import Clock, Timetable
from contactbench.errors import BadInput
from contactbench.measure.clock import MOST_VISITS, VISITS
from contactbench.methods import METHODS
from contactbench.methods.base import ENGINES
from contactbench.plugins import brought
from contactbench.results import provenance
from contactbench.results.cells import Cell, Cells
from contactbench.results.schema import PROFILES as NAMES
from contactbench.results.schema import TABLES
from contactbench.results.store import OldTable, read
from contactbench.scenes import SCENES

#: what this process may use before it is bound to one of them
CORES = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
REPOSITORY = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Profile:
    """How much is run: settings of a method, visits to a cell, the budget of a solver that calls back into Python."""

    name: str
    points: int
    visits: int
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
    "smoke": Profile("smoke", 1, VISITS, 40_000),  # the budget of standard: the same rows, the same ends
    "standard": Profile("standard", 6, VISITS, 40_000),
    "full": Profile("full", 99, MOST_VISITS, 1_000_000),
}


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("contactbench")
    group.addoption("--profile", choices=list(PROFILES), default="standard", help="how much to run")
    group.addoption("--results", type=Path, default=REPOSITORY / "results", help="where the tables go")
    group.addoption("--untimed", action="store_true", help="errors, counts and laws alone: no times")
    group.addoption("--own", action="store_true", help="only what plug-ins and installed packages bring")
    group.addoption("--resume", action="store_true", help="keep the rows of a run that was killed")
    group.addoption("--report", action="store_true", help="write documents and figures at the end")


def pytest_configure(config: pytest.Config) -> None:
    config.profile, config.begun = PROFILES[config.getoption("--profile")], False
    worker = getattr(config, "workerinput", None)  # of pytest-xdist: its controller runs no cells
    shared = bool(worker or config.getoption("numprocesses", None))
    config.controls, config.timed = worker is None, not (shared or config.getoption("untimed"))
    if worker or not shared:
        pin_to_one_core(int(worker["workerid"].removeprefix("gw")) if worker else -1)
    config.run = worker["run"] if worker else (provenance.new_run_id(), selection(config))
    config.cells = Cells(config.getoption("--results").resolve(), config.profile.name, *config.run)


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    node.workerinput["run"] = node.config.run


def pin_to_one_core(which: int) -> None:
    """XLA sizes its thread pool by the cores it may use, and handing parts of a small program to another
    thread costs more than running them (up to 70 µs a call, measured)."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {CORES[which % len(CORES)]})
        if "jax" in sys.modules:  # it took one for every core; brought up later, it takes the one it is left
            from contactbench.xla import jax  # not above: pytest asks every name of this file for attributes

            jax.config.update("jax_num_cpu_devices", 1)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """An experiment declares its cells as a function ``cells(profile)`` beside the test."""
    if "cell" in metafunc.fixturenames:
        cells = named(metafunc.function, metafunc.config)
        metafunc.parametrize("cell", list(cells.values()), ids=list(cells))


def named(test: Any, config: pytest.Config) -> dict[str, tuple]:
    """The cells of a test by their names; none for a test of times alone in a run without times."""
    cells = [] if test.times and not config.timed else test.cells(config.profile)
    if config.getoption("own"):
        own = brought()
        cells = [cell for cell in cells if not own.isdisjoint(cell)]
    return {"-".join(f"{p:.6g}" if isinstance(p, float) else str(p) for p in cell): cell for cell in cells}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Timed cells come after the others, file by file: the last of them prepared, all of a file are timed.

    Where processes share the cells, what shares its compiled programs (one method on one scene) stands together.
    """
    if config.controls:
        items.sort(key=lambda item: (item.path.name, item.get_closest_marker("timed") is not None))
    else:
        items.sort(key=lambda item: str(item.callspec.params["cell"]))


@pytest.hookimpl(tryfirst=True)  # before a worker of pytest-xdist says what it has collected
def pytest_collection_finish(session: pytest.Session) -> None:
    """Leave out what is done already, if the run is one that resumes."""
    config, items = session.config, session.items
    if config.getoption("collectonly"):
        return
    with full_disk():
        if not config.getoption("--resume"):
            config.cells.begin_anew()
            return
    done = config.cells.done()
    config.hook.pytest_deselected(items=[item for item in items if identity(item) in done])
    items[:] = [item for item in items if identity(item) not in done]


def identity(item: pytest.Item) -> Cell:
    return (item.path.name, item.name)


def all_cells(config: pytest.Config) -> list[Cell]:
    return [
        (file.name, f"{test.__name__}[{name}]")
        for file in Path(__file__).parent.glob("bench_*.py")
        for test in vars(import_module(file.stem)).values()
        if hasattr(test, "cells")
        for name in named(test, config)
    ]


def selection(config: pytest.Config) -> str:
    """Which part of the experiments was asked for, empty for all of them: the rows of the rest are kept.

    Marks do not count: a run is made in two goes, what is timed by itself.
    """
    narrowed = [argument for argument in config.args if "::" in argument or argument.endswith(".py")]
    own = ["--own"] * config.getoption("own")
    return " ".join([*narrowed, config.getoption("keyword"), *own]).strip()


def pytest_sessionstart(session: pytest.Session) -> None:
    config = session.config
    if not config.controls or config.getoption("collectonly"):
        return
    try:
        for each in TABLES.values():  # refused now rather than after ten minutes
            with suppress(*([] if config.cells.selection else [OldTable])):  # a whole run replaces those
                read(each, config.cells.results)
        config.cells.begin(provenance.environment(config.profile.name))
    except (BadInput, OSError) as error:
        raise pytest.UsageError(f"--results {config.cells.results}: {error}") from None
    config.begun = True


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Any:
    item.rows, item.later, finished = [], False, False
    try:
        result = yield
        finished = True
        return result
    finally:
        with full_disk():
            if item.rows or (finished and not item.later):
                item.config.cells.save(item.rows, identity(item), finished)


@contextmanager
def full_disk() -> Iterator[None]:
    """End the run in one line where the disk takes no more; what was finished before is there."""
    try:
        yield
    except OSError as error:
        where = f"{error.strerror} ({error.filename})" if error.filename else error.strerror
        pytest.exit(f"{where}: finished cells are kept; make room, then --resume", returncode=2)


@cache  # asked for once a cell, of thousands, it would cost as much as what is measured
def cells_of(test: Any, profile: str) -> frozenset[tuple]:
    return frozenset(test.cells(PROFILES[profile]))


@pytest.fixture
def complete(request: pytest.FixtureRequest) -> Callable[..., dict[str, Any]]:
    """``complete(table, row)`` adds the family of the method, and the smallest profile that has the cell."""
    cell = request.node.callspec.params["cell"]
    profile = next(name for name in NAMES if cell in cells_of(request.function, name))

    def complete(which: Any, row: dict[str, Any]) -> dict[str, Any]:
        known = "family" in which.columns and row["method"] in METHODS
        family = {"family": METHODS[row["method"]].family} if known else {}
        return {**family, **row, "profile": profile}

    return complete


@pytest.fixture
def record(request: pytest.FixtureRequest, complete: Any) -> Callable[..., None]:
    def record(which: Any, *rows: dict[str, Any]) -> None:
        request.node.rows += [(which, complete(which, row)) for row in rows]
        assert all(row.get("status", "ok") == "ok" or row["message"] for row in rows), "a bad end says why"

    return record


@pytest.fixture
def untimed(request: pytest.FixtureRequest) -> dict[str, Any] | None:
    """The row that the untimed test of a timed cell has made in this run; None where it was left out."""
    name = f"{request.function.times.__name__}[{request.node.callspec.id}]"
    rows = request.config.cells.rows((request.node.path.name, name))
    return rows[0][1] if rows else None


@pytest.fixture(scope="module")
def timetable(request: pytest.FixtureRequest) -> Iterator[Timetable | None]:
    if not request.config.timed:
        yield None
        return
    engines = {
        identity(item): next((part for part in item.callspec.params["cell"] if part in ENGINES), "")
        for item in request.session.items
        if item.module is request.module and "clock" in item.fixturenames
    }
    table = Timetable(engines, request.config.profile.visits)
    try:
        yield table
        if not table.ahead:  # else the run was interrupted
            with full_disk():
                table.go()
    finally:
        table.end()


@pytest.fixture
def clock(request: pytest.FixtureRequest, timetable: Timetable | None, record: Any, complete: Any) -> Clock:
    item = request.node

    def later(which: Any, row: dict[str, Any]) -> Callable[[dict[str, Any]], None]:
        """Record the row of this cell when its times are known: it is done then."""
        item.later = True
        untimed = complete(which, row)
        return lambda columns: item.config.cells.save([(which, untimed | columns)], identity(item))

    benchmark = None
    if timetable is not None:
        timetable.ahead.discard(identity(item))
        if item.config.pluginmanager.hasplugin("benchmark"):
            benchmark = request.getfixturevalue("benchmark")
            benchmark.group = item.path.stem
    return Clock(timetable, identity(item), record, later, benchmark)


@pytest.fixture
def profile(request: pytest.FixtureRequest) -> Profile:
    return request.config.profile


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    config = session.config
    if not config.begun:
        return
    with full_disk():
        config.cells.merge(() if config.cells.selection else all_cells(config))
    if exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED:  # all done, or none in this phase of the run
        session.exitstatus = pytest.ExitCode.OK
    if config.getoption("--report"):
        try:
            with full_disk():
                write_report(config.cells.results)
        except BadInput as error:  # a table that this run did not make is of another version
            config.get_terminal_writer().line(f"\nno report: {error}", red=True)
            session.exitstatus = pytest.ExitCode.TESTS_FAILED


def write_report(results: Path) -> None:
    from contactbench.report import write

    if CORES:  # nothing is timed any more
        os.sched_setaffinity(0, CORES)
    readme = REPOSITORY / "README.md"
    beside = results == REPOSITORY / "results" and readme.exists()
    write.report(results, {"methods": METHODS, "scenes": SCENES}, readme if beside else None)
