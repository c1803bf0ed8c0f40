"""Fixtures of the tests, and which cases of a long parametrisation the quick run takes."""

import os
import signal
import sys
from typing import Any

import pytest
from mpmath import mp

from cases import Clock, reading
from contactbench.measure.laws import LAWS
from contactbench.methods import METHODS
from contactbench.plugins import GROUPS, LOADED, OWN, VARIABLE
from contactbench.scene import Cache
from contactbench.scenes import SCENES
from contactbench.tables.schema import TABLES

os.environ.setdefault(
    "JAX_ENABLE_X64", "1"
)  # read when JAX is imported: what the tests compute with it is in doubles


def pytest_configure():
    """A shell that starts the tests in the background has them ignore Ctrl-C, which some of them send."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True)
def clock():
    """The clock that contactbench reads in a test: limits of time do not depend on how busy the machine is."""
    with reading(Clock()) as clock:
        yield clock


#: the marks of tests that only some systems can run
SYSTEMS = {"posix": sys.platform != "win32", "linux": sys.platform == "linux"}


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip by name what this system cannot run."""
    for mark, fits in SYSTEMS.items():
        if item.get_closest_marker(mark) and not fits:
            pytest.skip(f"needs {mark}, which {sys.platform} is not")


@pytest.hookimpl(tryfirst=True)  # before pytest leaves out the slow ones
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark as slow the cases that a test's ``quick`` marks do not name, but for a user's method or scene."""
    for item in items:
        marks = list(item.iter_markers("quick"))
        if marks and not has_users(item) and not any(names_case(mark, item) for mark in marks):
            item.add_marker("slow")


def names_case(mark: pytest.Mark, item: pytest.Item) -> bool:
    """Whether every parameter that the mark gives has one of the values given."""
    return all(
        label(item.callspec.params[parameter]) in (values if isinstance(values, tuple) else (values,))
        for parameter, values in mark.kwargs.items()
    )


def has_users(item: pytest.Item) -> bool:
    """Whether a case is about a registered method or scene that is not ours."""
    names = {name for value in item.callspec.params.values() if isinstance(name := label(value), str)}
    return bool(names & {*METHODS, *SCENES} - OWN)


def label(value: Any) -> Any:
    return getattr(value, "name", value)


@pytest.fixture
def registries(monkeypatch):
    """Forget what a test registers."""
    from contactbench.report.chapters import CHAPTERS

    monkeypatch.setenv(VARIABLE, "")
    kept = [(each, dict(each)) for each in (*GROUPS.values(), LAWS, CHAPTERS, LOADED)]
    yield
    for registry, items in kept:
        registry.clear()
        registry.update(items)


@pytest.fixture
def only_tables():
    """Leave some tables until the test ends: to read and compare the others, empty ones, takes most of its time."""
    kept = dict(TABLES)

    def only(*names):
        TABLES.clear()
        TABLES.update({name: kept[name] for name in names})

    yield only
    TABLES.clear()
    TABLES.update(kept)


@pytest.fixture
def unconfirmed(monkeypatch):
    """Have no second engine confirm the reference of a race, which takes most of a short one."""
    monkeypatch.setattr("contactbench.study.schedule.confirmed", lambda *_: 20)


@pytest.fixture
def fresh(monkeypatch):
    """Forget every truth and compiled program from before the test, once more at each call, and its own after it."""

    def forget():
        for module in [each for name, each in sys.modules.items() if name.startswith("contactbench.")]:
            for name in [name for name, value in vars(module).items() if isinstance(value, Cache)]:
                monkeypatch.setattr(module, name, Cache(256))

    forget()
    return forget


@pytest.fixture
def mp50():
    with mp.workdps(50):
        yield mp
