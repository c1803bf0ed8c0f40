"""What is made from a user's functions belongs to what they compute now: programs, references, solutions."""

import copy
import math
import pickle
from functools import partial, wraps
from itertools import pairwise

import mpmath
import numpy as np
import pytest

import contactbench as cb
from cases import chain, mine
from contactbench.numbers.functions import cos, exp, log, sin, sqrt, where
from contactbench.peers.compiled import functions
from contactbench.scene import Mechanical
from contactbench.scene.base import as_formula


def from_a_closure():
    """A potential, its gradient, and how its stiffness is changed."""
    k = 1.0

    def change(value):
        nonlocal k
        k = value

    return (lambda q: k * q[0] ** 2 / 2), (lambda q: (k * q[0],)), change


#: every engine once
RUNS = [
    ("contact-rkn6", {"step": 0.01}),
    ("contact-rkn6", {"step": 0.01, "engine": "python"}),
    ("cvode-bdf", {"rtol": 1e-9, "engine": "c+python"}),
    ("cyrk-dop853", {"rtol": 1e-10}),
    ("heyoka-taylor", {"rtol": 1e-10}),
    pytest.param("diffrax-tsit5", {"rtol": 1e-8}, marks=pytest.mark.slow),
    ("scipy-dop853", {"rtol": 1e-10}),
]


def oscillator(potential, gradient, kind=Mechanical, **more):
    return mine(potential, **{"t_end": 5.0, "kind": kind, "gradient": gradient} | more)


def truth(k):
    return math.cos(math.sqrt(k) * 5.0)


@pytest.mark.parametrize(("method", "options"), RUNS)
def test_a_function_that_changes_is_another_problem(method, options):
    potential, gradient, change = from_a_closure()
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
        assert cb.LAWS["solution_error"](solution) < 1e-5


class Spring:
    def __init__(self):
        self.k = 1.0

    def potential(self, q):
        return self.k * q[0] ** 2 / 2


def from_an_attribute():
    spring = Spring()
    return spring.potential, None, partial(setattr, spring, "k")


SHARED = {"k": 1.0}


def from_a_global_number():
    return (lambda q: SHARED["k"] * q[0] ** 2 / 2), None, partial(SHARED.__setitem__, "k")


def by_steps(scene):
    step = cb.step_map(scene, "contact-rkn6", carry=())
    y = step.start
    for _ in range(100):
        y = step(y, scene.t_end / 100)
    return y[0]


CALLS = {
    "solve": lambda scene: cb.solve(scene, "contact-rkn6", step=0.05).q[-1, 0],
    "run": lambda scene: cb.prepare(scene, "cvode-adams", rtol=1e-9)().q[-1, 0],
    "step": by_steps,
    "reference": lambda scene: cb.reference(scene, [5.0], ()).y[0, 0],
}


@pytest.mark.parametrize("made", [from_a_closure, from_an_attribute, from_a_global_number])
@pytest.mark.parametrize("call", CALLS)
@pytest.mark.quick(made=from_a_closure, call=("run", "step"))
@pytest.mark.quick(call="solve")
def test_so_it_is_wherever_the_stiffness_is_held_and_whoever_is_called(made, call):
    potential, gradient, change = made()
    scene = oscillator(potential, gradient)
    for k in (1.0, 2.0, 1.0):
        change(k)
        assert CALLS[call](scene) == pytest.approx(truth(k), abs=1e-5)
        own = oscillator(lambda q, k: k * q[0] ** 2 / 2, None, parameters={"k": 0.0})
        assert CALLS[call](own.with_(k=k)) == pytest.approx(truth(k), abs=1e-5)


@pytest.fixture
def weighted():
    """The weight of the second stage in a registered method of a user's."""
    weight = [0.5]

    @cb.fixed_step("mine", order=1, evaluations=2)
    def step(scene, x, h, xp):
        a = scene.rhs(x)
        b = scene.rhs(cb.shifted(x, h, a))
        return cb.shifted(cb.shifted(x, (1 - weight[0]) * h, a), weight[0] * h, b)

    yield weight
    del cb.METHODS["mine"]


