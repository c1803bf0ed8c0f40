"""A comparison on one scene: what it claims is so, what it cannot do it says, and it ends when told."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import contactbench as cb
from cases import REPOSITORY
from contactbench.measure.ladder import ENDS
from contactbench.measure.statistics import PROCESSES
from contactbench.methods.compiled import _programs
from contactbench.methods.engines import ENGINES
from contactbench.race import comparison, show
from contactbench.race import scout as scouting
from contactbench.race.keeping import kept
from contactbench.race.scout import Attempt
from contactbench.race.table import COLUMNS, cheapest, judged
from contactbench.solution import Status
from contactbench.truth import OutOfTime

RACED = ["contact-strang", "rk4", "cyrk-vern8", "contact-exact", "scipy-dop853"]
ERRORS = (1e-2, 1e-5)


def double_well():
    """A scene of nobody's: there is no stored reference of it."""
    return cb.Mechanical(
        name="well", q=(0.5, 0.3), p=(0.8, 0.1), gamma=0.05, t_end=5.0,
        potential=lambda q: (q[0] ** 2 - 1) ** 2 / 4 + q[1] ** 2 / 2,
        gradient=lambda q: (q[0] ** 3 - q[0], q[1]),
    )  # fmt: skip


@pytest.fixture(scope="module")
def frame():
    return cb.compare(double_well(), RACED, ERRORS, budget=120.0)  # it needs a tenth of it


def test_a_row_for_each_method_and_error_typed(frame):
    assert [(m, e) for m in RACED for e in ERRORS] == list(
        zip(frame["method"], frame["error_asked"], strict=True)
    )
    assert list(frame.columns[: len(COLUMNS)]) == list(COLUMNS)
    assert {name: str(frame[name].dtype) for name in COLUMNS} == COLUMNS
    assert {e: ENGINES[e] for e in frame["engine"]} == dict(zip(frame["engine"], frame["kind"], strict=True))


def test_the_error_said_is_the_largest_of_five_runs_and_no_larger_than_asked(frame):
    """Measured again, in another way: every end on its own, against the reference at that time."""
    scene = double_well()
    exact = cb.reference(scene, scene.t_end * np.arange(1, ENDS + 1) / ENDS, ()).y
    done = frame[frame["status"] == "ok"]
    assert len(done) == 8
    for row in done.itertuples():
        control, value = row.setting.split("=")
        errors = []
        for k, truth in enumerate(exact, start=1):
            method = cb.METHODS[row.method]
            assert control == ("rtol" if method.adaptive else "step")
            tried = [
                r for r in frame.attrs["runs"] if (r["method"], r["setting"]) == (row.method, row.setting)
            ]
            value = tried[0]["value"]  # the setting is printed with six digits
            run = cb.solve(scene, row.method, save_at=[scene.t_end * k / ENDS], carry=(), **{control: value})
            errors.append(np.linalg.norm(run.y[-1] - truth))
        said = max(errors) / np.linalg.norm(exact, axis=1).max()
        assert said == pytest.approx(row.error_reached, rel=1e-6)
        assert row.error_reached <= row.error_asked


def test_no_coarser_setting_that_was_tried_is_as_accurate(frame):
    tried = pd.DataFrame(frame.attrs["runs"])
    for row in frame[frame["status"] == "ok"].itertuples():
        own = tried[(tried["method"] == row.method) & (tried["status"] == "ok")]
        cheaper = own[own["evaluations"] < row.evaluations]
        assert (cheaper["error"] > row.error_asked).all()
        # and the setting is near the edge: the next cheaper one tried is within a step of the bisection
        if len(cheaper):
            assert row.evaluations / cheaper["evaluations"].max() < 1.5


def test_a_tighter_setting_that_is_sooner_done_stands_at_the_looser_error_too(frame):
    coarse, fine, finest = (Attempt(value, str(value), Status.ok, "", 0.0) for value in (1e-2, 1e-5, 1e-8))
    chosen = {("m", 1e-3): coarse, ("m", 1e-6): fine, ("m", 1e-9): finest}
    times = {id(coarse): {"time_median_s": 182e-6}, id(fine): {"time_median_s": 111e-6}}
    errors = (1e-3, 1e-6, 1e-9, 1e-12)
    found = [cheapest("m", error, errors, chosen, times) for error in errors]
    assert found == [fine, fine, finest, None]
    for _, rows in frame[frame["time_s"].notna()].groupby("method"):
        assert rows.sort_values("error_asked")["time_s"].is_monotonic_decreasing


