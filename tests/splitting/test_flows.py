"""Each subflow against a high-precision solution of its own equations, derived from its Hamiltonian."""

from __future__ import annotations

import math

import heyoka
import numpy as np
import pytest
import scipy.linalg
from mpmath import mp

import contactbench as cb
from cases import CONTACT_SCENES, TILTED, USER, by_name, few_slow, in_mp, random_state
from contactbench.splitting.flows import BODY, MECHANICAL, body_damp, damped_time, flows_of, rotation, spin
from contactbench.xla import jax, jnp

BITS = 180
DIGITS = mp.mpf(10) ** -45
H = "0.37"


def symbolic_flow(hamiltonian, n, y0, h):
    """Contact flow of H(q, p, s): equations by heyoka's symbolic derivatives, solved to 180 bits."""
    names = [f"q{i}" for i in range(n)] + [f"p{i}" for i in range(n)] + ["s"]
    v = heyoka.make_vars(*names)
    q, p, s = v[:n], v[n : 2 * n], v[-1]
    energy = hamiltonian(q, p, s) + 0 * s
    Hq, Hp, Hs = (
        [heyoka.diff(energy, c) for c in q],
        [heyoka.diff(energy, c) for c in p],
        heyoka.diff(energy, s),
    )
    slopes = Hp + [-a - b * Hs for a, b in zip(Hq, p, strict=True)]
    slopes.append(sum((a * b for a, b in zip(p, Hp, strict=True)), heyoka.expression(0.0)) - energy)
    real = lambda text: heyoka.real(text, BITS)  # noqa: E731
    state = np.array([real(mp.nstr(c, 55)) for c in y0])
    ta = heyoka.taylor_adaptive(
        list(zip(v, slopes, strict=True)), state, time=heyoka.real(0, BITS), fp_type=heyoka.real, prec=BITS
    )
    ta.propagate_until(real(h))
    return [mp.mpf(str(c)) for c in ta.state]


def real_scene(scene):
    """The scene with heyoka's multi-precision numbers, exact decimals."""
    return scene.with_numbers([heyoka.expression(heyoka.real(repr(v), BITS)) for v in scene.numbers()])


def parts(scene):
    symbolic = real_scene(scene)
    T = lambda q, p, s: symbolic.kinetic(tuple(p))  # noqa: E731
    V = lambda q, p, s: symbolic.V(tuple(q))  # noqa: E731
    G = lambda q, p, s: symbolic.dissipation(s)  # noqa: E731
    return {"drift": T, "kick": V, "damp": G, "drift_damp": lambda q, p, s: T(q, p, s) + G(q, p, s)}


FLOW_SCENES = [
    USER,
    cb.SCENES["particle"].with_(mass=1.7),
    USER.with_(name="undamped", gamma=0.0),
    USER.with_(name="quadratic damping", gamma=0.0, kappa=0.6),
    USER.with_(name="both dampings", kappa=0.6),
    USER.with_(name="negative kappa", kappa=-0.6),
    USER.with_(name="antidamped", gamma=-0.4),
]


FLOWS = [(scene, name) for scene in FLOW_SCENES for name in flows_of(scene)]


@by_name(FLOW_SCENES)
def test_a_mechanical_scene_has_every_flow(scene):
    assert set(flows_of(scene)) == set(MECHANICAL)


@pytest.mark.parametrize(("scene", "name"), FLOWS, ids=[f"{scene.name}-{name}" for scene, name in FLOWS])
@pytest.mark.quick(name="drift_damp")
@pytest.mark.quick(scene="user")
def test_subflow_solves_its_own_equations_to_45_digits(scene, name, mp50):
    exact, x = in_mp(scene, random_state(scene, 7))
    flow = flows_of(scene)[name]
    mine = flow.apply(exact, x, flow.constants(exact, mp50.mpf(H), mp50), mp50)
    truth = symbolic_flow(parts(scene)[name], len(x.q), scene.pack(x), H)
    for a, b in zip(scene.pack(mine), truth, strict=True):
        assert abs(a - b) < DIGITS * 10


