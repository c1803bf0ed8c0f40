"""The rigid body: the free one in closed form, `contact-exact`, and what compositions solve and keep on hard data."""

import math
from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import contactbench as cb
from cases import UNDERFLOW
from contactbench.measure.pullback import growth
from contactbench.methods.by_tolerance import PlainNumbers
from contactbench.numbers.dual import Dual, DualNumbers
from contactbench.scene import BodyState, free_body, rotate, rotation_matrix
from contactbench.scene.free_body import carlson, free, jacobi
from contactbench.scene.rigid_body import FREE_COST, MOMENTUM_COST
from contactbench.testing import check_scene
from contactbench.truth import decimal_context
from properties import MOTIONS, Fixed

BODY = cb.SCENES["rigid_body"]
EPSILON = 2.0**-53


# -- the flow --------------------------------------------------------------------------------------
def motions(kind, n):
    """Random bodies in any order of axes, data and times of a kind."""
    rng = np.random.default_rng(sum(map(ord, kind)))
    for _ in range(n):
        inertia, M = sorted(10 ** rng.uniform(-1, 1, 3)), rng.normal(size=3)
        t = rng.choice([-1, 1]) * 10 ** rng.uniform(-2, 2)
        small = 10 ** rng.uniform(-12, -4, 3) * rng.choice([-1, 1], 3)
        if kind == "separatrix":  # D = 0 up to 10⁻²…10⁻¹²
            a = 1 / np.array(inertia)
            M[0] = math.sqrt((a[1] - a[2]) / (a[0] - a[1])) * M[2] * (1 + small[0])
        if kind in AXES:
            M = np.where(np.arange(3) == AXES.index(kind), M, small * M)
        if kind == "an axis exactly":
            M = np.where(np.arange(3) == rng.integers(3), M, 0.0)
        if "oblate" in kind:
            inertia[0] = inertia[1] * (1 - abs(small[0]) * ("nearly" in kind))
        if "prolate" in kind:
            inertia[2] = inertia[1] * (1 + abs(small[0]) * ("nearly" in kind))
        if "across" in kind:
            M[0] *= small[1]
        if "sphere" in kind:
            inertia = sorted(inertia[0] * (1 + small * ("nearly" in kind)))
        if kind == "needle":
            inertia, M[0] = [1e-3, 1.0, 1.001], 0.02 * M[0]
        if kind == "hardly moving":
            M *= 10 ** rng.uniform(-200, -5)
        if kind == "long":
            t *= 1e5
        order = rng.permutation(3)
        yield [float(inertia[i]) for i in order], [float(M[i]) for i in order], float(t)


AXES = ("first axis", "middle axis", "last axis")
OBLONG = ("oblate", "prolate", "nearly oblate", "nearly prolate", "prolate, across", "nearly prolate, across")
SPECIAL = ("an axis exactly", "sphere", "nearly a sphere", "needle", "hardly moving", "long")
KINDS = ("generic", "separatrix", *AXES, *OBLONG, *SPECIAL)


def flat(x):
    return [*x.M, *(entry for row in rotation_matrix(x.R) for entry in row)]


def moved(inertia, M, t, xp):
    """The free motion with numbers of a namespace, in the order of their own moments."""
    scene = BODY.with_(inertia=tuple(map(float, inertia)))
    if xp is not math:
        order = tuple(sorted(range(3), key=lambda i: inertia[i]))
        scene = scene.with_numbers([*inertia, xp.mpf(0)])._replaced(by_inertia=order)
    one = xp.cos(0 * t)
    return free(scene, BodyState(tuple(M), (one, 0 * one, 0 * one, 0 * one)), t, xp)


def truth_and_reach(inertia, M, t):
    """M and R to 50 digits, and for each number its size and what one rounding of each datum changes."""
    context, change = decimal_context(50), "1e-25"
    exact = [context.mpf(v) for v in (*inertia, *M, t)]

    def end(data):
        return np.array(flat(moved(data[:3], data[3:6], data[6], context)))

    truth, reach = end(exact), np.array([math.hypot(*M)] * 3 + [1.0] * 9)
    for i in range(7):
        other = [v * (1 + context.mpf(change)) if j == i else v for j, v in enumerate(exact)]
        reach += (abs(end(other) - truth) / context.mpf(change)).astype(float)
    return truth, reach


def assert_determined(x, inertia, M, t):
    truth, reach = truth_and_reach(inertia, M, t)
    assert np.all(abs(flat(x) - truth) < 16 * EPSILON * reach), (inertia, M, t)
    np.testing.assert_allclose(rotate(x.R, x.M), M, rtol=0, atol=3e-15 * math.hypot(*M))


