"""What is made from a user's functions belongs to what they compute now: programs, references, solutions."""

from __future__ import annotations

import copy
import math
import pickle
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from multiprocessing import get_context

import numpy as np
import pytest

import contactbench as cb
from contactbench.peers import heyoka
from contactbench.scene import Mechanical, RigidBody
from contactbench.trace.compiled import compiled
from contactbench.trace.formula import formula

STIFFNESS = 1.0


class Spring:
    """A potential whose stiffness is an attribute."""

    def __init__(self, k):
        self.k = k

    def potential(self, q):
        return self.k * q[0] ** 2 / 2

    def gradient(self, q):
        return (self.k * q[0],)


@dataclass
class Unhashable:
    """The same as a callable that cannot be a key."""

    spring: Spring
    name: str

    def __call__(self, q):
        return getattr(self.spring, self.name)(q)


def from_globals():
    def change(k):
        global STIFFNESS
        STIFFNESS = k

    change(1.0)
    return (lambda q: STIFFNESS * q[0] ** 2 / 2), (lambda q: (STIFFNESS * q[0],)), change


def from_a_closure():
    k = 1.0

    def change(value):
        nonlocal k
        k = value

    return (lambda q: k * q[0] ** 2 / 2), (lambda q: (k * q[0],)), change


def from_an_attribute():
    spring = Spring(1.0)
    return spring.potential, spring.gradient, partial(setattr, spring, "k")


def from_a_default_argument():
    held = [1.0]

    def potential(q, k=held):
        return k[0] * q[0] ** 2 / 2

    def gradient(q, k=held):
        return (k[0] * q[0],)

    return potential, gradient, partial(held.__setitem__, 0)


def from_an_object_that_is_called():
    spring = Spring(1.0)
    return Unhashable(spring, "potential"), Unhashable(spring, "gradient"), partial(setattr, spring, "k")


SOURCES = [
    from_globals, from_a_closure, from_an_attribute, from_a_default_argument, from_an_object_that_is_called,
]  # fmt: skip
#: every engine once, and one method of every kind of run
RUNS = [
    ("contact-rkn6", {"step": 0.01}), ("contact-rkn6", {"step": 0.01, "engine": "jax"}),
    ("contact-rkn6", {"step": 0.01, "engine": "python"}), ("contact-strang", {"rtol": 1e-6}),
    ("rk4", {"step": 0.01}), ("herglotz2", {"step": 0.001}), ("contact-adaptive", {"rtol": 1e-8}),
    ("cvode-adams", {"rtol": 1e-10}), ("cvode-bdf", {"rtol": 1e-9, "engine": "c+python"}),
    ("cyrk-dop853", {"rtol": 1e-10}), ("heyoka-taylor", {"rtol": 1e-10}), ("diffrax-tsit5", {"rtol": 1e-8}),
    ("scipy-dop853", {"rtol": 1e-10}), ("scipy-radau", {"rtol": 1e-8}),
]  # fmt: skip


def oscillator(potential, gradient, **more):
    return Mechanical(
        name="mine", potential=potential, gradient=gradient, q=(1.0,), p=(0.0,), t_end=5.0, **more
    )


def truth(k):
    return math.cos(math.sqrt(k) * 5.0)


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize(
    ("method", "options"), RUNS, ids=lambda x: x if isinstance(x, str) else x.get("engine")
)
def test_a_function_that_changes_is_another_problem(source, method, options):
    potential, gradient, change = source()
    scene = oscillator(potential, gradient)
    run = cb.prepare(scene, method, **options)
    before = cb.solve(scene, method, **options)
    change(2.0)
    after = cb.solve(scene, method, **options)
    assert before.q[-1, 0] == pytest.approx(truth(1.0), abs=1e-5)
    assert after.q[-1, 0] == pytest.approx(truth(2.0), abs=1e-5)
    # a prepared run, and a solution, stay what they were
    assert run().q[-1, 0] == pytest.approx(truth(1.0), abs=1e-5)
    for solution in (before, after):
        assert solution.laws().loc["solution_error", "deviation"] < 1e-5


