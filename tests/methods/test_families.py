"""Families of methods by what defines them: Herglotz, collocation, multistep, symplectic Euler."""

import math
from fractions import Fraction

import numpy as np
import pytest
from mpmath import mp

import contactbench as cb
from cases import USER, by_name, in_mp, pairs, random_state
from contactbench.methods.euler import TREATMENTS
from contactbench.methods.fixed_step import FixedStep
from contactbench.numbers.quadrature import rule
from contactbench.runs import limits
from contactbench.scene import dot
from properties import contact_defect, momentum_defect

HERGLOTZ = [cb.METHODS["herglotz1"], cb.METHODS["herglotz2"]]
each = pytest.mark.parametrize("method", HERGLOTZ, ids=lambda m: m.name)
SCENES = [cb.SCENES["particle"].with_(mass=1.7), cb.SCENES["oscillator"].with_(gamma=2.0), USER]


def lagrangian(name, scene, h, q0, q1, s0, s1):
    """The two discrete Lagrangians, written as in their definitions."""
    v = [(b - a) / h for a, b in zip(q0, q1, strict=True)]
    kinetic = scene.mass * dot(v, v) / 2
    if name == "herglotz1":
        return kinetic - scene.V(q0) - scene.gamma * s0
    return kinetic - (scene.V(q0) + scene.V(q1)) / 2 - scene.gamma * (s0 + s1) / 2


@each
@by_name(SCENES)
def test_steps_satisfy_the_discrete_herglotz_principle(method, scene, mp50):
    """s by its recursion and q by the discrete contact Euler–Lagrange equation, from L alone.

    (1 + h ∂L_k/∂s_k) D₂L_{k−1} / (1 − h ∂L_{k−1}/∂s_k) + D₁L_k = 0, derivatives by central
    differences; neither p nor any formula of the implementation enters.
    """
    exact, x = in_mp(scene, random_state(scene, 21))
    h, delta = mp50.mpf("0.13"), mp50.mpf(10) ** -15
    path = [x]
    for _ in range(2):
        path.append(method.step(exact, path[-1], h, mp50))
    L = lambda *a: lagrangian(method.name, exact, h, *a)  # noqa: E731

    def partial(arguments, which, i=None):
        def at(d):
            moved, own = list(arguments), arguments[which]
            moved[which] = own + d if i is None else tuple(c + d * (k == i) for k, c in enumerate(own))
            return L(*moved)

        return (at(delta) - at(-delta)) / (2 * delta)

    (a, b, c) = path
    first, second = (a.q, b.q, a.s, b.s), (b.q, c.q, b.s, c.s)
    for before, after, arguments in ((a, b, first), (b, c, second)):
        assert abs(after.s - before.s - h * L(*arguments)) < mp50.mpf(10) ** -45
    weight = (1 + h * partial(second, 2)) / (1 - h * partial(first, 3))
    for i in range(len(x.q)):
        equation = weight * partial(first, 1, i) + partial(second, 0, i)
        assert abs(equation) < mp50.mpf(10) ** -27  # differences: 10⁻³⁰ truncation, 10⁻³⁵ cancellation


@pytest.mark.parametrize(
    "name", [name for name, method in cb.METHODS.items() if getattr(method, "factor", None)]
)
def test_the_contact_form_is_off_by_the_factor_alone(name):
    """σⁿ against e^{−γt}; measured drifts of the distribution: 3e-15, and the tangents grow to about 30 on the way."""
    scene, method = cb.SCENES["particle"], cb.METHODS[name]
    for h in (0.1, 0.0125):
        solution = cb.solve(scene, name, step=h, save_at=[5.0, 10.0])
        off = abs(method.conformal_factor(scene, h) ** round(10 / h) / math.exp(-scene.gamma * 10.0) - 1)
        assert cb.LAWS["contact_drift"](solution) == pytest.approx(off, rel=1e-6, abs=1e-13)
        assert (off < 1e-13) == (name == "euler-contact")
        assert cb.LAWS["distribution_drift"](solution) < 1e-13


