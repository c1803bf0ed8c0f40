"""Claims beyond the paper: what the contact form implies over long times, measured as its own claims are."""

from __future__ import annotations

from typing import Any

import numpy as np

from contactbench.claims.integrator import ORDER, ORDER_MISS, PARTICLE, RK4, STRANG, slope
from contactbench.claims.ledger import Evidence, at_least, at_most, claim
from contactbench.measure.laws import LAWS
from contactbench.measure.pullback import growth
from contactbench.measure.round_off import round_off_bound
from contactbench.methods import METHODS, solve
from contactbench.scenes import SCENES
from contactbench.splitting.modified import modified_hamiltonian

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