def test_a_scene_whose_motion_depends_on_s_is_compared_with_s():
    frame = cb.compare("quadratic_damping", ["contact-rkn4", "cyrk-vern8"], [1e-4], budget=30.0)
    assert (frame["status"] == "ok").all(), list(frame["reason"])


def test_times_are_compared_within_a_kind_only(frame):
    for (_, _), part in frame[frame["status"] == "ok"].groupby(["kind", "error_asked"]):
        assert part["ratio"].min() == 1.0
        assert set(part.loc[part["ratio"] == 1.0, "verdict"]) <= {"cheapest", "tie", "undecided"}
    assert set(frame.loc[frame["method"] == "scipy-dop853", "verdict"]) == {"cheapest"}


def test_a_contact_method_keeps_the_contact_form_and_a_runge_kutta_method_does_not(frame):
    kept = frame.set_index(["method", "error_asked"])["laws_kept"]
    for error in ERRORS:
        assert "contact drift" in kept["contact-strang", error]
        assert kept["rk4", error] == ""
    drift = frame.set_index(["method", "error_asked"])["contact_drift"]
    assert drift["contact-strang", 1e-2] < 1e-12 < drift["rk4", 1e-2]


def test_what_is_not_compared_says_why(frame):
    row = frame[frame["method"] == "contact-exact"].iloc[0]
    assert (row["status"], row["verdict"]) == ("unsupported", "")
    assert "rigid bodies" in row["reason"]
    assert math.isnan(row["time_s"])


def test_the_reference_is_checked_and_nothing_below_its_error_is_claimed(frame, monkeypatch):
    reference = frame.attrs["reference"]
    assert reference["source"] == "live"
    assert reference["digits"] >= 20
    assert reference["confirmed"] is None or reference["confirmed"] >= 15
    exact = comparison.reference

    def known_to_four_digits(*arguments, **options):
        return replace(exact(*arguments, **options), digits=4)

    monkeypatch.setattr("contactbench.race.comparison.reference", known_to_four_digits)
    found = cb.compare(double_well(), ["rk4"], (1e-2, 1e-6), budget=10.0)
    assert found.attrs["reference"]["error"] == 1e-4
    first, second = found.itertuples()
    assert first.status == "ok"
    assert first.error_reached >= 1e-4
    assert (second.status, second.verdict) == ("unresolved", "")
    assert "known to 1.0e-04 only" in second.reason


def test_a_reference_that_would_take_too_long_is_refused():
    with pytest.raises(OutOfTime, match="in the time it was given"):
        cb.compare(double_well().with_(t_end=4000.0), ["rk4"], ERRORS, budget=0.5)


def test_it_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = {path: path.stat().st_mtime_ns for path in REPOSITORY.glob("*/*.csv")}  # tables and references
    cb.compare("particle", ["rk4"], (1e-2,), budget=5.0)
    assert not list(tmp_path.iterdir())
    assert before == {path: path.stat().st_mtime_ns for path in REPOSITORY.glob("*/*.csv")}


@pytest.mark.slow
def test_a_method_without_a_setting_is_raced_too():
    frame = cb.compare("rigid_body", ["contact-exact", "contact-strang"], (1e-2, 1e-9), budget=60.0)
    exact = frame[frame["method"] == "contact-exact"]
    assert list(exact["status"]) == ["ok", "ok"]
    assert exact["error_reached"].max() < 1e-12
    assert exact["time_s"].nunique() == 1  # one run serves both errors
    assert "J law" in exact["laws_kept"].iloc[0]


# -- interruption, budget --------------------------------------------------------------------------
def test_control_c_ends_it_with_what_there_is(monkeypatch):
    one = scouting.scout

    def stopped(question, found):
        if found.method == "contact-strang":
            raise KeyboardInterrupt
            yield
        yield from one(question, found)

    monkeypatch.setattr("contactbench.race.comparison.scout", stopped)
    found = cb.compare("particle", ["rk4", "contact-strang", "herglotz2"], (0.5,), budget=20.0)
    assert found.attrs["interrupted"]
    rows = found.set_index("method")
    assert rows.loc["rk4", "status"] == "ok"
    assert rows.loc["rk4", "time_s"] > 0
    assert list(rows.loc[["contact-strang", "herglotz2"], "status"]) == ["interrupted", "interrupted"]
    assert "Interrupted" in show.text(found)


