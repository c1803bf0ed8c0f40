"""Any contact Hamiltonian: its derived equations, and the contact maps that collocation makes of them."""

import math
import pickle

import numpy as np
import pytest

import contactbench as cb
from cases import by_name, few_slow, refusal
from contactbench.measure.order import order_at
from contactbench.methods import contact_gauss
from contactbench.methods.implicit import TRIED, jacobian
from contactbench.scene import State
from contactbench.testing import check_scene
from contactbench.truth import decimal_context
from contactbench.xla import jax, jnp
from properties import pullback

m = cb.math


def anything(q, p, s):
    """No sum of parts: its contact maps have factors of their own."""
    kinetic = (1 + 0.3 * m.sin(s)) * (p[0] ** 2 + p[1] ** 2) / 2
    return kinetic + m.cos(q[0]) * q[1] ** 2 + 0.2 * s**2 + 0.1 * s * p[0] * q[1]


GENERAL = cb.ContactSystem(name="general", hamiltonian=anything, q=(0.5, 0.3), p=(0.2, 0.4), s=0.3, t_end=4.0)
#: what cannot be told from its name: damping of q, a rate that follows q, terms odd in p, powers
ROUGH = cb.ContactSystem(
    name="rough",
    hamiltonian=lambda q, p, s, a: (
        m.sqrt(1 + p[0] ** 2) + q[0] ** 4 / 4 + (a + q[0] ** 2) * s + 0.3 * p[0] * q[0]
    ),
    parameters={"a": 0.1},
    q=(0.7,),
    p=(-0.4,),
    s=0.2,
    t_end=4.0,
)
PENDULUM, POLAR, THERMOSTAT = map(cb.SCENES.get, ("double_pendulum", "polar", "thermostat"))
SCENES = [GENERAL, ROUGH, PENDULUM, POLAR, THERMOSTAT]
METHODS = {"contact-gauss2": 2, "contact-gauss4": 4, "contact-gauss8": 8}
PEERS = ("rk4", "rk8-7", "scipy-radau", "cvode-bdf", "cyrk-dop853", "diffrax-dopri8", "heyoka-taylor")
GIVEN = {"q": (1.0,), "p": (0.5,), "t_end": 1.0}


def matrix(q):
    c = m.cos(q[0] - q[1])
    return ((2.0, c), (c, 1.0))


def height(q):
    return 2 * (1 - m.cos(q[0])) + (1 - m.cos(q[1]))


MASSIVE = cb.Mechanical(
    name="massive", mass=matrix, potential=height, gamma=0.1, q=PENDULUM.q, p=PENDULUM.p, t_end=20.0
)


# -- the equations ---------------------------------------------------------------------------------
@by_name([*SCENES, MASSIVE])
def test_a_contact_system_follows_the_rules_of_scenes(scene):
    check_scene(scene)


@pytest.mark.quick(scene="rough")
@by_name(SCENES)
def test_its_equations_are_those_that_jax_derives(scene):
    n, rng = len(scene.q), np.random.default_rng(3)

    def H(y):
        return scene.hamiltonian(tuple(y[:n]), tuple(y[n : 2 * n]), y[2 * n], **scene.parameters)

    for _ in range(3):
        y = 0.3 * rng.normal(size=2 * n + 1) + 1.0
        slope = np.array(jax.grad(H)(jnp.asarray(y)))
        H_q, H_p, H_s, p = slope[:n], slope[n : 2 * n], slope[2 * n], y[n : 2 * n]
        expected = [*H_p, *(-H_q - p * H_s), p @ H_p - float(H(jnp.asarray(y)))]
        found = scene.pack(scene.rhs(scene.unpack(y.tolist(), ("s",))))
        np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13)


def test_where_the_rate_is_known_and_s_need_not_be_carried_is_seen_from_h():
    assert (PENDULUM.conformal_rate, PENDULUM.required) == (0.1, ())
    assert PENDULUM.with_(gamma=0.3).conformal_rate == 0.3
    for scene in (GENERAL, ROUGH, THERMOSTAT):
        assert (scene.conformal_rate, scene.required) == (None, ("s",))
    bare = cb.solve(PENDULUM, "contact-gauss4", step=0.1, carry=(), save_at=[2.0]).y[-1]
    whole = cb.solve(PENDULUM, "contact-gauss4", step=0.1, save_at=[2.0]).y[-1]
    np.testing.assert_allclose(bare, whole[:4], atol=1e-14)


