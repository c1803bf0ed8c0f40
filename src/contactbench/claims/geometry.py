"""Claims about contact geometry and the contact Hamilton equations (§2 of the paper)."""

from __future__ import annotations

import math

import numpy as np

from contactbench.claims.calculus import (
    IDENTITY,
    ROUND_OFF,
    SEED,
    along,
    contact_equations,
    eta,
    everywhere,
    exterior,
    function_of,
    largest,
    lie_derivative,
    points,
    reeb,
    vector_field,
)
from contactbench.claims.ledger import CORRECTED, Evidence, at_least, at_most, claim
from contactbench.scenes import SCENES
from contactbench.truth import reference
from contactbench.xla import jax, jnp

SOLVER = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14}
SOLVED = 1e-10, "10³ times the tolerance 10⁻¹³ of the solver it is integrated with"
TRUE = 1e-13, "the reference rounded to double precision, times e^{γT} = 7.4"
CUBIC = 100 * ROUND_OFF, "round-off of cubic polynomials with 400 terms of size up to 10"
LINE_WIDTH = 1e-2, "a line's width in the figure"


def quadratically_damped(gamma=0.1):
    """Return the particle with Γ(s) = γ s + ½ κ s² in place of γ s."""
    return SCENES["particle"].with_(name="particle, κ = 0.3", gamma=gamma, kappa=0.3)


def points_by_degree(seed):
    """Return random points of T*Rⁿ × R for n = 1, 2, 3."""
    return [points(2 * n + 1, seed=seed) for n in (1, 2, 3)]


def random_polynomial(dimension, seed):
    """Return a random cubic polynomial of y, all its coefficients of size one."""
    rng = np.random.default_rng(seed)
    constant, linear, quadratic, cubic = (jnp.asarray(rng.normal(size=(dimension,) * k)) for k in range(4))
    return lambda y: constant + linear @ y + y @ quadratic @ y + jnp.einsum("ijk,i,j,k", cubic, y, y, y)


@claim("C01")
def volume(seed: int = SEED) -> Evidence:
    def density(y):
        """Return |η ∧ (dη)ⁿ|/n!: the Pfaffian of dη bordered by η."""
        bordered = jnp.block([[jnp.zeros((1, 1)), eta(y)[None]], [-eta(y)[:, None], exterior(eta, y)]])
        return jnp.sqrt(jnp.abs(jnp.linalg.det(bordered)))

    smallest = min(everywhere(density, at).min() for at in points_by_degree(seed))
    one = 1 - 1e-9, "in canonical coordinates the density is 1; 10⁻⁹ for the determinant of a large p"
    yield at_least("min |η ∧ (dη)ⁿ|/n! at random points", smallest, *one)


@claim("C02")
def reeb_field(seed: int = SEED) -> Evidence:
    def unit(y):
        return jnp.zeros(len(y)).at[-1].set(1.0)

    def defect(y):
        return jnp.append(unit(y) @ exterior(eta, y), eta(y) @ unit(y) - 1)

    def second(y):
        """Return the second smallest singular value of dη: not 0, so the kernel is a line."""
        return jnp.linalg.svd(exterior(eta, y), compute_uv=False)[-2]

    at = points_by_degree(seed)
    off = max(largest(defect, some) for some in at)
    invariance = max(largest(lambda y: lie_derivative(unit, eta, y), some) for some in at)
    ones = 1 - 1e-9, "canonical coordinates: all but one are 1"
    smallest = min(everywhere(second, some).min() for some in at)
    yield at_most("max |ι_R dη|, |η(R) − 1| for R = ∂_s", off, *IDENTITY)
    yield at_most("max |L_R η|", invariance, *IDENTITY)
    yield at_least("second smallest singular value of dη", smallest, *ones)


@claim("C03")
def contact_hamilton_equations(seed: int = SEED) -> Evidence:
    def defect(field, hamiltonian):
        def at(y):
            slope, X = jax.grad(hamiltonian)(y), field(y)
            two = X @ exterior(eta, y) - (slope - slope @ reeb(eta, y) * eta(y))
            return jnp.append(two, eta(y) @ X + hamiltonian(y))

        return at

    def of_polynomial(at):
        H = random_polynomial(at.shape[1], seed)
        return largest(defect(contact_equations(H), H), at / 2)

    def of_scene(scene):
        return largest(defect(vector_field(scene), function_of(scene.hamiltonian)), points(5, seed=seed))

    random = max(map(of_polynomial, points_by_degree(seed)))
    ours = max(map(of_scene, (SCENES["particle"], quadratically_damped())))
    yield at_most("max defect of the two defining relations, random H", random, *CUBIC)
    yield at_most("the same for the right-hand side every method here integrates", ours, *IDENTITY)


