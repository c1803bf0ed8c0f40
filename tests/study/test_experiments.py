"""The benchmark: its profiles, what is run and how far, what is timed and how often, and a disk that is full."""

import math
import re
from collections import Counter

import pytest

import contactbench as cb
from cases import HARD, REPOSITORY, bench, few_slow, own_processes
from contactbench.measure.clock import Visit
from contactbench.methods.fixed_step import FixedStep
from contactbench.runs import grid
from contactbench.runs.experiment import PROFILES, Timing, experiments
from contactbench.runs.grid import FEW, SMALLEST, cells, climb, engines, look_along, run
from contactbench.runs.rows import along, bare, ended, passes_through
from contactbench.runs.runner import Run
from contactbench.runs.search import step_at, tolerance_at
from contactbench.runs.settings import (
    ALONG,
    DEAREST,
    ENDS,
    SAVES,
    control_of,
    evaluations_of_step,
    ladder,
    rungs_of_equal_cost,
    steps,
    times,
)
from contactbench.runs.timetable import OTHERS, SPARED, Entry, Timetable
from contactbench.tables.declared import RUNS
from contactbench.tables.schema import PROFILES as NAMES
from contactbench.tables.store import read

SMOKE, STANDARD, FULL = PROFILES.values()


# -- what is timed ---------------------------------------------------------------------------------
class Scripted:
    """A call whose visits take so long, one after the other; `order` says when it was visited."""

    def __init__(self, name, order, *times, lasts=0.001):
        self.name, self.order, self.times, self.lasts = name, order, iter(times), lasts

    def warm_up(self):
        return self.lasts

    def visit(self, rounds=3):
        self.order.append(self.name)
        t = next(self.times)
        return Visit([2 * t, t, 3 * t])


def entry(name, order, recorded, *times, error=1e-3, again=None, lasts=0.001, **key):
    known = {"scene": "s", "method": name, "engine": "llvm", "control": "step", "saved": 1} | key
    record = lambda row: recorded.update({name: (row, len(order))})  # noqa: E731
    return Entry(
        Timing(known, None, (), error), {}, Scripted(name, order, *times, lasts=lasts), again, [record]
    )


def test_visits_are_spread_over_the_timed_part_and_a_row_is_recorded_after_its_last():
    order, recorded, table = [], {}, Timetable(set(), visits=8)
    for name in "abcdef":
        again = Scripted("a again", order, *[3.0] * 8) if name == "a" else None
        table.entries.append(entry(name, order, recorded, *[4.0, 2.0] * 4, again=again))
    table.go()
    size = 7
    sweeps = {tuple(order[k : k + size]) for k in range(0, len(order), size)}
    assert len(sweeps) == 8
    assert {tuple(sorted(sweep)) for sweep in sweeps} == {("a", "a again", *"bcdef")}
    for name, (row, visited) in recorded.items():
        assert (row["method"], row["least_s"], row["halves"]) == (name, 2.0, 0.5)
        assert row.get("process") == (1.5 if name == "a" else None)
        assert visited == 8 * size


#: error, time, and what else is told of a row: who is visited as often as there is time for
CONTENDERS = {
    "the fastest": (1e-3, 1.0, {}, True),
    "a slower one": (1e-3, 1.9, {}, True),
    "a much slower one": (1e-3, 2.1, {}, False),
    "one that is more accurate": (1e-4, 4.0, {}, True),
    "one that is more accurate and slower": (1e-4, 9.0, {}, False),
    "one that is less accurate and slower": (1e-2, 3.0, {}, False),
    "one with callbacks": (1e-3, 50.0, {"engine": "python"}, True),
    "one on another scene": (1e-3, 50.0, {"scene": "other"}, True),
    "one saved at other times": (1e-3, 50.0, {"saved": 1000}, True),
    "by tolerance": (1e-3, 3.0, {"control": "rtol"}, True),
    "by tolerance, and slower": (1e-3, 9.0, {"control": "rtol"}, False),
}


