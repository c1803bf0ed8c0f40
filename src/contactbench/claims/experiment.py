"""Claims about the numerical example, the 2-DOF damped particle (§6 of the paper)."""

from __future__ import annotations

from typing import Any

import numpy as np

from contactbench.claims.calculus import ROUND_OFF
from contactbench.claims.integrator import (
    ABC,
    ENERGY_LADDER,
    ORDER_MISS,
    ORDER_WHY,
    PAPER_STEP,
    PARTICLE,
    PRINTED,
    RK4,
    STRANG,
    energy_errors,
    slope,
)
from contactbench.claims.ledger import Correction, Evidence, at_least, at_most, claim
from contactbench.measure.laws import LAWS
from contactbench.methods import solve
from contactbench.scenes import SCENES
from contactbench.truth import reference


def paper_run(name: str, **changes: Any) -> Any:
    """The experiment of §6, saved at every tenth step."""
    scene = SCENES[PARTICLE].with_(**changes)
    return solve(
        scene, name, step=PAPER_STEP, save_at=np.linspace(0, scene.t_end, 201), carry=(), engine="python"
    )


@claim(
    "C29",
    "§6 Results",
    "The splitting integrator closely matches RK4 in q(t) and p(t).",
    scene="particle, h = 0.01, T = 20",
    method="contact-printed against rk4",
)
def closeness() -> Evidence:
    printed, rk4 = paper_run(PRINTED).y, paper_run(RK4).y
    size = np.abs(rk4).max()
    return Evidence(
        [
            at_most(
                "max |(q, p) − (q, p)_RK4| / max |(q, p)|",
                np.abs(printed - rk4).max() / size,
                1e-2,
                "one per cent of the amplitude, a line's width in the paper's figure",
            )
        ]
    )


def rises(name: str, gamma: float, h: float) -> tuple[int, float]:
    """How many steps raise H0, and the largest rise over H0(0); T = 20."""
    scene = SCENES[PARTICLE].with_(gamma=gamma)
    run = solve(scene, name, step=h, save_at=h * np.arange(0, round(20 / h) + 1), carry=(), engine="python")
    energy = scene.energy(run.states())
    change = np.diff(energy) / energy[0]
    return int(np.count_nonzero(change > 4 * np.finfo(float).eps)), float(change.max())


@claim(
    "C30",
    "§6 Energy decay",
    "Both methods decay H0 monotonically.",
    kind=Correction.repairs,
    correction="At γ = 0.1 and the paper's h they do. For weak damping and coarse steps the splitting "
    "methods raise H0 near the turning points, where −γ‖p‖² vanishes but the O(h²) oscillation "
    "of H0 does not; the rise shrinks as h³.",
    scene="particle, γ = 10⁻³, h = 0.1; γ = 0.1, h = 0.01",
    method="contact-printed, contact-strang, rk4",
)
def monotone_methods() -> Evidence:
    weak = {name: rises(name, 1e-3, 0.1) for name in (PRINTED, STRANG, RK4)}
    paper = {name: rises(name, 0.1, PAPER_STEP) for name in (PRINTED, STRANG, RK4)}
    rate = slope({h: rises(STRANG, 0.0, h)[1] for h in (0.2, 0.1, 0.05, 0.025)})
    return Evidence(
        [
            at_most(
                f"steps that raise H0, {name}, γ = 10⁻³, h = 0.1", weak[name][0], 0, "monotone decay has none"
            )
            for name in weak
        ],
        [
            at_most(
                "steps that raise H0 at γ = 0.1, h = 0.01, all three",
                max(n for n, _ in paper.values()),
                0,
                "monotone decay has none",
            ),
            at_most(
                "|power of h in the largest rise of a step at γ = 0 − 3|",
                abs(rate - 3),
                ORDER_MISS,
                "the derivative of an oscillation of size h², over a step h",
            ),
        ],
    )


