"""Claims about the integrators (§5 of the paper, and its abstract)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from contactbench.claims.calculus import (
    IDENTITY,
    ROUND_OFF,
    SEED,
    canonical,
    contact_equations,
    eta,
    everywhere,
    largest,
    one_step,
    packed,
    points,
    pullback,
)
from contactbench.claims.ledger import Correction, Evidence, at_least, at_most, claim
from contactbench.claims.orders import (
    ABC,
    ORDER_MISS,
    ORDER_WHY,
    PAPER_STEP,
    PARTICLE,
    PRINTED,
    STRANG,
    asymmetry,
    exact_errors,
    local_errors,
    slope,
)
from contactbench.claims.rigid_body import body_flow_defect
from contactbench.measure.laws import LAWS
from contactbench.methods import METHODS, solve
from contactbench.methods.step_map import trajectory
from contactbench.scene import Mechanical
from contactbench.scenes import SCENES
from contactbench.splitting.flows import MECHANICAL, Flow
from contactbench.xla import jax, jnp


# -- subflows and compositions ---------------------------------------------------------------------
def flow_map(flow: Flow, scene: Mechanical) -> Any:
    """(h, y) ↦ φ_h(y)."""
    return lambda h, y: packed(flow.apply(scene, canonical(y), flow.constants(scene, h, jnp), jnp))


def flow_defect(flow: Any, hamiltonian: Any, seed: int) -> float:
    """max |dφ_h/dh − X_H(φ_h)|/(1 + |φ_h|) and |φ_0 − id| at random points and h: 0 for the exact flow."""
    field = contact_equations(hamiltonian)

    def defect(point):
        h, y = point[0], point[1:]
        value, rate = jax.jvp(lambda h: flow(h, y), (h,), (1.0,))
        size = 1 + jnp.abs(value).max()
        return jnp.append((rate - field(value)) / size, flow(0.0, y) - y)

    return largest(defect, points(6, seed=seed))


@claim(
    "C24",
    "§5.2, eqs. (82)–(84)",
    "The three subflows are the exact contact flows of T, V and γ s.",
    kind=Correction.extends,
    scene=PARTICLE,
    method="the subflows of contact-*",
    correction="A's update s += h T(p) needs T homogeneous of degree two; in general s += h (p·∂T/∂p − T). On "
    "T*SO(3) × R the flow A is the free rigid body, exact by elliptic functions. For Γ(s) = γs + ½κs² the flow C is "
    "a Möbius map of s, and A and C together have a flow of their own there too.",
)
def subflows(seed: int = SEED, gamma: float = 0.1, kappa: float = 0.05) -> Evidence:
    """kappa : of the quadratic damping that what goes beyond the claim is measured with."""
    scene = SCENES[PARTICLE].with_(gamma=gamma)
    parts = {
        "A (drift)": ("drift", lambda x: scene.kinetic(x.p)),
        "B (kick)": ("kick", lambda x: scene.V(x.q)),
        "C (damp)": ("damp", lambda x: scene.gamma * x.s),
        "A and C together (drift_damp)": ("drift_damp", lambda x: scene.kinetic(x.p) + scene.gamma * x.s),
    }
    exact = [
        at_most(
            f"max |dφ_h/dh − X(φ_h)|/(1 + |φ_h|), |φ_0 − id|: {label}",
            flow_defect(flow_map(MECHANICAL[name], scene), lambda y, H=part: H(canonical(y)), seed),
            *IDENTITY,
        )
        for label, (name, part) in parts.items()
    ]

    def contact_defect(name, factor):
        flow = flow_map(MECHANICAL[name], scene)
        return largest(
            lambda y: pullback(lambda z: flow(0.7, z), eta, y) - factor * eta(y), points(5, seed=seed)
        )

    decay = math.exp(-scene.gamma * 0.7)
    contact = max(contact_defect(*part) for part in (("kick", 1.0), ("drift", 1.0), ("damp", decay)))

    def quartic(y):
        return jnp.sum(y[2:4] ** 4) / 4

    def drift(general):
        def flow(h, y):
            T, p_T = quartic(y), jnp.sum(y[2:4] ** 4)
            return jnp.concatenate(
                [y[:2] + h * y[2:4] ** 3, y[2:4], jnp.array([y[4] + h * (p_T - T if general else T)])]
            )

        return flow

    curved = scene.with_(kappa=kappa)
    dissipated = {
        "C": ("damp", lambda x: curved.dissipation(x.s)),
        "A and C together": ("drift_damp", lambda x: curved.kinetic(x.p) + curved.dissipation(x.s)),
    }
    statement = [*exact, at_most("max |φ_h*η − e^{−γh}η| (A, B: factor 1)", contact, *IDENTITY)]
    corrected = [
        *(
            at_most(f"the same defect on T*SO(3) × R: {label}", body_flow_defect(name, seed), *IDENTITY)
            for label, name in (("A (free)", "free"), ("C (damp)", "damp"))
        ),
        *(
            at_most(
                f"the same defect with Γ = γs + ½κs², κ = {kappa:g}: {label}",
                flow_defect(flow_map(MECHANICAL[name], curved), lambda y, H=part: H(canonical(y)), seed),
                *IDENTITY,
            )
            for label, (name, part) in dissipated.items()
        ),
        at_most(
            "A with s += h (p·T_p − T) for T = ¼ Σ p⁴",
            flow_defect(drift(True), quartic, seed),
            10 * ROUND_OFF,
            "round-off of AD on numbers of size up to 100",
        ),
        at_least(
            "A as printed, s += h T, for the same T",
            flow_defect(drift(False), quartic, seed),
            1e-3,
            "far above round-off: it is not the flow",
        ),
    ]
    return Evidence(statement, corrected)


@claim(
    "C25",
    "§5.2, eq. (85)",
    "Φ_h = B½ A C B½ is symmetric and second order.",
    kind=Correction.replaces,
    correction="For γ > 0 it is first order and not time-symmetric, because A and C do not commute. The "
    "palindrome B½ A½ C A½ B½ is symmetric and second order; so is B½ (AC) B½ with the exact "
    "joint flow of A and C. This replaces the claim and does not repair it: the claim is about this composition, "
    "printed and drawn (Figure 6), and another takes its place; what is said of the integrator, in whatever order of "
    "flows, survives (C27).",
    scene=PARTICLE,
    method="contact-printed; corrected: contact-abc, contact-strang",
)
def printed_composition(**changes: Any) -> Evidence:
    """changes : of the particle, e.g. ``gamma``."""
    palindromes = [METHODS[name] for name in (ABC, STRANG)]
    statement = [
        at_least(
            "order of contact-printed, 50 digits",
            slope(exact_errors(METHODS[PRINTED], **changes)),
            2 - ORDER_MISS,
            ORDER_WHY,
        ),
        at_most(
            "|Φ_{−h} Φ_h x − x| at h = 1/10, 50 digits",
            asymmetry(PRINTED, **changes),
            1e-40,
            "round-off at 50 digits",
        ),
    ]
    corrected = [
        at_least(
            "smallest order of contact-abc and contact-strang",
            min(slope(exact_errors(m, **changes)) for m in palindromes),
            2 - ORDER_MISS,
            ORDER_WHY,
        ),
        at_most(
            "largest |Φ_{−h} Φ_h x − x| of the two",
            max(asymmetry(m.name, **changes) for m in palindromes),
            1e-40,
            "round-off at 50 digits",
        ),
    ]
    return Evidence(statement, corrected)


STEPS_OF_ANY_SIZE = (0.5, 0.1, 0.02)


def step_drift(name: str, h: float, gamma: float, seed: int) -> float:
    """max ‖Φ_h*η − e^{−γh}η‖/‖e^{−γh}η‖ of one step at random points."""
    scene = SCENES[PARTICLE].with_(gamma=gamma)
    decay = math.exp(-scene.gamma * h)
    map_ = one_step(METHODS[name], scene, h)
    return float(
        everywhere(
            lambda y: jnp.linalg.norm(pullback(map_, eta, y) / decay - eta(y)) / jnp.linalg.norm(eta(y)),
            points(5, seed=seed),
        ).max()
    )


@claim(
    "C26",
    "§5.2, after eq. (85)",
    "The integrator preserves the contact structure up to O(h³).",
    kind=Correction.sharpens,
    correction="Every step is an exact conformal contact map, Φ_h*η = e^{−γh}η, at every step size: a "
    "composition of exact contact flows leaves nothing to O(h³).",
    scene=PARTICLE,
    method="contact-printed, contact-abc, contact-strang",
)
def contact_structure(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    drifts = {
        h: max(step_drift(name, h, gamma, seed) for name in (PRINTED, ABC, STRANG)) for h in STEPS_OF_ANY_SIZE
    }
    scene = SCENES[PARTICLE].with_(gamma=gamma)
    long = solve(scene, PRINTED, step=0.5, save_at=[scene.t_end])
    statement = [
        at_most(
            f"drift of one step over h³, h = {STEPS_OF_ANY_SIZE}",
            max(d / h**3 for h, d in drifts.items()),
            1.0,
            "a constant of size one in O(h³)",
        )
    ]
    corrected = [
        at_most(f"drift of one step, h = {STEPS_OF_ANY_SIZE}", max(drifts.values()), *IDENTITY),
        at_most(
            "contact_drift of contact-printed over T = 20 at h = ½",
            LAWS["contact_drift"](long),
            ROUND_OFF,
            "round-off of 40 steps",
        ),
    ]
    return Evidence(statement, corrected)


@claim(
    "C27",
    "§5.2, after eq. (85)",
    "Up to O(h³) per step, the integrator has the correct decay of both H0 and s.",
    kind=Correction.repairs,
    correction="The order printed in eq. (85) errs by O(h²) per step in both, because it is of first order (C25). "
    "The palindromes B½ A½ C A½ B½ and B½ (AC) B½ do what is claimed, O(h³). Exact at every step size is the "
    "conformal factor e^{−γh}, hence the decay of J and, for the body, of ‖M‖.",
    scene="particle from random states; J: central, ‖M‖: rigid_body",
    method="contact-printed; corrected: contact-abc, contact-strang",
)
def energy_and_action_decay(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    scene = SCENES[PARTICLE].with_(gamma=gamma)
    starts = points(5, seed=seed)

    def local(name: str) -> list[float]:
        """Powers of h in the errors of H0 and s after one step."""
        return [slope(e) for e in local_errors(name, scene, (scene.energy, lambda x: x.s), starts)]

    printed, palindromes = local(PRINTED), [local(name) for name in (ABC, STRANG)]
    worst = [min(powers) for powers in zip(*palindromes, strict=True)]

    def momentum_law(name):
        other = SCENES[name].with_(gamma=gamma)
        run = solve(other, PRINTED, step=0.5, save_at=np.arange(1, 41) / 2, engine="python")
        return LAWS["momentum_law"](run), run

    central, _ = momentum_law("central")
    body, run = momentum_law("rigid_body")
    size = np.linalg.norm(run.M, axis=1) * np.exp(gamma * run.t) / np.linalg.norm(run.scene.M)
    exact = "round-off of the steps taken"
    least = 3 - ORDER_MISS, ORDER_WHY
    statement = [
        at_least("power of h in the error of H0 after one step, contact-printed", printed[0], *least),
        at_least("power of h in the error of s after one step, contact-printed", printed[1], *least),
    ]
    corrected = [
        at_least("the same for H0, contact-abc and contact-strang", worst[0], *least),
        at_least("the same for s, contact-abc and contact-strang", worst[1], *least),
        at_least(
            "smaller of the two powers, contact-printed",
            min(printed),
            2 - ORDER_MISS,
            "order 1 (C25): h² per step",
        ),
        at_most("momentum_law on central at h = ½", central, ROUND_OFF, exact),
        at_most("momentum_law on rigid_body at h = ½", body, ROUND_OFF, exact),
        at_most("max |‖M‖ e^{γt}/‖M(0)‖ − 1| there", np.abs(size - 1).max(), ROUND_OFF, exact),
    ]
    return Evidence(statement, corrected)


@claim(
    "C28",
    "§5.3, eq. (87)",
    "As γ → 0 the integrator becomes velocity Verlet.",
    scene="particle, γ = 0 and 10⁻⁸",
    method=PRINTED,
)
def verlet_limit(h: float = PAPER_STEP, steps: int = 2000) -> Evidence:
    def difference(gamma: float) -> float:
        """max |(q, p) − Verlet's| over the steps."""
        scene = SCENES[PARTICLE].with_(gamma=gamma)
        q, p = (np.array(v) for v in (scene.q, scene.p))
        most = 0.0
        for x in trajectory(METHODS[PRINTED], scene, scene.initial(()), [(h, 1)] * steps, math):
            p = p - h / 2 * np.array(scene.dV(tuple(q)))
            q = q + h * p
            p = p - h / 2 * np.array(scene.dV(tuple(q)))
            most = max(most, np.abs(q - np.array(x.q)).max(), np.abs(p - np.array(x.p)).max())
        return most

    statement = [
        at_most(
            f"max |difference| from velocity Verlet over {steps} steps at γ = 0",
            difference(0.0),
            0.0,
            "the same numbers, bit for bit",
        ),
        at_most(
            "the same at γ = 10⁻⁸",
            difference(1e-8),
            1e-8 * 5 * h * steps,
            "five times γ t: the amplitude decays by γ t/2, and the phase shifts with it",
        ),
    ]
    return Evidence(statement)
