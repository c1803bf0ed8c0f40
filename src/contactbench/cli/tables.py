"""The commands ``contactbench claim | report | bench | gate``."""

from __future__ import annotations

import argparse
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from contactbench.cli.parsing import print_json, writable
from contactbench.cli.printing import print_item
from contactbench.errors import BadInput


def claim(arguments: argparse.Namespace) -> int:
    from contactbench.paper import CLAIMS
    from contactbench.tables.schema import SEPARATOR

    own = CLAIMS[arguments.id.upper()]
    row: dict[str, Any] = own.words | own.row()
    if arguments.json:
        print_json(row, arguments)
    else:
        for name, label in LABELS.items():
            for item in filter(None, row.get(name, "").split(SEPARATOR)):
                print_item(f"{label:11} ", item, 12)
    return 0 if row["status"] == "ok" else 1


#: columns of the ledger in the order of printing, with their labels
LABELS = {name: name for name in ("id", "where", "claim", "scene", "method", "message")}
LABELS |= {"evidence": "measured", "verdict": "verdict", "correction": "correction"}
LABELS |= {"corrected_evidence": "measured"}


def report(arguments: argparse.Namespace) -> int:
    import contactbench as cb
    from contactbench.questions import write

    results, readme = arguments.results, arguments.readme
    registries = {"methods": cb.METHODS, "scenes": cb.SCENES}
    if not list(results.glob("*.csv")):
        raise BadInput(f"--results {results}: no tables there; run the benchmark first (tox -e bench)")
    if arguments.check:
        beside = results.resolve().parent / "README.md"
        if readme is None and write.computed_part(beside) is not None:
            readme = beside
        found = write.differing(results, readme, registries)
        print("\n".join(found) or "Documents, figures and tables agree.")
        return 1 if found else 0
    if readme:
        writable("--readme", readme)
    for path in write.report(results, registries, readme):
        print(path)
    return 0


def bench(arguments: argparse.Namespace) -> int:
    import contactbench as cb
    from contactbench.plugins import brought
    from contactbench.questions import write
    from contactbench.runs import runner
    from contactbench.runs.experiment import PROFILES
    from contactbench.study.ending import ending

    own = bool(brought()) and not arguments.all
    selection = " ".join([runner.OWN_ALONE] * own + [arguments.k] * bool(arguments.k))
    profile, results = PROFILES[arguments.profile], arguments.results.resolve()
    run = runner.Run(results, profile, selection, not arguments.untimed, own)
    failed = runner.work(run, arguments.k or "", arguments.resume)
    if not arguments.untimed:
        write.report(results, {"methods": cb.METHODS, "scenes": cb.SCENES})
        if not arguments.quiet:
            print(ending(results))
    return 1 if failed else 0


def gate(arguments: argparse.Namespace) -> int:
    with ending_by_sigterm():
        return judge(arguments)


@contextmanager
def ending_by_sigterm() -> Iterator[None]:
    """Turn SIGTERM into an exception inside the block, so that a cancelled job removes its temporary folders."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def judge(arguments: argparse.Namespace) -> int:
    from contactbench.gate import trees
    from contactbench.gate.compare import compare_folders

    if arguments.baseline is not None:
        if arguments.fresh is None or arguments.only == "speed":
            raise BadInput("--baseline: compares two folders of tables, give --fresh DIR too")
        found = compare_folders(arguments.baseline, arguments.fresh)
    else:
        status = trees.by_base(Path.cwd(), arguments.base, arguments.line, arguments.stdout)
        if status is not None:
            return status
        parts = (arguments.only,) if arguments.only else trees.PARTS
        folders = Path.cwd(), arguments.results, arguments.fresh
        found = trees.gate(*folders, arguments.base, parts, arguments.tables_changed)
    print(found.as_json() if arguments.json else found.as_markdown(), file=arguments.stdout)
    return found.status
