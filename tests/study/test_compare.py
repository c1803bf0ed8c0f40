"""A comparison on one scene: what it claims is so, what it cannot do it says, and it ends when told."""

import math
import re
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import contactbench as cb
from cases import Clock, reading
from contactbench.methods.base import ENGINES
from contactbench.runs.search import Search
from contactbench.runs.settings import ENDS, carry_of
from contactbench.scene import rotation_matrix
from contactbench.study import compare, race, schedule
from contactbench.study.compare import COLUMNS, with_reasons, with_verdicts
from contactbench.truth import OutOfTime
from frames import race_of, tried

RACED = ["contact-strang", "rk4", "cyrk-vern8", "contact-exact", "scipy-dop853"]
ERRORS = (1e-2, 1e-5)


def double_well():
    """A scene of nobody's: there is no stored reference of it."""
    return cb.Mechanical(
        name="well",
        q=(0.5, 0.3),
        p=(0.8, 0.1),
        gamma=0.05,
        t_end=5.0,
        potential=lambda q: (q[0] ** 2 - 1) ** 2 / 4 + q[1] ** 2 / 2,
        gradient=lambda q: (q[0] ** 3 - q[0], q[1]),
    )


@pytest.fixture(autouse=True)
def no_machine(clock):
    """What has a budget reads a clock of the test's."""


@pytest.fixture(scope="module")
def frame():
    with reading(Clock()):
        return cb.compare(double_well(), RACED, ERRORS, budget=120.0)


def test_a_row_for_each_method_and_error_typed(frame):
    pairs = list(zip(frame["method"], frame["error_asked"], strict=True))
    assert pairs == [(m, e) for m in RACED for e in ERRORS]
    assert {name: str(frame[name].dtype) for name in frame.columns[: len(COLUMNS)]} == COLUMNS
    assert [ENGINES[engine] for engine in frame["engine"]] == list(frame["kind"])


def test_the_error_said_is_the_largest_of_five_runs_and_no_larger_than_asked(frame):
    """Measured again, in another way: every end on its own, against the reference at that time."""
    scene = double_well()
    exact = cb.reference(scene, scene.t_end * np.arange(1, ENDS + 1) / ENDS, ()).y
    values = {(run["method"], run["setting"]): run["value"] for run in frame.attrs["runs"]}  # of all digits
    done = frame[frame["status"] == "ok"]
    assert len(done) == 8
    for row in done.itertuples():
        setting = {row.setting.split("=")[0]: values[row.method, row.setting]}
        errors = []
        for k, truth in enumerate(exact, start=1):
            run = cb.solve(scene, row.method, save_at=[scene.t_end * k / ENDS], carry=(), **setting)
            errors.append(run.y[-1] - truth)
        states = np.array([scene.pack(scene.initial(())), *exact])
        halves = zip(np.split(np.array(errors), 2, axis=1), np.split(states, 2, axis=1), strict=True)  # q, p
        largest = max(np.linalg.norm(a, axis=1).max() / np.linalg.norm(b, axis=1).max() for a, b in halves)
        assert largest == pytest.approx(row.error_reached, rel=1e-6)
        assert row.error_reached <= row.error_asked


def test_no_coarser_setting_that_was_tried_is_as_accurate(frame):
    runs = pd.DataFrame(frame.attrs["runs"])
    for row in frame[frame["status"] == "ok"].itertuples():
        own = runs[(runs["method"] == row.method) & (runs["status"] == "ok")]
        cheaper = own[own["evaluations"] < row.evaluations]
        assert (cheaper["error"] > row.error_asked).all()
        # and the setting is near the edge: the next cheaper one tried is within a step of the bisection
        if len(cheaper):
            assert row.evaluations / cheaper["evaluations"].max() < 1.5


def test_a_tighter_setting_that_is_sooner_done_stands_at_the_looser_error_too(frame):
    errors = (1e-3, 1e-6, 1e-9, 1e-12)
    race = race_of("rk4", errors=errors)
    coarse, fine, finest = (
        tried(race.searches[0], 0.0, e, e, evaluations=round(1 / e), kind="rhs") for e in errors[:3]
    )
    race.times = {id(coarse): {"time_min_s": 182e-6}, id(fine): {"time_min_s": 111e-6}}
    assert [compare.soonest(race, race.searches[0], error) for error in errors] == [fine, fine, finest, None]
    for _, rows in frame[frame["time_s"].notna()].groupby("method"):
        assert rows.sort_values("error_asked")["time_s"].is_monotonic_decreasing


