"""Claims about the numerical example, the 2-DOF damped particle (§6 of the paper)."""

from __future__ import annotations

from typing import Any

import numpy as np

from contactbench.claims.calculus import ROUND_OFF
from contactbench.claims.ledger import Evidence, at_least, at_most, claim
from contactbench.claims.orders import (
    ABC,
    BODY_STEPS,
    ENERGY_LADDER,
    ORDER,
    ORDER_MISS,
    ORDER_WHY,
    PAPER_STEP,
    PARTICLE,
    PRINTED,
    RK4,
    STRANG,
    body_error,
    energy_errors,
    slope,
)
from contactbench.measure.laws import LAWS
from contactbench.methods import solve
from contactbench.scenes import SCENES
from contactbench.truth import reference

WIDTH = 1e-2, "one per cent of the energy, a line's width in the paper's figure"


def particle_run(name: str, h: float, saves: int, **changes: Any) -> Any:
    """Return a run of the particle, without s, saved at so many equal intervals and at the start."""
    scene = SCENES[PARTICLE].with_(**changes)
    t = np.linspace(0, scene.t_end, saves + 1)
    return solve(scene, name, step=h, save_at=t, carry=(), engine="python")


@claim("C29")
def closeness(**changes: Any) -> Evidence:
    """changes : of the particle: ``gamma`` and the initial data, which the paper does not print."""
    printed, rk4 = (particle_run(name, PAPER_STEP, 200, **changes).y for name in (PRINTED, RK4))
    off = np.abs(printed - rk4).max() / np.abs(rk4).max()
    width = 1e-2, "one per cent of the amplitude, a line's width in the paper's figure"
    return Evidence([at_most("max |(q, p) − (q, p)_RK4| / max |(q, p)|", off, *width)])


def rises(name: str, gamma: float, h: float, **changes: Any) -> tuple[int, float]:
    """Return how many steps raise H0, and the largest rise over H0(0); T = 20."""
    run = particle_run(name, h, round(20 / h), gamma=gamma, **changes)
    energy = run.scene.energy(run.states())
    change = np.diff(energy) / energy[0]
    return int(np.count_nonzero(change > 4 * np.finfo(float).eps)), float(change.max())


def monotone_from(name: str, h: float) -> float:
    """Return the damping γ from which no step of h raises H0 of the particle, to 2 %; T = 20."""
    low, high = 1e-2 * h * h, 1e2 * h * h
    while high / low > 1.02:
        middle = (low * high) ** 0.5
        low, high = (middle, high) if rises(name, middle, h)[0] else (low, middle)
    return high


@claim("C30")
def monotone_methods(gamma: float = 0.1, weak: float = 1e-3, coarse: float = 0.1) -> Evidence:
    """gamma : with the paper's h.  weak, coarse : damping and step where H0 rises."""
    paper = {name: rises(name, gamma, PAPER_STEP) for name in (PRINTED, STRANG, RK4)}
    edges = {
        f"{name}, h = {h:g}": monotone_from(name, h) / (0.75 * h * h)
        for name in (PRINTED, STRANG)
        for h in (0.1, 0.05)
    }
    turning = rises(PRINTED, gamma, PAPER_STEP, q=(0.0, 1.0), p=(0.0, 0.0))
    rate = slope({h: rises(STRANG, 0.0, h)[1] for h in (0.2, 0.1, 0.05, 0.025)})
    weakly = {name: rises(name, weak, coarse)[0] for name in (PRINTED, STRANG, RK4)}
    at_rest = f"q₁ = p₁ = 0, γ = {gamma:g}, h = 0.01, contact-printed"
    found = 0.15, "the border is found to 2 %, and the printed order approaches the constant as h → 0"
    oscillation = ORDER_MISS, "the derivative of an oscillation of size h², over a step h"
    raising = "steps that raise H0"
    statement = [
        at_most(f"{raising} at γ = {gamma:g}, h = 0.01, {name}", n, 0, "monotone decay has none")
        for name, (n, _) in paper.items()
    ]
    corrected = [
        *(
            at_least(f"{raising} at γ = {weak:g}, h = {coarse:g}, {name}", weakly[name], 1, "not monotone")
            for name in (PRINTED, STRANG)
        ),
        at_most(f"the same, {RK4}", weakly[RK4], 0, "its own dissipation lowers H0 further"),
        *(
            at_most(f"|γ/(¾ h²) − 1| at the border of monotone decay, {run}", abs(edge - 1), *found)
            for run, edge in edges.items()
        ),
        at_least(f"{raising} from {at_rest}", turning[0], 1, "not monotone at the turning points"),
        at_most("largest of these rises over H0(0)", turning[1], PAPER_STEP**3, "O(h³)"),
        at_most("|power of h in the largest rise of a step at γ = 0 − 3|", abs(rate - 3), *oscillation),
    ]
    return Evidence(statement, corrected)


