"""Claims about the numerical example, the 2-DOF damped particle (§6 of the paper), and claims beyond the paper."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy  # its parts are loaded when first used

from contactbench.claims.calculus import ROUND_OFF
from contactbench.claims.integrator import (
    ABC,
    ORDER,
    ORDER_MISS,
    ORDER_WHY,
    PAPER_STEP,
    PARTICLE,
    PRINTED,
    RK4,
    STRANG,
    slope,
)
from contactbench.claims.ledger import CORRECTED, Evidence, at_least, at_most, claim
from contactbench.measure.laws import LAWS
from contactbench.measure.pullback import growth
from contactbench.measure.round_off import round_off_bound
from contactbench.methods import METHODS, solve
from contactbench.scene import Mechanical
from contactbench.scenes import SCENES
from contactbench.splitting.modified import modified_hamiltonian
from contactbench.truth import reference

WIDTH = 1e-2, "one per cent of the energy, a line's width in the paper's figure"


def numerical(scene: Any, method: str, step: float, count: int) -> Any:
    """Return a run without s, saved at `count` equal intervals, start included."""
    t = np.linspace(0, scene.t_end, count + 1)
    return solve(scene, method, step=step, save_at=t, carry=(), engine="python")


@claim("C29")
def closeness(**changes: Any) -> Evidence:
    printed, rk4 = (numerical(PARTICLE.with_(**changes), name, PAPER_STEP, 200).y for name in (PRINTED, RK4))
    off = np.abs(printed - rk4).max() / np.abs(rk4).max()
    width = 1e-2, "one per cent of the amplitude, a line's width in the paper's figure"
    yield at_most("max |(q, p) − (q, p)_RK4| / max |(q, p)|", off, *width)


def rises(name: str, gamma: float, h: float, **changes: Any) -> tuple[int, float]:
    """Return how many steps raise H0, and the largest rise over H0(0); T = 20."""
    run = numerical(PARTICLE.with_(gamma=gamma, **changes), name, h, round(20 / h))
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
    turning = rises(PRINTED, gamma, PAPER_STEP, q=(0.0, 1.0), p=(0.0, 0.0))
    at_rest = f"q₁ = p₁ = 0, γ = {gamma:g}, h = 0.01, contact-printed"
    found = 0.15, "the border is found to 2 %, and the printed order approaches the constant as h → 0"
    raising = "steps that raise H0"
    weakly = f"{raising} at γ = {weak:g}, h = {coarse:g}"
    for name in (PRINTED, STRANG, RK4):
        n, _ = rises(name, gamma, PAPER_STEP)
        yield at_most(f"{raising} at γ = {gamma:g}, h = 0.01, {name}", n, 0, "monotone decay has none")
    yield CORRECTED
    for name in (PRINTED, STRANG):
        yield at_least(f"{weakly}, {name}", rises(name, weak, coarse)[0], 1, "not monotone")
    rk4, _ = rises(RK4, weak, coarse)
    yield at_most(f"the same, {RK4}", rk4, 0, "its own dissipation lowers H0 further")
    for name in (PRINTED, STRANG):
        for h in (0.1, 0.05):
            edge = monotone_from(name, h) / (0.75 * h * h)
            at = f"at the border of monotone decay, {name}, h = {h:g}"
            yield at_most(f"|γ/(¾ h²) − 1| {at}", abs(edge - 1), *found)
    yield at_least(f"{raising} from {at_rest}", turning[0], 1, "not monotone at the turning points")
    yield at_most("largest of these rises over H0(0)", turning[1], PAPER_STEP**3, "O(h³)")


def balance_defect(name: str, h: float, gamma: float) -> float:
    """Return max |H0(t) − H0(0) + γ ∫‖p‖²| / H0(0), the integral by splines through every step."""
    run = numerical(PARTICLE.with_(gamma=gamma), name, h, round(20 / h))
    power = gamma * (run.y[:, 2:] ** 2).sum(axis=1)
    work = scipy.interpolate.make_interp_spline(run.t, power, k=7).antiderivative()
    energy = run.scene.energy(run.states())
    return float(np.abs(energy - energy[0] + work(run.t) - work(0.0)).max() / energy[0])


@claim("C31")
def dissipation_law(gamma: float = 0.1) -> Evidence:
    ladder = min(1, gamma / 0.1) * np.array([0.025, 0.0125, 0.00625, 0.003125])  # h well below γ
    defect = balance_defect(PRINTED, PAPER_STEP, gamma)
    yield at_most("max |H0(t) − H0(0) + γ∫‖p‖²|/H0(0), h = 0.01", defect, *WIDTH)
    for name, order in ((PRINTED, 1), (STRANG, 2)):
        found = slope({h: balance_defect(name, h, gamma) for h in ladder})
        yield at_least(
            f"order of this defect, {name}", found, order - ORDER_MISS, f"its order is {order} (C25)"
        )


@claim("C32")
def exponential_energy(**changes: Any) -> Evidence:
    scene = PARTICLE.with_(**changes)
    t = np.linspace(0, scene.t_end, 201)
    truth = reference(scene, t).states()
    run = solve(scene, PRINTED, step=PAPER_STEP, save_at=t, carry=("s",), engine="python")

    def deviation(energy: np.ndarray) -> float:
        growing = energy * np.exp(scene.gamma * t)
        return float(np.abs(growing / growing[0] - 1).max())

    of_H0, of_H = deviation(scene.energy(truth)), deviation(scene.hamiltonian(truth))
    of_printed = deviation(scene.hamiltonian(run.states()))
    rounded = 1e-13, "the reference rounded to double precision; q, p and s decay as H does"
    yield at_most("read for H0: max |H0(t) e^{γt}/H0(0) − 1| of the truth", of_H0, *WIDTH)
    yield CORRECTED
    yield at_most("read for H: max |H(t) e^{γt}/H(0) − 1| of the truth", of_H, *rounded)
    yield at_most("the same of contact-printed, h = 0.01", of_printed, *WIDTH)


NOMINAL = {PRINTED: 1, ABC: 2, STRANG: 2, RK4: 4}
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


def body_error(law: str, name: str, steps: int) -> float:
    """Return the error of a law at five times over the span of the body, which is run without R and s."""
    scene = SCENES["rigid_body"]
    t = scene.t_end * np.arange(1, 6) / 5
    return float(LAWS[law](solve(scene, name, step=scene.t_end / steps, save_at=t, carry=())))


@claim("C33")
def convergence_orders(**changes: Any) -> Evidence:
    scene = PARTICLE.with_(**changes)
    # the caption's H is read both ways, as in C32
    readings = {"H0": "energy", "H": "hamiltonian"}
    orders = {
        (name, label): slope(energy_errors(name, scene, ENERGY_LADDER, energy))
        for label, energy in readings.items()
        for name in NOMINAL
    }
    for label in readings:
        quantity, least, most = f"order of the {label} error", 2 - ORDER_MISS, 2 + ORDER_MISS
        yield at_least(f"{quantity}, {PRINTED}", orders[PRINTED, label], least, ORDER_WHY)
        yield at_most(f"{quantity}, {RK4}", orders[RK4, label], most, ORDER_WHY)
    yield CORRECTED
    for (name, label), order in orders.items():
        nominal = NOMINAL[name]
        quantity = f"|order of the {label} error − {nominal}|, {name} (order {order:.2f})"
        yield at_most(quantity, abs(order - nominal), *ORDER)
    energy_error = max(body_error("energy_law_relative", name, 50) for name in (PRINTED, ABC))
    quantity = "max |H0(t) e^{2γt}/H0(0) − 1| of contact-printed and contact-abc on rigid_body, h = 0.4"
    yield at_most(quantity, energy_error, ROUND_OFF, "round-off of 50 steps")
    for name in (PRINTED, ABC):
        order = slope({1 / n: body_error("solution_error", name, n) for n in (20, 40, 80, 160)})
        quantity = f"|order of the solution error − {NOMINAL[name]}| on rigid_body, {name}"
        yield at_most(quantity, abs(order - NOMINAL[name]), *ORDER)


@claim("C34")
def contact_drifts(**changes: Any) -> Evidence:
    scene, law = PARTICLE.with_(**changes), LAWS["contact_drift"]
    end = {"save_at": [scene.t_end]}
    ours = max(law(solve(scene, name, step=0.1, **end)) for name in (PRINTED, ABC, STRANG))
    rk4, tsit5 = law(solve(scene, RK4, step=0.1, **end)), law(solve(scene, "diffrax-tsit5", rtol=1e-6, **end))
    rounding = ROUND_OFF, "round-off of 200 steps"
    above = 1e3 * ROUND_OFF, "a thousand times the bound the contact methods keep"
    yield at_most("largest contact_drift of the contact methods, h = 0.1", ours, *rounding)
    yield at_least("contact_drift of rk4, h = 0.1", rk4, *above)
    yield at_least("contact_drift of diffrax-tsit5, rtol 10⁻⁶", tsit5, *above)


def nearest_return(curve: np.ndarray) -> float:
    """Return the distance from the start to the curve after it has left, relative to the size of the start.

    curve : states along it, (k, d), close enough to be joined by straight lines.
    """
    start = curve[0]
    left = int(np.argmax(np.linalg.norm(curve - start, axis=1) > np.linalg.norm(start)))
    a, b = curve[left:-1], curve[left + 1 :]
    along = np.clip(((start - a) * (b - a)).sum(axis=1) / ((b - a) ** 2).sum(axis=1), 0, 1)
    return float(np.linalg.norm(a + along[:, None] * (b - a) - start, axis=1).min() / np.linalg.norm(start))


@claim("C35")
def conservative_limit(**changes: Any) -> Evidence:
    span, h = 20_000.0, 0.1
    free = PARTICLE.with_(gamma=0.0, t_end=span, **changes)
    run = solve(free, PRINTED, step=h, save_at=np.arange(1, 40_001) * (span / 40_000), carry=())
    off = np.abs(free.energy(run.states()) / free.energy(free.initial(())) - 1)
    early, late = off[:20_000].max(), off[20_000:].max()

    def distance(scene, **changes):
        """Return `nearest_return` of a scene without damping over T = 100."""
        scene = scene.with_(gamma=0.0, **changes)
        t = np.arange(0, 10001) * PAPER_STEP
        return nearest_return(solve(scene, PRINTED, step=PAPER_STEP, save_at=t, carry=(), engine="python").y)

    oscillates = h * h, "h²: the oscillation of a second-order symplectic method, with a constant of one"
    no_trend = 1.1, "a linear trend would double it"
    bounded = at_most("max |H0/H0(0) − 1| over T = 20000 at h = 0.1", off.max(), *oscillates)
    steady = at_most("the same over the second half of the run, over the first", late / early, *no_trend)
    particle, oscillator = distance(PARTICLE, **changes), distance(SCENES["oscillator"])
    special = distance(PARTICLE, q=(0.0, 0.5), p=(0.0, 0.3))
    closes = 1e-3, "ten times h² = 10⁻⁴ of the step used"
    yield from (bounded, steady)
    yield at_most("nearest return to the start over T = 100, particle", particle, *closes)
    yield CORRECTED
    yield from (bounded, steady)
    yield at_most("nearest return to the start over T = 100, oscillator", oscillator, *closes)
    yield at_most("the same, particle from q₁ = p₁ = 0", special, *closes)


# -- beyond the paper: what the contact form implies over long times -------------------------------------
#: steps that divide the time between two saved states
BETWEEN = 0.4
LADDER = tuple(BETWEEN / n for n in (2, 3, 4, 5, 6))


def deviations(degree: int, **changes: Any) -> dict[float, float]:
    """Return max |H̃e^{γt}/H̃(y₀) − 1| of contact-strang against the step; H̃ has brackets of up to `degree` parts."""
    scene, composition = PARTICLE.with_(**changes), METHODS[STRANG].composition
    found = {}
    for h in LADDER:
        run = solve(scene, STRANG, step=h, save_at=BETWEEN * np.arange(1, 51))
        states = run.states(), run.start()
        value, start = (modified_hamiltonian(scene, composition, x, h, degree) for x in states)
        found[h] = float(np.abs(value * np.exp(scene.gamma * run.t) / start - 1).max())
    return found


def halves(method: str, law: str, gamma: float, steps: int) -> tuple[float, float]:
    """Return the largest deviation from a law in the first half of a run with h = 0.1, and in the second."""
    scene = PARTICLE.with_(gamma=gamma, t_end=0.1 * steps)
    run = solve(scene, method, step=0.1, save_at=scene.t_end * np.arange(1, 4001) / 4000)
    size = LAWS[law].along(run).size  # type: ignore[union-attr]
    return float(size[:2000].max()), float(size[2000:].max())


@claim("X01")
def near_conservation(gamma: float = 0.1, weak: float = 1e-5, steps: int = 1_000_000) -> Evidence:
    """gamma : of the orders.  weak, steps : damping and length of the long run."""
    for what, degree, expected in (("H", 1, 2), ("H + h² H₂", 3, 4), ("H + h² H₂ + h⁴ H₄", 5, 6)):
        quantity = f"|order − {expected}| of the deviation of {what} from e^{{−γt}}, γ = {gamma:g}"
        yield at_most(quantity, abs(slope(deviations(degree, gamma=gamma)) - expected), *ORDER)
    early, late = halves(STRANG, "modified_hamiltonian", weak, steps)
    plain, plain_late = halves(STRANG, "hamiltonian_law", weak, steps)
    drifting, drifted = halves(RK4, "hamiltonian_law", weak, steps)
    no_drift = 1.1, "a linear drift would double it"
    fourth_order = 1e-3, "h⁴ = 10⁻⁴ times a constant of ten"
    halves_of = f"deviation of H̃ up to h⁴ in the second half of {steps:.0e} steps over that in the first"
    yield at_most(halves_of, late / early, *no_drift)
    yield at_most("the same of H", plain_late / plain, *no_drift)
    yield at_most("deviation of H̃ up to h⁴ over that of H", late / plain_late, *fourth_order)
    yield at_least(
        "the same halves of H under rk4", drifted / drifting, 1.5, "a drift, linear until it bends"
    )


STEPS, PEERS = (0.4, 0.2, 0.1, 0.05, 0.025), ("cyrk-dop853", "cyrk-vern8", "cyrk-tsit5")


def pairing(method: str, **setting: float) -> tuple[float, float]:
    """Return pairing_drift of a run of the chaotic scene, its steps held fixed, and the bound of its round-off."""
    scene = SCENES["duffing"]
    run = solve(scene, method, save_at=scene.t_end * np.arange(1, 6) / 5, **setting)
    drift = float(LAWS["pairing_drift_frozen"](run))
    return drift, round_off_bound(growth(run.frozen_differential), run.counts.evaluations or 0)


@claim("X02")
def pairs_kept(rough: float = 1e-4, fine: float = 1e-8) -> Evidence:
    """rough, fine : tolerances of the solvers that choose their steps."""
    kept = [pairing(name, step=h) for name in (STRANG, "contact-rkn4", "contact-rkn6") for h in STEPS]
    herglotz, rk4 = ({h: pairing(name, step=h)[0] for h in STEPS} for name in ("herglotz2", RK4))
    peers = {rtol: [pairing(name, rtol=rtol)[0] for name in PEERS] for rtol in (rough, fine)}
    worst, ratio = max(drift / bound for drift, bound in kept), min(peers[rough]) / max(peers[fine])
    rounding = 1, "ε times evaluations and growth of the map"
    own_factor = ORDER_MISS, "its own factor is (1 − γh/2)/(1 + γh/2)"
    above = 1e-11, "a hundred times the round-off of the contact methods"
    ours = "pairing_drift over the bound of its round-off, the largest of the contact methods at all steps"
    smallest = "smallest pairing_drift at rtol = "
    yield at_most(ours, worst, *rounding)
    yield at_most("|order of pairing_drift − 2|, herglotz2", abs(slope(herglotz) - 2), *own_factor)
    yield at_least("pairing_drift of rk4 at its finest step", rk4[min(STEPS)], *above)
    yield at_least(f"{smallest}{fine:g}, {', '.join(PEERS)}", min(peers[fine]), *above)
    yield at_least(f"{smallest}{rough:g} over the largest at {fine:g}", ratio, 10, "it follows the tolerance")
