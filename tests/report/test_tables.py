"""What the tables to read say, on small tables made by hand; views, numbers and their markdown; a comparison."""

import re

import numpy as np
import pandas as pd
import pytest

import contactbench as cb
from contactbench.questions import structure, work_precision
from contactbench.questions.contest import COMPILED
from contactbench.questions.headline import at_equal_cost, cost_answers, overview
from contactbench.questions.laws import along_time, equal_cost_view, least_errors, most_met_cost
from contactbench.questions.stability import ending, rates_view, started_runs
from contactbench.questions.write import glossary
from contactbench.report import markdown
from contactbench.report.numbers import duration
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of
from contactbench.study import race
from contactbench.tables.schema import TABLES
from frames import frames, row, table


def texts(view):
    """The first cell of each row → the texts of the others."""
    return {line[0].text: [cell.text for cell in line[1:]] for line in view.rows}


# -- laws at equal cost ----------------------------------------------------------------------------
def at_cost(scene, method, drift=1e-15, cost=30.0, **more):
    columns = {"energy_law": 1e-4, "momentum_law": drift, "contact_drift": drift}
    return row(scene, method, 0.1, solution_error=1e-3, cost=cost, rhs_equivalents=800.0, **columns, **more)


def test_the_mission_has_order_and_laws_side_by_side_and_j_where_it_is_claimed():
    rows = [at_cost(s, m) for s in ("particle", "rigid_body") for m in ("contact-strang", "rk4")]
    order = row("particle", "rk4", 0.1, solution_error=1e-3, order=4.0, order_nominal=4)
    claimed = row("rigid_body", "contact-strang", 0.1, momentum_law=1e-15, momentum_law_claimed=True)
    tables = frames(decay_laws=rows, convergence=[order], laws=[claimed])
    view = at_equal_cost(tables, "mission")
    heads = [(head.group, head.label) for head in view.columns]
    assert heads[1:4] == [("particle", "evaluations"), ("particle", "order"), ("particle", "H0 law")]
    assert ("rigid_body", "J law") in heads
    assert texts(view)["rk4"][:3] == ["800", "4.00", "1.0e-04"]
    assert at_equal_cost(frames(), "mission") is None


def test_the_mission_has_the_least_time_of_each_error_and_who_keeps_what():
    tables = frames(
        work_precision=raced("particle", **{"contact-strang": 2.0, "contact-rkn6": 1.0, "rk4": 0.5}),
        laws=[
            row("particle", m, 0.1, contact_drift=d, contact_drift_bound=1e-12, contact_drift_kept=d < 1e-12)
            | {"contact_drift_claimed": m != "rk4", "contact_drift_undecided": False}
            for m, d in (("contact-strang", 1e-15), ("contact-rkn6", 1e-15), ("rk4", 1e-8))
        ],
    )
    cells = texts(overview(tables))
    first, best = cells["the fastest of all"], cells["the fastest contact method"]
    assert [line[0].split()[0] for line in (first, best)] == ["rk4", "contact-rkn6"]
    assert [line[-1] for line in (first, best, cells["contact-strang"], cells["rk4"])] == [
        "to its error",
        "to round-off",
        "to round-off",
        "to its error",
    ]
    assert {line[-2] for line in cells.values()} == {"—"}  # nobody claims J there
    assert overview(frames()) is None


def test_the_cost_that_most_methods_meet_is_shown():
    rows = [at_cost("central", m, cost=c) for m in ("contact-a", "rk4") for c in (30.0, 100.0)]
    assert set(most_met_cost(table("decay_laws", rows))["cost"]) == {100.0}
    rows[3]["status"] = "failed"
    assert set(most_met_cost(table("decay_laws", rows))["cost"]) == {30.0}