def balance_defect(name: str, h: float, gamma: float) -> float:
    """Return max |H0(t) − H0(0) + γ ∫‖p‖²| / H0(0), the integral by splines through every step."""
    from scipy.interpolate import make_interp_spline

    run = particle_run(name, h, round(20 / h), gamma=gamma)
    work = make_interp_spline(run.t, gamma * (run.y[:, 2:] ** 2).sum(axis=1), k=7).antiderivative()
    energy = run.scene.energy(run.states())
    return float(np.abs(energy - energy[0] + work(run.t) - work(0.0)).max() / energy[0])


@claim("C31")
def dissipation_law(gamma: float = 0.1) -> Evidence:
    ladder = min(1, gamma / 0.1) * np.array([0.025, 0.0125, 0.00625, 0.003125])  # h well below γ
    orders = {name: slope({h: balance_defect(name, h, gamma) for h in ladder}) for name in (PRINTED, STRANG)}
    defect = balance_defect(PRINTED, PAPER_STEP, gamma)
    statement = [at_most("max |H0(t) − H0(0) + γ∫‖p‖²|/H0(0), h = 0.01", defect, *WIDTH)]
    for name, order in ((PRINTED, 1), (STRANG, 2)):
        least = order - ORDER_MISS, f"its order is {order} (C25)"
        statement.append(at_least(f"order of this defect, {name}", orders[name], *least))
    return Evidence(statement)


@claim("C32")
def exponential_energy(**changes: Any) -> Evidence:
    """changes : of the particle, e.g. ``gamma``, ``q``, ``p``."""
    scene = SCENES[PARTICLE].with_(**changes)
    t = np.linspace(0, scene.t_end, 201)
    growing = np.exp(scene.gamma * t)
    truth = reference(scene, t).states()
    H0, H = (f(truth) * growing for f in (scene.energy, scene.hamiltonian))
    run = solve(scene, PRINTED, step=PAPER_STEP, save_at=t, carry=("s",), engine="python")
    numerical = scene.hamiltonian(run.states()) * growing
    of_H0, of_H, of_printed = (np.abs(value / value[0] - 1).max() for value in (H0, H, numerical))
    rounded = 1e-13, "the reference rounded to double precision; q, p and s decay as H does"
    statement = [at_most("read for H0: max |H0(t) e^{γt}/H0(0) − 1| of the truth", of_H0, *WIDTH)]
    corrected = [
        at_most("read for H: max |H(t) e^{γt}/H(0) − 1| of the truth", of_H, *rounded),
        at_most("the same of contact-printed, h = 0.01", of_printed, *WIDTH),
    ]
    return Evidence(statement, corrected)


NOMINAL = {PRINTED: 1, ABC: 2, STRANG: 2, RK4: 4}
READINGS = {"H0": "energy", "H": "hamiltonian"}  #: the caption's H is read both ways, as in C32


@claim("C33")
def convergence_orders(**changes: Any) -> Evidence:
    """changes : of the particle, e.g. ``gamma``, ``q``, ``p``."""
    scene = SCENES[PARTICLE].with_(**changes)
    orders = {
        (name, label): slope(energy_errors(name, scene, ENERGY_LADDER, energy))
        for label, energy in READINGS.items()
        for name in NOMINAL
    }
    statement, corrected = [], []
    for label in READINGS:
        quantity, least, most = f"order of the {label} error", 2 - ORDER_MISS, 2 + ORDER_MISS
        statement.append(at_least(f"{quantity}, {PRINTED}", orders[PRINTED, label], least, ORDER_WHY))
        statement.append(at_most(f"{quantity}, {RK4}", orders[RK4, label], most, ORDER_WHY))
    for (name, label), order in orders.items():
        nominal = NOMINAL[name]
        quantity = f"|order of the {label} error − {nominal}|, {name} (order {order:.2f})"
        corrected.append(at_most(quantity, abs(order - nominal), *ORDER))
    energy_error = max(body_error("energy_law_relative", name, 50) for name in (PRINTED, ABC))
    quantity = "max |H0(t) e^{2γt}/H0(0) − 1| of contact-printed and contact-abc on rigid_body, h = 0.4"
    corrected.append(at_most(quantity, energy_error, ROUND_OFF, "round-off of 50 steps"))
    for name in (PRINTED, ABC):
        order = slope({1 / n: body_error("solution_error", name, n) for n in BODY_STEPS})
        quantity = f"|order of the solution error − {NOMINAL[name]}| on rigid_body, {name}"
        corrected.append(at_most(quantity, abs(order - NOMINAL[name]), *ORDER))
    return Evidence(statement, corrected)


