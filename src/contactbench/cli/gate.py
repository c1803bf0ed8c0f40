"""``contactbench gate``: has anything become worse?"""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path

from contactbench.cli.parsing import Command


def gate(arguments: argparse.Namespace) -> int:
    """Compare with the committed tables and time against another revision; 1 if something regressed."""
    from contactbench.gate.accuracy import PARTS
    from contactbench.gate.accuracy import gate as judge

    signal.signal(
        signal.SIGTERM, lambda *_: sys.exit(143)
    )  # a cancelled job removes its worktree on the way out
    parts = (arguments.only,) if arguments.only else PARTS
    verdict = judge(Path.cwd(), arguments.baseline, arguments.fresh, arguments.base, parts)
    print(verdict.as_json() if arguments.json else verdict.as_markdown())
    return 1 if verdict.red else 0


def add(command: Command) -> None:
    """The command and its options."""
    check = command(
        "gate", gate, "has anything become less accurate, more costly or slower?",
        """examples:
  contactbench gate
  contactbench gate --only accuracy --fresh /tmp/results-of-a-run
  contactbench gate --only speed --base origin/main

Accuracy: a fresh smoke run of the benchmark (about three minutes) against the committed tables.
Speed: the working tree against another revision, in turns on one core (about a minute).
Prints one table of what moved.  Exit status: 0 green, 1 red, 2 could not run.""",
    )  # fmt: skip
    check.add_argument("--only", choices=("accuracy", "speed"), help="one part; both by default")
    check.add_argument(
        "--baseline", type=Path, default=Path("results"), metavar="DIR", help="committed tables"
    )
    check.add_argument(
        "--fresh", type=Path, metavar="DIR", help="tables of a run just made (default: make them now)"
    )
    check.add_argument(
        "--base", metavar="REV",
        help="revision to be no slower than (default: HEAD if sources have local changes, else its parent)",
    )  # fmt: skip
    check.add_argument("--json", action="store_true", help="print one JSON object")
