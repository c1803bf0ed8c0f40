"""The benchmark: its profiles, timed cells, and a disk that is full."""

import math
import re
from collections import Counter
from itertools import chain

import pytest

import contactbench as cb
from cases import REPOSITORY, bench, few_slow, finished, own_processes
from contactbench.measure.clock import Part, Visit
from contactbench.measure.laws import errors_of
from contactbench.methods.fixed_step import FixedStep
from contactbench.paper import CLAIMS
from contactbench.paper.curves import FIGURES
from contactbench.runs import choice, work_precision
from contactbench.runs.choice import DEAR, SMOKE
from contactbench.runs.claims import LONG
from contactbench.runs.decay import COSTS, SAVES, evaluations, value_at
from contactbench.runs.experiment import PROFILES, Timing, experiments
from contactbench.runs.search import step_at, tolerance_at
from contactbench.runs.settings import DEAREST, ENDS, finer_steps, steps
from contactbench.runs.timetable import SAMPLE, SPARED, Entry, Timetable
from contactbench.runs.work_precision import errors, evaluations_spread, ladder, passes_through, runs
from contactbench.scenes import scenes_of
from contactbench.tables.declared import DEFINITIONS, WORK_PRECISION
from contactbench.tables.schema import PROFILES as NAMES
from contactbench.tables.store import read


class Scripted:
    """A call whose visits take so long, one after the other; `order` says when it was visited."""

    def __init__(self, name, order, *times, lasts=0.001):
        self.name, self.order, self.times, self.lasts = name, order, iter(times), lasts
        self.part = Part(lambda: None, share=0.25, span=1.0)

    def warm_up(self):
        return self.lasts

    def visit(self, rounds=3):
        self.order.append(self.name)
        t = next(self.times)
        return Visit([2 * t, t, 3 * t], [t / 2] * 3)


def test_the_smoke_profile_has_every_adaptive_method_at_its_tightest_tolerance():
    cells = {(scene, name, value) for scene, name, _, _, value in ladder(PROFILES["smoke"])}
    adaptive = {(SMOKE, name, method.rtol_range[0]) for name, method in cb.METHODS.items() if method.adaptive}
    assert len(adaptive) > 10
    assert adaptive <= cells


def test_visits_are_spread_over_the_timed_part_and_a_cell_is_recorded_with_its_last():
    order, recorded, cells = [], {}, "abcdef"
    table = Timetable(dict.fromkeys(cells, ""), visits=8)

    def entry(name):
        again = Scripted(f"{name} again", order, *[3.0] * 8) if name == "a" else None
        record = lambda columns: recorded.update({name: (columns, len(order))})  # noqa: E731
        return Entry(Scripted(name, order, *[4.0, 2.0] * 4), again, record)

    table.entries += map(entry, cells)
    table.go()
    size = len(cells) + 1
    sweeps = {tuple(order[k : k + size]) for k in range(0, len(order), size)}
    assert len(sweeps) == 8
    assert {tuple(sorted(sweep)) for sweep in sweeps} == {("a", "a again", *"bcdef")}
    for name, (columns, visited) in recorded.items():
        assert (columns["visits"], columns["rounds"]) == (8, 24)
        assert columns["time_min_s"] == 2.0
        assert columns["marginal_s"] == pytest.approx((2.0 - 1.0) / 0.75)
        assert columns.get("time_process_ratio") == (1.5 if name == "a" else None)
        assert visited > 7 * size


def test_what_lasts_long_is_visited_less_often_and_recorded_once():
    order, recorded = [], []
    table = Timetable(dict.fromkeys("abc", ""), visits=6)
    for name, lasts in {"a": 0.001, "b": 2 * min(SPARED), "c": 2 * max(SPARED)}.items():
        again = Scripted(f"{name} again", order, *[2.0] * 6, lasts=lasts)
        record = lambda columns, name=name: recorded.append((name, columns["visits"]))  # noqa: E731
        table.entries.append(Entry(Scripted(name, order, *[2.0] * 6, lasts=lasts), again, record))
    table.go()
    assert Counter(order) == {"a": 6, "a again": 6, "b": 3, "b again": 3, "c": 2, "c again": 2}
    assert set(order[6:8]) == {"a", "a again"}
    assert sorted(recorded) == [("a", 6), ("b", 3), ("c", 2)]