def turned_about(x, omega, h, xp):
    """M' = M × ω, R' = R ω̂ with ω constant, by matrix exponentials: M and R after time h."""
    a, b, c = omega
    hat = xp.matrix([[0, -c, b], [c, 0, -a], [-b, a, 0]])
    left = xp.matrix([[0, -a, -b, -c], [a, 0, c, -b], [b, -c, 0, a], [c, b, -a, 0]]) / 2  # q' = ½ q ⊗ (0, ω)
    return [*(xp.expm(-h * hat) * xp.matrix(list(x.M))), *(xp.expm(h * left) * xp.matrix(list(x.R)))]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_rotation_is_the_flow_of_a_square_of_one_component(axis, mp50):
    """½ a M_i²: ω = a M_i e_i is constant, and s' = M·ω − ½ a M_i²."""
    body = cb.SCENES["rigid_body"]
    _, x = in_mp(body, random_state(body, 8))
    a = mp50.mpf(H)
    out = rotation(x, axis, a, mp50)
    omega = [x.M[axis] * (i == axis) for i in range(3)]
    for mine, truth in zip([*out.M, *out.R], turned_about(x, omega, a, mp50), strict=True):
        assert abs(mine - truth) < DIGITS
    assert abs(out.s - x.s - a * x.M[axis] ** 2 / 2) < DIGITS


def test_spin_is_the_flow_of_the_square_of_the_momentum(mp50):
    """½ a ‖M‖²: ω = a M is constant since M × M = 0; it commutes with every rotation."""
    body = cb.SCENES["rigid_body"]
    exact, x = in_mp(body, random_state(body, 8))
    a = mp50.mpf(H)
    out = spin(x, a, mp50)
    for mine, truth in zip([*out.M, *out.R], turned_about(x, x.M, a, mp50), strict=True):
        assert abs(mine - truth) < DIGITS
    assert abs(out.s - x.s - a * sum(m * m for m in x.M) / 2) < DIGITS
    for axis in range(3):
        there, back = rotation(out, axis, a, mp50), spin(rotation(x, axis, a, mp50), a, mp50)
        for one, other in zip(exact.pack(there), exact.pack(back), strict=True):
            assert abs(one - other) < DIGITS


def test_spin_of_a_body_at_rest_is_nothing_and_has_a_derivative():
    """d(½ a M)/dM in the quaternion, by AD at the point where the axis is undefined."""
    body = cb.SCENES["rigid_body"].with_(M=(0.0, 0.0, 0.0))
    x = body.initial(body.carry())
    assert body.pack(spin(x, 0.3, math)) == body.pack(x)
    slope = jax.jacfwd(lambda M: jnp.stack(spin(x._replace(M=tuple(M)), 0.3, jnp).R))(jnp.zeros(3))
    np.testing.assert_allclose(slope, 0.15 * np.eye(4)[:, 1:], atol=1e-15)


@pytest.mark.parametrize("body", [cb.SCENES["rigid_body_anisotropic"], TILTED], ids=["diagonal", "tilted"])
def test_anisotropic_damping_is_the_matrix_exponential(body):
    x = random_state(body, 9)
    out = body_damp(body, x, BODY["damp"].constants(body, 0.8, math), math)
    np.testing.assert_allclose(out.M, scipy.linalg.expm(-0.8 * np.array(body.damping)) @ x.M, rtol=1e-14)
    assert out.R == x.R


def flow_map(scene, flow, h):
    def f(y):
        x = scene.unpack(list(y), scene.optional)
        return jnp.stack(scene.pack(flow.apply(scene, x, flow.constants(scene, h, jnp), jnp)))

    return f


