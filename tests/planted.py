"""Solvers that misbehave, for the benchmark to survive."""

import os
import signal
import time

import numpy as np

from contactbench.methods.base import METHODS, Adaptive
from contactbench.methods.prepared import Outcome, Prepared
from contactbench.solution import Counts, Status


class Misbehaving(Prepared):
    def integrate(self, y0):
        times = self.request.save_at
        y, end = np.tile(y0, (len(times), 1)), float(times[-1])
        match self.method:
            case "planted-hang":
                time.sleep(3600.0)
            case "planted-crash":
                os.kill(os.getpid(), signal.SIGKILL)
            case "planted-raise":
                raise FloatingPointError("of its own making")
            case "planted-nan":
                y[-1] = np.nan
            case "planted-early":
                end /= 2
        return Outcome(y, Counts(1, 1), Status.ok, "", end)


class Planted(Adaptive):
    rtol_range, engines, about = (1e-14, 1e-1), ("python",), "planted"

    def __init__(self, name):
        self.name = name

    def prepare(self, request):
        return Misbehaving(self.name, request)


NAMES = ("planted-hang", "planted-crash", "planted-raise", "planted-nan", "planted-early")


def register():
    for name in NAMES:
        if name not in METHODS:
            METHODS.add(Planted(name))


def row(question):
    """A row of runs.csv, made where the planted methods are registered."""
    from contactbench.runs.rows import along

    register()
    return along(question)


def attempt(run, cells, timetable=None):
    """As that of the runner, of cells one of which takes its process down and one fails."""
    from contactbench.runs import runner

    def measure(own, task, timetable=None):
        if "rk4" in task.cell:
            os.kill(os.getpid(), signal.SIGKILL)
        if "contact-gauss4" in task.cell:
            raise ValueError("planted")
        return once(own, task, timetable)

    once, runner.Run.measure = runner.Run.measure, measure
    try:
        return runner.attempt(run, cells, timetable)
    finally:
        runner.Run.measure = once
