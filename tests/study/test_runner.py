"""Runs in processes of their own: what they choose and refuse, what a solver that dies or fails costs, how they end."""

import subprocess
import sys

import pytest

import contactbench as cb
import planted
from cases import REPOSITORY, refusal
from contactbench.measure.isolation import Worker
from contactbench.methods import METHODS
from contactbench.runs import grid, runner
from contactbench.runs.experiment import PROFILES, Experiment, experiments
from contactbench.runs.grid import guarded
from contactbench.runs.runner import Run, Task
from contactbench.study.ending import ending
from contactbench.tables.cells import Cells
from contactbench.tables.declared import RUNS
from contactbench.tables.store import read
from made_up import row

TASK = Task(experiments()["run"], ("particle_long", "cvode-adams"), "particle_long-cvode-adams")


@pytest.mark.parametrize(
    ("expression", "chosen"),
    [
        ("", True),
        ("particle and cvode", True),
        ("Particle_Long and not (rk4 or timed)", True),
        ("bench_grid.py and not not adams", True),
        ("rk4 or heyoka", False),
        ("not run", False),
    ],
)
def test_cells_are_chosen_by_parts_of_their_names_as_pytest_does(expression, chosen):
    assert TASK.matches(expression) is chosen


@pytest.mark.parametrize("expression", ["and", "a b", "(a"])
def test_what_is_no_expression_is_refused(expression):
    assert "must be parts of names" in refusal(lambda: TASK.matches(expression))


# -- a row that the table cannot take --------------------------------------------------------------
@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"colour": "red"}, "no column 'colour'"),
        ({"error": "small"}, "'error': 'small' is no finite number"),
        ({"steps": 1.5}, "'steps': 1.5 is no whole number"),
        ({"momentum_law_kept": 1.0}, "'momentum_law_kept': 1.0 is no truth value"),
        ({"status": "failed", "message": ""}, "status failed without a message"),
    ],
)
def test_a_row_is_refused_where_it_is_recorded_and_the_next_run_starts(more, message, tmp_path):
    def rows(cell, profile):
        yield RUNS, row("contact-abc")
        yield RUNS, row("rk4") | more

    run = Run(tmp_path, PROFILES["smoke"], "some")
    run.begin()
    task = Task(Experiment("made_up", "made_up", lambda profile: [("rk4",)], rows), ("rk4",), "rk4")
    assert message in refusal(lambda: run.measure(task))
    run.end()
    Run(tmp_path, PROFILES["smoke"], "some").begin()
    assert list(read(RUNS, tmp_path)["method"]) == ["contact-abc"]  # what came before it
    assert not run.cells.done()


def test_a_cell_of_another_version_is_left_aside_and_stops_no_run(tmp_path):
    cells = Cells(tmp_path, "smoke", "before")
    cells.begin({"profile": "smoke"})
    cells.save([(RUNS, row("contact-abc") | {"colour": "red"})], ("bench.py", "a"))
    cells.save([(RUNS, row("rk4"))], ("bench.py", "b"))
    Run(tmp_path, PROFILES["smoke"]).begin()
    assert list(read(RUNS, tmp_path)["method"]) == ["rk4"]
    assert len(list(cells.folder.glob("*.new"))) == 1


# -- processes -------------------------------------------------------------------------------------
def test_a_cell_that_takes_its_process_down_or_fails_costs_itself(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(runner, "attempt", planted.attempt)
    run = Run(tmp_path, PROFILES["smoke"], "some", timed=False)
    chosen = "run and oscillator and not forced and (herglotz or rk4 or gauss4)"
    assert runner.work(run, chosen) == 2
    told = capsys.readouterr().err
    assert "run[oscillator-rk4]: the solver took its process down (signal 9)" in told
    assert "run[oscillator-contact-gauss4]: ValueError in planted.py" in told
    assert set(read(RUNS, tmp_path)["method"]) == {"herglotz1", "herglotz2"}
    assert len(run.cells.done()) == 2


# -- how a run ends ----------------------------------------------------------------------------------
def test_a_run_ends_with_the_answers_of_its_tables():
    text = ending(REPOSITORY / "results")
    assert text.startswith("Of ")
    assert "\nDoes a method keep the momentum J wherever it claims to?\n    always" in text


# -- a solver that hangs, dies or lies costs its own row only ----------------------------------------
EXPECTED = {
    "planted-hang": ("timeout", "no result after 0.5 s"),
    "planted-crash": ("failed", "signal 9"),
    "planted-raise": ("failed", "of its own making"),
    "planted-nan": ("diverged", "not finite"),
    "planted-early": ("failed", "ended at t = 10, not at t = 20"),
}


class Impatient(Worker):
    """A worker that waits half a second for what hangs, and five minutes for all else (as after a crash it imports)."""

    def call(self, limit, function, question):
        return super().call(0.5 if "planted-hang" in question else 300.0, function, question)


@pytest.fixture
def rows():
    """The row of each solver on the oscillator, in one worker, as a cell of a hard scene has them made.

    All planted solvers between two sound ones; then a fault of the experiment, which is no row.
    """
    planted.register()

    def row(name):
        return guarded(cb.SCENES["large_step"], planted.row, ("oscillator", name, "python", "rtol", 1e-6))

    try:
        with pytest.MonkeyPatch.context() as patch, Impatient() as worker:
            patch.setattr(grid, "worker", lambda: worker)
            made = {name: row(name) for name in ("scipy-dop853", *EXPECTED, "scipy-radau")}
            with pytest.raises(cb.UnknownName, match="no-such-method"):
                row("no-such-method")  # only what a solver raises is a failed solver
        return made
    finally:
        for name in planted.NAMES:
            del METHODS[name]


def test_a_planted_solver_is_a_row_with_its_status_and_the_sound_ones_around_it_are_untouched(rows):
    for name, (status, message) in EXPECTED.items():
        row = rows.pop(name)
        assert (row["status"], message in row["message"], "error" in row) == (status, True, False), row
    assert [(row["status"], row["error"] < 1e-4) for row in rows.values()] == [("ok", True)] * 2
    for name, status in (("planted-nan", "diverged"), ("planted-early", "failed")):  # in this process too
        assert cb.solve("oscillator", planted.Planted(name), rtol=1e-6).status == status


ASKER = """
import time
from contactbench.measure.isolation import Worker

if __name__ == "__main__":
    with Worker() as worker:
        print(worker.call(3600.0, str, "it computes"), flush=True)
        worker.call(3600.0, time.sleep, 3600.0)
"""


@pytest.mark.linux
@pytest.mark.timeout(300)
def test_a_worker_ends_with_the_process_that_asked_even_when_that_is_killed(tmp_path):
    (tmp_path / "asker.py").write_text(ASKER)
    asker = subprocess.Popen([sys.executable, str(tmp_path / "asker.py")], stdout=subprocess.PIPE, text=True)
    assert asker.stdout.readline() == "it computes\n"
    asker.kill()
    asker.communicate()  # until nobody has the pipe any more, the worker neither
