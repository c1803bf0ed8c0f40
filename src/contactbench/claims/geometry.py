"""Claims about contact geometry and the contact Hamilton equations (§2, and eq. symplectification)."""

from __future__ import annotations

import math

import numpy as np
from scipy.integrate import solve_ivp

from contactbench.claims.calculus import (
    ROUND_OFF,
    ROUND_OFF_WHY,
    along,
    canonical,
    contact_equations,
    eta,
    everywhere,
    exterior,
    function_of,
    largest,
    lie_derivative,
    packed,
    points,
    pullback,
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
SOLVER_BOUND, SOLVER_WHY = 1e-10, "10³ times the tolerance 10⁻¹³ of the solver it is integrated with"
TRUTH, TRUTH_WHY = 1e-13, "the reference rounded to double precision, times e^{γT} = 7.4"


def quadratically_damped():
    """The particle with Γ(s) = γ s + ½ κ s² in place of γ s."""
    return SCENES["particle"].with_(name="particle, κ = 0.3", gamma=0.1, kappa=0.3)


@claim("C01", "eq:contact-condition", "η ∧ (dη)ⁿ is a volume form.", scene="T*Rⁿ × R, n = 1, 2, 3")
def volume() -> Evidence:
    def density(y):
        """|η ∧ (dη)ⁿ|/n!: the Pfaffian of dη bordered by η."""
        bordered = jnp.block([[jnp.zeros((1, 1)), eta(y)[None]], [-eta(y)[:, None], exterior(eta, y)]])
        return jnp.sqrt(jnp.abs(jnp.linalg.det(bordered)))

    smallest = min(everywhere(density, points(2 * n + 1)).min() for n in DEGREES)
    return Evidence(
        [
            at_least(
                "min |η ∧ (dη)ⁿ|/n! at random points",
                smallest,
                1 - 1e-9,
                "in canonical coordinates the density is 1; 10⁻⁹ for the determinant of a large p",
            )
        ]
    )


@claim(
    "C02",
    "eq:ReebDef, eq:Reeb-in-coordinates",
    "R = ∂_s is the vector field with η(R) = 1 and ι_R dη = 0, and the only one.",
    scene="T*Rⁿ × R, n = 1, 2, 3",
)
def reeb_field() -> Evidence:
    def defect(y):
        unit = jnp.zeros(len(y)).at[-1].set(1.0)
        return jnp.append(unit @ exterior(eta, y), eta(y) @ unit - 1)

    def others(y):
        """Second smallest singular value of dη: not 0, so the kernel is a line."""
        return jnp.linalg.svd(exterior(eta, y), compute_uv=False)[-2]

    return Evidence(
        [
            at_most(
                "max |ι_R dη|, |η(R) − 1| for R = ∂_s",
                max(largest(defect, points(2 * n + 1)) for n in DEGREES),
                ROUND_OFF,
                ROUND_OFF_WHY,
            ),
            at_least(
                "second smallest singular value of dη",
                min(everywhere(others, points(2 * n + 1)).min() for n in DEGREES),
                1 - 1e-9,
                "canonical coordinates: all but one are 1",
            ),
        ]
    )


@claim(
    "C03",
    "eq:contact-vector-field, eq:canonical-contact-equations",
    "The coordinate equations q' = H_p, p' = −H_q − p H_s, s' = p·H_p − H solve ι_X dη = dH − R(H) η, ι_X "
    "η = −H.",
    scene="random cubic H(q, p, s), n = 1, 2, 3; particle, γ s and ½ κ s²",
)
def contact_hamilton_equations() -> Evidence:
    def defect(field, hamiltonian):
        def at(y):
            slope, X = jax.grad(hamiltonian)(y), field(y)
            two = X @ exterior(eta, y) - (slope - slope @ reeb(eta, y) * eta(y))
            return jnp.append(two, eta(y) @ X + hamiltonian(y))

        return at

    random = max(
        largest(defect(contact_equations(H), H), points(2 * n + 1) / 2)
        for n in DEGREES
        for H in [random_polynomial(2 * n + 1)]
    )
    ours = max(
        largest(defect(vector_field(scene), function_of(scene.hamiltonian)), points(5))
        for scene in (SCENES["particle"], quadratically_damped())
    )
    return Evidence(
        [
            at_most(
                "max defect of the two defining relations, random H",
                random,
                100 * ROUND_OFF,
                "round-off of cubic polynomials with 400 terms of size up to 10",
            ),
            at_most(
                "the same for the right-hand side every method here integrates",
                ours,
                ROUND_OFF,
                ROUND_OFF_WHY,
            ),
        ]
    )


@claim(
    "C04",
    "eq:H-evolution-Reeb",
    "Along the flow H' = −R(H).",
    kind=Correction.replaces,
    correction="H' = −R(H)·H, hence H(t) = H(0) e^{−γt}: the rate is proportional to H.",
    scene="random cubic H(q, p, s); particle",
)
def hamiltonian_evolution() -> Evidence:
    H = random_polynomial(5)
    rate = lambda y: along(contact_equations(H), H, y)  # noqa: E731
    dissipation = lambda y: jax.grad(H)(y) @ reeb(eta, y)  # noqa: E731
    at = points(5) / 2
    scene = SCENES["particle"]
    truth = reference(scene, np.linspace(0, scene.t_end, 201)).states()
    value = scene.hamiltonian(truth) * np.exp(scene.gamma * np.linspace(0, scene.t_end, 201))
    return Evidence(
        [
            at_most(
                "max |H' + R(H)| / max |R(H)|",
                largest(lambda y: rate(y) + dissipation(y), at) / largest(dissipation, at),
                100 * ROUND_OFF,
                "round-off of cubic polynomials with 400 terms of size up to 10",
            )
        ],
        [
            at_most(
                "max |H' + R(H) H| / max |R(H) H|",
                largest(lambda y: rate(y) + dissipation(y) * H(y), at)
                / largest(lambda y: dissipation(y) * H(y), at),
                100 * ROUND_OFF,
                "round-off of cubic polynomials with 400 terms of size up to 10",
            ),
            at_most(
                "max |H(t) e^{γt}/H(0) − 1| along the true particle",
                np.abs(value / value[0] - 1).max(),
                TRUTH,
                TRUTH_WHY,
            ),
        ],
    )


@claim(
    "C05",
    "eq:damped-Newton",
    "g q̈ + Γ' g q̇ + ∇V = 0 for H0 = ½ g^{ij}(q) p_i p_j + V(q).",
    kind=Correction.repairs,
    correction="True for a constant metric, which is what the paper assumes two equations earlier. For "
    "g(q) the acceleration is covariant: g_ij (q̈^j + Γ^j_kl q̇^k q̇^l) + Γ' g_ij q̇^j + ∂_i V "
    "= 0.",
    scene="central in polar coordinates, g = diag(1, r²)",
)
def damped_newton() -> Evidence:
    scene = SCENES["central"]
    gamma = scene.gamma

    def potential(q):
        return scene.V((q[0], 0.0 * q[0]))

    def polar(q):
        return jnp.diag(jnp.array([1.0, q[0] ** 2]))

    root = np.random.default_rng(1).normal(size=(2, 2))
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

    at = points(5)
    at[:, 0] = 0.5 + np.abs(at[:, 0])  # r > 0
    bound = 100 * ROUND_OFF, "round-off of AD on accelerations of size up to 100"
    return Evidence(
        [
            at_most("max |g q̈ + Γ' g q̇ + ∇V|, polar coordinates", largest(newton(polar, False), at), *bound),
            at_most("the same, constant metric", largest(newton(lambda q: constant, False), at), *bound),
        ],
        [
            at_most(
                "the same with the Christoffel term, polar coordinates",
                largest(newton(polar, True), at),
                *bound,
            )
        ],
    )


@claim("C06", "eq:dH0dt-intrinsic", "H0' = −Γ'(s) p·∂H0/∂p.", scene="particle, γ s and γ s + ½ κ s²")
def energy_balance() -> Evidence:
    def defect(scene):
        energy = function_of(scene.energy)
        gradient = jax.grad(energy)
        return lambda y: (
            along(vector_field(scene), energy, y) + scene.dissipation_rate(y[4]) * (y[2:4] @ gradient(y)[2:4])
        )

    return Evidence(
        [
            at_most(
                f"max |H0' + Γ' p·∂H0/∂p|, {label}",
                largest(defect(scene), points(5)),
                ROUND_OFF,
                ROUND_OFF_WHY,
            )
            for label, scene in (
                ("Γ = γ s", SCENES["particle"]),
                ("Γ = γ s + ½ κ s²", quadratically_damped()),
            )
        ]
    )


@claim(
    "C07",
    "after eq:dH0dt-quadratic",
    "H0 decreases monotonically when Γ' ≥ 0.",
    scene="particle, γ s and γ s + ½ κ s²",
)
def monotone_energy() -> Evidence:
    def rate(scene):
        """H0' where Γ'(s) ≥ 0."""
        return lambda y: jnp.where(
            scene.dissipation_rate(y[4]) >= 0,
            along(vector_field(scene), function_of(scene.energy), y),
            -jnp.inf,
        )

    scene = SCENES["particle"]
    t = np.linspace(0, scene.t_end, 201)
    energy = scene.energy(reference(scene, t).states())
    highest = max(everywhere(rate(s), points(5, 2000)).max() for s in (scene, quadratically_damped()))
    return Evidence(
        [
            at_most("largest H0' at 2000 random states with Γ' ≥ 0", highest, ROUND_OFF, ROUND_OFF_WHY),
            at_most(
                "largest rise of H0 between 201 times along the true particle, over H0(0)",
                np.diff(energy).max() / energy[0],
                4 * np.finfo(float).eps,
                "round-off of H0 itself",
            ),
        ]
    )


@claim(
    "C08",
    "fig2",
    "The oscillator's orbits are closed at λ = 0 and spiral to the origin for λ > 0; R(H) = λ.",
    scene="oscillator, λ = 0 and 0.2",
    method="none: the closed form",
    figures=("paper_2",),
)
def oscillator_portrait() -> Evidence:
    free, damped = (SCENES["oscillator"].with_(gamma=g) for g in (0.0, 0.2))
    start = free.pack(free.initial(()))

    def orbit(scene, times):
        return reference(scene, times, ()).y

    gap = np.abs(orbit(free, [2 * math.pi])[0] - start).max()
    period = 2 * math.pi / math.sqrt(1 - damped.gamma**2 / 4)
    turns = np.linalg.norm(orbit(damped, period * np.arange(1, 11)), axis=1)
    R_of_H = function_of(damped.hamiltonian)
    return Evidence(
        [
            at_most(
                "‖y(2π) − y(0)‖ at λ = 0", gap, 1e-14, "round-off of 2π times a velocity of one, and of y"
            ),
            at_most(
                "largest ratio of |y| over a turn at λ = 0.2",
                np.max(turns[1:] / turns[:-1]),
                math.exp(-damped.gamma * period / 2) * (1 + 1e-12),
                "e^{−λT/2}, T the period of the spiral, up to round-off",
            ),
            at_most(
                "max |R(H) − λ|",
                largest(lambda y: jax.grad(R_of_H)(y)[-1] - damped.gamma, points(3)),
                ROUND_OFF,
                ROUND_OFF_WHY,
            ),
        ]
    )


def turned(y, angle, axis=None):
    """The cotangent lift of a rotation, on T*R² × R or T*R³ × R."""
    n = (len(y) - 1) // 2
    if n == 2:
        c, s = jnp.cos(angle), jnp.sin(angle)
        matrix = jnp.array([[c, -s], [s, c]])
    else:
        hat = jnp.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0.0]])
        matrix = jnp.eye(3) + jnp.sin(angle) * hat + (1 - jnp.cos(angle)) * hat @ hat  # Rodrigues
    return jnp.concatenate([matrix @ y[:n], matrix @ y[n : 2 * n], y[2 * n :]])


