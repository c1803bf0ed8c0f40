"""What the tables to read say, on small tables made by hand."""

import math
import re

import numpy as np
import pandas as pd
import pytest

from contactbench.questions import cost, hard, mission, ring
from contactbench.questions.contest import ranked
from contactbench.report.numbers import DASH
from contactbench.report.views import Mark
from frames import frames, row, table, timed


def texts(view):
    """The first cell of each row → the texts of the others."""
    return {line[0].text: [cell.text for cell in line[1:]] for line in view.rows}


# -- cost ------------------------------------------------------------------------------------------
def raced(scene, **factors):
    """Runs of methods that take so many times as long as the fastest, at every error; and their times."""
    runs, seconds = [], []
    for method, factor in factors.items():
        for error, time in ((1e-2, 1e-6), (1e-13, 1e-5)):
            runs.append(row(scene, method, error, error=error, saved=1, evaluations=1e6 * factor * time))
            seconds.append(factor * time)
    return {"runs": runs, "times": timed(runs, seconds)}


def standing(**factors):
    return ranked(*(table(name, rows) for name, rows in raced("s", **factors).items()))


@pytest.mark.parametrize(
    ("factors", "text", "mark"),
    [
        ({"contact-a": 2.0, "rk4": 1.0, "rk8": 1.2}, r"rk4 and rk8 .*\(contact ×2\.00\)", None),
        ({"contact-a": 1.2, "rk4": 1.0}, r"rk4 and contact-a [^(]*", Mark.tie),
        ({"contact-a": 1.0, "rk4": 1.3}, r"contact-a [^(]*", Mark.best),
    ],
)
def test_all_within_a_quarter_of_the_least_are_named_with_the_factor_of_the_best_contact_method(
    factors, text, mark
):
    cell = cost.leaders_view(standing(**factors), "compiled").rows[0][1]
    assert re.fullmatch(text, cell.text)
    assert cell.mark is mark


def test_who_needs_the_fewest_evaluations_is_named_alone():
    runs = table("runs", raced("s", rk4=1.0, **{"contact-a": 1.01})["runs"])
    cell = cost.leaders_view(ranked(runs), "evaluations").rows[0][1]
    assert re.fullmatch(r"rk4 \d+ \(contact ×1\.01\)", cell.text)


def test_the_scenes_where_contact_methods_are_slower_at_every_error_are_named():
    one, other = raced("oscillator", contact=2.0, rk4=1.5), raced("particle", contact=1.0, rk4=1.5)
    found = mission.slower(frames(**{name: one[name] + other[name] for name in one}))
    assert (found.answer, found.count) == ("`oscillator`", "1 of 2 scenes")


def test_a_tolerance_is_compared_with_the_error_of_the_run():
    rows = [
        row("s", method, 1e-6, control="rtol", saved=1, error=error)
        for method, errors in {"contact-a": (5e-7,), "rk8-7": (2e-6, 3e-5)}.items()
        for error in errors
    ]
    rows[-1] |= {"scene": "t"}
    rows.append(row("s", "contact-a", 0.1, saved=1, error=1.0))
    rows.append(
        row("u", "rk8-7", 1e-6, control="rtol", saved=1, error=math.nan)
    )  # another end was not reached
    found = texts(cost.tolerance_view(frames(runs=rows)))
    assert found["contact-a"] == [
        "the run, by pilots",
        "1 of 1",
        "5.0e-01 [5.0e-01, 5.0e-01]",
        "5.0e-01: s, 10⁻⁶",
        DASH,
    ]
    assert found["rk8-7"] == ["a step", "0 of 3", "3.0e+01 [2.0e+00, inf]", "inf: u, 10⁻⁶", DASH]


# -- the mission -----------------------------------------------------------------------------------
MISSION = {"contact-printed": 4.0, "contact-strang": 2.0, "contact-rkn6": 1.0, "rk4": 0.5}


def mission_tables():
    made = raced("particle", **MISSION)
    for method in MISSION:
        for spent in (100.0, 1000.0):
            kept = {"contact_drift_claimed": method != "rk4", "contact_drift_kept": method != "rk4"}
            drift = {
                "contact_drift": 1e-8 if method == "rk4" else 1e-15,
                "energy_law": 1 / spent,
                "bound": 1e-12,
            }
            made["runs"].append(
                row("particle", method, 1 / spent, evaluations=spent, error=1 / spent, **kept | drift)
            )
    order = {
        "scene": "particle",
        "method": "rk4",
        "step": 0.1,
        "status": "ok",
        "order": 4.0,
        "order_nominal": 4,
    }
    return frames(**made, orders=[order])


def test_the_story_has_error_and_laws_of_every_contestant():
    view = mission.keeps_view(mission_tables())
    heads = [head.label for head in view.columns]
    shown = texts(view)
    assert [*shown] == ["contact-printed", "contact-strang", "rk4", "contact-rkn6"]
    assert shown["rk4"][:2] == ["1.0e-02", "1.0e-02"]
    marks = {line[0].text: line[heads.index("contact drift")].mark for line in view.rows}
    assert marks == dict.fromkeys(shown, Mark.kept) | {"rk4": None}


