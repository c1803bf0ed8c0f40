"""The command line: ``contactbench list | solve | claim | report | gate | references``."""

from __future__ import annotations

import argparse
import json
import signal
import sys
from pathlib import Path
from typing import Any

from contactbench.errors import BadInput


def listing(_: argparse.Namespace) -> int:
    """Print scenes, methods and laws."""
    import contactbench as cb

    print("scenes")
    for scene in cb.SCENES.values():
        print(f"  {scene.name:24} {scene.about}")
    print("methods")
    for method in cb.METHODS.values():
        kind = "adaptive" if method.adaptive else "fixed step"
        order = f"order {method.order}" if method.order else "variable order"
        print(f"  {method.name:24} {order}, {kind}, {'/'.join(method.engines)}: {method.about}")
    print("laws")
    for law in cb.LAWS.values():
        print(f"  {law.name:24} {law.definition}")
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
    from contactbench.laws import is_contact

    scene, out = solution.scene, {}
    if solution.ok:
        state = scene.unpack(tuple(solution.y[-1].tolist()), solution.carry)
        momentum = scene.momentum(state)
        out = {
            "state": dict(zip(solution.labels, solution.y[-1].tolist(), strict=True)),
            "H0": scene.energy(state),
            "H": scene.hamiltonian(state) if is_contact(scene) else None,
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
    from contactbench.table import SEPARATOR

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
    """Write markdown and figures from the CSV tables."""
    from contactbench.report import report as write

    if not list(arguments.results.glob("*.csv")):
        raise BadInput(
            f"--results {arguments.results}: no tables there; run the benchmark first (tox -e bench)"
        )
    for path in write(arguments.results):
        print(path)
    return 0


def gate(arguments: argparse.Namespace) -> int:
    """Compare with the committed tables and time against another revision; 1 if something regressed."""
    from contactbench.gate import PARTS
    from contactbench.gate import gate as judge

    signal.signal(
        signal.SIGTERM, lambda *_: sys.exit(143)
    )  # a cancelled job removes its worktree on the way out
    parts = (arguments.only,) if arguments.only else PARTS
    verdict = judge(Path.cwd(), arguments.baseline, arguments.fresh, arguments.base, parts)
    print(verdict.as_json() if arguments.json else verdict.as_markdown())
    return 1 if verdict.red else 0


def references(_: argparse.Namespace) -> int:
    """Print the stored references, their digits and their digests."""
    from contactbench.references import frozen_folder, manifest

    folder = frozen_folder()
    if folder is None:
        raise BadInput("no stored references in this installation; they are computed live")
    for name, entry in manifest(folder).items():
        second = entry["second_engine"]["agreeing_digits"]
        digits = f"{entry['digits']} digits stored, {second} confirmed by a second engine"
        print(f"{name:24} {digits}, sha256 {entry['sha256'][:16]}…")
    return 0


def parser() -> argparse.ArgumentParser:
    top = argparse.ArgumentParser(prog="contactbench", description=__doc__.split("\n")[0])
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")
    commands.add_parser("list", help="scenes, methods, laws").set_defaults(run=listing)

    one = commands.add_parser(
        "solve", help="solve one scene with one method",
        epilog="example: contactbench solve particle contact-strang --step 0.01 --set gamma=0.3 --json",
    )  # fmt: skip
    one.add_argument("scene")
    one.add_argument("method")
    one.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="change a parameter")
    one.add_argument("--step", type=float, help="step size (fixed-step methods)")
    one.add_argument("--rtol", type=float, help="tolerance (adaptive methods)")
    one.add_argument("--t-end", type=float, help="end time")
    one.add_argument("--engine", help="jax or python, where a method has both")
    one.add_argument("--max-steps", type=int, help="step budget")
    one.add_argument("--json", action="store_true", help="print one JSON object")
    one.set_defaults(run=solve)

    ledger = commands.add_parser(
        "claim", help="measure one claim of the paper", epilog="example: contactbench claim C25"
    )
    ledger.add_argument("id", help="C01 to C36")
    ledger.add_argument("--json", action="store_true", help="print one JSON object")
    ledger.set_defaults(run=claim)

    write = commands.add_parser("report", help="markdown and figures from the CSV tables")
    write.add_argument("--results", type=Path, default=Path("results"), help="folder of the tables")
    write.set_defaults(run=report)

    check = commands.add_parser(
        "gate", help="has anything become less accurate, more costly or slower?",
        description="Accuracy: a fresh smoke run of the benchmark (about three minutes) against the committed "
        "tables. Speed: the working tree against another revision, in turns on one core (about a minute). "
        "Prints one table of what moved. Exit status 0: green, 1: red, 2: could not run.",
        epilog="example: contactbench gate --only speed --base origin/main",
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
    check.set_defaults(run=gate)

    commands.add_parser("references", help="the stored references").set_defaults(run=references)
    return top


def main(argv: list[str] | None = None) -> int:
    """Entry point; bad input is one line on stderr and exit status 2."""
    arguments = parser().parse_args(argv)
    try:
        return arguments.run(arguments)
    except BadInput as error:
        print(f"contactbench: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