@each
def test_a_damping_it_is_not_derived_for_is_refused(method):
    solution = cb.solve(cb.SCENES["particle"].with_(kappa=0.5), method.name, step=0.1)
    assert solution.status is cb.Status.unsupported
    assert np.isnan(solution.y).all()


# -- implicit steps --------------------------------------------------------------------------------
GAUSS = {"contact-gauss2": 1, "contact-gauss4": 2, "contact-gauss8": 4, "contact-gauss16": 8}
CENTRAL = cb.SCENES["central"]


@pytest.mark.parametrize("stages", [*GAUSS.values(), 3, 32])
def test_gauss_tableaus_are_collocation_of_the_highest_order_and_symplectic(stages, mp50):
    nodes, b, A, onward = rule(mp, stages)
    c, s = [mp.fsum(row) for row in A], range(stages)
    assert max(abs(a - b) for a, b in zip(nodes, c, strict=True)) < mp.mpf(10) ** -48
    off = [mp.fsum(b[i] * c[i] ** k for i in s) - mp.mpf(1) / (k + 1) for k in range(2 * stages)]
    for k in s:
        off += [mp.fsum(A[i][j] * c[j] ** k for j in s) - c[i] ** (k + 1) / (k + 1) for i in s]
    off += [b[i] * A[i][j] + b[j] * A[j][i] - b[i] * b[j] for i in s for j in s]
    assert max(map(abs, off)) < mp.mpf(10) ** -48
    for row, at in zip(onward, c, strict=True):  # sums that cancel
        parts = [[w * each**k for w, each in zip(row, c, strict=True)] for k in s]
        gaps = [abs(mp.fsum(part) - (1 + at) ** k) / mp.fsum(map(abs, part)) for k, part in enumerate(parts)]
        assert max(gaps) < mp.mpf(10) ** -48


@pytest.mark.parametrize("stages", [0, 1.5, -1, 1000, True])
def test_a_number_of_stages_that_cannot_be_is_refused_in_one_line(stages):
    with pytest.raises(cb.BadInput, match=r"^stages = .*: must be a whole number ≥ 1, at most 32$"):
        cb.gauss(stages)


def test_gauss_of_stages_that_are_not_registered():
    assert cb.gauss(8) is cb.METHODS["contact-gauss16"]
    runs = [cb.solve("particle", cb.gauss(5), step=h, save_at=[20.0]) for h in (2.0, 1.0)]
    exact = cb.solve("particle", "contact-gauss16", step=0.5, save_at=[20.0]).y
    errors = [np.abs(run.y - exact).max() for run in runs]
    assert math.log2(errors[0] / errors[1]) == pytest.approx(10, abs=1.0)


@pytest.mark.parametrize("name", GAUSS)
def test_gauss_keeps_quadratic_invariants_and_is_symplectic_without_damping(name):
    still = CENTRAL.with_(gamma=0.0, t_end=200.0)
    solution = cb.solve(still, name, step=0.2, save_at=np.linspace(20, 200, 10))
    J = solution.q[:, 0] * solution.p[:, 1] - solution.q[:, 1] * solution.p[:, 0]
    assert np.ptp(J) < 1e-13  # measured: 2e-15
    run = cb.prepare(still, name, step=0.2, save_at=[2.0], carry=())
    M, omega = run.sensitivity(run.start)[0], np.kron([[0, 1], [-1, 0]], np.eye(2))
    np.testing.assert_allclose(M.T @ omega @ M, omega, atol=1e-13)


@pytest.mark.parametrize("name", GAUSS)
def test_pilots_and_saved_times_are_counted_truly(name):
    whole = cb.solve("particle", name, step=0.1, save_at=[20.0]).counts
    parts = cb.solve("particle", name, step=0.1, save_at=[5.0, 10.0, 20.0]).counts
    assert abs(parts.evaluations - whole.evaluations) < 0.02 * whole.evaluations
    chosen = cb.solve("particle", name, rtol=1e-2, save_at=[20.0])
    alone = cb.solve("particle", name, step=chosen.step, save_at=[20.0])
    assert alone.counts.evaluations < chosen.counts.evaluations < 6 * alone.counts.evaluations