@pytest.mark.parametrize("engine", ["llvm", "python"])
def test_a_step_map_that_changes_is_another_method(engine, weighted):
    """And a solution that there is stays what it was."""
    ends, solutions = [], []
    for weighted[0] in (0.5, 0.0, 0.5):
        solutions.append(cb.solve("oscillator", "mine", step=0.1, engine=engine))
        ends.append(solutions[-1].y[-1])
    np.testing.assert_array_equal(ends[0], ends[2])
    assert np.abs(ends[0] - ends[1]).max() > 1e-2
    drifts = [cb.LAWS["contact_drift"](solution) for solution in solutions]
    assert drifts[0] == drifts[2] < drifts[1] / 10


@pytest.mark.parametrize("method", ["contact-rkn6", "contact-strang", "herglotz2"])
def test_flows_refuse_a_kind_that_writes_its_equations_anew(method):
    class Heavy(Mechanical):
        def dissipation(self, s):
            return 3 * self.gamma * s

        def dissipation_rate(self, s):
            return 3 * self.gamma

    scene = oscillator(lambda q: q[0] ** 2 / 2, None, Heavy, gamma=0.1)
    options = {"rtol": 1e-6} if cb.METHODS[method].adaptive else {"step": 0.1}
    assert cb.solve(scene, method, **options).status == "unsupported"
    assert cb.solve(scene, "rk4", step=0.1).ok


NEAR_REST = {
    "pendulum": (lambda q: -cb.math.cos(q[0]), lambda q: (cb.math.sin(q[0]),)),
    "double well": (lambda q: (q[0] ** 2 - 1) ** 2 / 4, lambda q: (q[0] ** 3 - q[0],)),
    "offset": (lambda q: 1 + (q[0] - 3) ** 2 / 2, None),
    "quartic": (lambda q: 100 - q[0] ** 4 / 4, None),
    "large": (lambda q: 1e6 + q[0] ** 2 / 2, None),
}


@pytest.mark.parametrize("name", NEAR_REST)
@pytest.mark.parametrize("q", [0.0, 1e-12, 1e-9, 1e-7, 1e-3, 1.0, 1 + 1e-9, 3.0])
def test_a_start_beside_an_equilibrium_is_no_wrong_gradient(name, q):
    """Differences of a potential whose values are few there agree by luck."""
    cb.solve(oscillator(*NEAR_REST[name], q=q, t_end=1.0), "rk4", step=0.1, engine="python")


def test_what_cannot_be_recorded_is_kept_nowhere_and_not_pickled():
    k = 1.0
    scene = oscillator(lambda q: k * float(q[0]) ** 2 / 2, lambda q: (k * float(q[0]),))
    assert scene.recorded().identity is None
    with pytest.raises(cb.BadInput, match=r"its potential .* cannot be pickled"):
        pickle.dumps(scene)
    for k in (1.0, 2.0):
        assert cb.solve(scene, "rk4", step=0.01).q[-1, 0] == pytest.approx(truth(k), abs=1e-6)
        assert cb.solve(scene, "scipy-dop853", rtol=1e-10).q[-1, 0] == pytest.approx(truth(k), abs=1e-6)


def test_a_function_that_wraps_another_of_the_same_name_is_not_that():
    """`functools.wraps` lends the name of a registered scene's force, and with it its frozen reference."""
    particle = cb.SCENES["particle"]
    potential = wraps(particle.potential)(lambda q, **own: 2 * particle.potential(q, **own))
    gradient = wraps(particle.gradient)(lambda q, **own: tuple(2 * x for x in particle.gradient(q, **own)))
    scene = particle.with_(potential=potential, gradient=gradient, hessian=None)
    run = cb.solve(scene, "contact-rkn6", step=0.05, save_at=[0.5])
    assert cb.LAWS["solution_error"](run) < 1e-6
    assert cb.reference(scene, [0.5]).source == "live"


