"""The regression gate on tables made up for it: what turns it red, what does not, and what it says."""

from __future__ import annotations

import json
import math

import pytest

import contactbench as cb
from contactbench.gate.accuracy import accuracy
from contactbench.gate.rules import DECADES
from contactbench.results.schema import TABLES, Rule
from contactbench.results.store import merge
from contactbench.results.tables import (
    CLAIMS_TABLE,
    CONVERGENCE,
    ENSEMBLE_TABLE,
    LAWS_TABLE,
    LAWS_TIME,
    PAPER_FIGURES,
    STABILITY,
    STABILITY_LIMITS,
    WORK_PRECISION,
)
from made_up import RUN, folder, row, setting


@pytest.fixture
def baseline(tmp_path):
    return folder(tmp_path / "baseline")


def judged(baseline, change, tmp_path, **more):
    return accuracy(baseline, folder(tmp_path / "fresh", change, **more))


def test_identical_tables_are_green(baseline, tmp_path):
    verdict = judged(baseline, lambda which, row: row, tmp_path)
    assert not verdict.red
    assert verdict.lines == ()
    assert "Nothing moved" in verdict.as_markdown()
    assert "10 rows of a smoke run" not in verdict.as_markdown()  # the standard row was not asked for
    assert "9 rows of a smoke run" in verdict.as_markdown()


