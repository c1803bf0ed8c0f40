"""Cost at equal error: what takes part, what an error costs, who is near the least and who leads alone."""

import math

import numpy as np
import pandas as pd
import pytest

from contactbench.measure.law import is_kept
from contactbench.measure.statistics import WIDEST
from contactbench.questions import contest
from contactbench.questions.contest import TARGETS, contests, costs, ranked
from contactbench.questions.judgement import at_cost, law_rows, met_cost
from frames import row, table, timed


def ladder(method, factor=1.0, scene="s", finest=1e-13, halves=1.0, process=None, **more):
    """A ladder whose cost is `factor` at an error of 1e-1, and rises by a quarter each decade; and its times."""
    runs, seconds = [], []
    for decade in range(1, round(-math.log10(finest)) + 1):
        error, cost = 10.0**-decade, factor * 1.25 ** (decade - 1)
        given = {"error": error, "saved": 1, "evaluations": cost * 100} | more
        runs.append(row(scene, method, error, **given))
        seconds.append(cost * 1e-3)
    return runs, timed(runs, seconds, halves=halves, process=process)


def tables(*ladders):
    runs, times = ([r for each in ladders for r in each[side]] for side in (0, 1))
    return table("runs", runs), table("times", times)


def found(*ladders, timed=True, **which):
    runs, times = tables(*ladders)
    return costs(runs, *[times] * timed, **which)


def won(*ladders, timed=True, **which):
    """Whether a contact method is near the least, and whether it is alone there, of all errors."""
    runs, times = tables(*ladders)
    rows = contests(runs, *[times] * timed, **which)
    near = rows["ratio"] <= WIDEST if timed else rows["ratio"] < 1
    (own,) = {*zip(near, rows["ratio"] * rows["margin"] < 1, strict=True)}
    return own


# -- what an error costs ---------------------------------------------------------------------------
def test_a_cost_is_interpolated_between_the_settings_and_bounded_by_the_coarsest():
    runs, times = ladder("rk4")
    between = found((runs[::4], times[::4])).set_index("error")
    assert between["cost"][1e-6] == pytest.approx(1.25**5 * 1e-3)
    bounded = found((runs[4:], times[4:])).set_index("error")
    assert bounded["bound"].tolist() == [True, False, False, False]
    assert bounded["cost"][1e-3] == pytest.approx(1.25**4 * 1e-3)


@pytest.mark.parametrize("status", ["budget", "timeout"])
def test_a_cost_that_is_not_reached_says_whether_our_own_limit_ended_a_finer_run(status):
    runs, times = ladder("rk4", finest=1e-7)
    finer, coarser = (row("s", "rk4", value, status=status, saved=1) for value in (1e-9, 0.5))
    assert found((runs, times))["reason"].tolist() == [""] * 4
    assert found(([*runs, finer], times))["reason"].tolist() == ["", "", status, status]
    assert found(([*runs, coarser], times))["reason"].tolist() == [""] * 4


@pytest.mark.parametrize("engine", ["llvm", *contest.BY_ADDRESS])
def test_neither_a_run_s_fixed_cost_nor_calls_by_address_are_part_of_a_credited_time(engine):
    counts, each = np.array([100, 1000, 10_000]), 1e-8
    runs = [row("s", "rk4", 1 / n, evaluations=n, saved=1, engine=engine) for n in counts.tolist()]
    times = timed(runs, (1e-6 + each * counts).tolist())
    found = contest.credited(table("times", times), table("runs", runs))["least_s"]
    called = contest.CALL if engine in contest.BY_ADDRESS else 0.0
    assert found.tolist() == pytest.approx(((each - called) * counts).tolist())


# -- what takes part -------------------------------------------------------------------------------
def test_compiled_meets_compiled_and_callbacks_meet_callbacks():
    own, called_back = ladder("contact-a"), ladder("scipy-dop853", 0.1, engine="python")
    assert not len(contests(*tables(own, called_back)))  # nobody to compare with
    assert not len(contests(*tables(own, called_back), callbacks=True))
    assert won(own, called_back, timed=False) == (False, False)
    assert won(ladder("contact-a", engine="python"), called_back, callbacks=True) == (False, False)


@pytest.mark.parametrize("engine", ["c", "c++", "jax"])
def test_a_compiled_row_takes_part_whoever_it_is(engine):
    assert won(ladder("contact-a"), ladder("scipy-dop853", 0.5, engine=engine)) == (False, False)


def test_a_solver_that_does_not_count_takes_no_part_in_a_contest_in_evaluations():
    ladders = ladder("rk4"), ladder("diffrax-kvaerno5", evaluations=None)
    assert set(found(*ladders, timed=False)["method"]) == {"rk4"}
    assert set(found(*ladders)["method"]) == {"rk4", "diffrax-kvaerno5"}


