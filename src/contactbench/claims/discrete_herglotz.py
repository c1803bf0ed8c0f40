"""The claim about the discrete Herglotz principle (§5.1 of the paper)."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from contactbench.claims.calculus import IDENTITY, ROUND_OFF, SEED, largest, one_step, points
from contactbench.claims.ledger import Correction, Evidence, at_most, claim
from contactbench.claims.orders import ORDER, PARTICLE, exact_errors, slope
from contactbench.methods import METHODS
from contactbench.methods.step_map import trajectory
from contactbench.scene import Mechanical
from contactbench.scenes import SCENES
from contactbench.xla import jax, jnp

HERGLOTZ = "herglotz1"


def discrete_lagrangian(scene: Mechanical, q0: Any, q1: Any, s: Any, h: Any) -> Any:
    """L(q_k, q_{k+1}, s_k) = ½‖(q_{k+1} − q_k)/h‖² − V(q_k) − γ s_k."""
    v = [(b - a) / h for a, b in zip(q0, q1, strict=True)]
    return sum(c * c for c in v) / 2 - scene.V(tuple(q0)) - scene.gamma * s


def symplectic_defect(map_: Any, y: Any) -> Any:
    """DΦᵀ Ω DΦ − Ω of the (q, p) part."""
    n = (len(y) - 1) // 2
    derivative = jax.jacfwd(map_)(y)[: 2 * n, : 2 * n]
    omega = jnp.block([[jnp.zeros((n, n)), jnp.eye(n)], [-jnp.eye(n), jnp.zeros((n, n))]])
    return derivative.T @ omega @ derivative - omega


@claim(
    "C23",
    "§5.1, eq. (79)",
    "s_{k+1} = s_k + h L(q_k, q_{k+1}, s_k) with variations of q_k is a variational integrator, and "
    "reduces to the symplectic one when L does not depend on s.",
    kind=Correction.extends,
    correction="The paper leaves L and the order open. L = ½‖v‖² − V(q_k) − γ s_k gives an explicit scheme of "
    "order 1; taking V and γ s as means of both ends gives one of order 2, explicit too (Vermeeren, Bravetti, "
    "Seri 2019).",
    scene=PARTICLE,
    method="herglotz1, L = ½‖v‖² − V(q_k) − γ s_k; herglotz2",
)
def discrete_herglotz(seed: int = SEED, gamma: float = 0.1, h: float = 0.1) -> Evidence:
    scene, steps = SCENES[PARTICLE].with_(gamma=gamma), 20
    method = METHODS[HERGLOTZ]
    start = scene.initial(("s",))
    path = [start, *trajectory(method, scene, start, [(h, 1)] * steps, math)]
    q = jnp.array([x.q for x in path])

    def action(inner):
        """s_N along a discrete curve with the ends q_0 and q_N held."""
        curve, s = [q[0], *inner, q[-1]], scene.s
        for a, b in itertools.pairwise(curve):
            s = s + h * discrete_lagrangian(scene, a, b, s, h)
        return s

    reached, gradient = jax.jit(jax.value_and_grad(action))(q[1:-1])
    free = one_step(method, scene.with_(gamma=0.0), h)
    orders = {name: slope(exact_errors(METHODS[name])) for name in (HERGLOTZ, "herglotz2")}
    statement = [
        at_most("max |∂s_N/∂q_k| along a computed curve of 20 steps", np.abs(gradient).max(), *IDENTITY),
        at_most(
            "|s_N − s_N of the recursion| along it",
            abs(float(reached) - path[-1].s),
            ROUND_OFF,
            "round-off of 20 steps",
        ),
        at_most(
            "max |DΦᵀΩDΦ − Ω| at γ = 0",
            largest(lambda y: symplectic_defect(free, y), points(5, seed=seed)),
            *IDENTITY,
        ),
    ]
    corrected = [
        at_most("|order − 1| of herglotz1, 50 digits", abs(orders[HERGLOTZ] - 1), *ORDER),
        at_most("|order − 2| of herglotz2, 50 digits", abs(orders["herglotz2"] - 2), *ORDER),
    ]
    return Evidence(statement, corrected)
