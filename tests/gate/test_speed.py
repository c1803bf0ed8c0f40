"""The gate's speed part: which calls, in which order, what is red, what is not decided."""

from contextlib import contextmanager
from dataclasses import asdict, replace
from operator import itemgetter

import numpy as np
import pandas as pd
import pytest

import contactbench as cb
from contactbench.errors import BadInput
from contactbench.gate import revisions, speed, speed_worker
from contactbench.gate.speed import (
    MANY_SAVED_TIMES,
    MOST_ROUNDS_UNTIL_DECIDED,
    RATIO_LIMIT,
    ROUNDS,
    Cell,
    public,
    workload,
)
from contactbench.measure import clock
from contactbench.measure.statistics import PairedRatio
from made_up import project, time

CELL = Cell("particle", "contact-strang", "python", "step", 0.05)
PASS, STRADDLES, ABOVE = (PairedRatio(ratio, 0.9 * ratio, 1.1 * ratio, 15) for ratio in (1.0, 1.2, 1.5))


# -- what is timed ---------------------------------------------------------------------------------
def test_the_workload_is_the_finest_setting_that_is_short():
    rows = [
        *(time("rk4", f"step={h}", t, engine="llvm") for h, t in ((0.2, 1e-5), (0.1, 2e-3), (0.05, 5e-3))),
        time("rk4", "step=0.1", engine="python"),
        time("cvode-adams", "rtol=1e-06", 1e-3, engine="c"),
        time("scipy-radau", "rtol=0.001", 5e-3),
        time("contact-rkn6", "rtol=0.001", 1e-5),
        time("rk4", "step=0.2", 1e-4, saved=1000),
        *(time(name, "step=0.2", scene="central", engine="llvm") for name in ("rk4", "rk8", "contact-abc")),
        *(time(name, "step=0.2", scene="particle_long", engine="llvm") for name in ("rk4", "rk8")),
        time("gone", "step=0.2"),
    ]
    short = [("rk4", "llvm", "step=0.1"), ("rk4", "python", "step=0.1"), ("cvode-adams", "c", "rtol=1e-06")]
    elsewhere = [(name, "llvm", "step=0.2") for name in ("rk4", "contact-abc", "rk4", "rk8")]
    cells = workload(pd.DataFrame(rows))
    once = [cell for cell in cells if (cell.saves, cell.call) == (1, "prepared")]
    assert [(cell.method, cell.engine, cell.setting) for cell in once] == [*short, *elsewhere]
    many = [(cell.method, cell.engine, cell.saves) for cell in cells if cell.saves > 1]
    assert many == [("rk4", "llvm", MANY_SAVED_TIMES), ("cvode-adams", "c", MANY_SAVED_TIMES)]
    assert cells[-len(public()) :] == public()
    assert len(workload(pd.DataFrame(rows), everywhere=True)) == len(once) + 1  # rk8 on the third scene too


def test_public_calls_are_of_a_reference_in_closed_form_and_of_one_that_is_solved():
    scenes = [cb.SCENES[cell.scene] for cell in public() if cell.call == "reference"]
    sources = {cb.reference(scene.with_(gamma=1.01 * scene.gamma), [0.01]).source for scene in scenes}
    assert sources == {"closed form", "live"}


@pytest.mark.parametrize(("timed", "reasons"), [(range(3), 0), (range(2), 1), ([1, 2, 4], 1), ([], 2)])
def test_too_few_cells_are_inconclusive(timed, reasons):
    """Less than half of them, or none of a kind."""
    few = speed.too_few([replace(CELL, call="solve"), *[CELL] * 5], timed)
    assert len(few) == reasons
    assert speed.Findings(incomplete=few).status == (2 if reasons else 0)
    assert (speed.Findings(incomplete=few) + speed.Findings(speed.rows_of({"red": True}))).status == 1


# -- the judgement ---------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("first", "again", "result"),
    [
        (PASS, None, "pass"),
        (STRADDLES, None, "inconclusive"),
        (ABOVE, STRADDLES, "inconclusive"),
        (ABOVE, ABOVE, "slower"),
    ],
)
def test_slower_takes_two_intervals_above_the_limit(first, again, result):
    assert speed.decide(first, again) == result


@pytest.fixture
def clocked(monkeypatch, tmp_path):
    """Time cells of two trees by ``clock(tree's name, cell, readings so far)``; return the readings' order too."""

    def compare(clock, count, sides=("base",)):
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
        ratios = speed.time_pairs(trees, [CELL] * count, pairs)[0]
        return ratios if len(sides) > 1 else {i: ratio for (_, i), ratio in ratios.items()}, order

    return compare