def test_a_scene_whose_motion_depends_on_s_is_compared_with_s():
    frame = cb.compare("quadratic_damping", ["contact-rkn4", "cyrk-vern8"], [1e-4], budget=30.0)
    assert (frame["status"] == "ok").all(), list(frame["reason"])


def test_times_are_compared_within_a_kind_only(frame):
    for (_, _), part in frame[frame["status"] == "ok"].groupby(["kind", "error_asked"]):
        assert part["ratio"].min() == 1.0
        assert set(part.loc[part["ratio"] == 1.0, "verdict"]) <= {"win", "tie", "undecided"}
    assert set(frame.loc[frame["method"] == "scipy-dop853", "verdict"]) == {"win"}


def test_a_contact_method_keeps_the_contact_form_and_a_runge_kutta_method_does_not(frame):
    kept = frame.set_index(["method", "error_asked"])["laws_kept"]
    for error in ERRORS:
        assert "η" in kept["contact-strang", error].split(", ")
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
    exact = schedule.reference
    monkeypatch.setattr(schedule, "reference", lambda *a, **more: replace(exact(*a, **more), digits=4))
    found = cb.compare(double_well(), ["rk4"], (1e-2, 1e-6), budget=10.0)
    assert found.attrs["reference"]["error"] == 1e-4
    first, second = found.itertuples()
    assert first.status == "ok"
    assert first.error_reached >= 1e-4
    assert (second.status, second.verdict) == ("unresolved", "")
    assert "known to 1.0e-04 only" in second.reason


def test_a_reference_that_would_take_too_long_is_refused_and_what_is_advised_instead_is_done():
    """In its time, the laws of the run included: nearly undamped, it takes the reference of s longer than the rest."""
    scene = double_well().with_(t_end=3e3, gamma=1e-4)
    with pytest.raises(OutOfTime) as refused:
        cb.compare(scene, ["rk4"], [1e-2], budget=0.5)
    more, t_end = re.search(r"--budget ([\d.]+)s \(budget=\1\), t_end=([\d.]+)", str(refused.value)).groups()
    assert float(more) > 5.0
    found = cb.compare(scene.with_(t_end=float(t_end)), ["rk4"], [1e-2], budget=0.5)
    assert found.attrs["seconds"] < 2 * schedule.LEAST_REFERENCE


def test_copies_of_a_frame_share_the_rows_of_every_setting(frame):
    assert frame.copy().attrs["runs"] is frame.attrs["runs"]


def test_what_cannot_be_had_in_high_precision_has_a_reference_that_two_solvers_agree_on(monkeypatch):
    """By a function of floats, and where there is no time for more digits: a linear force, known in closed form."""
    of_tables = {
        "potential": lambda q, omega: omega * omega * float(q[0]) ** 2 / 2,
        "gradient": lambda q, omega: (omega * omega * float(q[0]),),
    }
    scene = cb.SCENES["oscillator"].with_(name="table", exact=None, **of_tables)
    t = np.array([4.95, 2.03])  # times of no frozen state
    known = cb.reference(cb.SCENES["oscillator"], t).y

    def late(*_, **__):
        raise OutOfTime("late")

    of_floats = cb.reference(scene, t)
    monkeypatch.setattr(sys.modules["contactbench.truth.reference"], "live", late)
    out_of_time = cb.reference(cb.SCENES["oscillator"].with_(exact=None), t)
    for found in (of_floats, out_of_time):
        assert found.source == "two solvers"
        assert 10 <= found.digits <= 15
        np.testing.assert_allclose(found.y, known, rtol=0, atol=10.0**-found.digits)


# -- interruption, budget --------------------------------------------------------------------------
def test_control_c_ends_it_with_what_there_is(monkeypatch):
    turns = Search.turns

    def stopped(search):
        if search.method.name == "contact-strang":
            raise KeyboardInterrupt
        yield from turns(search)

    monkeypatch.setattr(Search, "turns", stopped)
    found = cb.compare("particle", ["rk4", "contact-strang", "herglotz2"], (0.5,), budget=20.0)
    assert found.attrs["interrupted"]
    assert list(found["status"]) == ["ok", "interrupted", "interrupted"]
    assert found["time_s"][0] > 0


