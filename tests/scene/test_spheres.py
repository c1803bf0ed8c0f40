"""Points on spheres: orders, what is kept to round-off, and the same motions in angles, as a body and as a top."""

import math
import pickle

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import contactbench as cb
from cases import UPRIGHT_PENDULUM, mine, refusal
from contactbench.measure.order import error_at
from contactbench.methods.by_tolerance import PlainNumbers
from contactbench.numbers.dual import Dual, DualNumbers
from contactbench.scene import rotation_matrix
from contactbench.scene.spheres import circular
from contactbench.testing import check_scene
from contactbench.truth import decimal_context
from contactbench.xla import jax, jnp
from properties import contact_defect

PENDULUM = cb.SCENES["spherical_pendulum"]
#: two points of other masses and radii, coupled, with nonlinear damping
PAIR = cb.Spheres(
    name="pair",
    potential=lambda q, k: k * q[0][2] + 0.3 * q[1][0] ** 2 + sum(a * b for a, b in zip(*q, strict=True)),
    parameters={"k": 1.3},
    mass=(1.5, 0.7),
    radius=(1.0, 2.0),
    gamma=0.1,
    kappa=0.3,
    s=0.4,
    q=((0.6, 0.0, -0.8), (0.0, 2.0, 0.0)),
    p=((0.32, 0.9, 0.24), (0.3, 0.0, -0.4)),
    t_end=5.0,
)
#: rotors in a plane, of which nothing but their angles to each other counts
ROTORS = cb.Spheres(
    name="rotors",
    potential=lambda q: -q[0][0] * q[1][0] - q[0][1] * q[1][1],
    rotation_invariant=True,
    gamma=0.1,
    q=((0.6, -0.8), (0.0, 1.0)),
    p=((0.8, 0.6), (0.3, 0.0)),
    t_end=5.0,
)
#: what a unit quaternion is in R⁴, off every axis
AROUND = (0.5, 0.1, -0.7, 0.5)


def point(q, p, potential=lambda q: 0 * q[0], **more):
    given = {"name": "point", "gamma": 0.1, "t_end": 5.0} | more
    return cb.Spheres(potential=potential, q=q, p=p, **given)


FOUR = point(AROUND, (0.7, -0.1, 0.4, -0.12), lambda q: 0.3 * q[0] * q[1] + 0.2 * q[3] ** 2, name="four")
CONTACT = [name for name, method in cb.METHODS.items() if method.contact and method.refuses(PENDULUM) is None]
ORDERED = [name for name in CONTACT if cb.METHODS[name].order is not None]


@pytest.mark.parametrize(
    "scene", [PAIR.recorded(), PAIR.with_(kappa=0.0), ROTORS, FOUR], ids=lambda scene: scene.name
)
@pytest.mark.quick(scene=("four",))
def test_they_keep_the_rules_of_scenes(scene):
    check_scene(scene)


# -- orders and structure ----------------------------------------------------------------------------
@pytest.mark.parametrize("gamma", [0.0, 0.2, 3.0])
@pytest.mark.parametrize("name", ORDERED)
@pytest.mark.quick(name="contact-rkn6", gamma=0.2)
def test_tables_keep_their_order(name, gamma):
    """At 50 digits, so that no round-off hides the slope: Nyström's tables too, at any damping."""
    method, scene = cb.METHODS[name], PENDULUM.with_(gamma=gamma)
    order = method.order
    if name == "contact-printed" and gamma == 0:
        order = 2
    coarse, fine = (float(error_at(method, scene, 2.0, n)) for n in (16, 32))
    assert math.log2(coarse / fine) == pytest.approx(order, abs=0.35)


@pytest.mark.parametrize("name", ["contact-strang", "contact-rkn6", "contact-rkn8"])
@pytest.mark.parametrize("scene", [PENDULUM, PAIR.with_(kappa=0.0), FOUR], ids=lambda scene: scene.name)
@pytest.mark.quick(name="contact-rkn6", scene=("spherical_pendulum",))
def test_a_step_is_a_contact_map_of_the_tangent_bundle(scene, name):
    """On vectors tangent to it, as far as floats are on it."""
    assert contact_defect(cb.METHODS[name], scene, "0.37", 2) < 1e-15


