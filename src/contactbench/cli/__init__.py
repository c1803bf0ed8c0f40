"""The command line: ``contactbench list | solve | compare | claim | report | gate | references``."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from typing import Any

from contactbench.cli import claim, compare, gate, listing, references, report, solve
from contactbench.cli.parsing import PLUGIN, Parser
from contactbench.errors import BadInput

#: in the order of --help
COMMANDS = (listing, solve, compare, claim, report, gate, references)


def parser() -> argparse.ArgumentParser:
    top = Parser(
        prog="contactbench",
        description="Contact splitting integrators beside the established ODE solvers, measured.",
        parents=[PLUGIN],
        epilog="""examples:
  contactbench list methods
  contactbench solve particle contact-strang --step 0.01
  contactbench solve particle my-method --step 0.01 --plugin my.py
  contactbench compare particle
  contactbench claim C25
  contactbench report --results results

The tables come from the benchmark, `tox -e bench`.
Exit status: 0 done; 1 done, but the run did not end ok; 2 bad input.""",
    )
    top.add_argument("--version", action="store_true", help="print the version and exit")
    top.set_defaults(run=None)
    commands = top.add_subparsers(dest="command", metavar="COMMAND", parser_class=Parser)

    def command(name: str, run: Callable[[argparse.Namespace], int], about: str, examples: str = "") -> Any:
        made = commands.add_parser(
            name,
            help=about,
            description=about[0].upper() + about[1:] + ".",
            parents=[PLUGIN],
            epilog=examples,
        )
        made.set_defaults(run=run)
        return made

    for each in COMMANDS:
        each.add(command)
    return top


def overview(top: argparse.ArgumentParser, arguments: argparse.Namespace) -> int:
    """What a line without a command asks for: the version, or help."""
    import contactbench

    print(f"contactbench {contactbench.__version__}" if arguments.version else top.format_help().rstrip())
    return 0


def main(argv: list[str] | None = None) -> int:
    """Entry point; bad input is one line on stderr and exit status 2."""
    try:
        plugins, _ = PLUGIN.parse_known_args(argv)
        top = parser()
        arguments = top.parse_args(argv)
        if plugins.plugin:
            from contactbench.plugins import load_file

            for path in plugins.plugin:
                load_file(path)
        arguments.plugin = plugins.plugin  # a subcommand's parser sees only what follows its name
        status = arguments.run(arguments) if arguments.run else overview(top, arguments)
        sys.stdout.flush()
    except BadInput as error:
        print(f"contactbench: {error}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # the reader has left, as in `contactbench list | head -1`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 141
    except OSError as error:
        print(f"contactbench: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("contactbench: interrupted", file=sys.stderr)
        return 130
    return status