AXIS = np.array([0.48, 0.6, 0.64])  #: a unit vector


@claim(
    "C09",
    "eq:strict-invariance",
    "Cotangent lifts, extended trivially in s, preserve η.",
    scene="T*R² × R, T*R³ × R",
)
def cotangent_lifts() -> Evidence:
    def bend(q):
        """A diffeomorphism of R² that is no rotation."""
        return jnp.array([q[0] + jnp.tanh(q[1]), q[1] + jnp.sin(q[0] + jnp.tanh(q[1])) / 2])

    def lifted(y):
        q, p = y[:2], y[2:4]
        return jnp.concatenate([bend(q), jnp.linalg.solve(jax.jacfwd(bend)(q).T, p), y[4:]])

    def strictness(map_):
        return lambda y: pullback(map_, eta, y) - eta(y)

    defects = {
        "rotations of the plane": (lambda y: turned(y, 0.7), points(5)),
        "rotations of space": (lambda y: turned(y, 0.7, AXIS), points(7)),
        "a nonlinear change of coordinates": (lifted, points(5)),
    }
    return Evidence(
        [
            at_most(
                f"max |Φ*η − η|, {label}",
                largest(strictness(map_), at),
                ROUND_OFF,
                ROUND_OFF_WHY,
            )
            for label, (map_, at) in defects.items()
        ]
    )


