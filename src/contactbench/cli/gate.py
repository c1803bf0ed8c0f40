"""``contactbench gate``: has anything become worse?"""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path

from contactbench.cli.parsing import Command
from contactbench.errors import BadInput, positive


def seconds(text: str) -> float:
    """Return a positive number of seconds, for argparse."""
    try:
        return positive("seconds", float(text))
    except (BadInput, ValueError) as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def gate(arguments: argparse.Namespace) -> int:
    """Compare with the committed tables and time against another revision; 1 if something regressed."""
    from contactbench.gate import judge
    from contactbench.gate.compare import compare_folders

    # a cancelled job removes its folders on the way out
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    if arguments.baseline is not None:
        if arguments.fresh is None or arguments.only == "speed":
            raise BadInput("--baseline: compares two folders of tables, give --fresh DIR too")
        found = compare_folders(arguments.baseline, arguments.fresh)
    else:
        parts = (arguments.only,) if arguments.only else judge.PARTS
        folders = Path.cwd(), arguments.results, arguments.fresh
        question = judge.Question(*folders, arguments.base, parts, arguments.tables_changed, arguments.budget)
        status = judge.by_base(question, arguments.json)
        if status is not None:
            return status
        found = judge.gate(question)
    print(found.as_json() if arguments.json else found.as_markdown())
    return found.status


EXAMPLES = """examples:
  contactbench gate
  contactbench gate --only accuracy --fresh /tmp/results-of-a-run
  contactbench gate --only speed --base origin/main

Accuracy: a fresh smoke run of the benchmark (about two minutes), and the tables of the working tree, against
the tables of another revision.  Speed: the working tree against another revision, in turns on one core (a few
minutes).  The gate of that revision judges, by its own rules.  Prints one table of what moved.  A change that
means to change tables names them, in a line "Tables-changed: laws, claims" of a commit's message or with
--tables-changed.
Exit status: 0 green, cells that stay open named; 1 red; 2 inconclusive as a whole, or could not run."""
#: options that take a folder, and what of
FOLDERS = {
    "--results": "the committed tables, a folder of the repository (default: results)",
    "--fresh": "tables of a run just made (default: make them now)",
    "--baseline": "compare --fresh with this folder of tables instead, outside any repository",
}
BASE = "revision to compare with (default: where the main branch was left, on it HEAD's parent)"
BUDGET = (
    "time for the speed part; what is not decided by then is inconclusive, all of it below half of the cells"
)
CHANGED = "a table that is meant to change, or all; may be repeated"


def add(command: Command) -> None:
    """Add the command and its options."""
    check = command("gate", gate, "has anything become less accurate or slower?", EXAMPLES)
    check.add_argument("--only", choices=("accuracy", "speed"), help="one part; both by default")
    for option, about in FOLDERS.items():
        default = Path("results") if option == "--results" else None
        check.add_argument(option, type=Path, default=default, metavar="DIR", help=about)
    check.add_argument("--base", metavar="REV", help=BASE)
    check.add_argument("--tables-changed", action="append", default=[], metavar="TABLE", help=CHANGED)
    check.add_argument("--budget", type=seconds, metavar="SECONDS", help=BUDGET)
    check.add_argument("--json", action="store_true", help="print one JSON object")