@pytest.mark.parametrize("root", [1e-3, 1e-6, 1e-8])
@pytest.mark.parametrize("u", [0.1, 1.0, 5.0])
def test_derivatives_beside_the_separatrix_are_right_to_a_rounding_over_the_modulus(u, root):
    """By k' = √(1 − m): so many digits contact-abc and contact-exact have of a map there, whose values have all."""
    m, m1 = Dual(1 - root * root, -2 * root), Dual(root * root, 2 * root)
    sn, cn, dn, _ = jacobi(Dual(u, 0.0), m, m1, DualNumbers(PlainNumbers()))
    mp = decimal_context(60)
    for name, found in (("sn", sn), ("cn", cn), ("dn", dn)):
        exact = lambda k, name=name: mp.ellipfun(name, u, m=1 - k * k)  # noqa: E731
        step = mp.mpf(root) / 10**20
        true = (exact(root + step) - exact(root - step)) / (2 * step)
        assert abs(found.b - true) < 2 * EPSILON / root


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.quick(kind=("generic", "separatrix", "oblate", "sphere", "an axis exactly"))
def test_double_precision_is_right_to_what_the_data_determine(kind):
    """M/L and R within 16 roundings, and 16 times what one rounding of each datum changes (long times: the
    phase); J = R M and the lengths of M and R to round-off."""
    for inertia, M, t in motions(kind, 6):
        x = moved(inertia, M, t, math)
        assert_determined(x, inertia, M, t)
        assert abs(math.hypot(*x.M) / math.hypot(*M) - 1) < 1e-15
        assert abs(math.hypot(*x.R) - 1) < 1e-15


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.quick(kind=("generic", "last axis", "nearly prolate"))
def test_the_compiled_method_is_right_to_what_the_data_determine(kind):
    """As above, axes in order (one program) and times ahead; loops have a fixed length."""
    for inertia, M, t in motions(kind, 6):
        inertia, M = zip(*sorted(zip(inertia, M, strict=True)), strict=True)
        scene = BODY.with_(inertia=inertia, M=M, gamma=0.0, t_end=abs(t))
        run = cb.prepare(scene, "contact-exact", save_at=[abs(t)], carry=("R",), engine="llvm")
        found = scene.unpack(run.bare(run.start).tolist(), ("R",))
        assert_determined(found, [*inertia], [*M], abs(t))


# -- the method ------------------------------------------------------------------
EXACT = cb.METHODS["contact-exact"]
UNDAMPED = BODY.with_(name="undamped", gamma=0.0)
BODIES = [*map(cb.SCENES.get, ("rigid_body", "tumbling", "needle")), UNDERFLOW]
BODIES += [BODY.with_(name="driven", gamma=-0.1), UNDAMPED]


@pytest.mark.parametrize("engine", EXACT.engines)
@pytest.mark.parametrize("scene", BODIES, ids=lambda s: s.name)
@pytest.mark.quick(engine="python", scene=("rigid_body", "tumbling", "needle"))
@pytest.mark.quick(scene="rigid_body", engine="llvm")
def test_contact_exact_has_round_off_for_an_error_whatever_the_time(engine, scene):
    times = scene.t_end * np.arange(11) / 10
    solution = cb.solve(scene, "contact-exact", save_at=times, engine=engine)
    assert solution.ok
    assert cb.LAWS["solution_error"](solution) < 1e-13  # the needle's phase of 700 leaves 3e-14
    for name in ("momentum_law", "attitude_drift", "hamiltonian_law"):
        assert cb.LAWS[name](solution) < 1e-14, name
    magnified = max(1.0, growth(solution.differential))
    assert cb.LAWS["contact_drift"](solution) < 1e-13 * magnified
    assert solution.counts == (10, 10 * FREE_COST, 0, 0, "rotation")
    momentum = cb.solve(scene, "contact-exact", save_at=times, engine=engine, carry=())
    assert momentum.counts == (10, 10 * MOMENTUM_COST, 0, 0, "rotation")


@pytest.mark.parametrize("engine", EXACT.engines)
def test_contact_exact_has_an_end(engine):
    runaway = BODY.with_(gamma=-50.0, t_end=20.0)
    solution = cb.solve(runaway, "contact-exact", save_at=[0.1, 20.0], engine=engine)
    assert solution.status == "diverged"
    assert np.isnan(solution.y[-1]).all()


def test_fixed_loops_are_long_enough_at_the_smallest_complement():
    m1 = free_body.SMALLEST
    K = jacobi(1.0, 1.0, m1, math)[3]
    for u in (0.5, 20.0, 300.0, K, 1.3 * K):
        plain, fixed = (jacobi(u, 1.0, m1, xp) for xp in (math, Fixed(math)))
        np.testing.assert_allclose(fixed, plain, rtol=1e-12)
    for x in (0.0, 1e-200, 0.5):
        given = math.sqrt(x), math.sqrt(m1), 1.5, (1.5 - x) * 1.5 * 0.5
        plain, fixed = (carlson(*given, xp) for xp in (math, Fixed(math)))
        assert fixed == pytest.approx(plain, rel=1e-14)