@pytest.mark.parametrize("name", CONTACT)
@pytest.mark.quick(name=("contact-strang", "contact-rkn8"))
def test_what_is_kept_is_kept_to_round_off(name):
    found = cb.solve(PENDULUM, name, step=0.1)
    deviation = found.laws()["deviation"]
    assert deviation["sphere_drift"] < 2e-14
    assert deviation["momentum_law"] < 2e-13
    assert deviation["contact_drift"] < 5e-12
    assert cb.LAWS["sphere_drift"].claimed(found)


@pytest.mark.slow
def test_long_runs_stay_on_the_sphere():
    """Where roundings of |q| and q·p drive each other, unless kicks take them back (to 10⁻³ at this end)."""
    scene = UPRIGHT_PENDULUM.with_(t_end=20000.0)
    found = cb.solve(scene, "contact-rkn4", step=0.05, save_at=np.linspace(200, 20000, 100))
    assert cb.LAWS["sphere_drift"](found) < 2e-15


def test_other_methods_drift_off_the_sphere():
    """By as much as |q| and q·p say; nobody claims it."""
    found = cb.solve(PENDULUM, "rk4", step=0.2, save_at=[10.0, 20.0])
    lengths = np.abs(np.linalg.norm(found.q, axis=1) - 1)
    momenta = np.abs(np.sum(found.q * found.p, axis=1)) / max(np.linalg.norm(PENDULUM.p), math.sqrt(2))
    assert cb.LAWS["sphere_drift"](found) == pytest.approx(max(*lengths, *momenta))
    assert 1e-6 < lengths.max() < 1e-2
    assert not cb.LAWS["sphere_drift"].claimed(found)


# -- the flow ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("angle", [0.0, 1e-170, 1e-8, 0.3, 0.999, 1.001, 3.2, 50.0, 1e5])
def test_cosine_and_sinc_are_those_of_the_library(angle):
    xp, square = decimal_context(40), angle * angle
    exact = xp.sqrt(xp.mpf(square))
    cos, sinc = circular(square, math)
    many = circular(np.array([square, 0.25]), np)
    size = 4e-16 * max(1.0, angle)
    assert abs(cos - xp.cos(exact)) < size
    assert abs(sinc - (xp.sin(exact) / exact if exact else 1)) < size
    assert (many[0][0], many[1][0]) == (cos, sinc)
    slope = circular(Dual(square, 1.0), DualNumbers(PlainNumbers()))[0].b  # d cos θ = −½ (sin θ/θ) d θ²
    assert slope == pytest.approx(-sinc / 2, rel=1e-9, abs=1e-15 * max(1.0, angle))


def test_a_free_point_goes_round_its_great_circle():
    """A thousand turns in one step, of mass 2 on radius 3, slowed down: the angle is |p| φ(h)/(m R)."""
    scene = point((3.0, 0.0, 0.0), (0.0, 40000.0, 0.0), mass=2.0, radius=3.0, gamma=0.5)
    angle = 40000.0 * -math.expm1(-0.5) / 0.5 / 6
    found = cb.solve(scene, "contact-strang", step=1.0, save_at=[1.0])
    turned = (math.cos(angle), math.sin(angle), 0.0)
    assert np.allclose(found.q[0], [3 * c for c in turned], rtol=0, atol=1e-9)
    ahead = np.array((-turned[1], turned[0], 0))
    assert np.allclose(found.p[0], 40000 * math.exp(-0.5) * ahead, rtol=0, atol=1e-4)
    assert found.s[0] == pytest.approx(math.exp(-0.5) * 40000.0**2 / 4 * -math.expm1(-0.5) / 0.5, rel=1e-12)


@pytest.mark.slow
def test_a_step_is_smooth_where_nothing_moves():
    """First and second derivatives at p = 0, by JAX, against differences of the first."""
    scene = PENDULUM.with_(p=(0.0, 0.0, 0.0))
    step = cb.step_map(scene, "contact-strang")
    y, e = jnp.array(scene.pack(scene.initial(("s",)))), 1e-5
    f = lambda y: jnp.stack(step(tuple(y), 0.3))  # noqa: E731
    forward, backward, second = jax.jacfwd(f), jax.jacrev(f), jax.hessian(f)(y)
    assert np.allclose(forward(y), backward(y), rtol=0, atol=1e-15)
    columns = [(forward(y.at[j].add(e)) - forward(y.at[j].add(-e))) / (2 * e) for j in range(7)]
    assert np.allclose(second, np.stack(columns, axis=-1), rtol=0, atol=1e-9)


