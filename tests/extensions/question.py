"""A question of one's own, in one file: its table, its experiment, its chapter with a summary, a view and a figure.

How long does the particle take to lose half its energy?  ``python question.py FOLDER`` measures it.
"""

import sys
from pathlib import Path

import numpy as np

import contactbench as cb
from contactbench.questions.answers import evaluate
from contactbench.report.chapters import CHAPTERS, Answer, Chapter
from contactbench.report.curves import by_method
from contactbench.report.drawing import Axis, Figure, Panel
from contactbench.report.views import View
from contactbench.tables.schema import TABLES, Column, Rule, Table
from contactbench.tables.store import merge

COLUMNS = {
    "scene": Column("name of the scene"),
    "method": Column("name of the method"),
    "step": Column("step size h", "number", exact=True),
    "status": Column("how the run ended", rule=Rule.same),
    "half_life": Column("time at which H0 is half of H0(0)", "number", Rule.value),
}
ABOUT = "when H0 has fallen to a half of H0(0), by linear interpolation"
HALF_LIFE = TABLES.add(Table("half_life", ABOUT, COLUMNS, key=("scene", "method", "step")))


def rows():
    for step in (0.4, 0.2, 0.1):
        solution = cb.solve("particle", "rk4", step=step, save_at=np.linspace(0.5, 20, 40))
        energy = solution.scene.energy(solution.states())
        start = solution.scene.energy(solution.start())
        when = float(np.interp(-start / 2, -energy, solution.t))
        yield {"scene": "particle", "method": "rk4", "step": step, "status": "ok", "half_life": when}


def parts(frames):
    frame = frames["half_life"]
    panel = Panel("particle", Axis("step", "log"), Axis("half-life"), by_method(frame, "step", "half_life"))
    shown = frame[["method", "step", "half_life"]]
    view = View("half_life", "Half-life", shown, "The time at which H0 is half of what it was.")
    return [view, Figure("half_life", "Half-life of the energy against the step", (panel,))]


def answers(frames):
    query = "half_life[half_life.status == 'ok'].half_life"
    values = evaluate(query, frames)
    yield Answer(
        "When is half of the energy gone?", f"at {values.mean():.3g}", f"{len(values)} steps", (query,)
    )


TITLE, LEAD = "Half-life of the energy", "When is half of it gone?"
CHAPTERS.add(Chapter("half_life", TITLE, LEAD, 90, ("half_life",), parts, answers))

if __name__ == "__main__":
    merge(HALF_LIFE, rows(), Path(sys.argv[1]))
