"""A comparison on one scene: what it claims is so, what it cannot do it says, and it ends when told."""

import re
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import contactbench as cb
from cases import Clock, Ticks, mine, reading
from contactbench.cli import main
from contactbench.errors import BadInput
from contactbench.measure.clock import Race
from contactbench.methods.base import ENGINES
from contactbench.runs.search import Search
from contactbench.runs.settings import ENDS
from contactbench.study import compare, field, race, schedule
from contactbench.study.compare import COLUMNS, frame_of
from contactbench.truth import OutOfTime
from frames import race_of, tried

RACED = ["contact-strang", "rk4", "cyrk-vern8", "contact-exact", "scipy-dop853"]
ERRORS = (1e-2, 1e-5)
#: its truth is a closed form
OWN = cb.SCENES["oscillator"].with_(name="own", gamma=0.07, t_end=20.0)


@pytest.fixture(scope="module")
def frame():
    with reading(Clock()):
        return cb.compare(OWN, RACED, ERRORS, budget=120.0)


def budget(seconds=60.0):
    return schedule.Budget(seconds, schedule.perf_counter(), progress=False)


# -- what is claimed -------------------------------------------------------------------------------
def test_a_row_for_each_method_and_error_typed(frame):
    pairs = list(zip(frame["method"], frame["error_asked"], strict=True))
    assert pairs == [(m, e) for m in RACED for e in ERRORS]
    assert {name: str(frame[name].dtype) for name in frame.columns[: len(COLUMNS)]} == COLUMNS
    assert [ENGINES[engine] for engine in frame["engine"]] == list(frame["kind"])
    assert frame.copy().attrs["runs"] is frame.attrs["runs"]
    assert frame.groupby(["kind", "error_asked"])["ratio"].min().eq(1.0).all()
    refused = frame[frame["method"] == "contact-exact"]
    assert {*refused["status"]} == {"unsupported"}
    assert refused["reason"].str.contains("rigid bodies").all()
    assert refused["time_s"].isna().all()


def test_the_error_said_is_the_largest_of_five_runs_and_no_larger_than_asked(frame):
    """Measured again, in another way: every end on its own, against the reference at that time."""
    exact = cb.reference(OWN, OWN.t_end * np.arange(1, ENDS + 1) / ENDS, ()).y
    values = {(run["method"], run["setting"]): run["value"] for run in frame.attrs["runs"]}  # of all digits
    done = frame[frame["status"] == "ok"]
    assert len(done) == 8
    for row in done.itertuples():
        setting = {row.setting.split("=")[0]: values[row.method, row.setting]}
        errors = []
        for k, truth in enumerate(exact, start=1):
            run = cb.solve(OWN, row.method, save_at=[OWN.t_end * k / ENDS], carry=(), **setting)
            errors.append(run.y[-1] - truth)
        states = np.array([OWN.pack(OWN.initial(())), *exact])
        halves = zip(np.split(np.array(errors), 2, axis=1), np.split(states, 2, axis=1), strict=True)  # q, p
        largest = max(np.linalg.norm(a, axis=1).max() / np.linalg.norm(b, axis=1).max() for a, b in halves)
        assert largest == pytest.approx(row.error_reached, rel=1e-6)
        assert row.error_reached <= row.error_asked


def test_no_coarser_setting_that_was_tried_is_as_accurate(frame):
    runs = pd.DataFrame(frame.attrs["runs"])
    for row in frame[frame["status"] == "ok"].itertuples():
        own = runs[(runs["method"] == row.method) & (runs["status"] == "ok")]
        tighter = frame[(frame["method"] == row.method) & (frame["error_asked"] < row.error_asked)]
        if row.setting in set(
            tighter["setting"]
        ):  # it was sooner done than the coarser one, whatever it evaluates
            continue
        cheaper = own[own["evaluations"] < row.evaluations]
        assert (cheaper["error"] > row.error_asked).all()
        # and the setting is near the edge: the next cheaper one tried is within a step of the bisection
        if len(cheaper):
            assert row.evaluations / cheaper["evaluations"].max() < 1.5