@claim(
    "C10",
    "eq:xiM-Lie-eta",
    "Strictness implies L_ξ η = −dJ_ξ.",
    kind=Correction.replaces,
    correction="L_ξ η = 0, which is what strictness says; J_ξ = −ι_ξ η, and dJ_ξ = ι_ξ dη.",
    scene="T*R³ × R under rotations",
)
def infinitesimal_strictness() -> Evidence:
    def generator(y):
        return jax.jvp(lambda angle: turned(y, angle, AXIS), (0.0,), (1.0,))[1]

    def momentum(y):
        return jnp.dot(AXIS, jnp.cross(y[:3], y[3:6]))

    lie = lambda y: lie_derivative(generator, eta, y)  # noqa: E731
    at = points(7)
    return Evidence(
        [
            at_most(
                "max |L_ξ η + dJ_ξ|",
                largest(lambda y: lie(y) + jax.grad(momentum)(y), at),
                ROUND_OFF,
                ROUND_OFF_WHY,
            )
        ],
        [
            at_most("max |L_ξ η|", largest(lie, at), ROUND_OFF, ROUND_OFF_WHY),
            at_most(
                "max |J_ξ + ι_ξ η|",
                largest(lambda y: momentum(y) + eta(y) @ generator(y), at),
                ROUND_OFF,
                ROUND_OFF_WHY,
            ),
            at_most(
                "max |dJ_ξ − ι_ξ dη|",
                largest(lambda y: jax.grad(momentum)(y) - generator(y) @ exterior(eta, y), at),
                ROUND_OFF,
                ROUND_OFF_WHY,
            ),
        ],
    )