def test_clamped_uncertain_and_kept_entries_are_told_apart():
    rows = [
        at_cost("central", "contact-a", 0.5, contact_drift_clamped=3),
        at_cost("central", "rk4", 1e-8, contact_drift_uncertainty=2e-9),
        at_cost("central", "cvode-bdf", 1e-8, contact_drift_uncertainty=6e-9),
        at_cost("central", "contact-b", contact_drift_kept=True),
        at_cost("central", "contact-c", contact_drift_kept=None, contact_drift_undecided=True),
        at_cost("central", "rk5", 1e-4, contact_drift_undecided=True, contact_drift_bound=1e-3),
    ]
    tables = frames(decay_laws=rows)
    cells = [line[-1] for line in equal_cost_view(tables["decay_laws"], tables).rows]
    written = ["5.0e-01†", "1.0e-08 ± 2e-09", "≤ 1.0e-08", "1.0e-15", "1.0e-15", "1.0e-04‡"]
    assert [cell.text for cell in cells] == written
    assert [cell.mark for cell in cells] == [None, None, None, Mark.kept, None, None]  # as the column says


def test_the_closest_to_the_true_energy_are_all_that_tie_or_are_at_round_off():
    assert least_errors(pd.Series({"a": 2.1e-3, "b": 1.9e-3, "c": 1e-3, "d": np.nan})) == ["c", "b"]
    rows = [
        {
            "scene": "s",
            "method": method,
            "setting": "step=0.2",
            "t": time,
            "energy_deviation": time * deviation,
        }
        for method, deviation in {"contact-o8": 3e-13, "rk8": 1e-15, "rk4": 1e-3}.items()
        for time in (1.0, 2.0)
    ]
    title = along_time(table("laws_time", rows), "s").title
    assert title == "s: closest to the true energy, to 10⁻¹²: rk8 and contact-o8"


# -- cost ------------------------------------------------------------------------------------------
def raced(scene, **factors):
    """Rows of methods that take so many times as long as the fastest, at every error."""
    return [
        row(scene, method, error, solution_error=error, time_min_s=factor * time, time_median_s=time)
        for method, factor in factors.items()
        for error, time in ((1e-2, 1e-6), (1e-13, 1e-5))
    ]


def contest(**factors):
    return work_precision.contest(table("work_precision", raced("s", **factors)), COMPILED)


def test_the_cheapest_is_named_with_the_factor_of_the_best_contact_method():
    lost = contest(contact=2.0, rk4=1.0)
    cell = work_precision.winners_view(lost, "w").rows[0][1]
    assert re.fullmatch(r"rk4 .*\(contact ×2\.00\)", cell.text)
    assert cell.mark is None
    (line,) = work_precision.losses_view({"time": lost.contests}, "l").rows
    assert re.fullmatch("4 of 4: .*rk4 ×2.00", line[1].text)
    won = contest(contact=1.0, rk4=2.0)
    assert work_precision.winners_view(won, "w").rows[0][1].mark is Mark.best
    assert not work_precision.losses_view({"time": won.contests}, "l").rows


def test_the_scenes_where_a_contact_method_loses_at_every_error_are_named_and_those_elsewhere_counted():
    rows = raced("oscillator", contact=2.0, rk4=1.5) + raced("particle", contact=1.0, rk4=1.5)
    slower = [each for each in cost_answers(frames(work_precision=rows)) if "slower" in each.question]
    assert [each.answer for each in slower] == ["`oscillator`"]
    assert [each.count for each in slower] == ["4 of 4 pairs there, 0 of 4 elsewhere"]


# -- hard scenes -----------------------------------------------------------------------------------
def test_a_setting_that_was_not_run_is_no_ending_and_escaping_as_the_motion_does_is_right():
    ended = ({"status": "budget", "end_time": 1.0}, {"status": "budget"}, {"status": "unsupported"})
    rows = [row("large_step", "rk4", 10.0**-k, **each) for k, each in enumerate(ended)]
    rows += [row("escape", "rk4", 0.1, status=s, end_time=1.0, blow_up_time=1.5) for s in ("diverged", "ok")]
    assert started_runs(table("stability", rows))["right"].tolist() == [False, True, False]