def test_contenders_are_visited_more_often_than_those_that_are_slower_and_no_better():
    order, recorded, table = [], {}, Timetable(set(), visits=8)
    for name, (error, time, key, _) in CONTENDERS.items():
        table.entries.append(entry(name, order, recorded, *[time] * 8, error=error, **key))
    table.go()
    assert Counter(order) == {name: 8 if often else OTHERS for name, (*_, often) in CONTENDERS.items()}
    assert set(recorded) == set(CONTENDERS)


def test_what_lasts_long_is_visited_less_often_and_recorded_once():
    order, recorded, table = [], {}, Timetable(set(), visits=6)
    for name, lasts in {"a": 0.001, "b": 2 * min(SPARED), "c": 2 * max(SPARED)}.items():
        again = Scripted(f"{name} again", order, *[2.0] * 6, lasts=lasts)
        table.entries.append(entry(name, order, recorded, *[2.0] * 6, again=again, lasts=lasts, scene=name))
    # beside c, with which it does not contend
    table.entries.append(entry("d", order, recorded, *[9.0] * 6, lasts=2 * max(SPARED), scene="c"))
    table.go()
    assert Counter(order) == {"a": 6, "a again": 6, "b": 3, "b again": 3, "c": 2, "c again": 2, "d": 2}
    assert set(order[7:9]) == {"a", "a again"}
    assert set(recorded) == {*"abcd"}
    assert all("halves" in row for row, _ in recorded.values())


QUESTION = ("particle", "contact-strang", "llvm", "step", 0.1)


def test_cells_that_time_the_same_call_share_its_visits():
    rows, table = [], Timetable(set(), visits=2)
    key = {"scene": "particle", "method": "contact-strang", "engine": "llvm", "control": "step", "saved": 1}
    with table:
        for _ in range(2):
            table.add(Timing(key, bare, (QUESTION,), 1e-3), rows.append)
        table.go()
    assert len(table.entries) == 1
    assert rows == [rows[0]] * 2


def test_another_process_prepares_and_times_what_it_is_told():
    with Timetable(set(), 8) as table:
        call = table.second(Timing({"engine": "llvm"}, bare, (QUESTION,), 1e-3))
        assert call.warm_up() > 0
        visit = call.visit(2)
        assert len(visit.whole) == 2
        assert min(visit.whole) > 1e-8


def test_what_is_timed_is_a_run_to_the_end_alone_that_ended_well_and_is_not_solved_anew(monkeypatch):
    row = ended(QUESTION)
    timing = experiments()["times"].timing
    monkeypatch.setattr(grid, "ended", None)
    assert timing(row).key == {name: row[name] for name in timing(row).key}
    assert timing(row).error == row["error"]
    assert timing(row | {"saved": SAVES}) is timing(row | {"status": "budget"}) is None
    known, call = bare(*timing(row).arguments)
    assert known.keys() == {"compile_s", "first_s"}
    assert call.run()[:4] == pytest.approx(
        cb.solve(*QUESTION[:2], step=0.1, save_at=[20.0]).y[-1][:4], rel=1e-13
    )


# -- which cells -----------------------------------------------------------------------------------
def test_pytest_has_a_test_of_every_experiment_in_the_file_of_its_question():
    found = {
        path.stem.removeprefix("bench_"): re.findall(r"def test_(\w+)", path.read_text())
        for path in REPOSITORY.glob("bench/bench_*.py")
    }
    every = [(each.question, each.name) for each in experiments().values()]
    assert sorted(every) == sorted((question, name) for question, names in found.items() for name in names)


@pytest.mark.parametrize("experiment", experiments().values(), ids=list(experiments()))
def test_every_cell_of_a_profile_is_one_of_the_next(experiment):
    """What `profile` in a row promises: a larger run has the rows of a smaller one."""
    assert tuple(PROFILES) == NAMES
    smoke, standard, full = (set(experiment.cells(profile)) for profile in PROFILES.values())
    assert standard
    assert smoke <= standard <= full