def test_a_tighter_setting_that_is_sooner_done_stands_at_the_looser_error_too():
    errors = (1e-3, 1e-6, 1e-9, 1e-12)
    (one,) = race_of("rk4", errors=errors)
    coarse, fine, finest = (tried(one, 0.0, e, e, evaluations=round(1 / e), kind="rhs") for e in errors[:3])
    clock = {id(coarse): {"time_s": 182e-6}, id(fine): {"time_s": 111e-6}}
    found = [compare.row(one.question, one, error, {}, clock)["setting"] for error in errors]
    assert found == [fine.setting, fine.setting, finest.setting, finest.setting]


def test_a_contact_method_keeps_the_contact_form_and_a_runge_kutta_method_does_not(frame):
    own = frame.set_index(["method", "error_asked"])
    for error in ERRORS:
        assert "η" in own["laws_kept"]["contact-strang", error].split(", ")
        assert own["laws_kept"]["rk4", error] == ""
    assert own["contact_drift"]["contact-strang", 1e-2] < 1e-12 < own["contact_drift"]["rk4", 1e-2]


def test_nothing_below_the_error_of_the_reference_is_claimed(frame):
    assert frame.attrs["reference"]["digits"] >= 12
    (one,) = race_of("rk4", errors=(1e-3, 1e-6))
    truth = replace(one.question.truth, digits=4)
    question = replace(one.question, truth=truth)
    for error in question.errors:
        tried(one, 1.0, error / 100)
    first, second = frame_of(question, [one], {}, {}).itertuples()
    assert (first.status, first.error_reached) == ("ok", 1e-4)
    assert (second.status, second.verdict) == ("unresolved", "")
    assert "known to 1.0e-04 only" in second.reason


# -- scenes ----------------------------------------------------------------------------------------
BODY = cb.SCENES["rigid_body"]


@pytest.mark.parametrize(
    ("scene", "method", "carry", "setting"),
    [
        (cb.SCENES["quadratic_damping"], "contact-rkn4", ["s"], "step="),
        (cb.SCENES["lane_emden_5"], "contact-rkn6", [], " steps of "),  # they grow
        (BODY, "rk8-7", ["R"], "rtol="),
        (BODY.with_(attitude=False), "rk8-7", [], "rtol="),
    ],
    ids=["action", "growing", "attitude", "momentum"],
)
def test_all_that_acts_on_the_motion_is_part_of_the_error(scene, method, carry, setting):
    """The truth is that of the fields carried, s where it acts and R unless its user says no."""
    frame = cb.compare(scene, [method], [1e-5], budget=60.0)
    (row,) = frame.to_dict("records")
    assert frame.attrs["carry"] == carry
    assert setting in row["setting"]
    assert row["error_reached"] <= 1e-5
    if (control := setting.strip("=")) in ("step", "rtol"):
        (given,) = (run["value"] for run in frame.attrs["runs"] if run["setting"] == row["setting"])
        run = cb.solve(scene, method, save_at=[scene.t_end], carry=carry, **{control: given})
        assert np.abs(run.y[-1] - cb.reference(scene, [scene.t_end], carry).y[0]).max() < 1e-4


# -- references ------------------------------------------------------------------------------------
def test_a_reference_that_would_take_too_long_is_refused_and_what_is_advised_instead_is_done(monkeypatch):
    """Of one that takes its time for every hundred units of t."""

    def slow(scene, times, carry, seconds):
        if scene.t_end > 100:
            raise OutOfTime("too late", seconds * scene.t_end / 100)
        return cb.reference(scene, times, carry)

    monkeypatch.setattr(schedule, "reference", slow)
    monkeypatch.setattr(schedule, "LEAST_REFERENCE", 2.0)
    with pytest.raises(OutOfTime) as refused:
        cb.compare(OWN.with_(t_end=3e3), ["rk4"], [1e-2], budget=0.5)
    more, t_end = re.search(r"--budget ([\d.]+)s \(budget=\1\), t_end=([\d.]+)", str(refused.value)).groups()
    assert float(more) * schedule.REFERENCE == pytest.approx(60.0)
    found = cb.compare(OWN.with_(t_end=float(t_end)), ["rk4"], [1e-2], budget=0.5)
    assert found.attrs["reference"]["digits"] > 12


