"""The gate's speed part: which calls, in which order, what is red, what is not decided."""

from contextlib import contextmanager
from dataclasses import asdict, replace
from operator import itemgetter

import numpy as np
import pandas as pd
import pytest

from contactbench.errors import BadInput
from contactbench.gate import revisions, speed, speed_worker
from contactbench.gate.speed import LIMIT, MANY, MOST_ROUNDS, PUBLIC, ROUNDS, Cell, workload
from contactbench.measure import clock
from contactbench.measure.statistics import PairedRatio
from contactbench.plugins import VARIABLE
from made_up import project, row
from planted_faults import plugin

CELL = Cell("particle", "contact-strang", "python", "step", 0.05)
PASS, STRADDLES, ABOVE = (PairedRatio(ratio, 0.9 * ratio, 1.1 * ratio, 15) for ratio in (1.0, 1.2, 1.5))


# -- what is timed ---------------------------------------------------------------------------------
def test_the_workload_is_the_finest_setting_that_is_short():
    def timed(method, setting, seconds, **more):
        return row(method, setting, **{"carried": "q p", "variant": "", "time_median_s": seconds} | more)

    body = {"carried": "M R", "scene": "rigid_body", "engine": "llvm"}
    rows = [
        *(timed("rk4", f"step={h}", t, **body) for h, t in ((0.2, 1e-5), (0.1, 2e-3), (0.05, 5e-3))),
        timed("cvode-adams", "rtol=1e-06", 1e-3, engine="c"),
        timed("scipy-radau", "rtol=0.001", 5e-3),
        timed("contact-rkn6", "rtol=0.001", 1e-5, variant="chosen"),
        *(timed(name, "step=0.2", 1e-4, scene="central") for name in ("rk4", "contact-abc")),
        *(timed("rk4", "step=0.1", 1e-4, engine=engine) for engine in ("python", "llvm")),
    ]
    cells = workload(pd.DataFrame(rows))
    once = [cell for cell in cells if cell.saves == 1 and cell.call == "prepared"]
    assert [(cell.scene, cell.method, cell.setting, cell.carry) for cell in once] == [
        ("rigid_body", "rk4", "step=0.1", ("R",)),
        ("particle", "cvode-adams", "rtol=1e-06", ()),
        ("central", "rk4", "step=0.2", ()),
        ("particle", "rk4", "step=0.1", ()),
        ("particle", "rk4", "step=0.1", ()),
    ]  # no long run, no chosen step; elsewhere few methods
    many = [(cell.method, cell.engine, cell.saves) for cell in cells if cell.saves > 1]
    assert many == [("cvode-adams", "c", MANY), ("rk4", "llvm", MANY)]
    assert cells[-len(PUBLIC) :] == PUBLIC


@pytest.mark.parametrize(
    ("timed", "reasons"), [(range(6), 0), (range(3), 0), (range(2), 1), ([1, 2, 4], 1), ([], 2)]
)
def test_too_few_cells_are_inconclusive(timed, reasons):
    """Less than half of them, or none of a kind."""
    few = speed.too_few([Cell("particle", call="solve"), *[Cell("particle", "rk4")] * 5], timed)
    assert len(few) == reasons
    assert speed.Findings(incomplete=few).status == (2 if reasons else 0)
    assert (speed.Findings(incomplete=few) + speed.Findings(speed.rows_of({"red": True}))).status == 1


# -- the judgement ---------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("first", "again", "result"),
    [
        (PASS, None, "pass"),
        (STRADDLES, None, "inconclusive"),
        (ABOVE, ABOVE, "slower"),
        (ABOVE, STRADDLES, "inconclusive"),
        (ABOVE, None, "inconclusive"),
    ],
)
def test_slower_takes_two_intervals_above_the_limit(first, again, result):
    assert speed.decide(first, again) == result


@pytest.fixture
def clocked(monkeypatch, tmp_path):
    """Time cells of two trees by ``clock(tree's name, cell, readings so far)``; return the readings' order too."""

    def compare(clock, count, until=None, sides=("base",)):
        order = []

        @contextmanager
        def scripted(tree, root):
            asked = []

            def receive():
                if not isinstance(asked[-1], int):
                    return {"code": str(tree), "refused": {}}
                order.append((tree.name, asked[-1]))
                return [clock(*order[-1], len(order))]

            yield asked.append, receive

        monkeypatch.setattr(speed, "timing_process", scripted)
        trees = {side: tmp_path / side for side in ("tree", *sides)}
        pairs = {(side, i) for side in sides for i in range(count)}
        ratios = speed.time_pairs(trees, [CELL] * count, pairs, until)[0]
        return ratios if len(sides) > 1 else {i: ratio for (_, i), ratio in ratios.items()}, order

    return compare


def test_turns_are_shuffled_and_paired(clocked):
    """Timed in turns by a clock that drifts: the ratio does not see the drift."""
    factor = {"base": 1.0, "tree": 1.5}
    ratios, order = clocked(lambda name, cell, k: factor[name] * (1 + cell) * np.exp(k / 50), 4)
    assert [ratio.ratio for ratio in ratios.values()] == pytest.approx([1.5] * 4, rel=0.03)
    assert {ratio.rounds for ratio in ratios.values()} == {ROUNDS}
    first = [order[i][0] for i in range(0, len(order), 2)]
    assert 20 < first.count("base") < 40  # of 60 pairs either goes first
    assert [cell for _, cell in order[:8:2]] != [cell for _, cell in order[8:16:2]]


