"""Claims about momentum maps and reduction (§3 of the paper)."""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from contactbench.claims.calculus import (
    ROUND_OFF,
    along,
    function_of,
    largest,
    points,
    vector_field,
)
from contactbench.claims.geometry import SOLVER, SOLVER_BOUND, SOLVER_WHY, TRUTH, TRUTH_WHY
from contactbench.claims.ledger import Evidence, at_least, at_most, claim
from contactbench.scenes import SCENES
from contactbench.truth import reference


def times(scene):
    """201 equal times, the grid of the frozen references."""
    return np.linspace(0, scene.t_end, 201)


def momenta(scene):
    """J along the truth, shape (201, m)."""
    return np.array(scene.momentum(reference(scene, times(scene)).states())).T


@claim(
    "C11",
    "eq:momentum-decay-general, eq:J-decay-solution, fig3",
    "For a symmetry of H the momentum decays: J' = −R(H) J, J(t) = e^{−λt} J(0).",
    scene="central, rigid_body; central with γ s + ½ κ s²",
    figures=("paper_3",),
)
def momentum_decay() -> Evidence:
    def deviation(name):
        scene = SCENES[name]
        J = momenta(scene)
        scaled = J * np.exp(scene.conformal_rate * times(scene))[:, None]
        return np.linalg.norm(scaled - J[0], axis=1).max() / np.linalg.norm(J[0])

    nonlinear = SCENES["central"].with_(kappa=0.3)
    momentum = function_of(lambda x: nonlinear.momentum(x)[0])

    def defect(y):
        return along(vector_field(nonlinear), momentum, y) + nonlinear.dissipation_rate(y[4]) * momentum(y)

    return Evidence(
        [
            at_most(
                "max ‖J e^{λt} − J(0)‖/‖J(0)‖ along the true central", deviation("central"), TRUTH, TRUTH_WHY
            ),
            at_most("the same for the true rigid body, J = R M", deviation("rigid_body"), TRUTH, TRUTH_WHY),
            at_most(
                "max |J' + Γ'(s) J| for Γ = γ s + ½ κ s²",
                largest(defect, points(5)),
                10 * ROUND_OFF,
                "round-off of AD on forces of size up to 100",
            ),
        ]
    )


@claim(
    "C12",
    "eq:level-set-not-invariant",
    "J⁻¹(μ) is not invariant for λ ≠ 0, unless μ = 0.",
    scene="central, λ = 0 and 0.1",
)
def level_sets() -> Evidence:
    damped = SCENES["central"]

    def change(scene):
        J = momenta(scene)[:, 0]
        return np.abs(J - J[0]).max() / (abs(J[0]) or 1.0)

    why = "far above the uncertainty 10⁻¹³ of the truth"
    return Evidence(
        [
            at_least("max |J(t) − J(0)|/|J(0)| at λ = 0.1", change(damped), 1e-3, why),
            at_most("the same at λ = 0", change(damped.with_(gamma=0.0)), TRUTH, TRUTH_WHY),
            at_most("max |J(t)| at λ = 0.1, J(0) = 0", change(damped.with_(p=(0.3, 0.0))), TRUTH, TRUTH_WHY),
        ]
    )


@claim(
    "C13",
    "eq:time-dependent-level",
    "One may reduce along the decaying level μ(t) = e^{−λt} μ0.",
    scene="central in polar coordinates",
    method="SciPy DOP853, rtol 10⁻¹³, on the reduced equations",
)
def time_dependent_reduction() -> Evidence:
    scene = SCENES["central"]
    t = times(scene)
    full = reference(scene, t, ()).states()
    radius = np.hypot(*full.q)
    radial = (full.q[0] * full.p[0] + full.q[1] * full.p[1]) / radius
    mu = scene.momentum(scene.initial(()))[0]

    def reduced(t, y):
        """H_μ = ½ (p_r² + μ(t)²/r²) + V(r), with γ s: the contact equations of (r, p_r) alone."""
        r, p_r = y
        level = mu * np.exp(-scene.gamma * t)
        return [p_r, level**2 / r**3 - scene.dV((r, 0.0))[0] - scene.gamma * p_r]

    run = solve_ivp(reduced, (0, scene.t_end), [radius[0], radial[0]], t_eval=t, **SOLVER)
    error = np.hypot(run.y[0] - radius, run.y[1] - radial).max() / np.hypot(radius, radial).max()
    return Evidence([at_most("max ‖(r, p_r) reduced − full‖ / max ‖full‖", error, SOLVER_BOUND, SOLVER_WHY)])
