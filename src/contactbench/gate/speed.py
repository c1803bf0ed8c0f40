"""Is the working tree slower than other revisions of it?  Timed in pairs, each revision in a process of its own.

A round times every cell in shuffled order, the revisions right after one another in random order, so that whatever else
the machine does meets all of them; the ratio of each pair is what counts, never a time.
"""

from __future__ import annotations

import json
import random
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from subprocess import PIPE
from time import perf_counter
from typing import Any

import pandas as pd

from contactbench.errors import BadInput
from contactbench.gate import revisions
from contactbench.gate.compare import INCONCLUSIVE, Findings, rows_of
from contactbench.measure.statistics import PairedRatio, paired_ratio
from contactbench.methods import METHODS
from contactbench.scenes import SCENES
from contactbench.solution import setting_key

LIMIT = 1.25
ROUNDS = 15
#: rounds a cell gets at most, as long as it is undecided
MOST_ROUNDS = 60
#: how much of a message that says why a cell is not timed
WORDS = 80
#: shares of the time: what compilation may take, and what is kept for the second look
COMPILING, SECOND_LOOK = 0.6, 0.25

#: the tree that is judged, and what it is compared with; a pair is one of the latter and the number of a cell
HEAD, BASE, PINNED = "tree", "base", "pinned"
type Pair = tuple[str, int]
#: how a timing process is asked, and answers
type Send = Callable[[object], None]
type Receive = Callable[[], Any]

#: one of each kind, their kernels have no code in common; and a long one, where a fast loop outweighs its call
MAIN = ("particle", "particle_long", "rigid_body")
#: the methods that are timed on every other scene too
EVERYWHERE = ("contact-rkn6", "rk4", "heyoka-taylor")
#: the scene of the runs with many saved times, and how many those are
MANY_ON, MANY = "particle", 1000
#: of a method's settings the finest that takes at most so many seconds; a method that has none is not timed there
LONGEST = 3e-3


@dataclass(frozen=True)
class Cell:
    """A call that is timed, of a prepared run or a public one; saves : equidistant saved times, the end among them."""

    scene: str
    method: str = "contact-rkn6"
    engine: str = "llvm"
    control: str = "step"
    value: float = 0.1
    carry: tuple[str, ...] = ()
    saves: int = 1
    call: str = "prepared"

    @property
    def kind(self) -> str:
        return self.method if self.call == "prepared" else self.call

    @property
    def setting(self) -> str:
        many = f", {self.saves} saved times" if self.saves > 1 else ""
        call = f", {self.call}" if self.call != "prepared" else ""
        return f"{setting_key(self.control, self.value)}{many}{call}"


#: a short run, of so many steps: what a call takes beside them
SHORT, STEPS = "particle", 12
#: what a user calls, on standard scenes; references on those where they take little: in closed form, and live
PUBLIC = [Cell(SHORT, value=SCENES[SHORT].t_end / STEPS, call=call) for call in ("run()", "run(q=…)", "bare")]
PUBLIC += [Cell("particle", call=call) for call in ("solve", "new scene", "import")]
PUBLIC += [Cell(scene, call="reference") for scene in ("oscillator", "saddle_edge")]


def workload(work: pd.DataFrame) -> list[Cell]:
    """Return every method and engine on `MAIN`, a few elsewhere or with many saved times, and the public calls."""
    cells = []
    for cell in every(work):
        if cell.scene in MAIN or cell.method in EVERYWHERE:
            cells.append(cell)
        known = METHODS.get(cell.method)
        if cell.scene == MANY_ON and known is not None and cell.engine == known.engines[0]:
            cells.append(replace(cell, saves=MANY))
    return [*cells, *PUBLIC] if cells else []


def every(work: pd.DataFrame) -> list[Cell]:
    """Return every method and engine on every scene of a table, each at the finest setting that is soon done."""
    timed = work[(work["variant"] == "") & (work["time_median_s"] <= LONGEST)]
    slowest = timed.sort_values("time_median_s").groupby(["scene", "method", "engine"], sort=False).tail(1)
    cells = []
    for row in slowest.sort_index().itertuples():
        carry = tuple(field for field in ("s", "R") if field in row.carried.split())
        cells.append(Cell(row.scene, row.method, row.engine, row.control, float(row.value), carry))
    return cells