def test_turns_are_shuffled_and_paired(clocked):
    """Three in a round, right after one another, by a clock that drifts: each pair has its own ratio without it."""
    factor = {"pinned": 1.0, "base": 1.2, "tree": 1.4}
    ratios, order = clocked(lambda name, cell, k: factor[name] * np.exp(k / 50), 2, sides=("base", "pinned"))
    assert ratios["base", 1].ratio == pytest.approx(1.4 / 1.2, rel=0.03)
    assert ratios["pinned", 1].ratio == pytest.approx(1.4, rel=0.03)
    assert ratios["base", 0].rounds == ROUNDS
    rounds = [order[i : i + 3] for i in range(0, 90, 3)]
    assert {len({*map(itemgetter(1), one)}) for one in rounds} == {1}
    assert len({tuple(map(itemgetter(0), one)) for one in rounds}) == 6
    assert {one[0][1] for one in rounds[::2]} == {0, 1}  # either cell goes first


def test_what_is_undecided_gets_more_rounds(clocked):
    """Of three cells with a noisy clock only the one near the limit."""
    noise = np.random.default_rng(1).normal(size=10_000)
    factor = {"base": [1.0] * 3, "tree": [1.0, 1.02 * RATIO_LIMIT, 2.0]}
    ratios, _ = clocked(lambda name, cell, k: factor[name][cell] * np.exp(0.1 * noise[k]), 3)
    assert [ratios[i].rounds for i in range(3)] == [ROUNDS, MOST_ROUNDS_UNTIL_DECIDED, ROUNDS]


def test_the_clock_is_that_of_the_tree_that_judges_and_a_call_that_ends_badly_is_not_timed():
    assert speed_worker.clock.__file__ == clock.__file__
    timed = speed_worker.ready(asdict(CELL))
    assert len(timed.visit().whole) == clock.ROUNDS
    with pytest.raises(RuntimeError, match="diverged"):
        speed_worker.ready(asdict(replace(CELL, scene="large_step", value=3.0)))


# -- processes -------------------------------------------------------------------------------------
@pytest.fixture(scope="session")
def copy(tmp_path_factory):
    return project(tmp_path_factory.mktemp("copy").resolve())


def test_a_cell_one_side_cannot_run_is_refused_and_a_broken_tree_is_not_compared(copy, tmp_path):
    pairs, cells = {("base", 0), ("base", 1)}, [CELL, replace(CELL, method="no-such-method")]
    ratios, refused = speed.time_pairs({"tree": copy, "base": copy}, cells, pairs)
    assert set(ratios) == {("base", 0)}
    assert refused["tree", 1].startswith("UnknownName")
    (tmp_path / "src" / "contactbench").mkdir(parents=True)
    (tmp_path / "src" / "contactbench" / "__init__.py").write_text("raise RuntimeError('broken')")
    with pytest.raises(BadInput, match="timing process ended: RuntimeError: broken"):
        speed.time_pairs({"tree": tmp_path, "base": copy}, cells, pairs)


#: at the end of the package's own module: what every public call does beside its work
DELAYS = """
import time

{pause}

def late(function, seconds):
    def other(*given, **more):
        pause(seconds)
        return function(*given, **more)
    return other

class Late:
    def __init__(self, *given, run=prepare, **more):
        run = run(*given, **more)
        self.start, self.run, self.bare = run.start, late(run, 0.002), late(run.bare, 0.002)

    def __call__(self, **more):
        return self.run(**more)

solve, reference, prepare = late(solve, 0.2), late(reference, 0.2), Late
"""
#: time that passes, or is only told: a clock that nothing else moves
SLEEP = "pause = time.sleep; pause(1)"
TELL = (
    "now = [0.0]; pause = lambda seconds: now.append(now[-1] + seconds); time.perf_counter = lambda: now[-1]"
)
QUICK = ("solve", "run()", "run(q=…)", "bare")


@pytest.mark.parametrize("quick", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_delay_of_every_public_call_is_found_and_the_same_code_is_not_slower(quick, copy, monkeypatch):
    """All of them planted in the sources of the head; what is quick beside a pinned revision, as slow as its parent."""
    monkeypatch.setattr(speed, "ROUNDS", 7)
    cells = [cell for cell in public() if (cell.call in QUICK) is quick]
    file = copy / "src/contactbench/__init__.py"
    original = file.read_text()
    assert original.count("load_installed()\n") == 1
    delays = DELAYS.format(pause=TELL if quick else SLEEP)
    file.write_text(original.replace("load_installed()\n", "load_installed()\n" + delays))
    try:
        with revisions.checkout(copy, "HEAD") as tree:
            moved = speed.compare_speed(
                copy, copy if quick else tree, cells, pin="HEAD" if quick else ""
            ).moved
    finally:
        file.write_text(original)
    found = moved[moved["red"]]
    assert {*zip(found["scene"], found["setting"], strict=True)} == {(c.scene, c.setting) for c in cells}
    assert {*found["between"]} == {"pinned → tree" if quick else "base → tree"}


def test_a_clone_without_the_pinned_revision_is_inconclusive(copy, monkeypatch):
    monkeypatch.setattr(speed, "time_pairs", lambda *_: ({("base", 0): PASS}, {}))
    assert speed.compare_speed(copy, copy, [CELL]).status == 0
    found = speed.compare_speed(copy, copy, [CELL], pin="f" * 40)
    assert found.status == 2
    assert "pinned revision ffffffffffff is not in this clone" in found.incomplete[0]
