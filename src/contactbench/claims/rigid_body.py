"""Claims about the damped rigid body: its equations, momentum map and energy (§4.1–4.4 of the paper)."""

from __future__ import annotations

from typing import Any

import numpy as np

from contactbench.claims.calculus import (
    IDENTITY,
    ROUND_OFF,
    SEED,
    along,
    body_chart,
    body_eta,
    contact_field,
    largest,
    pack,
    points,
    rotate_in_space,
)
from contactbench.claims.geometry import TRUE
from contactbench.claims.ledger import Evidence, at_most, claim
from contactbench.claims.linearisation import momentum_rate
from contactbench.methods import solve
from contactbench.numbers.dual import Dual, DualNumbers, slope, value
from contactbench.scene import BodyState
from contactbench.scenes import SCENES
from contactbench.splitting.flows import flows_of
from contactbench.truth import reference
from contactbench.xla import jax, jnp

BODY = "rigid_body"
SOLVED = 1e-10, "10³ times the tolerance 10⁻¹³ of the solver"


def body_flow_defect(name: str, seed: int = SEED) -> float:
    """Return max |dφ_h/dh − X(φ_h)|/(1 + |φ_h|) of a subflow of the body, 0 if it is exact, at random states and h.

    X is that of the kinetic energy for A, the equations of C15 without damping, and of γs for C.  The derivative
    comes from dual numbers.
    """
    scene = SCENES[BODY]
    xp, at = DualNumbers(np), points(9, seed=seed).T
    R = at[3:7] / np.linalg.norm(at[3:7], axis=0)
    x, flow = BodyState(tuple(at[:3]), tuple(R), at[7]), flows_of(scene)[name]
    moved = scene.pack(flow.apply(scene, x, flow.constants(scene, Dual(at[8], 1.0), xp), xp))
    after, rate = (np.array([part(c) + 0 * at[8] for c in moved]) for part in (value, slope))
    here = scene.unpack(tuple(after), scene.optional)
    if name == "free":
        field = scene.with_(gamma=0.0).rhs(here)
    else:
        field = BodyState(tuple(-scene.gamma * m for m in here.M), (0.0,) * 4, -scene.gamma * here.s)
    gap = np.array([r - f for r, f in zip(rate, scene.pack(field), strict=True)])
    return float((np.abs(gap).max(axis=0) / (1 + np.abs(after).max(axis=0))).max())


@claim("C15")
def body_equations(seed: int = SEED, **changes: Any) -> Evidence:
    """changes : of the scene, e.g. ``inertia`` or ``gamma``."""
    scene = SCENES[BODY].with_(**changes)
    form = body_eta(scene)

    def defect(y):
        """Return X_H from its definition in a chart of T*SO(3) × R, against the equations."""
        X = contact_field(form, lambda y: scene.hamiltonian(body_chart(y)), y)
        moved = jax.jvp(body_chart, (y,), (X,))[1]
        return pack(moved) - pack(scene.rhs(body_chart(y)))

    off = largest(defect, points(7, seed=seed))
    rounding = 10 * ROUND_OFF, "round-off of AD through a chart whose metric is conditioned up to 10"
    return Evidence([at_most("max |X_H by definition − equations| at random (R, M, s)", off, *rounding)])


@claim("C16")
def body_momentum_map(seed: int = SEED, **changes: Any) -> Evidence:
    scene = SCENES[BODY].with_(**changes)
    unit = np.eye(3)

    def momentum_map(y):
        """Return J_ξ = −ι_ξ η for the rotations ξ = e_i in space."""
        x = body_chart(y)

        def component(axis):
            dR = jax.jvp(lambda angle: rotate_in_space(axis, angle, x.R), (0.0,), (1.0,))[1]
            return -scene.contact_form(x, BodyState((0.0,) * 3, dR, 0.0))

        return jnp.stack([component(axis) for axis in unit])

    def against(candidate):
        return largest(lambda y: momentum_map(y) - jnp.stack(candidate(body_chart(y))), points(7, seed=seed))

    t = np.linspace(0, scene.t_end, 201)
    truth = reference(scene, t).states()
    scaled = np.array(truth.M) * np.exp(scene.gamma * t)
    J = np.array(scene.momentum(truth)) * np.exp(scene.gamma * t)
    of_M, of_J = (np.abs(x - x[:, :1]).max() / np.linalg.norm(scaled[:, 0]) for x in (scaled, J))
    statement = [
        at_most("max |J_ξ − M·ξ| at random (R, M), J_ξ = −ι_ξ η", against(lambda x: x.M), *IDENTITY),
        at_most("max |M_i(t) e^{γt} − M_i(0)|/‖M(0)‖ along the true body", of_M, *TRUE),
    ]
    corrected = [
        at_most("max |J_ξ − (R M)·ξ|, the suite's momentum map", against(scene.momentum), *IDENTITY),
        at_most("max |(R M)_i(t) e^{γt} − (R M)_i(0)|/‖M(0)‖", of_J, *TRUE),
    ]
    return Evidence(statement, corrected)


@claim("C17")
def body_energy(seed: int = SEED, **changes: Any) -> Evidence:
    scene = SCENES[BODY].with_(**changes)
    run = solve(scene, "scipy-dop853", rtol=1e-13, save_at=np.linspace(0, scene.t_end, 21), carry=())
    energy = scene.energy(run.states()) * np.exp(2 * scene.gamma * run.t)

    def energy_of(M):
        return scene.energy(BodyState(tuple(M)))

    def balance(M):
        return along(momentum_rate(scene), energy_of, M) + 2 * scene.gamma * energy_of(M)

    statement = [
        at_most("max |H0(t) e^{2γt}/H0(0) − 1|", np.abs(energy / energy[0] - 1).max(), *SOLVED),
        at_most("max |H0' + 2γ H0| at random M", largest(balance, points(3, seed=seed)), *IDENTITY),
    ]
    return Evidence(statement)
