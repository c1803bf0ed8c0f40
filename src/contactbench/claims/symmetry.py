"""Claims about momentum maps and reduction (§3 of the paper)."""

from __future__ import annotations

from functools import partial

import numpy as np
import scipy  # its parts are loaded when first used

from contactbench.claims.calculus import (
    IDENTITY,
    ROUND_OFF,
    SEED,
    along,
    canonical,
    contact_equations,
    eta,
    exterior,
    function_of,
    largest,
    lie_derivative,
    pack,
    points,
    pullback,
    vector_field,
)
from contactbench.claims.geometry import SOLVED, SOLVER, TRUE
from contactbench.claims.ledger import Evidence, at_least, at_most, claim
from contactbench.scenes import SCENES
from contactbench.truth import reference
from contactbench.xla import jax, jnp


def rotate(y, angle, axis=None):
    """Return the cotangent lift of a rotation, on T*R² × R or T*R³ × R."""
    n = (len(y) - 1) // 2
    if n == 2:
        c, s = jnp.cos(angle), jnp.sin(angle)
        matrix = jnp.array([[c, -s], [s, c]])
    else:
        hat = jnp.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0.0]])
        matrix = jnp.eye(3) + jnp.sin(angle) * hat + (1 - jnp.cos(angle)) * hat @ hat  # Rodrigues
    return jnp.concatenate([matrix @ y[:n], matrix @ y[n : 2 * n], y[2 * n :]])


AXIS = np.array([0.48, 0.6, 0.64])  #: a unit vector


def generator(y):
    """Return the generator of the rotations about `AXIS` at y."""
    return jax.jvp(lambda angle: rotate(y, angle, AXIS), (0.0,), (1.0,))[1]


@claim("C09")
def cotangent_lifts(seed: int = SEED) -> Evidence:
    def bend(q):
        """Return a diffeomorphism of R² that is no rotation."""
        return jnp.array([q[0] + jnp.tanh(q[1]), q[1] + jnp.sin(q[0] + jnp.tanh(q[1])) / 2])

    def lifted(y):
        q, p = y[:2], y[2:4]
        return jnp.concatenate([bend(q), jnp.linalg.solve(jax.jacfwd(bend)(q).T, p), y[4:]])

    def strictness(map_):
        return lambda y: pullback(map_, eta, y) - eta(y)

    defects = {
        "rotations of the plane": (lambda y: rotate(y, 0.7), points(5, seed=seed)),
        "rotations of space": (lambda y: rotate(y, 0.7, AXIS), points(7, seed=seed)),
        "a nonlinear change of coordinates": (lifted, points(5, seed=seed)),
    }
    statement = [
        at_most(f"max |Φ*η − η|, {label}", largest(strictness(map_), at), *IDENTITY)
        for label, (map_, at) in defects.items()
    ]
    return Evidence(statement)