@pytest.mark.parametrize(
    "scene",
    few_slow([*CONTACT_SCENES, *FLOW_SCENES[2:]], cb.SCENES["rigid_body"]),
    ids=lambda scene: scene.name,
)
def test_every_subflow_is_a_conformal_contact_map(scene):
    """Φ*η = c η, with c = e^{−γh} for the flows that damp and 1 for the others (κ: c depends on s)."""
    x = random_state(scene, 10)
    start, basis = scene.pack(x), scene.tangents(x)
    form = np.array([scene.contact_form(x, v) for v in basis], dtype=float)
    for name, flow in flows_of(scene).items():
        f = flow_map(scene, flow, 0.3)
        y = f(jnp.array(start))
        pulled = [
            float(scene.contact_form(
                scene.unpack(list(y), scene.optional),
                scene.unpack(list(jax.jvp(f, (jnp.array(start),), (jnp.array(scene.pack(v)),))[1]), scene.optional),
            ))
            for v in basis
        ]  # fmt: skip
        factor = pulled[-1]  # η(∂_s) = 1
        if "damp" not in name:
            assert abs(factor - 1) < 1e-15
        assert factor == pytest.approx(math.exp(flow.log_factor(scene, x, 0.3, math)), rel=1e-14)
        if "damp" in name and not getattr(scene, "nonlinear_damping", False):
            assert abs(factor - math.exp(-scene.conformal_rate * 0.3)) < 1e-15
        np.testing.assert_allclose(pulled, factor * form, rtol=0, atol=2e-14, err_msg=name)


@by_name(FLOW_SCENES)
def test_flows_that_may_be_merged_form_one_parameter_groups(scene, mp50):
    exact, x = in_mp(scene, random_state(scene, 11))
    for flow in flows_of(scene).values():

        def run(h, x, flow=flow):
            return flow.apply(exact, x, flow.constants(exact, mp50.mpf(h), mp50), mp50)

        for a, b in zip(scene.pack(run("0.3", run("-0.1", x))), scene.pack(run("0.2", x)), strict=True):
            assert abs(a - b) < DIGITS


def test_damped_time_is_exactly_h_without_damping_and_smooth_towards_it():
    for xp in (math, np, jnp):
        assert damped_time(0.0, 0.3, xp) == 0.3
        assert abs(damped_time(1e-12, 0.3, xp) - 0.3) < 1e-12
    assert float(jax.jit(lambda g: damped_time(g, 0.3, jnp))(0.0)) == 0.3


def test_quadratic_damping_reports_blow_up_instead_of_a_wrong_number():
    """s' = −½κs² from s = −2 reaches −∞ at t = 2/(κ·2); beyond it there is no state."""
    scene = USER.with_(gamma=0.0, kappa=1.0, s=-2.0)
    flow = MECHANICAL["damp"]
    for xp in (math, np, jnp):
        before = flow.apply(scene, scene.initial(("s",)), flow.constants(scene, 0.9, xp), xp)
        after = flow.apply(scene, scene.initial(("s",)), flow.constants(scene, 1.1, xp), xp)
        assert float(before.s) == pytest.approx(-20.0, rel=1e-12)
        assert math.isinf(float(after.s))


# -- kinetic energy and Γ = γs + ½κs² together -----------------------------------------------------
#: how often rounding errors of one unit occur in the flow, at most: each is amplified by the condition below
UNITS = 12


def merged_flow(scene, x, h, xp):
    flow = MECHANICAL["drift_damp"]
    return flow.apply(scene, x, flow.constants(scene, h, xp), xp)


