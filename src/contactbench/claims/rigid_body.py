"""Claims about the damped rigid body (§4 of the paper)."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq, least_squares

from contactbench.claims.calculus import (
    ROUND_OFF,
    ROUND_OFF_WHY,
    along,
    body_chart,
    body_eta,
    contact_field,
    largest,
    packed,
    points,
    turned_left,
)
from contactbench.claims.ledger import Correction, Evidence, at_least, at_most, claim
from contactbench.methods import solve
from contactbench.scene import BodyState, RigidBody, cross
from contactbench.scenes import SCENES
from contactbench.truth import reference
from contactbench.xla import jax, jnp

BODY = "rigid_body"
ANISOTROPIC = "rigid_body_anisotropic"
DOP853 = "scipy-dop853, rtol 10⁻¹³"
COARSER = "scipy-dop853, rtol 10⁻¹² and 10⁻⁹"
SOLVER_BOUND, SOLVER_WHY = 1e-10, "10³ times the tolerance 10⁻¹³ of the solver"
SPECTRUM, SPECTRUM_WHY = 1e-12, "round-off of the eigenvalues of a 3×3 matrix of size one"


def momentum_rate(scene: RigidBody):
    """M' as a function of M, by the scene's right-hand side."""
    return lambda M: packed(scene.rhs(BodyState(tuple(M))))


def equation(inertia, D):
    """M × I⁻¹M − D M for any matrix D, symmetric or not (eq. anisotropic)."""
    return lambda M: np.array(cross(M, M / inertia)) - D @ M


def with_damping(*rates: float, inertia=(1.0, 2.0, 3.0)) -> RigidBody:
    """The anisotropic body with other damping rates about its principal axes."""
    return SCENES[ANISOTROPIC].with_(damping=rates, inertia=inertia)


def spectrum(matrix, M) -> np.ndarray:
    """Eigenvalues of a linearisation at an equilibrium M on a principal axis, the one along it last."""
    axis = int(np.argmax(np.abs(M)))
    across = [i for i in range(3) if i != axis]
    return np.append(np.linalg.eigvals(matrix[np.ix_(across, across)]), matrix[axis, axis])


def spectra(scenes, momenta) -> np.ndarray:
    """`spectrum` of many diagonal D at many equilibria, linearised by AD of the right-hand side; (k, 3)."""

    def linearisation(numbers, M):
        return jax.jacfwd(momentum_rate(scenes[0].with_numbers(list(numbers))))(M)

    numbers = np.array([scene.numbers() for scene in scenes])
    matrices = np.asarray(jax.jit(jax.vmap(linearisation))(numbers, np.array(momenta, dtype=float)))
    return np.array([spectrum(matrix, M) for matrix, M in zip(matrices, momenta, strict=True)])


def growths(scenes, momenta) -> np.ndarray:
    """Largest growth rate across the line of equilibria through each M."""
    return spectra(scenes, momenta)[:, :2].real.max(axis=1)


def growth(scene: RigidBody, M) -> float:
    """The same for one case."""
    matrix = np.asarray(jax.jacfwd(momentum_rate(scene))(jnp.asarray(M, dtype=float)))
    return float(spectrum(matrix, M)[:2].real.max())


@claim(
    "C15",
    "eq:rb-R, eq:rb-M, eq:rb-s",
    "H = ½ M·I⁻¹M + γ s on T*SO(3) × R gives R' = R Ω̂, M' = M × Ω − γM, s' = ½ M·Ω − γ s.",
    scene=BODY,
)
def body_equations() -> Evidence:
    scene = SCENES[BODY]
    form = body_eta(scene)

    def defect(y):
        """X_H from its definition in a chart of T*SO(3) × R, against the equations."""
        X = contact_field(form, lambda y: scene.hamiltonian(body_chart(y)), y)
        moved = jax.jvp(body_chart, (y,), (X,))[1]
        return packed(moved) - packed(scene.rhs(body_chart(y)))

    return Evidence(
        [
            at_most(
                "max |X_H by definition − equations| at random (R, M, s)",
                largest(defect, points(7)),
                10 * ROUND_OFF,
                "round-off of AD through a chart whose metric is conditioned up to 10",
            )
        ]
    )


@claim(
    "C16",
    "eq:rb-J",
    "The left action of SO(3) has momentum map J(R, M) = M.",
    kind=Correction.replaces,
    correction="J = R M, the spatial momentum. It decays as e^{−γt}, component by component; body M does "
    "not. (M is the momentum map of the right action.)",
    scene=BODY,
)
def body_momentum_map() -> Evidence:
    scene = SCENES[BODY]
    unit = np.eye(3)

    def momentum_map(y):
        """J_ξ = −ι_ξ η for the rotations ξ = e_i in space."""
        x = body_chart(y)

        def component(axis):
            dR = jax.jvp(lambda angle: turned_left(axis, angle, x.R), (0.0,), (1.0,))[1]
            return -scene.contact_form(x, BodyState((0.0,) * 3, dR, 0.0))

        return jnp.stack([component(axis) for axis in unit])

    def against(candidate):
        return largest(lambda y: momentum_map(y) - jnp.stack(candidate(body_chart(y))), points(7))

    t = np.linspace(0, scene.t_end, 201)
    truth = reference(scene, t).states()
    scaled = np.array(truth.M) * np.exp(scene.gamma * t)
    J = np.array(scene.momentum(truth)) * np.exp(scene.gamma * t)
    size = np.linalg.norm(scaled[:, 0])
    why = "the reference rounded to double precision, times e^{γT} = 7.4"
    return Evidence(
        [
            at_most(
                "max |J_ξ − M·ξ| at random (R, M), J_ξ = −ι_ξ η",
                against(lambda x: x.M),
                ROUND_OFF,
                ROUND_OFF_WHY,
            ),
            at_most(
                "max |M_i(t) e^{γt} − M_i(0)|/‖M(0)‖ along the true body",
                np.abs(scaled - scaled[:, :1]).max() / size,
                1e-13,
                why,
            ),
        ],
        [
            at_most(
                "max |J_ξ − (R M)·ξ|, the suite's momentum map",
                against(scene.momentum),
                ROUND_OFF,
                ROUND_OFF_WHY,
            ),
            at_most(
                "max |(R M)_i(t) e^{γt} − (R M)_i(0)|/‖M(0)‖", np.abs(J - J[:, :1]).max() / size, 1e-13, why
            ),
        ],
    )


@claim("C17", "eq:H0-decay-rb", "With isotropic damping H0(t) = H0(0) e^{−2γt}.", scene=BODY, method=DOP853)
def body_energy() -> Evidence:
    scene = SCENES[BODY]
    run = solve(scene, "scipy-dop853", rtol=1e-13, save_at=np.linspace(0, scene.t_end, 21), carry=())
    energy = scene.energy(run.states()) * np.exp(2 * scene.gamma * run.t)

    def energy_of(M):
        return scene.energy(BodyState(tuple(M)))

    return Evidence(
        [
            at_most(
                "max |H0(t) e^{2γt}/H0(0) − 1|",
                np.abs(energy / energy[0] - 1).max(),
                SOLVER_BOUND,
                SOLVER_WHY,
            ),
            at_most(
                "max |H0' + 2γ H0| at random M",
                largest(
                    lambda M: along(momentum_rate(scene), energy_of, M) + 2 * scene.gamma * energy_of(M),
                    points(3),
                ),
                ROUND_OFF,
                ROUND_OFF_WHY,
            ),
        ]
    )


INERTIA = np.array([1.0, 2.0, 3.0])
STARTS = 12


def distance_from_set(M, D) -> float:
    """How far M is from {D M = 0, M ∥ a principal axis}, relative to its size."""
    u = M / np.linalg.norm(M)
    return float(max(np.linalg.norm(D @ u), np.sqrt(max(0.0, 1 - np.max(u * u)))))


def equilibria(D, rng) -> list[np.ndarray]:
    """Nonzero solutions of M × I⁻¹M = D M found from random starts, by least squares on residual/‖M‖²."""
    f = equation(INERTIA, D)
    found = []
    for _ in range(STARTS):
        start = rng.normal(size=3)
        fit = least_squares(
            lambda M: np.append(f(M) / (M @ M), 0.0), start, xtol=1e-15, ftol=1e-15, gtol=1e-15
        )
        size = np.linalg.norm(fit.x)
        if np.linalg.norm(f(fit.x)) < 1e-12 * size * size and 1e-3 < size < 1e3:
            found.append(fit.x)
    return found


@claim(
    "C18",
    "eq:equilibrium-set",
    "The equilibria under a positive-semidefinite D are 0 and the M on a principal axis with DM = 0.",
    kind=Correction.extends,
    scene="M' = M × I⁻¹M − DM, I = (1, 2, 3), random D",
    method="none: least squares from random starts",
    correction="Needs D symmetric: then M·DM = 0, which every equilibrium obeys, forces DM = 0. With D = S "
    "+ Â, S symmetric ≥ 0 and Â antisymmetric, M·DM = M·SM ≥ 0 still, but S M = 0 leaves M × Ω "
    "= Â M to balance off the axes: S = 1 − uuᵀ, u = (1, 1, 0)/√2, Â = a×, a = −(1, −1, "
    "0)/(4√2) has the equilibrium M = u.",
)
def equilibrium_set() -> Evidence:
    rng = np.random.default_rng(3)
    distances, count = [0.0], 0
    for k in range(24):
        rank = k % 3 + 1
        turn = np.eye(3) if k % 2 else np.linalg.qr(rng.normal(size=(3, 3)))[0]
        D = turn @ np.diag(rng.permutation([*rng.uniform(0.1, 1, rank), 0, 0, 0][:3])) @ turn.T
        found = equilibria(D, rng)
        distances += [distance_from_set(M, D) for M in found]
        count += len(found)
    M = points(3)
    D = SCENES[ANISOTROPIC]
    u = np.array([1.0, 1.0, 0.0]) / np.sqrt(2)
    a = -np.array([1.0, -1.0, 0.0]) / np.sqrt(2) / 4
    skew = np.eye(3) - np.outer(u, u) + np.cross(np.eye(3), -a).T  # columns e_i × (−a) = a × e_i
    work = largest(
        lambda M: (
            M @ momentum_rate(D)(M) + M @ jnp.stack(D.damp_matrix_function(tuple(M), lambda rate: rate))
        ),
        M,
    )
    return Evidence(
        [
            at_most(
                "farthest of the equilibria found from the set, 24 symmetric D of rank 1, 2, 3",
                max(distances),
                1e-5,
                "square root of the solver's 10⁻¹², since the residual may vanish quadratically, times 10",
            ),
            at_least(
                "equilibria found, all M ≠ 0",
                count,
                10,
                "the search must find something to be worth anything",
            ),
            at_most("max |M·M' + M·DM|, which makes M·DM = 0 necessary", work, ROUND_OFF, ROUND_OFF_WHY),
        ],
        [
            at_least(
                "distance from the set of an equilibrium of a D that is not symmetric",
                distance_from_set(u, skew),
                1e-2,
                "far above the residual of the equilibrium",
            ),
            at_most(
                "its residual |M × I⁻¹M − DM|",
                np.abs(equation(INERTIA, skew)(u)).max(),
                ROUND_OFF,
                ROUND_OFF_WHY,
            ),
            at_least(
                "smallest eigenvalue of the symmetric part of that D",
                np.linalg.eigvalsh((skew + skew.T) / 2).min(),
                -ROUND_OFF,
                "zero up to round-off",
            ),
        ],
    )


@claim(
    "C19",
    "Stability theorem 1",
    "A rotation about an extreme axis in ker D is linearly asymptotically stable.",
    kind=Correction.repairs,
    correction="The eigenvalue along the axis is always 0, because the whole axis consists of equilibria. "
    "The rotation is asymptotically stable only transversally, and only if D damps the "
    "transverse plane (D ≠ 0 there; at D = 0 the transverse eigenvalues are imaginary).",
    scene="anisotropic body, axes 1 and 3 in ker D, 100 random (I, D)",
)
def extreme_axes() -> Evidence:
    rng = np.random.default_rng(4)
    damped, free, momenta = [], [], []
    for k in range(100):
        inertia = tuple(np.sort(rng.uniform(0.5, 3.0, 3)))
        axis = (0, 2)[k % 2]
        M, rates = np.zeros(3), rng.uniform(0.05, 1.0, 3)
        M[axis], rates[axis] = rng.uniform(0.2, 2.0), 0.0
        momenta.append(M)
        damped.append(with_damping(*rates, inertia=inertia))
        free.append(with_damping(0, 0, 0, inertia=inertia))
    values, undamped = spectra(damped, momenta).real, spectra(free, momenta).real
    one = with_damping(0, 0.5, 0.5).with_(M=(1.0, 0.02, 0.02), t_end=60.0)
    end = solve(one, "scipy-dop853", rtol=1e-12, save_at=[60.0], carry=()).y[-1]
    return Evidence(
        [at_most("largest real part of the whole spectrum", values.max(), -SPECTRUM, SPECTRUM_WHY)],
        [
            at_most(
                "largest real part of the transverse spectrum", values[:, :2].max(), -SPECTRUM, SPECTRUM_WHY
            ),
            at_most("max |real part| at D = 0", np.abs(undamped).max(), SPECTRUM, SPECTRUM_WHY),
            at_most(
                "transverse momentum at t = 60 from 0.02, D = diag(0, ½, ½)",
                np.hypot(end[1], end[2]),
                1e-9,
                "0.02·√2·e^{−60/2} = 3·10⁻¹⁵ and the solver's tolerance",
            ),
            at_least(
                "shift along the axis that remains", abs(end[0] - 1.0), 1e-7, "above the solver's tolerance"
            ),
        ],
    )


def coupling(inertia, size) -> float:
    """ab, the product of the two rates that couple the transverse momenta at an intermediate axis."""
    I1, I2, I3 = inertia
    return size * size * (1 / I2 - 1 / I3) * (1 / I1 - 1 / I2)


@claim(
    "C20",
    "Stability theorem 2",
    "A rotation about the intermediate axis in ker D is always a saddle.",
    kind=Correction.replaces,
    correction="It is a saddle only while d₁d₃ < ab, with ab = |M*|² (1/I₂ − 1/I₃)(1/I₁ − 1/I₂) the "
    "product of the coupling rates; for d₁d₃ > ab damping stabilises it. With I = (1, 2, 3), "
    "|M*| = 1, D = diag(d, 0, d) the border is d² = 1/12.",
    scene="anisotropic body, D = diag(d₁, 0, d₃)",
    figures=("paper_stability",),
)
def intermediate_axis() -> Evidence:
    M = np.array([0.0, 1.0, 0.0])
    rates = growths([with_damping(d, 0, d) for d in np.linspace(0.0, 0.5, 11)], [M] * 11)
    border = brentq(
        lambda square: growth(with_damping(np.sqrt(square), 0, np.sqrt(square)), M), 0.01, 0.5, xtol=1e-15
    )
    rng = np.random.default_rng(5)
    cases, momenta, predicted = [], [], []
    for _ in range(200):
        inertia = tuple(np.sort(rng.uniform(0.5, 3.0, 3)))
        d1, d3, size = *rng.uniform(0.0, 0.6, 2), rng.uniform(0.3, 1.5)
        cases.append(with_damping(d1, 0, d3, inertia=inertia))
        momenta.append(size * M)
        predicted.append(d1 * d3 > coupling(inertia, size))
    wrong = np.count_nonzero((growths(cases, momenta) < 0) != np.array(predicted))
    calm = with_damping(0.5, 0, 0.5).with_(M=(0.05, 1.0, 0.05), t_end=60.0)
    end = solve(calm, "scipy-dop853", rtol=1e-12, save_at=[60.0], carry=()).y[-1]
    return Evidence(
        [
            at_least(
                "smallest growth rate, D = diag(d, 0, d), d from 0 to ½", rates.min(), SPECTRUM, SPECTRUM_WHY
            )
        ],
        [
            at_most(
                "cases of 200 random (I, D, M*) that the criterion d₁d₃ > ab gets wrong",
                wrong,
                0,
                "a criterion has none",
            ),
            at_most(
                "|d² − 1/12| at the border found by bisection",
                abs(border - coupling((1, 2, 3), 1.0)),
                SPECTRUM,
                SPECTRUM_WHY,
            ),
            at_most(
                "transverse momentum at t = 60 from 0.07, d = ½",
                np.hypot(end[0], end[2]),
                1e-4,
                "0.07·e^{−0.21·60} = 2·10⁻⁷; the axis it settles on is a little shorter than 1",
            ),
        ],
    )


@claim(
    "C21",
    "Stability theorem 3",
    "If M* is not in ker D there is no steady rotation and all trajectories decay to the origin.",
    kind=Correction.replaces,
    correction="A trajectory that starts off ker D may still settle on it: with D = diag(0, 1, 1) it ends "
    "in a steady rotation about axis 1. All decay to the origin if ker D contains no principal "
    "axis, and where ker D ≠ 0 then only as t^{−1/2}.",
    scene="anisotropic body, D = diag(0, 1, 1)",
    method=COARSER,
)
def decay_to_the_origin() -> Evidence:
    scene = with_damping(0, 1, 1)
    left = solve(scene, "scipy-dop853", rtol=1e-12, save_at=[80.0], carry=()).y[-1] / np.linalg.norm(scene.M)
    D = ((1.0, -0.5, 0.0), (-0.5, 0.25, 0.0), (0.0, 0.0, 1.0))  # kernel (1, 2, 0), no principal axis
    tilted = SCENES[ANISOTROPIC].with_(damping=D)
    sizes = np.linalg.norm(
        solve(tilted, "scipy-dop853", rtol=1e-9, save_at=[80.0, 8000.0], carry=()).y, axis=1
    )
    return Evidence(
        [
            at_most(
                "‖M(80)‖/‖M(0)‖, D = diag(0, 1, 1), D M(0) ≠ 0",
                np.linalg.norm(left),
                1e-2,
                "the damped rates are 1: what decays is gone",
            )
        ],
        [
            at_least(
                "|M₁(80)|/‖M(0)‖", abs(left[0]), 1e-2, "above what a decaying component would have left"
            ),
            at_most(
                "what is left across axis 1",
                np.hypot(left[1], left[2]),
                1e-9,
                "10³ times the tolerance 10⁻¹² of the solver",
            ),
            at_most(
                "‖M(8000)‖/‖M(80)‖ where ker D holds no principal axis",
                sizes[1] / sizes[0],
                0.15,
                "along ker D ‖M‖' = −c‖M‖³, hence t^{−1/2}: 0.1, and half as much again for the transient",
            ),
        ],
    )


@claim(
    "C22",
    "fig4, fig5",
    "With isotropic damping the equilibria lie on all principal axes of the momentum sphere, the outer two "
    "stable, the middle one unstable.",
    kind=Correction.repairs,
    correction="With γ > 0 the only equilibrium is M = 0. The axes are relative equilibria: the direction "
    "M/‖M‖ stays while ‖M‖ decays as e^{−γt}. In the damped time τ = (1 − e^{−γt})/γ directions "
    "near axes 1 and 3 turn about them, near axis 2 they leave (until τ runs out at 1/γ). They "
    "do not migrate to a stable axis, contrary to the caption of fig4: H0/‖M‖² is constant, so "
    "the direction stays on the polhode of the free body.",
    scene=BODY,
    figures=("paper_4", "paper_5"),
)
def relative_equilibria() -> Evidence:
    scene = SCENES[BODY]
    rate = momentum_rate(scene)
    axes = [s * e for e in np.eye(3) for s in (1.0, -1.0)]
    rates = [np.asarray(rate(M)) for M in axes]
    truth = reference(scene, np.linspace(0, scene.t_end, 201), ())
    shape = scene.energy(truth.states()) / (truth.y**2).sum(axis=1)
    turning = max(np.linalg.norm(np.cross(M, f)) for M, f in zip(axes, rates, strict=True))
    of_direction = growths([scene] * 3, np.eye(3)) + scene.gamma  # relative to ‖M‖, which decays with γ
    return Evidence(
        [
            at_most(
                "max ‖M'‖ at the six unit momenta on the axes",
                max(np.linalg.norm(f) for f in rates),
                ROUND_OFF,
                ROUND_OFF_WHY,
            )
        ],
        [
            at_most("max ‖M × M'‖ there: the direction stays", turning, ROUND_OFF, ROUND_OFF_WHY),
            at_most(
                "growth rate of the direction near axes 1 and 3",
                max(of_direction[0], of_direction[2]),
                SPECTRUM,
                SPECTRUM_WHY,
            ),
            at_least(
                "growth rate of the direction near axis 2",
                of_direction[1],
                0.1,
                "√(ab) = √(1/12) = 0.29 by Euler's equations; 0.1 is far from 0",
            ),
            at_most(
                "max |(H0/‖M‖²)(t)/(H0/‖M‖²)(0) − 1| along the true body",
                np.abs(shape / shape[0] - 1).max(),
                1e-13,
                "the reference rounded to double precision",
            ),
        ],
    )
