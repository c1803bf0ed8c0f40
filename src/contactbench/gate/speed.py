"""Is the working tree slower than another revision of it?  Both are timed in turns, side by side.

Each revision has a process of its own, with its sources on PYTHONPATH, on the same core.  A round
times every cell in shuffled order, base and head right after one another in random order, so that
whatever else the machine does meets both; the ratio of each pair is what counts, never a time.  A
cell whose interval of the median ratio straddles `LIMIT` gets more rounds.  It is judged slower when
the whole interval is above `LIMIT`, and is again in fresh processes: the layout of code and data in
memory, drawn anew with every process, is worth some per cent.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from filelock import FileLock, Timeout

from contactbench.errors import BadInput
from contactbench.results.statistics import PairedRatio, paired_ratio, timing
from contactbench.solution import printed_setting

LIMIT = 1.25
ROUNDS = 15
#: rounds a cell gets at most, as long as it is undecided
MOST_ROUNDS = 60
#: one of each kind, their kernels have no code in common; and a long one, where a fast loop outweighs its call
SCENES = ("particle", "particle_long", "rigid_body")
#: of a method's settings the finest that takes at most so long; a method that has none is not timed there
LONGEST = 3e-3


@dataclass(frozen=True)
class Cell:
    """One prepared call that is timed."""

    scene: str
    method: str
    engine: str
    control: str
    value: float
    carry: tuple[str, ...]

    @property
    def setting(self) -> str:
        return printed_setting(self.control, self.value)

    def request(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(frozen=True)
class Comparison:
    """Two revisions: each cell's ratio and verdict, and the cells that could not be timed, with why."""

    base: str
    head: str
    judged: tuple[tuple[Cell, PairedRatio, str], ...]
    refused: tuple[tuple[Cell, str], ...]


def workload(work: pd.DataFrame, scenes: Sequence[str] = SCENES) -> list[Cell]:
    """A cell for every method and engine of the work–precision table, at a setting that is worth timing."""
    timed = work[(work["variant"] == "") & (work["family"] != "limit") & (work["time_median_s"] <= LONGEST)]
    slowest = timed.sort_values("time_median_s").groupby(["scene", "method", "engine"], sort=False).tail(1)
    cells = []
    for _, row in slowest.sort_index()[lambda rows: rows["scene"].isin(scenes)].iterrows():
        carry = tuple(field for field in ("s", "R") if field in row["carried"].split())
        cells.append(
            Cell(row["scene"], row["method"], row["engine"], row["control"], float(row["value"]), carry)
        )
    return cells


def undecided(ratio: PairedRatio) -> bool:
    """Whether the interval has the limit in it."""
    return ratio.low <= LIMIT < ratio.high


def verdict(first: PairedRatio, again: PairedRatio | None) -> str:
    """slower, pass, or inconclusive; `again` is what fresh processes say of a cell that looks slower."""
    if first.high <= LIMIT:
        return "pass"
    return "slower" if first.low > LIMIT and again is not None and again.low > LIMIT else "inconclusive"


# -- processes -------------------------------------------------------------------------------------
def environment(tree: Path) -> dict[str, str]:
    """Environment variables with which a process runs the code of a tree."""
    own = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    return {"JAX_PLATFORMS": "cpu", **own, **threads, "PYTHONPATH": str(tree / "src")}


class Side:
    """A process that times cells with the code of one tree."""

    def __init__(self, python: str, tree: Path, cells: Sequence[Cell], core: int | None, later: int | None):
        self.tree = tree
        self.errors = tempfile.TemporaryFile("w+")  # noqa: SIM115, closed with the process
        self.process = subprocess.Popen(
            [python, "-P", str(Path(__file__).with_name("speed_worker.py"))],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.errors, text=True, bufsize=1,
            cwd=tree, env=environment(tree),
        )  # fmt: skip
        self._say({"core": core, "later": later, "cells": [cell.request() for cell in cells]})

    def __enter__(self) -> Side:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        self.errors.close()

    def refused(self) -> dict[int, str]:
        """Wait until every cell is compiled; the cells that cannot be timed, and why."""
        answer = self._answer()
        if not Path(answer["code"]).is_relative_to(self.tree):
            raise BadInput(f"{self.tree}: the timing process imports {answer['code']} instead")
        return {int(i): why for i, why in answer["refused"].items()}

    def time(self, cell: int) -> float:
        """Seconds per call, the fastest of a few repeats: one that nothing interrupted."""
        self._say(cell)
        return timing(self._answer()).minimum

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
    pythons: Sequence[str], trees: Sequence[Path], cells: Sequence[Cell], rounds: int, seed: int
) -> tuple[dict[int, PairedRatio], dict[int, str]]:
    """Ratio second/first tree of every cell, from one new process each, and the cells refused.

    rounds : for every cell; the undecided get as many again until they have `MOST_ROUNDS` or more.
    """
    from tqdm import tqdm

    main, other = cores()
    draw = random.Random(seed)
    with ExitStack() as stack:
        sides = [
            stack.enter_context(Side(python, tree, cells, core, main))
            for python, tree, core in zip(pythons, trees, (main, other), strict=True)
        ]
        refused: dict[int, str] = {}
        for side, name in zip(sides, ("base", "head"), strict=True):
            refused |= {i: f"{name}: {why}" for i, why in side.refused().items() if i not in refused}
        times: dict[int, tuple[list[float], list[float]]] = {
            i: ([], []) for i in range(len(cells)) if i not in refused
        }
        ratios: dict[int, PairedRatio] = {}
        ask = list(times)
        while ask:
            for _ in tqdm(range(rounds), f"timing {len(ask)} cells", unit="round", disable=None):
                for i in draw.sample(ask, len(ask)):
                    for k in draw.sample((0, 1), 2):
                        times[i][k].append(sides[k].time(i))
            ratios |= {i: paired_ratio(*times[i]) for i in ask}
            ask = [i for i in ask if undecided(ratios[i]) and ratios[i].rounds < MOST_ROUNDS]
    return dict(sorted(ratios.items())), refused


