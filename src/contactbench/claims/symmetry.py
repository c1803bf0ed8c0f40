"""Claims about momentum maps and reduction (§3 of the paper)."""

from __future__ import annotations

from functools import partial

import numpy as np
import scipy  # its parts are loaded when first used

from contactbench.claims.calculus import (
    IDENTITY,
    LARGE_NUMBERS,
    ROUND_OFF,
    SEED,
    along,
    canonical,
    contact_equations,
    eta,
    exterior,
    largest,
    lie_derivative,
    points,
    pullback,
)
from contactbench.claims.geometry import SOLVED, SOLVER, TRUE
from contactbench.claims.ledger import CORRECTED, Evidence, at_least, at_most, claim
from contactbench.scenes import SCENES
from contactbench.truth import reference
from contactbench.xla import jax, jnp

AXIS = np.array([0.48, 0.6, 0.64])  #: a unit vector


def rotate(y, angle):
    """Return the cotangent lift of a rotation about `AXIS`, on T*R³ × R."""
    hat = jnp.array([[0, -AXIS[2], AXIS[1]], [AXIS[2], 0, -AXIS[0]], [-AXIS[1], AXIS[0], 0.0]])
    matrix = jnp.eye(3) + jnp.sin(angle) * hat + (1 - jnp.cos(angle)) * hat @ hat  # Rodrigues
    return jnp.concatenate([matrix @ y[:3], matrix @ y[3:6], y[6:]])


def generator(y):
    """Return the generator of the rotations about `AXIS` at y."""
    return jax.jvp(lambda angle: rotate(y, angle), (0.0,), (1.0,))[1]


@claim("C09")
def cotangent_lifts(seed: int = SEED) -> Evidence:
    def bend(q):
        """Return a diffeomorphism of R² that is no rotation."""
        return jnp.array([q[0] + jnp.tanh(q[1]), q[1] + jnp.sin(q[0] + jnp.tanh(q[1])) / 2])

    def lifted(y):
        q, p = y[:2], y[2:4]
        return jnp.concatenate([bend(q), jnp.linalg.solve(jax.jacfwd(bend)(q).T, p), y[4:]])

    def defect(map_, dimension):
        return largest(lambda y: pullback(map_, eta, y) - eta(y), points(dimension, seed=seed))

    yield at_most("max |Φ*η − η|, rotations of space", defect(lambda y: rotate(y, 0.7), 7), *IDENTITY)
    yield at_most("max |Φ*η − η|, a nonlinear change of coordinates", defect(lifted, 5), *IDENTITY)


@claim("C10")
def infinitesimal_strictness(seed: int = SEED) -> Evidence:
    def momentum(y):
        return jnp.dot(AXIS, jnp.cross(y[:3], y[3:6]))

    def defect(function):
        return largest(function, points(7, seed=seed))

    lie, slope = lambda y: lie_derivative(generator, eta, y), jax.grad(momentum)
    contraction = lambda y: generator(y) @ exterior(eta, y)  # noqa: E731
    yield at_most("max |L_ξ η + dJ_ξ|", defect(lambda y: lie(y) + slope(y)), *IDENTITY)
    yield CORRECTED
    yield at_most("max |L_ξ η|", defect(lie), *IDENTITY)
    yield at_most("max |J_ξ + ι_ξ η|", defect(lambda y: momentum(y) + eta(y) @ generator(y)), *IDENTITY)
    yield at_most("max |dJ_ξ − ι_ξ dη|", defect(lambda y: slope(y) - contraction(y)), *IDENTITY)


