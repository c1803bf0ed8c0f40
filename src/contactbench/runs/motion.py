"""Compare a weakly damped orbit after many turns, and its energy, between methods at equal cost."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import contactbench as cb
from contactbench.runs.experiment import Cell, Profile, Recorded, Row, experiment
from contactbench.runs.trial import agreed
from contactbench.scene.base import Elapsed
from contactbench.tables.declared import MOTION

#: the central force with a damping weak enough for many turns
SCENE, GAMMA, SPAN = "central", 0.005, 300.0
#: the methods, and their evaluations per unit of time
METHODS, COST = ("contact-strang", "rk4"), 5.0
#: solvers that must agree on the truth, and to how many digits, far more than a figure shows
TRUTH, SOLVERS, DIGITS = "truth", (("heyoka-taylor", 1e-15), ("rkn12-10", 1e-13)), 9
#: times between points of the energy, and of the orbit, for the truth closer; how long the orbit is drawn
SAVED, FINE, ORBIT = 0.8, 0.1, 14.4

type Line = tuple[str, str, np.ndarray, np.ndarray]  #: a panel, a curve, its abscissas and ordinates


def every(between: float, begin: float) -> np.ndarray:
    """Return equidistant times from a beginning to the end, without 0."""
    count = round((SPAN - begin) / between)
    return np.round(begin + between * np.arange(0 if begin else 1, count + 1), 9)


def lines(name: str) -> Iterator[tuple[Line, int | None]]:
    """Yield the energy and the orbit of a method, or of the truth, and its evaluations."""
    scene: cb.Mechanical = cb.SCENES[SCENE].with_(gamma=GAMMA, t_end=SPAN)
    along, late = every(SAVED, 0.0), every(FINE if name == TRUTH else SAVED, SPAN - ORBIT)
    t = np.union1d(along, late)
    if name == TRUTH:
        given: Row = {"save_at": Elapsed(t), "carry": ()}
        truth = agreed(scene, (), *(cb.solve(scene, solver, rtol=rtol, **given) for solver, rtol in SOLVERS))
        assert truth.digits >= DIGITS
        states, evaluations = truth.states(), None
    else:
        step = cb.METHODS[name].per_step(scene) / COST
        saved, ended = (cb.solve(scene, name, step=step, save_at=Elapsed(s)) for s in (t, [SPAN]))
        states, evaluations = saved.states(), ended.counts.evaluations
    energy, orbit = np.isin(t, along), np.isin(t, late)
    yield ("energy", name, t[energy], scene.energy(states)[energy]), evaluations
    x, y = (np.asarray(q)[orbit] for q in states.q)
    yield ("orbit", name, x, y), evaluations


@experiment(lambda profile: [("motion",)])
def motion(cell: Cell, profile: Profile) -> Recorded:
    for name in (TRUTH, *METHODS):
        for (panel, curve, *places), evaluations in lines(name):
            row: Row = {"figure": cell[0], "panel": panel, "curve": curve, "z": evaluations}
            row["kind"] = TRUTH if name == TRUTH else "method"
            for point, (x, y) in enumerate(zip(*places, strict=True)):
                yield MOTION, row | {"point": point, "x": x, "y": y}