def test_a_reference_of_ones_own_is_taken():
    """The closed form: the same winners' errors; another solution is not reached; other shapes are refused."""

    def known(t):
        return cb.reference(OWN, t, ()).y

    frame = cb.compare(OWN, ["contact-rkn6"], errors=[1e-6], budget=60, reference=known)
    assert frame.attrs["reference"]["source"] == "given"
    assert (frame["status"] == "ok").all()
    other = cb.compare(OWN, ["contact-rkn6"], errors=[1e-6], budget=60, reference=lambda t: 1.5 * known(t))
    assert other["time_s"].isna().all()
    with pytest.raises(cb.BadInput, match="reference = 'gives shape"):
        cb.compare(OWN, ["rk4"], reference=lambda t: known(t)[:, :1])


# -- interruption, budget --------------------------------------------------------------------------
def interrupt(*_):
    raise KeyboardInterrupt


def test_control_c_in_the_search_ends_it_with_what_there_is(monkeypatch, unconfirmed):
    turns, names = Search.turns, ["rk4", "contact-strang", "herglotz2"]
    monkeypatch.setattr(
        Search, "turns", lambda one: map(interrupt, [0]) if one.method.name == names[1] else turns(one)
    )
    found = cb.compare("particle", names, (0.5,), budget=60.0)
    assert found.attrs["interrupted"]
    assert list(found["status"]) == ["ok", "interrupted", "interrupted"]
    assert found["time_s"][0] > 0
    assert "Interrupted" in race.text(found)


def test_control_c_at_the_clock_leaves_what_was_timed(monkeypatch):
    (one,), sweep = race_of("rk4"), Race.sweep
    attempt = tried(one, 1e-3, 1e-3, run=SimpleNamespace(bare_call=lambda: lambda: None))
    monkeypatch.setattr(Race, "sweep", lambda self, *given: map(interrupt, sweep(self, *given)))
    time = budget()
    assert schedule.time_runs(one.question, [one], time).keys() == {id(attempt)}
    assert time.interrupted


def test_what_the_fewest_rounds_have_no_time_for_is_not_timed_and_says_so():
    searches, run = race_of("rk4", "contact-strang"), SimpleNamespace(bare_call=lambda: lambda: None)
    quick, _ = (tried(each, t, 1e-3, run=run) for each, t in zip(searches, (1e-3, 100.0), strict=True))
    clock = schedule.time_runs(searches[0].question, searches, budget())
    assert clock.keys() == {id(quick)}
    found = frame_of(searches[0].question, searches, {}, clock)
    assert list(found["reason"]) == ["", "too slow for the time that was left"]


def test_a_method_that_breaks_is_a_row(monkeypatch, unconfirmed):
    def broken(self, request):
        raise RuntimeError("no compiler found")

    monkeypatch.setattr(type(cb.METHODS["cvode-bdf"]), "prepare", broken)
    found = cb.compare("particle", ["cvode-bdf"], (1e-2,), budget=60.0)
    assert list(found["status"]) == ["failed"]
    assert "no compiler found" in found["reason"][0]


def test_a_setting_is_given_up_between_its_runs_when_it_goes_on_for_too_long():
    question = replace(race_of("rk4")[0].question, deadline=0.0)
    found = schedule.search(question, ["rk4", "herglotz2"], ["rk4"], budget())
    assert [(each.attempts, each.why) for each in found] == [([], schedule.NOT_BEGUN)] * 2


def test_what_compiles_for_long_is_not_begun_without_the_time_for_it():
    with reading(Ticks(1e-6)):
        question, time = race_of("rk4")[0].question, budget(4.0)
        found = schedule.search(
            question, ["heyoka-taylor", "diffrax-dopri8", "rk4"], ["diffrax-dopri8"], time
        )
    assert [bool(each.attempts) for each in found] == [True, False, True]
    assert found[1].why == schedule.NOT_BEGUN