def test_control_c_before_there_is_a_reference_is_passed_on(monkeypatch):
    def stopped(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("contactbench.race.comparison.reference", stopped)
    with pytest.raises(KeyboardInterrupt):
        cb.compare("particle", ["rk4"], (1e-2,))


def test_a_spent_budget_is_said_of_each_method_it_stopped():
    found = cb.compare("particle", ["contact-printed", "diffrax-tsit5"], (1e-9,), budget=1.0)
    assert list(found["status"]) == ["budget", "budget"]
    assert found["reason"].str.len().min() > 0
    assert found["error_reached"].isna()[1]


def test_what_a_cheap_method_leaves_goes_to_the_others(monkeypatch):
    """Every turn is that of the method that has had the least time, and no method has a fixed share."""
    given = {"rk4": 0.0, "contact-strang": 0.0, "herglotz2": 0.0}
    clock = [0.0]
    costs, lengths = (
        {"rk4": 0.1, "contact-strang": 1.0, "herglotz2": 5.0},
        {"rk4": 3, "contact-strang": 4, "herglotz2": 99},
    )
    turns = []

    def scripted(question, found):
        for _ in range(lengths[found.method]):
            clock[0] += costs[found.method]
            given[found.method] += costs[found.method]
            turns.append(found.method)
            found.attempts.append(Attempt(1.0, "step=1", Status.ok, "", 0.1, error=0.3))
            yield

    monkeypatch.setattr("contactbench.race.comparison.scout", scripted)
    monkeypatch.setattr("contactbench.race.comparison.perf_counter", lambda: clock[0])
    race = comparison.Comparison(cb.SCENES["particle"], list(given), (1e-2,), 60.0, False)
    race.scout_all()
    assert turns[:3] == ["rk4", "contact-strang", "herglotz2"]
    assert turns[3:8] == ["rk4", "rk4", "contact-strang", "contact-strang", "contact-strang"]
    assert given["herglotz2"] > 25.0  # all that was left, more than an equal share
    assert clock[0] - costs["herglotz2"] <= comparison.SCOUTING * 60.0
    why = {each.method: each.why for each in race.scouted}
    assert why["rk4"] is None
    assert why["herglotz2"][0] == "budget"
    assert "no time was left after step=1" in why["herglotz2"][1]


@pytest.mark.slow
def test_xla_compiles_an_adaptive_solver_once():
    """Another budget of steps would be another program: a dozen compilations instead of one."""
    scene = double_well()
    found = cb.compare(scene, ["diffrax-tsit5"], (1e-3, 1e-6), budget=300.0)
    assert list(found["status"]) == ["ok", "ok"]
    assert len(found.attrs["runs"]) > 5
    of_the_motion = [key for key in _programs.items if key[:3] == (scene.recorded().identity, "run", ())]
    assert len(of_the_motion) == 1


def test_what_the_fewest_rounds_have_no_time_for_is_not_timed_and_says_so(monkeypatch):
    race = comparison.Comparison(cb.SCENES["particle"], ["rk4", "contact-strang"], (1e-2,), 60.0, False)
    quick, slow = (Attempt(1.0, "step=1", Status.ok, "", seconds, error=1e-3) for seconds in (1e-3, 100.0))
    race.chosen = {("rk4", 1e-2): quick, ("contact-strang", 1e-2): slow}
    monkeypatch.setattr("contactbench.race.comparison.bare", lambda attempt: lambda: None)
    race.time_all()
    assert race.times.keys() == {id(quick)}
    assert race.untimed == {id(slow): "too slow for the time that was left"}


def test_a_method_that_breaks_is_a_row(monkeypatch):
    def broken(request):
        raise RuntimeError("no compiler found")

    item = replace(cb.METHODS["rk4"], name="rk4")
    object.__setattr__(item, "prepare", broken)
    monkeypatch.setitem(cb.METHODS, "rk4", item)
    found = cb.compare("particle", ["rk4"], (1e-2,), budget=5.0)
    assert list(found["status"]) == ["failed"]
    assert "no compiler found" in found["reason"][0]


# -- input -----------------------------------------------------------------------------------------
BAD = {
    "scene": (("wel",), {}, "unknown scene 'wel'"),
    "method": (("particle", ["rk5"]), {}, "unknown method 'rk5': did you mean 'rk4'?"),
    "error": (("particle", ["rk4"], (0.0,)), {}, "error = 0.0: must be between 0 and 1"),
    "errors": (("particle", ["rk4"], ()), {}, "errors: at least one"),
    "budget": (("particle", ["rk4"]), {"budget": -1}, "budget = -1: must be > 0"),
}


@pytest.mark.parametrize(("arguments", "options", "says"), BAD.values(), ids=BAD)
def test_bad_input_is_named(arguments, options, says):
    with pytest.raises(cb.BadInput) as caught:
        cb.compare(*arguments, **options)
    assert says in str(caught.value)


# -- verdicts --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("times", "halves", "expected"),
    [
        ([1.0, 1.1, 3.0], 1.0, ["cheapest", "×1.10", "×3.00"]),
        ([1.0, 1.03, 3.0], 1.0, ["tie", "tie", "×3.00"]),
        ([1.0, 1.1, 3.0], 1.1, ["tie", "tie", "×3.00"]),
        ([1.0, 1.1, 3.0], 0.5, ["undecided", "undecided", "×3.00"]),
        ([1.0, 1.1, math.nan], math.nan, ["undecided", "undecided", ""]),
        ([1.0, math.nan], 1.0, ["cheapest", ""]),
    ],
)
def test_a_tie_is_within_the_margin_of_its_pair(times, halves, expected):
    """The halves of the first call's visits agree; those of the second do not."""
    known = [1.0, halves, 1.0][: len(times)]
    frame = pd.DataFrame(
        {"kind": "compiled", "error_asked": 1e-3, "time_s": times, "time_halves_ratio": known}
    )
    assert list(judged(frame)["verdict"]) == expected


