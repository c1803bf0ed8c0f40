"""Is the working tree slower, or does it take more memory, than another revision of it?

Each revision has a process of its own, with its sources on PYTHONPATH, on the same core.  A round times
every cell in shuffled order, base and head right after one another in random order, so that whatever else
the machine does meets both; the ratio of each pair is what counts, never a time.  A cell whose interval of
the median ratio straddles `LIMIT` gets more rounds.  It is judged slower when the whole interval is above
`LIMIT`, and is again in fresh processes: the layout of code and data in memory, drawn anew with every
process, is worth some per cent.  What is measured once in a process (compilation, memory) is judged when it
is too much in `CONFIRMED` pairs of processes; every process begins with empty caches of compiled programs.
"""

from __future__ import annotations

import json
import os
import random
import subprocess
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

from contactbench.errors import BadInput
from contactbench.gate.fresh import environment
from contactbench.gate.speed_worker import RUNS_SECONDS
from contactbench.gate.workload import Cell
from contactbench.measure.statistics import PairedRatio, paired_ratio

LIMIT = 1.25
ROUNDS = 15
#: rounds a cell gets at most, as long as it is undecided
MOST_ROUNDS = 60
#: share of the time that compilation may take
COMPILING = 0.6
#: seconds of processor time of compilation, and share of what the base takes, that the head may take more
COMPILE, COMPILE_SHARE = 0.1, 0.15
#: bytes that repeated runs of a cell may leave behind more than the base's
LEAK = 1_000_000
#: bytes that the process may take more at its peak, and as a share
PEAK, PEAK_SHARE = 30_000_000, 0.1
#: pairs of processes that must agree before compilation or memory is judged
CONFIRMED = 3


@dataclass(frozen=True)
class Costs:
    """What a process says once: seconds of compilation and bytes left behind by cell, and its peak in bytes."""

    compile: dict[int, float] = field(default_factory=dict)
    leaked: dict[int, float] = field(default_factory=dict)
    peak: float = 0.0


Pair = tuple[Costs, Costs]  #: of base and head
#: the number of no cell: the process as a whole
WHOLE = -1


@dataclass(frozen=True)
class Measured:
    """One pair of processes: the ratios of the cells timed, the cells refused and why, and what is said once."""

    ratios: dict[int, PairedRatio]
    refused: dict[int, str]
    costs: Pair
    unfinished: bool = False  #: whether the time was up before every cell was decided


def undecided(ratio: PairedRatio) -> bool:
    """Whether the interval has the limit in it."""
    return ratio.low <= LIMIT < ratio.high


def verdict(first: PairedRatio, again: PairedRatio | None) -> str:
    """slower, pass, or inconclusive; `again` is what fresh processes say of a cell that looks slower."""
    if first.high <= LIMIT:
        return "pass"
    return "slower" if first.low > LIMIT and again is not None and again.low > LIMIT else "inconclusive"


def measured(pair: Pair) -> set[int]:
    """The cells that both processes ran."""
    base, head = pair
    return base.compile.keys() & head.compile.keys()


def same_cells(pair: Pair) -> bool:
    """Whether both processes ran the same cells."""
    base, head = pair
    return base.compile.keys() == head.compile.keys()


def suspects(pair: Pair) -> dict[str, set[int]]:
    """The cells that compile longer or leave more behind than they may, and {WHOLE} where the peak is higher.

    The peaks of processes that ran different cells are not compared.
    """
    base, head = pair
    # a cell that one side had no time for, or refuses, is no suspect
    compiled, kept = measured(pair), base.leaked.keys() & head.leaked.keys()
    over = {
        "compilation": {
            i for i in compiled if head.compile[i] > base.compile[i] * (1 + COMPILE_SHARE) + COMPILE
        },
        "memory left behind": {i for i in kept if head.leaked[i] > base.leaked[i] + LEAK},
        "peak memory": {WHOLE}
        if same_cells(pair) and head.peak > base.peak * (1 + PEAK_SHARE) + PEAK
        else set(),
    }
    return {what: which for what, which in over.items() if which}


def looked_at(pair: Pair, i: int, first: Pair) -> bool:
    """Whether a pair has measured a cell; of the process as a whole, all cells of the first pair."""
    if i == WHOLE:
        return same_cells(pair) and measured(pair) >= measured(first)
    return i in measured(pair)


# -- processes -------------------------------------------------------------------------------------
def empty_caches(folder: Path) -> dict[str, str]:
    """Environment variables by which compiled programs are kept in a new folder, those of numba and of JAX.

    What one tree has compiled, or finds beside its sources, must not spare the other one the work.
    """
    return {
        "CONTACTBENCH_CACHE": str(folder),
        "NUMBA_CACHE_DIR": str(folder / "numba"),
        "JAX_COMPILATION_CACHE_DIR": str(folder / "xla"),
    }