def test_what_cannot_be_trusted_or_differentiated_is_refused():
    scene = oscillator(lambda q: q[0] ** 2 / 2, lambda q: (q[0] if isinstance(q[0], float) else 2 * q[0],))
    with pytest.raises(cb.BadInput, match="may not depend on the kind of number"):
        cb.solve(scene, "rk4", step=0.1)
    with pytest.raises(cb.BadInput, match="its gradient is missing"):
        oscillator(lambda q: math.sin(q[0]), None)


# -- the gradient ----------------------------------------------------------------------------------
@pytest.mark.parametrize("center", [-0.1, 0.5, -0.93])
def test_a_gradient_that_is_wrong_somewhere_on_the_way_is_refused(center):
    bump = lambda x: 5 * cb.math.exp(-100 * (x - center) ** 2)  # noqa: E731
    scene = oscillator(lambda q: q[0] ** 2 / 2, lambda q: (q[0] + bump(q[0]),))
    for ask in (
        lambda: cb.reference(scene, [5.0]),
        lambda: cb.solve(scene, "rk4", step=0.05),
        lambda: cb.prepare(scene, "rk4", step=0.05)().laws(),
        lambda: cb.compare(scene, ["rk4", "cvode-adams"], budget=5),
    ):
        with pytest.raises(cb.BadInput, match="its gradient is not the potential's: component 1 is"):
            ask()


# -- sizes -----------------------------------------------------------------------------------------
def test_many_components_compile():
    n = 100
    options = {"step": 0.05, "save_at": [1.0], "carry": ()}
    found, python = (cb.solve(chain(n), "contact-strang", engine=e, **options) for e in (None, "python"))
    np.testing.assert_allclose(found.y, python.y, rtol=0, atol=1e-13)


def test_programs_of_peers_grow_with_the_couplings_not_with_their_square():
    sizes = [
        sum(len(function.body) for function in functions(chain(n).recorded(), ())[1].values())
        for n in (8, 16, 32)
    ]
    assert max(b / a for a, b in pairwise(sizes)) < 2.6


# -- pickling --------------------------------------------------------------------------------------
@pytest.mark.parametrize(("method", "options"), RUNS[::2])
def test_solutions_are_pickled_and_copied(method, options):
    solution = cb.solve(oscillator(*from_a_closure()[:2]), method, **options)
    for other in (pickle.loads(pickle.dumps(solution)), copy.deepcopy(solution)):
        np.testing.assert_array_equal(other.y, solution.y)
        assert repr(other) == repr(solution)
        for law in ("solution_error", "contact_drift"):
            np.testing.assert_allclose(cb.LAWS[law](other), cb.LAWS[law](solution), rtol=1e-6)


@pytest.mark.parametrize("names", [("v0", "v1"), ("v1", "v0"), ("a0", "tuple0"), ("v5", "v3")])
def test_parameters_may_have_any_names(names):
    def end(stiffness, other):
        def potential(q, **given):
            return given[stiffness] * q[0] ** 2 / 2 + given[other] * q[0] ** 4 / 4

        scene = mine(potential, p=0.3, t_end=3.0, parameters={stiffness: 2.0, other: 0.5})
        return cb.solve(scene, "contact-rkn6", step=0.1).y[-1]

    assert np.array_equal(end(*names), end("k", "c"))


# -- derivatives of formulas -------------------------------------------------------------------------
def radius(q):
    return sqrt(q[0] * q[0] + q[1] * q[1])


def pulled(q, by):
    return tuple(by * c for c in q)


def ring(q):
    a, b = q[0] * (1 + q[0] * q[0]), q[1] * (1 + q[1] * q[1])
    r = q[1] - q[0]
    pull = r * (1 + r * r)
    return a - pull, b + pull


def inverse_cube(r):
    return 1 / (r * r * r)


