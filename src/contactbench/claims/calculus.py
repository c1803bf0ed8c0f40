"""Exterior calculus at a point by automatic differentiation: independent of every hand-written formula.

A one-form is a function ``eta(y) -> covector`` on coordinates y ∈ R^N, a two-form a matrix with
``(u, v) -> u·A v``.  Canonical coordinates are y = (q, p, s), η = ds − p·dq.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from contactbench.scene import Mechanical, State
from contactbench.scenes import SCENES
from contactbench.xla import jax, jnp

Field = Callable[[Any], Any]
SEED = 20
#: sums of a few dozen products of numbers of size one, differentiated by AD: a few hundred ulp
ROUND_OFF = 1e-12
#: bound and reason of what holds identically
IDENTITY = ROUND_OFF, "round-off of automatic differentiation on numbers of size one"


def points(dimension: int, count: int = 64, seed: int = SEED) -> np.ndarray:
    """Return random points of R^dimension, standard normal, shape (count, dimension)."""
    return np.random.default_rng(seed).normal(size=(count, dimension))


def everywhere(function: Field, at: np.ndarray) -> np.ndarray:
    return np.asarray(jax.jit(jax.vmap(function))(jnp.asarray(at)))


def largest(function: Field, at: np.ndarray) -> float:
    """Return max |function| over points and components."""
    return float(np.abs(everywhere(function, at)).max())


# -- forms -----------------------------------------------------------------------------------------
def canonical(y: Any) -> State:
    """Return the coordinates (q, p, s) as a state."""
    n = (len(y) - 1) // 2
    return State(tuple(y[:n]), tuple(y[n : 2 * n]), y[2 * n])


def pack(x: Any) -> Any:
    return jnp.concatenate([jnp.ravel(jnp.asarray(part, dtype=float)) for part in x if part is not None])


def eta(y: Any) -> Any:
    """Return the suite's own contact form on T*Rⁿ × R, as a covector at y."""
    form = SCENES["particle"].contact_form
    return jax.grad(lambda v: form(canonical(y), canonical(v)))(jnp.zeros(len(y)))


def exterior(form: Field, y: Any) -> Any:
    """Return dα as a matrix: dα(u, v) = D(α·v)[u] − D(α·u)[v]."""
    derivative = jax.jacfwd(form)(y)  # [i, j] = ∂_j α_i
    return derivative.T - derivative


def pullback(map_: Field, form: Field, y: Any) -> Any:
    """Return (Φ*α)(y) = α(Φ(y))·DΦ(y)."""
    return form(map_(y)) @ jax.jacfwd(map_)(y)


def lie_derivative(field: Field, form: Field, y: Any) -> Any:
    """Return L_X α, in components X^i ∂_i α_j + α_i ∂_j X^i."""
    return jax.jacfwd(form)(y) @ field(y) + form(y) @ jax.jacfwd(field)(y)


def along(field: Field, function: Field, y: Any) -> Any:
    return jax.jvp(function, (y,), (field(y),))[1]


# -- contact Hamiltonian vector fields -------------------------------------------------------------
def reeb(form: Field, y: Any) -> Any:
    """Return the vector with α(R) = 1 and ι_R dα = 0, by least squares on these equations."""
    rows = jnp.vstack([exterior(form, y).T, form(y)])
    return jnp.linalg.lstsq(rows, jnp.zeros(len(y) + 1).at[-1].set(1.0))[0]


def contact_field(form: Field, hamiltonian: Field, y: Any) -> Any:
    """Return X_H solved from its definition ι_X dα = dH − R(H) α, ι_X α = −H  (§2.3, eq. (11))."""
    slope, covector = jax.grad(hamiltonian)(y), form(y)
    right = jnp.append(slope - (slope @ reeb(form, y)) * covector, -hamiltonian(y))
    return jnp.linalg.lstsq(jnp.vstack([exterior(form, y).T, covector]), right)[0]


def contact_equations(hamiltonian: Field) -> Field:
    """Return X_H by the paper's coordinate formula (§2.3, eq. (23))."""

    def field(y: Any) -> Any:
        n = (len(y) - 1) // 2
        slope, p = jax.grad(hamiltonian)(y), y[n : 2 * n]
        dq, dp, ds = slope[:n], slope[n : 2 * n], slope[2 * n]
        return jnp.concatenate([dp, -dq - p * ds, jnp.array([p @ dp - hamiltonian(y)])])

    return field


# -- scenes in coordinates -------------------------------------------------------------------------
def vector_field(scene: Mechanical) -> Field:
    return lambda y: pack(scene.rhs(canonical(y)))


def function_of(measure: Callable[[State], Any]) -> Field:
    return lambda y: measure(canonical(y))
