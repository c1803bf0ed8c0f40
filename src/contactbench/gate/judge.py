"""The gate: which tables and which revisions are compared, and what becomes of the two parts."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd

from contactbench.errors import BadInput
from contactbench.gate import committed, revisions, speed
from contactbench.gate.accuracy import against, runs
from contactbench.gate.fresh import environment, fresh_run
from contactbench.gate.verdict import Line, Verdict
from contactbench.gate.workload import Cell, workload
from contactbench.results.provenance import MADE
from contactbench.results.schema import TABLES
from contactbench.results.store import read

PARTS = ("accuracy", "speed")


@dataclass(frozen=True)
class Question:
    """What is to be judged.

    root : a folder of the working tree.  results : its tables, relative to the top of the tree.
    fresh : tables of a run just made; None: they are made now.  base : the revision to compare with.
    changed : tables that are meant to change, beside those the commits name.  budget : seconds of the speed part.
    """

    root: Path
    results: Path = Path("results")
    fresh: Path | None = None
    base: str | None = None
    parts: Sequence[str] = PARTS
    changed: Iterable[str] = field(default=())
    budget: float | None = None


def gate(question: Question) -> Verdict:
    """Run the parts asked for; see the command line's help."""
    root = revisions.repository(question.root)
    base = revisions.base(root, question.base)
    folder = question.results if not question.results.is_absolute() else question.results.relative_to(root)
    with (
        tempfile.TemporaryDirectory(prefix="contactbench-gate-") as scratch,
        revisions.checkout(root, base) as tree,
    ):
        old = tree / folder
        if not any(old.glob("*.csv")):
            raise BadInput(f"--base {base[:12]}: no tables in {folder}/ at that revision")
        verdict = changed_rules(tree, root)
        if "accuracy" in question.parts:
            verdict += tables_against(question, root, base, root / folder, old, Path(scratch))
        if "speed" in question.parts:
            work = read(TABLES["work_precision"], old)
            if work.empty:
                raise BadInput(f"--base {base[:12]}: no timed rows to choose from in {folder}/")
            verdict += slower(root, workload(work), base, question.budget)
    return verdict


# -- rules -----------------------------------------------------------------------------------------
def by_base(question: Question, as_json: bool = False) -> int | None:
    """Have the gate of the base revision judge this tree: its exit status, its verdict is printed.

    A tree whose own gate judged it could move its own goal.  None where this process is that gate, or the base is too
    old to have one.
    """
    if revisions.JUDGED in os.environ:
        return None
    root = revisions.repository(question.root)
    base = revisions.base(root, question.base)
    with revisions.checkout(root, base) as tree:
        if not revisions.judges(tree):
            return None
        given = {
            "only": question.parts[0] if len(question.parts) == 1 else None, "results": question.results,
            "fresh": question.fresh, "budget": question.budget,
        }  # fmt: skip
        options = [f"--{name}={value}" for name, value in given.items() if value is not None]
        options += [f"--tables-changed={name}" for name in question.changed] + ["--json"] * as_json
        command = [revisions.interpreter(tree, root), "-P", "-m", "contactbench.cli", "gate", "--base", base]
        variables = environment(tree) | {revisions.JUDGED: sys.executable}
        with subprocess.Popen(
            [*command, *options], cwd=question.root, env=variables, stdout=subprocess.PIPE, text=True
        ) as run:
            try:
                print(run.communicate()[0], end="")
            except BaseException:
                run.terminate()  # it removes what it has made, and ends
                raise
        return run.returncode


def changed_rules(tree: Path, root: Path) -> Verdict:
    """A line for each rule of the base that is another one in the tree that is judged.

    Where it is not the base's gate that judges, they leave open what it would have said.
    """
    before, after = rulebook(tree), rulebook(root)
    if not before or not after:
        return Verdict(notes=("inconclusive: the rules of the base and of this tree could not be compared",))
    own = revisions.JUDGED not in os.environ
    words = "inconclusive" if own else "rule changed, the base's judges"
    lines = [
        Line(f"rule {name}" if kind == "rules" else f"code of {name}", old[:40], new[:40], "", words, False)
        for kind in before
        for name, old in before[kind].items()
        if (new := after[kind].get(name, "none")) != old
    ]
    moved = own and any(line.measure.startswith("rule ") for line in lines)
    return Verdict(tuple(lines), incomplete=("the base is too old to judge by its own rules",) * moved)


def rulebook(tree: Path) -> dict[str, dict[str, str]]:
    """The rules of a tree, and digests of their code; none where it is too old, or broken."""
    command = [sys.executable, "-P", str(Path(__file__).with_name("rulebook.py"))]
    done = subprocess.run(command, cwd=tree, env=environment(tree), capture_output=True, text=True)
    return json.loads(done.stdout) if done.returncode == 0 else {}