@pytest.mark.parametrize("name", cb.METHODS)
def test_every_method_is_run_somewhere_and_the_mission_with_all_its_contestants(name):
    standard, full = (set(cells(profile)) for profile in (STANDARD, FULL))
    assert full == {(scene, method) for scene in cb.SCENES for method in cb.METHODS}
    method, here = cb.METHODS[name], {scene for scene, m in standard if m == name}
    mission = {scene.name for scene in cb.SCENES.values() if scene.mission and not method.solves(scene)}
    stiff = {scene.name for scene in cb.SCENES.values() if scene.stiff}
    assert here >= (mission if method.mission or not grid.is_dear(method) else stiff)
    assert not method.like or method.like in cb.METHODS


def test_the_smoke_profile_has_every_scene_and_what_is_soon_compiled():
    smoke = set(cells(SMOKE))
    assert {scene for scene, _ in smoke} == set(cb.SCENES)
    assert {method for _, method in smoke} == {n for n, m in cb.METHODS.items() if not grid.is_dear(m)}


def test_callbacks_are_run_where_the_mission_is_and_elsewhere_the_first_engine_alone():
    for scene in cb.SCENES.values():
        for method in cb.METHODS.values():
            assert engines(scene, method)[0] == method.engines[0]
            assert scene.mission or engines(scene, method) == [method.engines[0]]
    rk4, particle = cb.METHODS["rk4"], cb.SCENES["particle"]
    assert engines(particle, rk4) == list(rk4.engines)
    mine = particle.with_(name="mine")
    assert engines(mine, cb.METHODS["rk8"]) == list(rk4.engines)  # what is brought is run by all there is


# -- which settings --------------------------------------------------------------------------------
FIXED = [method for method in cb.METHODS.values() if isinstance(method, FixedStep)]


@pytest.mark.parametrize("scene", cb.SCENES.values(), ids=cb.SCENES)
def test_a_rung_along_the_motion_costs_all_fixed_steps_the_same(scene):
    costs = {}
    for method in FIXED:
        values = rungs_of_equal_cost(scene, method)
        assert values == sorted(set(values), reverse=True)
        assert max(values) <= scene.t_end / SAVES * (1 + 1e-9)
        if not method.refuses(scene):
            costs[method.name] = [evaluations_of_step(scene, method) / step for step in values]
    finest = {cb.METHODS[name].order <= 2: cost[-1] for name, cost in costs.items()}
    for name, cost in costs.items():
        assert cost[-1] == pytest.approx(finest[cb.METHODS[name].order <= 2]), name


@pytest.mark.parametrize("name", [name for name, m in cb.METHODS.items() if m.adaptive])
def test_every_adaptive_method_gets_its_full_range(name):
    method = cb.METHODS[name]
    tolerances = rungs_of_equal_cost(cb.SCENES["large_step"], method)
    assert tolerances[-1] == method.rtol_range[0] <= ALONG[-1]
    assert tolerances == sorted(set(tolerances), reverse=True)
    assert tolerances[:3] == [*ALONG]


@pytest.mark.parametrize("method", cb.METHODS.values(), ids=cb.METHODS)
def test_a_ladder_falls_and_the_standard_one_is_part_of_it(method):
    scene = cb.SCENES["kepler"]
    every, enough = ladder(scene, method, control_of(scene, method), DEAREST)
    assert every == sorted(set(every), reverse=True)
    assert enough == [value for value in every if value in enough]
    assert 2 * len(enough) >= len(every)
    if method.control == "step":
        assert scene.t_end / every[-1] * evaluations_of_step(scene, method) <= DEAREST


@pytest.mark.parametrize(
    ("falls_by", "floor", "rungs"),
    [
        (256.0, 1e-16, 5),  # 10⁻¹² is passed by the fifth
        (256.0, 1e-10, 6),  # two steps below that at which round-off shows are tried
        (1.6, 1e-16, 99),
    ],
    ids=["passes every error", "meets round-off", "costs too much"],
)
@pytest.mark.parametrize("profile", [SMOKE, STANDARD, FULL], ids=PROFILES)
def test_a_ladder_goes_on_to_the_end_of_what_a_method_can_do(monkeypatch, falls_by, floor, rungs, profile):
    scene, method = cb.SCENES["thermostat"], cb.METHODS["rk8"]
    every, enough = ladder(scene, method, "step", DEAREST)

    def measured(question):
        rung = enough.index(question[-1]) if question[-1] in enough else 0
        error = max(1e-3 * falls_by**-rung, floor)
        return {"status": "ok", "error": error, "setting": question[-1]}

    monkeypatch.setattr(grid, "ended", measured)
    rows = list(climb(scene, method, "llvm", "step", profile))
    last = enough[min(rungs, len(enough)) - 1]
    wanted = {
        SMOKE: enough[:FEW],
        STANDARD: [h for h in enough if h >= last],
        FULL: [h for h in every if h >= last],
    }
    assert {row["setting"] for row in rows} == set(wanted[profile])
    told = {row["setting"]: row["profile"] for row in rows}
    assert all(
        told[h] == (NAMES[0] if h in enough[:FEW] else NAMES[1] if h in enough else NAMES[2]) for h in told
    )