def balance_defect(name: str, h: float) -> float:
    """max |H0(t) − H0(0) + γ ∫‖p‖²| / H0(0), the integral by splines through every step."""
    from scipy.interpolate import make_interp_spline

    scene = SCENES[PARTICLE]
    t = h * np.arange(0, round(20 / h) + 1)
    run = solve(scene, name, step=h, save_at=t, carry=(), engine="python")
    work = make_interp_spline(t, scene.gamma * (run.y[:, 2:] ** 2).sum(axis=1), k=7).antiderivative()
    energy = scene.energy(run.states())
    return float(np.abs(energy - energy[0] + work(t) - work(0.0)).max() / energy[0])


@claim(
    "C31",
    "eq:dH0dt",
    "H0' = −γ‖p‖² is reproduced to high accuracy.",
    scene="particle, h = 0.01, T = 20",
    method="contact-printed; order: also contact-strang",
)
def dissipation_law() -> Evidence:
    ladder = (0.025, 0.0125, 0.00625, 0.003125)
    orders = {name: slope({h: balance_defect(name, h) for h in ladder}) for name in (PRINTED, STRANG)}
    return Evidence(
        [
            at_most(
                "max |H0(t) − H0(0) + γ∫‖p‖²|/H0(0), h = 0.01",
                balance_defect(PRINTED, PAPER_STEP),
                1e-2,
                "one per cent of the energy, a line's width in the paper's figure",
            ),
            at_least(
                "order of this defect, contact-printed",
                orders[PRINTED],
                1 - ORDER_MISS,
                "its order is 1 (C25)",
            ),
            at_least(
                "order of this defect, contact-strang", orders[STRANG], 2 - ORDER_MISS, "its order is 2 (C25)"
            ),
        ]
    )


@claim(
    "C32",
    "fig7 left",
    "H0 of the particle follows an exact exponential law.",
    kind=Correction.replaces,
    correction="H follows one, H(t) = H(0) e^{−γt}, and H0 of the isotropic body does. H0 of a particle in "
    "a potential loses energy at −γ‖p‖², which stops at every turning point: it swings about "
    "e^{−γt}.",
    scene="particle, γ = 0.1, T = 20",
    figures=("paper_7",),
)
def exponential_energy() -> Evidence:
    scene = SCENES[PARTICLE]
    t = np.linspace(0, scene.t_end, 201)
    truth = reference(scene, t).states()
    H0, H = (f(truth) * np.exp(scene.gamma * t) for f in (scene.energy, scene.hamiltonian))
    return Evidence(
        [
            at_most(
                "max |H0(t) e^{γt}/H0(0) − 1| of the truth",
                np.abs(H0 / H0[0] - 1).max(),
                1e-2,
                "one per cent of the energy, a line's width in the paper's figure",
            )
        ],
        [
            at_most(
                "max |H(t) e^{γt}/H(0) − 1| of the truth",
                np.abs(H / H[0] - 1).max(),
                1e-13,
                "the reference rounded to double precision, times e^{γT} = 7.4",
            )
        ],
    )


NOMINAL = {PRINTED: 1, ABC: 2, STRANG: 2, RK4: 4}


@claim(
    "C33",
    "fig7 right",
    "Both integrators, the splitting and RK4, converge with second order in H0.",
    kind=Correction.replaces,
    correction="RK4 is of order 4; the splitting as printed of order 1; its palindromic forms of order 2.",
    scene="particle, γ = 0.1, T = 20",
    method="contact-printed, contact-abc, contact-strang, rk4",
    figures=("paper_7",),
)
def convergence_orders() -> Evidence:
    scene = SCENES[PARTICLE]
    orders = {name: slope(energy_errors(name, scene, ENERGY_LADDER)) for name in NOMINAL}
    return Evidence(
        [
            at_least("order of the H0 error, contact-printed", orders[PRINTED], 2 - ORDER_MISS, ORDER_WHY),
            at_most("order of the H0 error, rk4", orders[RK4], 2 + ORDER_MISS, ORDER_WHY),
        ],
        [
            at_most(
                f"|order of the H0 error − {nominal}|, {name} (order {orders[name]:.2f})",
                abs(orders[name] - nominal),
                ORDER_MISS,
                ORDER_WHY,
            )
            for name, nominal in NOMINAL.items()
        ],
    )