def test_runs_saved_at_other_times_take_no_part():
    ladders = ladder("contact-a"), ladder("rk4", 0.1, saved=25)
    assert set(found(*ladders)["method"]) == {"contact-a"}
    assert set(found(*ladders, timed=False, saved=25)["method"]) == {"rk4"}


def test_settings_of_an_oracle_and_those_of_a_tolerance_are_never_mixed():
    """Contact methods by their pilots, adaptive ones as they are; neither steps nor pilots in the other's contest."""
    pilots, steps = ladder("contact-a", 3.0, control="rtol"), ladder("contact-a")
    others = ladder("rk4", 0.1), ladder("cyrk-dop853", 2.0, control="rtol")
    by_tolerance = found(pilots, steps, *others, tolerance=True)
    assert set(by_tolerance["method"]) == {"contact-a", "cyrk-dop853"}
    ratios = contests(*tables(pilots, steps, *others), tolerance=True)["ratio"]
    assert ratios.tolist() == pytest.approx([1.5] * len(TARGETS))
    oracle = found(pilots, steps, *others)
    assert oracle[oracle["method"] == "contact-a"]["cost"].tolist() == found(steps)["cost"].tolist()


# -- who is near the least, and who leads ----------------------------------------------------------
@pytest.mark.parametrize(
    ("factor", "near", "alone"),
    [(1.3, True, True), (1.2, True, False), (0.82, True, False), (0.7, False, False)],
)
def test_a_verdict_on_time_names_all_within_a_quarter_of_the_least(factor, near, alone):
    ladders = ladder("contact-a"), ladder("rk4", factor)
    assert won(*ladders) == (near, alone)
    standing = ranked(*tables(*ladders))
    assert (standing["verdict"] == "tie").all() == (0.8 <= factor <= 1.25)
    assert set(standing[standing["ratio"] == 1.0]["verdict"]) == {"win" if factor in (1.3, 0.7) else "tie"}


@pytest.mark.parametrize(("factor", "alone"), [(1.01, True), (0.99, False)])
def test_evaluations_have_their_exact_order(factor, alone):
    assert won(ladder("contact-a"), ladder("rk4", factor), timed=False) == (alone, alone)


def test_a_method_is_of_the_family_that_it_declares():
    rows = ladder("contact-a", 2.0)
    assert won(rows, ladder("mine")) == (False, False)
    assert won(rows, ladder("mine", family="contact"), ladder("rk4", 3.0)) == (True, True)


def test_who_alone_reaches_an_error_is_alone():
    runs = contests(*tables(ladder("contact-a"), ladder("rk4", 0.5, finest=1e-7)))
    assert runs.set_index("error")["ratio"].to_dict() == pytest.approx({1e-3: 2, 1e-6: 2, 1e-9: 0, 1e-12: 0})


def test_a_margin_is_of_its_pair_and_of_two_processes():
    def margins(*ladders):
        return set(contests(*tables(*ladders))["margin"].round(6))

    assert margins(ladder("contact-a"), ladder("rk4")) == {WIDEST}
    noisy = [ladder(method, halves=1 / 1.2) for method in ("contact-a", "rk4")]
    assert margins(*noisy) == {round(math.exp(math.hypot(math.log(1.04), 2**0.5 * math.log(1.2))), 6)}
    assert margins(ladder("contact-a", process=1.4), ladder("rk4")) == {1.4}
    assert set(contests(tables(*noisy)[0])["margin"]) == {1.0}


def test_a_pair_takes_the_spread_of_its_noisier_engine():
    own, other = ladder("contact-a", process=1.01), ladder("rk4", process=1.3, engine="c")
    assert len(own[0]) >= contest.ENOUGH
    assert contests(*tables(own, other))["margin"].tolist() == pytest.approx([1.3] * len(TARGETS))


@pytest.mark.parametrize("halves", [2.0, math.nan])
def test_a_cell_too_noisy_to_judge_is_undecided_and_still_beats_what_is_far_off(halves):
    ladders = ladder("contact-a", halves=halves), ladder("rk4", 1.1), ladder("cvode-bdf", 100.0)
    verdicts = ranked(*tables(*ladders)).groupby("method")["verdict"].first()
    assert verdicts["rk4"] == "undecided"
    assert verdicts["cvode-bdf"] == ("loss" if halves == 2.0 else "undecided")


def test_who_was_cut_off_may_be_the_fastest():
    known = found(ladder("rk4"), ladder("rk8", 2.0)).assign(at_least=math.nan)
    assert set(contest.standings(known)["verdict"]) == {"win", "loss"}
    known.loc[known["method"] == "rk8", "at_least"] = 1e-9
    assert set(contest.standings(known)["verdict"]) == {"undecided", "loss"}