@claim("C04")
def hamiltonian_evolution(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    H = random_polynomial(5, seed)
    rate = lambda y: along(contact_equations(H), H, y)  # noqa: E731
    dissipation = lambda y: jax.grad(H)(y) @ reeb(eta, y)  # noqa: E731
    at = points(5, seed=seed) / 2
    scene = SCENES["particle"].with_(gamma=gamma)
    t = np.linspace(0, scene.t_end, 201)
    value = scene.hamiltonian(reference(scene, t).states()) * np.exp(scene.gamma * t)

    def relative(law):
        """Return max |H' + law| / max |law|."""
        return largest(lambda y: rate(y) + law(y), at) / largest(law, at)

    smallest = everywhere(lambda y: -rate(y) / dissipation(y), at).min()
    off = np.abs(value / value[0] - 1).max()
    rises = 0.0, "where it is negative, H goes the other way than claimed"
    yield at_most("max |H' + R(H)| / max |R(H)|", relative(dissipation), *CUBIC)
    yield CORRECTED
    yield at_most("max |H' + R(H) H| / max |R(H) H|", relative(lambda y: dissipation(y) * H(y)), *CUBIC)
    yield at_most("max |H(t) e^{γt}/H(0) − 1| along the true particle", off, *TRUE)
    yield at_most("smallest −H'/R(H) at random points", smallest, *rises)


@claim("C05")
def damped_newton(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    scene = SCENES["central"]
    root = np.random.default_rng(seed).normal(size=(2, 2))
    constant = jnp.asarray(root @ root.T + np.eye(2))
    at = points(5, seed=seed)
    at[:, 0] = 0.5 + np.abs(at[:, 0])  # r > 0

    def potential(q):
        return scene.V((q[0], 0.0 * q[0]))

    def polar(q):
        return jnp.diag(jnp.array([1.0, q[0] ** 2]))

    def defect(metric, connection):
        """Return the largest left-hand side of the damped Newton equation along the contact flow of H0 + γ s."""

        def H(y):
            q, p = y[:2], y[2:4]
            return p @ jnp.linalg.solve(metric(q), p) / 2 + potential(q) + gamma * y[4]

        field = contact_equations(H)

        def newton(y):
            q, g = y[:2], metric(y[:2])
            velocity = field(y)[:2]
            acceleration = along(field, lambda z: field(z)[:2], y)
            d = jax.jacfwd(metric)(q)  # [i, j, k] = ∂_k g_ij
            christoffel = (d + jnp.einsum("ikj->ijk", d) - jnp.einsum("jki->ijk", d)) / 2
            curved = jnp.einsum("ijk,j,k", christoffel, velocity, velocity) if connection else 0.0
            return g @ acceleration + curved + gamma * g @ velocity + jax.grad(potential)(q)

        return largest(newton, at)

    bound = 100 * ROUND_OFF, "round-off of AD on accelerations of size up to 100"
    yield at_most("max |g q̈ + Γ' g q̇ + ∇V|, polar coordinates", defect(polar, False), *bound)
    yield at_most("the same, constant metric", defect(lambda q: constant, False), *bound)
    yield CORRECTED
    yield at_most("the same with the Christoffel term, polar coordinates", defect(polar, True), *bound)


@claim("C06")
def energy_balance(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    def defect(scene):
        energy, field = function_of(scene.energy), vector_field(scene)

        def at(y):
            return along(field, energy, y) + scene.dissipation_rate(y[4]) * (
                y[2:4] @ jax.grad(energy)(y)[2:4]
            )

        return largest(at, points(5, seed=seed))

    linear, quadratic = SCENES["particle"].with_(gamma=gamma), quadratically_damped(gamma)
    yield at_most("max |H0' + Γ' p·∂H0/∂p|, Γ = γ s", defect(linear), *IDENTITY)
    yield at_most("max |H0' + Γ' p·∂H0/∂p|, Γ = γ s + ½ κ s²", defect(quadratic), *IDENTITY)


@claim("C07")
def monotone_energy(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    def rate(scene):
        """Return H0' where Γ'(s) ≥ 0."""
        change = lambda y: along(vector_field(scene), function_of(scene.energy), y)  # noqa: E731
        return lambda y: jnp.where(scene.dissipation_rate(y[4]) >= 0, change(y), -jnp.inf)

    scene = SCENES["particle"].with_(gamma=gamma)
    energy = scene.energy(reference(scene, np.linspace(0, scene.t_end, 201)).states())
    at = points(5, 2000, seed)
    highest = max(everywhere(rate(s), at).max() for s in (scene, quadratically_damped(gamma)))
    rise = np.diff(energy).max() / energy[0]
    rounding = 4 * np.finfo(float).eps, "round-off of H0 itself"
    yield at_most("largest H0' at 2000 random states with Γ' ≥ 0", highest, *IDENTITY)
    yield at_most("largest rise of H0 between 201 times along the true particle, over H0(0)", rise, *rounding)


@claim("C08")
def oscillator_portrait(
    seed: int = SEED, gamma: float = 0.2, overdamped: float = 2.5, start: tuple[float, float] = (1.0, 0.0)
) -> Evidence:
    """gamma : of the spiral, between 0 and 2.  overdamped : ≥ 2.  start : (q, p)."""
    given = SCENES["oscillator"].with_(q=start[:1], p=start[1:])
    free, damped, slow, driven = (given.with_(gamma=rate) for rate in (0.0, gamma, overdamped, -gamma))
    period = 2 * math.pi / math.sqrt(1 - gamma**2 / 4)

    def orbit(scene, times):
        return reference(scene, times, ()).y

    def half_turns(scene):
        """Return the half turns about the origin in ten periods, by sign changes of q."""
        q = orbit(scene, np.linspace(0, 10 * period, 401))[:, 0]
        return np.count_nonzero(np.diff(np.sign(q)))

    def ratios(scene):
        """Return ‖y‖ after each of ten turns over ‖y‖ before it."""
        sizes = np.linalg.norm(orbit(scene, period * np.arange(1, 11)), axis=1)
        return sizes[1:] / sizes[:-1]

    gap = np.abs(orbit(free, [2 * math.pi])[0] - np.array(start)).max() / np.linalg.norm(start)
    R_of_H = jax.grad(function_of(damped.hamiltonian))
    reeb_rate = largest(lambda y: R_of_H(y)[-1] - gamma, points(3, seed=seed))
    rounding = 1e-14, "round-off of 2π times a velocity of one, and of y"
    shrinks = math.exp(-gamma * period / 2) * (1 + 1e-12)
    spiral = shrinks, "e^{−λT/2}, T the period of the spiral, up to round-off"
    creeping, grows = (1, "two real eigenvalues: q changes its sign once at most"), (1.0, "it grows")
    yield at_most("‖y(2π) − y(0)‖/‖y(0)‖ at λ = 0", gap, *rounding)
    yield at_most(f"largest ratio of ‖y‖ over a turn at λ = {gamma:g}", np.max(ratios(damped)), *spiral)
    yield at_least(f"half turns in ten periods at λ = {gamma:g}", half_turns(damped), 20, "two a period")
    yield at_most("max |R(H) − λ|", reeb_rate, *IDENTITY)
    yield CORRECTED
    yield at_most(f"half turns in the same time at λ = {overdamped:g}", half_turns(slow), *creeping)
    yield at_least(f"smallest ratio of ‖y‖ over a turn at λ = {-gamma:g}", np.min(ratios(driven)), *grows)


@claim("C37")
def vertical_component(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    scene = SCENES["particle"].with_(gamma=gamma)
    H, field = function_of(scene.hamiltonian), vector_field(scene)
    vertical = lambda y: eta(y) @ field(y)  # noqa: E731
    at = points(5, seed=seed)
    from_dissipation = largest(lambda y: vertical(y) - jax.grad(H)(y) @ reeb(eta, y), at)
    yield at_most("max |η(X_H) − R(H)|", from_dissipation, *IDENTITY)
    yield CORRECTED
    yield at_most("max |η(X_H) + H|", largest(lambda y: vertical(y) + H(y), at), *IDENTITY)


@claim("C38")
def memory(gamma: float = 0.1, start: tuple[float, float] = (1.0, 0.0)) -> Evidence:
    """gamma : < 2.  start : (q, p)."""
    end = 10 / gamma
    scene = SCENES["oscillator"].with_(gamma=gamma, q=start[:1], p=start[1:], t_end=end)
    nodes, weights = np.polynomial.legendre.leggauss(600)
    t, weights = end * (nodes + 1) / 2, end * weights / 2
    x = reference(scene, np.append(t, end)).states()
    q, p, s = x.q[0][:-1], x.p[0][:-1], x.s[-1]
    lagrangian = (p**2 - q**2) / 2
    weighed = weights @ (np.exp(-gamma * (end - t)) * lagrangian)
    nearer = min(abs(s - weights @ lagrangian), abs(s - weights @ (gamma * p**2)))
    solved = 1e-12 * (start[0] ** 2 + start[1] ** 2), "round-off of the quadrature"
    yield at_most(f"|s − ∫(T − V)| or |s − ∫γp²| at t = {end:g}, the smaller", nearer, *solved)
    yield CORRECTED
    yield at_most("|s − ∫e^{−γ(t−τ)} (T − V)|", abs(s - weighed), *solved)


@claim("C42")
def oscillator_energy(gamma: float = 0.1) -> Evidence:
    """gamma : < 2."""
    scene = SCENES["oscillator"].with_(gamma=gamma)
    half = math.pi / math.sqrt(1 - gamma**2 / 4)
    t = half * np.arange(0, 10, 1 / 64)
    value = scene.energy(reference(scene, t, ()).states()) * np.exp(gamma * t)
    off, change = np.abs(value / value[0] - 1).max(), np.abs(value[64:] - value[:-64]).max() / value[0]
    yield at_most("max |H0(t) e^{λt}/H0(0) − 1|", off, *LINE_WIDTH)
    yield CORRECTED
    yield at_most("max |change of H0 e^{λt} after a half turn|/H0(0)", change, *TRUE)