def too_few(cells: Sequence[Cell], timed: Collection[int]) -> tuple[str, ...]:
    left_out = sorted({cell.kind for cell in cells} - {cells[i].kind for i in timed})
    few = [f"only {len(timed)} of {len(cells)} cells timed"] if 2 * len(timed) < len(cells) else []
    return (*few, *([f"no cell timed of {', '.join(left_out)}"] if left_out else []))


def compare_speed(
    root: Path, tree: Path, cells: Sequence[Cell], budget: float | None = None, pin: str = ""
) -> Findings:
    start = perf_counter()
    ends = [None, None] if budget is None else [start + (1 - SECOND_LOOK) * budget, start + budget]
    # time may end early: other cells first in every change; the calls in front, and one of each method
    cells = random.Random(revisions.commit(root, "HEAD")).sample(cells, len(cells))
    kinds = pd.Series([cell.kind for cell in cells])
    turns = kinds.groupby(kinds).cumcount()
    cells = [cells[i] for i in sorted(turns.index, key=lambda i: (cells[i] not in PUBLIC, turns[i]))]
    pairs = {(BASE, i) for i in range(len(cells))}
    with ExitStack() as stack:
        trees, incomplete = {HEAD: root, BASE: tree}, []
        if pin and (commit := revisions.commit(root, pin)):
            trees[PINNED] = stack.enter_context(revisions.checkout(root, commit))
            pairs |= {(PINNED, i) for i, cell in enumerate(cells) if cell in PUBLIC}
        elif pin:
            incomplete = [f"the pinned revision {pin[:12]} is not in this clone; git fetch origin {pin}"]
        first, refused = time_pairs(trees, cells, pairs, ends[0], root)
        suspects = {pair for pair, ratio in first.items() if ratio.low > LIMIT}
        again = time_pairs(trees, cells, suspects, ends[1], root)[0] if suspects else {}
    rows = []
    for pair, ratio in sorted(first.items()):
        result = decide(ratio, again.get(pair))
        if result != "pass":
            row = {name: getattr(cells[pair[1]], name) for name in ("scene", "method", "engine", "setting")}
            after = f"×{ratio.ratio:.2f} (×{ratio.low:.2f} … ×{ratio.high:.2f})"
            row |= {"between": f"{pair[0]} → tree", "measure": "time", "before": "×1", "after": after}
            rows.append(row | {"result": result, "red": result == "slower"})
    timed = {side: {i: ratio for (one, i), ratio in first.items() if one == side} for side in (BASE, PINNED)}
    middle = median(ratio.ratio for ratio in timed[BASE].values()) if timed[BASE] else 1.0
    texts = [f"speed: {len(timed[BASE])} of {len(cells)} cells timed, median ratio {middle:.3f} to the base"]
    if timed[PINNED]:
        calls = (
            f"{cells[i].call} on {cells[i].scene} ×{ratio.ratio:.2f}" for i, ratio in timed[PINNED].items()
        )
        texts.append(f"speed to the pinned {pin[:12]}: {', '.join(calls)}")
    elif PINNED in trees:
        incomplete.append(f"no call timed beside the pinned {pin[:12]}")
    reasons = Counter(f"not timed on the {side}: {why[:WORDS]}" for (side, _), why in refused.items())
    notes = tuple(f"{count} cells {why}" for why, count in reasons.items())
    return Findings(rows_of(*rows), tuple(texts), notes, (*too_few(cells, timed[BASE]), *incomplete))


def decide(first: PairedRatio, again: PairedRatio | None) -> str:
    """Return whether a cell is slower: so it is in fresh processes too, whose layout in memory is drawn anew."""
    if first.high <= LIMIT:
        return "pass"
    return "slower" if first.low > LIMIT and again is not None and again.low > LIMIT else INCONCLUSIVE


