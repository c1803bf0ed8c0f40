"""The command line: ``contactbench list | solve | claim | report | gate | references``."""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from contactbench.errors import BadInput, positive


def listing(arguments: argparse.Namespace) -> int:
    """Print scenes, methods, laws and claims, or one kind without heading and indentation."""
    import contactbench as cb

    def method(item: Any) -> str:
        kind = "adaptive" if item.adaptive else "fixed step"
        order = f"order {item.order}" if item.order else "variable order"
        return f"{order}, {kind}, {'/'.join(item.engines)}: {item.about}"

    def claims() -> dict[str, str]:
        from contactbench.claims import CLAIMS

        return {name: f"{item.where}: {item.says}" for name, item in CLAIMS.items()}

    kinds: dict[str, Callable[[], dict[str, str]]] = {
        "scenes": lambda: {name: scene.about for name, scene in cb.SCENES.items()},
        "methods": lambda: {name: method(item) for name, item in cb.METHODS.items()},
        "laws": lambda: {name: law.definition for name, law in cb.LAWS.items()},
        "claims": claims,
    }
    for kind in [arguments.kind] if arguments.kind else kinds:
        if not arguments.kind:
            print(kind)
        indent = "" if arguments.kind else "  "
        for name, about in kinds[kind]().items():
            print(f"{indent}{name:24} {about}")
    return 0


def assignments(pairs: list[str]) -> dict[str, Any]:
    """``name=value`` arguments; a value is JSON (a number or a list of numbers)."""
    changes = {}
    for pair in pairs:
        name, _, text = pair.partition("=")
        try:
            changes[name] = json.loads(text)
        except json.JSONDecodeError:
            raise BadInput(
                f"--set {pair}: must be name=value, the value a number or [list, of, numbers]"
            ) from None
        if isinstance(changes[name], list):
            changes[name] = tuple(changes[name])
    return changes


def solve(arguments: argparse.Namespace) -> int:
    """Solve a scene once and print where it ended."""
    import contactbench as cb

    scene = cb.SCENES[arguments.scene].with_(**assignments(arguments.set))
    if arguments.t_end is not None:
        scene = scene.with_(t_end=arguments.t_end)
    options = {k: getattr(arguments, k) for k in ("step", "rtol", "engine", "max_steps")}
    solution = cb.solve(
        scene, arguments.method, save_at=[scene.t_end], **{k: v for k, v in options.items() if v is not None}
    )
    print(json.dumps(summary(solution), allow_nan=False) if arguments.json else described(summary(solution)))
    return 0 if solution.ok else 1


def summary(solution: Any) -> dict[str, Any]:
    """Final state, energies, momentum, counts and status as plain JSON values; null for not reached."""
    scene, out = solution.scene, {}
    if solution.ok:
        state = scene.unpack(tuple(solution.y[-1].tolist()), solution.carry)
        momentum = scene.momentum(state)
        out = {
            "state": dict(zip(solution.labels, solution.y[-1].tolist(), strict=True)),
            "H0": scene.energy(state),
            "H": scene.hamiltonian(state) if scene.is_contact else None,
            "J": None if momentum is None else list(momentum),
        }
    return {
        "scene": scene.name,
        "method": solution.method,
        "engine": solution.engine,
        "setting": solution.setting,
        "status": str(solution.status),
        "message": solution.message,
        "t": solution.end_time,
        **out,
        "counts": solution.counts._asdict(),
    }


def described(summary: dict[str, Any]) -> str:
    """One line per entry."""
    return "\n".join(f"{key:8} {value}" for key, value in summary.items() if value not in (None, ""))


def claim(arguments: argparse.Namespace) -> int:
    """Measure one claim of the paper and print its row."""
    from contactbench.claims import CLAIMS

    row = CLAIMS[arguments.id].row()
    print(json.dumps(row, allow_nan=False, ensure_ascii=False) if arguments.json else readable(row))
    return 0 if row["status"] == "ok" else 1