# -- other tables ----------------------------------------------------------------------------------
def test_random_contests_leave_out_hard_problems_and_those_that_nobody_solves():
    problems = table(
        "problems", [{"seed": 1, "scene": f"a-{i}", "hard": "wall" * (i == 2)} for i in range(3)]
    )
    costs = {("a-0", "contact-a"): 1.1, ("a-0", "rk4"): 1.0, ("a-2", "contact-a"): 1.0, ("a-2", "rk4"): 2.0}
    rows = [
        {"seed": 1, "scene": scene, "method": method, "error": 1e-6, "status": "ok", "time_s": cost}
        for (scene, method), cost in costs.items()
    ]
    rows += [
        {"seed": 1, "scene": "a-1", "method": m, "error": 1e-6, "status": "budget"}
        for m in ("contact-a", "rk4")
    ]
    runs = table("runs", [row("s", name, 0.1) for name in ("contact-a", "rk4")])
    (only,) = contest.random_contests(table("population", rows), problems, runs, "time_s").itertuples()
    assert (only.scene, only.ours, only.other, only.ratio) == ("a-0", "contact-a", "rk4", pytest.approx(1.1))


def test_a_hard_scene_that_was_not_run_is_no_ending():
    ended = ({"status": "budget", "end_time": 1.0}, {"status": "budget"}, {"status": "unsupported"}, {})
    rows = [row("large_step", "rk4", 10.0**-k, **each) for k, each in enumerate(ended)]
    found = contest.hard_runs(table("runs", [*rows, row("particle", "rk4", 0.1)]))
    assert found["status"].tolist() == ["budget", "ok"]


# -- which runs keep a law, as the columns of the tables say ---------------------------------------
def run(value=1e-15, method="contact-a", bound=1e-12, **more):
    kept = {"contact_drift_claimed": method.startswith("contact"), "contact_drift_kept": value <= 1e-12}
    return row("central", method, 0.1, contact_drift=value, error=1e-3, bound=bound, **kept | more)


def test_a_run_that_claims_a_law_and_breaks_it_is_broken():
    rows = law_rows(
        table("runs", [run(), run(1e-3), run(1e-3, "rk4"), run(status="diverged")]), "contact_drift"
    )
    assert rows["broken"].tolist() == [False, True, True]
    assert rows["claimed"].tolist() == [True, True, False]


def test_an_undecided_run_is_neither_kept_nor_broken_and_one_without_a_bound_is_not_judged():
    blank = run(contact_drift_kept=None)
    rows = law_rows(table("runs", [blank, blank | {"bound": None}]), "contact_drift")
    assert (rows["judged"].tolist(), rows["undecided"].tolist()) == ([True, False], [True, False])
    assert not (rows["broken"] | rows["kept"]).any()


@pytest.mark.parametrize(
    ("value", "limit", "kept"),
    [(1e-7, 1e-6, True), (1e-7, 2e-6, None), (1e-12, 1.0, True), (2.0, 1.0, False)],
)
def test_a_bound_above_a_millionth_decides_nothing(value, limit, kept):
    assert is_kept(value, limit) is kept


# -- equal cost ------------------------------------------------------------------------------------
def second_order(method, spent):
    """Runs whose error and energy law fall as the square of the cost."""
    return [row("s", method, 1 / n, evaluations=n, error=n**-2.0, energy_law=1e-3 * n**-2.0) for n in spent]


def test_the_cost_that_most_methods_meet_is_the_smallest_of_several():
    rows = [*second_order("a", (100, 900)), *second_order("b", (150, 4000)), *second_order("c", (200, 800))]
    assert met_cost(table("runs", rows)) == 200


def test_a_deviation_at_a_cost_is_between_the_runs_beside_it_or_at_their_end():
    runs = table("runs", second_order("a", (100, 400)))
    between, beyond = (at_cost(runs, cost, ["error", "energy_law"]) for cost in (200.0, 1e6))
    assert between.to_dict() == pytest.approx(
        {"evaluations": 200, "error": 200.0**-2, "energy_law": 1e-3 * 200.0**-2}
    )
    assert beyond["evaluations"] == 400
    assert at_cost(runs.assign(status="failed"), 200.0, ["error"]) is None


def test_a_law_is_kept_at_a_cost_where_both_runs_beside_it_keep_it():
    rows = pd.DataFrame([run(evaluations=100.0), run(1e-3, evaluations=200.0), run(1e-3, evaluations=400.0)])
    rows = table("runs", rows.to_dict("records"))
    assert at_cost(rows, 100.0, ["contact_drift"])["contact_drift_kept"]
    assert not at_cost(rows, 150.0, ["contact_drift"])["contact_drift_kept"]