@claim("C34")
def contact_drifts(**changes: Any) -> Evidence:
    """changes : of the particle, e.g. ``gamma``, ``q``, ``p``."""
    scene, law = SCENES[PARTICLE].with_(**changes), LAWS["contact_drift"]
    end = {"save_at": [scene.t_end]}
    ours = max(law(solve(scene, name, step=0.1, **end)) for name in (PRINTED, ABC, STRANG))
    rk4, tsit5 = law(solve(scene, RK4, step=0.1, **end)), law(solve(scene, "diffrax-tsit5", rtol=1e-6, **end))
    rounding = ROUND_OFF, "round-off of 200 steps"
    above = 1e3 * ROUND_OFF, "a thousand times the bound the contact methods keep"
    statement = [
        at_most("largest contact_drift of the contact methods, h = 0.1", ours, *rounding),
        at_least("contact_drift of rk4, h = 0.1", rk4, *above),
        at_least("contact_drift of diffrax-tsit5, rtol 10⁻⁶", tsit5, *above),
    ]
    return Evidence(statement)


def nearest_return(points_: np.ndarray) -> float:
    """Return the distance from the start to the curve after it has left, relative to the size of the start.

    points_ : states along the curve, (k, d), close enough to be joined by straight lines.
    """
    start = points_[0]
    left = int(np.argmax(np.linalg.norm(points_ - start, axis=1) > np.linalg.norm(start)))
    a, b = points_[left:-1], points_[left + 1 :]
    along_ = np.clip(((start - a) * (b - a)).sum(axis=1) / ((b - a) ** 2).sum(axis=1), 0, 1)
    return float(np.linalg.norm(a + along_[:, None] * (b - a) - start, axis=1).min() / np.linalg.norm(start))


@claim("C35")
def conservative_limit(**changes: Any) -> Evidence:
    """changes : of the particle: ``q``, ``p``."""
    span, h = 20_000.0, 0.1
    free = SCENES[PARTICLE].with_(gamma=0.0, t_end=span, **changes)
    run = solve(free, PRINTED, step=h, save_at=np.arange(1, 40_001) * (span / 40_000), carry=())
    off = np.abs(free.energy(run.states()) / free.energy(free.initial(())) - 1)
    early, late = off[:20_000].max(), off[20_000:].max()

    def distance(name, **changes):
        """Return `nearest_return` of a scene without damping over T = 100."""
        scene = SCENES[name].with_(gamma=0.0, **changes)
        t = np.arange(0, 10001) * PAPER_STEP
        return nearest_return(solve(scene, PRINTED, step=PAPER_STEP, save_at=t, carry=(), engine="python").y)

    oscillates = h * h, "h²: the oscillation of a second-order symplectic method, with a constant of one"
    no_trend = 1.1, "a linear trend would double it"
    bounded = [
        at_most("max |H0/H0(0) − 1| over T = 20000 at h = 0.1", off.max(), *oscillates),
        at_most("the same over the second half of the run, over the first", late / early, *no_trend),
    ]
    particle, oscillator = distance(PARTICLE, **changes), distance("oscillator")
    special = distance(PARTICLE, q=(0.0, 0.5), p=(0.0, 0.3))
    closes = 1e-3, "ten times h² = 10⁻⁴ of the step used"
    statement = [*bounded, at_most("nearest return to the start over T = 100, particle", particle, *closes)]
    corrected = [
        *bounded,
        at_most("nearest return to the start over T = 100, oscillator", oscillator, *closes),
        at_most("the same, particle from q₁ = p₁ = 0", special, *closes),
    ]
    return Evidence(statement, corrected)
