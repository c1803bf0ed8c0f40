"""``contactbench gate``: has anything become worse?"""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path

from contactbench.cli.parsing import Command
from contactbench.errors import BadInput, positive


def seconds(text: str) -> float:
    """A positive number of seconds, for argparse."""
    try:
        return positive("seconds", float(text))
    except (BadInput, ValueError) as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def gate(arguments: argparse.Namespace) -> int:
    """Compare with the committed tables and time against another revision; 1 if something regressed."""
    from contactbench.gate import judge
    from contactbench.gate.compare import compare_folders

    signal.signal(
        signal.SIGTERM, lambda *_: sys.exit(143)
    )  # a cancelled job removes its folders on the way out
    if arguments.baseline is not None:
        if arguments.fresh is None or arguments.only == "speed":
            raise BadInput("--baseline: compares two folders of tables, give --fresh DIR too")
        found = compare_folders(arguments.baseline, arguments.fresh)
    else:
        question = judge.Question(
            Path.cwd(), arguments.results, arguments.fresh, arguments.base,
            (arguments.only,) if arguments.only else judge.PARTS, arguments.tables_changed, arguments.budget,
        )  # fmt: skip
        status = judge.by_base(question, arguments.json)
        if status is not None:
            return status
        found = judge.gate(question)
    print(found.as_json() if arguments.json else found.as_markdown())
    return found.status


def add(command: Command) -> None:
    """The command and its options."""
    check = command(
        "gate", gate, "has anything become less accurate, more costly or slower?",
        """examples:
  contactbench gate
  contactbench gate --only accuracy --fresh /tmp/results-of-a-run
  contactbench gate --only speed --base origin/main

Accuracy: a fresh smoke run of the benchmark (about two minutes), and the tables of the working tree, against
the tables of another revision.  Speed: the working tree against another revision, in turns on one core (a few
minutes).  The gate of that revision judges, by its own rules.  Prints one table of what moved.  A change that
means to change tables names them, in a line "Tables-changed: laws, claims" of a commit's message or with
--tables-changed.
Exit status: 0 green, cells that stay open named; 1 red; 2 inconclusive as a whole, or could not run.""",
    )  # fmt: skip
    check.add_argument("--only", choices=("accuracy", "speed"), help="one part; both by default")
    check.add_argument(
        "--results", type=Path, default=Path("results"), metavar="DIR",
        help="the committed tables, a folder of the repository (default: results)",
    )  # fmt: skip
    check.add_argument(
        "--fresh", type=Path, metavar="DIR", help="tables of a run just made (default: make them now)"
    )
    check.add_argument(
        "--baseline", type=Path, metavar="DIR",
        help="compare --fresh with this folder of tables instead, outside any repository: it vouches for no revision",
    )  # fmt: skip
    check.add_argument(
        "--base", metavar="REV",
        help="revision to compare with (default: where the main branch was left, on it HEAD's parent)",
    )  # fmt: skip
    check.add_argument(
        "--tables-changed", action="append", default=[], metavar="TABLE",
        help="a table that is meant to change, or all; may be repeated",
    )  # fmt: skip
    check.add_argument(
        "--budget", type=seconds, metavar="SECONDS",
        help="time for the speed part; what is not decided by then is inconclusive, all of it below half of the cells",
    )  # fmt: skip
    check.add_argument("--json", action="store_true", help="print one JSON object")