def test_a_sample_of_every_engines_cells_is_timed_in_a_second_process():
    cells = {k: "llvm" if k % 10 else "c" for k in range(1000)} | {1000 + k: "jax" for k in range(5)}
    sample = Timetable(cells, 8).sample
    assert Counter(cells[k] for k in sample) == {"llvm": SAMPLE, "c": SAMPLE, "jax": 3}
    assert Timetable(cells, 8).sample == sample


def test_another_process_prepares_and_times_what_it_is_told():
    cell = ("particle", "contact-strang", "llvm", "step", 0.1)
    with Timetable({}, 8) as table:
        call = table.second(Timing(WORK_PRECISION, runs, (cell, None)))
        assert set(call.prepared.result()[1]) == {"call_s"}
        call.warm_up()
        visit = call.visit(2)
        assert len(visit.whole) == 2
        assert min(visit.whole) * visit.iterations > 1e-5


# -- The profiles of the benchmark, and which cells they visit -------------------------------------
def visited(name, profile="smoke"):
    return experiments()[name].cells(PROFILES[profile])


def test_the_smoke_profile_visits_every_scene_method_figure_and_soon_measured_claim():
    everything = {("scene", name) for name in cb.SCENES} | {("method", name) for name in cb.METHODS}
    assert set(visited("definition")) == everything
    timed = {cell[:2] for cell in visited("work_precision_errors")}
    assert {name for scene, name in timed if scene == "particle"} == set(cb.METHODS)
    soon = {name for name, method in cb.METHODS.items() if method.engines[0] not in DEAR}
    assert {cell[1] for cell in visited("laws")} == soon
    hard = {cell[0] for cell in visited("stability")}
    assert hard == {scene.name for scene in scenes_of("stability")}
    assert set(LONG) < set(CLAIMS)
    assert {cell[0] for cell in visited("claim")} == set(CLAIMS) - set(LONG)
    assert {cell[0] for cell in visited("paper_figure")} == set(FIGURES)


@pytest.mark.parametrize("experiment", ["laws", "convergence", "decay_laws", "work_precision"])
def test_a_scene_that_names_its_experiments_is_run_by_these_and_no_others(experiment):
    few = {name: scene.experiments for name, scene in cb.SCENES.items() if scene.experiments}
    cells = visited(experiment, "standard")
    assert {cell[0] for cell in cells} & few.keys() == {name for name in few if experiment in few[name]}


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


@pytest.mark.parametrize("place", range(len(choice.LEFT)))
def test_every_line_of_what_is_left_to_full_leaves_something_out_of_a_standard_run(place, monkeypatch):
    left = choice.LEFT[place]
    some = [experiments()[name] for name in left.experiments] or list(experiments().values())
    without = (*choice.LEFT[:place], *choice.LEFT[place + 1 :])
    cells = set(map(str, chain.from_iterable(each.cells(PROFILES["standard"]) for each in some)))
    monkeypatch.setattr(choice, "LEFT", without)
    assert cells < set(map(str, chain.from_iterable(each.cells(PROFILES["standard"]) for each in some)))


