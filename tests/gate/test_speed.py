"""The gate's speed part: which calls, in which order, what is red, what is not decided."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np
import pytest

from cases import counts_memory, most_slow
from contactbench.cli import main
from contactbench.errors import BadInput
from contactbench.gate import judge, speed, speed_worker
from contactbench.gate.workload import MANY, PUBLIC, Cell, workload
from contactbench.measure.statistics import PairedRatio
from contactbench.plugins import VARIABLE
from contactbench.results.store import merge, read
from contactbench.results.tables import WORK_PRECISION
from made_up import commit, committed, folder, git, row
from planted_faults import plugin

REPOSITORY = Path(__file__).parents[2]


@pytest.mark.parametrize(
    ("first", "again", "expected"),
    [
        ((1.0, 0.9, 1.2), None, "pass"),
        ((1.3, 1.2, 1.4), None, "inconclusive"),
        ((1.5, 1.4, 1.6), (1.5, 1.3, 1.7), "slower"),
        ((1.5, 1.4, 1.6), (1.2, 1.1, 1.3), "inconclusive"),
        ((1.5, 1.4, 1.6), None, "inconclusive"),
        ((0.5, 0.4, 0.6), None, "pass"),
    ],
)
def test_slower_takes_two_intervals_above_the_limit(first, again, expected):
    def ratio(values):
        return None if values is None else PairedRatio(*values, 15)

    assert speed.verdict(ratio(first), ratio(again)) == expected


def test_a_quarter_of_the_time_left_is_kept_for_the_second_look(monkeypatch):
    monkeypatch.setattr(judge, "perf_counter", lambda: 100.0)
    assert [judge.reserve(until) for until in (140.0, 100.0, 60.0)] == [10.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [(1.1, 1.3, True), (1.1, speed.LIMIT, False), (speed.LIMIT, 1.3, True), (1.26, 1.3, False)],
)
def test_undecided_is_an_interval_with_the_limit_in_it(low, high, expected):
    assert speed.undecided(PairedRatio(1.2, low, high, 9)) is expected


def test_the_workload_is_the_finest_setting_that_is_short(tmp_path):
    baseline = folder(tmp_path)
    merge(
        WORK_PRECISION,
        [
            row(setting=f"step={h}", carried="M R", time_median_s=time, scene="rigid_body")
            for h, time in ((0.2, 1e-5), (0.1, 2e-3), (0.05, 5e-3))
        ]
        + [row("scipy-radau", "rtol=0.001", carried="q p", time_median_s=5e-3)]
        + [row("limit-c", family="limit", variant="contact-strang", carried="q p", time_median_s=1e-5)]
        + [row("contact-rkn6", "rtol=0.001", variant="chosen", carried="q p", time_median_s=1e-5)],
        baseline,
    )
    merge(
        WORK_PRECISION,
        [
            row(name, carried="q p", time_median_s=1e-4, scene="central", setting="step=0.2")
            for name in ("rk4", "contact-abc")
        ],
        baseline,
    )
    cells = workload(read(WORK_PRECISION, baseline))
    assert [
        (c.scene, c.method, c.setting, c.carry) for c in cells if c.saves == 1 and c.call == "prepared"
    ] == [
        ("particle", "rk4", "step=0.1", ()),
        ("particle", "cvode-adams", "rtol=1e-06", ()),
        ("central", "rk4", "step=0.2", ()),
        ("rigid_body", "rk4", "step=0.1", ("R",)),
    ]  # neither the run out of budget nor the long one, no C loop and no chosen step; elsewhere one method
    assert [(c.scene, c.method, c.saves) for c in cells if c.saves > 1] == [
        ("particle", "rk4", MANY), ("particle", "cvode-adams", MANY),
    ]  # fmt: skip
    assert cells[-len(PUBLIC) :] == list(PUBLIC)
    assert {cell.call for cell in PUBLIC} == {*speed_worker.CALLS} - {"prepared"}


def test_many_saved_times_are_timed_on_the_first_engine_of_a_method(tmp_path):
    cells = workload(read(WORK_PRECISION, committed(tmp_path)))
    many = {cell.method: cell.engine for cell in cells if cell.saves > 1}
    assert many["rk4"] == many["contact-strang"] == "numba"


CELLS = [Cell("particle", "contact-strang", "python", "step", 0.05, ())]


@contextmanager
def patched(file, old, new):
    """A source file with one passage replaced, for as long as the block lasts."""
    original = file.read_text()
    assert original.count(old) == 1
    file.write_text(original.replace(old, new))
    try:
        yield
    finally:
        file.write_text(original)


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """A clone of the project with its sources as they are now, and made-up tables, committed."""
    path = folder(tmp_path_factory.mktemp("copy").resolve() / "results").parent
    shutil.copytree(REPOSITORY / "src", path / "src", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("bench", "references"):
        shutil.copytree(REPOSITORY / name, path / name)
    for name in ("pyproject.toml", "constraints.txt"):
        shutil.copy(REPOSITORY / name, path)
    for arguments in (
        ["init", "-q"], ["add", "."],
        ["-c", "user.name=t", "-c", "user.email=t@example.org", "commit", "-q", "-m", "all"],
    ):  # fmt: skip
        subprocess.run(["git", "-C", str(path), *arguments], check=True)
    return path


def lines(verdict, measure="time"):
    return [line for line in verdict.lines if line.measure == measure]


def test_the_same_code_is_not_slower_and_twice_the_work_is(copy):
    same = judge.slower(copy, CELLS, "HEAD")
    assert not same.red
    once = "            run(y, w, [*shape, 0], after)\n"
    (file,) = (
        path for path in (copy / "src" / "contactbench" / "methods").rglob("*.py") if once in path.read_text()
    )
    with patched(file, once, once + once):
        slower = judge.slower(copy, CELLS, "HEAD")
    assert "with local changes" in slower.compared[0]
    (line,) = lines(slower)
    assert line.verdict == "slower"
    assert float(line.after.removeprefix("×")) == pytest.approx(2, rel=0.15)


def test_a_cell_one_side_cannot_run_is_reported_and_a_broken_tree_is_not_compared(copy, tmp_path):
    cells = [*CELLS, Cell("particle", "no-such-method", "jax", "step", 0.1, ())]
    found = speed.paired_times([sys.executable] * 2, [copy] * 2, cells, rounds=2, seed=0)
    assert set(found.ratios) == {0}
    assert "base: UnknownName" in found.refused[1]
    (tmp_path / "src" / "contactbench").mkdir(parents=True)
    (tmp_path / "src" / "contactbench" / "__init__.py").write_text("raise RuntimeError('broken')")
    with pytest.raises(BadInput, match="timing process ended: RuntimeError: broken"):
        speed.paired_times([sys.executable] * 2, [copy, tmp_path], CELLS, rounds=2, seed=0)


@pytest.fixture
def clocked(monkeypatch, tmp_path):
    """Times two trees by ``clock(tree's name, cell, readings so far)``; also gives who was asked, in order."""

    def compare(clock, cells, until=None):
        asked = []

        class Side:
            def __init__(self, _python, tree, _cells, _core, _later, _seconds):
                self.name = tree.name

            def __enter__(self):
                return self

            def __exit__(self, *_):
                pass

            def refused(self):
                return {}

            def time(self, cell):
                asked.append((self.name, cell))
                return clock(self.name, cell, len(asked))

            def ask_costs(self):
                pass

            def costs(self):
                return speed.Costs()

        monkeypatch.setattr(speed, "Side", Side)
        trees = [tmp_path / "base", tmp_path / "head"]
        found = speed.paired_times(["p", "p"], trees, cells, speed.ROUNDS, seed=0, until=until)
        return found, asked

    return compare


def test_turns_are_shuffled_and_paired(clocked):
    """Timed in turns by a clock that drifts: the ratio does not see the drift."""
    factor = {"base": 1.0, "head": 1.5}
    found, asked = clocked(lambda name, cell, k: factor[name] * 1e-3 * (1 + cell) * np.exp(k / 50), CELLS * 4)
    for ratio in found.ratios.values():
        assert ratio.ratio == pytest.approx(1.5, rel=0.03)
        assert ratio.rounds == speed.ROUNDS
    first = [asked[i][0] for i in range(0, len(asked), 2)]
    assert 20 < first.count("base") < 40  # of 60 pairs either goes first
    assert [cell for _, cell in asked[:8:2]] != [cell for _, cell in asked[8:16:2]]


def test_what_is_undecided_gets_more_rounds(clocked):
    """Of three cells with a noisy clock only the one near the limit."""
    noise = np.random.default_rng(1).normal(size=10_000)
    factor = [1.0, 1.02 * speed.LIMIT, 2.0]
    found, _ = clocked(
        lambda name, cell, k: (factor[cell] if name == "head" else 1.0) * np.exp(0.1 * noise[k]), CELLS * 3
    )
    assert [found.ratios[i].rounds for i in range(3)] == [speed.ROUNDS, speed.MOST_ROUNDS, speed.ROUNDS]


def test_what_there_is_no_time_for_is_said_to_be_inconclusive(clocked):
    """The time is up after three rounds: no cell is judged slower on them."""
    end = perf_counter() + 1e9
    calls = []

    def clock(name, cell, k):
        calls.append(k)
        if len(calls) == 3 * 2 * 3:
            time_is_up.append(True)
        return 1e-3

    time_is_up = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(speed, "perf_counter", lambda: end + 1 if time_is_up else end - 1e6)
        found, _ = clocked(clock, CELLS * 3, until=end)
    assert found.unfinished
    assert {ratio.rounds for ratio in found.ratios.values()} == {3}
    said = judge.sentences(found, [], ("base", "head"))
    assert said[1] == "speed: inconclusive beyond that, the time was up after 3 rounds of 15 or more"


@pytest.mark.parametrize(
    ("timed", "reasons"),
    [(range(6), []), (range(3), []), (range(2), ["only 2 of 6"]), ([1, 2, 4], ["no cell timed of solve"]),
     ([], ["only 0 of 6", "no cell timed of rk4, solve"])],
)  # fmt: skip
def test_too_few_cells_are_no_verdict(timed, reasons):
    solve, rk4 = (replace(CELLS[0], method="rk4", call=call) for call in ("solve", "prepared"))
    few = judge.too_few([solve, *[rk4] * 5], timed)
    assert len(few) == len(reasons)
    assert all(map(str.startswith, few, reasons))
    verdict = judge.Verdict(incomplete=few)
    assert verdict.status == (2 if reasons else 0)
    red = judge.Line("time", "×1", "×2", "", "slower", True)
    assert (verdict + judge.Verdict((red,))).status == 1


def test_a_gate_without_time_is_inconclusive(copy, tmp_path, monkeypatch, capsys):
    """From the command line, of a whole workload."""
    root = tmp_path / "project"
    git(copy, "clone", "-q", str(copy), str(root))
    commit(root, "nothing more")
    monkeypatch.chdir(root)
    assert main(["gate", "--only", "speed", "--budget", "1", "--json"]) == 2
    assert "only " in json.loads(capsys.readouterr().out)["incomplete"][0]


class Scripted(speed.Side):
    """A process whose clock is a script: a call takes 1 ms, but for one repeat that something interrupts."""

    def __init__(self, interrupted):
        self.interrupted = interrupted

    def _say(self, what):
        ends = np.cumsum([1e-3, 1e-3 + self.interrupted, 1e-3])
        clock = iter([t for start, end in zip([0.0, *ends[:-1]], ends, strict=True) for t in (start, end)])
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(speed_worker, "perf_counter", lambda: next(clock))
            self.answer = speed_worker.seconds(lambda: None, 1e-3)

    def _answer(self):
        return self.answer


def test_the_estimate_is_the_repeat_that_nothing_interrupted():
    assert Scripted(0.0).time(0) == Scripted(5e-3).time(0) == pytest.approx(1e-3)


def test_a_verdict_says_inconclusive_in_words():
    line = judge.Line("time", "×1", "×1.3", "", "inconclusive", False, "particle", "rk4")
    verdict = judge.Verdict((line,), ("speed: …",))
    assert not verdict.red
    assert verdict.as_markdown().startswith("# Regression gate: green, but 1 inconclusive\n")
    assert '"inconclusive": 1' in verdict.as_json()


# -- compilation and memory ------------------------------------------------------------------------
@pytest.mark.slow
def test_both_trees_begin_with_empty_caches_of_their_own(copy, tmp_path, monkeypatch):
    """A program kept elsewhere, which one tree alone might find, is neither read nor written."""
    seen = []
    for name in ("CONTACTBENCH_CACHE", "NUMBA_CACHE_DIR", "JAX_COMPILATION_CACHE_DIR"):
        monkeypatch.setenv(name, str(tmp_path / name))
    monkeypatch.setenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    monkeypatch.setenv("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")

    class Seen(speed.Side):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            assert not any(Path(self.caches.name).iterdir())

        def costs(self):
            folder = Path(self.caches.name)
            seen.append({path.relative_to(folder).parts[0] for path in folder.rglob("*") if path.is_file()})
            return super().costs()

    monkeypatch.setattr(speed, "Side", Seen)
    cells = [Cell("particle", "rk4", engine, "step", 0.4, ()) for engine in ("numba", "jax")]
    found = speed.paired_times([sys.executable] * 2, [copy] * 2, cells, rounds=0, seed=0)
    assert found.refused == {}
    assert seen == [{"programs", "numba", "xla"}] * 2
    assert list(tmp_path.iterdir()) == []


def test_with_little_time_every_method_and_engine_comes_first():
    cells = [Cell("particle", name, e, "step", h, ()) for name in "ab" for e in "xy" for h in (0.1, 0.2, 0.4)]
    ordered = judge.kinds_first(cells, "seed")
    assert sorted(map(repr, ordered)) == sorted(map(repr, cells))
    assert [len({(c.method, c.engine) for c in ordered[k : k + 4]}) for k in (0, 4, 8)] == [4, 4, 4]
    assert len({c.method for c in ordered[:2]}) == 2
    assert ordered == judge.kinds_first(cells, "seed") != judge.kinds_first(cells, "another")


def pair(**head):
    base = {"compile": {0: 1.0, 1: 0.02}, "leaked": {0: 0.0, 1: 2e5}, "peak": 4e8}
    return speed.Costs(**base), speed.Costs(**{**base, **head})


@pytest.mark.parametrize(
    ("costs", "expected"),
    [
        (pair(), {}),
        (pair(compile={0: 1.2, 1: 0.1}), {}),
        (pair(compile={0: 1.3, 1: 0.32}), {"compilation": {0, 1}}),
        (pair(leaked={0: 9e5, 1: 1.1e6}), {}),
        (pair(leaked={0: 9e5, 1: 1.3e6}), {"memory left behind": {1}}),
        (pair(peak=4.6e8), {}),
        (pair(peak=4.8e8), {"peak memory": {-1}}),
        (pair(compile={0: 1.0}), {}),
    ],
)
def test_what_is_said_once_a_process_is_a_suspect_beyond_a_share_and_an_amount(costs, expected):
    assert speed.suspects(costs) == expected


@pytest.mark.parametrize("side", [0, 1])
def test_a_cell_that_one_tree_had_no_time_for_is_no_suspect(side):
    """Not 0 s against 1.2 s."""
    sides = [speed.Costs({0: 1.0, 1: 1.2}, {0: 0.0, 1: 5e6}, 4e8), speed.Costs({0: 1.0}, {0: 0.0}, 4e8)]
    assert speed.suspects((sides[side], sides[1 - side])) == {}


def answering(monkeypatch, *costs):
    """The pairs of processes answer so, one after the other; the cells each is asked for."""
    asked, answers = [], list(costs)

    def paired_times(pythons, trees, cells, rounds, seed, until):
        asked.append(cells)
        return speed.Measured({}, {}, answers.pop(0))

    monkeypatch.setattr(speed, "paired_times", paired_times)
    return asked


@pytest.mark.parametrize(("agreeing", "verdicts"), [(2, ["more"]), (1, []), (0, [])])
def test_a_suspect_is_red_when_three_pairs_of_processes_agree(agreeing, verdicts, monkeypatch):
    """Alone in its processes, a cell has another number than among all."""
    seconds = (0.5 if k < agreeing else 0.02 for k in range(2))
    asked = answering(monkeypatch, *[(speed.Costs({0: 0.02}), speed.Costs({0: each})) for each in seconds])
    cells = [*CELLS, Cell("particle", "rk4", "numba", "step", 0.1, ())]
    found = judge.once_a_process((), (), cells, pair(compile={0: 1.0, 1: 0.5}), None)
    assert [(line.method, line.measure, line.verdict) for line in found] == [
        ("rk4", "compilation", verdict) for verdict in verdicts
    ]
    assert asked
    assert all([cell.method for cell in cells] == ["rk4"] for cells in asked)


NOTHING = (speed.Costs(), speed.Costs())


def test_a_suspect_that_there_is_no_time_to_measure_again_stays_inconclusive(monkeypatch):
    answering(monkeypatch, NOTHING, NOTHING)
    cells = [*CELLS, Cell("particle", "rk4", "numba", "step", 0.1, ())]
    found = judge.once_a_process((), (), cells, pair(leaked={0: 0.0, 1: 3.2e6}), None)
    assert [(line.method, line.measure, line.verdict, line.change) for line in found] == [
        ("rk4", "memory left behind", "inconclusive", "+3 MB")
    ]


@pytest.mark.parametrize(("again", "verdicts"), [(4.8e8, ["more"]), (4.1e8, [])])
def test_a_peak_is_confirmed_by_processes_that_run_every_cell_suspects_first(again, verdicts, monkeypatch):
    """What runs fewer cells clears nothing."""
    cells = [Cell("particle", name, "numba", "step", 0.1, ()) for name in ("rk4", "contact-strang")]
    asked = answering(monkeypatch, *[pair(peak=again)] * 2)
    found = judge.once_a_process((), (), cells, pair(peak=4.8e8, compile={0: 1.0, 1: 0.5}), None)
    assert asked[0] == cells[::-1]
    assert [line.verdict for line in found if line.measure == "peak memory"] == verdicts
    answering(monkeypatch, NOTHING, NOTHING)
    (line,) = judge.once_a_process((), (), cells, pair(peak=4.8e8), None)
    assert (line.measure, line.verdict, line.change) == ("peak memory", "inconclusive", "+80 MB")


def test_peaks_of_processes_that_ran_different_cells_are_not_compared():
    costs = speed.Costs({0: 1.0}, {}, 4e8), speed.Costs({0: 1.0, 1: 1.0}, {}, 8e8)
    assert speed.suspects(costs) == {}
    (note,) = judge.refusals(CELLS, speed.Measured({}, {}, costs))
    assert note.startswith("peak memory not compared")
    assert judge.refusals(CELLS, speed.Measured({}, {}, pair())) == ()


@counts_memory
@pytest.mark.parametrize("size", [0, 1000, 20_000, 900_000])
def test_what_runs_leave_behind_is_counted_but_not_what_is_allocated_once(size):
    """Beside a hole of some megabytes, which a leak could hide in."""
    hole = [np.ones(5000) for _ in range(100)]
    kept = [np.ones(1_000_000)]
    del hole[::2]

    def run():
        if len(kept) == 1:
            kept.append(np.ones(3_000_000))
        if size:
            kept.append(np.ones(size // 8))

    found = speed_worker.left_behind(run, once=2e-4)
    assert found == pytest.approx(speed_worker.RUNS * size, rel=0.1, abs=5e4)


SPENT = {
    "compilation": "dearer('contact-strang', '{tree}', 0.3)",
    "memory left behind": "dearer('contact-strang', '{tree}', leak=10_000)",
}


@pytest.mark.parametrize("fault", most_slow(SPENT, "compilation"))
@pytest.mark.slow
def test_compilation_and_memory_are_planted_in_one_of_two_trees(fault, copy, tmp_path, monkeypatch):
    planted = SPENT[fault]
    monkeypatch.setenv(VARIABLE, str(plugin(tmp_path / "more.py", planted.format(tree=str(copy)))))
    cells = [Cell("particle", "contact-strang", "numba", "step", 0.4, ())]
    verdict = judge.slower(copy, cells, "HEAD")
    assert fault in {line.measure for line in verdict.lines if line.red}


#: at the end of the package's own module: what every public call does beside its work
DELAYS = """
import time
from contactbench.ensembles import ensemble
from contactbench.methods.prepared import Prepared

def late(function, seconds, when=""):
    def other(*given, **more):
        if when in {"", *more}:
            time.sleep(seconds)
        return function(*given, **more)
    return other

time.sleep(1)
solve, ensemble, reference = late(solve, 0.01), late(ensemble, 0.5), late(reference, 0.2)
Prepared.__call__ = late(Prepared.__call__, 0.002, "q")
"""


@pytest.mark.parametrize(
    "calls",
    [["solve", "run(q=…)"], pytest.param(["ensemble", "reference", "import"], marks=pytest.mark.slow)],
    ids=" ".join,
)
def test_a_delay_of_every_public_call_is_found(calls, copy, monkeypatch):
    """All of them planted in the sources of the head; a live reference takes longer, and shares its call."""
    monkeypatch.setattr(speed, "ROUNDS", 7)
    cells = [cell for cell in PUBLIC if cell.call in calls]
    assert not judge.slower(copy, cells[:1], "HEAD").red
    with patched(copy / "src/contactbench/__init__.py", "load_installed()\n", "load_installed()\n" + DELAYS):
        verdict = judge.slower(copy, cells, "HEAD")
    slower = [line.setting for line in lines(verdict) if line.verdict == "slower"]
    assert slower == [cell.setting for cell in cells]


def test_a_slowdown_is_planted_in_one_of_two_trees(copy, tmp_path, monkeypatch):
    call = f"slower(['contact-strang'], 1.5, {str(copy)!r})"
    monkeypatch.setenv(VARIABLE, str(plugin(tmp_path / "slower.py", call)))
    # so many steps that what a call costs beside them is little, and short enough not to be interrupted often
    cells = [Cell("particle", "contact-strang", "python", "step", 0.05, ())]
    (line,) = lines(judge.slower(copy, cells, "HEAD"))
    assert line.verdict == "slower"
    assert float(line.after.removeprefix("×")) == pytest.approx(1.5, rel=0.15)