@pytest.mark.parametrize("source", SOURCES)
def test_so_is_it_to_references_ensembles_and_step_maps(source):
    potential, gradient, change = source()
    scene = oscillator(potential, gradient)
    for k in (1.0, 2.0, 1.0):
        change(k)
        assert cb.reference(scene, [5.0]).y[0, 0] == pytest.approx(truth(k), abs=1e-14)
        for engine in ("numba", "jax"):
            found = cb.ensemble(scene, "contact-rkn6", {"q": (np.ones(3),)}, step=0.05, engine=engine)
            assert found.final.q[0] == pytest.approx(truth(k), abs=1e-6)
        step = cb.step_map(scene, "contact-rkn6", carry=())
        y = step.start
        for _ in range(100):
            y = step(y, 0.05)
        assert y[0] == pytest.approx(truth(k), abs=1e-6)


def test_a_step_map_that_changes_is_another_method():
    weight = 0.5

    @cb.fixed_step("mine", order=1, evaluations=2)
    def step(scene, x, h, xp):
        a = scene.rhs(x)
        b = scene.rhs(cb.shifted(x, h, a))
        return cb.shifted(cb.shifted(x, (1 - weight) * h, a), weight * h, b)

    try:
        for engine in ("numba", "jax", "python"):
            ends = []
            for value in (0.5, 0.0, 0.5):
                weight = value
                ends.append(cb.solve("oscillator", "mine", step=0.1, engine=engine).y[-1])
            np.testing.assert_array_equal(ends[0], ends[2])
            assert np.abs(ends[0] - ends[1]).max() > 1e-2
    finally:
        del cb.METHODS["mine"]


@pytest.mark.parametrize("engine", ["numba", "python"])
def test_what_was_made_from_a_step_map_stays_what_it_was(engine):
    weight = 0.5

    @cb.fixed_step("mine", order=1, evaluations=2)
    def step(scene, x, h, xp):
        return cb.shifted(x, h, scene.rhs(cb.shifted(x, weight * h, scene.rhs(x))))

    try:
        solution, one = (
            cb.solve("oscillator", "mine", step=0.05, engine=engine),
            cb.step_map("oscillator", "mine"),
        )
        drift, y = cb.LAWS["contact_drift"](solution), one(one.start, 0.1)
        weight = 1.0
        again = cb.solve("oscillator", "mine", step=0.05, engine=engine)
        assert cb.LAWS["contact_drift"](again) > 10 * drift
        copied = cb.solve("oscillator", "mine", step=0.05, engine=engine)
        assert cb.LAWS["contact_drift"](copied) == cb.LAWS["contact_drift"](again)
        assert one(one.start, 0.1) == y
    finally:
        del cb.METHODS["mine"]


@pytest.mark.parametrize("method", ["contact-rkn6", "contact-strang", "contact-adaptive", "herglotz2"])
def test_flows_refuse_a_kind_that_writes_its_equations_anew(method):
    class Heavy(Mechanical):
        def dissipation(self, s):
            return 3 * self.gamma * s

        def dissipation_rate(self, s):
            return 3 * self.gamma

    scene = Heavy(name="heavy", potential=lambda q: q[0] ** 2 / 2, gamma=0.1, q=(1.0,), p=(0.0,), t_end=5.0)
    options = {"rtol": 1e-6} if cb.METHODS[method].adaptive else {"step": 0.1}
    found = cb.solve(scene, method, **options)
    assert found.status == "unsupported"
    assert "dissipation_rate" in found.message
    assert cb.solve(scene, "rk4", step=0.1).ok


NEAR_REST = {
    "pendulum": lambda q: -cb.math.cos(q[0]), "offset": lambda q: 1 + (q[0] - 3) ** 2 / 2,
    "quartic": lambda q: 100 - q[0] ** 4 / 4, "large": lambda q: 1e6 + q[0] ** 2 / 2,
    "double well": lambda q: (q[0] ** 2 - 1) ** 2 / 4,
}  # fmt: skip