def test_where_not_all_can_begin_the_first_go_on_and_the_others_are_named(monkeypatch, clock):
    """Compiling takes a fifth of the search; those that may lead are before the others."""
    attempt = Search.attempt

    def slow(search, value):
        clock.added += 0.0 if search.attempts else 2.0
        return attempt(search, value)

    monkeypatch.setattr(Search, "attempt", slow)
    names = ["contact-bm6", "contact-rkn4", "rk8", "herglotz2", "contact-strang", "rkn8", "rk4"]
    (one,), time = race_of("rk4"), budget(16.0)
    found = schedule.search(one.question, names, names[1:], time)
    done = [each.method.name for each in found if each.done]
    assert done == names[1 : 1 + len(done)]
    assert 1 <= len(done) <= 5
    frame = frame_of(one.question, found, {}, {})
    assert frame["status"].ne("ok").sum() == len(names) - len(done)
    assert found[0].why == found[-1].why == schedule.NOT_BEGUN


# -- verdicts --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("status", "spent", "expected"),
    [
        ("budget", 0.5, "undecided"),  # timed once it may have taken twice as long as it takes
        ("budget", 1.9, "undecided"),
        ("budget", 2.1, "win"),
        ("interrupted", 0.5, "undecided"),
        ("failed", 0.5, "win"),
        ("budget", None, "win"),  # it was not begun, and that is said
    ],
)
def test_nobody_wins_where_a_rival_was_cut_off_that_might_be_sooner_done(status, spent, expected):
    searches, clock = race_of("rk4", "herglotz2", "contact-strang"), {}
    for each, seconds in zip(searches, (1.0, 3.0), strict=False):
        clock[id(tried(each, seconds, 1e-3))] = {"time_s": seconds, "halves": 1.0}
    searches[2].why = (status, "")
    if spent:
        tried(searches[2], spent, 0.1)
    frame = frame_of(searches[0].question, searches, {}, clock)
    assert list(frame["verdict"]) == [expected, "loss", ""]
    assert frame["reason"].str.contains("may be faster: contact-strang").iloc[0] == (expected == "undecided")
    assert frame["reason"].iloc[1] == ""


def test_what_is_undecided_says_why():
    """Of two times that the clock does not tell apart both do; the third is a loss and needs no reason."""
    searches, clock = race_of("rk4", "herglotz2", "contact-strang"), {}
    for each, seconds, halves in zip(searches, (1.0, 1.1, 3.0), (1.0, 0.5, 1.0), strict=True):
        clock[id(tried(each, seconds, 1e-3))] = {"time_s": seconds, "halves": halves}
    frame = frame_of(searches[0].question, searches, {}, clock)
    assert list(frame["verdict"]) == ["undecided", "undecided", "loss"]
    unclear = frame["reason"].str.startswith("times cannot be told apart within a factor of 2")
    assert list(unclear) == [True, True, False]


# -- every method on molecules -----------------------------------------------------------------------
#: seconds of the quick part
SHORT = 3.0
#: where the Lennard-Jones and the Buckingham pair rest
LJ_REST, BUCKINGHAM_REST = 2 ** (1 / 6), 1.0


def morse(r):
    return (1 - cb.math.exp(-r)) ** 2


def steep_morse(r):
    return 5 * (1 - cb.math.exp(-3 * r)) ** 2


def lennard_jones(r2):
    return 4 * (r2**-6 - r2**-3)


def buckingham(r2):
    r = cb.math.sqrt(r2)
    return 2e4 * cb.math.exp(-10 * r) - 1 / (r2 * r2 * r2)


def atoms(n, pair, rest, seed, stretch, heat, t_end=30.0):
    """n atoms on a line, neighbours bound to each other: pair(r) at the distance r; displaced and hot at random."""
    q, p = np.random.default_rng(seed).standard_normal((2, n))
    potential = lambda q: sum(pair(b - a) for a, b in pairwise(q))  # noqa: E731
    start = {"q": rest * np.arange(n) + stretch * q, "p": heat * p}
    return cb.Mechanical(name="line", potential=potential, gamma=0.1, t_end=t_end, **start)