def test_ladders_reach_every_error_where_steps_can():
    scene, method = cb.SCENES["thermostat"], cb.METHODS["rk8"]
    rows = [row for row in climb(scene, method, "llvm", "step", STANDARD) if row["saved"] == 1]
    assert [row.get("error", 1.0) <= SMALLEST for row in rows] == [False] * (len(rows) - 1) + [True]


def test_after_a_spent_budget_no_tighter_tolerance_is_run(monkeypatch):
    ran = []

    def scripted(question, *more):
        ran.append(question[-1])
        return {"setting": question[-1], "status": "budget" if question[-1] < 1e-5 else "ok"}

    monkeypatch.setattr(grid, "along", scripted)
    method = cb.METHODS["cyrk-dop853"]
    rows = list(look_along(cb.SCENES["particle"], method, "c++", STANDARD))
    assert ran == [*ALONG[:2]]
    assert [row["status"] for row in rows] == ["ok", "budget", "budget", "budget"]
    assert all(f"rtol={ALONG[1]:g}" in row["message"] for row in rows[2:])


# -- what a row says -------------------------------------------------------------------------------
def test_a_cell_has_one_row_that_says_why_a_scene_is_refused():
    rows = [row for _, row in run.rows(("rigid_body", "rkn8"), STANDARD)]
    assert [(row["saved"], row["status"]) for row in rows] == [(1, "unsupported"), (SAVES, "unsupported")]
    assert all(row["message"] for row in rows)


@pytest.mark.parametrize(("scene", "method"), [("particle", "contact-rkn4"), ("rigid_body", "cyrk-dop853")])
def test_rows_of_a_cell_have_keys_of_their_own_and_follow_from_the_public_call(scene, method):
    rows = [row for _, row in run.rows((scene, method), STANDARD)]
    assert len({tuple(row[name] for name in RUNS.key) for row in rows}) == len(rows)
    assert {row["profile"] for row in rows} == {NAMES[0], NAMES[1]}
    for row in rows:
        item, saved = cb.SCENES[scene], row["saved"]
        given = {row["control"]: row["setting"], "engine": row["engine"]}
        at = times(item, saved)
        carry = ("R",) if "R" in item.optional else ()
        own = cb.solve(
            scene, method, save_at=at, carry=None if saved == SAVES else carry, dense=saved != SAVES, **given
        )
        assert (row["steps"], row["evaluations"]) == (own.counts.steps, own.counts.rhs_equivalents)
        if saved == SAVES:
            assert row["error"] == cb.LAWS["solution_error"](own)
            assert row["energy_law"] == cb.LAWS["energy_law"](own)


@pytest.mark.parametrize("method", few_slow(FIXED, cb.METHODS["contact-gauss16"]), ids=lambda m: m.name)
def test_fixed_steps_pass_through_the_earlier_ends(method):
    """The error there, of runs of their own and of one that passes through; a processed method has more of it."""
    scene = cb.SCENES["central"]
    ends = times(scene, ENDS).tolist()
    step = steps(scene, method)[2 if method.one_step else 4]  # a history begins with steps too long for it
    own = ended((scene.name, method.name, "python", "step", step))["error"]
    passing = cb.solve(scene, method, save_at=ends, step=step, engine="python", carry=())
    same = cb.LAWS["solution_error"](passing) == pytest.approx(own, rel=1e-6, abs=1e-14)
    assert same == passes_through(scene, method, "python", "step")