def textbook(gamma, kappa, mass, q, p, s, h, xp):
    """The same flow from w = κs/2, r² = κT/2 in complex numbers, without a case, or None beyond blow-up."""
    phi = (1 - xp.exp(-gamma * h)) / gamma if gamma else h
    T, w = p * p / (2 * mass), kappa * s / 2
    r = xp.sqrt(xp.mpc(kappa * T / 2))
    y = (1 + w * phi) ** 2 + (r * phi) ** 2
    if (kappa < 0 or r == 0) and 1 + w * phi <= abs(r * phi):
        return None
    # the angle of 1 + wφ + irφ
    angle = xp.log((1 + w * phi + 1j * r * phi) / (1 + w * phi - 1j * r * phi)) / 2j if r else xp.mpc(0)
    if kappa > 0 and (1 + w * phi) < 0:
        angle += xp.pi * xp.sign(phi)
    path = angle / r if r else phi / (1 + w * phi)
    decay = xp.exp(-gamma * h)
    return tuple(
        c.real for c in (q + p / mass * path, decay * p / y, decay * (s + (kappa * s * s / 2 + T) * phi) / y)
    )


def line(**numbers):
    """A free particle on a line."""
    return cb.Mechanical(
        name="line", potential=lambda q: 0 * q[0], gradient=lambda q: (0 * q[0],), t_end=1.0,
        **({"q": (0.3,), "p": (0.5,)} | numbers),
    )  # fmt: skip


def random_flows(n, seed):
    """Numbers, states and steps over many orders of magnitude: κ, T and γ down to nothing, all signs."""
    rng = np.random.default_rng(seed)

    def spread(low, high):
        return float(rng.choice([-1, 1]) * 10.0 ** rng.uniform(low, high))

    for _ in range(n):
        small = rng.random(3) < 0.1
        yield {
            "kappa": spread(-1 if rng.random() < 0.5 else -14, 1.5),
            "gamma": 0.0 if small[0] else spread(-12, 0.5), "mass": abs(spread(-1, 1)),
            "q": (spread(-1, 1),), "p": (0.0 if small[1] else spread(-12, 1.5),),
            "s": 0.0 if small[2] else spread(-3, 1.5),
        }, spread(-2, 0.5)  # fmt: skip


def test_merged_flow_is_the_closed_form_to_round_off_over_random_states(mp50):
    """Within UNITS roundings, each amplified by (‖(1, ks)‖² + b²)/y: what data of 16 digits leave near blow-up."""
    worst, ended = 0.0, 0
    for numbers, h in random_flows(3_000, 41):
        scene = line(**numbers)
        mine = scene.pack(merged_flow(scene, scene.initial(("s",)), h, math))
        exact = {k: mp50.mpf(v[0] if k in "qp" else v) for k, v in numbers.items()}
        truth = textbook(xp=mp50, h=mp50.mpf(h), **exact)
        if truth is None:
            ended += 1
            assert not np.isfinite(mine).all()
            continue
        phi = damped_time(scene.gamma, h, math)
        k, T = scene.kappa * phi / 2, scene.kinetic(scene.p)
        square, a = abs(k * phi * T), 1 + k * scene.s
        y = abs(a * a + math.copysign(square, k * phi))
        growth = ((1 + abs(k * scene.s)) ** 2 + square) / y
        sizes = (
            abs(scene.q[0]) + abs(float(truth[0])) + abs(phi * scene.p[0] / scene.mass) * growth,
            abs(float(truth[1])) * growth,
            (abs(a * scene.s) + abs(phi * T)) * math.exp(-scene.gamma * h) / y * growth,
        )
        for one, other, size in zip(mine, truth, sizes, strict=True):
            worst = max(worst, float(abs(one - other)) / (size * 2.0**-53 + 1e-300))
    assert worst < UNITS
    assert 60 < ended < 1500


