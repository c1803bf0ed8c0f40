"""Do splittings for weak damping pay?  ``python bench/near_integrable.py`` prints what an error costs.

Weakly damped anisotropic bodies, of moments 1, 2, 3, tumbling, and a needle; the tables of
`contactbench.splitting.near_integrable`, the palindrome of the same two flows, compositions of two rotations,
and the fastest peers, all compiled: µs for errors of 1e-3, 1e-6 and 1e-9, an asterisk at the least.
"""

from __future__ import annotations

import math
from time import perf_counter

import numpy as np

import contactbench as cb
from contactbench.measure.ladder import tolerances
from contactbench.methods.contact import contact_method
from contactbench.splitting.near_integrable import NEAR_INTEGRABLE

WEAK = cb.SCENES["rigid_body_anisotropic"]
RATES = np.array(WEAK.damping).diagonal()
SCENES = [
    WEAK.with_(name="strongly damped"),
    WEAK.with_(name="damped by 1e-2 of that", damping=1e-2 * RATES, t_end=200.0),
    WEAK.with_(name="damped by 1e-4 of that", damping=1e-4 * RATES, t_end=200.0),
    WEAK.with_(name="tumbling, 1e-3", damping=1e-3 * RATES, M=(1e-8, 1.0, 1e-8), t_end=200.0),
    WEAK.with_(name="needle, 1e-3", damping=1e-3 * RATES, M=(0.02, 1.0, 0.5), inertia=(1e-3, 1.0, 1.001)),
]
TABLES = [contact_method(table) for table in NEAR_INTEGRABLE]
OTHERS = ("contact-abc", "contact-bm6", "contact-o8", "heyoka-taylor", "cyrk-vern8", "cyrk-dop853")
ERRORS = (1e-3, 1e-6, 1e-9)
#: steps over the whole span, coarse to fine
STEPS = [round(5 * 2 ** (k / 2)) for k in range(21)]
#: seconds for which a call is repeated, of which the fastest counts; longer ones are not tried
REPEAT, LONGEST = 0.02, 5e-3


def fastest(run):
    end, best = perf_counter() + REPEAT, math.inf
    while perf_counter() < end:
        start = perf_counter()
        run.bare(run.start)
        best = min(best, perf_counter() - start)
    return best


def curve(scene, method):
    """(error, seconds) over the settings of a method."""
    for value in tolerances(method) if method.adaptive else [scene.t_end / n for n in STEPS]:
        run = cb.prepare(scene, method.name, save_at=[scene.t_end], carry=(), **{method.control: value})
        solution = run()
        if not solution.ok:
            continue
        seconds = fastest(run)
        yield cb.LAWS["solution_error"](solution), seconds
        if seconds > LONGEST:
            return


def main():
    for method in TABLES:
        cb.METHODS.add(method)
    for scene in SCENES:
        print(scene.name)
        found = {}
        for method in (*TABLES, *(cb.METHODS[name] for name in OTHERS)):
            points = list(curve(scene, method))
            found[method.name] = [
                min((s for e, s in points if e <= error), default=math.inf) for error in ERRORS
            ]
        least = [min(column) for column in zip(*found.values(), strict=True)]
        for name, seconds in found.items():
            marks = ["*" if s == best else " " for s, best in zip(seconds, least, strict=True)]
            print(f"  {name:14}", *(f"{1e6 * s:9.1f}{m}" for s, m in zip(seconds, marks, strict=True)))


if __name__ == "__main__":
    main()
