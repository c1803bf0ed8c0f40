"""The functions a force may use: the same on every kind of number, with the right derivative; powers for heyoka."""

import math
from functools import partial
from operator import eq, ge, lt, ne

import heyoka
import mpmath
import numpy as np
import pytest

import contactbench as cb
from contactbench.blame import FUNCTIONS
from contactbench.numbers.dual import DERIVATIVES, Dual
from contactbench.numbers.dual import slope as slope_of
from contactbench.numbers.dual import value as value_of
from contactbench.numbers.protocol import CannotRecord
from contactbench.numbers.series import Series, SeriesNumbers
from contactbench.trace.formula import formula
from contactbench.xla import jax, jnp
from properties import Fixed

#: inside the domain of each
POINT = {name: 1.25 if name == "acosh" else 0.375 for name in FUNCTIONS}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_kind_of_number_gives_the_same(name):
    x, function = POINT[name], getattr(cb.math, name)
    expected = getattr(math, name)(x)
    assert function(x) == expected
    assert function(np.array([x, x])) == pytest.approx([expected] * 2, rel=1e-15)
    assert float(jax.jit(function)(jnp.asarray(x))) == pytest.approx(expected, rel=1e-15)
    with mpmath.workdps(40):
        precise = function(mpmath.mpf(x))
        assert float(precise) == pytest.approx(expected, rel=1e-15)
        assert abs(precise - getattr(mpmath, name)(mpmath.mpf(x))) == 0
    slope = (function(x + 1e-6) - function(x - 1e-6)) / 2e-6
    assert function(Dual(x, 1.0)).b == pytest.approx(slope, rel=1e-8)


@pytest.mark.parametrize("name", DERIVATIVES)
def test_derivatives_of_dual_numbers(name):
    """Of 30-digit ones, so that the formula shows and not its rounding."""
    alias = {"arctan": "atan", "arcsin": "asin", "abs": "fabs"}
    with mpmath.workdps(30):
        x, v = mpmath.mpf(POINT.get(name, 0.375)), mpmath.mpf("1.7")
        function = getattr(mpmath, alias.get(name, name))
        derivative = DERIVATIVES[name](Fixed(mpmath.mp), x, function(x)) * v
        assert abs(derivative - v * mpmath.diff(function, x)) < mpmath.mpf(10) ** -15


SEVERAL = {
    "hypot": (lambda x: cb.math.hypot(x, 2 * x), lambda x: math.sqrt(5) * abs(x)),
    "where": (lambda x: cb.math.where(x > 0, x * x, -x), lambda x: x * x if x > 0 else -x),
    "where, of a constant": (lambda x: cb.math.where(x > 0, x, 1.0), lambda x: x if x > 0 else 1.0),
    "where, of constants": (lambda x: x * cb.math.where(x > 0, 2.0, 3.0), lambda x: x * (2 if x > 0 else 3)),
    "abs": (abs, abs),
}


@pytest.mark.parametrize("name", SEVERAL)
@pytest.mark.parametrize("x", [0.375, -0.375])
def test_functions_of_several_numbers(name, x):
    function, plain = SEVERAL[name]
    expected, slope = plain(x), (plain(x + 1e-6) - plain(x - 1e-6)) / 2e-6
    array = np.array([x, x])
    for found in (function(x), *function(array), jax.jit(function)(jnp.asarray(x)), function(mpmath.mpf(x))):
        assert float(found) == pytest.approx(expected, rel=1e-15)
    assert float(function(array.astype(object))[0]) == pytest.approx(expected, rel=1e-15)
    found = function(Dual(x, 1.0))
    assert [get(found) for get in (value_of, slope_of)] == pytest.approx([expected, slope], rel=1e-8)
    assert jax.grad(function)(x) == pytest.approx(slope, rel=1e-8)
    recorded = formula(lambda q: function(q), (0,), ())
    assert recorded(x) == pytest.approx(expected, rel=1e-15)
    assert recorded.gradient()(x)[0] == pytest.approx(slope, rel=1e-8)


WALL = {
    "abs": lambda q: 2 * abs(q[0]) ** 3 / 3,
    "hypot": lambda q: 2 * cb.math.hypot(q[0], 0.5) ** 3 / 3,
    "where": lambda q: cb.math.where(q[0] < 0, q[0] ** 4, q[0] ** 2) / 2,
}


@pytest.mark.parametrize("name", WALL)
def test_a_potential_of_several_pieces_runs_everywhere(name):
    scene = cb.Mechanical(name=name, potential=WALL[name], gamma=0.1, q=(1.0,), p=(0.0,), t_end=4.0)
    compiled, python = (cb.solve(scene, "contact-rkn4", step=0.05, engine=e) for e in ("llvm", "python"))
    assert compiled.ok
    np.testing.assert_allclose(python.y, compiled.y, rtol=1e-12)
    assert cb.solve(scene, "cvode-adams", rtol=1e-9).q[-1] == pytest.approx(compiled.q[-1], abs=1e-3)


def test_functions_of_floats_are_total():
    assert math.isnan(cb.math.sqrt(-1.0))
    assert cb.math.log(0.0) == -math.inf
    assert cb.math.exp(1e3) == math.inf
    assert cb.math.sinh(-1e3) == -math.inf


# -- powers of heyoka's expressions: products where a power has no series at zero ------------------------
X = Series(heyoka.expression("x"))


def values(series, x):
    return heyoka.cfunc([each.expression for each in series], vars=[X.expression])(np.array([x]))


def test_a_power_is_that_power():
    powers = [-3, -1, 0, 1, 2, *range(3, 17), 20, 0.5, 2.5]
    assert values([X**n for n in powers], 1.3) == pytest.approx([1.3**n for n in powers], rel=1e-14)


def test_a_whole_power_has_a_series_at_zero():
    powers = range(1, 17)
    states = [heyoka.expression(f"x{n}") for n in powers]
    system = [(x, (1 + Series(x) ** n).expression) for n, x in zip(powers, states, strict=True)]
    run = heyoka.taylor_adaptive(system, [0.0] * len(powers))
    assert run.propagate_until(0.5)[0] == heyoka.taylor_outcome.time_limit
    assert np.isfinite(run.state).all()
    assert run.state[:2] == pytest.approx([np.expm1(0.5), np.tan(0.5)], rel=1e-14)


def test_arithmetic_from_both_sides_and_of_numpy_s_scalars():
    y = np.float64(2.0) * (3.0 - X) / (1.0 + X) - (-X) + X / 4.0 + 2.0**X
    true = [2 * 2.5 / 1.5 + 0.5 + 0.125 + 2**0.5, np.arctan2(0.5, 2.0)]
    assert values([y, SeriesNumbers().atan2(X, 2.0)], 0.5) == pytest.approx(true, rel=1e-14)


def test_its_value_cannot_be_asked_for():
    for ask in (bool, float, int, iter, *(partial(each, 0) for each in (eq, ne, lt, ge))):
        with pytest.raises(CannotRecord, match="known only when the program runs"):
            ask(X)


def test_a_function_that_it_has_not_is_refused_with_what_it_has():
    with pytest.raises(AttributeError, match=r"cb\.math has no 'cbrt': it has acos, .*, where"):
        _ = cb.math.cbrt


def test_a_potential_that_takes_its_tuple_for_a_number_is_told_what_it_is_given():
    with pytest.raises(cb.BadInput, match=r"q is a tuple of numbers, q\[0\] the first"):
        cb.Mechanical(name="x", potential=lambda q: q**2 / 2, q=(1.0,), p=(0.0,), t_end=1.0)