@pytest.mark.quick(scene="general", method=("contact-gauss4", "cyrk-dop853", "heyoka-taylor"))
@pytest.mark.parametrize("scene", [GENERAL, ROUGH], ids=["general", "rough"])
@pytest.mark.parametrize("method", [*METHODS, *PEERS])
def test_methods_of_all_engines_agree_on_it(method, scene):
    own = cb.METHODS[method]
    for engine in own.engines:
        setting = {"rtol": 1e-9} if own.adaptive else {"step": 2e-3 if own.order > 2 else 1e-4}
        solution = cb.solve(scene, method, engine=engine, save_at=[0.5], **setting)
        assert solution.ok, solution.message
        # measured: 2e-9 of cvode-bdf, 5e-9 of contact-gauss2
        assert cb.LAWS["solution_error"](solution) < 1e-7


def test_what_h_reads_is_read_by_every_call():
    strength = [1.0]
    scene = cb.ContactSystem(hamiltonian=lambda q, p, s: p[0] ** 2 / 2 + strength[0] * q[0] ** 2 / 2, **GIVEN)
    x = State((1.0,), (0.5,), 0.0)
    assert scene.rhs(x).p == (-1.0,)
    first = cb.solve(scene, "rk4", step=0.1)
    strength[0] = 4.0
    assert scene.rhs(x).p == (-4.0,)
    assert not np.array_equal(first.y, cb.solve(scene, "rk4", step=0.1).y)


def test_it_is_pickled_and_changed_and_stepped():
    again = pickle.loads(pickle.dumps(ROUGH))
    x = ROUGH.initial(("s",))
    assert again.rhs(x) == ROUGH.rhs(x)
    assert again.with_(a=0.7).rhs(x) == ROUGH.with_(a=0.7).rhs(x) != ROUGH.rhs(x)
    step = cb.step_map(ROUGH, "contact-gauss4")
    one = cb.solve(ROUGH, "contact-gauss4", step=0.1, save_at=[0.1]).y[-1]
    np.testing.assert_allclose(step(step.start, 0.1), one, rtol=1e-14)


@pytest.mark.parametrize("scene", few_slow([ROUGH, GENERAL], GENERAL), ids=["rough", "general"])
def test_jax_takes_gradients_of_a_step_that_iterates(scene):
    """Of the equations, not of the iteration: also for arrays, and for the scene's numbers."""
    step, h = cb.step_map(scene, "contact-gauss2"), 0.1
    y, d = np.array(step.start), len(step.start)

    def after(y, numbers):
        return jnp.stack(step(tuple(y), h, tuple(numbers)))

    numbers = np.array(scene.numbers())
    backward = jax.vmap(jax.jacrev(after, argnums=(0, 1)), in_axes=(0, None))
    (J, again), (K, _) = jax.jit(backward)(jnp.stack([y, y]), numbers)
    forward = jax.jit(jax.jacfwd(after))(y, numbers)
    np.testing.assert_allclose(J, forward, rtol=1e-13, atol=1e-15)
    delta, points = 1e-5, np.concatenate([y, numbers])
    for column, moved in zip(np.hstack([J, K]).T, delta * np.eye(len(points)), strict=True):
        ends = [np.array(step(p[:d], h, p[d:])) for p in (points + moved, points - moved)]
        np.testing.assert_allclose(column, (ends[0] - ends[1]) / (2 * delta), atol=1e-8)
    np.testing.assert_allclose(again, J, rtol=1e-13, atol=1e-15)


# -- contact maps ----------------------------------------------------------------------------------
@pytest.mark.quick(scene="rough")
@by_name([ROUGH, GENERAL, PENDULUM])
@pytest.mark.parametrize("method", METHODS)
def test_orders_at_fifty_digits(method, scene):
    found = order_at(cb.METHODS[method], scene.recorded(), 0.5, 4)
    assert found == pytest.approx(METHODS[method], abs=0.06)  # measured: within 0.03


def off_the_form(method, scene):
    """Return how far Φ*η is from c η, c a number, in parts of η."""
    pulled, form = pullback(cb.METHODS[method], scene.recorded(), "0.1", 1)
    context = decimal_context(150)
    c = sum(a * b for a, b in zip(pulled, form, strict=True)) / sum(b * b for b in form)
    return context.norm([a - c * b for a, b in zip(pulled, form, strict=True)]) / context.norm(form)


@pytest.mark.quick(scene="rough", method=("contact-gauss4", "rk4"))
@by_name(SCENES)
@pytest.mark.parametrize("method", [*METHODS, "rk4"])
def test_a_step_is_a_contact_map_whatever_h(method, scene):
    """At 150 digits: Φ*η is c η for a number c, which a Runge–Kutta method misses by its error."""
    off = off_the_form(method, scene)
    assert off > 1e-12 if method == "rk4" else off < 1e-90


@by_name([GENERAL])
@pytest.mark.parametrize("method", METHODS)
def test_a_step_of_doubles_is_one_to_round_off(method, scene):
    steps = [cb.solve(scene, method, step=h, save_at=[h]) for h in (0.02, 0.1, 0.2)]
    assert max(map(cb.LAWS["distribution_drift"], steps)) < 3e-15  # measured: 1e-15


