"""Powers of heyoka's expressions: products where a power has no series at zero, the same numbers everywhere."""

import heyoka
import numpy as np
import pytest

from contactbench.numbers.protocol import CannotRecord
from contactbench.numbers.series import Series, SeriesNumbers


def value(series, x):
    function = heyoka.cfunc([series.expression], vars=[heyoka.expression("x")])
    return function(np.array([x]))[0]


@pytest.mark.parametrize("n", [-3, -1, 0, 1, 2, *range(3, 17), 20, 0.5, 2.5])
def test_a_power_is_that_power(n):
    x = Series(heyoka.expression("x"))
    assert value(x**n, 1.3) == pytest.approx(1.3**n, rel=1e-14)


@pytest.mark.parametrize("n", range(1, 17))
def test_a_whole_power_has_a_series_at_zero(n):
    x = Series(heyoka.expression("x"))
    run = heyoka.taylor_adaptive([(x.expression, (1 + x**n).expression)], [0.0])
    assert run.propagate_until(0.5)[0] == heyoka.taylor_outcome.time_limit
    if n == 2:
        assert run.state[0] == pytest.approx(np.tan(0.5), rel=1e-14)


def test_arithmetic_from_both_sides_and_of_numpy_s_scalars():
    x = Series(heyoka.expression("x"))
    y = np.float64(2.0) * (3.0 - x) / (1.0 + x) - (-x) + x / 4.0 + 2.0**x
    assert value(y, 0.5) == pytest.approx(2 * 2.5 / 1.5 + 0.5 + 0.125 + 2**0.5, rel=1e-14)
    assert value(SeriesNumbers().atan2(x, 2.0), 0.5) == pytest.approx(np.arctan2(0.5, 2.0), rel=1e-14)


@pytest.mark.parametrize(
    "ask",
    [bool, float, int, lambda x: x == 0, lambda x: x != 0, lambda x: x < 0, lambda x: x >= 0, lambda x: [*x]],
)
def test_its_value_cannot_be_asked_for(ask):
    with pytest.raises(CannotRecord, match="known only when the program runs"):
        ask(Series(heyoka.expression("x")))