class Side:
    """A process that times cells with the code of one tree.

    seconds : after which it prepares no more cells.
    """

    def __init__(
        self, python: str, tree: Path, cells: Sequence[Cell], core: int | None, later: int | None,
        seconds: float | None = None,
    ) -> None:  # fmt: skip
        self.tree = tree
        self.errors = tempfile.TemporaryFile("w+")  # noqa: SIM115, closed with the process
        self.caches = tempfile.TemporaryDirectory(prefix="contactbench-caches-")
        self.process = subprocess.Popen(
            [python, "-P", str(Path(__file__).with_name("speed_worker.py"))],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.errors, text=True, bufsize=1,
            cwd=tree, env=environment(tree) | empty_caches(Path(self.caches.name)),
        )  # fmt: skip
        requests = [cell.request() for cell in cells]
        self._say({"core": core, "later": later, "cells": requests, "seconds": seconds})

    def __enter__(self) -> Side:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        self.errors.close()
        self.caches.cleanup()

    def refused(self) -> dict[int, str]:
        """Wait until every cell is compiled; the cells that cannot be timed, and why."""
        answer = self._answer()
        if not Path(answer["code"]).is_relative_to(self.tree):
            raise BadInput(f"{self.tree}: the timing process imports {answer['code']} instead")
        return {int(i): why for i, why in answer["refused"].items()}

    def time(self, cell: int) -> float:
        """Seconds per call, the fastest of a few repeats: one that nothing interrupted."""
        self._say(cell)
        return float(min(self._answer()))

    def ask_costs(self) -> None:
        """Let it run every cell for what it leaves behind; `costs` waits for the end."""
        self._say("costs")

    def costs(self) -> Costs:
        answer = self._answer()
        compiled, leaked = ({int(i): v for i, v in answer[name].items()} for name in ("compile", "leaked"))
        return Costs(compiled, leaked, answer["peak"])

    def _say(self, what: Any) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(what) + "\n")
        self.process.stdin.flush()

    def _answer(self) -> Any:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if line:
            return json.loads(line)
        self.errors.seek(0)
        last = (self.errors.read().strip() or f"exit {self.process.wait()}").splitlines()[-1]
        raise BadInput(f"{self.tree}: the timing process ended: {last}")


def cores() -> tuple[int | None, int | None]:
    """The core both sides are timed on, and the one the second compiles on in the meantime."""
    if not hasattr(os, "sched_getaffinity"):
        return None, None
    allowed = sorted(os.sched_getaffinity(0))
    return allowed[-1], allowed[-2:][0]


def paired_times(
    pythons: Sequence[str], trees: Sequence[Path], cells: Sequence[Cell], rounds: int, seed: int,
    until: float | None = None,
) -> Measured:  # fmt: skip
    """Ratio second/first tree of every cell, from one new process each.

    rounds : for every cell; the undecided get as many again until they have `MOST_ROUNDS` or more.
    until : on the clock of `perf_counter`, when to stop.  Of what is left, compilation takes `COMPILING` at most, and
    what the runs for memory take at the end is set aside.
    """
    from tqdm import tqdm

    main, other = cores()
    draw = random.Random(seed)
    left = None if until is None else max(1.0, COMPILING * (until - perf_counter()))
    with ExitStack() as stack:
        sides = [
            stack.enter_context(Side(python, tree, cells, core, main, left))
            for python, tree, core in zip(pythons, trees, (main, other), strict=True)
        ]
        refused: dict[int, str] = {}
        for side, name in zip(sides, ("base", "head"), strict=True):
            refused |= {i: f"{name}: {why}" for i, why in side.refused().items() if i not in refused}
        times: dict[int, tuple[list[float], list[float]]] = {
            i: ([], []) for i in range(len(cells)) if i not in refused
        }
        if until is not None:
            until -= RUNS_SECONDS * len(times)
        ratios: dict[int, PairedRatio] = {}
        ask, late = list(times) if rounds else [], False
        while ask and not late:
            for _ in tqdm(range(rounds), f"timing {len(ask)} cells", unit="round", disable=None):
                late = until is not None and perf_counter() > until
                if late:
                    break
                for i in draw.sample(ask, len(ask)):
                    for k in draw.sample((0, 1), 2):
                        times[i][k].append(sides[k].time(i))
            ratios |= {i: paired_ratio(*times[i]) for i in ask if times[i][0]}
            ask = (
                [i for i in ask if undecided(ratios[i]) and ratios[i].rounds < MOST_ROUNDS] if ratios else []
            )
        for side in sides:
            side.ask_costs()
        costs = sides[0].costs(), sides[1].costs()
    return Measured(dict(sorted(ratios.items())), refused, costs, late)