def readable(row: dict[str, Any]) -> str:
    """A claim's row: the claim, each measurement on a line, the verdict, the correction."""
    from contactbench.results.schema import SEPARATOR

    lines = [f"{row['id']}  {row['where']}", f"claim       {row['claim']}"]
    lines += [f"scene       {row['scene']}", f"method      {row['method']}"]
    if row["status"] != "ok":
        return "\n".join([*lines, f"status      {row['status']}: {row['message']}"])
    lines += [f"measured    {item}" for item in row["evidence"].split(SEPARATOR)]
    lines.append(f"verdict     {row['verdict']}")
    if row["correction"]:
        lines.append(f"correction  {row['correction']}")
    lines += [f"measured    {item}" for item in row.get("corrected_evidence", "").split(SEPARATOR) if item]
    return "\n".join(lines)


def report(arguments: argparse.Namespace) -> int:
    """Write markdown, figures and the page from the CSV tables, or say which are not what the tables say."""
    import contactbench as cb
    from contactbench.report import check, write

    registries = {"methods": cb.METHODS, "scenes": cb.SCENES}
    if not list(arguments.results.glob("*.csv")):
        raise BadInput(
            f"--results {arguments.results}: no tables there; run the benchmark first (tox -e bench)"
        )
    if arguments.check:
        found = check.differing(arguments.results, arguments.readme, registries)
        print("\n".join(found) or "Documents, figures and tables agree.")
        return 1 if found else 0
    for path in write.report(arguments.results, registries):
        print(path)
    if arguments.readme:
        write.into_readme(arguments.readme, arguments.results)
        print(arguments.readme)
    return 0


def gate(arguments: argparse.Namespace) -> int:
    """Compare with the committed tables and time against another revision; 1 if something regressed."""
    from contactbench.gate.judge import PARTS, Question
    from contactbench.gate.judge import gate as judge

    signal.signal(
        signal.SIGTERM, lambda *_: sys.exit(143)
    )  # a cancelled job removes its worktree on the way out
    verdict = judge(
        Question(
            Path.cwd(), arguments.results, arguments.fresh, arguments.base,
            (arguments.only,) if arguments.only else PARTS, arguments.tables_changed, arguments.budget,
        )
    )  # fmt: skip
    print(verdict.as_json() if arguments.json else verdict.as_markdown())
    return 1 if verdict.red else 0


def references(_: argparse.Namespace) -> int:
    """Print the stored references, their digits and their digests."""
    from contactbench.truth import frozen_folder, manifest

    folder = frozen_folder()
    if folder is None:
        raise BadInput("no stored references in this installation; they are computed live")
    for name, entry in manifest(folder).items():
        second = entry["second_engine"]["agreeing_digits"]
        digits = f"{entry['digits']} digits stored, {second} confirmed by a second engine"
        print(f"{name:24} {digits}, sha256 {entry['sha256'][:16]}…")
    return 0


def seconds(text: str) -> float:
    """A positive number of seconds, for argparse."""
    try:
        return positive("seconds", text)
    except BadInput as error:
        raise argparse.ArgumentTypeError(str(error)) from None


class Parser(argparse.ArgumentParser):
    """Keeps the layout of its examples; bad usage is one line and exit status 2."""

    def __init__(self, **options: Any) -> None:
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, **options)

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {' '.join(message.split())} (see {self.prog} --help)\n")


#: taken from anywhere on the line and loaded first, so that every command knows what it brings
PLUGIN = Parser(prog="contactbench", add_help=False, allow_abbrev=False)
PLUGIN.add_argument(
    "--plugin", action="append", default=[], metavar="FILE", type=Path,
    help="Python file that registers methods or scenes of your own; may be repeated",
)  # fmt: skip


