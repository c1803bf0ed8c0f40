"""A solver that hangs, dies or lies costs its own row only."""

import subprocess
import sys

import pytest

import contactbench as cb
import planted
from contactbench.measure.isolation import Worker
from contactbench.methods import METHODS
from contactbench.runs import grid
from contactbench.runs.grid import guarded

EXPECTED = {
    "planted-hang": ("timeout", "no result after 0.5 s"),
    "planted-crash": ("failed", "signal 9"),
    "planted-raise": ("failed", "of its own making"),
    "planted-nan": ("diverged", "not finite"),
    "planted-early": ("failed", "ended at t = 10, not at t = 20"),
}


class Impatient(Worker):
    """A worker that waits half a second for what hangs, and a minute for all else (as after a crash it imports)."""

    def call(self, limit, function, question):
        return super().call(0.5 if "planted-hang" in question else 60.0, function, question)


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