# -- A disk that is full while a benchmark runs ----------------------------------------------------
#: after one file of the run and one of a cell, or when the tables are written, there is no room
FULL = """
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


@pytest.mark.parametrize("bench", few_slow([bench, own_processes], own_processes))
@pytest.mark.parametrize(("name", "after"), few_slow([("replacing", 2), ("merge", 0)], ("merge", 0)))
def test_a_full_disk_is_one_line_and_what_was_finished_is_kept(name, after, bench, tmp_path):
    fault, results = tmp_path / "full.py", tmp_path / "results"
    fault.write_text(FULL.format(name=name, after=after))
    process = bench(results, "definition and contact", "--plugin", str(fault))
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 2, output
    (line,) = (line for line in output.splitlines() if "No space left" in line)
    assert "--resume" in line
    assert "Traceback" not in output
    finished(bench(results, "definition and contact", "--resume"))
    assert len(read(DEFINITIONS, results)) == sum("contact" in name for name in (*cb.METHODS, *cb.SCENES))


# -- What work–precision adds to a run, and settings at which methods cost the same ----------------
@pytest.mark.parametrize(
    ("method", "scene", "rtol", "turns"),
    [
        ("cvode-bdf", "particle", 1e-4, False),
        ("heyoka-taylor", "particle", 1e-4, False),
        ("cvode-adams", "particle_long", 1e-12, True),  # 31 to 49 thousand evaluations were met
    ],
)
def test_only_a_long_tight_run_turns_on_the_last_digit_of_its_data(method, scene, rtol, turns):
    run = cb.prepare(scene, method, rtol=rtol, save_at=[cb.SCENES[scene].t_end], carry=())
    spread = evaluations_spread(run, run().counts.evaluations)
    assert spread > 0.1 if turns else spread == 0


FIXED = [method.name for method in cb.METHODS.values() if isinstance(method, FixedStep)]


@pytest.mark.parametrize("method", FIXED)
def test_fixed_steps_pass_through_the_earlier_ends(method):
    """The error there, of runs of their own and of one that passes through; a processed method has more of it."""
    scene = cb.SCENES["central"]
    ends = [scene.t_end * k / ENDS for k in range(1, ENDS)]
    rung = 2 if cb.METHODS[method].one_step else 4  # those with a history begin with steps too long for them
    options = {"step": steps(scene, cb.METHODS[method])[rung], "engine": "python", "carry": ()}
    own = errors_of([cb.solve(scene, method, save_at=[t], **options) for t in ends]).max()
    passing = errors_of([cb.solve(scene, method, save_at=ends, **options)]).max()
    same = passing == pytest.approx(own, rel=1e-6, abs=1e-14)
    assert same == passes_through(cb.METHODS[method], "python", "step")


@pytest.mark.parametrize(
    ("scene", "method", "value", "fields"),
    [
        ("particle", "contact-strang", 0.8, "q p"),
        ("quadratic_damping", "contact-strang", 0.8, "q p s"),
        ("rigid_body", "cyrk-vern8", 1e-5, "M R"),
        ("forced_oscillator", "contact-strang", 0.8, "q p t"),
        ("forced_oscillator", "cyrk-vern8", 1e-5, "q p"),
    ],
)
def test_carried_is_what_is_integrated(scene, method, value, fields):
    item = cb.METHODS[method]
    row = errors((scene, method, item.engines[0], item.control, value), PROFILES["standard"])
    assert row["carried"] == fields


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


@pytest.mark.parametrize("name", ["contact-strang", "contact-rkn8", "contact-o8", "rk4", "scipy-dop853"])
@pytest.mark.parametrize("cost", COSTS)
def test_costs_are_equal_within_a_tenth_and_settings_the_same_every_time(name, cost):
    scene, method = cb.SCENES["central"], cb.METHODS[name]
    target = cost * scene.t_end
    value = value_at(scene, method, target)
    assert value == value_at(scene, method, target)
    assert evaluations(scene, method, value) == pytest.approx(target, rel=0.1)


def test_steps_end_at_the_saved_times_and_rotations_count_half():
    for name in ("contact-strang", "contact-rkn4"):
        method, body = cb.METHODS[name], cb.SCENES["rigid_body"]
        h = step_at(method, body, 600.0, SAVES)
        n = round(body.t_end / h)
        assert n % SAVES == 0
        assert method.counts(body, n) / 2 == pytest.approx(600, rel=0.1)


@pytest.mark.parametrize(
    ("falls_by", "floor", "rungs"),
    [
        (256.0, 1e-16, 5),  # 10⁻¹² is passed by the fifth
        (256.0, 1e-10, 6),  # two steps below that at which round-off shows are tried
        (1.2, 1e-16, 99),
    ],
    ids=["passes every error", "meets round-off", "costs too much"],
)
def test_a_ladder_goes_on_to_the_end_of_what_a_method_can_do(monkeypatch, falls_by, floor, rungs):
    scene, method = cb.SCENES["thermostat"], cb.METHODS["rk8"]
    every = [steps(scene, method)[-1], *finer_steps(scene, method)]

    def measured(cell):
        return (
            max(1e-3 * falls_by ** -every.index(cell[-1]), floor)
            if rungs < 99
            else 0.5 ** every.index(cell[-1])
        )

    monkeypatch.setattr(work_precision, "error_of", measured)
    run = [h for h in every if not work_precision.is_past_the_end(("thermostat", "rk8", "llvm", "step", h))]
    assert run == every[: min(rungs, len(every))]
    assert scene.t_end / every[-1] * method.per_step(scene) > DEAREST / 2


def test_ladders_of_the_standard_profile_reach_every_error_where_steps_can():
    cells = [c for c in ladder(PROFILES["standard"]) if c[:2] == ("thermostat", "rk8") and c[3] == "step"]
    reached = [work_precision.error_of(cell) for cell in cells if not work_precision.is_past_the_end(cell)]
    assert min(reached) < 1e-12
    assert len(reached) < len(cells)