def test_merged_flow_solves_its_equations_over_random_states():
    """Against Taylor integration of q' = p/m, p' = −(γ + κs)p, s' = T − γs − ½κs² to 25 digits."""
    q, p, s = heyoka.make_vars("q", "p", "s")
    gamma, kappa, mass = (heyoka.par[i] for i in range(3))
    real = lambda v: heyoka.real(repr(v), BITS)  # noqa: E731
    half = heyoka.expression(real(0.5))
    T = half * p * p / mass
    ta = heyoka.taylor_adaptive(
        [(q, p / mass), (p, -(gamma + kappa * s) * p), (s, T - gamma * s - half * kappa * s * s)],
        np.array([real(0.0)] * 3), time=heyoka.real(0, BITS), pars=np.array([real(1.0)] * 3),
        fp_type=heyoka.real, prec=BITS,
    )  # fmt: skip
    compared = 0
    with mp.workdps(50):
        for numbers, h in random_flows(400, 42):
            scene = line(**numbers)
            exact, x = in_mp(scene, scene.initial(("s",)))
            mine = exact.pack(merged_flow(exact, x, mp.mpf(repr(h)), mp))
            if not all(mp.isfinite(c) for c in mine):
                continue  # blown up: the closed form's own test
            ta.time, ta.state[:] = heyoka.real(0, BITS), [real(v) for v in scene.pack(scene.initial(("s",)))]
            ta.pars[:] = [real(v) for v in (scene.gamma, scene.kappa, scene.mass)]
            outcome, *_ = ta.propagate_until(real(h), max_steps=400)
            if outcome != heyoka.taylor_outcome.time_limit:
                continue  # too close to infinity to step there
            compared += 1
            for a, b in zip(mine, [mp.mpf(str(c)) for c in ta.state], strict=True):
                assert abs(a - b) < mp.mpf(10) ** -25 * (1 + abs(b)), (numbers, h)
    assert compared > 200


@pytest.mark.parametrize("kappa", [0.8, -0.8])
@pytest.mark.parametrize("p", [0.0, 1e-170, 1e-9, 0.7])
def test_merged_flow_has_a_derivative_where_the_path_is_straight(kappa, p):
    """jit and jvp, no nan at T = 0; against differences of the closed form at 50 digits."""
    scene = line(kappa=kappa, gamma=0.2, p=(p,), s=0.4)

    def flow(y):
        return jnp.stack(scene.pack(merged_flow(scene, scene.unpack(list(y), ("s",)), 0.5, jnp)))

    start = jnp.array(scene.pack(scene.initial(("s",))))
    slope = jax.jit(jax.jacfwd(flow))(start)
    with mp.workdps(50):
        exact, x = in_mp(scene, scene.initial(("s",)))
        delta = mp.mpf(10) ** -20
        for i in range(3):
            ahead, behind = (
                exact.pack(merged_flow(exact, exact.unpack([c + d * (i == j) for j, c in enumerate(exact.pack(x))],
                                                           ("s",)), mp.mpf("0.5"), mp))
                for d in (delta, -delta)
            )  # fmt: skip
            truth = [float((a - b) / (2 * delta)) for a, b in zip(ahead, behind, strict=True)]
            np.testing.assert_allclose(slope[:, i], truth, rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize("kappa", [1.5, 1e-9, -1.5])
def test_merged_flow_is_the_same_on_arrays_and_traced_numbers(kappa):
    scene = line(kappa=kappa, gamma=0.1)
    rng = np.random.default_rng(5)
    y = np.array(
        [rng.normal(size=50), rng.normal(size=50) * (np.arange(50) % 5 > 0), 2 * rng.normal(size=50)]
    )
    with np.errstate(invalid="ignore"):
        arrays = np.array(scene.pack(merged_flow(scene, scene.unpack(list(y), ("s",)), 0.9, np)))
        program = jax.jit(
            lambda y: jnp.stack(scene.pack(merged_flow(scene, scene.unpack(list(y), ("s",)), 0.9, jnp)))
        )
        traced = np.asarray(program(y))
    alone = []
    for column in y.T:
        alone.append(scene.pack(merged_flow(scene, scene.unpack(column.tolist(), ("s",)), 0.9, math)))
    fine = np.isfinite(alone).all(axis=1)
    assert 5 < fine.sum() <= 50
    for other in (arrays, traced):
        np.testing.assert_array_equal(np.isfinite(other).all(axis=0), fine)
        np.testing.assert_allclose(other[:, fine], np.array(alone).T[:, fine], rtol=1e-13, atol=1e-15)
