"""Each subflow against a high-precision solution of its own equations, derived from its Hamiltonian."""

from __future__ import annotations

import math

import heyoka
import numpy as np
import pytest
import scipy.linalg
from mpmath import mp

import contactbench as cb
from cases import CONTACT_SCENES, TILTED, USER, by_name, in_mp, random_state
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
    USER.with_(name="antidamped", gamma=-0.4),
]


FLOWS = [(scene, name) for scene in FLOW_SCENES for name in flows_of(scene)]


@by_name(FLOW_SCENES)
def test_a_mechanical_scene_has_every_flow_but_the_merged_one_of_quadratic_damping(scene):
    assert set(MECHANICAL) - set(flows_of(scene)) == ({"drift_damp"} if scene.nonlinear_damping else set())


@pytest.mark.parametrize(("scene", "name"), FLOWS, ids=[f"{scene.name}-{name}" for scene, name in FLOWS])
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


@by_name([*CONTACT_SCENES, *FLOW_SCENES[2:]])
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
        elif not getattr(scene, "nonlinear_damping", False):
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
    for xp in (math, jnp):
        before = flow.apply(scene, scene.initial(("s",)), flow.constants(scene, 0.9, xp), xp)
        after = flow.apply(scene, scene.initial(("s",)), flow.constants(scene, 1.1, xp), xp)
        assert float(before.s) == pytest.approx(-20.0, rel=1e-12)
        assert math.isinf(float(after.s))