# -- multistep methods -----------------------------------------------------------------------------
#: the denominator of the symmetric β and half of them, as printed
PRINTED = {
    "quinlan-tremaine8": "12096 17671 -23622 61449 -50516",
    "quinlan-tremaine12": "53222400 90987349 -229596838 812627169 -1628539944 2714971338 -3041896548",
}


@pytest.mark.parametrize("name", PRINTED)
def test_the_forces_of_symmetric_methods_are_the_printed_ones(name):
    denominator, *half = map(int, PRINTED[name].split())
    half = [Fraction(c, denominator) for c in half]
    assert cb.METHODS[name].beta == [*half, *half[-2::-1]]
    assert (1, *cb.METHODS[name].alpha) == (1, *cb.METHODS[name].alpha)[::-1]


@pytest.mark.parametrize("name", PRINTED)
def test_momenta_and_actions_are_exact_on_polynomials(name):
    """h z' from the last increment and z''; ∫ g over ten steps: both of a higher degree than the method's own."""
    method = cb.METHODS[name]
    K = method.forces
    for d in range(2, K + 3):
        second = [Fraction(d * (d - 1) * (10 - j) ** (d - 2)) for j in range(K + 1)]
        found = 10**d - 9**d + sum(c * a for c, a in zip(method.velocity, second, strict=True))
        assert found == d * 10 ** (d - 1)

    def ends(n, d):
        return sum(c * Fraction(n - j) ** d for j, c in enumerate(method.quadrature))

    for d in range(K + 1):
        inner = sum(i**d for i in range(1, 11))
        assert inner + ends(10, d) - ends(0, d) == Fraction(10 ** (d + 1), d + 1)


#: steps over the whole run, and twice the error measured
STEPS = [("quinlan-tremaine8", 32_000, 8.5e-9), ("quinlan-tremaine12", 16_000, 2.4e-9)]


@pytest.mark.parametrize(("name", "n", "bound"), STEPS)
def test_a_long_run_takes_one_gradient_a_step(name, n, bound):
    scene = cb.SCENES["particle_long"]
    solution = cb.solve(scene, name, step=scene.t_end / n, save_at=[scene.t_end])
    assert cb.LAWS["solution_error"](solution) < bound
    assert n < solution.counts.evaluations == cb.METHODS[name].counts(scene, n) < n + 350
    starts = cb.solve(scene, name, step=scene.t_end / n, save_at=scene.t_end * np.arange(1, 5) / 4)
    assert starts.counts.evaluations - n == 4 * (solution.counts.evaluations - n)


#: a step that is a binary number; three times the error measured
@pytest.mark.parametrize(("name", "bound"), [("quinlan-tremaine8", 1e-13), ("quinlan-tremaine12", 3e-13)])
def test_a_damped_run_has_no_more_than_round_off_for_an_error(name, bound):
    """The factors that carry the history, e^{γt/2} and its reciprocal, stay each other's."""
    scene = cb.SCENES["particle_long"]
    run = cb.solve(scene, name, step=2.0**-6, save_at=[scene.t_end])
    assert cb.LAWS["solution_error"](run) < bound


def test_the_energy_of_a_symmetric_method_has_no_drift():
    scene, errors = cb.SCENES["central"].with_(gamma=0.0, t_end=2000.0), []
    for t in np.linspace(100, 2000, 20):
        end = cb.solve(scene, "quinlan-tremaine12", step=0.1, save_at=[t], carry=()).y[-1]
        x = scene.unpack(end.tolist(), ())
        errors.append(abs(scene.energy(x) - scene.energy(scene.initial(()))))
    assert max(errors[10:]) < 2 * max(errors[:10]) < 1e-4  # measured: 1.3 times as large


