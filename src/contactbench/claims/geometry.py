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
    random_polynomial,
    reeb,
    vector_field,
)
from contactbench.claims.ledger import Correction, Evidence, at_least, at_most, claim
from contactbench.scenes import SCENES
from contactbench.truth import reference
from contactbench.xla import jax, jnp

DEGREES = (1, 2, 3)  #: degrees of freedom on which an identity is tested
SOLVER = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14}
SOLVED = 1e-10, "10³ times the tolerance 10⁻¹³ of the solver it is integrated with"
TRUE = 1e-13, "the reference rounded to double precision, times e^{γT} = 7.4"


def quadratically_damped(gamma=0.1):
    """The particle with Γ(s) = γ s + ½ κ s² in place of γ s."""
    return SCENES["particle"].with_(name="particle, κ = 0.3", gamma=gamma, kappa=0.3)


@claim("C01", "§2.1, eq. (2)", "η ∧ (dη)ⁿ is a volume form.", scene="T*Rⁿ × R, n = 1, 2, 3")
def volume(seed: int = SEED) -> Evidence:
    def density(y):
        """|η ∧ (dη)ⁿ|/n!: the Pfaffian of dη bordered by η."""
        bordered = jnp.block([[jnp.zeros((1, 1)), eta(y)[None]], [-eta(y)[:, None], exterior(eta, y)]])
        return jnp.sqrt(jnp.abs(jnp.linalg.det(bordered)))

    smallest = min(everywhere(density, points(2 * n + 1, seed=seed)).min() for n in DEGREES)
    measured = at_least(
        "min |η ∧ (dη)ⁿ|/n! at random points",
        smallest,
        1 - 1e-9,
        "in canonical coordinates the density is 1; 10⁻⁹ for the determinant of a large p",
    )
    return Evidence([measured])


@claim(
    "C02",
    "§2.2, eqs. (4), (8) and (9)",
    "R = ∂_s is the vector field with η(R) = 1 and ι_R dη = 0, and the only one; its flow preserves η.",
    scene="T*Rⁿ × R, n = 1, 2, 3",
)
def reeb_field(seed: int = SEED) -> Evidence:
    def defect(y):
        unit = jnp.zeros(len(y)).at[-1].set(1.0)
        return jnp.append(unit @ exterior(eta, y), eta(y) @ unit - 1)

    def invariance(y):
        return lie_derivative(lambda y: jnp.zeros(len(y)).at[-1].set(1.0), eta, y)

    def others(y):
        """Second smallest singular value of dη: not 0, so the kernel is a line."""
        return jnp.linalg.svd(exterior(eta, y), compute_uv=False)[-2]

    statement = [
        at_most(
            "max |ι_R dη|, |η(R) − 1| for R = ∂_s",
            max(largest(defect, points(2 * n + 1, seed=seed)) for n in DEGREES),
            *IDENTITY,
        ),
        at_most(
            "max |L_R η|", max(largest(invariance, points(2 * n + 1, seed=seed)) for n in DEGREES), *IDENTITY
        ),
        at_least(
            "second smallest singular value of dη",
            min(everywhere(others, points(2 * n + 1, seed=seed)).min() for n in DEGREES),
            1 - 1e-9,
            "canonical coordinates: all but one are 1",
        ),
    ]
    return Evidence(statement)


@claim(
    "C03",
    "§2.3, eqs. (11) and (23)",
    "The coordinate equations q' = H_p, p' = −H_q − p H_s, s' = p·H_p − H solve ι_X dη = dH − R(H) η, ι_X "
    "η = −H.",
    scene="random cubic H(q, p, s), n = 1, 2, 3; particle, γ s and ½ κ s²",
)
def contact_hamilton_equations(seed: int = SEED) -> Evidence:
    def defect(field, hamiltonian):
        def at(y):
            slope, X = jax.grad(hamiltonian)(y), field(y)
            two = X @ exterior(eta, y) - (slope - slope @ reeb(eta, y) * eta(y))
            return jnp.append(two, eta(y) @ X + hamiltonian(y))

        return at

    random = max(
        largest(defect(contact_equations(H), H), points(2 * n + 1, seed=seed) / 2)
        for n in DEGREES
        for H in [random_polynomial(2 * n + 1, seed)]
    )
    ours = max(
        largest(defect(vector_field(scene), function_of(scene.hamiltonian)), points(5, seed=seed))
        for scene in (SCENES["particle"], quadratically_damped())
    )
    statement = [
        at_most(
            "max defect of the two defining relations, random H",
            random,
            100 * ROUND_OFF,
            "round-off of cubic polynomials with 400 terms of size up to 10",
        ),
        at_most("the same for the right-hand side every method here integrates", ours, *IDENTITY),
    ]
    return Evidence(statement)