def test_what_the_fewest_rounds_have_no_time_for_is_not_timed_and_says_so():
    race, run = race_of("rk4", "contact-strang"), SimpleNamespace(bare_call=lambda: lambda: None)
    quick, _ = (tried(each, t, 1e-3, run=run) for each, t in zip(race.searches, (1e-3, 100.0), strict=True))
    race.time()
    assert race.times.keys() == {id(quick)}
    assert compare.row(race, race.searches[1], 1e-2)["reason"] == "too slow for the time that was left"


def test_a_method_that_breaks_is_a_row(monkeypatch):
    def broken(self, request):
        raise RuntimeError("no compiler found")

    monkeypatch.setattr(type(cb.METHODS["cvode-bdf"]), "prepare", broken)
    found = cb.compare("particle", ["cvode-bdf"], (1e-2,), budget=60.0)
    assert list(found["status"]) == ["failed"]
    assert "no compiler found" in found["reason"][0]


def test_a_turn_is_given_up_when_it_goes_on_for_too_long():
    """Between the runs of a setting; no setting of it is a row."""
    race = race_of("rk4", "herglotz2")
    for each in race.searches:
        each.question = replace(race.question, deadline=0.0)
    race.search()
    assert [each.attempts for each in race.searches] == [[], []]
    assert [each.why for each in race.searches] == [("budget", "no time was left to begin it")] * 2


def test_what_compiles_as_slowly_as_others_of_its_engine_did_is_begun_in_time_only():
    race = race_of("rk4", "herglotz2")
    race.searches[0].compile_s, race.searches[0].why = 100.0, ("failed", "")
    race.search()
    assert race.searches[1].why[0] == "budget"
    assert "compiling it takes about 1e+02 s" in race.searches[1].why[1]


# -- verdicts --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("times", "halves", "expected"),
    [
        ([1.0, 1.1, 3.0], 1.0, ["win", "loss", "loss"]),
        ([1.0, 1.03, 3.0], 1.0, ["tie", "tie", "loss"]),
        ([1.0, 1.1, 3.0], 1.1, ["tie", "tie", "loss"]),
        ([1.0, 1.1, 3.0], 0.5, ["undecided", "undecided", "loss"]),
        ([1.0, 1.1, math.nan], math.nan, ["undecided", "undecided", ""]),
        ([1.0, math.nan, math.nan], 1.0, ["win", "", ""]),
    ],
)
def test_a_tie_is_within_the_margin_of_its_pair(times, halves, expected):
    """The halves of the first call's visits agree; those of the second do not."""
    clock = {"time_s": times, "time_halves_ratio": [1.0, halves, 1.0]}
    frame = pd.DataFrame({"kind": "compiled", "error_asked": 1e-3} | clock)
    assert list(with_verdicts(frame)["verdict"]) == expected


@pytest.mark.parametrize(
    ("status", "spent", "expected"),
    [
        ("budget", 0.5, "undecided"),  # timed once it may have taken twice as long as it takes
        ("budget", 1.9, "undecided"),
        ("budget", 2.1, "win"),
        ("interrupted", None, "undecided"),
        ("failed", 0.5, "win"),
    ],
)
def test_nobody_wins_where_a_rival_was_cut_off_that_might_be_sooner_done(status, spent, expected):
    race = race_of("rk4", "herglotz2", "contact-strang")
    first, second, rival = race.searches
    for each, seconds in ((first, 1.0), (second, 3.0)):
        race.times[id(tried(each, seconds, 1e-3))] = {"time_min_s": seconds, "time_halves_ratio": 1.0}
    rival.why = (status, "")
    if spent:
        tried(rival, spent, 0.1)
    rows = pd.DataFrame([compare.row(race, each, 1e-2) for each in race.searches])
    frame = with_reasons(with_verdicts(rows))
    assert list(frame["verdict"]) == [expected, "loss", ""]
    assert frame["reason"].str.contains("nobody knows: contact-strang").iloc[0] == (expected == "undecided")
    assert frame["reason"].iloc[1] == ""


def test_what_is_undecided_says_why():
    """Of two times that the clock does not tell apart both do; the third is a loss and needs no reason."""
    clock = {"time_s": [1.0, 1.1, 3.0], "time_halves_ratio": [1.0, 0.5, 1.0], "at_least": math.nan}
    known = {"kind": "compiled", "error_asked": 1e-3, "method": ["a", "b", "c"], "status": "ok", "reason": ""}
    frame = with_reasons(with_verdicts(pd.DataFrame(known | clock)))
    unclear = frame["reason"].str.startswith("times cannot be told apart within a factor of ")
    assert list(unclear) == [True, True, False]
    frame.attrs["unbegun"] = []
    assert [line.split(": ")[:2] for line in race.cuts(frame)] == [["a and b", "undecided"]]


