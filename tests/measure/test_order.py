"""Orders of convergence extrapolated from errors whose order is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from contactbench.measure.order import fit_order

H = [0.8 / 2**k for k in range(9)]


@pytest.mark.parametrize("order", [1, 2, 4, 6, 8])
def test_order_of_a_clean_power_law(order):
    fit = fit_order(H, [3 * h**order for h in H])
    assert fit.order == pytest.approx(order, abs=1e-12)
    assert fit.uncertainty < 1e-11
    assert fit.last_slope == pytest.approx(order, abs=1e-12)
    assert math.isnan(fit.pairwise[0])  # nothing coarser to compare with
    np.testing.assert_allclose(fit.pairwise[1:], order)


def test_pre_asymptotic_points_and_the_round_off_plateau_are_left_out():
    errors = [h**4 * (1 + 30 * h**2) + 1e-10 for h in H]
    fit = fit_order(H, errors, floor=1e-9)
    assert abs(fit.order - 4) < fit.uncertainty < 0.2
    assert not fit.used[0]
    assert not fit.used[-1]
    assert fit.used.sum() == 4


@pytest.mark.parametrize("below", range(1, 7))
def test_no_order_rests_on_a_point_below_the_floor(below):
    """Of nine points; three above it are too few."""
    errors = np.array([h**4 * (1 + 0.3 * h**2) for h in H])
    floor = errors[-below]
    fit = fit_order(H, errors, floor)
    assert fit.used.sum() == (4 if below <= 5 else 0)
    assert not fit.used[errors <= floor].any()


def test_noise_has_no_order():
    rng = np.random.default_rng(0)
    found = [fit_order(H, rng.uniform(0.1, 1, len(H))).order for _ in range(50)]
    assert np.isnan(found).mean() > 0.9
    assert math.isnan(fit_order(H[:3], [h**2 for h in H[:3]]).order)  # three points are too few
    assert math.isnan(fit_order(H, [math.nan] * len(H)).order)


@pytest.mark.parametrize("power", [1, 2])
def test_the_uncertainty_covers_the_truth(power):
    """Random error constants of three powers, of either sign, and round-off: at most 3 % are missed,
    where a term happens to be cancelled by the next."""
    rng = np.random.default_rng(1)
    missed, total = 0, 0
    for _ in range(600):
        p, n = rng.integers(1, 9), rng.integers(5, 10)
        a = rng.normal(size=3) * rng.choice([0.3, 1.0, 3.0])
        h = np.array(H[:n])
        errors = h**p * np.abs(1 + sum(c * h ** (power * (i + 1)) for i, c in enumerate(a)))
        fit = fit_order(h, errors + 1e-14 * rng.random(n), 1e-12)
        if not math.isnan(fit.order):
            total += 1
            missed += abs(fit.order - p) > fit.uncertainty
    assert total > 480
    assert missed <= 0.03 * total


@pytest.mark.parametrize(
    ("ratio", "slopes", "uncertainty"),
    [
        (2, (3.0, 3.01, 3.031), 9e-3),
        (2, (3.0, 3.01, 3.031, 3.074), 3e-3),
        (1.2, (3.0, 3.002, 3.0042), 9e-3 / (1.2**2 - 1)),  # falling like h² the rest is more than the last
    ],
)
def test_the_uncertainty_is_three_times_the_spread_of_the_extrapolations_and_nine_unchecked(
    ratio, slopes, uncertainty
):
    """k = 1: the limits s₀ − (s₁ − s₀)/(r − 1) differ by 0.001; the third differs from the second by as much, a quarter
    of that at the finest step."""
    steps = 0.1 * ratio ** np.arange(len(slopes) + 1)
    errors = np.cumprod([1e-9, *(ratio**slope for slope in slopes)])
    fit = fit_order(steps, errors)
    assert fit.order == pytest.approx(2.99, abs=1e-12)
    assert fit.uncertainty == pytest.approx(uncertainty, rel=1e-6)