@by_name([PENDULUM, POLAR, cb.SCENES["central"]])
def test_where_the_rate_is_known_the_factor_is_that_of_the_flow(scene):
    solution = cb.solve(scene, "contact-gauss4", step=0.25, save_at=[2.0])
    assert cb.LAWS["solution_error"](solution) > 1e-6
    assert cb.LAWS["contact_drift"](solution) < 1e-12  # measured: 3e-13 on polar, of 24 iterations a step
    if scene.has_momentum_law:
        assert cb.LAWS["momentum_law"](solution) < 1e-13


def test_strong_damping_does_not_slow_the_iteration_down():
    """Where r is known the equations of (q, P) have no damping in them."""
    runs = (cb.solve(PENDULUM.with_(gamma=g), "contact-gauss4", step=0.05) for g in (0.1, 50))
    weak, strong = (run.counts.evaluations for run in runs)
    assert strong < 1.1 * weak


def test_a_wrong_coefficient_costs_the_structure(monkeypatch):
    given = contact_gauss.rule

    def wrong(xp, stages):
        (first, *rows), found = given(xp, stages).matrix, given(xp, stages)
        return found._replace(matrix=[[*first[:-1], first[-1] + 1e-6], *rows])

    monkeypatch.setattr(contact_gauss, "rule", wrong)
    assert off_the_form("contact-gauss4", ROUGH) > 1e-9


@pytest.mark.parametrize("engine", ["llvm", "python"])
def test_a_step_without_a_solution_fails_and_says_so(engine):
    solution = cb.solve("kepler_drag", "contact-gauss4", step=0.125, save_at=[0.5], engine=engine)
    assert solution.status is cb.Status.failed
    assert "does not converge at t = 0, of a step of 0.125" in solution.message


@pytest.mark.parametrize("engine", ["llvm", "python"])
@pytest.mark.parametrize("gamma", [0.0, 0.3, 40.0])
def test_where_the_fixed_point_iteration_stalls_newtons_finds_the_step(gamma, engine):
    """ωh = 50: undamped, the midpoint rule is Cayley's map; damped, the factor is that of the flow."""
    stiff = cb.SCENES["oscillator"].with_(omega=100.0, gamma=gamma, t_end=5.0)
    solution = cb.solve(stiff, "contact-gauss2", step=0.5, save_at=[0.5, 1.0], engine=engine)
    assert solution.ok
    assert cb.LAWS["contact_drift"](solution) < 1e-10
    # twelve iterations or more come first, then the Jacobian and a few more
    assert 2 * (TRIED + 6) <= solution.counts.evaluations < 60
    if gamma == 0.0:
        A = np.array([[0.0, 1.0], [-1e4, 0.0]])
        cayley = np.linalg.solve(np.eye(2) - A / 4, np.eye(2) + A / 4)
        y = np.array([stiff.q[0], stiff.p[0]])
        for state in solution.y[:, :2]:
            y = cayley @ y
            np.testing.assert_allclose(state, y, atol=1e-12 * np.abs(y).max())


def test_a_wrong_jacobian_is_no_newton_iteration(monkeypatch):
    wrong = lambda f, x: [[0.1 * c for c in row] for row in jacobian(f, x)]  # noqa: E731
    monkeypatch.setattr(contact_gauss, "jacobian", wrong)
    stiff = cb.SCENES["oscillator"].with_(omega=100.0, name="stiff_too")
    solution = cb.solve(stiff, "contact-gauss2", step=0.5, save_at=[0.5], engine="python")
    assert solution.status is cb.Status.failed


# -- scenes ----------------------------------------------------------------------------------------
def test_polar_is_central_in_other_coordinates():
    t = np.linspace(0, 20, 201)
    x, y = (cb.reference(scene, t).states() for scene in (POLAR, cb.SCENES["central"]))
    (r, angle), (radial, J) = x.q, x.p
    c, s = np.cos(angle), np.sin(angle)
    mapped = [r * c, r * s, radial * c - J * s / r, radial * s + J * c / r, x.s]
    np.testing.assert_allclose(mapped, [*y.q, *y.p, y.s], atol=1e-14)


def test_the_thermostat_has_the_canonical_density():
    """div X = −(n + 1) ∂H/∂s, and ρ = e^{−βh} e^s/(1 + e^s)² is transported by it: div(ρX) = 0."""

    def log_density(y):
        q, p, s = y
        return -THERMOSTAT.parameters["beta"] * (q * q + p * p) / 2 + s - 2 * math.log1p(math.exp(s))

    scene, delta = THERMOSTAT.recorded(), 1e-5
    for y in np.random.default_rng(2).normal(size=(5, 3)):
        x = scene.unpack(y.tolist(), ("s",))
        slope = np.array(scene.pack(scene.rhs(x)))
        along = (log_density(y + delta * slope) - log_density(y - delta * slope)) / (2 * delta)
        divergence = np.trace(np.array(scene.jacobian(x)))
        assert divergence + along == pytest.approx(0, abs=1e-6 * np.abs(slope).max() ** 3)


