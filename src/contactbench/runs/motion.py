"""What is seen of a method: a weakly damped orbit after many turns, and its energy, at equal cost.

One cell: a method, or the truth.  Steps are as many times longer as they have evaluations.
"""

from __future__ import annotations

import numpy as np

import contactbench as cb
from contactbench.runs.experiment import Cell, Profile, Recorded, experiment
from contactbench.runs.trial import agreed
from contactbench.scene.base import Elapsed
from contactbench.tables.declared import MOTION, ORBIT, TRUTH

#: the central force, so weakly damped that a motion has many turns
SCENE, GAMMA, SPAN = "central", 0.005, 300.0
#: step of each method, five evaluations per unit of time each
STEPS = {"contact-strang": 0.2, "rk4": 0.8}
#: times between what is saved; of the truth less along the orbit, which is drawn as a line
SAVED, FINE = 0.8, 0.1
#: what agree on the truth, and to how many digits: far more than are seen
SOLVERS, DIGITS = (("heyoka-taylor", 1e-15), ("rkn12-10", 1e-13)), 9


@experiment(lambda profile: [(name,) for name in (TRUTH, *STEPS)])
def motion(cell: Cell, profile: Profile) -> Recorded:
    (name,) = cell
    scene = cb.SCENES[SCENE].with_(gamma=GAMMA, t_end=SPAN)
    t = SAVED * np.arange(1, round(SPAN / SAVED) + 1)
    if name == TRUTH:
        late = SPAN - ORBIT + FINE * np.arange(round(ORBIT / FINE) + 1)
        t = np.unique(np.round([*t[t < late[0]], *late], 9))
        runs = (cb.solve(scene, solver, rtol=rtol, save_at=Elapsed(t)) for solver, rtol in SOLVERS)
        truth = agreed(scene, ("s",), *runs)
        assert truth.digits >= DIGITS
        y, evaluations = truth.y, None
    else:
        saved, ended = (
            cb.solve(scene, name, step=STEPS[name], save_at=Elapsed(times)) for times in (t, [SPAN])
        )
        y, evaluations = saved.y, ended.counts.evaluations
    for time, row in zip(t.tolist(), y.tolist(), strict=True):
        x = scene.unpack(row, ("s",))
        point = {"t": time, "q1": x.q[0], "q2": x.q[1], "energy": scene.energy(x)}
        yield MOTION, {"scene": SCENE, "method": name, "evaluations": evaluations, **point}