def test_turns_have_length_one_on_average():
    """Over 2000 turns: what is off has one sign and adds up along a run.

    Measured 1.5·10⁻¹⁷, and 4·10⁻¹⁷ where the turn is not scaled; the average itself is known to 10⁻¹⁸.
    """
    total, turns = Fraction(0), 500
    for inertia, M in MOTIONS[:4]:
        body = BODY.with_(inertia=inertia, M=M)
        x = body.initial(("R",))
        for _ in range(turns):
            x = free(body, x._replace(R=(1.0, 0.0, 0.0, 0.0)), 0.1, math)
            total += (sum(Fraction(c) ** 2 for c in x.R) - 1) / 2
    assert abs(total / (4 * turns)) < 2.5e-17


@pytest.mark.parametrize("size", [1e-200, 1e-310, 5e-324])
def test_attitude_stays_a_rotation_where_momentum_has_hardly_any_digits(size):
    """A body that has all but stopped: squares of M underflow, then M itself is left with a digit or none."""
    rng, scene = np.random.default_rng(3), UNDERFLOW
    for _ in range(20):
        M = tuple(float(c) for c in size * rng.uniform(-4, 4, 3))
        x = BodyState(M, (1.0, 0.0, 0.0, 0.0), None)
        for _ in range(20):
            x = free(scene, x, 0.5, math)
        assert math.hypot(*x.R) == pytest.approx(1, abs=1e-13)
        assert math.hypot(*x.M) == pytest.approx(math.hypot(*M), rel=1e-14, abs=200 * 5e-324)


# -- compositions ----------------------------------------------------------------------------------
#: A on a body is the free body itself
EXACT_DRIFT = ["contact-printed", "contact-abc"]
#: A on a body is split once more
SPLIT = ["contact-strang", "contact-bm6", "contact-rkn4", "contact-o8"]


SYMMETRIC = [BODY.with_(inertia=inertia) for inertia in ((2, 2, 2), (1, 2, 2), (2, 1, 1), (2, 3, 2))]


@pytest.mark.parametrize(
    ("method", "scene"), [*product(SPLIT, SYMMETRIC), *((method, UNDAMPED) for method in EXACT_DRIFT)]
)
def test_a_body_is_solved_exactly_at_any_step_by_the_one_part_it_has(method, scene):
    """Of a symmetric body one part of A is zero; without damping the printed schemes are A alone."""
    given = {"save_at": [5.0, 10.0, 20.0], "engine": "python"}
    found, true = cb.solve(scene, method, step=5.0, **given), cb.solve(scene, "contact-exact", **given)
    for name in ("M", "R", "s"):
        np.testing.assert_allclose(getattr(found, name), getattr(true, name), rtol=0, atol=2e-13)


@pytest.mark.parametrize("method", [*EXACT_DRIFT, *SPLIT])
def test_a_body_at_rest_stays_and_has_a_derivative(method):
    solution = cb.solve(BODY.with_(M=(0.0, 0.0, 0.0)), method, step=0.5, save_at=[1.0, 2.0])
    np.testing.assert_array_equal(solution.M, 0)
    np.testing.assert_allclose(solution.R, [np.eye(3)] * 2, rtol=0, atol=1e-15)
    assert np.isfinite(solution.sensitivity).all()


@pytest.mark.parametrize("method", EXACT_DRIFT)
@pytest.mark.parametrize("M", [(1, 0, 0), (0, 1, 0), (0, 0, 2), (1, 1, 0), (1, 0, 1)], ids=str)
def test_the_closed_form_has_a_derivative_on_the_axes_and_between_two(method, M):
    solution = cb.solve(BODY.with_(M=M), method, step=0.5, save_at=[1.0])
    assert cb.LAWS["contact_drift"](solution) < 1e-13


def test_a_step_as_long_as_the_decay_is_no_trouble():
    """e^{−γh} underflows within one step; negative substeps would grow by e^{+γ|a|h} if they met damping."""
    body = BODY.with_(gamma=50.0, t_end=100.0, M=(0.1, 0.2, 0.3))
    found, true = (
        cb.solve(body, name, **setting, save_at=[50.0, 100.0], engine="python").y
        for name, setting in (("contact-o8", {"step": 50.0}), ("contact-exact", {}))
    )
    np.testing.assert_allclose(found, true, rtol=0, atol=1e-12)


