"""Standard errors: of blocks, of functions of means, and honest ones of what is correlated."""

from __future__ import annotations

import numpy as np
import pytest

from contactbench.measure.statistics import blocks, jackknife


def test_the_jackknife_of_a_mean_is_the_standard_deviation_over_the_root_of_the_number():
    means = np.random.default_rng(1).normal(size=(40, 2))
    value, error = jackknife(means)
    np.testing.assert_allclose(value, means.mean(axis=0), rtol=1e-14)
    np.testing.assert_allclose(error, means.std(axis=0, ddof=1) / np.sqrt(40), rtol=1e-12)


def test_of_a_function_it_is_propagation_of_errors():
    """x/y of two means with correlated errors, small against them."""
    rng = np.random.default_rng(2)
    x = rng.normal(2, 0.01, 400)
    y = x / 2 + rng.normal(3, 0.01, 400)
    value, error = jackknife(np.column_stack([x, y]), lambda mean: mean[0] / mean[1])
    slope = np.array([1 / y.mean(), -x.mean() / y.mean() ** 2])
    assert value == pytest.approx(x.mean() / y.mean(), rel=1e-14)
    assert error == pytest.approx(np.sqrt(slope @ np.cov(x, y) @ slope / 400), rel=1e-3)


@pytest.mark.parametrize(("k", "n", "expected"), [(100, 40, 40), (100, 8, 32), (100, 1, 32), (3, 2, 6)])
def test_a_block_for_every_run_or_for_as_many_parts_as_it_takes(k, n, expected):
    series = np.random.default_rng(3).normal(size=(k, 2, n))
    means = blocks(series)
    assert means.shape == (expected, 2)
    parts = expected // n
    length = k // parts
    np.testing.assert_allclose(means[0], series[k - parts * length :, :, 0][:length].mean(axis=0))
    np.testing.assert_allclose(means[-1], series[-length:, :, -1].mean(axis=0))


@pytest.mark.parametrize("n", [1, 8, 64])
def test_error_bars_of_a_correlated_series_are_as_large_as_the_errors(n):
    """x_{k+1} = 0.9 x_k + noise remembers ten steps; without blocks the bar would be 4.4 times too short."""
    rng, phi, k, repeats = np.random.default_rng(4), 0.9, 64_000 // n, 60
    noise = rng.normal(size=(k + 200, repeats * n))
    x = np.zeros_like(noise)
    for j in range(1, len(x)):
        x[j] = phi * x[j - 1] + noise[j]
    found = [jackknife(blocks(part)) for part in np.split(x[200:, None], repeats, axis=2)]
    z = np.array([value[0] / error[0] for value, error in found])
    assert np.sqrt((z**2).mean()) == pytest.approx(1, abs=0.3)  # 60 values: 0.09, and the bars their own 13 %


def test_one_block_has_no_error():
    value, error = jackknife(np.array([[2.0]]))
    assert value == 2
    assert np.isnan(error)