# -- damping ---------------------------------------------------------------------------------------
def test_rates_are_compared_at_equal_cost_and_ties_are_named():
    common = {"experiment": "overdamped", "t_end": 100.0}
    fixed = common | {"damping_per_step": 25.0, "evaluations": 200}
    rows = [
        row("overdamped", "contact-a", 0.5, **fixed, rate_error=1e-4),
        row("overdamped", "rk4", 0.5, **fixed, rate_error=1.5e-4),
        row("overdamped", "scipy-radau", 1e-9, control="rtol", **common, evaluations=2000, rate_error=1e-10),
    ]
    (line,) = rates_view(table("damping_rates", rows)).rows  # ten times dearer is no equal cost
    assert (line[1].text, line[1].mark) == ("contact-a and rk4 1.0e-04", Mark.tie)
    rows[2]["evaluations"] = 210
    (line,) = rates_view(table("damping_rates", rows)).rows
    assert (line[1].text, line[1].mark) == ("scipy-radau 1.0e-10", Mark.best)


# -- what structure buys ---------------------------------------------------------------------------
def on_the_ring(method, errors, each_ns=20.0, **more):
    """Rows of steps 1/4 and 1/8, at T = 10⁴ timed, and at T = 10⁵: errors of the two at each length."""
    for span, found in errors.items():
        for evaluations, error in zip((4.0, 8.0), found, strict=True):
            ring = {"gamma": 1e-5, "t_end": span, "n": 16, "floor": 1e-5, "starts": 16} | more
            timed = {"time_min_s": 1e-6 * each_ns, "timed_evaluations": 1000} if span == 1e4 else {}
            costs = {"energy_error": error, "rate_error": error, "evaluations_per_time": evaluations}
            costs |= {"energy_error_low": error / 2, "energy_error_high": 2 * error}
            yield row("chaotic_ring", method, 1 / evaluations, **ring, **costs, **timed)


RING = [
    *on_the_ring("contact-a", {1e4: (1e-2, 1e-3), 1e5: (1e-2, 1e-3)}),
    *on_the_ring("herglotz2", {1e4: (2e-2, 1e-3), 1e5: (2e-2, 1e-3)}, 40.0),
    *on_the_ring("rk4", {1e4: (1e-1, 1e-2), 1e5: (1.0, 1e-2)}, 30.0),
    *on_the_ring("rk4", {1e4: (1e-9, 1e-9)}, gamma=1e-3),
]


def test_who_has_the_energy_left_right_at_the_least_cost_in_the_longest_run():
    time, evaluations = structure.answers(frames(structure_buys=RING))
    assert "T = 10⁵" in time.question
    assert "median of 16 starts" in time.question
    assert (time.answer, time.count) == ("contact-a", "8 ms; herglotz2 ×2.35, rk4 ×3.00")
    assert evaluations.answer == "contact-a"
    assert evaluations.count == "4 per unit of time; herglotz2 ×1.17, rk4 ×2.00"
    contradicting = [*RING, *on_the_ring("rk5", dict.fromkeys((1e4, 1e5), (1e-4, 1e-5)), 1.0)]
    assert next(structure.answers(frames(structure_buys=contradicting))).answer == "rk5"
    assert not [*structure.answers(frames())]


def test_one_setting_is_shown_at_both_lengths_and_a_bound_as_one():
    bound = on_the_ring("contact-b", {1e4: (1e-4, 1e-5), 1e5: (1e-4, 1e-5)})
    rows = structure.main_rows(table("structure_buys", [*RING, *bound]))
    shown = texts(structure.costs_view(rows))
    to_one_percent = ["2.4 ms", "8", "×3.00", "24 ms", "8", "×3.00"]
    assert shown["rk4"] == [*to_one_percent, "step=0.125", *["1.0e-02"] * 3, "5.0e-03 to 2.0e-02"]
    assert shown["contact-b"][0] == "≤ 800 µs"
    assert "rk4, the best that is no contact method, ×3.00 that" in structure.figure(rows).title


# -- views, numbers and their markdown -------------------------------------------------------------
def view(rows, labels, **more):
    return View("v", "Title", frame_of(rows, labels), "A legend.", **more)