def sixth(q):
    over = 1 / (q[0] * q[0])
    return over * over * over


def lennard_jones(q):
    return ((6 - 12 * sixth(q)) * sixth(q) / q[0],)


#: name → potential, its gradient by hand, number of coordinates
POTENTIALS = {
    "double well": (lambda q: (q[0] ** 2 - 1) ** 2 / 4, lambda q: (q[0] * (q[0] * q[0] - 1),), 1),
    "double well, expanded": (
        lambda q: q[0] ** 4 / 4 - q[0] ** 2 / 2,
        lambda q: (q[0] * (q[0] * q[0] - 1),),
        1,
    ),
    "harmonic": (lambda q: 2.5 * q[0] * q[0] / 2, lambda q: (2.5 * q[0],), 1),
    "pendulum": (lambda q: -cos(q[0]), lambda q: (sin(q[0]),), 1),
    "Kepler": (lambda q: -1 / radius(q), lambda q: pulled(q, inverse_cube(radius(q))), 2),
    "Hénon–Heiles": (
        lambda q: (q[0] * q[0] + q[1] * q[1]) / 2 + q[0] * q[0] * q[1] - q[1] ** 3 / 3,
        lambda q: (q[0] * (1 + 2 * q[1]), q[1] + q[0] * q[0] - q[1] * q[1]),
        2,
    ),
    "Morse": (lambda q: (1 - exp(-q[0])) ** 2, lambda q: (2 * exp(-q[0]) * (1 - exp(-q[0])),), 1),
    "quartic": (
        lambda q: (q[0] ** 2 + q[1] ** 2) / 2 + (q[0] ** 2 + q[1] ** 2) ** 2 / 10,
        lambda q: pulled(q, 1 + 0.4 * (q[0] * q[0] + q[1] * q[1])),
        2,
    ),
    "Lennard-Jones": (lambda q: sixth(q) * sixth(q) - sixth(q), lennard_jones, 1),
    "ring": (
        lambda q: sum(r**2 / 2 + r**4 / 4 for r in (q[0], q[1], q[1] - q[0])),
        ring,
        2,
    ),
    "logarithm": (lambda q: log(1 + q[0] * q[0]), lambda q: (2 * q[0] / (1 + q[0] * q[0]),), 1),
}


@pytest.mark.parametrize("name", POTENTIALS)
def test_a_derived_gradient_takes_hardly_more_operations_than_one_by_hand(name):
    potential, gradient, n = POTENTIALS[name]
    derived, by_hand = as_formula(potential, (n,)).gradient(), as_formula(gradient, (n,))
    assert len(derived.body) <= max(1.2 * len(by_hand.body), len(by_hand.body) + 1)