def test_a_mass_that_depends_on_q_is_factored_in_the_recording():
    x = PENDULUM.unpack([0.3, -0.7, 0.2, 0.9, 0.4], ("s",))
    own, other = (scene.pack(scene.rhs(x)) for scene in (MASSIVE, PENDULUM))
    np.testing.assert_allclose(own, other, rtol=1e-14, atol=1e-15)
    rng = np.random.default_rng(1)
    root, p = rng.normal(size=(4, 4)), rng.normal(size=4)
    M = root @ root.T + np.eye(4)
    given = {"potential": lambda q: q[0] * q[1] + q[2] ** 2 + q[3], "q": (0.0,) * 4, "p": tuple(p), "s": 0.5}
    scene = massive(mass=lambda q: tuple(map(tuple, M.tolist())), kappa=0.3, **given)()
    x = scene.initial(("s",))
    assert scene.hamiltonian_at(x) == pytest.approx(p @ np.linalg.solve(M, p) / 2 + 0.15 * 0.25, rel=1e-13)
    np.testing.assert_allclose(scene.rhs(x).q, np.linalg.solve(M, p), rtol=1e-12)
    assert scene.parameters == {"gamma": 0.0, "kappa": 0.3}


def test_rotations_of_a_metric_are_a_symmetry():
    def conformal(q, swell):
        size = 1 + swell * (q[0] ** 2 + q[1] ** 2)
        return ((size, 0.0 * q[0]), (0.0 * q[0], size))

    given = {
        "potential": lambda q: (q[0] ** 2 + q[1] ** 2) / 2,
        "q": (1.0, 0.2),
        "p": (0.3, 0.4),
        "t_end": 5.0,
    }
    scene = massive(mass=conformal, parameters={"swell": 0.3}, rotation_invariant=True, gamma=0.1, **given)()
    assert cb.LAWS["momentum_law"](cb.solve(scene, "contact-gauss4", step=0.25)) < 1e-14
    assert cb.LAWS["momentum_law"](cb.solve(scene, "rk4", step=0.25)) > 1e-8


def test_laws_of_a_general_h():
    solution = cb.solve(THERMOSTAT, "contact-gauss4", step=0.1, save_at=[1.0])
    laws = solution.laws()["deviation"]
    assert 1e-9 < laws["contact_drift"] < 1e-3  # its own factor is off by its error
    assert laws["distribution_drift"] < 1e-13
    assert laws["hamiltonian_law"] < 1e-2
    assert {"momentum_law", "pairing_drift"}.isdisjoint(laws.index)


# -- bad input -------------------------------------------------------------------------------------
def system(H, **changes):
    return lambda: cb.ContactSystem(hamiltonian=H, **GIVEN | changes)


def massive(**changes):
    given = {"mass": matrix, "potential": height, "q": (1.0, 0.5), "p": (0.0, 0.0), "t_end": 1.0}
    return lambda: cb.Mechanical(name="mine", **given | changes)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (system(lambda q, p, s: 1.0), "depends on none of q, p and s"),
        (system(lambda q, p, s: p[0] if p[0] > 0 else q[0]), "its hamiltonian cannot be recorded"),
        (system(lambda q, p, s: 1j * p[0]), "must return a real number"),
        (system(lambda q, p: p[0]), "is called with q, p, s; it takes q, p"),
        (system(lambda q, p, s: q[0] / (p[0] - 0.5)), "ZeroDivisionError"),
        (system(lambda q, p, s: p[0] ** 2, gamma=0.1), "gamma: ContactSystem takes none"),
        (system(lambda q, p, s: p[0] ** 2 + q[0], momentum=lambda q, p, s: p[0]), "momentum: is none of a symmetry"),
        (system(lambda q, p, s: p[0] ** 2, momentum=lambda q, p, s: "J"), "momentum: must return a real number"),
        (massive(mass=lambda q: 2.0), "mass: is 2.0 at q = (1.0, 0.5): must be 2 rows of 2 numbers"),
        (massive(mass=lambda q: ((1.0, 2.0), (2.0, 1.0))), "symmetric and positive definite"),
        (massive(gradient=height), "gradient: is derived"),
        (massive(parameters={"gamma": 0.1}), "parameter 'gamma': must have a name of its own"),
        (massive(mass=((1.0, 0.0), (0.0, 1.0))), "cb.Mechanical(mass=lambda q: …)"),
        (massive(rotation_invariant=True), "is none of a symmetry"),
    ],
)  # fmt: skip
def test_bad_input_is_refused_in_one_line(call, says):
    assert says in refusal(call)