@pytest.mark.parametrize("name", PRINTED)
def test_what_it_has_no_formula_for_is_refused(name):
    with pytest.raises(cb.BadInput):
        cb.step_map("particle", name)
    with pytest.raises(cb.BadInput):
        cb.prepare("particle", name, rtol=1e-6)
    ahead = cb.SCENES["oscillator"].with_(gamma=2.0, t_end=701.0)  # e^{γt} would overflow
    for scene in ("rigid_body", "quadratic_damping", "forced_oscillator", ahead):
        assert cb.solve(scene, name, step=0.1).status is cb.Status.unsupported


@pytest.mark.slow
def test_the_start_of_a_step_of_many_stages_is_not_extrapolated():
    """The polynomial of the last step would amplify its rounding to the size of the motion."""
    run = cb.solve("double_pendulum", cb.gauss(32), step=0.1, save_at=[0.3], engine="python")
    assert run.ok
    assert cb.LAWS["solution_error"](run) < 1e-14


# -- symplectic Euler with the damping treatments of game engines ------------------------------------
#: −log(d)/h
RATES = {
    "euler-explicit-damping": lambda g, h: -math.log1p(-g * h) / h,
    "euler-implicit-damping": lambda g, h: math.log1p(g * h) / h,
    "euler-contact": lambda g, h: g,
}


def test_the_explicit_one_is_the_first_contact_variational_integrator():
    runs = [cb.solve("particle", name, step=0.1).y for name in ("euler-explicit-damping", "herglotz1")]
    np.testing.assert_allclose(*runs, rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", TREATMENTS)
def test_rates_measured_on_a_falling_body(name):
    factor = cb.METHODS[name].conformal_factor(cb.SCENES["particle"], 0.1)
    assert -math.log(factor) / 0.1 == pytest.approx(RATES[name](cb.SCENES["particle"].gamma, 0.1), rel=1e-13)
    rows = [row for _, row in limits.ticks.rows((name,), None)]
    assert len(rows) == len(limits.TICKS) * len(limits.DRAGS)
    for row in rows:
        g, h = row["gamma"], 1 / row["setting"]
        explicit = name == "euler-explicit-damping"
        true = math.inf if explicit and g * h >= 1 else RATES[name](g, h)
        assert row["measured"] == pytest.approx(true, rel=1e-11)


# -- every method with a conformal factor at fifty digits --------------------------------------------
METHODS = [m for m in cb.METHODS.values() if isinstance(m, FixedStep) and (m.contact or m.factor)]
PARTICLE, BODY = (cb.SCENES[name] for name in ("particle", "rigid_body"))
#: other parameters, mass and inertia ratios included; a generic attitude
HEAVY = PARTICLE.with_(name="heavy", gamma=0.35, mass=1.6, coupling=-0.15, q=(0.7, -0.4), p=(0.5, 0.2), s=0.3)
SLENDER = BODY.with_(
    name="slender", gamma=0.3, inertia=(0.8, 1.1, 2.5), M=(-0.6, 0.4, 0.9), R=(0.5, 0.5, -0.5, 0.5), s=0.2
)
GENERIC = [PARTICLE, HEAVY, BODY, SLENDER]
BEYOND = 1e-45  # 50 digits less what a few hundred operations on numbers of size one lose


@pairs(METHODS, GENERIC)
@pytest.mark.quick(scene="heavy")
@pytest.mark.quick(method="contact-rkn4", scene="slender")
def test_map_is_conformal_contact_with_the_claimed_factor(method, scene):
    """Five steps of size 0.2 as one map, at 150 digits."""
    assert contact_defect(method, scene, "0.2", 5) < BEYOND


@pairs(METHODS, [CENTRAL, CENTRAL.with_(name="soft", gamma=0.4, stiffness=0.3, p=(-0.2, 0.9)), BODY, SLENDER])
def test_momentum_map_decays_by_the_claimed_factor(method, scene):
    assert momentum_defect(method, scene, "0.2", 20) < BEYOND
