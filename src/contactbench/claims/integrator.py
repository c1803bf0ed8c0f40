"""Claims about the integrators (§5 of the paper, and its abstract)."""

from __future__ import annotations

import itertools
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
    pack,
    points,
    pullback,
)
from contactbench.claims.ledger import Evidence, at_least, at_most, claim
from contactbench.claims.orders import (
    ABC,
    ORDER,
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
from contactbench.methods.fixed_step_run import trajectory
from contactbench.scene import Mechanical
from contactbench.scenes import SCENES
from contactbench.splitting.flows import MECHANICAL, Flow
from contactbench.xla import jax, jnp

# -- the discrete Herglotz principle ---------------------------------------------------------------
HERGLOTZ = "herglotz1"


def discrete_lagrangian(scene: Mechanical, q0: Any, q1: Any, s: Any, h: Any) -> Any:
    """Return L(q_k, q_{k+1}, s_k) = ½‖(q_{k+1} − q_k)/h‖² − V(q_k) − γ s_k."""
    v = [(b - a) / h for a, b in zip(q0, q1, strict=True)]
    return sum(c * c for c in v) / 2 - scene.V(tuple(q0)) - scene.gamma * s


def symplectic_defect(map_: Any, y: Any) -> Any:
    """Return DΦᵀ Ω DΦ − Ω of the (q, p) part."""
    n = (len(y) - 1) // 2
    derivative = jax.jacfwd(map_)(y)[: 2 * n, : 2 * n]
    omega = jnp.block([[jnp.zeros((n, n)), jnp.eye(n)], [-jnp.eye(n), jnp.zeros((n, n))]])
    return derivative.T @ omega @ derivative - omega


@claim("C23")
def discrete_herglotz(seed: int = SEED, gamma: float = 0.1, h: float = 0.1) -> Evidence:
    scene, steps = SCENES[PARTICLE].with_(gamma=gamma), 20
    method = METHODS[HERGLOTZ]
    start = scene.initial(("s",))
    path = [start, *trajectory(method, scene, start, [(h, 1)] * steps, math)]
    q = jnp.array([x.q for x in path])

    def action(inner):
        """Return s_N along a discrete curve with the ends q_0 and q_N held."""
        curve, s = [q[0], *inner, q[-1]], scene.s
        for a, b in itertools.pairwise(curve):
            s = s + h * discrete_lagrangian(scene, a, b, s, h)
        return s

    reached, gradient = jax.jit(jax.value_and_grad(action))(q[1:-1])
    free = one_step(method, scene.with_(gamma=0.0), h)
    orders = {name: slope(exact_errors(METHODS[name])) for name in (HERGLOTZ, "herglotz2")}
    defect = largest(lambda y: symplectic_defect(free, y), points(5, seed=seed))
    rounding = ROUND_OFF, "round-off of 20 steps"
    statement = [
        at_most("max |∂s_N/∂q_k| along a computed curve of 20 steps", np.abs(gradient).max(), *IDENTITY),
        at_most("|s_N − s_N of the recursion| along it", abs(float(reached) - path[-1].s), *rounding),
        at_most("max |DΦᵀΩDΦ − Ω| at γ = 0", defect, *IDENTITY),
    ]
    corrected = [
        at_most("|order − 1| of herglotz1, 50 digits", abs(orders[HERGLOTZ] - 1), *ORDER),
        at_most("|order − 2| of herglotz2, 50 digits", abs(orders["herglotz2"] - 2), *ORDER),
    ]
    return Evidence(statement, corrected)


# -- subflows and compositions ---------------------------------------------------------------------
def flow_map(flow: Flow, scene: Mechanical) -> Any:
    """Return (h, y) ↦ φ_h(y)."""
    return lambda h, y: pack(flow.apply(scene, canonical(y), flow.constants(scene, h, jnp), jnp))


def flow_defect(flow: Any, hamiltonian: Any, seed: int) -> float:
    """Return max |dφ_h/dh − X_H(φ_h)|/(1 + |φ_h|) and |φ_0 − id| at random points and h: 0 for the exact flow."""
    field = contact_equations(hamiltonian)

    def defect(point):
        h, y = point[0], point[1:]
        value, rate = jax.jvp(lambda h: flow(h, y), (h,), (1.0,))
        size = 1 + jnp.abs(value).max()
        return jnp.append((rate - field(value)) / size, flow(0.0, y) - y)

    return largest(defect, points(6, seed=seed))


@claim("C24")
def subflows(seed: int = SEED, gamma: float = 0.1, kappa: float = 0.05) -> Evidence:
    """kappa : of the quadratic damping that what goes beyond the claim is measured with."""
    scene = SCENES[PARTICLE].with_(gamma=gamma)
    parts = {
        "A (drift)": ("drift", lambda x: scene.kinetic(x.p)),
        "B (kick)": ("kick", lambda x: scene.V(x.q)),
        "C (damp)": ("damp", lambda x: scene.gamma * x.s),
        "A and C together (drift_damp)": ("drift_damp", lambda x: scene.kinetic(x.p) + scene.gamma * x.s),
    }

    def part_defect(name, scene, part):
        return flow_defect(flow_map(MECHANICAL[name], scene), lambda y: part(canonical(y)), seed)

    def contact_defect(name, factor):
        flow = flow_map(MECHANICAL[name], scene)
        form = lambda y: pullback(lambda z: flow(0.7, z), eta, y)  # noqa: E731
        return largest(lambda y: form(y) - factor * eta(y), points(5, seed=seed))

    decay = math.exp(-scene.gamma * 0.7)
    contact = max(contact_defect(*part) for part in (("kick", 1.0), ("drift", 1.0), ("damp", decay)))

    def quartic(y):
        return jnp.sum(y[2:4] ** 4) / 4

    def drift(general):
        def flow(h, y):
            q, p, s = y[:2], y[2:4], y[4]
            T, p_T = quartic(y), jnp.sum(p**4)
            action = s + h * (p_T - T if general else T)
            return jnp.concatenate([q + h * p**3, p, jnp.array([action])])

        return flow

    curved = scene.with_(kappa=kappa)
    dissipated = {
        "C": ("damp", lambda x: curved.dissipation(x.s)),
        "A and C together": ("drift_damp", lambda x: curved.kinetic(x.p) + curved.dissipation(x.s)),
    }
    measure, nonlinear = "max |dφ_h/dh − X(φ_h)|/(1 + |φ_h|), |φ_0 − id|", f"Γ = γs + ½κs², κ = {kappa:g}"
    general, as_printed = (flow_defect(drift(general), quartic, seed) for general in (True, False))
    rounding = 10 * ROUND_OFF, "round-off of AD on numbers of size up to 100"
    no_flow = 1e-3, "far above round-off: it is not the flow"
    statement = [
        *(
            at_most(f"{measure}: {label}", part_defect(name, scene, part), *IDENTITY)
            for label, (name, part) in parts.items()
        ),
        at_most("max |φ_h*η − e^{−γh}η| (A, B: factor 1)", contact, *IDENTITY),
    ]
    corrected = [
        *(
            at_most(f"the same defect on T*SO(3) × R: {label}", body_flow_defect(name, seed), *IDENTITY)
            for label, name in (("A (free)", "free"), ("C (damp)", "damp"))
        ),
        *(
            at_most(f"the same defect with {nonlinear}: {label}", part_defect(name, curved, part), *IDENTITY)
            for label, (name, part) in dissipated.items()
        ),
        at_most("A with s += h (p·T_p − T) for T = ¼ Σ p⁴", general, *rounding),
        at_least("A as printed, s += h T, for the same T", as_printed, *no_flow),
    ]
    return Evidence(statement, corrected)


@claim("C25")
def printed_composition(**changes: Any) -> Evidence:
    """changes : of the particle, e.g. ``gamma``."""
    orders = {name: slope(exact_errors(METHODS[name], **changes)) for name in (PRINTED, ABC, STRANG)}
    asymmetries = {name: asymmetry(name, **changes) for name in orders}
    second, rounding = (2 - ORDER_MISS, ORDER_WHY), (1e-40, "round-off at 50 digits")
    statement = [
        at_least("order of contact-printed, 50 digits", orders[PRINTED], *second),
        at_most("|Φ_{−h} Φ_h x − x| at h = 1/10, 50 digits", asymmetries[PRINTED], *rounding),
    ]
    smallest, largest_ = min(orders[ABC], orders[STRANG]), max(asymmetries[ABC], asymmetries[STRANG])
    corrected = [
        at_least("smallest order of contact-abc and contact-strang", smallest, *second),
        at_most("largest |Φ_{−h} Φ_h x − x| of the two", largest_, *rounding),
    ]
    return Evidence(statement, corrected)


STEPS_OF_ANY_SIZE = (0.5, 0.1, 0.02)


def step_drift(name: str, h: float, gamma: float, seed: int) -> float:
    """Return max ‖Φ_h*η − e^{−γh}η‖/‖e^{−γh}η‖ of one step at random points."""
    scene = SCENES[PARTICLE].with_(gamma=gamma)
    decay = math.exp(-scene.gamma * h)
    map_ = one_step(METHODS[name], scene, h)

    def drift(y: Any) -> Any:
        return jnp.linalg.norm(pullback(map_, eta, y) / decay - eta(y)) / jnp.linalg.norm(eta(y))

    return float(everywhere(drift, points(5, seed=seed)).max())


@claim("C26")
def contact_structure(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    def drift(h: float) -> float:
        return max(step_drift(name, h, gamma, seed) for name in (PRINTED, ABC, STRANG))

    drifts = {h: drift(h) for h in STEPS_OF_ANY_SIZE}
    scene = SCENES[PARTICLE].with_(gamma=gamma)
    long = LAWS["contact_drift"](solve(scene, PRINTED, step=0.5, save_at=[scene.t_end]))
    steps = f"drift of one step{{}}, h = {STEPS_OF_ANY_SIZE}"
    third_order = 1.0, "a constant of size one in O(h³)"
    rounding = ROUND_OFF, "round-off of 40 steps"
    statement = [at_most(steps.format(" over h³"), max(d / h**3 for h, d in drifts.items()), *third_order)]
    corrected = [
        at_most(steps.format(""), max(drifts.values()), *IDENTITY),
        at_most("contact_drift of contact-printed over T = 20 at h = ½", long, *rounding),
    ]
    return Evidence(statement, corrected)


@claim("C27")
def energy_and_action_decay(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    scene = SCENES[PARTICLE].with_(gamma=gamma)
    starts = points(5, seed=seed)

    def local(name: str) -> list[float]:
        """Return the powers of h in the errors of H0 and s after one step."""
        return [slope(e) for e in local_errors(name, scene, (scene.energy, lambda x: x.s), starts)]

    printed, palindromes = local(PRINTED), [local(name) for name in (ABC, STRANG)]
    worst = [min(powers) for powers in zip(*palindromes, strict=True)]

    def coarse(name):
        other = SCENES[name].with_(gamma=gamma)
        return solve(other, PRINTED, step=0.5, save_at=np.arange(1, 41) / 2, engine="python")

    central, body, law = coarse("central"), coarse("rigid_body"), LAWS["momentum_law"]
    size = np.linalg.norm(body.M, axis=1) * np.exp(gamma * body.t) / np.linalg.norm(body.scene.M)
    exact = ROUND_OFF, "round-off of the steps taken"
    first, least = (2 - ORDER_MISS, "order 1 (C25): h² per step"), (3 - ORDER_MISS, ORDER_WHY)
    statement = [
        at_least("power of h in the error of H0 after one step, contact-printed", printed[0], *least),
        at_least("power of h in the error of s after one step, contact-printed", printed[1], *least),
    ]
    corrected = [
        at_least("the same for H0, contact-abc and contact-strang", worst[0], *least),
        at_least("the same for s, contact-abc and contact-strang", worst[1], *least),
        at_least("smaller of the two powers, contact-printed", min(printed), *first),
        at_most("momentum_law on central at h = ½", law(central), *exact),
        at_most("momentum_law on rigid_body at h = ½", law(body), *exact),
        at_most("max |‖M‖ e^{γt}/‖M(0)‖ − 1| there", np.abs(size - 1).max(), *exact),
    ]
    return Evidence(statement, corrected)


@claim("C28")
def verlet_limit(h: float = PAPER_STEP, steps: int = 2000) -> Evidence:
    def difference(gamma: float) -> float:
        """Return max |(q, p) − Verlet's| over the steps."""
        scene = SCENES[PARTICLE].with_(gamma=gamma)
        q, p = (np.array(v) for v in (scene.q, scene.p))
        most = 0.0
        for x in trajectory(METHODS[PRINTED], scene, scene.initial(()), [(h, 1)] * steps, math):
            p = p - h / 2 * np.array(scene.dV(tuple(q)))
            q = q + h * p
            p = p - h / 2 * np.array(scene.dV(tuple(q)))
            most = max(most, np.abs(q - np.array(x.q)).max(), np.abs(p - np.array(x.p)).max())
        return most

    equal = 0.0, "the same numbers, bit for bit"
    near = 1e-8 * 5 * h * steps, "five times γ t: the amplitude decays by γ t/2, and the phase shifts with it"
    off = f"max |difference| from velocity Verlet over {steps} steps at γ = 0"
    statement = [
        at_most(off, difference(0.0), *equal),
        at_most("the same at γ = 10⁻⁸", difference(1e-8), *near),
    ]
    return Evidence(statement)