@claim("C10")
def infinitesimal_strictness(seed: int = SEED) -> Evidence:
    def momentum(y):
        return jnp.dot(AXIS, jnp.cross(y[:3], y[3:6]))

    def defect(function):
        return largest(function, points(7, seed=seed))

    lie, slope = lambda y: lie_derivative(generator, eta, y), jax.grad(momentum)
    contraction = lambda y: generator(y) @ exterior(eta, y)  # noqa: E731
    statement = [at_most("max |L_ξ η + dJ_ξ|", defect(lambda y: lie(y) + slope(y)), *IDENTITY)]
    corrected = [
        at_most("max |L_ξ η|", defect(lie), *IDENTITY),
        at_most("max |J_ξ + ι_ξ η|", defect(lambda y: momentum(y) + eta(y) @ generator(y)), *IDENTITY),
        at_most("max |dJ_ξ − ι_ξ dη|", defect(lambda y: slope(y) - contraction(y)), *IDENTITY),
    ]
    return Evidence(statement, corrected)


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
    statement = [
        at_most("max |L_X L_ξ β + L_ξ L_X β|/max |L_X L_ξ β|, a one-form β, invariant H", total, *bound),
        at_most("max |L_ξ L_X dη|, H not invariant", largest(lambda y: exterior(other, y), at), *bound),
    ]
    corrected = [
        at_most("max |L_X L_ξ β − L_ξ L_X β|/max |L_X L_ξ β|, invariant H", difference, *bound),
        at_most("max |L_X η + R(H) η|", largest(law, at), *bound),
    ]
    return Evidence(statement, corrected)


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

    nonlinear = SCENES["central"].with_(gamma=gamma, kappa=0.3)
    momentum = function_of(lambda x: nonlinear.momentum(x)[0])

    def defect(y):
        return along(vector_field(nonlinear), momentum, y) + nonlinear.dissipation_rate(y[4]) * momentum(y)

    coefficients = np.random.default_rng(seed).normal(size=(4, 4))

    def invariant(y):
        """Return a contact Hamiltonian that rotations leave alone, not of the form H0(q, p) + Γ(s)."""
        q, p, s = y[:2], y[2:4], y[4]
        u = jnp.array([q @ q, p @ p, q @ p, s])
        return u @ coefficients @ u / 4

    def general(y):
        rate = jax.grad(invariant)(y)[-1]
        return along(contact_equations(invariant), momentum, y) + rate * momentum(y)

    at = points(5, seed=seed)
    of_forces = 10 * ROUND_OFF, "round-off of AD on forces of size up to 100"
    of_quartic = 10 * ROUND_OFF, "round-off of AD on a quartic"
    statement = [
        at_most("max ‖J e^{λt} − J(0)‖/‖J(0)‖ along the true central", deviation("central"), *TRUE),
        at_most("the same for the true rigid body, J = R M", deviation("rigid_body"), *TRUE),
        at_most("max |J' + Γ'(s) J| for Γ = γ s + ½ κ s²", largest(defect, at), *of_forces),
        at_most("max |J' + R(H) J|, random invariant H(q, p, s)", largest(general, at / 2), *of_quartic),
    ]
    return Evidence(statement)


@claim("C12")
def level_sets(gamma: float = 0.1) -> Evidence:
    damped = SCENES["central"].with_(gamma=gamma)

    def change(scene):
        J = momenta(scene)[:, 0]
        return np.abs(J - J[0]).max() / (abs(J[0]) or 1.0)

    straight = damped.with_(q=(1.0, 0.0), p=(0.3, 0.0))
    moves = 1e-3, "far above the uncertainty 10⁻¹³ of the truth"
    statement = [
        at_least(f"max |J(t) − J(0)|/|J(0)| at λ = {gamma:g}", change(damped), *moves),
        at_most("the same at λ = 0", change(damped.with_(gamma=0.0)), *TRUE),
        at_most(f"max |J(t)| at λ = {gamma:g}, J(0) = 0", change(straight), *TRUE),
    ]
    return Evidence(statement)


@claim("C13")
def time_dependent_reduction(gamma: float = 0.1) -> Evidence:
    scene = SCENES["central"].with_(gamma=gamma)
    t = times(scene)
    full = reference(scene, t, ()).states()
    radius, radial = radius_and_speed(full)
    mu = scene.momentum(scene.initial(()))[0]

    def reduced(t, y):
        """Return H_μ = ½ (p_r² + μ(t)²/r²) + V(r), with γ s: the contact equations of (r, p_r) alone."""
        r, p_r = y
        level = mu * np.exp(-scene.gamma * t)
        return [p_r, level**2 / r**3 - scene.dV((r, 0.0))[0] - scene.gamma * p_r]

    run = scipy.integrate.solve_ivp(reduced, (0, scene.t_end), [radius[0], radial[0]], t_eval=t, **SOLVER)
    error = np.hypot(run.y[0] - radius, run.y[1] - radial).max() / np.hypot(radius, radial).max()
    return Evidence([at_most("max ‖(r, p_r) reduced − full‖ / max ‖full‖", error, *SOLVED)])