@claim(
    "C04",
    "§2.2, eq. (10)",
    "Along the flow H' = −R(H).",
    kind=Correction.replaces,
    correction="H' = −R(H)·H, hence H(t) = H(0) e^{−γt}: the rate is proportional to H. This replaces the claim and "
    "does not repair it: where R(H) > 0 and H < 0, H rises while eq. (10) lets it fall.",
    scene="random cubic H(q, p, s); particle",
)
def hamiltonian_evolution(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    H = random_polynomial(5, seed)
    rate = lambda y: along(contact_equations(H), H, y)  # noqa: E731
    dissipation = lambda y: jax.grad(H)(y) @ reeb(eta, y)  # noqa: E731
    at = points(5, seed=seed) / 2
    scene = SCENES["particle"].with_(gamma=gamma)
    truth = reference(scene, np.linspace(0, scene.t_end, 201)).states()
    value = scene.hamiltonian(truth) * np.exp(scene.gamma * np.linspace(0, scene.t_end, 201))
    statement = [
        at_most(
            "max |H' + R(H)| / max |R(H)|",
            largest(lambda y: rate(y) + dissipation(y), at) / largest(dissipation, at),
            100 * ROUND_OFF,
            "round-off of cubic polynomials with 400 terms of size up to 10",
        )
    ]
    corrected = [
        at_most(
            "max |H' + R(H) H| / max |R(H) H|",
            largest(lambda y: rate(y) + dissipation(y) * H(y), at)
            / largest(lambda y: dissipation(y) * H(y), at),
            100 * ROUND_OFF,
            "round-off of cubic polynomials with 400 terms of size up to 10",
        ),
        at_most(
            "max |H(t) e^{γt}/H(0) − 1| along the true particle", np.abs(value / value[0] - 1).max(), *TRUE
        ),
        at_most(
            "smallest −H'/R(H) at random points",
            everywhere(lambda y: -rate(y) / dissipation(y), at).min(),
            0.0,
            "where it is negative, H goes the other way than claimed",
        ),
    ]
    return Evidence(statement, corrected)


@claim(
    "C05",
    "§2.4.1, eq. (33)",
    "g q̈ + Γ' g q̇ + ∇V = 0 for H0 = ½ g^{ij}(q) p_i p_j + V(q).",
    kind=Correction.repairs,
    correction="True for a constant metric; the paper assumes the Euclidean one in eq. (29), then writes g(q). For "
    "g(q) the acceleration is covariant: g_ij (q̈^j + Γ^j_kl q̇^k q̇^l) + Γ' g_ij q̇^j + ∂_i V "
    "= 0.",
    scene="central in polar coordinates, g = diag(1, r²)",
)
def damped_newton(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    scene = SCENES["central"]

    def potential(q):
        return scene.V((q[0], 0.0 * q[0]))

    def polar(q):
        return jnp.diag(jnp.array([1.0, q[0] ** 2]))

    root = np.random.default_rng(seed).normal(size=(2, 2))
    constant = jnp.asarray(root @ root.T + np.eye(2))

    def newton(metric, connection):
        """The left-hand side of the damped Newton equation along the contact flow of H0 + γ s."""

        def at(y):
            def H(y):
                q, p = y[:2], y[2:4]
                return p @ jnp.linalg.solve(metric(q), p) / 2 + potential(q) + gamma * y[4]

            field = contact_equations(H)
            q, g = y[:2], metric(y[:2])
            velocity = field(y)[:2]
            acceleration = along(field, lambda z: field(z)[:2], y)
            d = jax.jacfwd(metric)(q)  # [i, j, k] = ∂_k g_ij
            christoffel = (
                jnp.einsum("ijk->ijk", d) + jnp.einsum("ikj->ijk", d) - jnp.einsum("jki->ijk", d)
            ) / 2
            curved = jnp.einsum("ijk,j,k", christoffel, velocity, velocity) if connection else 0.0
            return g @ acceleration + curved + gamma * g @ velocity + jax.grad(potential)(q)

        return at

    at = points(5, seed=seed)
    at[:, 0] = 0.5 + np.abs(at[:, 0])  # r > 0
    bound = 100 * ROUND_OFF, "round-off of AD on accelerations of size up to 100"
    statement = [
        at_most("max |g q̈ + Γ' g q̇ + ∇V|, polar coordinates", largest(newton(polar, False), at), *bound),
        at_most("the same, constant metric", largest(newton(lambda q: constant, False), at), *bound),
    ]
    corrected = [
        at_most(
            "the same with the Christoffel term, polar coordinates", largest(newton(polar, True), at), *bound
        )
    ]
    return Evidence(statement, corrected)


@claim("C06", "§2.4.1, eq. (35)", "H0' = −Γ'(s) p·∂H0/∂p.", scene="particle, γ s and γ s + ½ κ s²")
def energy_balance(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    def defect(scene):
        energy = function_of(scene.energy)
        gradient = jax.grad(energy)
        return lambda y: (
            along(vector_field(scene), energy, y) + scene.dissipation_rate(y[4]) * (y[2:4] @ gradient(y)[2:4])
        )

    statement = [
        at_most(f"max |H0' + Γ' p·∂H0/∂p|, {label}", largest(defect(scene), points(5, seed=seed)), *IDENTITY)
        for label, scene in (
            ("Γ = γ s", SCENES["particle"].with_(gamma=gamma)),
            ("Γ = γ s + ½ κ s²", quadratically_damped(gamma)),
        )
    ]
    return Evidence(statement)


@claim(
    "C07",
    "§2.4.1, after eq. (37)",
    "H0 decreases monotonically when Γ' ≥ 0.",
    scene="particle, γ s and γ s + ½ κ s²",
)
def monotone_energy(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    def rate(scene):
        """H0' where Γ'(s) ≥ 0."""
        return lambda y: jnp.where(
            scene.dissipation_rate(y[4]) >= 0,
            along(vector_field(scene), function_of(scene.energy), y),
            -jnp.inf,
        )

    scene = SCENES["particle"].with_(gamma=gamma)
    t = np.linspace(0, scene.t_end, 201)
    energy = scene.energy(reference(scene, t).states())
    highest = max(
        everywhere(rate(s), points(5, 2000, seed)).max() for s in (scene, quadratically_damped(gamma))
    )
    statement = [
        at_most("largest H0' at 2000 random states with Γ' ≥ 0", highest, *IDENTITY),
        at_most(
            "largest rise of H0 between 201 times along the true particle, over H0(0)",
            np.diff(energy).max() / energy[0],
            4 * np.finfo(float).eps,
            "round-off of H0 itself",
        ),
    ]
    return Evidence(statement)


@claim(
    "C08",
    "§2.4.1, Figure 2",
    "The oscillator's orbits are closed at λ = 0 and spiral to the origin with dissipation; R(H) = λ.",
    kind=Correction.extends,
    correction="The orbit is a spiral for 0 < λ < 2ω. From λ = 2ω on it reaches the origin without turning about "
    "it, and for λ < 0, which the text's λ ≠ 0 includes, it recedes.",
    scene="oscillator, ω = 1, λ = 0 and 0.2; λ = 2.5 and −0.2",
    method="none: the closed form",
    figures=("paper_2",),
)
def oscillator_portrait(
    seed: int = SEED, gamma: float = 0.2, overdamped: float = 2.5, start: tuple[float, float] = (1.0, 0.0)
) -> Evidence:
    """gamma : of the spiral, between 0 and 2.  overdamped : ≥ 2.  start : (q, p)."""
    free, damped, slow, driven = (
        SCENES["oscillator"].with_(gamma=g, q=start[:1], p=start[1:])
        for g in (0.0, gamma, overdamped, -gamma)
    )

    def orbit(scene, times):
        return reference(scene, times, ()).y

    def turns(scene, end):
        """Half turns about the origin, by sign changes of q."""
        q = orbit(scene, np.linspace(0, end, 401))[:, 0]
        return np.count_nonzero(np.diff(np.sign(q)))

    gap = np.abs(orbit(free, [2 * math.pi])[0] - np.array(start)).max() / np.linalg.norm(start)
    period = 2 * math.pi / math.sqrt(1 - gamma**2 / 4)
    sizes = np.linalg.norm(orbit(damped, period * np.arange(1, 11)), axis=1)
    away = np.linalg.norm(orbit(driven, period * np.arange(1, 11)), axis=1)
    R_of_H = function_of(damped.hamiltonian)
    statement = [
        at_most(
            "‖y(2π) − y(0)‖/‖y(0)‖ at λ = 0", gap, 1e-14, "round-off of 2π times a velocity of one, and of y"
        ),
        at_most(
            f"largest ratio of ‖y‖ over a turn at λ = {gamma:g}",
            np.max(sizes[1:] / sizes[:-1]),
            math.exp(-gamma * period / 2) * (1 + 1e-12),
            "e^{−λT/2}, T the period of the spiral, up to round-off",
        ),
        at_least(
            f"half turns in ten periods at λ = {gamma:g}", turns(damped, 10 * period), 20, "two a period"
        ),
        at_most(
            "max |R(H) − λ|",
            largest(lambda y: jax.grad(R_of_H)(y)[-1] - gamma, points(3, seed=seed)),
            *IDENTITY,
        ),
    ]
    corrected = [
        at_most(
            f"half turns in the same time at λ = {overdamped:g}",
            turns(slow, 10 * period),
            1,
            "two real eigenvalues: q changes its sign once at most",
        ),
        at_least(
            f"smallest ratio of ‖y‖ over a turn at λ = {-gamma:g}",
            np.min(away[1:] / away[:-1]),
            1.0,
            "it grows",
        ),
    ]
    return Evidence(statement, corrected)


@claim(
    "C37",
    "§2.2, Figure 1",
    "The vertical component of X_H, along the Reeb field, is R(H).",
    kind=Correction.replaces,
    correction="The component along R is η(X_H) = −H: by the definition of X_H, eq. (11). It is no measure of "
    "dissipation: it is there without any, and 0 where H = 0.",
    scene="particle, random states",
)
def vertical_component(seed: int = SEED, gamma: float = 0.1) -> Evidence:
    scene = SCENES["particle"].with_(gamma=gamma)
    H, field = function_of(scene.hamiltonian), vector_field(scene)
    vertical = lambda y: eta(y) @ field(y)  # noqa: E731
    at = points(5, seed=seed)
    statement = [
        at_most(
            "max |η(X_H) − R(H)|",
            largest(lambda y: vertical(y) - jax.grad(H)(y) @ reeb(eta, y), at),
            *IDENTITY,
        )
    ]
    corrected = [
        at_most("max |η(X_H) + H|", largest(lambda y: vertical(y) + H(y), at), *IDENTITY),
        at_most(
            "max |η(X_H + H R)|: what is left is tangential",
            largest(lambda y: eta(y) @ (field(y) + H(y) * reeb(eta, y)), at),
            *IDENTITY,
        ),
    ]
    return Evidence(statement, corrected)


@claim(
    "C38",
    "§2.3, after eq. (15)",
    "s records the history of a motion by accumulating its action or the energy dissipated.",
    kind=Correction.replaces,
    correction="s' = T − V − γs forgets: s(t) = e^{−γt} s(0) + ∫ e^{−γ(t−τ)} (T − V) dτ, which weighs what is 1/γ "
    "ago with 1/e and tends to 0 with the motion, while the energy dissipated tends to H0(0). (Herglotz' action, the "
    "integral of T − V − γs, is s itself, and says nothing.)",
    scene="oscillator, T = 100",
    method="none: the closed form",
)
def memory(gamma: float = 0.1, start: tuple[float, float] = (1.0, 0.0)) -> Evidence:
    """gamma : < 2.  start : (q, p)."""
    end = 10 / gamma
    scene = SCENES["oscillator"].with_(gamma=gamma, q=start[:1], p=start[1:], t_end=end)
    nodes, weights = np.polynomial.legendre.leggauss(600)
    t, weights = end * (nodes + 1) / 2, end * weights / 2
    x = reference(scene, np.append(t, end)).states()
    q, p = x.q[0][:-1], x.p[0][:-1]
    lagrangian, s = (p**2 - q**2) / 2, x.s[-1]
    weighed = weights @ (np.exp(-gamma * (end - t)) * lagrangian)
    nearer = min(abs(s - weights @ lagrangian), abs(s - weights @ (gamma * p**2)))
    solved = 1e-12 * (start[0] ** 2 + start[1] ** 2), "round-off of the quadrature"
    statement = [at_most(f"|s − ∫(T − V)| or |s − ∫γp²| at t = {end:g}, the smaller", nearer, *solved)]
    corrected = [at_most("|s − ∫e^{−γ(t−τ)} (T − V)|", abs(s - weighed), *solved)]
    return Evidence(statement, corrected)


@claim(
    "C42",
    "§2.4.1, Figure 2, caption",
    "Linear dissipation makes the oscillator's mechanical energy decay exponentially.",
    kind=Correction.repairs,
    correction="From turn to turn: for λ < 2ω, H0 e^{λt} is periodic. Within a turn H0 falls at the rate λp², which "
    "is 0 at each turning point.",
    scene="oscillator, λ = 0.1",
    method="none: the closed form",
    figures=("paper_2",),
)
def oscillator_energy(gamma: float = 0.1) -> Evidence:
    """gamma : < 2."""
    scene = SCENES["oscillator"].with_(gamma=gamma)
    half = math.pi / math.sqrt(1 - gamma**2 / 4)
    t = half * np.arange(0, 10, 1 / 64)
    value = scene.energy(reference(scene, t, ()).states()) * np.exp(gamma * t)
    statement = [
        at_most(
            "max |H0(t) e^{λt}/H0(0) − 1|",
            np.abs(value / value[0] - 1).max(),
            1e-2,
            "a line's width in the figure",
        )
    ]
    corrected = [
        at_most(
            "max |change of H0 e^{λt} after a half turn|/H0(0)",
            np.abs(value[64:] - value[:-64]).max() / value[0],
            *TRUE,
        ),
    ]
    return Evidence(statement, corrected)
