"""The experiments of `contactbench.study` under pytest: a test for each, its cells as parameters."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic
from typing import Any

import pytest
from tqdm import tqdm

from contactbench.errors import BadInput
from contactbench.measure.clock import Call
from contactbench.measure.isolation import bind
from contactbench.methods import METHODS
from contactbench.runs import population
from contactbench.runs.experiment import PROFILES, Experiment, experiments
from contactbench.runs.runner import Run, Task
from contactbench.runs.timetable import Timetable
from contactbench.scenes import SCENES
from contactbench.tables.cells import DiskFull, disk

#: what this process may use before it is bound to one of them
CORES = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
REPOSITORY = Path(__file__).resolve().parents[1]


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("contactbench")
    group.addoption("--profile", choices=list(PROFILES), default="standard", help="how much to run")
    group.addoption("--results", type=Path, default=REPOSITORY / "results", help="where the tables go")
    group.addoption("--untimed", action="store_true", help="errors, counts and laws alone: no times")
    group.addoption("--seed", type=int, help="of the random problems, instead of those of the repository")
    group.addoption("--resume", action="store_true", help="keep the rows of a run that was killed")
    group.addoption("--report", action="store_true", help="write documents and figures at the end")


def pytest_configure(config: pytest.Config) -> None:
    worker = getattr(config, "workerinput", None)  # of pytest-xdist: its controller runs no cells
    shared = bool(worker or config.getoption("numprocesses", None))
    config.controls, config.begun = worker is None, False
    if config.controls:
        config.pluginmanager.register(Shown(config))
    if worker or not shared:
        which = int(worker["workerid"].removeprefix("gw")) if worker else -1
        bind(CORES and [CORES[which % len(CORES)]])
    if config.getoption("--seed") is not None:
        population.OWN_SEED[:] = [config.getoption("--seed")]
    profile, results = PROFILES[config.getoption("--profile")], config.getoption("--results").resolve()
    timed, name = not (shared or config.getoption("untimed")), {"name": worker["run"]} if worker else {}
    config.run = Run(results, profile, selection(config), timed, **name)
    # runs that diverge overflow; how they end is a row
    config.addinivalue_line("filterwarnings", "ignore::RuntimeWarning")


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    node.workerinput["run"] = node.config.run.name


def selection(config: pytest.Config) -> str:
    """Which part of the experiments was asked for, empty for all of them: the rows of the rest are kept.

    Marks do not count: a run is made in two goes, what is timed by itself.
    """
    narrowed = [argument for argument in config.args if "::" in argument or argument.endswith(".py")]
    return " ".join([*narrowed, config.getoption("keyword")]).strip()


# -- which cells -----------------------------------------------------------------------------------
def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """A test runs the experiment of its name."""
    tasks = metafunc.config.run.tasks_of(experiment_of(metafunc.function))
    metafunc.parametrize("task", tasks, ids=[task.name for task in tasks])


def experiment_of(test: Callable[..., None]) -> Experiment:
    return experiments()[test.__name__.removeprefix("test_")]


def task_of(item: pytest.Item) -> Task:
    return item.callspec.params["task"]


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Timed cells come after the others, file by file: the last of them prepared, all of a file are timed.

    Where processes share the cells, what shares its compiled programs (one method on one scene) stands together.
    """
    items[:] = [item for item in items if isinstance(task_of(item), Task)]  # pytest has one for no cells too
    for item in items:
        if task_of(item).experiment.timed:
            item.add_marker("timed")
    if config.controls:
        items.sort(key=lambda item: (item.path.name, task_of(item).experiment.timed))
    else:
        items.sort(key=lambda item: str(task_of(item).cell))


@pytest.hookimpl(tryfirst=True)  # before a worker of pytest-xdist says what it has collected
def pytest_collection_finish(session: pytest.Session) -> None:
    """Leave out what is done already, if the run is one that resumes."""
    config, items = session.config, session.items
    if config.getoption("collectonly"):
        return
    with full_disk():
        left = config.run.remaining([task_of(item) for item in items], config.getoption("--resume"))
    keys = {task.key for task in left}
    config.hook.pytest_deselected(items=[item for item in items if task_of(item).key not in keys])
    items[:] = [item for item in items if task_of(item).key in keys]


# -- a cell ----------------------------------------------------------------------------------------
@contextmanager
def full_disk() -> Iterator[None]:
    try:
        yield
    except DiskFull as error:
        pytest.exit(str(error), returncode=2)