# -- Runge–Kutta methods on the clock of a damped body -------------------------------------------------
@pytest.mark.parametrize("carry", [(), ("R", "s")], ids=["momentum", "all"])
@pytest.mark.parametrize(("method", "setting"), [("rk8", 20), ("rk8-7", 1e-8)])
def test_isotropic_damping_costs_a_runge_kutta_method_nothing(method, setting, carry):
    """Times e^{−γT} they are the runs of the free body over (1 − e^{−γT})/γ."""
    gamma, end = 0.1, 20.0
    passed = -math.expm1(-gamma * end) / gamma
    runs = []
    for rate, time in ((gamma, end), (0.0, passed)):
        control = {"step": time / setting} if method != "rk8-7" else {"rtol": setting}
        body = BODY.with_(gamma=rate, t_end=time)
        runs.append(cb.solve(body, method, save_at=[time], carry=carry, **control))
    damped, free = (run.y[-1] for run in runs)
    kept = np.ones(len(free))
    kept[[*range(3), *range(7, len(free))]] = math.exp(-gamma * end)
    assert runs[0].counts.evaluations == runs[1].counts.evaluations
    assert damped == pytest.approx(kept * free, rel=1e-12, abs=1e-14)


@pytest.mark.parametrize("engine", ["llvm", "python"])
@pytest.mark.parametrize(("method", "setting"), [("rk8", {"step": 10.0}), ("rk8-7", {"rtol": 1e-9})])
def test_nothing_overflows_where_everything_has_decayed(method, setting, engine):
    body, times = BODY.with_(gamma=50.0, t_end=100.0), [0.01, 50.0, 100.0]
    found = cb.solve(body, method, save_at=times, engine=engine, **setting)
    assert found.ok
    assert found.y == pytest.approx(cb.solve(body, "contact-exact", save_at=times).y, abs=1e-8)


# -- the heavy top -----------------------------------------------------------------------------------
TOP = cb.SCENES["heavy_top"]
#: three moments, a centre of mass off every axis, an attitude of no symmetry
GENERAL = TOP.with_(
    weight=1.7,
    inertia=(1.0, 1.7, 0.6),
    axis=(0.3, -0.4, 0.8),
    M=(0.4, -0.7, 1.1),
    R=Rotation.from_rotvec([0.4, 1.0, -0.3]).as_matrix(),
)
#: gravity's gradient on it, too
SATELLITE = GENERAL.with_(
    potential=lambda u: 0.6 * sum(i * c * c for i, c in zip((1.0, 1.7, 0.6), u, strict=True))
)
CONTACT = [name for name, method in cb.METHODS.items() if method.contact and method.refuses(TOP) is None]


def test_it_keeps_the_rules_of_scenes():
    check_scene(SATELLITE)


@pytest.mark.parametrize(("scene", "gradient"), [(GENERAL, 0.0), (SATELLITE, 1.2)])
def test_the_solution_is_that_of_matrices(scene, gradient):
    """By SciPy, with a rotation matrix and the cross products written out with NumPy."""
    inertia, axis, up = np.array(GENERAL.inertia), np.array(GENERAL.axis), np.array([0.0, 0.0, 1.0])

    def rhs(t, y):
        M, R, s = y[:3], y[3:12].reshape(3, 3), y[12]
        omega, u = M / inertia, R.T @ up
        torque = np.cross(u, GENERAL.weight * axis + gradient * inertia * u)
        V = GENERAL.weight * u @ axis + gradient / 2 * u @ (inertia * u)
        ds = M @ omega / 2 - V - GENERAL.gamma * s
        dM, dR = np.cross(M, omega) + torque - GENERAL.gamma * M, R @ np.cross(np.eye(3), omega)
        return np.concatenate([dM, dR.ravel(), [ds]])

    start = np.concatenate([GENERAL.M, np.array(rotation_matrix(GENERAL.R)).ravel(), [GENERAL.s]])
    own = solve_ivp(rhs, (0, 5.0), start, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    found = cb.solve(scene, "contact-bm6", step=0.05, save_at=[5.0])
    x = GENERAL.unpack(found.y[-1].tolist(), found.carry)
    assert np.allclose([*x.M, *np.ravel(rotation_matrix(x.R)), x.s], own, rtol=0, atol=1e-9)


def test_the_spin_of_lagranges_top_decays_alone():
    """M·χ has no torque where two moments are equal."""
    found = cb.reference(TOP, np.linspace(0, 20, 5)).states()
    assert np.allclose(found.M[2], 2.0 * np.exp(-TOP.gamma * np.linspace(0, 20, 5)), rtol=1e-14)


def test_it_refuses_what_it_has_no_law_for():
    with pytest.raises(cb.BadInput, match=r"its potential cannot be differentiated: .*float"):
        TOP.with_(potential=lambda u: float(u[0]) ** 2)
    with pytest.raises(cb.BadInput, match="of a heavy top it is isotropic"):
        TOP.with_(damping=(0.1, 0.2, 0.3))
    assert "isotropic damping" in cb.METHODS["contact-exact"].refuses(TOP)