#: functions of two numbers whose gradient nobody writes by hand
OTHERS = {
    "ratio of a square": lambda q: q[0] * q[0] / (q[0] * q[0]) * q[0],
    "ratio of powers": lambda q: q[0] * q[0] / (q[0] ** 3 + 1) + 3 / (q[1] * q[1]),
    "broken powers": lambda q: q[0] ** -3.5 * q[1] ** 2.3 + 0.1 * q[1] ** -0.3,
    "powers of powers": lambda q: q[0] ** 2.3 + q[1] ** -1.5 + q[0] ** q[1],
    "a number to a power": lambda q: 2.0 ** q[0],  # whose derivative has log 2, a double
    "powers of sums": lambda q: q[0] ** 0.1 * 0.2 + (q[0] * q[0] + 0.3) ** 1.7 / 1.1,
    "choice": lambda q: where(q[0] > 1, q[0] ** 3 * q[1], q[1] / q[0]) * q[1],
    "choice, of quotients": lambda q: where(q[0] > 1, q[0] / 3, q[0] / 7) * 0.1,
    "nested": lambda q: exp(-2 * (1 - q[0] * q[1]) ** 2) * (1 - q[0] * q[1]) - 1 / sqrt(q[0] + q[1] * q[1]),
    "differences": lambda q: (q[0] - q[1]) ** 4 * (2 * q[0] - 3 * q[1]) ** 2 / 7 - (q[0] - q[1]) ** 2,
    "polynomial": lambda q: q[0] ** 4 / 4 - 3 * q[0] * q[1] ** 2 + q[1] / 7 - (q[0] - q[1]) ** 3,
    "roots and quotients": lambda q: -1 / sqrt(q[0] ** 2 + q[1] ** 2) + q[0] / (2 + q[1] ** 2),
    "quotient in an exponent": lambda q: exp(-(((q[0] - 3) / 3) ** 2)) / 7,
    "products": lambda q: 0.1 * (0.1 * q[0] ** 3) * 0.3 + q[0] * 0.7 / 0.9,
    "functions of quotients": lambda q: sin(q[0] / 3) * log(q[0] / 7) / 0.3 + 1 / (q[0] * 0.1) ** 3,
    "exponential": lambda q: (1 - exp(-(q[0] - 0.3))) ** 2 + log(2 + q[1]) * q[0],
    "circular": lambda q: sin(q[0]) * cos(q[1]) + cb.math.tan(q[0] / 3),
    "arcus": lambda q: cb.math.asin(q[0] / 3) + cb.math.acos(q[1] / 3) + cb.math.atan(q[0] * q[1]),
    "angle": lambda q: cb.math.atan2(q[1], q[0]),
    "hyperbolic": lambda q: cb.math.tanh(q[0]) * cb.math.sinh(q[1]) + cb.math.cosh(q[0]),
    "area": lambda q: cb.math.asinh(q[1]) + cb.math.acosh(2 + q[0]) + cb.math.atanh(q[1] / 4),
    "small arguments": lambda q: cb.math.expm1(q[0] - q[1]) * q[1] + cb.math.log1p(q[0] * q[1]),
    "absolute": lambda q: abs(q[0] - q[1]) ** 3 + np.hypot(q[0], q[1]),
    "NumPy": lambda q: np.sin(q[0]) + np.float64(2) * np.exp(q[1]) + np.maximum(q[0], q[1]) ** 2,
    "constant": lambda q: 3.0,
    "one of them": lambda q: q[1],
}


@pytest.mark.parametrize("name", [*POTENTIALS, *OTHERS])
def test_derivatives_are_those_of_the_function(name):
    """At 60 digits, by differences: 1/3, and 0.1 × 0.1 as two floats, are rounded for doubles alone; and in doubles."""
    function, _, n = POTENTIALS[name] if name in POTENTIALS else (OTHERS[name], None, 2)
    value, off = as_formula(function, (n,)), 1e-15 if name == "a number to a power" else 1e-35
    gradient = value.gradient()
    hessian = gradient.hessian()
    for q in np.random.default_rng(5).uniform(0.5, 2.0, (5, n)).tolist():
        with mpmath.workdps(60):
            x, h = tuple(map(mpmath.mpf, q)), mpmath.mpf(10) ** -20
            slope, rows = gradient(x), hessian(x)
            for i in range(n):
                ends = [tuple(c + d * (i == j) for j, c in enumerate(x)) for d in (h, -h)]
                pairs = [(slope[i], [*map(value, ends)])]
                pairs += [(rows[j][i], [gradient(end)[j] for end in ends]) for j in range(n)]
                for found, (ahead, behind) in pairs:
                    assert abs(found - (ahead - behind) / (2 * h)) < off * (1 + abs(found))
            exact, bends = [*map(float, slope)], [*map(float, np.ravel(rows))]
        # roundings of the terms of a sum that cancel
        assert gradient(q) == pytest.approx(exact, rel=1e-14, abs=1e-14 * max(map(abs, exact)))
        assert np.ravel(hessian(q)) == pytest.approx(bends, rel=1e-13, abs=1e-13 * max(1.0, *map(abs, bends)))