# -- the same motions, written otherwise ---------------------------------------------------------------
def test_a_plane_pendulum_is_its_angle():
    """Mass 2, length 0.5, quadratic damping: p_θ = R p·e, s the same."""
    m, R, more = 2.0, 0.5, {"kappa": 0.2, "s": 0.3}
    angle = mine(lambda q: -R * cb.math.cos(q[0]), 0.9, 0.8, 4.0, mass=m * R * R, gamma=0.1, **more)
    q, p = (R * math.sin(0.9), -R * math.cos(0.9)), (0.8 / R * math.cos(0.9), 0.8 / R * math.sin(0.9))
    plane = point(q, p, lambda q: q[1], mass=m, radius=R, **more)
    for method in ("contact-rkn6", "contact-abc"):  # merged with damping, and in three parts
        one, other = (cb.solve(scene, method, step=0.1, save_at=[4.0]) for scene in (angle, plane))
        theta = one.q[0, 0]
        direction = np.array([math.cos(theta), math.sin(theta)])
        assert np.allclose(other.q[0], R * np.array([math.sin(theta), -math.cos(theta)]), rtol=0, atol=1e-13)
        assert np.allclose(other.p[0], one.p[0, 0] / R * direction, rtol=0, atol=1e-13)
        assert other.s[0] == pytest.approx(one.s[0], abs=1e-13)


def around(quaternion, M):
    """Return 2 R ⊗ (0, M), the momentum of a body with equal moments I as a point of mass 4I on S³."""
    w, x, y, z = quaternion
    a, b, c = M
    product = (-x * a - y * b - z * c, w * a + y * c - z * b, w * b - x * c + z * a, w * c + x * b - y * a)
    return tuple(2 * each for each in product)


def test_a_body_with_equal_moments_is_a_point_on_the_sphere_in_four_dimensions():
    M, inertia = (0.2, 1.5, 0.3), 1.7
    body = cb.RigidBody(name="ball", inertia=(inertia,) * 3, M=M, R=AROUND, gamma=0.1, t_end=20.0)
    ball = point(AROUND, around(AROUND, M), rotation_invariant=True, mass=4 * inertia, t_end=20.0)
    one, other = (cb.solve(scene, "contact-strang", step=1.0) for scene in (body, ball))
    assert np.allclose(other.q, one.quaternion, rtol=0, atol=1e-13)
    expected = [around(R, M) for R, M in zip(one.quaternion, one.M, strict=True)]
    assert np.allclose(other.p, expected, rtol=0, atol=1e-13)
    assert np.allclose(other.s, one.s, rtol=0, atol=1e-13)
    assert cb.LAWS["momentum_law"](other) < 1e-13


def test_a_top_with_equal_moments_is_one_too():
    axis, weight = (0.3, -0.4, 0.8), 1.7
    top = cb.SCENES["heavy_top"].with_(
        inertia=(0.5,) * 3, weight=weight, axis=axis, gamma=0.1, M=(0.4, -0.7, 1.1), R=AROUND
    )
    height = lambda q: weight * sum(a * b for a, b in zip(rotation_matrix(q)[2], axis, strict=True))  # noqa: E731
    four = point(AROUND, around(AROUND, top.M), height, mass=2.0)
    one = cb.solve(top, "contact-bm6", step=0.02, save_at=[3.0])
    other = cb.solve(four, "contact-rkn8", step=0.05, save_at=[3.0])
    assert np.allclose(other.q[0], one.quaternion[0], rtol=0, atol=1e-10)
    assert np.allclose(other.p[0], around(one.quaternion[0], one.M[0]), rtol=0, atol=1e-10)
    assert other.s[0] == pytest.approx(one.s[0], abs=1e-10)