# -- accuracy --------------------------------------------------------------------------------------
def tables_against(
    question: Question, root: Path, base: str, results: Path, old: Path, scratch: Path
) -> Verdict:
    """A fresh run, and the tables of the tree, against those of the base revision."""
    changed = committed.listed(revisions.messages(root, base), question.changed, results)
    made_before = runs(old)
    before, lines = committed.readable(old, changed)
    head, other_version = committed.readable(results, changed)
    lines += other_version + committed.record_lines(results, head)
    told: list[str] = []
    for name, table in TABLES.items():
        lines += committed.differences(table, before[name], head[name], name in changed)
        told += filter(None, [committed.described(table, before[name], head[name])])
    notes = [f"tables changed in this change: {', '.join(told)}"] if told else []
    verdict = Verdict(tuple(lines), (f"tables: {results} against {base[:12]}",), tuple(notes))

    fresh = question.fresh
    if fresh is None:
        fresh = scratch
        verdict += Verdict(tuple(fresh_run(root, fresh)))
    reference = {name: head[name] if name in changed else before[name] for name in TABLES}
    fresh_tables, _ = committed.readable(fresh, changed)
    compared = against(reference, made_before, fresh_tables, fresh, f"the tables of {base[:12]}")
    clean = not revisions.dirty(root, ".", *(f":!{made}" for made in MADE))
    more = [
        *committed.record_lines(fresh, fresh_tables),
        *committed.commit_lines(fresh, revisions.commit_of(root, "HEAD"), clean),
    ]
    for name, table in TABLES.items():
        more += committed.taken_out(table, before[name], head[name], fresh_tables[name])
        more += uncommitted(name, head[name], before[name], fresh_tables[name])
    return verdict + compared + Verdict(tuple(more))


def uncommitted(name: str, head: pd.DataFrame, before: pd.DataFrame, fresh: pd.DataFrame) -> list[Line]:
    """Red where a run makes a table that is not among the committed ones."""
    if len(head) or len(before) or not len(fresh):
        return []
    return [Line(f"table {name}", "none", f"{len(fresh)} rows", "", "not committed", True, table=name)]


# -- speed -----------------------------------------------------------------------------------------
def slower(root: Path, cells: Sequence[Cell], revision: str | None, budget: float | None = None) -> Verdict:
    """The working tree in `root` against a revision of it, on cells.

    Raises `BadInput` when there is no git, no such revision, or a timing process cannot run.
    """
    if not cells:
        raise BadInput("no timed rows to choose from; run the benchmark first (tox -e bench)")
    root = revisions.repository(root)
    commit = revisions.base(root, revision)
    head = revisions.git(root, "rev-parse", "--short=12", "HEAD")
    head += " with local changes" if revisions.dirty(root) else ""
    until = None if budget is None else perf_counter() + budget
    cells = cells if budget is None else kinds_first(cells, commit)
    with revisions.checkout(root, commit) as tree:
        head_python = os.environ.get(revisions.JUDGED, "")  # set: this process is the base's own
        base_python = sys.executable if head_python else revisions.interpreter(tree, root)
        pythons, trees = (base_python, head_python or sys.executable), (tree, root)
        # neither has to compile modules it imports late
        for python, sources in zip(pythons, trees, strict=True):
            subprocess.run([python, "-m", "compileall", "-q", str(sources / "src")], capture_output=True)
        return timed(pythons, trees, cells, until, (commit[:12], head))


def kinds_first(cells: Sequence[Cell], seed: str) -> list[Cell]:
    """Shuffled, the first of every kind in front, then those of its engines, before any second: time may end early."""
    seen: Counter[Any] = Counter()
    ranked = []
    for cell in random.Random(seed).sample(cells, len(cells)):
        both = cell.kind, cell.engine
        ranked.append((1 + seen[both] if seen[cell.kind] else 0, cell))
        seen.update((cell.kind, both))
    return [cell for _, cell in sorted(ranked, key=lambda pair: pair[0])]


def timed(
    pythons: Sequence[str], trees: Sequence[Path], cells: Sequence[Cell], until: float | None,
    names: tuple[str, str],
) -> Verdict:  # fmt: skip
    """Time cells of two trees; those that look slower again in fresh processes."""
    first = speed.paired_times(
        pythons, trees, cells, speed.ROUNDS, seed=1, until=until and until - reserve(until)
    )
    again: dict[int, speed.PairedRatio] = {}
    suspects = [i for i, ratio in first.ratios.items() if ratio.low > speed.LIMIT]
    if suspects:
        found = speed.paired_times(
            pythons, trees, [cells[i] for i in suspects], speed.ROUNDS, seed=2, until=until
        )
        again = {suspects[k]: ratio for k, ratio in found.ratios.items()}
    lines = [
        Line(
            "time", "×1", f"×{ratio.ratio:.2f}", f"×{ratio.low:.2f} … ×{ratio.high:.2f}", said, said == "slower",
            cells[i].scene, cells[i].method, cells[i].engine, cells[i].setting,
        )
        for i, ratio in first.ratios.items()
        if (said := speed.verdict(ratio, again.get(i))) != "pass"
    ]  # fmt: skip
    lines += once_a_process(pythons, trees, cells, first.costs, until)
    notes, few = refusals(cells, first), too_few(cells, first.ratios)
    return Verdict(tuple(lines), sentences(first, lines, names), notes, len(first.ratios), few)