@claim(
    "C34",
    "fig7 caption",
    "Only the geometric method preserves the contact structure.",
    scene="particle, T = 20",
    method="contact-* and rk4 at h = 0.1, diffrax-tsit5 at rtol 10⁻⁶",
)
def contact_drifts() -> Evidence:
    scene, law = SCENES[PARTICLE], LAWS["contact_drift"]
    end = {"save_at": [scene.t_end]}
    ours = max(law(solve(scene, name, step=0.1, **end)) for name in (PRINTED, ABC, STRANG))
    why = "a thousand times the bound the contact methods keep"
    return Evidence(
        [
            at_most(
                "largest contact_drift of the contact methods, h = 0.1",
                ours,
                ROUND_OFF,
                "round-off of 200 steps",
            ),
            at_least(
                "contact_drift of rk4, h = 0.1", law(solve(scene, RK4, step=0.1, **end)), 1e3 * ROUND_OFF, why
            ),
            at_least(
                "contact_drift of diffrax-tsit5, rtol 10⁻⁶",
                law(solve(scene, "diffrax-tsit5", rtol=1e-6, **end)),
                1e3 * ROUND_OFF,
                why,
            ),
        ]
    )


def nearest_return(points_: np.ndarray) -> float:
    """Distance from the start to the curve after it has left, relative to the size of the start.

    points_ : states along the curve, (k, d), close enough to be joined by straight lines.
    """
    start = points_[0]
    left = int(np.argmax(np.linalg.norm(points_ - start, axis=1) > np.linalg.norm(start)))
    a, b = points_[left:-1], points_[left + 1 :]
    along_ = np.clip(((start - a) * (b - a)).sum(axis=1) / ((b - a) ** 2).sum(axis=1), 0, 1)
    return float(np.linalg.norm(a + along_[:, None] * (b - a) - start, axis=1).min() / np.linalg.norm(start))


@claim(
    "C35",
    "§6 Conservative limit, fig8",
    "At γ = 0 there is no artificial dissipation: the energy stays bounded and the orbits of the 2-DOF "
    "particle are closed.",
    kind=Correction.repairs,
    correction="The energy stays bounded over long times. The orbit does not close: only the 1-DOF "
    "oscillator's does.",
    scene="particle and oscillator, γ = 0",
    method=PRINTED,
    figures=("paper_8",),
)
def conservative_limit() -> Evidence:
    span, h = 20_000.0, 0.1
    free = SCENES[PARTICLE].with_(gamma=0.0, t_end=span)
    run = solve(free, PRINTED, step=h, save_at=np.arange(1, 40_001) * (span / 40_000), carry=())
    off = np.abs(free.energy(run.states()) / free.energy(free.initial(())) - 1)
    early, late = off[:20_000].max(), off[20_000:].max()

    def returned(name):
        scene = SCENES[name].with_(gamma=0.0)
        t = np.arange(0, 10001) * PAPER_STEP
        return nearest_return(solve(scene, PRINTED, step=PAPER_STEP, save_at=t, carry=(), engine="python").y)

    bounded = [
        at_most(
            "max |H0/H0(0) − 1| over T = 20000 at h = 0.1",
            off.max(),
            h * h,
            "h²: the oscillation of a second-order symplectic method, with a constant of one",
        ),
        at_most(
            "the same over the second half of the run, over the first",
            late / early,
            1.1,
            "a linear trend would double it",
        ),
    ]
    closes = 1e-3, "ten times h² = 10⁻⁴ of the step used"
    return Evidence(
        [
            *bounded,
            at_most("nearest return to the start over T = 100, particle", returned(PARTICLE), *closes),
        ],
        [
            *bounded,
            at_most("nearest return to the start over T = 100, oscillator", returned("oscillator"), *closes),
        ],
    )
