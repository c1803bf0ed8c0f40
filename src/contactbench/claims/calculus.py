"""Exterior calculus at a point by automatic differentiation: independent of every hand-written formula.

A one-form is a function ``eta(y) -> covector`` on coordinates y ∈ R^N, a two-form a matrix with
``(u, v) -> u·A v``.  Canonical coordinates are y = (q, p, s), η = ds − p·dq.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from contactbench.scene import BodyState, Mechanical, RigidBody, State, quaternion_product
from contactbench.scenes import SCENES
from contactbench.xla import jax, jnp

Field = Callable[[Any], Any]

SEED = 20
POINTS = 64
#: sums of a few dozen products of numbers of size one, differentiated by AD: a few hundred ulp
ROUND_OFF = 1e-12
#: bound and reason of what holds identically
IDENTITY = ROUND_OFF, "round-off of automatic differentiation on numbers of size one"


def points(dimension: int, count: int = POINTS, seed: int = SEED) -> np.ndarray:
    """Return random points of R^dimension, standard normal, shape (count, dimension)."""
    return np.random.default_rng(seed).normal(size=(count, dimension))


def everywhere(function: Callable[[Any], Any], at: np.ndarray) -> np.ndarray:
    """Return the function at many points, compiled once."""
    return np.asarray(jax.jit(jax.vmap(function))(jnp.asarray(at)))


def largest(function: Callable[[Any], Any], at: np.ndarray) -> float:
    """Return max |function| over points and components."""
    return float(np.abs(everywhere(function, at)).max())


# -- forms -----------------------------------------------------------------------------------------
def canonical(y: Any) -> State:
    """Return the coordinates (q, p, s) as a state."""
    n = (len(y) - 1) // 2
    return State(tuple(y[:n]), tuple(y[n : 2 * n]), y[2 * n])


def pack(x: Any) -> Any:
    """Return a state as a JAX vector."""
    return jnp.stack(
        [jnp.asarray(c, dtype=float) for part in x if part is not None for c in jnp.ravel(jnp.asarray(part))]
    )


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


def along(field: Field, function: Callable[[Any], Any], y: Any) -> Any:
    """Return X(f), the derivative of f along X."""
    return jax.jvp(function, (y,), (field(y),))[1]


# -- contact Hamiltonian vector fields -------------------------------------------------------------
def reeb(form: Field, y: Any) -> Any:
    """Return the vector with α(R) = 1 and ι_R dα = 0, by least squares on these equations."""
    rows = jnp.vstack([exterior(form, y).T, form(y)])
    return jnp.linalg.lstsq(rows, jnp.zeros(len(y) + 1).at[-1].set(1.0))[0]


def contact_field(form: Field, hamiltonian: Callable[[Any], Any], y: Any) -> Any:
    """Return X_H solved from its definition ι_X dα = dH − R(H) α, ι_X α = −H  (§2.3, eq. (11))."""
    slope, covector = jax.grad(hamiltonian)(y), form(y)
    right = jnp.append(slope - (slope @ reeb(form, y)) * covector, -hamiltonian(y))
    return jnp.linalg.lstsq(jnp.vstack([exterior(form, y).T, covector]), right)[0]


def contact_equations(hamiltonian: Callable[[Any], Any]) -> Field:
    """Return X_H by the paper's coordinate formula (§2.3, eq. (23))."""

    def field(y: Any) -> Any:
        n = (len(y) - 1) // 2
        slope, p = jax.grad(hamiltonian)(y), y[n : 2 * n]
        dq, dp, ds = slope[:n], slope[n : 2 * n], slope[2 * n]
        return jnp.concatenate([dp, -dq - p * ds, jnp.array([p @ dp - hamiltonian(y)])])

    return field


def random_polynomial(dimension: int, seed: int = SEED) -> Callable[[Any], Any]:
    """Return a random cubic polynomial of y, all its coefficients of size one."""
    rng = np.random.default_rng(seed)
    constant, linear, quadratic, cubic = (jnp.asarray(rng.normal(size=(dimension,) * k)) for k in range(4))
    return lambda y: constant + linear @ y + y @ quadratic @ y + jnp.einsum("ijk,i,j,k", cubic, y, y, y)


# -- scenes in coordinates -------------------------------------------------------------------------
def vector_field(scene: Mechanical) -> Field:
    """Return the scene's right-hand side on (q, p, s)."""
    return lambda y: pack(scene.rhs(canonical(y)))


def function_of(measure: Callable[[State], Any]) -> Callable[[Any], Any]:
    """Return a function of the state as one of (q, p, s)."""
    return lambda y: measure(canonical(y))


def body_chart(y: Any) -> BodyState:
    """Return the coordinates (θ, M, s) of T*SO(3) × R: the attitude is the rotation by the vector θ ≠ 0."""
    theta = y[:3]
    angle = jnp.sqrt(theta @ theta)
    axis = jnp.sin(angle / 2) * theta / angle
    return BodyState(tuple(y[3:6]), (jnp.cos(angle / 2), *axis), y[6])


def body_eta(scene: RigidBody) -> Field:
    """Return the body's contact form in that chart."""

    def form(y: Any) -> Any:
        def on(v: Any) -> Any:
            x, dx = jax.jvp(body_chart, (y,), (v,))
            return scene.contact_form(x, dx)

        return jax.grad(on)(jnp.zeros(7))

    return form


def rotate_in_space(axis: Any, angle: Any, R: Any) -> Any:
    """Return the attitude after a further rotation in space: R → Rot(axis, angle) R."""
    half = angle / 2
    return quaternion_product((jnp.cos(half), *(jnp.sin(half) * c for c in axis)), R)


def one_step(method: Any, scene: Any, h: float) -> Any:
    """Return Φ_h as a JAX map of (q, p, s)."""
    return lambda y: pack(method.advance(scene, canonical(y), h, 1, jnp))
