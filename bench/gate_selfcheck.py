"""How far can the regression gate be trusted?  False alarms on identical code, and planted faults found.

    python bench/gate_selfcheck.py [--runs 1] [--results results] [--only accuracy|speed]

A fault (selfcheck_faults.py) is planted by a plug-in that replaces what is registered (planted_faults.py), and
only the cells are run in which it must show; a fault of tables is made in copies of the committed ones.  The
gate then compares as it compares a pull request with its base.  With n judgements of identical code and no alarm
the rate of alarms is below 3/n, with 95 % confidence.

What is judged is noted at once in ``.journal`` of the results: killed, the same command goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path
from statistics import median
from typing import Any

from tqdm import tqdm

import selfcheck_accuracy
import selfcheck_speed
import selfcheck_tables
from contactbench.gate import judge, revisions
from contactbench.results.journal import FOLDER
from contactbench.results.provenance import environment, new_run_id, save_run
from contactbench.results.schema import PROFILES
from contactbench.results.selfcheck import GATE_SELFCHECK
from contactbench.results.store import forget, keys, merge
from selfcheck_faults import ROOT, Judgement, Task


# -- the journal -----------------------------------------------------------------------------------
class Journal:
    """The tasks that are done and what they judged, a line each; begun anew for other code or another question."""

    def __init__(self, path: Path, question: dict[str, Any]) -> None:
        self.path, self.done = path, dict[str, list[Judgement]]()
        lines = list(parsed(path)) if path.exists() else []
        if lines and lines[0] == question:
            self.done = {line["task"]: [Judgement(**one) for one in line["judged"]] for line in lines[1:]}
        path.parent.mkdir(parents=True, exist_ok=True)
        kept = [question, *({"task": task, "judged": list(map(asdict, j))} for task, j in self.done.items())]
        path.write_text("".join(json.dumps(line) + "\n" for line in kept), encoding="utf-8")

    def add(self, task: str, judged: Sequence[Judgement]) -> None:
        """Note a task as done, on disk when this returns."""
        self.done[task] = list(judged)
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"task": task, "judged": list(map(asdict, judged))}) + "\n")
            file.flush()
            os.fsync(file.fileno())


def parsed(path: Path) -> Iterator[Any]:
    """The lines of a journal; one cut short by a kill does not count."""
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            yield json.loads(line)
        except json.JSONDecodeError:
            return


# -- the table -------------------------------------------------------------------------------------
def rows(judged: Sequence[Judgement]) -> list[dict[str, Any]]:
    """The rows of the table: how many judgements of a kind were red, and what the first of these said."""
    kinds: dict[tuple[str, str, str], list[Judgement]] = {}
    for one in judged:
        kinds.setdefault((one.part, one.planted, one.condition), []).append(one)
    return [
        {
            "part": part, "planted": planted, "condition": condition, "wanted": found[0].wanted,
            "runs": len(found), "red": sum(one.red for one in found),
            "seconds": median(one.seconds for one in found),
            "example": next((one.words for one in found if one.red), ""),
        }
        for (part, planted, condition), found in kinds.items()
    ]  # fmt: skip


def write(judged: Sequence[Judgement], results: Path, whole: bool) -> list[dict[str, Any]]:
    """Put the rows into the table; a whole self-check removes those of others."""
    made = rows(judged)
    merge(GATE_SELFCHECK, made, results)
    if whole:
        forget(GATE_SELFCHECK, set(keys(GATE_SELFCHECK, made)), (*PROFILES, ""), results)
    return made


def wrong(row: dict[str, Any]) -> str:
    """What is wrong with a row, in words: an alarm, a fault missed, or one seen that is said not to be."""
    red, judged = row["red"], row["runs"]
    least = {"none": 0, "not seen": 0, "all": judged, "19 in 20": 0.95 * judged}.get(row["wanted"], 0)
    most = 0 if row["wanted"] in ("none", "not seen") else judged
    if least <= red <= most:
        return ""
    return (
        f"{row['part']}, {row['planted']} ({row['condition']}): {red} red of {judged}, wanted {row['wanted']}"
    )


# -- all of it -------------------------------------------------------------------------------------
def work_off(tasks: Sequence[Task], journal: Journal, results: Path) -> None:
    """Run what is left: what is not timed on all cores, then the rest, one after the other."""
    left = [task for task in tasks if task.name not in journal.done]
    with tqdm(
        total=sum(task.about for task in tasks), unit="", initial=sum(t.about for t in tasks if t not in left),
        bar_format="{percentage:3.0f} % done, {elapsed} elapsed, about {remaining} left  {desc}", mininterval=0,
    ) as bar:  # fmt: skip

        def finished(task: Task, judged: list[Judgement]) -> None:
            journal.add(task.name, judged)
            write([one for found in journal.done.values() for one in found], results, whole=False)
            red = sum(one.red for one in judged)
            tqdm.write(f"{task.name}: {red} red of {len(judged)}, wanted {judged[0].wanted}")
            bar.update(task.about)

        with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
            running = {pool.submit(task.judge): task for task in left if task.shared}
            try:
                for future in as_completed(running):
                    finished(running[future], future.result())
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
        for task in left:
            if not task.shared:
                finished(task, task.judge())


def tasks_of(parts: Sequence[str], runs: int, results: Path, scratch: Path) -> list[Task]:
    made = []
    if "accuracy" in parts:
        made += [*selfcheck_accuracy.tasks(runs, results, scratch), *selfcheck_tables.tasks(results, scratch)]
    if "speed" in parts:
        made += selfcheck_speed.tasks(runs, results, scratch)
    return made


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--runs", type=int, default=1, help="runs of what is repeated, in each condition")
    parser.add_argument("--results", type=Path, default=ROOT / "results", help="where the tables are and go")
    parser.add_argument("--only", choices=judge.PARTS, help="one part of the gate; both by default")
    arguments = parser.parse_args()
    if revisions.dirty(ROOT, "src", "bench"):
        sys.exit(
            "gate_selfcheck: the sources have local changes; faults are planted in HEAD, so commit first"
        )
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("ended"))  # worktrees are removed on the way out
    results = arguments.results.resolve()
    if not (results / "work_precision.csv").exists():
        sys.exit(f"gate_selfcheck: {results}: no tables of a benchmark there")
    parts = (arguments.only,) if arguments.only else judge.PARTS
    question = {"commit": revisions.commit_of(ROOT, "HEAD"), "parts": list(parts), "runs": arguments.runs}
    journal = Journal(results / FOLDER / "gate_selfcheck.jsonl", question)
    with tempfile.TemporaryDirectory(prefix="contactbench-selfcheck-") as folder:
        tasks = tasks_of(parts, arguments.runs, results, Path(folder))
        work_off(tasks, journal, results)
    judged = [one for task in tasks for one in journal.done[task.name]]
    whole = parts == judge.PARTS
    made = write(judged, results, whole)
    save_run(
        new_run_id(), environment("gate_selfcheck", 0), [GATE_SELFCHECK.name],
        [GATE_SELFCHECK.name] if whole else [], results,
    )  # fmt: skip
    journal.path.unlink()
    found = list(filter(None, map(wrong, made)))
    print("\n".join([f"{len(judged)} judgements, {len(found)} not as wanted", *found]))
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
