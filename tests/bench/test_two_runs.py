"""Two runs of the benchmark are compared verdict by verdict."""

from __future__ import annotations

import pytest

from contactbench.results.store import merge
from contactbench.results.tables import WORK_PRECISION
from frames import row
from two_runs import main


def folder(path, ours, theirs, halves=1.0):
    """Work–precision of two methods at two errors."""

    def made(method, error, time):
        clock = {"time_min_s": time / error, "time_halves_ratio": halves}
        costs = {"solution_error": error, "rhs_equivalents": 1 / error}
        return row("particle", method, error, profile="smoke", **costs, **clock)

    timed = [("contact-a", ours), ("rk4", theirs)]
    merge(WORK_PRECISION, [made(m, error, time) for m, time in timed for error in (1e-2, 1e-13)], path)
    return path


@pytest.mark.parametrize(
    ("theirs", "halves", "turned", "inside"),
    [(1.3, 1.0, 0, "100.0%"), (1.2, 1.1, 0, "100.0%"), (0.9, 1.5, 0, "100.0%"), (0.7, 1.0, 4, "50.0%")],
)
def test_only_a_verdict_that_both_decide_can_turn_round(theirs, halves, turned, inside, tmp_path, capsys):
    quiet = folder(tmp_path / "quiet", 1.0, 1.3)
    loaded = folder(tmp_path / "loaded", 1.0, theirs, halves)
    assert main([quiet, loaded]) == (turned > 0)
    printed = capsys.readouterr().out
    assert f"winners that turned round: {turned}" in printed
    assert f"Time, compiled: {inside} of 4 cells" in printed
