"""Cost at equal error: what takes part, what an error costs, and who wins, ties or loses; and which runs keep a law."""

import math

import pytest

from contactbench.measure.law import is_kept
from contactbench.questions import contest
from contactbench.questions.contest import COMPILED, EVALUATIONS, TARGETS, contests, costs
from contactbench.questions.judgement import law_rows
from frames import frames, row, table


def ladder(method, factor=1.0, scene="s", engine="jax", finest=1e-13, **more):
    """A ladder whose cost is `factor` at an error of 1e-1, and rises by a quarter each decade."""
    rows = []
    for decade in range(1, round(-math.log10(finest)) + 1):
        error, cost = 10.0**-decade, factor * 1.25 ** (decade - 1)
        times = {"time_median_s": cost * 1e-3, "time_min_s": cost * 1e-3, "rhs_equivalents": cost * 100}
        rows.append(row(scene, method, error, engine=engine, solution_error=error, **times | more))
    return rows


def found(*ladders, kind=COMPILED):
    return costs(table("work_precision", [r for rows in ladders for r in rows]), kind)


def winners(*ladders, kind=COMPILED):
    return set(contests(found(*ladders, kind=kind))["winner"])


# -- what an error costs ---------------------------------------------------------------------------
def test_a_cost_is_interpolated_between_the_settings_and_bounded_by_the_coarsest():
    rows = [r for r in ladder("rk4") if r["solution_error"] < 1e-4]
    between = found(ladder("rk4")[::4]).set_index("error")
    assert between["cost"][1e-6] == pytest.approx(1.25**5 * 1e-3)
    bounded = found(rows).set_index("error")
    assert bounded["bound"].tolist() == [True, False, False, False]
    assert bounded["cost"][1e-3] == pytest.approx(1.25**4 * 1e-3)


@pytest.mark.parametrize("status", ["budget", "timeout"])
def test_a_cost_that_is_not_reached_says_whether_our_own_limit_ended_a_finer_run(status):
    coarse = ladder("rk4", finest=1e-7)
    finer, coarser = row("s", "rk4", 1e-9, status=status), row("s", "rk4", 0.5, status=status)
    assert found(coarse)["reason"].tolist() == [""] * 4
    assert found([*coarse, finer])["reason"].tolist() == ["", "", status, status]
    assert found([*coarse, coarser])["reason"].tolist() == [""] * 4


# -- what takes part -------------------------------------------------------------------------------
def test_what_this_package_runs_beside_the_libraries():
    theirs = [r | {"package": "CyRK"} for r in ladder("cyrk-vern8", 2.0, engine="c++")]
    rows = found(ladder("contact-a", 3.0), ladder("rk4"), theirs)
    assert set(contests(rows)["winner"]) == {"other"}
    won = contests(rows, contest.of_this_package)
    assert set(won["winner"]) == {"ours"}
    assert set(won["ours"]) == {"rk4"}
    assert set(won["other"]) == {"cyrk-vern8"}


def test_kinds_of_engine_are_never_mixed():
    own, called_back = ladder("contact-a"), ladder("scipy-dop853", 0.1, engine="python")
    assert not len(contests(found(own, called_back)))  # nobody to compare with
    assert not len(contests(found(own, called_back, kind=contest.CALLED_BACK)))
    assert winners(own, called_back, kind=EVALUATIONS) == {"other"}


@pytest.mark.parametrize("engine", ["c", "c++", "llvm"])
def test_a_compiled_row_takes_part_whoever_it_is(engine):
    assert winners(ladder("contact-a"), ladder("scipy-dop853", 0.5, engine=engine)) == {"other"}


def test_one_integrator_of_two_makers_is_one_contestant_where_engines_do_not_matter():
    shapes = ladder("scipy-dop853", 2.0, engine="python"), ladder("cyrk-dop853", 3.0, engine="c++")
    assert set(found(*shapes, kind=EVALUATIONS)["method"]) == {"dop853"}
    assert set(found(*shapes)["method"]) == {"cyrk-dop853"}
    assert set(found(*shapes, kind=contest.CALLED_BACK)["method"]) == {"scipy-dop853"}


def test_a_solver_that_does_not_count_takes_no_part_in_a_contest_in_evaluations():
    silent = [r | {"rhs_equivalents": None} for r in ladder("diffrax-kvaerno5")]
    assert set(found(ladder("rk4"), silent, kind=EVALUATIONS)["method"]) == {"rk4"}
    assert set(found(ladder("rk4"), silent)["method"]) == {"rk4", "diffrax-kvaerno5"}


def test_a_marginal_time_needs_halves_and_no_closed_form():
    timed = [r | {"marginal_s": 1e-6, "marginal_halves_ratio": 1.0} for r in ladder("rk4")]
    exact = [r | {"control": "exact"} for r in timed]
    assert set(found(timed, kind=contest.MARGINAL)["method"]) == {"rk4"}
    noise = [r | {"marginal_halves_ratio": ratio} for r, ratio in zip(timed, (2.0, 0.5) * 9, strict=False)]
    assert not len(found(exact, noise, ladder("contact-a"), kind=contest.MARGINAL))