def parser() -> argparse.ArgumentParser:
    top = Parser(
        prog="contactbench",
        description="Contact splitting integrators beside the established ODE solvers, measured.",
        parents=[PLUGIN],
        epilog="""examples:
  contactbench list methods
  contactbench solve particle contact-strang --step 0.01
  contactbench solve particle my-method --step 0.01 --plugin my.py
  contactbench claim C25
  contactbench report --results results

The tables come from the benchmark, `tox -e bench`.
Exit status: 0 done; 1 done, but the run did not end ok; 2 bad input.""",
    )
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=Parser)

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

    show = command(
        "list", listing, "scenes, methods, laws and claims",
        """examples:
  contactbench list
  contactbench list methods | grep adaptive
  contactbench list scenes --plugin my.py""",
    )  # fmt: skip
    show.add_argument("kind", nargs="?", choices=["scenes", "methods", "laws", "claims"], help="only these")

    one = command(
        "solve", solve, "solve one scene with one method and print where it ended",
        """examples:
  contactbench solve particle contact-strang --step 0.01
  contactbench solve particle contact-rkn6 --rtol 1e-8           the step chosen from pilots
  contactbench solve particle cvode-bdf --rtol 1e-8 --t-end 100
  contactbench solve particle rk4 --step 0.01 --set gamma=0.3 --set q=[1,0.5] --json | jq .H0

Exit status: 0 the run ended ok; 1 it did not (the status says how); 2 bad input.""",
    )  # fmt: skip
    one.add_argument("scene", help="its name (contactbench list scenes)")
    one.add_argument("method", help="its name (contactbench list methods)")
    one.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE",
        help="change a parameter: a number or a list [1,2]; may be repeated",
    )  # fmt: skip
    one.add_argument("--step", type=float, help="step size (fixed-step methods)")
    one.add_argument("--rtol", type=float, help="tolerance (adaptive methods; others choose a step from it)")
    one.add_argument("--t-end", type=float, help="end time")
    one.add_argument("--engine", help="numba, jax or python, where a method has several")
    one.add_argument("--max-steps", type=int, help="step budget")
    one.add_argument("--json", action="store_true", help="print one JSON object")

    ledger = command(
        "claim", claim, "measure one claim of the paper",
        "examples:\n  contactbench claim C25\n  contactbench claim C07 --json | jq -r .verdict",
    )  # fmt: skip
    ledger.add_argument("id", help="C01 to C36 (contactbench list claims)")
    ledger.add_argument("--json", action="store_true", help="print one JSON object")

    write = command(
        "report", report, "markdown, figures and report.html from the CSV tables alone",
        """examples:
  contactbench report
  contactbench report --results /tmp/mine
  contactbench report --check --readme README.md

Nothing is solved: every number is read from the tables.  report.html is one page that needs no network.""",
    )  # fmt: skip
    write.add_argument("--results", type=Path, default=Path("results"), help="folder of the tables")
    write.add_argument("--readme", type=Path, help="also fill in the part of this file that is computed")
    write.add_argument(
        "--check", action="store_true",
        help="write nothing; name each file that is not what the tables give, exit status 1 if there is one",
    )  # fmt: skip

    check = command(
        "gate", gate, "has anything become less accurate, more costly or slower?",
        """examples:
  contactbench gate
  contactbench gate --only accuracy --fresh /tmp/results-of-a-run
  contactbench gate --only speed --base origin/main

Accuracy: a fresh smoke run of the benchmark (about three minutes), and the tables of the working tree, against
the tables of another revision.  Speed: the working tree against another revision, in turns on one core (a few
minutes).  Prints one table of what moved.  A change that means to change tables names them, in a line
"Tables-changed: laws, claims" of a commit's message or with --tables-changed.
Exit status: 0 green, or inconclusive as it says; 1 red; 2 could not run.""",
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
        "--base", metavar="REV",
        help="revision to compare with (default: of accuracy where the main branch was left, on it HEAD; of speed "
        "HEAD if sources have local changes, else its parent)",
    )  # fmt: skip
    check.add_argument(
        "--tables-changed", action="append", default=[], metavar="TABLE",
        help="a table that is meant to change, or all; may be repeated",
    )  # fmt: skip
    check.add_argument(
        "--budget", type=seconds, metavar="SECONDS",
        help="time for the speed part; what is not decided by then is said to be inconclusive",
    )  # fmt: skip
    check.add_argument("--json", action="store_true", help="print one JSON object")

    command("references", references, "the stored references, their digits and digests")
    return top


def main(argv: list[str] | None = None) -> int:
    """Entry point; bad input is one line on stderr and exit status 2."""
    try:
        plugins, _ = PLUGIN.parse_known_args(argv)
        arguments = parser().parse_args(argv)
        if plugins.plugin:
            from contactbench.plugins import load_file

            for path in plugins.plugin:
                load_file(path)
        arguments.plugin = plugins.plugin  # a subcommand's parser sees only what follows its name
        status = arguments.run(arguments)
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


if __name__ == "__main__":
    sys.exit(main())