FAULTS = {
    "error": (setting(LAWS_TABLE, "rk4", solution_error=2.2e-5), "rk4", "solution_error"),
    "error gone down": (setting(LAWS_TABLE, "rk4", solution_error=4e-6), "rk4", "solution_error"),
    "error of an adaptive solver": (
        setting(WORK_PRECISION, "cvode-adams", solution_error=5e-5), "cvode-adams", "solution_error",
    ),
    "error at fifty digits": (setting(CONVERGENCE, "contact-o8", solution_error=1e-19), "contact-o8", "solution_error"),
    "error not a number": (setting(LAWS_TABLE, "rk4", solution_error=math.nan), "rk4", "solution_error"),
    "error infinite": (setting(LAWS_TABLE, "rk4", solution_error=math.inf), "rk4", "solution_error"),
    "round-off lost": (setting(LAWS_TABLE, "rk4", momentum_law=3e-12), "rk4", "momentum_law"),
    "slope": (
        lambda t, r: {**r, "pairwise_order": 3.8} if t is CONVERGENCE and r["in_fit"] and r["method"] == "rk4" else r,
        "rk4", "pairwise_order",
    ),
    "one gradient more": (setting(WORK_PRECISION, "rk4", evaluations=801), "rk4", "evaluations"),
    "a fifth more steps": (setting(WORK_PRECISION, "cvode-adams", steps=241), "cvode-adams", "steps"),
    "status": (setting(WORK_PRECISION, "rk4", status="diverged", solution_error=math.nan), "rk4", "status"),
    "a refusal that ends well": (setting(WORK_PRECISION, "cvode-bdf", status="ok"), "cvode-bdf", "status"),
    "order claimed": (setting(CONVERGENCE, "contact-o8", order_nominal=6), "contact-o8", "order_nominal"),
    "family": (setting(LAWS_TABLE, "rk4", family="contact"), "rk4", "family"),
    "verdict of a claim": (setting(CLAIMS_TABLE, "any", verdict="refuted"), "any", "verdict"),
    "dropped method": (
        lambda t, r: None if r["method"] == "contact-o8" else r, "contact-o8", "method in convergence",
    ),
    "dropped setting": (
        lambda t, r: None if t is CONVERGENCE and r["setting"] == "step=0.8" else r, "rk4", "row of convergence",
    ),
    "dropped table": (lambda t, r: None if t is LAWS_TABLE else r, "", "table laws"),
    "what a claim measured": (setting(CLAIMS_TABLE, "any", measured=3e-12), "any", "measured"),
    "the bound of a claim": (setting(CLAIMS_TABLE, "any", bound=1e-11), "any", "bound"),
    "a fitted order": (
        lambda t, r: {**r, "order": 3.9} if t is CONVERGENCE and not r["in_fit"] else r, "rk4", "order",
    ),
    "an adaptive solver's count": (
        setting(WORK_PRECISION, "cvode-adams", evaluations=728), "cvode-adams", "evaluations",
    ),
    "what is carried": (setting(WORK_PRECISION, "rk4", carried="q p s"), "rk4", "carried"),
    "a row of a larger profile only": (setting(LAWS_TABLE, "rk4", profile="full"), "rk4", "profile"),
    "a row of no profile": (setting(LAWS_TABLE, "rk4", profile=""), "rk4", "profile"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.quick(
    fault=("error", "error infinite", "slope", "family", "dropped method", "the bound of a claim")
)
def test_every_kind_of_regression_is_red_and_named(fault, baseline, tmp_path):
    change, method, measure = FAULTS[fault]
    verdict = judged(baseline, change, tmp_path)
    assert verdict.red
    red = [line for line in verdict.lines if line.red]
    assert (method, measure) in {(line.method, line.measure) for line in red}
    assert {line.scene for line in red} <= {"particle", ""}
    assert any(measure in line and method in line for line in verdict.as_markdown().splitlines())
    assert json.loads(verdict.as_json())["red"]


ALLOWED = {
    "error within a factor of two": setting(LAWS_TABLE, "rk4", solution_error=1.9e-5),
    "round-off that stays so": setting(LAWS_TABLE, "rk4", momentum_law=9e-13),
    "slope outside the asymptotic range": lambda t, r: (
        {**r, "pairwise_order": 0.5} if t is CONVERGENCE and not r["in_fit"] else r
    ),
    "time": setting(WORK_PRECISION, "rk4", time_median_s=1.0),
    "message": setting(WORK_PRECISION, "cvode-bdf", message="other words"),
    "what a claim measured, far below its bound": setting(CLAIMS_TABLE, "any", measured=9e-16),
    "a row of a smaller profile": lambda t, r: {**r, "profile": "smoke"},
}


@pytest.mark.parametrize("change", ALLOWED.values(), ids=ALLOWED)
def test_what_may_move_is_green(change, baseline, tmp_path):
    assert not judged(baseline, change, tmp_path).red


def test_errors_at_round_off_may_move(tmp_path):
    before = folder(tmp_path / "b", setting(LAWS_TABLE, "rk4", solution_error=2e-16))
    assert not judged(before, setting(LAWS_TABLE, "rk4", solution_error=2e-14), tmp_path).red
    assert judged(before, setting(LAWS_TABLE, "rk4", solution_error=1e-13), tmp_path / "again").red


def test_an_ill_conditioned_motion_has_a_higher_floor_and_a_limit_may_move_by_a_hundredth(tmp_path):
    limit = {"method": "rk4", "gamma": 1.0, "omega": 1.0, "profile": "smoke"}

    def made(name, error, largest):
        path = folder(tmp_path / name)
        merge(STABILITY, [row(end_error=error, condition_number=1e6)], path)
        merge(STABILITY_LIMITS, [{**limit, "limit": largest}], path)
        return path

    before = made("before", 1e-9, 2.0)
    assert not accuracy(before, made("close", 2e-8, 2.01)).red
    assert not accuracy(made("never", 1e-9, math.inf), made("still", 1e-9, math.inf)).red
    lines = accuracy(before, made("far", 1e-7, 2.03)).lines
    assert {(line.table, line.measure) for line in lines if line.red} == {
        ("stability", "end_error"),
        ("stability_limits", "limit"),
    }


def test_of_a_larger_run_the_larger_profiles_rows_are_expected(baseline, tmp_path):
    small = judged(baseline, lambda t, r: r, tmp_path, keep=lambda row: row["profile"] == "smoke")
    assert not small.red
    standard = {**RUN, "profile": "standard"}
    large = judged(
        baseline, lambda t, r: r, tmp_path / "again", keep=lambda row: row["profile"] == "smoke", run=standard
    )
    assert [(line.measure, line.setting) for line in large.lines] == [("row of work_precision", "step=0.01")]


def test_the_worst_row_stands_for_a_measure(baseline, tmp_path):
    verdict = judged(
        baseline,
        lambda t, r: {**r, "solution_error": r["solution_error"] * (30 if r["in_fit"] else 3)}
        if t is CONVERGENCE and r["method"] == "rk4" else r,
        tmp_path,
    )  # fmt: skip
    (line,) = (line for line in verdict.lines if line.measure == "solution_error")
    assert (line.setting, line.change, line.rows) == ("step=0.1", "×30", 2)


def test_counts_of_a_solver_that_chooses_its_steps_are_exact_on_one_machine_and_within_a_tenth_on_two(
    baseline, tmp_path
):
    """One step more is red where nothing but the code can have changed it."""
    one, tenth, more = (setting(WORK_PRECISION, "cvode-adams", steps=n) for n in (201, 219, 221))
    other = {**RUN, "isa": "y"}
    assert judged(baseline, one, tmp_path / "one").red
    assert not judged(baseline, tenth, tmp_path / "other", run=other).red
    assert judged(baseline, more, tmp_path / "more", run=other).red
    fixed = setting(WORK_PRECISION, "rk4", steps=201)
    assert judged(baseline, fixed, tmp_path / "fixed", run=other).red
    unknown = {name: value for name, value in RUN.items() if name != "isa"}  # nobody knows its processor
    assert not judged(baseline, tenth, tmp_path / "unknown", run=unknown).red


@pytest.mark.parametrize(("spread", "red"), [(0.0, True), (0.04, True), (0.6, False)])
def test_counts_may_move_by_what_roundings_were_measured_to_do_to_them(spread, red, tmp_path):
    change = setting(WORK_PRECISION, "cvode-adams", evaluations_spread=spread)
    before = folder(tmp_path / "before", change)
    now = setting(WORK_PRECISION, "cvode-adams", evaluations_spread=spread, evaluations=1200)
    assert accuracy(before, folder(tmp_path / "now", now, run={**RUN, "isa": "y"})).red is red
    assert accuracy(before, folder(tmp_path / "here", now)).red  # where there are no other roundings


def test_new_rows_and_other_machines_are_noted_not_judged(baseline, tmp_path):
    fresh = folder(tmp_path / "fresh", run={**RUN, "cpu": "b"})
    merge(LAWS_TABLE, [row("mine", solution_error=1.0)], fresh)
    verdict = accuracy(baseline, fresh)
    assert not verdict.red
    assert {"1 rows have no baseline yet", "processor: baseline a x, fresh b x"} <= set(verdict.notes)


def test_what_a_run_does_not_visit_is_said(tmp_path):
    before = folder(tmp_path / "before", keep=lambda row: row["profile"] == "smoke")
    merge(LAWS_TABLE, [row(profile="standard", setting="step=0.2", map_growth=1.0)], before)
    (note,) = (note for note in judged(before, lambda t, r: r, tmp_path).notes if "not seen" in note)
    assert "laws.map_growth" in note
    assert "laws.solution_error" not in note


def figure(**more):
    return {"figure": "f", "panel": "p", "curve": "c", "kind": "method", "profile": "smoke", **more}


def claim(**more):
    return {"id": "C02", "status": "ok", "profile": "smoke", **more}


#: rows of other tables, what moves in them, and how far it may and may not
MOVES = {
    "a point of a figure": (
        PAPER_FIGURES, [figure(point=0, x=0.0, y=1.0), figure(point=1, x=1.0, y=1e-9)], "y", 1.005, 1.02,
    ),
    "round-off on a figure": (PAPER_FIGURES, [figure(point=0, x=0.0, y=2e-16)], "y", 3e-13, 2e-12),
    "energy along time": (LAWS_TIME, [row(t=1.0, energy=0.5)], "energy", 0.504, 0.51),
    "the time of the blow-up": (STABILITY, [row(status="diverged", blow_up_time=2.0)], "blow_up_time", 2.01, 2.03),
    "how far a run got": (STABILITY, [row(status="diverged", end_time=2.0)], "end_time", 2.1, 2.3),
    "how far a run got that ended well": (STABILITY, [row(end_time=2.0)], "end_time", 2.0, 2.001),
    "members of an ensemble": (
        ENSEMBLE_TABLE, [row(question="error", trajectories=8, cores=1, member_deviation=1e-15)],
        "member_deviation", 5e-13, 3e-12,
    ),
    "what a lower bound measures": (
        CLAIMS_TABLE, [claim(relation="≥", bound=1.9, measured=2.0)],
        "measured", 2.01, 2.03,
    ),
    "what an upper bound measures": (
        CLAIMS_TABLE, [claim(relation="≤", bound=0.01, measured=2e-3)],
        "measured", 3.8e-3, 5e-3,
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", MOVES)
@pytest.mark.quick(what=("a point of a figure", "the time of the blow-up", "members of an ensemble"))
def test_what_was_not_compared_once_moves_within_its_limits_only(what, tmp_path):
    table, rows, name, little, much = MOVES[what]

    def made(folder_name, value=None):
        path = folder(tmp_path / folder_name)
        first = {**rows[0], name: value} if value is not None else rows[0]
        known = [{k: v for k, v in one.items() if k in table.every_column} for one in (first, *rows[1:])]
        merge(table, known, path)
        return path

    before = made("before")
    assert not accuracy(before, made("little", little)).red
    assert [line.measure for line in accuracy(before, made("much", much)).lines if line.red] == [name]


def test_a_column_that_the_baseline_lacks_is_not_judged_and_one_that_is_lost_is(tmp_path):
    """A law that is new, in a table from before it."""
    new = setting(LAWS_TABLE, "rk4", momentum_balance=1e-3)
    assert not judged(folder(tmp_path / "before"), new, tmp_path).red
    had = folder(tmp_path / "had", new)
    lines = accuracy(had, folder(tmp_path / "lost")).lines
    assert {(line.method, line.measure) for line in lines if line.red} == {("rk4", "momentum_balance")}


@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
def test_every_column_has_a_rule_or_says_why_none(table):
    for name, column in table.every_column.items():
        if name in table.key or column.timed:
            continue  # found again by its key; judged as pairs of times, by the speed part
        assert (column.rule is None) == bool(column.ungated), name
    assert not {name for name, column in table.columns.items() if column.timed and column.rule}
    assert {name for name in table.columns if name.endswith("_s")} <= set(table.timed)


def test_the_rules_are_those_of_the_laws():
    assert LAWS_TABLE.rules["momentum_law"] is Rule.structure
    assert LAWS_TABLE.rules["solution_error"] is Rule.error
    assert {name: LAWS_TABLE.rules[name] for name in cb.LAWS} == {
        name: Rule[law.gate.value] for name, law in cb.LAWS.items()
    }
    assert pytest.approx(2, abs=0.01) == 10**DECADES