#: a molecule, and its budget in seconds
MOLECULES = {
    "Morse, 20 atoms": (lambda: atoms(20, lambda r: morse(r - 1), 1.0, 0, 0.3, 0.3), 60.0),
    "Morse, steep, 12 atoms, hot": (lambda: atoms(12, lambda r: steep_morse(r - 1), 1.0, 2, 0.2, 2.0), 30.0),
    "Morse, three bonds": (lambda: atoms(4, lambda r: morse(r - 1), 1.0, 0, 1.0, 1.0), 40.0),
    "Lennard-Jones, 8 atoms": (
        lambda: atoms(8, lambda r: lennard_jones(r * r), LJ_REST, 5, 0.03, 0.3, 20.0),
        40.0,
    ),
    "Buckingham, two atoms that part": (
        lambda: atoms(2, lambda r: buckingham(r * r), BUCKINGHAM_REST, 9, 0.0, 1.0),
        20.0,
    ),
}


def outcome_of(scene, budget):
    """Return the frame of a race, or why there is none."""
    try:
        return cb.compare(scene, budget=budget)
    except cb.BadInput as why:
        return str(why)


def unexplained(outcome):
    """Return what of a race has neither a verdict nor, for every method, one line that says why not."""
    if isinstance(outcome, str):
        return [outcome] if "\n" in outcome else []
    return [
        key
        for key, part in outcome.groupby(["kind", "error_asked"])
        if not (part["verdict"].isin(["win", "tie", "undecided"]).any() or part["reason"].ne("").all())
    ]


@pytest.mark.quick(name="Morse, three bonds")
@pytest.mark.parametrize("name", MOLECULES)
def test_a_race_of_a_molecule_names_winners_or_reasons(name, request, unconfirmed):
    make, budget = MOLECULES[name]
    if request.config.option.markexpr.startswith("not slow"):
        budget = SHORT
    assert not unexplained(outcome_of(make(), budget))


# -- which methods race by default -------------------------------------------------------------------
OSCILLATOR = cb.SCENES["oscillator"]


@pytest.fixture
def planted(monkeypatch):
    """Plant the cost of each method on each of some random problems, by its number."""

    def plant(costs, damping=lambda k: 0.1, count=50):
        problems = [
            {"seed": 1, "scene": f"a-{k}", "kind": "mechanical", "hard": "", "damping": damping(k)}
            for k in range(count)
        ]
        problems.append(problems[0] | {"scene": "b-0", "hard": "stiff"})  # where another one leads
        rows = [
            {"seed": 1, "scene": f"a-{k}", "method": method, "error": 1e-6, "status": "ok"}
            | {"evaluations": cost(k), "time_s": 1e-8 * cost(k)}
            for k in range(count)
            for method, cost in costs.items()
        ]
        rows.append(rows[0] | {"scene": "b-0", "method": "cvode-bdf"})
        tables = {"population": pd.DataFrame(rows), "problems": pd.DataFrame(problems)}
        monkeypatch.setattr(field, "results", tables.__getitem__)

    return plant


def beside(scene=OSCILLATOR):
    return [name for name in field.field(scene, [1e-6]) if name not in field.contestants()]


@pytest.mark.parametrize(
    ("cost", "leads"),
    [
        (lambda k: 1.2, True),
        (lambda k: 1.3, False),
        (lambda k: 1.0 if k % 5 == 0 else 9.0, True),  # on a fifth
        (lambda k: 1.0 if k % 6 == 0 else 9.0, False),
    ],
)
def test_a_method_leads_that_is_near_the_least_on_a_part_of_the_problems(planted, cost, leads):
    planted({"rkn12": lambda k: 1.0, "contact-rkn8": lambda k: 1.0, "rk8": cost})
    assert {*beside()} == {"rkn12", "contact-rkn8", *["rk8"] * leads}


@pytest.mark.parametrize(("gamma", "first"), [(1e-4, "contact-rkn8"), (1.0, "contact-rkn4")])
def test_problems_of_the_nearest_damping_are_asked(planted, gamma, first):
    halves = {"contact-rkn8": True, "contact-rkn4": False}
    weak = {name: lambda k, own=own: 1.0 if (k < 50) == own else 9.0 for name, own in halves.items()}
    planted(weak, damping=lambda k: 1e-4 if k < 50 else 1.0, count=100)
    assert beside(OSCILLATOR.with_(gamma=gamma)) == [first]