def test_coupled_points_move_as_scipy_says():
    """Lagrange's multiplier by hand, masses and radii that differ, Γ = γs + ½κs²."""
    m, R, k = (1.5, 0.7), (1.0, 2.0), 1.3

    def rhs(t, y):
        q, p, s = y[:6].reshape(2, 3), y[6:12].reshape(2, 3), y[12]
        slope = np.array([[0, 0, k], [0.6 * q[1, 0], 0, 0]]) + q[::-1]
        V = k * q[0, 2] + 0.3 * q[1, 0] ** 2 + q[0] @ q[1]
        rate, T, force = 0.1 + 0.3 * s, 0.0, []
        for i in range(2):
            multiplier = (q[i] @ slope[i] - p[i] @ p[i] / m[i]) / R[i] ** 2
            force.append(-slope[i] + multiplier * q[i] - rate * p[i])
            T += p[i] @ p[i] / 2 / m[i]
        velocity = p / np.array(m)[:, None]
        return np.concatenate([velocity.ravel(), np.ravel(force), [T - V - 0.1 * s - 0.15 * s * s]])

    own = solve_ivp(rhs, (0, 5.0), [*PAIR.q, *PAIR.p, PAIR.s], "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    found = cb.solve(PAIR, "contact-rkn8", step=0.05, save_at=[5.0])
    assert np.allclose(found.y[-1], own, rtol=0, atol=1e-9)


# -- what they are given --------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"q": (0.5, 0.0, -0.8)}, r"q = \(0.5, 0.0, -0.8\): must be on the sphere, .* = 1.0: it is 0.943"),
        ({"p": (1.0, 0.0, 0.0)}, r"p = \(1.0, 0.0, 0.0\): must be tangent, q·p = 0: q·p is 0.6"),
        ({"radius": 2.0}, r"\|q\| = radius = 2.0: it is 1.0"),
        ({"radius": (1.0, 1.0)}, "must be one number > 0, or 1 of them"),
        ({"q": (0.6, 0.8), "p": (0.0, 0.0)}, "must be 3 numbers for each point"),
        ({"axis": (0.0, 0.0, 0.0)}, "must be the direction of an axis, not zero"),
        ({"q": ((0.6, 0.8, 0.0), (1.0, 0.0))}, r"q\[1\] = \(1.0, 0.0\): must be 3 numbers"),
        ({"q": PAIR.q[:3] * 2, "p": (0.0,) * 6}, "gradient: of several points it is derived"),
        ({"dimension": 1}, "dimension = 1: must be a whole number ≥ 2"),
    ],
)
def test_a_start_that_is_none_is_refused_in_one_line(changes, says):
    with pytest.raises(cb.BadInput, match=says):
        PENDULUM.with_(**changes)


def test_a_symmetry_that_is_none_is_refused():
    with pytest.raises(cb.BadInput, match=r"axis = \(1.0, 0.0, 0.0\), but the potential exerts a torque"):
        cb.reference(PENDULUM.with_(potential=lambda q, weight: weight * q[2], axis=(2, 0, 0)), 1.0)
    with pytest.raises(cb.BadInput, match="is for points in space, and for one axis"):
        ROTORS.with_(axis=(0, 0, 1))


def test_a_start_of_one_s_own_and_a_copy():
    run = cb.prepare(PENDULUM, "contact-rkn6", step=0.1, save_at=[1.0])
    found = run(q=(0.8, 0.0, -0.6), p=(0.0, 0.5, 0.0))
    elsewhere = PENDULUM.with_(q=(0.8, 0.0, -0.6), p=(0.0, 0.5, 0.0))
    again = cb.solve(elsewhere, "contact-rkn6", step=0.1, save_at=[1.0])
    assert np.array_equal(found.y, again.y)
    assert "must be on the sphere" in refusal(lambda: run(q=(0.8, 0.1, -0.6)))
    copy = pickle.loads(pickle.dumps(PAIR))
    pair = (cb.solve(scene, "contact-rkn4", step=0.1, save_at=[1.0]).y for scene in (PAIR, copy))
    assert np.array_equal(*pair)
    flat = PAIR.with_(q=PAIR.q, mass=2.0)  # one after the other, as they are kept
    assert flat.bodies == 2
    assert flat.momentum(flat.initial(()))[2] == pytest.approx(0.6 * 0.9 - 2.0 * 0.3)