# -- revisions -------------------------------------------------------------------------------------
def git(root: Path, *arguments: str) -> str:
    """The output of git.  Raises `BadInput` with git's own last line."""
    if shutil.which("git") is None:
        raise BadInput("git: not installed; the speed of two revisions needs it (--only accuracy does not)")
    done = subprocess.run(["git", "-C", str(root), *arguments], capture_output=True, text=True)
    if done.returncode:
        last = (done.stderr.strip() or f"exit {done.returncode}").splitlines()[-1]
        raise BadInput(f"git {arguments[0]} in {root}: {last}")
    return done.stdout.strip()


def repository(folder: Path) -> Path:
    """The top of the working tree a folder is in.  Raises `BadInput` if it is not this project's."""
    root = Path(git(folder, "rev-parse", "--show-toplevel"))
    if not (root / "src" / "contactbench").is_dir():
        raise BadInput(f"{root}: no src/contactbench there; run the gate in a checkout of the project")
    return root


def dirty(root: Path) -> bool:
    """Whether the sources differ from the commit that is checked out."""
    return bool(git(root, "status", "--porcelain", "--", "src"))


def resolved(root: Path, revision: str | None) -> str:
    """The commit to compare with: by default HEAD if the sources have local changes, else its parent."""
    name = revision or ("HEAD" if dirty(root) else "HEAD~1")
    try:
        return git(root, "rev-parse", "--verify", "--quiet", "--end-of-options", f"{name}^{{commit}}")
    except BadInput:
        why = "no such revision (in a shallow clone fetch more history)"
        raise BadInput(f"--base {name}: {why}") from None


CHECKOUT = "contactbench-base-"


@contextmanager
def checkout(root: Path, commit: str) -> Iterator[Path]:
    """A working tree of a commit, for as long as the block lasts."""
    drop_dead_checkouts(root)
    with tempfile.TemporaryDirectory(prefix=CHECKOUT) as scratch, FileLock(Path(scratch) / "alive"):
        tree = Path(scratch).resolve() / "base"
        git(root, "worktree", "add", "--detach", "--force", str(tree), commit)
        try:
            if not (tree / "src" / "contactbench").is_dir():
                raise BadInput(f"--base {commit[:12]}: that revision has no src/contactbench")
            yield tree
        finally:
            git(root, "worktree", "remove", "--force", str(tree))


def drop_dead_checkouts(root: Path) -> None:
    """Remove the working trees of processes that were killed: nobody holds their lock any more."""
    for line in git(root, "worktree", "list", "--porcelain").splitlines():
        tree = Path(line.removeprefix("worktree "))
        if not line.startswith("worktree ") or not tree.parent.name.startswith(CHECKOUT):
            continue
        if tree.parent.exists():
            try:
                FileLock(tree.parent / "alive").acquire(blocking=False).lock.release()
            except Timeout:
                continue  # it lives
            shutil.rmtree(tree.parent, ignore_errors=True)
        git(root, "worktree", "prune")


def interpreter(tree: Path, root: Path) -> str:
    """The Python that runs a tree: ours, unless its pins differ from those of `root`; then one of its own."""
    if pins(tree) == pins(root):
        return sys.executable
    python = tree / ".venv" / "bin" / "python"
    install = [str(python), "-m", "pip", "install", "--quiet", "-c", "constraints.txt", "-e", ".[bench]"]
    for command in ([sys.executable, "-m", "venv", str(tree / ".venv")], install):
        done = subprocess.run(command, cwd=tree, capture_output=True, text=True)
        if done.returncode:
            last = (done.stderr.strip() or "no message").splitlines()[-1]
            raise BadInput(f"the base revision pins other versions, which could not be installed: {last}")
    return str(python)


def pins(tree: Path) -> tuple[Any, ...]:
    """What fixes the versions of everything but our own code."""
    project = tomllib.loads((tree / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    constraints = tree / "constraints.txt"
    return project["dependencies"], constraints.read_text(encoding="utf-8") if constraints.exists() else ""


def compare_revisions(root: Path, revision: str | None, cells: Sequence[Cell]) -> Comparison:
    """The working tree against a revision; cells that look slower are timed again in fresh processes.

    Raises `BadInput` when there is no git, no such revision, or a timing process cannot run.
    """
    root = repository(root)
    commit = resolved(root, revision)
    head = git(root, "rev-parse", "--short=12", "HEAD") + (" with local changes" if dirty(root) else "")
    with checkout(root, commit) as tree:
        pythons, trees = (interpreter(tree, root), sys.executable), (tree, root)
        ratios, refused = paired_times(pythons, trees, cells, ROUNDS, seed=1)
        if not ratios:
            raise BadInput(f"no cell could be timed; {cells[0].method}: {refused[0]}")
        suspects = [i for i, ratio in ratios.items() if ratio.low > LIMIT]
        again: dict[int, PairedRatio] = {}
        if suspects:
            found, _ = paired_times(pythons, trees, [cells[i] for i in suspects], ROUNDS, seed=2)
            again = {suspects[k]: ratio for k, ratio in found.items()}
    return Comparison(
        commit[:12], head,
        tuple((cells[i], ratio, verdict(ratio, again.get(i))) for i, ratio in ratios.items()),
        tuple((cells[i], why) for i, why in refused.items()),
    )  # fmt: skip