@claim(
    "C14",
    "eq:symplectification",
    "The contact flow is the projection of a homogeneous Hamiltonian flow on (M × R₊, d(rη)).",
    scene="particle",
    method="SciPy DOP853, rtol 10⁻¹³, on Hamilton's equations",
)
def symplectification() -> Evidence:
    scene = SCENES["particle"]

    def homogeneous(z):
        """K(q, P, s, r) = −r H(q, −P/r, s), of degree one in the momenta P = −r p of q and r of s."""
        q, P, s, r = z[:2], z[2:4], z[4], z[5]
        return -r * scene.hamiltonian(canonical(jnp.concatenate([q, -P / r, s[None]])))

    def hamilton(_, z):
        slope = jax.grad(homogeneous)(z)
        return jnp.concatenate([slope[2:4], -slope[:2], slope[5:6], -slope[4:5]])

    compiled = jax.jit(hamilton)
    start = packed(scene.initial(("s",)))
    r0 = 1.0
    z0 = np.concatenate([start[:2], -r0 * start[2:4], start[4:], [r0]])
    t = np.linspace(0, scene.t_end, 21)
    run = solve_ivp(lambda t, z: np.asarray(compiled(t, z)), (0, scene.t_end), z0, t_eval=t, **SOLVER)
    q, P, s, r = run.y[:2], run.y[2:4], run.y[4], run.y[5]
    projected = np.vstack([q, -P / r, s]).T
    truth = reference(scene, t).y

    def degree(z):
        scaled = z * jnp.array([1, 1, 3.0, 3.0, 1, 3.0])
        return homogeneous(scaled) - 3 * homogeneous(z)

    somewhere = points(6)
    somewhere[:, 5] = 0.5 + np.abs(somewhere[:, 5])
    return Evidence(
        [
            at_most(
                "max ‖projected − true‖ / max ‖true‖",
                np.linalg.norm(projected - truth, axis=1).max() / np.linalg.norm(truth, axis=1).max(),
                SOLVER_BOUND,
                SOLVER_WHY,
            ),
            at_most(
                "max |r(t) e^{−γt} − 1|",
                np.abs(r * np.exp(-scene.gamma * t) - 1).max(),
                SOLVER_BOUND,
                SOLVER_WHY,
            ),
            at_most(
                "max |K(q, 3P, s, 3r) − 3K(q, P, s, r)|",
                largest(degree, somewhere),
                10 * ROUND_OFF,
                "round-off of AD on numbers of size up to 100",
            ),
        ]
    )