@pytest.mark.parametrize("name", NEAR_REST)
def test_a_start_beside_an_equilibrium_is_no_wrong_gradient(name):
    """Differences of a potential whose values are few there agree by luck."""
    for q in (0.0, 1e-12, 1e-7, 1e-3, 1.0, 1 + 1e-9, 3.0):
        scene = Mechanical(name=name, potential=NEAR_REST[name], gamma=0.1, q=(q,), p=(0.0,), t_end=1.0)
        cb.solve(scene, "rk4", step=0.1, engine="python")
    given = {"double well": lambda q: (q[0] ** 3 - q[0],), "pendulum": lambda q: (cb.math.sin(q[0]),)}.get(
        name
    )
    if given is not None:
        for q in (0.0, 1e-9, 1.0):
            scene = Mechanical(
                name=name, potential=NEAR_REST[name], gradient=given, gamma=0.1, q=(q,), p=(0.0,), t_end=1.0
            )
            cb.solve(scene, "rk4", step=0.1, engine="python")


def test_what_cannot_be_recorded_is_kept_nowhere():
    k = 1.0
    scene = oscillator(lambda q: k * float(q[0]) ** 2 / 2, lambda q: (k * float(q[0]),))
    assert scene.recorded().identity is None
    for k in (1.0, 2.0):
        assert cb.solve(scene, "rk4", step=0.01).q[-1, 0] == pytest.approx(truth(k), abs=1e-6)
        assert cb.solve(scene, "scipy-dop853", rtol=1e-10).q[-1, 0] == pytest.approx(truth(k), abs=1e-6)


class Own(Mechanical):
    """A kind of scene of a user's own: its force is a method."""

    strength = 1.0

    def V(self, q):
        return self.strength * q[0] ** 2 / 2

    def dV(self, q):
        return (self.strength * q[0],)


@pytest.mark.parametrize("method", ["contact-rkn6", "cvode-adams", "heyoka-taylor"])
def test_so_are_the_equations_of_a_kind_of_ones_own(method, monkeypatch):
    scene = Own(
        name="own", potential=lambda q: 0.0, gradient=lambda q: (q[0],), q=(1.0,), p=(0.0,), t_end=5.0
    )
    options = {"step": 0.01} if method == "contact-rkn6" else {"rtol": 1e-10}
    for k in (1.0, 2.0):
        monkeypatch.setattr(Own, "strength", k)
        solution = cb.solve(scene, method, **options)
        assert solution.q[-1, 0] == pytest.approx(truth(k), abs=1e-6)


def test_a_function_that_wraps_another_of_the_same_name_is_not_that():
    """`functools.wraps` lends the name of a registered scene's force, and with it its frozen reference."""
    from functools import wraps

    particle = cb.SCENES["particle"]

    def doubled(function, times):
        @wraps(function)
        def wrapper(q, **parameters):
            return times(function(q, **parameters))

        return wrapper

    scene = particle.with_(
        potential=doubled(particle.potential, lambda v: 2 * v),
        gradient=doubled(particle.gradient, lambda g: tuple(2 * x for x in g)),
        hessian=None,
    )
    assert cb.solve(scene, "contact-rkn6", step=0.05).laws().loc["solution_error", "deviation"] < 1e-6
    assert cb.reference(scene, [20.0]).source == "live"


def test_a_function_of_the_kind_of_number_is_refused():
    scene = oscillator(lambda q: q[0] ** 2 / 2, lambda q: (q[0] if isinstance(q[0], float) else 2 * q[0],))
    with pytest.raises(cb.BadInput, match="may not depend on the kind of number"):
        cb.solve(scene, "rk4", step=0.1)


