"""A solver that hangs, dies or lies costs its own row only."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

import contactbench as cb
import planted
from contactbench.measure.isolation import Worker
from contactbench.runs.stability import rows_of

EXPECTED = {
    "planted-hang": ("timeout", "no result after 2 s"),
    "planted-crash": ("failed", "signal 9"),
    "planted-raise": ("failed", "of its own making"),
    "planted-nan": ("diverged", "not finite"),
    "planted-early": ("failed", "ended at t = 10, not at t = 20"),
}


@pytest.fixture(scope="module")
def rows():
    """All planted solvers between two sound ones, in one worker, as a cell of the experiment runs them."""
    order = ["scipy-dop853", *EXPECTED, "heyoka-taylor"]
    key = {"scene": "oscillator", "status": "failed", "setting": "rtol=1e-06"}
    calls = [(key | {"method": name}, planted.row, (name,)) for name in order]
    with Impatient() as worker:
        return {row["method"]: row for row in rows_of(calls, worker)}


class Impatient(Worker):
    """A worker that waits two seconds for what hangs, and a minute for all else (as after a crash it imports)."""

    def call(self, limit, function, name):
        return super().call(2.0 if name == "planted-hang" else 60.0, function, name)


@pytest.mark.parametrize("name", EXPECTED)
def test_a_planted_solver_is_a_row_with_its_status(rows, name):
    status, message = EXPECTED[name]
    assert rows[name]["status"] == status
    assert message in rows[name]["message"]
    assert "solution_error" not in rows[name]


@pytest.mark.parametrize("name", ["scipy-dop853", "heyoka-taylor"])
def test_the_sound_solvers_around_them_are_untouched(rows, name):
    assert rows[name]["status"] == "ok"
    assert rows[name]["solution_error"] < 1e-4


def test_a_fault_of_the_experiment_is_no_row():
    """Only what a solver raises is a failed solver."""
    calls = [({"status": "failed", "setting": "rtol=1e-06"}, planted.row, ("no-such-method",))]
    with Impatient() as worker, pytest.raises(cb.UnknownName, match="no-such-method"):
        rows_of(calls, worker)


ASKER = """
import os, time
from contactbench.measure.isolation import Worker
from contactbench.runs.stability import rows_of

if __name__ == "__main__":
    with Worker() as worker:
        print(worker.call(60.0, os.getpid), flush=True)
        worker.call(60.0, time.sleep, 60.0)
"""


@pytest.mark.linux
def test_a_worker_ends_with_the_process_that_asked_even_when_that_is_killed(tmp_path):
    (tmp_path / "asker.py").write_text(ASKER)
    asker = subprocess.Popen([sys.executable, str(tmp_path / "asker.py")], stdout=subprocess.PIPE, text=True)
    worker = int(asker.stdout.readline())
    time.sleep(0.2)  # it is computing
    asker.kill()
    asker.wait()
    deadline = time.monotonic() + 20
    while alive(worker) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not alive(worker)


def alive(pid):
    """Whether a process runs; one that has ended may still be listed if nobody asked how."""
    stat = Path(f"/proc/{pid}/stat")
    return stat.exists() and stat.read_text().rpartition(")")[2].split()[0] != "Z"
