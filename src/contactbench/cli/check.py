"""``contactbench check``: a method or a scene against the contract."""

from __future__ import annotations

import argparse
import sys

from contactbench.cli.parsing import Command
from contactbench.errors import BadInput, unknown_name

ROW = "{:>4}  {:30} {:9} {:24} {}"


def check(arguments: argparse.Namespace) -> int:
    """Follow every rule of the contract; print which, where, and what was measured."""
    import contactbench as cb
    from contactbench.testing import Violation, method_findings, scene_findings

    name, engines = arguments.name, arguments.engine or None
    if name in cb.METHODS:
        findings = method_findings(cb.METHODS[name], engines)
    elif name in cb.SCENES:
        if engines:
            raise BadInput(f"--engine {engines[0]}: {name} is a scene, which has none")
        findings = scene_findings(cb.SCENES[name])
    else:
        raise unknown_name("method or scene", name, [*cb.METHODS, *cb.SCENES])
    print(ROW.format("rule", "which", "engine", "scene", "measured"))
    try:
        for found in findings:
            numbers = ", ".join(f"{what} {value:.4g}" for what, value in found.measured.items())
            result = f"does not apply: {found.not_here}" if found.not_here else numbers or "kept"
            print(ROW.format(*found[:4], result), flush=True)
    except Violation as broken:
        print(f"contactbench: {broken}", file=sys.stderr)
        return 1
    return 0


EXAMPLES = """examples:
  contactbench check my-method --plugin my.py
  contactbench check my-method --engine python --plugin my.py
  contactbench check double-well --plugin my.py

Exit status: 0 all rules are kept, 1 one is broken (stderr says which), 2 bad input."""


def add(command: Command) -> None:
    """Add the command and its options."""
    one = command("check", check, "check a method or a scene against every rule of its contract", EXAMPLES)
    one.add_argument("name", help="of a method or a scene")
    one.add_argument("--engine", action="append", help="of a method: only this one; may be repeated")