# -- the gradient ----------------------------------------------------------------------------------
@pytest.mark.parametrize("center", [-0.1, 0.5, -0.93])
def test_a_gradient_that_is_wrong_somewhere_on_the_way_is_refused(center):
    scene = oscillator(
        lambda q: q[0] ** 2 / 2, lambda q: (q[0] + 5 * cb.math.exp(-100 * (q[0] - center) ** 2),)
    )
    for ask in (
        lambda: cb.reference(scene, [5.0]),
        lambda: cb.solve(scene, "rk4", step=0.05),
        lambda: cb.prepare(scene, "rk4", step=0.05)().laws(),
        lambda: cb.compare(scene, ["rk4", "cvode-adams"], budget=5),
    ):
        with pytest.raises(cb.BadInput, match="its gradient is not the potential's: component 1 is"):
            ask()


MECHANICAL = [s for s in cb.SCENES.values() if isinstance(s, Mechanical)]


@pytest.mark.parametrize("scene", MECHANICAL, ids=lambda s: s.name)
def test_derived_derivatives_are_those_written_by_hand_and_as_short(scene):
    sizes = tuple(len(scene.q) if name == "q" else 0 for name in scene.functions["gradient"][:-1])
    written = formula(scene.gradient, sizes, tuple(scene.parameters))
    potential = formula(scene.potential, sizes, tuple(scene.parameters))
    derived = potential.gradient()
    rng = np.random.default_rng(7)
    places = [rng.uniform(0.2, 1.5, len(scene.q)) for _ in range(20)]
    time = () if scene.clock is None else (0.7,)
    for q in places:
        np.testing.assert_allclose(
            derived(tuple(q), *time, **scene.parameters),
            written(tuple(q), *time, **scene.parameters), rtol=1e-13, atol=1e-14,
        )  # fmt: skip
        if scene.hessian is not None:
            np.testing.assert_allclose(
                np.array(derived.jacobian(symmetric=True)(tuple(q), **scene.parameters), dtype=float),
                np.array(scene.hessian(tuple(q), **scene.parameters), dtype=float), rtol=1e-12, atol=1e-13,
            )  # fmt: skip
    assert len(derived.operations) <= 1.3 * len(written.operations) + 1


FUNCTIONS = {
    "polynomial": lambda q: q[0] ** 4 / 4 - 3 * q[0] * q[1] ** 2 + q[1] / 7 - (q[0] - q[1]) ** 3,
    "roots and quotients": lambda q: -1 / cb.math.sqrt(q[0] ** 2 + q[1] ** 2) + q[0] / (2 + q[1] ** 2),
    "exponential": lambda q: (1 - cb.math.exp(-(q[0] - 0.3))) ** 2 + cb.math.log(2 + q[1]) * q[0],
    "circular": lambda q: cb.math.sin(q[0]) * cb.math.cos(q[1]) + cb.math.tan(q[0] / 3),
    "inverse": lambda q: cb.math.atan2(q[1], q[0]) + cb.math.asin(q[0] / 3) + cb.math.acos(q[1] / 3)
    + cb.math.atan(q[0] * q[1]),
    "hyperbolic": lambda q: cb.math.tanh(q[0]) * cb.math.sinh(q[1]) + cb.math.cosh(q[0])
    + cb.math.asinh(q[1]) + cb.math.acosh(2 + q[0]) + cb.math.atanh(q[1] / 4),
    "powers": lambda q: q[0] ** 2.3 + q[1] ** -1.5 + q[0] ** q[1] + 2.0 ** q[0],
    "absolute": lambda q: abs(q[0] - q[1]) ** 3 + np.hypot(q[0], q[1]),
    "NumPy": lambda q: np.sin(q[0]) + np.float64(2) * np.exp(q[1]) + np.maximum(q[0], q[1]) ** 2,
    "constant": lambda q: 3.0,
    "one of them": lambda q: q[1],
}  # fmt: skip


