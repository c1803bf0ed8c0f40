"""A question of one's own, in one file: its table, its experiment, its room with a view, a figure and a finding.

How long does the particle take to lose half its energy?  ``python question.py FOLDER`` measures it.
"""

import sys
from pathlib import Path

import numpy as np

import contactbench as cb
from contactbench.report.cells import Head, View, number, word
from contactbench.report.curves import by_method, number_axis
from contactbench.report.drawing import Axis, Figure, Panel
from contactbench.report.numbers import readable
from contactbench.report.rooms import ROOMS, Finding, Room
from contactbench.results.columns import COMMON
from contactbench.results.columns import number as column
from contactbench.results.schema import Rule, table
from contactbench.results.store import merge

HALF_LIFE = table(
    "half_life", "when H0 has fallen to a half of H0(0), by linear interpolation",
    {**COMMON, "half_life": column("time at which H0 is half of H0(0)", Rule.value)},
)  # fmt: skip


def rows():
    for step in (0.4, 0.2, 0.1):
        solution = cb.solve("particle", "rk4", step=step, save_at=np.linspace(0.5, 20, 40))
        energy = solution.scene.energy(solution.states())
        start = solution.scene.energy(solution.start())
        when = float(np.interp(-start / 2, -energy, solution.t))
        yield {
            "scene": "particle", "method": "rk4", "family": "established", "engine": solution.engine,
            "control": "step", "value": step, "variant": "", "setting": solution.setting, "status": "ok",
            "message": "", "half_life": when, "profile": "smoke",
        }  # fmt: skip


def sections(frames):
    frame = frames["half_life"]
    heads = (Head("method", words=True), Head("step"), Head("half-life"))
    cells = tuple(
        (word(r["method"]), number(r["value"], readable), number(r["half_life"], readable))
        for _, r in frame.iterrows()
    )
    panel = Panel("particle", number_axis("step"), Axis("half-life"), by_method(frame, "value", "half_life"))
    return [
        View(
            "half_life",
            "Half-life",
            "The time at which H0 is half of what it was.",
            heads,
            cells,
            "half_life.csv",
        ),
        Figure("half_life", "Half-life of the energy against the step", (panel,)),
    ]


def findings(frames):
    values = frames["half_life"]["half_life"]
    return [Finding("half_life", "Half-life", f"It is {values.mean():.3g}.", f"{len(values)} rows")]


ROOMS.add(
    Room(
        "half_life",
        "Half-life of the energy",
        "when half of it is gone",
        90,
        ("half_life",),
        sections,
        findings,
    )
)

if __name__ == "__main__":
    merge(HALF_LIFE, rows(), Path(sys.argv[1]))