def test_a_law_is_judged_by_what_the_run_claims():
    row = along(("particle", "contact-strang", "llvm", "step", 0.05))
    assert row["contact_drift_claimed"]
    assert row["contact_drift_kept"]
    assert row["contact_drift"] <= row["bound"] == 1e-12
    other = along(("particle", "rk4", "llvm", "step", 0.05))
    assert not other["contact_drift_claimed"]
    assert not other["contact_drift_kept"]
    without = along(("particle", "cyrk-dop853", "c++", "rtol", 1e-7), "on the mission's scenes only")
    assert "contact_drift" not in without
    assert "contact_drift_kept" not in without


def test_nothing_is_judged_of_a_motion_that_ends_in_infinity():
    for scene in HARD:
        if scene.name == "escape":
            row = along(
                (
                    scene.name,
                    "contact-strang",
                    "llvm",
                    "step",
                    rungs_of_equal_cost(scene, cb.METHODS["rk4"])[-1],
                )
            )
            assert (row["truth"], row["status"]) == ("diverged", "diverged")
            assert "error" not in row


# -- settings of equal cost ------------------------------------------------------------------------
RANGE = (1e-13, 1e-1)


def smooth(rtol):
    return 10 * rtol**-0.2


@pytest.mark.parametrize("target", [20.0, 137.0, 2000.0])
def test_a_tolerance_is_found_for_a_cost(target):
    rtol = tolerance_at(smooth, target, RANGE)
    assert smooth(rtol) == pytest.approx(target, rel=0.03)
    assert float(f"{rtol:.3g}") == rtol  # as it is printed


def test_bad_ends_at_loose_tolerances_and_spent_budgets_are_avoided():
    def cost(rtol):
        return 0.0 if rtol > 1e-4 else math.inf if rtol < 1e-9 else smooth(rtol)

    assert smooth(tolerance_at(cost, 300.0, RANGE)) == pytest.approx(300.0, rel=0.03)
    cheapest = smooth(1e-4)
    assert cost(tolerance_at(cost, 15.0, RANGE)) == pytest.approx(cheapest, rel=0.05)


def test_steps_end_at_the_saved_times_and_rotations_count_half():
    for name in ("contact-strang", "contact-rkn4"):
        method, body = cb.METHODS[name], cb.SCENES["rigid_body"]
        n = round(body.t_end / step_at(method, body, 600.0, ENDS))
        assert n % ENDS == 0
        assert method.counts(body, n) / 2 == pytest.approx(600, rel=0.1)


# -- a disk that is full while a benchmark runs ----------------------------------------------------
#: after one file of the run and one of a cell, or when the tables are written, there is no room
FULL_DISK = """
import errno
from contactbench.methods import METHODS
from contactbench.tables import cells

METHODS["rk4"] = METHODS["rk4"].__class__(**vars(METHODS["rk4"]))  # a plug-in registers something

def full(once):
    calls = []
    def write(*arguments, **more):
        calls.append(1)
        if len(calls) > {after}:
            raise OSError(errno.ENOSPC, "No space left on device", "a-file")
        return once(*arguments, **more)
    return write

cells.{name} = full(cells.{name})
"""
KEYWORD = "run and oscillator and not forced and herglotz and not timed"


@pytest.mark.parametrize("bench", few_slow([bench, own_processes], own_processes))
@pytest.mark.parametrize(("name", "after"), few_slow([("replacing", 2), ("merge", 0)], ("merge", 0)))
def test_a_full_disk_is_one_line_and_what_was_finished_is_kept(name, after, bench, tmp_path):
    fault, results = tmp_path / "full.py", tmp_path / "results"
    fault.write_text(FULL_DISK.format(name=name, after=after))
    process = bench(results, KEYWORD, "--plugin", str(fault))
    output, _ = process.communicate(timeout=240)
    assert process.returncode == 2, output
    (line,) = (line for line in output.splitlines() if "No space left" in line)
    assert "--resume" in line
    assert "Traceback" not in output
    Run(results, SMOKE).begin()  # the next one
    assert set(read(RUNS, results)["method"]) == {"herglotz1", *["herglotz2"] * (name == "merge")}