@pytest.fixture(scope="module")
def timetable(request: pytest.FixtureRequest) -> Iterator[Timetable]:
    """The timed cells of a file, visited in turns when the last of them is prepared."""
    run, items = request.config.run, request.session.items
    with run.timetable(
        task_of(i) for i in items if i.module is request.module and task_of(i).experiment.timed
    ) as table:
        yield table
        if not table.ahead:  # else the run was interrupted
            with full_disk():
                table.go()


@pytest.fixture
def measure(task: Task, request: pytest.FixtureRequest) -> Callable[[], None]:
    """A function that measures the cell; pytest-benchmark times its last call here, the least of all goes along."""

    def measure() -> None:
        run = request.config.run
        with full_disk():
            entries = run.measure(
                task, request.getfixturevalue("timetable") if task.experiment.timed else None
            )
        here = [(entry, entry.call) for entry in entries if isinstance(entry.call, Call)]
        if here and request.config.pluginmanager.hasplugin("benchmark"):
            (entry, call), benchmark = here[-1], request.getfixturevalue("benchmark")
            benchmark.group, entry.told = request.path.stem, benchmark.extra_info
            benchmark.pedantic(call.run, iterations=call.calls_a_round())

    return measure


# -- what is seen of it ------------------------------------------------------------------------------
class Progress:
    """Cells that are done, what runs, and the time left: a bar on a terminal, elsewhere a line at each tenth."""

    def __init__(self, total: int) -> None:
        self.total, self.begun, self.done, self.tenths = total, monotonic(), 0, 0
        self.bar = tqdm(total=total, unit="cell", disable=None, dynamic_ncols=True, mininterval=1.0)

    def step(self, name: str) -> str:
        """Count a cell; return the line to print."""
        self.done += 1
        self.bar.set_postfix_str(name[:50], refresh=False)
        self.bar.update()
        if not self.bar.disable or self.done * 10 // self.total == self.tenths:
            return ""
        self.tenths = self.done * 10 // self.total
        spent = monotonic() - self.begun
        left = spent * (self.total / self.done - 1)
        return f"{self.done} of {self.total} cells, {spent / 60:.1f} min, about {left / 60:.1f} left: {name}"


@pytest.hookimpl(tryfirst=True)
def pytest_report_teststatus(report: pytest.TestReport) -> tuple[str, str, str] | None:
    """No dots: a run has thousands of cells."""
    return ("passed", "", "") if report.passed and report.when == "call" else None


class Shown:
    """Shows the progress of a run, in the process that controls it."""

    def __init__(self, config: pytest.Config) -> None:
        self.config, self.progress = config, None

    @pytest.hookimpl(optionalhook=True)
    def pytest_xdist_node_collection_finished(self, ids: list[str]) -> None:
        self.begin(len(ids))

    def pytest_runtestloop(self, session: pytest.Session) -> None:
        self.begin(len(session.items))

    def begin(self, total: int) -> None:
        if self.progress is None and total:
            self.progress = Progress(total)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        counts = self.progress is not None and report.when == "call"
        if counts and (line := self.progress.step(report.nodeid.partition("::test_")[2])):
            self.config.get_terminal_writer().write(f"{line}\n", flush=True)

    def pytest_sessionfinish(self) -> None:
        if self.progress is not None:
            self.progress.bar.close()


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    if config.begun and config.getoption("--report"):
        from contactbench.study.ending import ending

        terminalreporter.section("results")
        terminalreporter.line(ending(config.run.results))


# -- the whole run ---------------------------------------------------------------------------------
def pytest_sessionstart(session: pytest.Session) -> None:
    config = session.config
    if not config.controls or config.getoption("collectonly"):
        return
    try:
        config.run.begin()
    except BadInput as error:
        raise pytest.UsageError(str(error)) from None
    config.begun = True


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    config = session.config
    if not config.begun:
        return
    gc.disable()  # it would look through thousands of prepared runs again and again below
    with full_disk():
        config.run.end()
    if exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED:  # all done, or none in this phase of the run
        session.exitstatus = pytest.ExitCode.OK
    if config.getoption("--report"):
        try:
            write_report(config.run.results)
        except BadInput as error:  # a table that this run did not make is of another version
            config.get_terminal_writer().line(f"\nno report: {error}", red=True)
            session.exitstatus = pytest.ExitCode.TESTS_FAILED


def write_report(results: Path) -> None:
    from contactbench.questions import write

    bind(CORES)  # nothing is timed any more
    readme = REPOSITORY / "README.md"
    beside = results == REPOSITORY / "results" and readme.exists()
    with full_disk(), disk():
        write.report(results, {"methods": METHODS, "scenes": SCENES}, readme if beside else None)