def test_what_cannot_run_a_scene_neither_races_nor_keeps_others_from_leading(planted):
    planted({"contact-exact": lambda k: 1.0, "contact-rkn8": lambda k: 3.0, "rk8": lambda k: 9.0})
    assert beside() == ["contact-rkn8"]


def test_the_best_contact_methods_race_where_others_lead(planted):
    planted({"rkn12": lambda k: 1.0, "contact-rkn8": lambda k: 5.0, "contact-bm6": lambda k: 9.0})
    assert {*beside()} == {"rkn12", "contact-rkn8"}


def test_the_contestants_and_a_method_of_ones_own_always_race(planted, registries):
    @cb.fixed_step("my-own", order=2)
    def my_own(scene, x, h, xp):
        return x

    planted({"contact-rkn8": lambda k: 1.0})
    assert field.field(OSCILLATOR, [1e-6]) == ["contact-rkn8", *field.contestants(), "my-own"]
    engines = {cb.METHODS[name].engines[0] for name in field.contestants()}
    assert {"llvm", "python", "c", "jax"} <= engines


KINDS = [*map(cb.SCENES.get, ("heavy_top", "double_pendulum", "rigid_body"))]
KINDS.append(cb.Equations(name="own", rhs=lambda t, y: (y[1], -y[0]), y0=(1.0, 0.0), t_end=5.0))
KINDS.append(mine(lambda q: float(q[0]) ** 2 / 2, name="floats", gradient=lambda q: (float(q[0]),)))
KINDS.append(mine(lambda q: q[0] ** 2, name="rest", q=0.0))


@pytest.mark.parametrize("scene", KINDS, ids=lambda scene: scene.name)
def test_some_methods_race_on_every_kind_of_scene_a_contact_method_among_them(scene):
    found = [cb.METHODS[name] for name in field.field(scene, compare.ERRORS)]
    assert 7 <= len(found) <= field.MOST_LEADERS + len(field.contestants())
    assert all(method.refuses(scene) is None for method in found)
    contact = any(method.family == "contact" for method in found)
    assert contact != isinstance(scene, cb.Equations)


def test_without_tables_there_is_no_field(monkeypatch):
    def missing(name):
        raise BadInput("no result tables in this installation")

    monkeypatch.setattr(field, "results", missing)
    assert field.field(OSCILLATOR, [1e-6]) == []


@pytest.mark.parametrize(
    ("methods", "known", "raced", "leading", "budget"),
    [
        (None, ["rk4"], ["rk4"], ["rk4"], compare.BUDGET),
        (None, [], [*cb.METHODS], [*cb.METHODS], compare.BUDGET),
        (
            "all",
            ["rk4"],
            ["rk4", *(name for name in cb.METHODS if name != "rk4")],
            ["rk4"],
            compare.LONG_BUDGET,
        ),
        (["rk8", "rk4", "rk8"], ["rkn8"], ["rk8", "rk4"], ["rk8", "rk4"], compare.LONG_BUDGET),
    ],
)
def test_who_races_and_for_how_long(monkeypatch, unconfirmed, methods, known, raced, leading, budget):
    taken = []
    monkeypatch.setattr(compare, "field", lambda scene, errors: known)
    monkeypatch.setattr(compare, "search", lambda question, *given: taken.append(given) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        cb.compare("oscillator", methods)
    ((found, first, time),) = taken
    assert (found, first, time.seconds) == (raced, leading, budget)


@pytest.mark.parametrize(
    ("line", "given"), [("", None), ("--all", "all"), ("rk4 --all", ["rk4"]), ("rk4", ["rk4"])]
)
def test_the_command_races_all_where_it_is_told(monkeypatch, capsys, line, given):
    taken = []
    monkeypatch.setattr(cb, "compare", lambda scene, methods, *_, **__: taken.append(methods) or 1 / 0)
    assert main(["compare", "particle", *line.split()]) == 2
    assert taken == [given]