def time_pairs(
    trees: Mapping[str, Path],
    cells: Sequence[Cell],
    pairs: Collection[Pair],
    until: float | None = None,
    root: Path | None = None,
) -> tuple[dict[Pair, PairedRatio], dict[Pair, str]]:
    """Return for each pair of a revision and a cell the ratio of the head to it, or why there is none.

    until : when to stop.
    """
    from tqdm import tqdm

    draw = random.Random(0)
    left = None if until is None else max(1.0, COMPILING * (until - perf_counter()))
    # the head has every cell that one of the others has
    asked = {side: {i for one, i in pairs if side in (one, HEAD)} for side in trees}
    refused: dict[Pair, str] = {}
    with ExitStack() as stack:
        used = (side for side in asked if asked[side])
        sides = {side: stack.enter_context(timing_process(trees[side], root)) for side in used}
        for side, (send, _) in sides.items():  # all compile at once
            send({"cells": {i: asdict(cells[i]) for i in sorted(asked[side])}, "seconds": left})
        for side, (_, receive) in sides.items():
            answer = receive()
            if revisions.ours(trees[side]) and not Path(answer["code"]).is_relative_to(trees[side]):
                raise BadInput(f"{trees[side]}: the timing process imports {answer['code']} instead")
            refused |= {(side, int(i)): why for i, why in answer["refused"].items()}
        times: dict[Pair, tuple[list[float], list[float]]]
        times = {pair: ([], []) for pair in sorted(pairs) if not {pair, (HEAD, pair[1])} & refused.keys()}
        ratios: dict[Pair, PairedRatio] = {}
        ask = list(times)
        for done in tqdm(range(1, MOST_ROUNDS + 1), "timing", unit="round", disable=None):
            if not ask or (until is not None and perf_counter() > until):
                break
            numbers = sorted({i for _, i in ask})
            for i in draw.sample(numbers, len(numbers)):
                now = [HEAD, *(side for side, j in ask if j == i)]
                fastest = {}
                for side in draw.sample(now, len(now)):
                    send, receive = sides[side]
                    send(i)
                    fastest[side] = min(receive())  # of the repeats: one that nothing interrupted
                for side in now[1:]:
                    for own, seconds in zip(times[side, i], (fastest[side], fastest[HEAD]), strict=True):
                        own.append(seconds)
            if done % ROUNDS == 0:
                ratios |= {pair: paired_ratio(*times[pair]) for pair in ask}
                ask = [pair for pair in ask if ratios[pair].low <= LIMIT < ratios[pair].high]
    return ratios | {pair: paired_ratio(*times[pair]) for pair in ask if times[pair][0]}, refused


@contextmanager
def timing_process(tree: Path, root: Path | None = None) -> Iterator[tuple[Send, Receive]]:
    command = [sys.executable, "-P", str(Path(__file__).with_name("speed_worker.py"))]
    with (
        tempfile.TemporaryFile("w+") as errors,
        tempfile.TemporaryDirectory(prefix="contactbench-caches-") as caches,
    ):
        # programs that one side has compiled must not spare the other the work
        names = ("CONTACTBENCH_CACHE", "NUMBA_CACHE_DIR", "JAX_COMPILATION_CACHE_DIR")
        variables = revisions.environment(tree, root) | dict.fromkeys(names, caches)
        process = subprocess.Popen(
            command, text=True, bufsize=1, env=variables, cwd=tree, stdin=PIPE, stdout=PIPE, stderr=errors
        )
        to, out = process.stdin, process.stdout
        assert to is not None
        assert out is not None

        def send(request: object) -> None:
            to.write(json.dumps(request) + "\n")

        def receive() -> Any:
            line = out.readline()
            if line:
                return json.loads(line)
            errors.seek(0)
            last = (errors.read().strip() or f"exit {process.wait()}").splitlines()[-1]
            raise BadInput(f"{tree}: the timing process ended: {last}")

        try:
            yield send, receive
        finally:
            process.kill()
            process.wait()
