"""Which runs keep a law, as the columns of the tables say."""

from __future__ import annotations

import pytest

from contactbench.measure.law import judge
from contactbench.results.judgement import bound, law_rows
from frames import frames, row, table


def run(value=1e-15, method="contact-a", scene="central", limit=1e-12, undecided=False, **more):
    """A run with a judged contact drift."""
    claimed, kept = method.startswith("contact"), value <= limit
    columns = {"claimed": claimed, "kept": kept, "undecided": undecided, "bound": limit}
    judgement = {f"contact_drift_{name}": column for name, column in columns.items()}
    return row(scene, method, 0.1, contact_drift=value, solution_error=1e-3, **judgement, **more)


@pytest.mark.parametrize("where", ["laws", "stability"])
def test_a_run_that_claims_a_law_and_breaks_it_is_broken(where):
    rows = law_rows(frames(**{where: [run(), run(1e-3), run(1e-3, "rk4")]}), "contact_drift")
    assert rows["broken"].tolist() == [False, True, True]
    assert rows["claimed"].tolist() == [True, True, False]


def test_an_undecided_run_is_neither_kept_nor_broken_and_one_without_a_bound_is_not_judged():
    blank = dict.fromkeys(("contact_drift_kept", "contact_drift_undecided", "contact_drift_bound"))
    told = run(undecided=True) | {"contact_drift_kept": None}
    rows = law_rows(frames(laws=[told, run() | blank]), "contact_drift")
    assert rows["judged"].tolist() == [True, False]
    assert not rows["broken"].any()
    assert not rows["kept"].any()


def test_runs_that_failed_and_plain_loops_have_no_row():
    rows = [run(), run(status="diverged"), run(method="limit-c")]
    assert len(law_rows(frames(laws=rows), "contact_drift")) == 1
    assert not len(law_rows(frames(), "contact_drift"))


def test_what_differences_do_not_resolve_is_unsure():
    rows = [run(3e-12) | {"contact_drift_uncertainty": bar} for bar in (2e-12, 1e-12)]
    assert law_rows(frames(laws=rows), "contact_drift")["unsure"].tolist() == [True, False]


def test_round_off_grows_with_the_map_and_where_that_is_unknown_with_the_motion():
    growths = [{"map_growth": 1e4}, {"map_growth": None, "condition_number": 1e5}, {}]
    rows = table("stability", [run(evaluations=1000, **more) for more in growths])
    expected = [1000 * 1e4 * 2.0**-52, 1000 * 1e5 * 2.0**-52, 1e-12]
    assert bound(rows, "contact_drift").tolist() == pytest.approx(expected)
    assert bound(rows, "momentum_law").tolist() == [1e-12] * 3  # a law of the state alone


@pytest.mark.parametrize(
    ("value", "limit", "judgement"),
    [
        (1e-7, 1e-6, (True, False)),
        (1e-7, 2e-6, (False, True)),
        (1e-12, 1.0, (True, False)),
        (2.0, 1.0, (False, False)),
    ],
)
def test_a_bound_above_a_millionth_decides_nothing(value, limit, judgement):
    assert judge(value, limit) == judgement