def test_marks_are_seen_and_a_bar_does_not_break_a_table():
    cells = Cell("a|b", mark=Mark.best), Cell("c", mark=Mark.tie)
    text = markdown.parts([view([cells], ["1", "2"])])
    assert text.splitlines()[-1].split(" | ") == ["| **a\\|b**", "*c* |"]
    assert text.startswith("## Title\n\nA legend.\n\n| 1 ")
    assert "&lt;b>" in markdown.parts([view([("<b>", 1)], ["a", "b"])])


def test_numbers_are_written_by_their_column_and_words_stand_left():
    shown = view([("rk4", 1e-3, 2.0, None)], ["method", "error", "time", "reason"], show={"time": duration})
    assert [cell.text for cell in shown.rows[0]] == ["rk4", "1.0e-03", "2 s", "—"]
    assert [head.words for head in shown.columns] == [True, False, False, True]


def test_the_glossary_has_every_method_scene_and_column():
    text = markdown.parts(glossary({"methods": cb.METHODS, "scenes": cb.SCENES}))
    for name in (*cb.METHODS, *cb.SCENES):
        assert re.search(rf"^\| {re.escape(name)} ", text, re.M), name
    for name, steps in (("contact-exact", "exact"), ("cvode-adams", "adaptive"), ("rk4", "fixed")):
        (line,) = re.findall(rf"^\| {name} .*$", text, re.M)
        assert f"| {steps} " in line
    assert all(f"`{column}`" in text for each in TABLES.values() for column in each.columns)


def test_infinite_numbers_have_their_sign_and_missing_ones_are_dashes():
    assert (as_cell(float("inf")).text, as_cell(pd.NA).text) == ("∞", "—")


# -- A comparison on one scene as text and plot -----------------------------------------------------
@pytest.fixture(scope="module")
def frame():
    return cb.compare("oscillator", ["contact-strang", "rk4", "contact-exact"], (1e-2, 1e-4), budget=60.0)


def test_text_has_every_time_and_the_plot_every_kind(frame):
    text = race.text(frame)
    for run in frame[frame["status"] == "ok"].itertuples():
        assert f"{run.setting}, {run.error_reached:.1e}" in text
    assert "contact-exact: unsupported" in text
    assert [panel.title for panel in race.figure(frame).panels] == ["Compiled", "Evaluations"]


def test_a_law_there_was_no_time_for_is_not_called_broken(frame):
    own = frame[frame["method"] == "contact-strang"].copy()
    assert race.kept_laws(own) == "η"
    for rows, kept in (
        (own.index[0], "η"),
        (own.index, "η not measured"),
    ):  # at one of the two errors, at both
        own.loc[rows, ["contact_drift", "laws_kept"]] = [np.nan, ""]
        assert race.kept_laws(own) == kept
    assert race.kept_laws(frame[frame["method"] == "rk4"]) == "none"


def test_a_curve_says_what_an_error_costs_and_never_turns_back():
    errors = [1e-1, 3e-1, 1e-3, 1e-2, 1e-4, 1e-9]
    tried = pd.DataFrame({"method": ["a"] * 5 + ["b"], "error": errors, "cost": [1, 2, 3, 4, 5, 9]})
    front = race.front(tried)
    assert front.query("method == 'a'")["cost"].tolist() == [1, 3, 5]
    assert len(front) == 4


@pytest.mark.parametrize(
    ("runs", "value", "text", "mark"),
    [
        ([("ok", 1e-3, True), ("ok", 1e-5, True)], 1e-5, "1e-05", None),
        ([("ok", 1e-3, True), ("diverged", np.nan, False)], 1e-3, "1e-03", Mark.exception),
        ([("diverged", np.nan, True)], None, "diverged", None),
        ([("failed", np.nan, False), ("budget", np.nan, False)], None, "failed and budget", Mark.exception),
    ],
)
def test_a_method_shows_its_smallest_error_or_how_it_ended_and_where_that_is_wrong(runs, value, text, mark):
    cell = ending(pd.DataFrame(runs, columns=["status", "solution_error", "right"]))
    assert (cell.value, cell.text, cell.mark) == (value, text, mark)