def too_few(cells: Sequence[Cell], timed: Collection[int]) -> tuple[str, ...]:
    """Why the cells that were timed are no sample of all: below half of them, or none of a method or public call."""
    left_out = sorted({cell.kind for cell in cells} - {cells[i].kind for i in timed})
    return (
        *[f"only {len(timed)} of {len(cells)} cells timed"] * (2 * len(timed) < len(cells)),
        *[f"no cell timed of {', '.join(left_out)}"] * bool(left_out),
    )


def reserve(until: float) -> float:
    """Of the time that is left, what is kept for the second look."""
    return max(0.0, (until - perf_counter()) / 4)


def sentences(first: speed.Measured, lines: Sequence[Line], names: tuple[str, str]) -> tuple[str, ...]:
    if not first.ratios:
        return (f"speed: {names[1]} against {names[0]}: no cell timed",)
    middle = float(np.median([ratio.ratio for ratio in first.ratios.values()]))
    red = sum(line.red for line in lines)
    open_ = sum(line.verdict == "inconclusive" for line in lines)
    cleared = len(first.ratios) - sum(line.measure == "time" for line in lines)
    words = (
        f"speed: {names[1]} against {names[0]}: {cleared} of {len(first.ratios)} cells no slower, {red} red, "
        f"{open_} inconclusive, median ratio {middle:.3f}; red when the whole 95 % interval is above "
        f"{speed.LIMIT} twice, in fresh processes"
    )
    if not first.unfinished:
        return (words,)
    least = min(ratio.rounds for ratio in first.ratios.values())
    return (
        words,
        f"speed: inconclusive beyond that, the time was up after {least} rounds of {speed.ROUNDS} or more",
    )


def refusals(cells: Sequence[Cell], found: speed.Measured) -> tuple[str, ...]:
    """Why cells were not timed, and what cannot be compared for it; those there was no time for in one note."""
    late = [i for i, why in found.refused.items() if why.endswith("no time left")]
    notes = [
        f"{cells[i].scene} {cells[i].method} ({cells[i].engine}) not timed: {why}"
        for i, why in found.refused.items()
        if i not in late
    ]
    if late:
        notes.append(f"inconclusive: no time to compile {len(late)} of {len(cells)} cells")
    if not speed.same_cells(found.costs):
        notes.append("peak memory not compared: the two processes ran different cells")
    return tuple(notes)


def once_a_process(
    pythons: Sequence[str], trees: Sequence[Path], cells: Sequence[Cell], first: speed.Pair, until: float | None
) -> list[Line]:  # fmt: skip
    """Compilation and memory: red where they are too much in every one of `CONFIRMED` pairs of processes.

    A pair that measures a suspect and finds nothing clears it; one that there was no time to measure again stays,
    inconclusive.
    """
    found = Counter((what, i) for what, which in speed.suspects(first).items() for i in which)
    pairs = [first]
    while found and len(pairs) < speed.CONFIRMED and (until is None or perf_counter() < until):
        suspects = {i for _, i in found}
        which = sorted(suspects - {speed.WHOLE})  # first: there may be no time for more
        if speed.WHOLE in suspects:
            which += [i for i in range(len(cells)) if i not in which]
        again = speed.paired_times(pythons, trees, [cells[i] for i in which], 0, seed=0, until=until)
        base, head = (renumbered(side, which) for side in again.costs)
        pairs.append((base, head))
        now = speed.suspects(pairs[-1])
        for what, i in list(found):
            if i in now.get(what, set()):
                found[what, i] += 1
            elif speed.looked_at(pairs[-1], i, first):
                del found[what, i]
    lines = []
    for (what, i), times in sorted(found.items()):
        measured = [pair for pair in pairs if speed.looked_at(pair, i, first)]
        lines.append(spent(what, i, cells, measured, times == speed.CONFIRMED))
    return lines


def renumbered(costs: speed.Costs, which: Sequence[int]) -> speed.Costs:
    """The costs of some cells by the numbers these have among all."""
    return speed.Costs(
        {which[k]: v for k, v in costs.compile.items()}, {which[k]: v for k, v in costs.leaked.items()}, costs.peak
    )  # fmt: skip


def spent(what: str, i: int, cells: Sequence[Cell], pairs: Sequence[speed.Pair], sure: bool) -> Line:
    """The line of a cost: the medians of both sides over the pairs of processes that were asked for it."""

    def middle(side: int) -> float:
        value: Callable[[speed.Costs], float] = {
            "compilation": lambda c: c.compile[i],
            "memory left behind": lambda c: c.leaked[i] / 1e6,
            "peak memory": lambda c: c.peak / 1e6,
        }[what]
        return float(np.median([value(pair[side]) for pair in pairs]))

    before, after = middle(0), middle(1)
    unit = "s" if what == "compilation" else "MB"
    cell = cells[i] if i != speed.WHOLE else None
    words = (what, f"{before:.3g} {unit}", f"{after:.3g} {unit}", f"{after - before:+.3g} {unit}")
    verdict = "more" if sure else "inconclusive"
    where = (cell.scene, cell.method, cell.engine, cell.setting) if cell else ("", "", "", "")
    return Line(*words, verdict, sure, *where, rows=1)
