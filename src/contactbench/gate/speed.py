"""Is the working tree slower than another revision of it?  Timed in pairs.

Each revision has a process of its own, with its sources on PYTHONPATH, on the same core.  A round times every cell in
shuffled order, base and head right after one another in random order, so that whatever else the machine does meets
both; the ratio of each pair is what counts, never a time.  A cell whose interval of the median ratio straddles `LIMIT`
gets more rounds.  It is slower when the whole interval is above `LIMIT`, and is again in fresh processes: the layout
of code and data in memory, drawn anew with every process, is worth some per cent.
"""

from __future__ import annotations

import json
import random
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import pandas as pd

from contactbench.errors import BadInput
from contactbench.gate import revisions
from contactbench.gate.compare import INCONCLUSIVE, Findings, rows_of
from contactbench.measure.statistics import PairedRatio, paired_ratio
from contactbench.methods import METHODS
from contactbench.solution import setting_key

LIMIT = 1.25
ROUNDS = 15
#: rounds a cell gets at most, as long as it is undecided
MOST_ROUNDS = 60
#: shares of the time: what compilation may take, and what is kept for the second look
COMPILING, SECOND_LOOK = 0.6, 0.25

#: one of each kind, their kernels have no code in common; and a long one, where a fast loop outweighs its call
SCENES = ("particle", "particle_long", "rigid_body")
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
    engine: str = "numba"
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


#: what a user calls, on standard scenes; references on those where they take little: in closed form, and live
PUBLIC = [Cell("particle", call=call) for call in ("solve", "run(q=…)", "new scene", "ensemble", "import")]
PUBLIC += [Cell(scene, call="reference") for scene in ("oscillator", "saddle_edge")]


def workload(work: pd.DataFrame) -> list[Cell]:
    """Return every method and engine on `SCENES`, a few elsewhere or with many saved times, and the public calls."""
    cells = []
    for cell in every(work):
        if cell.scene in SCENES or cell.method in EVERYWHERE:
            cells.append(cell)
        known = METHODS.get(cell.method)
        if cell.scene == MANY_ON and known is not None and cell.engine == known.engines[0]:
            cells.append(replace(cell, saves=MANY))
    return [*cells, *PUBLIC] if cells else []


def every(work: pd.DataFrame) -> list[Cell]:
    """Return every method and engine on every scene of a table, each at the finest setting that is soon done."""
    timed = work[(work["variant"] == "") & (work["family"] != "limit") & (work["time_median_s"] <= LONGEST)]
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


def judge_speed(root: Path, tree: Path, cells: Sequence[Cell], budget: float | None = None) -> Findings:
    start = perf_counter()
    ends = [None, None] if budget is None else [start + (1 - SECOND_LOOK) * budget, start + budget]
    # time may end early: other cells first in every change, of each kind one in front
    cells = random.Random(revisions.commit(root, "HEAD")).sample(cells, len(cells))
    kinds = pd.Series([cell.kind for cell in cells])
    cells = [cells[i] for i in kinds.groupby(kinds).cumcount().argsort(kind="stable")]
    first, refused = time_pairs((tree, root), dict(enumerate(cells)), ends[0], root)
    suspects = {i: cells[i] for i, ratio in first.items() if ratio.low > LIMIT}
    again = time_pairs((tree, root), suspects, ends[1], root)[0] if suspects else {}
    rows = []
    for i, ratio in first.items():
        result = decide(ratio, again.get(i))
        if result != "pass":
            row = {name: getattr(cells[i], name) for name in ("scene", "method", "engine", "setting")}
            after = f"×{ratio.ratio:.2f} (×{ratio.low:.2f} … ×{ratio.high:.2f})"
            row |= {"measure": "time", "before": "×1", "after": after, "result": result}
            rows.append(row | {"red": result == "slower"})
    median = sorted(ratio.ratio for ratio in first.values())[len(first) // 2] if first else 1.0
    sentence = f"speed: {len(first)} of {len(cells)} cells timed, median ratio {median:.3f} to the base"
    notes = tuple(f"{count} cells not timed: {why}" for why, count in Counter(refused.values()).items())
    return Findings(rows_of(*rows), (sentence,), notes, too_few(cells, first))


def decide(first: PairedRatio, again: PairedRatio | None) -> str:
    if first.high <= LIMIT:
        return "pass"
    return "slower" if first.low > LIMIT and again is not None and again.low > LIMIT else INCONCLUSIVE


def time_pairs(
    trees: Sequence[Path], cells: dict[int, Cell], until: float | None = None, root: Path | None = None
) -> tuple[dict[int, PairedRatio], dict[int, str]]:
    """Return of every cell the ratio of the second to the first tree, or why it has none; until : when to stop."""
    from tqdm import tqdm

    draw = random.Random(0)
    left = None if until is None else max(1.0, COMPILING * (until - perf_counter()))
    with ExitStack() as stack:
        sides = [stack.enter_context(timing_process(tree, root)) for tree in trees]
        for send, _ in sides:  # both compile at once
            send({"cells": {i: asdict(cell) for i, cell in cells.items()}, "seconds": left})
        refused: dict[int, str] = {}
        for tree, (_, receive) in zip(trees, sides, strict=True):
            answer = receive()
            if revisions.ours(tree) and not Path(answer["code"]).is_relative_to(tree):
                raise BadInput(f"{tree}: the timing process imports {answer['code']} instead")
            refused |= {int(i): why for i, why in answer["refused"].items()}
        times: dict[int, tuple[list[float], list[float]]] = {i: ([], []) for i in cells if i not in refused}
        ratios: dict[int, PairedRatio] = {}
        ask = list(times)
        for done in tqdm(range(1, MOST_ROUNDS + 1), "timing", unit="round", disable=None):
            if not ask or (until is not None and perf_counter() > until):
                break
            for i in draw.sample(ask, len(ask)):
                for k in draw.sample((0, 1), 2):
                    send, receive = sides[k]
                    send(i)
                    times[i][k].append(min(receive()))  # the fastest repeat: one that nothing interrupted
            if done % ROUNDS == 0:
                ratios |= {i: paired_ratio(*times[i]) for i in ask}
                ask = [i for i in ask if ratios[i].low <= LIMIT < ratios[i].high]
    return ratios | {i: paired_ratio(*times[i]) for i in ask if times[i][0]}, refused


@contextmanager
def timing_process(
    tree: Path, root: Path | None = None
) -> Iterator[tuple[Callable[[Any], None], Callable[[], Any]]]:
    command = [sys.executable, "-P", str(Path(__file__).with_name("speed_worker.py"))]
    with (
        tempfile.TemporaryFile("w+") as errors,
        tempfile.TemporaryDirectory(prefix="contactbench-caches-") as caches,
    ):
        # programs that one side has compiled must not spare the other the work
        names = ("CONTACTBENCH_CACHE", "NUMBA_CACHE_DIR", "JAX_COMPILATION_CACHE_DIR")
        variables = revisions.environment(tree, root) | dict.fromkeys(names, caches)
        pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": errors}
        process: Any = subprocess.Popen(command, text=True, bufsize=1, env=variables, cwd=tree, **pipes)

        def send(request: Any) -> None:
            process.stdin.write(json.dumps(request) + "\n")

        def receive() -> Any:
            line = process.stdout.readline()
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