def test_a_pinned_revision_sees_the_drift_that_each_parent_did_not(clocked):
    """Three in a round, right after one another; each pair has its own interval, and its own end of the rounds."""
    factor = {"pinned": 1.0, "base": 1.2, "tree": 1.4}
    ratios, order = clocked(lambda name, cell, k: factor[name] * np.exp(k / 50), 2, sides=("base", "pinned"))
    assert ratios["base", 1].ratio == pytest.approx(1.4 / 1.2, rel=0.03)
    assert ratios["pinned", 1].ratio == pytest.approx(1.4, rel=0.03)
    rounds = [order[i : i + 3] for i in range(0, 90, 3)]
    assert {len({*map(itemgetter(1), one)}) for one in rounds} == {1}
    assert len({tuple(map(itemgetter(0), one)) for one in rounds}) == 6


def test_what_is_undecided_gets_more_rounds(clocked):
    """Of three cells with a noisy clock only the one near the limit."""
    noise = np.random.default_rng(1).normal(size=10_000)
    factor = {"base": [1.0] * 3, "tree": [1.0, 1.02 * LIMIT, 2.0]}
    ratios, _ = clocked(lambda name, cell, k: factor[name][cell] * np.exp(0.1 * noise[k]), 3)
    assert [ratios[i].rounds for i in range(3)] == [ROUNDS, MOST_ROUNDS, ROUNDS]


def test_rounds_end_with_the_time(clocked, monkeypatch):
    readings = []
    monkeypatch.setattr(speed, "perf_counter", lambda: len(readings))
    ratios, _ = clocked(lambda *reading: readings.append(reading) or 1e-3, 3, until=3 * 2 * 3 - 1)
    assert {ratio.rounds for ratio in ratios.values()} == {3}


def test_the_clock_is_that_of_the_tree_that_judges_and_a_call_that_ends_badly_is_not_timed():
    assert speed_worker.clock.__file__ == clock.__file__
    timed = speed_worker.ready(asdict(CELL))
    assert len(timed.visit().whole) == clock.ROUNDS
    with pytest.raises(RuntimeError, match="diverged"):
        speed_worker.ready(asdict(replace(CELL, scene="large_step", value=3.0)))


# -- processes -------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    return project(tmp_path_factory.mktemp("copy").resolve())


def judge(copy, cells, base=None, pin=""):
    """The red rows of the tree beside its own commit, or another tree."""
    with revisions.checkout(copy, "HEAD") as tree:
        moved = speed.compare_speed(copy, base or tree, cells, pin=pin).moved
    return moved[moved["red"]]


def test_the_same_code_is_not_slower_and_half_as_much_again_is(copy, tmp_path, monkeypatch):
    """So many steps that a call costs little beside them."""
    assert judge(copy, [CELL]).empty
    call = f"slower(['contact-strang'], 1.5, {str(copy)!r})"
    monkeypatch.setenv(VARIABLE, str(plugin(tmp_path / "slower.py", call)))
    (after,) = judge(copy, [CELL])["after"]
    assert float(after.split()[0].removeprefix("×")) == pytest.approx(1.5, rel=0.15)


def test_a_cell_one_side_cannot_run_is_refused_and_a_broken_tree_is_not_compared(copy, tmp_path):
    pairs, cells = {("base", 0), ("base", 1)}, [CELL, Cell("particle", "no-such-method")]
    ratios, refused = speed.time_pairs({"tree": copy, "base": copy}, cells, pairs)
    assert set(ratios) == {("base", 0)}
    assert refused["tree", 1].startswith("UnknownName")
    (tmp_path / "src" / "contactbench").mkdir(parents=True)
    (tmp_path / "src" / "contactbench" / "__init__.py").write_text("raise RuntimeError('broken')")
    with pytest.raises(BadInput, match="timing process ended: RuntimeError: broken"):
        speed.time_pairs({"tree": copy, "base": tmp_path}, cells, pairs)


#: at the end of the package's own module: what every public call does beside its work
DELAYS = """
import time

def late(function, seconds):
    def other(*given, **more):
        time.sleep(seconds)
        return function(*given, **more)
    return other

class Late:
    def __init__(self, *given, run=prepare, **more):
        run = run(*given, **more)
        self.start, self.run, self.bare = run.start, late(run, 0.002), late(run.bare, 0.002)

    def __call__(self, **more):
        return self.run(**more)

time.sleep(1)
solve, reference, prepare = late(solve, 0.2), late(reference, 0.2), Late
"""
QUICK = ("solve", "run()", "run(q=…)", "bare")


@pytest.mark.parametrize("quick", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_delay_of_every_public_call_is_found(quick, copy, monkeypatch):
    """All of them planted in the sources of the head; what is quick beside a pinned revision, as slow as its parent."""
    monkeypatch.setattr(speed, "ROUNDS", 7)
    cells = [cell for cell in PUBLIC if (cell.call in QUICK) is quick]
    file = copy / "src/contactbench/__init__.py"
    original = file.read_text()
    assert original.count("load_installed()\n") == 1
    file.write_text(original.replace("load_installed()\n", "load_installed()\n" + DELAYS))
    try:
        found = judge(copy, cells, copy if quick else None, "HEAD" if quick else "")
    finally:
        file.write_text(original)
    expected = {(cell.scene, cell.setting) for cell in cells}
    assert {*zip(found["scene"], found["setting"], strict=True)} == expected
    assert {*found["between"]} == {"pinned → tree" if quick else "base → tree"}


def test_a_clone_without_the_pinned_revision_is_inconclusive(copy, monkeypatch):
    monkeypatch.setattr(speed, "time_pairs", lambda *_: ({("base", 0): PASS}, {}))
    assert speed.compare_speed(copy, copy, [CELL]).status == 0
    found = speed.compare_speed(copy, copy, [CELL], pin="f" * 40)
    assert found.status == 2
    assert "pinned revision ffffffffffff is not in this clone" in found.incomplete[0]