def test_every_time_has_a_margin_to_the_cheapest(frame):
    beside = frame[frame["ratio"] > 1]
    assert len(beside)
    assert (beside["margin"] >= PROCESSES).all()
    assert beside.loc[beside["ratio"] > beside["margin"], "verdict"].str.startswith("×").all()
    assert set(beside.loc[beside["ratio"] <= beside["margin"], "verdict"]) <= {"tie", "undecided"}


# -- shown -----------------------------------------------------------------------------------------
def test_text_page_and_plot_say_the_same(frame, tmp_path):
    text, page = show.text(frame), show.html(frame)
    for row in frame.itertuples():
        assert row.method in text
        assert row.method in page
        if row.verdict.startswith("×"):
            assert row.verdict in text
            assert row.verdict in page
    assert "not claimed" in text
    assert "contact-exact: unsupported" in text
    assert "src=" not in page  # one file, nothing to fetch
    from contactbench.report.draw import render

    figure = show.figure(frame)
    assert [panel.title for panel in figure.panels] == ["Compiled", "Calling back into Python", "Evaluations"]
    render(figure).savefig(tmp_path / "plot.svg")
    assert (tmp_path / "plot.svg").stat().st_size > 10_000


def test_a_law_there_was_no_time_for_is_not_called_broken(frame):
    own = frame[frame["method"] == "contact-strang"].copy()
    assert "contact drift" in show.kept_by(own)
    own.loc[own.index[0], ["contact_drift", "laws_kept"]] = [np.nan, ""]  # measured at one of the two errors
    assert "contact drift" in show.kept_by(own)
    own["contact_drift"], own["laws_kept"] = np.nan, ""
    assert "not measured: contact drift" in show.kept_by(own)
    assert show.kept_by(frame[frame["method"] == "rk4"]) == "none"


def test_a_curve_says_what_an_error_costs_and_never_turns_back():
    tried = pd.DataFrame(
        {
            "method": ["a"] * 5 + ["b"],
            "error": [1e-1, 3e-1, 1e-3, 1e-2, 1e-4, 1e-9],
            "evaluations": [1, 2, 3, 4, 5, 9],
        }
    )
    kept_of_a = show.front(tried, "error", "evaluations").query("method == 'a'")
    assert list(kept_of_a["evaluations"]) == [1, 3, 5]
    assert len(show.front(tried, "error", "evaluations")) == 4


def test_the_terminal_says_setting_and_error_of_each_time(frame):
    text = show.text(frame)
    for row in frame[frame["status"] == "ok"].itertuples():
        assert f"{row.setting}, {row.error_reached:.1e}" in text


def test_round_off_of_a_map_that_grows_is_told_from_a_broken_law():
    """Near the top of a double well round-off grows with the map; the bound of the tables of laws knows."""
    frame = pd.DataFrame(
        {
            "contact_drift": [2e-12, 2e-12, 2e-12],
            "map_growth": [50.0, 1.0, np.nan],
            "evaluations": [2000.0] * 3,
        }
    )
    assert kept(frame, cb.SCENES["oscillator"]) == ["contact drift", "", ""]