@claim("C14")
def symplectification(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    """The contact flow is the projection of a homogeneous Hamiltonian flow; there J r is conserved."""

    def lifted(contact):
        """Return K(x, P, s, r) = −r H(x, −P/r, s), of degree one in the momenta P = −r p of x and r of s."""

        def K(z):
            n = (len(z) - 2) // 2
            x, P, s, r = z[:n], z[n : 2 * n], z[-2], z[-1]
            return -r * contact(jnp.concatenate([x, -P / r, s[None]]))

        return K

    def flow(K, z0, t):
        """Hamilton's equations of K for the pairs (x, P) and (s, r)."""
        n = (len(z0) - 2) // 2

        @jax.jit
        def rhs(z):
            slope = jax.grad(K)(z)
            return jnp.concatenate([slope[n : 2 * n], -slope[:n], slope[-1:], -slope[-2:-1]])

        run = scipy.integrate.solve_ivp(lambda _, z: np.asarray(rhs(z)), (0, t[-1]), z0, t_eval=t, **SOLVER)
        return run.y

    scene = SCENES["particle"].with_(gamma=gamma)
    t = np.linspace(0, scene.t_end, 21)
    particle = lifted(lambda y: scene.hamiltonian(canonical(y)))
    start = np.asarray(pack(scene.initial(("s",))))
    run = flow(particle, np.concatenate([start[:2], -start[2:4], start[4:], [1.0]]), t)
    r = run[5]
    projected = np.vstack([run[:2], -run[2:4] / r, run[4]]).T
    truth = reference(scene, t).y

    # central: P_θ = −r J is conserved on the extended space, and its level is reduced as in mechanics
    central = SCENES["central"].with_(gamma=gamma)
    from_start = np.array([*central.q, *(-p for p in central.p), central.s, 1.0])
    full = flow(lifted(lambda y: central.hamiltonian(canonical(y))), from_start, t)
    level = full[0] * full[3] - full[1] * full[2]

    def polar(y):
        """Return H on (ρ, p_ρ, s) with p_θ put in for the conserved level, y = (ρ, θ, p_ρ, p_θ, s)."""
        return (y[2] ** 2 + (y[3] / y[0]) ** 2) / 2 + central.V((y[0], 0.0 * y[0])) + gamma * y[4]

    def reduced(z):
        """Return K on (ρ, P_ρ, s, r) at the level P_θ."""
        ρ, P, s, r = z
        return lifted(polar)(jnp.stack([ρ, 0.0 * ρ, P, level[0] + 0.0 * ρ, s, r]))

    q, p = np.array(central.q), np.array(central.p)
    ρ0 = np.linalg.norm(q)
    down = flow(reduced, np.array([ρ0, -(q @ p) / ρ0, central.s, 1.0]), t)
    true = reference(central, t).states()
    ρ, radial = radius_and_speed(true)
    off = np.abs(np.array([down[0] - ρ, -down[1] / down[3] - radial, down[2] - true.s]))

    def degree(z):
        return particle(z * jnp.array([1, 1, 3.0, 3.0, 1, 3.0])) - 3 * particle(z)

    somewhere = points(6, seed=seed)
    somewhere[:, 5] = 0.5 + np.abs(somewhere[:, 5])
    error = np.linalg.norm(projected - truth, axis=1).max() / np.linalg.norm(truth, axis=1).max()
    change = np.abs(level / level[0] - 1).max()
    rounding = 10 * ROUND_OFF, "round-off of AD on numbers of size up to 100"
    statement = [
        at_most("max ‖projected − true‖ / max ‖true‖", error, *SOLVED),
        at_most("max |r(t) e^{−γt} − 1|", np.abs(r * np.exp(-gamma * t) - 1).max(), *SOLVED),
        at_most("max |K(q, 3P, s, 3r) − 3K(q, P, s, r)|", largest(degree, somewhere), *rounding),
        at_most("max |r J − r(0) J(0)|/|J(0)|, central: the lifted momentum is conserved", change, *SOLVED),
        at_most("max |(ρ, p_ρ, s) reduced, then projected, − true|, central", off.max(), *SOLVED),
    ]
    return Evidence(statement)
