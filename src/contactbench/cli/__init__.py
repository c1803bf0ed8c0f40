"""The command line: ``contactbench list | solve | compare | check | claim | report | bench | gate | …``."""

from __future__ import annotations

import argparse
import atexit
import os
import platform
import sys
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from importlib import metadata
from typing import NoReturn

from contactbench.cli import listing, runs, tables
from contactbench.cli.parsing import HELP, PLUGIN, Parser, add_options
from contactbench.errors import BadInput, UnknownName, one_line

COMMANDS: dict[str, Callable[[argparse.Namespace], int]] = {
    "list": listing.listing,
    "solve": runs.solve,
    "compare": runs.compare,
    "check": runs.check,
    "claim": tables.claim,
    "report": tables.report,
    "bench": tables.bench,
    "gate": tables.gate,
}


def parser() -> argparse.ArgumentParser:
    about, epilog = HELP["contactbench"]["about"], HELP["contactbench"]["epilog"]
    top = Parser(prog="contactbench", description=about, parents=[PLUGIN], epilog=epilog)
    add_options(top, "contactbench")

    def overview(arguments: argparse.Namespace) -> int:
        print(versions() if arguments.version else top.format_help().rstrip())
        return 0

    top.set_defaults(run=overview)
    commands = top.add_subparsers(dest="command", metavar="COMMAND")
    for name, run in COMMANDS.items():
        about, epilog = HELP[name]["about"], HELP[name].get("epilog", "")
        one = commands.add_parser(name, help=about, description=about, parents=[PLUGIN], epilog=epilog)
        add_options(one, name)
        one.set_defaults(run=run)
    return top


#: commands that accept a user's file, and the hint for it
OWN, OF_A_FILE = ("solve", "compare", "check"), "; those of your own file with --plugin FILE"

#: packages whose versions `--version` prints
PEERS = ["scipy", "scikit-sundae", "diffrax", "jax", "heyoka", "cyrk", "numba", "numpy"]


def versions() -> str:
    import contactbench

    installed = {name: next(iter(metadata.distributions(name=name)), None) for name in PEERS}
    found = [f"{name} {one.version if one else 'not installed'}" for name, one in installed.items()]
    return f"contactbench {contactbench.__version__}\nPython {platform.python_version()}, {', '.join(found)}"


def open_streams() -> None:
    """Make stdout and stderr accept any text: closed streams write to the null device, unknown characters as "?"."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: SIM115
        elif getattr(stream, "errors", None) in ("strict", "surrogateescape"):
            stream.reconfigure(errors="replace")


def main(argv: list[str] | None = None) -> int:
    """Run the command line; an error is one line on stderr and exit status 2."""
    status = command(argv)
    if argv is None and any(
        not each.daemon for each in threading.enumerate() if each is not threading.main_thread()
    ):
        leave(status)  # the interpreter would wait for a plug-in's thread
    return status


def leave(status: int) -> NoReturn:
    """End the process as the interpreter does, without waiting for threads."""
    with suppress(OSError):
        sys.stdout.flush()
        sys.stderr.flush()
    atexit._run_exitfuncs()
    os._exit(status)


def command(argv: list[str] | None) -> int:
    open_streams()
    plugins, _ = PLUGIN.parse_known_args(argv)
    top = parser()
    arguments, more = top.parse_known_args(argv)
    if more and (arguments.command != "compare" or any(word.startswith("-") for word in more)):
        top.error(f"unrecognized arguments: {' '.join(more)}")
    arguments.more = more  # methods that follow an option
    arguments.stdout = stdout = sys.stdout
    try:
        if getattr(arguments, "json", False):  # stdout carries only the JSON, not a plug-in's output
            sys.stdout = sys.stderr
        if plugins.plugin:
            from contactbench.plugins import load_file

            for path in plugins.plugin:
                load_file(path)
        arguments.line = sys.argv[1:] if argv is None else argv
        status: int = arguments.run(arguments)
        stdout.flush()
    except BrokenPipeError:  # the reader has left, as in `contactbench list | head -1`
        os.dup2(os.open(os.devnull, os.O_WRONLY), stdout.fileno())
        return 141
    except (BadInput, OSError) as error:
        yours = isinstance(error, UnknownName) and not plugins.plugin and arguments.command in OWN
        return fail(error, str(error), plugins.traceback, OF_A_FILE * yours)
    except KeyboardInterrupt:
        print("contactbench: interrupted", file=sys.stderr)
        return 130
    except BaseException as error:
        if isinstance(error, SystemExit) and error.code not in (0, None):
            raise  # raised on purpose, as when a job is cancelled
        last = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{os.path.basename(last.filename)}, line {last.lineno}"
        says = f"{type(error).__name__}: {error} ({where}; --traceback shows the rest)"
        return fail(error, says, plugins.traceback)
    finally:
        if argv is not None:
            sys.stdout = stdout
    return status


def fail(error: BaseException, message: str, whole: bool, remedy: str = "") -> int:
    if whole:
        traceback.print_exception(error)
    print(f"contactbench: {one_line(message)}{remedy}", file=sys.stderr)
    return 2