def test_the_readme_has_the_mission_in_one_table():
    view = mission.overview(mission_tables())
    shown = {line[0].text: line[1:] for line in view.rows}
    assert shown["RK4"][0].mark is Mark.best
    best, fastest = shown["the best contact method"][0], shown["the fastest of all"][0]
    assert (best.text.split()[0], best.mark) == ("contact-rkn6", None)  # twice the least time
    assert fastest.text.split()[0] == "rk4"
    kept = {label: cells[-1].text for label, cells in shown.items()}
    assert kept["RK4"] == kept["the fastest of all"] == "to its error"
    assert kept["the best contact method"] == "to round-off"
    assert mission.overview(frames()) is None


# -- hard scenes -----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("runs", "value", "text", "mark"),
    [
        ([("ok", 1e-3, "ok"), ("ok", 1e-5, "ok")], 1e-5, "1e-05", None),
        ([("ok", 1e-3, "ok"), ("diverged", np.nan, "ok")], 1e-3, "1e-03", Mark.exception),
        ([("diverged", np.nan, "diverged")], None, "diverged", None),
        ([("failed", np.nan, "ok"), ("budget", np.nan, "ok")], None, "failed and budget", Mark.exception),
    ],
)
def test_a_method_shows_its_smallest_error_or_how_it_ended_and_where_that_is_wrong(runs, value, text, mark):
    cell = hard.ending(pd.DataFrame(runs, columns=["status", "error", "truth"]))
    assert (cell.value, cell.text, cell.mark) == (value, text, mark)


def test_rates_are_compared_at_equal_cost_and_ties_are_named():
    rows = [
        {"question": "creep", "scene": "overdamped", "method": method, "status": "ok", "setting": setting}
        | {"evaluations": evaluations, "error": error, "gamma": 50.0, "t_end": 100.0}
        for method, setting, evaluations, error in (
            ("contact-a", 0.5, 200.0, 1e-4),
            ("rk4", 0.5, 200.0, 1.5e-4),
            ("scipy-radau", 1e-9, 2000.0, 1e-10),
        )
    ]
    cells = [line[-1] for line in hard.rates_view(table("limits", rows)).rows]
    assert (cells[0].text, cells[0].mark) == ("contact-a and rk4 1.0e-04", Mark.tie)
    assert (cells[-1].text, cells[-1].mark) == ("scipy-radau 1.0e-10", Mark.best)


# -- the ring --------------------------------------------------------------------------------------
def on_the_ring(method, errors, each_ns=20.0, **more):
    """Runs of steps 1/4 and 1/8 at both lengths with errors of the two, and the times of their beginning."""
    runs, times = [], []
    for span, found in errors.items():
        for evaluations, error in zip((4.0, 8.0), found, strict=True):
            known = {"scene": "chaotic_ring", "method": method, "control": "step", "setting": 1 / evaluations}
            ring = {"gamma": 1e-5, "t_end": span, "status": "ok", "floor": 1e-5} | more
            spread = {"low": error / 2, "high": 2 * error, "energy_error": error, "rate_error": error}
            runs.append(known | ring | spread | {"evaluations": evaluations})
            times.append(
                known | {"engine": "llvm", "saved": 1, "least_s": each_ns * 1e-9 * evaluations * 500}
            )
    return {"ring": runs, "times": times}


def ring_tables(*more):
    made = [
        on_the_ring("contact-a", {1e4: (1e-2, 1e-3), 1e5: (1e-2, 1e-3)}),
        on_the_ring("herglotz2", {1e4: (2e-2, 1e-3), 1e5: (2e-2, 1e-3)}, 40.0),
        on_the_ring("rk4", {1e4: (1e-1, 1e-2), 1e5: (1.0, 1e-2)}, 30.0),
        on_the_ring("rk4", {1e4: (1e-9, 1e-9)}, 30.0, gamma=1e-3),
    ]
    rows = {name: [r for each in (*made, *more) for r in each[name]] for name in ("ring", "times")}
    rows["times"] = list({(r["method"], r["setting"]): r for r in rows["times"]}.values())
    return frames(**rows, runs=[row("s", name, 0.1) for name in ("contact-a", "herglotz2", "rk4")])


def test_who_has_the_energy_left_right_at_the_least_cost_in_the_longest_run():
    time, evaluations = ring.answers(ring_tables())
    assert "T = 10⁵" in time.question
    assert (time.answer, time.count) == (
        "contact-a",
        "8 ms; best non-contact methods: herglotz2 ×2.35 and rk4 ×3.00",
    )
    assert evaluations.answer == "contact-a"
    assert evaluations.count == "4 per unit of time; best non-contact methods: herglotz2 ×1.17 and rk4 ×2.00"
    faster = on_the_ring("rk5", dict.fromkeys((1e4, 1e5), (1e-4, 1e-5)), 1.0)
    assert next(ring.answers(ring_tables(faster))).answer == "rk5"
    assert not [*ring.answers(frames())]


def test_one_setting_is_shown_at_both_lengths_and_a_bound_as_one():
    tables = ring_tables(on_the_ring("contact-b", {1e4: (1e-4, 1e-5), 1e5: (1e-4, 1e-5)}))
    rows = ring.main_rows(tables)
    shown = texts(ring.costs_view(tables, rows))
    to_one_percent = ["2.4 ms", "8", "×3.00", "24 ms", "8", "×3.00"]
    assert shown["rk4"] == [*to_one_percent, "step=0.125", *["1.0e-02"] * 3, "5.0e-03 to 2.0e-02"]
    assert shown["contact-b"][0] == "≤ 800 µs"
    assert "rk4, the fastest established method, ×3.00 that" in ring.figure(tables, rows).title
