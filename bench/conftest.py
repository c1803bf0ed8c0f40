"""Collects the rows the experiments make, journals them, and folds them into the result tables."""

from __future__ import annotations

import os
import random
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# One thread for every engine; read when the libraries are first imported.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
# One core: XLA sizes its thread pool by the cores it may use, and handing parts of a small program to
# another thread costs more than running them (up to 70 µs a call, measured).
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

import pytest

from contactbench import table

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
        """`points` of a ladder, spread over it."""
        if self.points >= len(ladder):
            return ladder
        if self.points == 1:
            return [ladder[len(ladder) // 3]]
        last = len(ladder) - 1
        return [ladder[round(i * last / (self.points - 1))] for i in range(self.points)]


PROFILES = {
    "smoke": Profile("smoke", 1, 5, 0.0, 20_000),
    "standard": Profile("standard", 6, 5, 0.02, 40_000),
    "full": Profile("full", 99, 15, 0.3, 1_000_000),
}


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("contactbench")
    group.addoption("--profile", choices=list(PROFILES), default="standard", help="how much to run")
    group.addoption("--results", type=Path, default=REPOSITORY / "results", help="where the tables go")
    group.addoption("--resume", action="store_true", help="keep the rows of a run that was killed")


def pytest_configure(config: pytest.Config) -> None:
    config.profile = PROFILES[config.getoption("--profile")]
    config.journal = table.Journal(config.getoption("--results").resolve(), table.new_run_id())


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """An experiment declares its cells as a function ``cells(profile)`` beside the test."""
    if "cell" in metafunc.fixturenames:
        cells = metafunc.function.cells(metafunc.config.profile)
        metafunc.parametrize("cell", cells, ids=["-".join(map(str, c)) for c in cells])


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Timed cells run in shuffled order, so that slow drifts of the machine hit all methods alike."""
    random.Random(SHUFFLE_SEED).shuffle(items)
    items.sort(key=lambda item: item.path.name)
    if config.getoption("--resume"):
        done = config.journal.done()
        skipped = [i for i in items if _identity(i) in done]
        config.hook.pytest_deselected(items=skipped)
        items[:] = [i for i in items if _identity(i) not in done]


def _identity(item: pytest.Item) -> tuple[str, str]:
    return (item.path.name, item.name)


def pytest_sessionstart(session: pytest.Session) -> None:
    config = session.config
    if not config.getoption("collectonly"):
        if not config.getoption("--resume"):
            config.journal.fold()  # rows a killed run left behind are still good rows
        config.environment = table.environment(config.profile.name, SHUFFLE_SEED)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Any:
    result = yield
    item.config.journal.finish(_identity(item))
    return result


@pytest.fixture
def record(request: pytest.FixtureRequest) -> Callable[..., None]:
    """``record(table, **row)`` journals one row of a result table."""
    return lambda which, **row: request.config.journal.append(which, row)


@pytest.fixture
def record_all(request: pytest.FixtureRequest) -> Callable[..., None]:
    """``record_all(table, rows)`` journals many rows at once."""
    return lambda which, rows: request.config.journal.append(which, *rows)


@pytest.fixture
def profile(request: pytest.FixtureRequest) -> Profile:
    return request.config.profile


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    config = session.config
    if config.getoption("collectonly") or not hasattr(config, "environment"):
        return
    journal = config.journal
    journal.fold()
    table.save_environment(journal.run_id, config.environment, journal.results)
    if session.testscollected and sys.stderr.isatty():
        print(f"\ntables in {journal.results}; now run: contactbench report", file=sys.stderr)