@pytest.mark.parametrize("name", FUNCTIONS)
def test_derivatives_of_formulas_against_jax(name):
    import jax

    recorded = formula(FUNCTIONS[name], (2,), ())
    derived = recorded.gradient()
    rng = np.random.default_rng(3)
    for q in rng.uniform(0.3, 1.4, (10, 2)):
        wanted = jax.grad(lambda q: recorded((q[0], q[1])) + 0 * q[0])(jax.numpy.array(q))
        np.testing.assert_allclose(derived(tuple(q)), wanted, rtol=1e-12, atol=1e-13)
        hessian = jax.hessian(lambda q: recorded((q[0], q[1])) + 0 * q[0])(jax.numpy.array(q))
        for symmetric in (True, False):
            found = np.array(derived.jacobian(symmetric)(tuple(q)), dtype=float)
            np.testing.assert_allclose(found, hessian, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("method", list(cb.METHODS))
def test_a_scene_needs_its_potential_only(method):
    """Every engine has the force, and where it is asked for the Jacobian, that the potential implies."""
    written = cb.SCENES["central"].with_(t_end=3.0)
    scene = Mechanical(
        name="central without", potential=lambda q: (q[0] ** 2 + q[1] ** 2) / 2 + (q[0] ** 2 + q[1] ** 2) ** 2 / 4,
        gamma=0.1, q=written.q, p=written.p, t_end=3.0,
    )  # fmt: skip
    chosen = cb.METHODS[method]
    if chosen.refuses(written) is not None:
        assert cb.solve(scene, method).status == "unsupported"
        return
    options = (
        {"rtol": 1e-8} if chosen.adaptive else {"step": 0.02 if chosen.order and chosen.order > 1 else 0.002}
    )
    expected, found = (cb.solve(s, method, save_at=[3.0], **options) for s in (written, scene))
    assert found.ok
    tolerance = 1e-10 if not chosen.adaptive else 1e-6
    np.testing.assert_allclose(found.y, expected.y, rtol=0, atol=tolerance)


def test_a_potential_that_cannot_be_differentiated_needs_a_gradient():
    with pytest.raises(cb.BadInput, match="its gradient is missing"):
        oscillator(lambda q: math.sin(q[0]), None)


# -- sizes -----------------------------------------------------------------------------------------
def chain(n):
    def potential(q):
        total = 0.0
        for i in range(n):
            r = q[i] - q[i - 1]
            total = total + r * r / 2 + r**4 / 16
        return total

    q = [math.sin(2 * math.pi * i / n) for i in range(n)]
    return Mechanical(name="chain", potential=potential, gamma=1e-3, q=q, p=[0.0] * n, t_end=1.0)


@pytest.mark.parametrize("n", [250, pytest.param(1000, marks=pytest.mark.slow)])
def test_many_components_compile(n):
    found = cb.solve(chain(n), "contact-strang", step=0.05, save_at=[1.0], carry=())
    python = cb.solve(chain(n), "contact-strang", step=0.05, save_at=[1.0], carry=(), engine="python")
    np.testing.assert_allclose(found.y, python.y, rtol=0, atol=1e-13)


@pytest.mark.parametrize("method", ["cvode-adams", "cvode-bdf", "cyrk-dop853"])
def test_programs_of_peers_grow_with_the_couplings_not_with_their_square(method):
    from contactbench.peers.c_functions import source

    sizes = [len(source(chain(n).recorded(), ()).splitlines()) for n in (8, 16, 32, 64)]
    assert max(b / a for a, b in pairwise(sizes)) < 2.6


def test_integrators_of_heyoka_are_bounded():
    scene = cb.SCENES["oscillator"]
    for i in range(heyoka._integrators.size + 5):
        cb.prepare(scene.with_(gamma=0.01 * (i + 1)), "heyoka-taylor", rtol=1e-3)
    assert len(heyoka._integrators) == heyoka._integrators.size


# -- pickling --------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", list(cb.SCENES))
def test_registered_scenes_are_pickled_and_copied(name):
    scene = cb.SCENES[name]
    assert pickle.loads(pickle.dumps(scene)).identity == scene.identity
    assert copy.deepcopy(scene) == scene


@pytest.mark.parametrize(("method", "options"), RUNS[::3])
def test_solutions_are_pickled_and_copied(method, options):
    solution = cb.solve(oscillator(*from_a_closure()[:2]), method, **options)
    for other in (pickle.loads(pickle.dumps(solution)), copy.deepcopy(solution)):
        np.testing.assert_array_equal(other.y, solution.y)
        assert repr(other) == repr(solution)
        for law in ("solution_error", "contact_drift"):
            np.testing.assert_allclose(cb.LAWS[law](other), cb.LAWS[law](solution), rtol=1e-6)


def test_results_of_a_process_pool_are_ordinary():
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        solution = pool.submit(cb.solve, "particle", "contact-rkn6", step=0.1).result()
    np.testing.assert_array_equal(solution.y, cb.solve("particle", "contact-rkn6", step=0.1).y)
    assert solution.laws().loc["contact_drift", "deviation"] < 1e-12


def test_ensembles_are_pickled():
    found = cb.ensemble(oscillator(*from_a_closure()[:2]), "contact-rkn6", {"q": (np.ones(3),)}, step=0.1)
    again = pickle.loads(pickle.dumps(found))
    np.testing.assert_array_equal(again.final.q[0], found.final.q[0])


def test_a_scene_that_cannot_be_pickled_says_so_in_a_line():
    scene = oscillator(lambda q: float(q[0]) ** 2 / 2, lambda q: (float(q[0]),))
    with pytest.raises(cb.BadInput, match=r"its potential .* cannot be pickled"):
        pickle.dumps(scene)


# -- runs that are wrecked -------------------------------------------------------------------------
def test_an_energy_that_no_motion_has_is_no_ok():
    eccentric = 0.99
    scene = cb.SCENES["kepler_drag"].with_(
        q=(1 - eccentric, 0.0), p=(0.0, math.sqrt((1 + eccentric) / (1 - eccentric))), gamma=0.0, t_end=20.0
    )
    wrecked = cb.solve(scene, "contact-strang", step=0.01)
    assert (wrecked.status, wrecked.end_time < 20.0) == ("diverged", True)
    assert "H0 rose from -0.5 to" in wrecked.message
    assert np.isnan(wrecked.y[-1]).all()
    assert cb.solve(scene, "contact-strang", step=1e-4).ok
    # from the top of a double well every error is an increase: small beside the energies on the way, it is none
    well = Mechanical(
        name="well", potential=lambda q: q[0] ** 4 / 4 - q[0] ** 2 / 2, q=(1e-4,), p=(0.0,), t_end=40.0
    )
    assert cb.solve(well, "rk4", step=0.1).ok


def test_the_absolute_tolerance_is_told():
    assert "rtol=1e-06, atol=1e-06)" in repr(cb.solve("oscillator", "cvode-adams", rtol=1e-6))
    assert "rtol=1e-06, atol=1e-12)" in repr(cb.solve("oscillator", "cvode-adams", rtol=1e-6, atol=1e-12))
    for method in ("heyoka-taylor", "contact-adaptive"):  # their steps follow from rtol alone
        assert "atol" not in repr(cb.solve("oscillator", method, rtol=1e-6))
        with pytest.raises(cb.BadInput, match="takes rtol alone"):
            cb.solve("oscillator", method, rtol=1e-6, atol=1e-6)


def test_equal_programs_are_compiled_once():
    """Two functions that compute the same are one to the compiler."""
    cb.solve(oscillator(*from_a_closure()[:2]), "rk4", step=0.1)
    before = compiled.cache_info().misses
    cb.solve(oscillator(*from_an_attribute()[:2]), "rk4", step=0.1)
    assert compiled.cache_info().misses == before


def test_a_rigid_body_has_no_functions_of_a_user():
    body = RigidBody(name="body", inertia=(1.0, 2.0, 3.0), gamma=0.1, M=(0.2, 1.5, 0.3), t_end=1.0)
    assert body.recorded() is body
    assert body.identity is not None