def test_fixed_steps_grow_on_a_scene_that_slows_down():
    """By equal steps the same errors take three and five times the evaluations."""
    found = cb.compare("lane_emden_5", ["contact-rkn6", "rk4"], [1e-6], budget=30.0)
    assert found["setting"].str.contains(" steps of ").all()
    assert (found["evaluations"] < [150, 300]).all()
    assert found["contact_drift"].iloc[0] < 1e-13


def test_a_reference_of_ones_own_is_taken():
    """The closed form: the same winners' errors; another solution is not reached; other shapes are refused."""
    scene = cb.SCENES["oscillator"].with_(t_end=5.0)

    def known(t):
        return cb.reference(scene, t, ()).y

    frame = cb.compare(scene, ["contact-rkn6"], errors=[1e-6], budget=5, reference=known)
    assert frame.attrs["reference"]["source"] == "given"
    assert (frame["status"] == "ok").all()
    other = cb.compare(scene, ["contact-rkn6"], errors=[1e-6], budget=5, reference=lambda t: 1.5 * known(t))
    assert other["time_s"].isna().all()
    with pytest.raises(cb.BadInput, match="reference: gives shape"):
        cb.compare(scene, ["rk4"], reference=lambda t: known(t)[:, :1])


# -- who begins, and when --------------------------------------------------------------------------
def test_every_method_has_a_first_run_before_any_has_a_second():
    """High orders first."""
    names = ["rk4", "contact-rkn8", "scipy-dop853", "contact-strang", "cvode-adams"]
    schedule, seen = race_of(*names, errors=(1e-3,)), list[str]()
    for each in schedule.searches:
        attempt = each.attempt
        each.attempt = lambda value, each=each, attempt=attempt: (
            seen.append(each.method.name) or attempt(value)
        )
    schedule.search()
    first = ["contact-rkn8", "scipy-dop853", "cvode-adams", "rk4", "contact-strang"]
    assert seen[:5] == first
    assert schedule.unbegun == []


@pytest.mark.slow
def test_where_not_all_can_begin_those_that_have_go_on_and_the_others_are_named_first(monkeypatch, clock):
    """Compiling takes a seventh of the search."""
    attempt = Search.attempt

    def slow(search, value):
        if not search.attempts:
            clock.added += 1.5
        return attempt(search, value)

    monkeypatch.setattr(Search, "attempt", slow)
    names = [name for name in cb.METHODS if name.startswith("contact-") and name != "contact-exact"][:12]
    found = cb.compare("particle", names, (1e-2,), budget=16.0)
    assert 1 <= found["time_s"].notna().sum() <= 8
    unbegun = found.attrs["unbegun"]
    assert set(unbegun) == set(
        found.loc[found["reason"].str.startswith(("no time was left to", "comp")), "method"]
    )
    first = " ".join(race.text(found).partition("\n\n")[0].split())
    assert first == f"Not begun, for want of time (--budget): {', '.join(unbegun)}."
    assert "compiling it takes" not in race.text(found)


def test_the_attitude_of_a_body_is_part_of_the_race_unless_its_user_says_no():
    body = cb.RigidBody(name="own", inertia=(1, 2, 3), damping=(0.1, 0.2, 0.3), M=(0.3, 1.0, 0.2), t_end=5.0)
    assert carry_of(cb.SCENES["rigid_body"]) == carry_of(body) == ("R",)
    assert carry_of(body.with_(attitude=False)) == ()
    frame = cb.compare(body, ["rk8-7"], [1e-6], budget=10.0)
    (row,), setting = frame.to_dict("records"), float(frame["setting"][0].partition("=")[2])
    assert frame.attrs["carry"] == ["R"]
    assert row["error_reached"] <= 1e-6
    run = cb.solve(body, "rk8-7", rtol=setting, save_at=[5.0])
    turned = rotation_matrix(cb.reference(body, [5.0]).states().R)
    assert np.abs(run.R[0] - np.array(turned)[..., 0]).max() <= 2e-6
    with pytest.raises(cb.BadInput, match="attitude = False"):
        cb.SCENES["heavy_top"].with_(attitude=False)