@claim("C39")
def commuting_derivatives(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    def invariant(y):
        return y[3:6] @ y[3:6] / 2 + (y[:3] @ y[:3]) ** 2 / 4 + gamma * y[6]

    def form(y):
        """Return a one-form that neither flow leaves alone."""
        return jnp.sin(y[::-1]) + y * y[0]

    def both(field, form):
        """Return L_X L_ξ and L_ξ L_X of a one-form."""
        along_X, along_ξ = partial(lie_derivative, field), partial(lie_derivative, generator)
        return partial(along_X, partial(along_ξ, form)), partial(along_ξ, partial(along_X, form))

    at = points(7, seed=seed)
    X = contact_equations(invariant)
    left, right = both(X, form)
    size = largest(left, at)
    # without invariance d L_ξ L_X η = L_ξ L_X dη, of which eq. (51) says that it is −L_X L_ξ dη = 0
    _, other = both(contact_equations(lambda y: invariant(y) + y[0] * y[6]), eta)
    law = lambda y: lie_derivative(X, eta, y) + gamma * eta(y)  # noqa: E731
    total = largest(lambda y: left(y) + right(y), at) / size
    difference = largest(lambda y: left(y) - right(y), at) / size
    bound = 100 * ROUND_OFF, "round-off of second derivatives by AD on numbers of size up to 100"
    yield at_most("max |L_X L_ξ β + L_ξ L_X β|/max |L_X L_ξ β|, a one-form β, invariant H", total, *bound)
    yield at_most("max |L_ξ L_X dη|, H not invariant", largest(lambda y: exterior(other, y), at), *bound)
    yield CORRECTED
    yield at_most("max |L_X L_ξ β − L_ξ L_X β|/max |L_X L_ξ β|, invariant H", difference, *bound)
    yield at_most("max |L_X η + R(H) η|", largest(law, at), *bound)


def times(scene):
    """Return 201 equal times, the grid of the frozen references."""
    return np.linspace(0, scene.t_end, 201)


def momenta(scene):
    """Return J along the truth, shape (201, m)."""
    return np.array(scene.momentum(reference(scene, times(scene)).states())).T


def radius_and_speed(x):
    """Return ‖q‖ and q·p/‖q‖ in the plane."""
    radius = np.hypot(*x.q)
    return radius, (x.q[0] * x.p[0] + x.q[1] * x.p[1]) / radius


@claim("C11")
def momentum_decay(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    def deviation(name):
        scene = SCENES[name].with_(gamma=gamma)
        J = momenta(scene)
        scaled = J * np.exp(scene.conformal_rate * times(scene))[:, None]
        return np.linalg.norm(scaled - J[0], axis=1).max() / np.linalg.norm(J[0])

    coefficients = np.random.default_rng(seed).normal(size=(4, 4))

    def invariant(y):
        """Return a contact Hamiltonian that rotations leave alone, not of the form H0(q, p) + Γ(s)."""
        q, p, s = y[:2], y[2:4], y[4]
        u = jnp.array([q @ q, p @ p, q @ p, s])
        return u @ coefficients @ u / 4

    def defect(y):
        momentum = lambda y: SCENES["central"].momentum(canonical(y))[0]  # noqa: E731
        rate = jax.grad(invariant)(y)[-1]
        return along(contact_equations(invariant), momentum, y) + rate * momentum(y)

    off = largest(defect, points(5, seed=seed) / 2)
    of_quartic = 10 * ROUND_OFF, "round-off of AD on a quartic"
    yield at_most("max ‖J e^{λt} − J(0)‖/‖J(0)‖ along the true central", deviation("central"), *TRUE)
    yield at_most("the same for the true rigid body, J = R M", deviation("rigid_body"), *TRUE)
    yield at_most("max |J' + R(H) J|, random invariant H(q, p, s)", off, *of_quartic)


@claim("C12")
def level_sets(gamma: float = 0.1) -> Evidence:
    damped = SCENES["central"].with_(gamma=gamma)

    def change(scene):
        J = momenta(scene)[:, 0]
        return np.abs(J - J[0]).max() / (abs(J[0]) or 1.0)

    straight = damped.with_(q=(1.0, 0.0), p=(0.3, 0.0))
    moves = 1e-3, "far above the uncertainty 10⁻¹³ of the truth"
    yield at_least(f"max |J(t) − J(0)|/|J(0)| at λ = {gamma:g}", change(damped), *moves)
    yield at_most("the same at λ = 0", change(damped.with_(gamma=0.0)), *TRUE)
    yield at_most(f"max |J(t)| at λ = {gamma:g}, J(0) = 0", change(straight), *TRUE)


@claim("C13")
def time_dependent_reduction(gamma: float = 0.1) -> Evidence:
    scene = SCENES["central"].with_(gamma=gamma)
    t = times(scene)
    radius, radial = radius_and_speed(reference(scene, t, ()).states())
    mu = scene.momentum(scene.initial(()))[0]

    def reduced(t, y):
        """Return H_μ = ½ (p_r² + μ(t)²/r²) + V(r), with γ s: the contact equations of (r, p_r) alone."""
        r, p_r = y
        level = mu * np.exp(-scene.gamma * t)
        return [p_r, level**2 / r**3 - scene.dV((r, 0.0))[0] - scene.gamma * p_r]

    run = scipy.integrate.solve_ivp(reduced, (0, scene.t_end), [radius[0], radial[0]], t_eval=t, **SOLVER)
    error = np.hypot(run.y[0] - radius, run.y[1] - radial).max() / np.hypot(radius, radial).max()
    yield at_most("max ‖(r, p_r) reduced − full‖ / max ‖full‖", error, *SOLVED)


@claim("C14")
def symplectification(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    """The contact flow is the projection of a homogeneous Hamiltonian flow; there J r is conserved."""
    scene = SCENES["central"].with_(gamma=gamma)
    t = np.linspace(0, scene.t_end, 21)

    def lifted(contact):
        """Return K(x, P, s, r) = −r H(x, −P/r, s), of degree one in the momenta P = −r p of x and r of s."""

        def K(z):
            n = (len(z) - 2) // 2
            x, P, s, r = z[:n], z[n : 2 * n], z[-2], z[-1]
            return -r * contact(jnp.concatenate([x, -P / r, s[None]]))

        return K

    def flow(K, z0):
        """Return the motion by Hamilton's equations of K for the pairs (x, P) and (s, r)."""
        n = (len(z0) - 2) // 2

        @jax.jit
        def rhs(z):
            slope = jax.grad(K)(z)
            return jnp.concatenate([slope[n : 2 * n], -slope[:n], slope[-1:], -slope[-2:-1]])

        run = scipy.integrate.solve_ivp(lambda _, z: np.asarray(rhs(z)), (0, t[-1]), z0, t_eval=t, **SOLVER)
        return run.y

    def polar(y):
        """Return H on (ρ, p_ρ, s) with p_θ put in for the conserved level, y = (ρ, θ, p_ρ, p_θ, s)."""
        return (y[2] ** 2 + (y[3] / y[0]) ** 2) / 2 + scene.V((y[0], 0.0 * y[0])) + gamma * y[4]

    full = lifted(lambda y: scene.hamiltonian(canonical(y)))
    q, p = np.array(scene.q), np.array(scene.p)
    run = flow(full, np.array([*q, *-p, scene.s, 1.0]))
    r, level = run[5], run[0] * run[3] - run[1] * run[2]
    truth = reference(scene, t)
    projected = np.vstack([run[:2], -run[2:4] / r, run[4]]).T
    error = np.linalg.norm(projected - truth.y, axis=1).max() / np.linalg.norm(truth.y, axis=1).max()

    def reduced(z):
        """Return K on (ρ, P_ρ, s, r) at the level P_θ = −r J."""
        ρ, P, s, r = z
        return lifted(polar)(jnp.stack([ρ, 0.0 * ρ, P, level[0] + 0.0 * ρ, s, r]))

    ρ0 = np.linalg.norm(q)
    down = flow(reduced, np.array([ρ0, -(q @ p) / ρ0, scene.s, 1.0]))
    ρ, radial = radius_and_speed(truth.states())
    off = np.abs(np.array([down[0] - ρ, -down[1] / down[3] - radial, down[2] - truth.states().s]))

    def degree(z):
        return full(z * jnp.array([1, 1, 3.0, 3.0, 1, 3.0])) - 3 * full(z)

    somewhere = points(6, seed=seed)
    somewhere[:, 5] = 0.5 + np.abs(somewhere[:, 5])
    change = np.abs(level / level[0] - 1).max()
    yield at_most("max ‖projected − true‖ / max ‖true‖", error, *SOLVED)
    yield at_most("max |r(t) e^{−γt} − 1|", np.abs(r * np.exp(-gamma * t) - 1).max(), *SOLVED)
    yield at_most("max |K(q, 3P, s, 3r) − 3K(q, P, s, r)|", largest(degree, somewhere), *LARGE_NUMBERS)
    yield at_most("max |r J − r(0) J(0)|/|J(0)|: the lifted momentum is conserved", change, *SOLVED)
    yield at_most("max |(ρ, p_ρ, s) reduced, then projected, − true|", off.max(), *SOLVED)
