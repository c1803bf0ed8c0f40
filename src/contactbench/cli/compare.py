"""``contactbench compare``: a work–precision race on one scene."""

from __future__ import annotations

import argparse
import json
import os
import sys
from typing import Any

from contactbench.cli.parsing import PICTURES, Command, add_files, add_parameters, assignments, writable
from contactbench.errors import BadInput


def numbers(text: str) -> list[float]:
    """1e-3,1e-6 as numbers."""
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise BadInput(f"--error {text}: must be errors separated by commas, as in 1e-3,1e-6") from None


def duration(text: str) -> float:
    """60s, 60 or 2m in seconds."""
    units = {"s": 1.0, "m": 60.0}
    number, unit = (text[:-1], units[text[-1]]) if text[-1:] in units else (text, 1.0)
    try:
        return float(number) * unit
    except ValueError:
        raise BadInput(f"--budget {text}: must be a time, as in 60s or 2m") from None


def compare(arguments: argparse.Namespace) -> int:
    """Race the methods and print who is cheapest at each error."""
    for option, kinds in (("html", ()), ("plot", PICTURES), ("csv", ())):
        writable(f"--{option}", getattr(arguments, option), kinds)
    one_core()
    import contactbench as cb
    from contactbench.report import race

    scene = cb.SCENES[arguments.scene].with_(**assignments(arguments.set))
    methods, budget = arguments.method or None, duration(arguments.budget)
    frame = cb.compare(scene, methods, numbers(arguments.error), budget, progress=not arguments.quiet)
    if arguments.csv:
        frame.to_csv(arguments.csv, index=False, lineterminator="\n")
    if arguments.html:
        arguments.html.write_text(race.html(frame), encoding="utf-8")
    if arguments.plot and (figure := race.figure(frame)) is not None:
        from contactbench.report.draw import render

        render(figure).savefig(arguments.plot)
    print(as_json(frame) if arguments.json else race.text(frame))
    return 130 if frame.attrs["interrupted"] else int(not frame["time_s"].notna().any())


def as_json(frame: Any) -> str:
    """The rows, and what holds for all of them; null for what is not known."""
    rows = json.loads(frame.to_json(orient="records", double_precision=15))
    known = {name: value for name, value in frame.attrs.items() if name != "runs"}
    return json.dumps({**known, "rows": rows}, allow_nan=False)


def one_core() -> None:
    """Before JAX makes its threads: to hand parts of a small program to another costs more than running them."""
    if hasattr(os, "sched_setaffinity") and "jax" not in sys.modules:
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


EXAMPLES = """examples:
  contactbench compare particle
  contactbench compare double-well --plugin my.py --error 1e-4,1e-8 --html out.html
  contactbench compare particle contact-rkn8 cvode-adams heyoka-taylor --budget 20s --json | jq '.rows[].margin'

Nothing is written but the files named.  Ctrl-C ends it with what there is.
Exit status: 0 done, 1 nothing could be timed, 2 bad input or no reference, 130 interrupted."""


def add(command: Command) -> None:
    """Add the command and its options."""
    about = "race the methods on one scene: what each costs at each error, what it keeps"
    race = command("compare", compare, about, EXAMPLES)
    race.add_argument("scene", help="its name (contactbench list scenes)")
    race.add_argument(
        "method", nargs="*", default=[], help="names (contactbench list methods); by default all"
    )
    add_parameters(race)
    errors = "errors asked for, relative to the motion"
    race.add_argument("--error", default="1e-3,1e-6,1e-9", metavar="E,E,…", help=errors)
    race.add_argument("--budget", default="60s", metavar="TIME", help="for everything (default: 60s)")
    figure = "the figure alone (.svg, .png, .pdf)"
    add_files(race, html="one page: tables and figure", plot=figure, csv="the rows")
    race.add_argument("--json", action="store_true", help="print one JSON object")
    race.add_argument("--quiet", action="store_true", help="no progress on stderr")
