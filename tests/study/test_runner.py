"""Runs in processes of their own: what they choose, what they refuse, and what one that dies or fails costs."""

import pytest

import contactbench as cb
import planted
from cases import refusal
from contactbench.runs import runner
from contactbench.runs.experiment import PROFILES, Experiment, experiments
from contactbench.runs.runner import Run, Task
from contactbench.tables.cells import Cells
from contactbench.tables.declared import CONVERGENCE, DEFINITIONS
from contactbench.tables.store import read
from made_up import row

TASK = Task(experiments()["laws"], ("particle_long", "cvode-adams"), "particle_long-cvode-adams")


@pytest.mark.parametrize(
    ("expression", "chosen"),
    [
        ("", True),
        ("particle and cvode", True),
        ("Particle_Long and not (rk4 or timed)", True),
        ("bench_laws.py and not not adams", True),
        ("rk4 or heyoka", False),
        ("not laws", False),
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
        ({"solution_error": "small"}, "'solution_error': 'small' is no finite number"),
        ({"steps": 1.5}, "'steps': 1.5 is no whole number"),
        ({"in_fit": 1.0}, "'in_fit': 1.0 is no truth value"),
        ({"status": "failed", "message": ""}, "status failed without a message"),
    ],
)
def test_a_row_is_refused_where_it_is_recorded_and_the_next_run_starts(more, message, tmp_path):
    def rows(cell, profile):
        yield CONVERGENCE, row("contact-abc")
        yield CONVERGENCE, row("rk4") | more

    run = Run(tmp_path, PROFILES["smoke"], "some")
    run.begin()
    task = Task(Experiment("made_up", "made_up", lambda profile: [("rk4",)], rows), ("rk4",), "rk4")
    assert message in refusal(lambda: run.measure(task))
    run.end()
    Run(tmp_path, PROFILES["smoke"], "some").begin()
    assert list(read(CONVERGENCE, tmp_path)["method"]) == ["contact-abc"]  # what came before it
    assert not run.cells.done()


def test_a_cell_of_another_version_is_left_aside_and_stops_no_run(tmp_path):
    cells = Cells(tmp_path, "smoke", "before")
    cells.begin({"profile": "smoke"})
    cells.save([(CONVERGENCE, row("contact-abc") | {"colour": "red"})], ("bench.py", "a"))
    cells.save([(CONVERGENCE, row("rk4"))], ("bench.py", "b"))
    Run(tmp_path, PROFILES["smoke"]).begin()
    assert list(read(CONVERGENCE, tmp_path)["method"]) == ["rk4"]
    assert len(list(cells.folder.glob("*.new"))) == 1


# -- processes -------------------------------------------------------------------------------------
def test_a_cell_that_takes_its_process_down_or_fails_costs_itself(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(runner, "attempt", planted.attempt)
    run = Run(tmp_path, PROFILES["smoke"], "some", timed=False)
    chosen = "definition and method and (contact-strang or rk4 or scipy or method-contact-gauss4)"
    assert runner.work(run, chosen) == 2
    told = capsys.readouterr().err
    assert "definition[method-rk4]: the solver took its process down (signal 9)" in told
    assert "definition[method-contact-gauss4]: ValueError in planted.py" in told
    names = {name for name in cb.METHODS if "contact-strang" in name or "scipy" in name}
    assert set(read(DEFINITIONS, tmp_path)["method"]) == names
    assert len(run.cells.done()) == len(names)
