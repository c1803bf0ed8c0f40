"""Orders of convergence behind the claims: in 50 digits where round-off would hide the slope."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import scipy  # its parts are loaded when first used

from contactbench.measure.laws import LAWS
from contactbench.measure.order import fit_order
from contactbench.methods import METHODS, solve
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.fixed_step_run import trajectory
from contactbench.scene import Mechanical, State
from contactbench.scenes import SCENES
from contactbench.truth import decimal_context, reference, with_decimals

PARTICLE = "particle"
PRINTED, ABC, STRANG, RK4 = "contact-printed", "contact-abc", "contact-strang", "rk4"
DIGITS = 50
#: a fitted order may miss the nominal one by this much at the step sizes used
ORDER_MISS = 0.1
ORDER_WHY = "the next term of the error bends the slope by a few per cent at the steps used"
ORDER = ORDER_MISS, ORDER_WHY
PAPER_STEP = 0.01
#: errors of H0 in double precision below this are round-off of some 10⁴ steps; 50-digit errors stay above
ENERGY_FLOOR = 1e-12


# -- orders in high precision ----------------------------------------------------------------------
def gap(a: Sequence[Any], b: Sequence[Any]) -> Any:
    """Return max |a − b|."""
    return max(abs(x - y) for x, y in zip(a, b, strict=True))


def exact_numbers(scene: Mechanical) -> tuple[Any, Any]:
    """Return a 50-digit number namespace, and the scene with such numbers."""
    context = decimal_context(DIGITS)
    return context, with_decimals(scene, context.mpf)


END, LADDER = 4, (32, 64, 128, 256)


def exact_errors(method: FixedStep, **changes: Any) -> dict[float, float]:
    """Return max ‖(q, p) − true‖ over t = 1, …, 4 against the step, everything in 50 digits.

    changes : of the particle, e.g. ``gamma``; its truth then costs a second or two.
    """
    scene = SCENES[PARTICLE].with_(**changes)
    context, twin = exact_numbers(scene)
    truth = [[context.mpf(x) for x in row] for row in reference(scene, range(1, END + 1), ()).decimals]
    errors = {}
    for n in LADDER:
        h = context.mpf(1) / n
        states = trajectory(method, twin, twin.initial(()), [(h, n)] * END, context)
        errors[1 / n] = float(max(gap(twin.pack(x), y) for x, y in zip(states, truth, strict=True)))
    return errors


def slope(errors: dict[float, float]) -> float:
    """Return the order, fitted over the asymptotic range."""
    return fit_order(list(errors), list(errors.values()), ENERGY_FLOOR).order


def asymmetry(name: str, **changes: Any) -> float:
    """Return |Φ_{−h} Φ_h x − x| in 50 digits for one step of h = 1/10."""
    context, twin = exact_numbers(SCENES[PARTICLE].with_(**changes))
    x, h = twin.initial(("s",)), context.mpf(1) / 10
    method = METHODS[name]
    back = method.advance(twin, method.advance(twin, x, h, 1, context), -h, 1, context)
    return float(gap(twin.pack(back), twin.pack(x)))


ENERGY_LADDER = (16, 32, 64, 128, 256, 512)  #: steps per unit of time


def energy_errors(
    name: str, scene: Mechanical, counts: Sequence[int], energy: str = "energy"
) -> dict[float, float]:
    """Return the paper's measure, max |E − E*| over 20 equal times, against the step (double precision).

    energy : "energy" for H0, "hamiltonian" for H.
    """
    carry = ("s",) if energy == "hamiltonian" else ()
    value = getattr(scene, energy)
    t = scene.t_end * np.arange(1, 21) / 20
    truth = value(reference(scene, t, carry).states())
    errors = {}
    for n in counts:
        h = scene.t_end / (20 * n)
        run = solve(scene, name, step=h, save_at=t, carry=carry, engine="python")
        errors[h] = float(np.abs(value(run.states()) - truth).max())
    return errors


BODY, BODY_STEPS = "rigid_body", (20, 40, 80, 160)


def body_error(law: str, name: str, steps: int) -> float:
    """Return the error of a law at five times over the span of the body, which is run without R and s."""
    scene = SCENES[BODY]
    t = scene.t_end * np.arange(1, 6) / 5
    return float(LAWS[law](solve(scene, name, step=scene.t_end / steps, save_at=t, carry=())))


LOCAL_STEPS = (0.008, 0.004, 0.002, 0.001)


def local_errors(
    name: str, scene: Mechanical, measures: Sequence[Callable[[Any], Any]], starts: np.ndarray
) -> list[dict[float, float]]:
    """Return the error of each measure of the state after one step from `starts` (k, 5), against the step.

    The truth is integrated with SciPy's DOP853 at a tolerance of 10⁻¹³, far below these errors.
    """

    def state(y: np.ndarray) -> State:
        return scene.unpack(tuple(y.reshape(-1, 5).T), ("s",))

    def rate(_: float, y: np.ndarray) -> np.ndarray:
        return np.stack(scene.pack(scene.rhs(state(y)))).T.ravel()

    times, solver = sorted(LOCAL_STEPS), {"method": "DOP853", "rtol": 1e-13, "atol": 1e-15}
    run = scipy.integrate.solve_ivp(rate, (0, times[-1]), starts.ravel(), t_eval=times, **solver)
    found: list[dict[float, float]] = [{} for _ in measures]
    for h, y in zip(times, run.y.T, strict=True):
        after = METHODS[name].advance(scene, state(starts), h, 1, np)
        for errors, measure in zip(found, measures, strict=True):
            errors[h] = float(np.abs(measure(after) - measure(state(y))).max())
    return found
