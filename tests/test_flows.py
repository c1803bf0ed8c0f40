"""Each subflow against a high-precision solution of its own equations, derived from its Hamiltonian."""

from __future__ import annotations

import math

import heyoka
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from cases import CONTACT_SCENES, TILTED, USER, by_name, in_mp, random_state
from mpmath import mp

import contactbench as cb
from contactbench.flows import BODY, MECHANICAL, body_damp, damped_time, flows_of, rotation

BITS = 180
DIGITS = mp.mpf(10) ** -45
H = "0.37"


def symbolic_flow(hamiltonian, n, y0, h):
    """Contact flow of H(q, p, s): equations by heyoka's symbolic derivatives, solved to 180 bits."""
    names = [f"q{i}" for i in range(n)] + [f"p{i}" for i in range(n)] + ["s"]
    v = heyoka.make_vars(*names)
    q, p, s = v[:n], v[n : 2 * n], v[-1]
    energy = hamiltonian(q, p, s) + 0 * s
    Hq, Hp, Hs = [heyoka.diff(energy, c) for c in q], [heyoka.diff(energy, c) for c in p], heyoka.diff(energy, s)
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


@by_name(FLOW_SCENES)
@pytest.mark.parametrize("name", list(MECHANICAL))
def test_subflow_solves_its_own_equations_to_45_digits(scene, name, mp50):
    if name not in flows_of(scene):
        assert scene.nonlinear_damping
        assert name == "drift_damp"
        return
    exact, x = in_mp(scene, random_state(scene, 7))
    flow = flows_of(scene)[name]
    mine = flow.apply(exact, x, flow.constants(exact, mp50.mpf(H), mp50), mp50)
    truth = symbolic_flow(parts(scene)[name], len(x.q), scene.pack(x), H)
    for a, b in zip(scene.pack(mine), truth, strict=True):
        assert abs(a - b) < DIGITS * 10


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_rotation_is_the_flow_of_its_part_of_the_kinetic_energy(axis, mp50):
    """M' = M × ω e_i, R' = R ω ê_i, s' = M_i²/2I_i with ω = M_i/I_i constant: by matrix exponentials."""
    body = cb.SCENES["rigid_body"].with_(inertia=(0.7, 1.9, 2.3))
    exact, x = in_mp(body, random_state(body, 8))
    h = mp50.mpf(H)
    out = rotation(exact, x, axis, h, mp50)
    rate = x.M[axis] / exact.inertia[axis]
    hat = mp50.zeros(3)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    hat[j, k], hat[k, j] = -rate, rate
    turned = mp50.expm(-h * hat) * mp50.matrix(list(x.M))  # M × Ω = −Ω̂ M
    left = mp50.zeros(4)  # q' = ½ q ⊗ (0, ω e_i)
    a = axis + 1
    b, c = j + 1, k + 1
    left[0, a], left[a, 0], left[b, c], left[c, b] = -rate / 2, rate / 2, rate / 2, -rate / 2
    attitude = mp50.expm(h * left) * mp50.matrix(list(x.R))
    for mine, truth in zip([*out.M, *out.R], [*turned, *attitude], strict=True):
        assert abs(mine - truth) < DIGITS
    assert abs(out.s - x.s - h * x.M[axis] * rate / 2) < DIGITS


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
        assert flow.group

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
