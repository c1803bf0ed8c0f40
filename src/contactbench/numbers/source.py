"""A scene's functions as source of straight-line code, for C, numba and plain Python."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from typing import Any, NamedTuple

from contactbench.numbers.recording import FUNCTIONS, CannotRecord, Tape, recorded, text_of

NAMES = re.compile(r"[a-z]+\d+")
#: what the program imports
PREAMBLE = (
    f"from math import {', '.join(FUNCTIONS)}, atan2, hypot, inf, nan\n\nLARGEST = {sys.float_info.max!r}\n"
)


class Source(NamedTuple):
    """A recorded function ``name(y, numbers, out)``.

    text : Python source, to be executed with `PREAMBLE` before it.  y : packed state, `inputs` long;
    numbers : the scene's `numbers()`, `parameters` long; out : where the `outputs` results are written,
    a Jacobian row by row.  Each may be anything with an index: an array, or a pointer in compiled code.
    """

    text: str
    name: str
    inputs: int
    parameters: int
    outputs: int


def source(scene: Any, what: str, carry: Sequence[str]) -> Source:
    """A scene's right-hand side ("rhs") or its derivative ("jacobian") as source.

    A Jacobian's zeros are taken for zeros wherever they are multiplied with, inf and nan included.
    The text depends on `scene.structure` and the fields carried only: the scene's numbers are arguments.
    Raises `CannotRecord` where the scene branches on values, or has no Jacobian.
    """
    carry = tuple(carry)
    d, numbers = len(scene.labels(carry)), len(scene.numbers())
    tape = Tape(sparse=what == "jacobian")
    y = [tape.assign(f"y[{i}]", "f", tape.root) for i in range(d)]
    twin = scene.with_numbers([tape.assign(f"numbers[{i}]", "f", tape.root) for i in range(numbers)])
    result = recorded(lambda: getattr(twin, what)(scene.unpack(y, carry)))
    if result is None:
        raise CannotRecord(f"scene {scene.name!r} has no {what}")
    flat = scene.pack(result) if what == "rhs" else [entry for row in result for entry in row]
    tape.root.add(*(f"out[{i}] = {text_of(v)}" for i, v in enumerate(flat)))
    lines = "\n".join(needed(tape.root.lines))
    return Source(f"def {what}(y, numbers, out):\n{lines}\n", what, d, numbers, len(flat))


def needed(lines: Sequence[str]) -> list[str]:
    """Straight-line code without what nothing reads."""
    kept, read = [], {"out"}
    for line in reversed(lines):
        target, _, text = line.partition(" = ")
        if target.strip().partition("[")[0] in read:
            kept.append(line)
            read |= {*NAMES.findall(text)}
    return kept[::-1]


def executed(text: str) -> dict[str, Any]:
    """The names that source defines when run by Python itself."""
    scope: dict[str, Any] = {}
    exec(PREAMBLE + text, scope)
    return scope


def executed_on_lists(text: str) -> dict[str, Any]:
    """The same for functions of arrays, which become lists of lists: ``w[u, i]`` is ``w[u][i]``."""
    return executed(re.sub(r"\[(\w+), ", r"[\1][", text))