def test_settings_of_an_oracle_and_those_of_a_tolerance_are_never_mixed():
    """Contact methods by their pilots, adaptive ones as they are; neither steps nor pilots in the other's contest."""
    pilots = [r | {"variant": "pilots", "control": "rtol"} for r in ladder("contact-a", 3.0)]
    steps = [r | {"control": "step"} for r in [*ladder("contact-a"), *ladder("rk4", 0.1)]]
    adaptive = [r | {"control": "rtol"} for r in ladder("cyrk-dop853", 2.0)]
    by_tolerance = found(pilots, steps, adaptive, kind=contest.BY_TOLERANCE[1])
    assert set(by_tolerance["method"]) == {"contact-a", "cyrk-dop853"}
    assert contests(by_tolerance)["ratio"].tolist() == [pytest.approx(2 / 3)] * len(TARGETS)
    oracle = found(pilots, steps, adaptive)
    assert oracle[oracle["method"] == "contact-a"]["cost"].tolist() == found(steps[:13])["cost"].tolist()
    assert {kind.by for kind in contest.BY_TOLERANCE} == {"tolerance"}


# -- who wins --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("factor", "winner"), [(1.1, "ours"), (1.03, "tie"), (1 / 1.03, "tie"), (1 / 1.1, "other")]
)
def test_win_tie_and_loss_of_the_contact_methods(factor, winner):
    rows = found(ladder("contact-a"), ladder("rk4", factor))
    won = contests(rows)
    assert won["winner"].tolist() == [winner] * len(TARGETS)
    assert won["ratio"].tolist() == pytest.approx([factor] * len(TARGETS))
    ranked = contest.standings(rows)
    assert (ranked["verdict"] == "tie").all() == (winner == "tie")
    assert set(ranked[ranked["ratio"] == 1.0]["verdict"]) == {"tie" if winner == "tie" else "win"}


def test_a_method_is_of_the_family_that_it_declares():
    rows = [*ladder("contact-a", 2.0), *ladder("mine")]
    assert winners(rows) == {"other"}
    assert winners([r | {"family": "contact"} for r in rows], ladder("rk4", 3.0)) == {"ours"}
    assert winners(ladder("contact-a", 2.0), ladder("herglotz1")) == {"other"}


def test_a_margin_is_of_its_pair_and_of_two_processes():
    quiet = [ladder("contact-a"), ladder("rk4", 1.1)]
    noisy = [ladder(m, scene="noisy", time_halves_ratio=1 / 1.08) for m in ("contact-a", "rk4")]
    won = contests(found(*quiet, *noisy)).groupby("scene")
    assert won["winner"].unique().map(list).to_dict() == {"s": ["ours"], "noisy": ["tie"]}
    margins = won["margin"].first()
    assert margins["s"] == pytest.approx(1.04)
    assert margins["noisy"] == pytest.approx(math.exp(math.hypot(math.log(1.04), 2**0.5 * math.log(1.08))))
    apart = [[r | {"time_process_ratio": 1.12} for r in rows] for rows in quiet]
    assert winners(*apart) == {"tie"}
    assert winners(*quiet, kind=EVALUATIONS) == {"tie"}
    assert set(contests(found(*quiet, kind=EVALUATIONS))["margin"]) == {contest.COUNTED}


def test_a_pair_takes_the_spread_of_its_noisier_engine():
    own = [r | {"time_process_ratio": 1.01} for r in ladder("contact-a")]
    jax = [r | {"time_process_ratio": 1.3, "engine": "c"} for r in ladder("rk4", 1.1)]
    assert len(own) >= contest.ENOUGH
    assert contests(found(own, jax))["margin"].tolist() == pytest.approx([1.3] * len(TARGETS))


@pytest.mark.parametrize("twice", [contest.ENOUGH - 1, contest.ENOUGH])
def test_an_engine_timed_twice_in_few_cells_has_the_spread_of_all(twice):
    few = [r | {"time_process_ratio": 1.1 if i < twice else None} for i, r in enumerate(ladder("contact-a"))]
    many = [r | {"time_process_ratio": 1.3, "engine": "c"} for r in ladder("rk4")]
    spread = COMPILED.process_spread(table("work_precision", few + many), "jax")
    assert spread == (1.1 if twice == contest.ENOUGH else 1.3)


@pytest.mark.parametrize("halves", [2.0, math.nan])
def test_a_cell_too_noisy_to_judge_is_undecided_and_still_beats_what_is_far_off(halves):
    noisy = ladder("contact-a", time_halves_ratio=halves)
    rows = found(noisy, ladder("rk4", 1.1), ladder("cvode-bdf", 100.0))
    assert set(contests(rows)["winner"]) == {"undecided"}
    verdicts = contest.standings(rows).groupby("method")["verdict"].first()
    assert verdicts["rk4"] == "undecided"
    assert verdicts["cvode-bdf"] == ("loss" if halves == 2.0 else "undecided")


# -- Which runs keep a law, as the columns of the tables say ---------------------------------------
def run(value=1e-15, method="contact-a", scene="central", limit=1e-12, undecided=False, **more):
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


def test_runs_that_failed_have_no_row():
    rows = [run(), run(status="diverged")]
    assert len(law_rows(frames(laws=rows), "contact_drift")) == 1
    assert not len(law_rows(frames(), "contact_drift"))


@pytest.mark.parametrize(
    ("value", "limit", "kept"),
    [(1e-7, 1e-6, True), (1e-7, 2e-6, None), (1e-12, 1.0, True), (2.0, 1.0, False)],
)
def test_a_bound_above_a_millionth_decides_nothing(value, limit, kept):
    assert is_kept(value, limit) is kept
