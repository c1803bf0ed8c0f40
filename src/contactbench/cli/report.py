"""``contactbench report``: documents, figures and page from the tables."""

from __future__ import annotations

import argparse
from pathlib import Path

from contactbench.cli.parsing import Command, writable, writable_folder
from contactbench.errors import BadInput


def report(arguments: argparse.Namespace) -> int:
    """Write markdown, figures and the page from the CSV tables, or say which are not what the tables say."""
    import contactbench as cb
    from contactbench.report import write

    registries = {"methods": cb.METHODS, "scenes": cb.SCENES}
    if not list(arguments.results.glob("*.csv")):
        raise BadInput(
            f"--results {arguments.results}: no tables there; run the benchmark first (tox -e bench)"
        )
    if arguments.check:
        found = write.differing(arguments.results, arguments.readme, registries)
        print("\n".join(found) or "Documents, figures and tables agree.")
        return 1 if found else 0
    writable_folder("--results", arguments.results)
    if arguments.readme:  # refused now if it has no computed part
        write.parts_beside(arguments.readme)
        writable("--readme", arguments.readme)
    for path in write.report(arguments.results, registries, arguments.readme, arguments.png):
        print(path)
    return 0


EXAMPLES = """examples:
  contactbench report
  contactbench report --results /tmp/mine
  contactbench report --check --readme README.md

Nothing is solved: every number is read from the tables.  report.html is one page that needs no network."""


def add(command: Command) -> None:
    """Add the command and its options."""
    write = command("report", report, "markdown, figures and report.html from the CSV tables alone", EXAMPLES)
    write.add_argument("--results", type=Path, default=Path("results"), help="folder of the tables")
    write.add_argument("--png", action="store_true", help="save the figures as .png too")
    write.add_argument("--readme", type=Path, help="also fill in the part of this file that is computed")
    check = "write nothing; name each file that is not what the tables give, exit status 1 if there is one"
    write.add_argument("--check", action="store_true", help=check)
