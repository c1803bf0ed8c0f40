"""Equal-error costs and paired ratios on data whose answer is known."""

import math

import numpy as np
import pytest

from contactbench.errors import BadInput
from contactbench.measure import statistics
from contactbench.measure.statistics import Verdict, margin, verdict


def test_a_setting_that_costs_more_for_less_does_not_count():
    cost = statistics.costs_to_reach([1e-2, 1e-3, 1e-4], [1.0, 500.0, 10.0], [1e-3])
    assert cost == pytest.approx([10**0.5])
    # an accurate setting that is cheaper than all others
    assert statistics.costs_to_reach([1e-2, 1e-4], [500.0, 10.0], [1e-3]) == pytest.approx([10.0])


@pytest.mark.parametrize("true", [0.5, 1.0, 1.3, 2.0])
def test_a_ratio_is_found_in_noise_and_drift(true):
    """Pairs that share a drift and have heavy-tailed noise of their own."""
    rng = np.random.default_rng(1)
    inside = 0
    for _ in range(200):
        drift = np.exp(np.cumsum(rng.normal(0, 0.3, 15)))
        base, head = (drift * factor * np.exp(0.03 * rng.standard_t(3, 15)) for factor in (1.0, true))
        found = statistics.paired_ratio(base, head)
        assert found.low <= found.ratio <= found.high
        assert found.ratio == pytest.approx(true, rel=0.15)
        inside += found.low <= true <= found.high
    assert inside >= 0.9 * 200  # a percentile interval of a median of 15 covers about 95 %


# -- margins ---------------------------------------------------------------------------------------
def test_a_margin_is_of_both_cells_and_of_processes_and_has_a_floor():
    assert margin((1.0, 1.0), 1.0) == margin((1.1, 1.0), 1.1) == statistics.WIDEST == 1.25
    assert margin((1.3, 1.0), 1.0) == margin((1.0, 1 / 1.3), 1.0) == pytest.approx(1.3)
    assert margin((1.0, 1.0), 1.3) == pytest.approx(1.3)
    together = np.exp(np.linalg.norm(np.log([1.2, 1.2, 1.1])))
    assert margin((1.2, 1 / 1.2), 1.1) == pytest.approx(together)
    assert margin((1.0, math.nan), 1.0) == math.inf  # of a cell that was visited once nothing is known


@pytest.mark.parametrize(
    ("ratio", "within", "expected"),
    [
        (1.06, 1.05, Verdict.loss),
        (1 / 1.06, 1.05, Verdict.win),
        (1.04, 1.05, Verdict.tie),
        (1 / 1.04, 1.05, Verdict.tie),
        (1.04, 2 * statistics.WIDEST, Verdict.undecided),
        (46.0, 56.0, Verdict.undecided),
        (60.0, 56.0, Verdict.loss),
        (1e9, math.inf, Verdict.undecided),
    ],
)
def test_a_verdict_is_a_tie_only_where_the_clock_can_tell(ratio, within, expected):
    assert verdict(ratio, within) is expected


@pytest.mark.parametrize("ratio", [0.0, -1.0, math.nan])
def test_what_is_no_ratio_of_costs_is_refused(ratio):
    with pytest.raises(BadInput, match="must be a ratio of two costs"):
        verdict(ratio, 1.05)


@pytest.mark.parametrize(
    ("processes", "halves", "spread"),
    [
        ([1.0] * 94 + [1 / 1.05] * 2 + [3.0] * 4, [1.0] * 100, 1.05),  # what covers 95 of 100 cells
        ([math.nan, 1 / 1.5], [1.0, math.nan], 1.5),
        ([math.nan], [1.0], statistics.PROCESSES),
        ([1.02, 1.5, 1.4], [1.0, 1.3, 1 / 1.3], 1.02),  # noisy cells say nothing of processes
        ([1.2, 1.5], [1.1, 1.3], 1.5),  # where there are others
    ],
)
def test_processes_differ_by_what_covers_most_of_the_quiet_cells(processes, halves, spread):
    assert statistics.process_spread(processes, halves) == pytest.approx(spread)
