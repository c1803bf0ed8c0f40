"""A scene's right-hand side and Jacobian as C functions, for solvers written in C and C++.

    void rhs     (double *dy, double t, const double *y, double *data)
    void jacobian(double *J,  double t, const double *y, double *data)     J column by column, as LAPACK has it

data = (calls of rhs, calls of jacobian, constants…): the functions count their own calls.  The constants are
what the scene's numbers give before a state is known (1/m, γ/2, …), computed once; so one compiled function
serves every scene of the same structure.  The source is recorded from the scene (numbers/recording.py) and
compiled by numba.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from contactbench.methods.base import stopwatch
from contactbench.numbers.dual import Dual, slope
from contactbench.numbers.recording import (
    PREAMBLE,
    Block,
    CannotRecord,
    Tape,
    executed,
    recorded,
    text_of,
)
from contactbench.scene import Scene

#: places in data: the two counters, then the constants
RHS_CALLS, JACOBIAN_CALLS, CONSTANTS = 0, 1, 2


@dataclass(frozen=True)
class CFunctions:
    """Addresses of the two functions (jacobian 0 where it cannot be had), and how to make their data."""

    rhs: int
    jacobian: int
    constants: Callable[[Sequence[float]], list[float]]
    #: seconds spent recording and compiling
    compile_s: float
    #: what keeps the machine code alive
    keep: Any

    def data(self, numbers: Sequence[float]) -> np.ndarray:
        """The argument `data` for a scene's numbers."""
        return np.array([0.0] * CONSTANTS + self.constants(numbers))


_compiled: dict[Any, CFunctions] = {}


def c_functions(scene: Scene, carry: tuple[str, ...]) -> CFunctions:
    """The C functions of a scene, compiled once for its structure and the fields carried.

    Raises `CannotRecord` where the right-hand side branches on values.
    """
    key = (scene.structure, carry)
    if key not in _compiled:
        elapsed = stopwatch()
        text = source(scene, carry)
        addresses, keep = compiled(text)
        _compiled[key] = CFunctions(
            addresses.get("rhs", 0), addresses.get("jacobian", 0), _constants(text), elapsed(), keep
        )
    return _compiled[key]


def _constants(text: str) -> Callable[[Sequence[float]], list[float]]:
    return executed(text)["constants"]


def source(scene: Scene, carry: tuple[str, ...]) -> str:
    """Python source of `constants(numbers)`, `rhs(dy, t, y, data)` and, where it exists, `jacobian`."""
    tape = Tape()
    tape.root.depth = 1
    numbers = [tape.assign(f"numbers[{i}]", "f", tape.root) for i in range(len(scene.numbers()))]
    twin = scene.with_numbers(numbers)
    bodies = {"rhs": _body(tape, scene, carry, "dy", lambda x: scene.pack(twin.rhs(x)))}
    try:
        bodies["jacobian"] = _body(tape, scene, carry, "J", lambda x: by_columns(derivative(twin, x, carry)))
    except CannotRecord:  # a function without a derivative on dual numbers: the solver takes differences
        pass
    known = set(tape.root.known.values())
    used = [
        name for name in dict.fromkeys(NAMES.findall("\n".join(sum(bodies.values(), [])))) if name in known
    ]
    places = [f"    {name} = data[{i}]" for i, name in enumerate(used, CONSTANTS)]
    text = ["def constants(numbers):", *tape.root.lines, f"    return [{', '.join(used)}]"]
    for (name, lines), out, counter in zip(
        bodies.items(), ("dy", "J"), (RHS_CALLS, JACOBIAN_CALLS), strict=False
    ):
        text += [f"def {name}({out}, t, y, data):", f"    data[{counter}] += 1.0", *places, *lines]
    return "\n".join(text) + "\n"


#: what a tape calls its values
NAMES = re.compile(r"\b[fib]\d+\b")


def _body(
    tape: Tape, scene: Scene, carry: tuple[str, ...], out: str, function: Callable[[Any], list[Any]]
) -> list[str]:
    """The lines of a function of the state, less what depends on the scene's numbers alone."""
    block = Block(tape.root)
    tape.block = block
    y = [tape.assign(f"y[{i}]", "f", block) for i in range(len(scene.labels(carry)))]
    values = recorded(lambda: function(scene.unpack(y, carry)))
    indent = "    " * (block.depth - tape.root.depth)
    return [line.removeprefix(indent) for line in block.lines] + [
        f"    {out}[{i}] = {text_of(v)}" for i, v in enumerate(values)
    ]


def derivative(scene: Scene, x: Any, carry: tuple[str, ...]) -> list[list[Any]]:
    """Df at x: the scene's own Jacobian, or its right-hand side on dual numbers."""
    rows = scene.jacobian(x)
    if rows is not None:
        return rows
    y = scene.pack(x)
    columns = []
    for j in range(len(y)):
        moved = [Dual(c, 1.0 if i == j else 0.0) for i, c in enumerate(y)]
        columns.append([slope(c) for c in scene.pack(scene.rhs(scene.unpack(moved, carry)))])
    return [list(row) for row in zip(*columns, strict=True)]


def by_columns(rows: Sequence[Sequence[Any]]) -> list[Any]:
    return [entry for column in zip(*rows, strict=True) for entry in column]


def compiled(text: str) -> tuple[dict[str, int], list[Any]]:
    """Addresses of the C functions in a source, and what has to be kept."""
    import numba
    from numba import types

    pointer = types.CPointer(types.float64)
    signature = types.void(pointer, types.float64, pointer, pointer)
    names = executed(PREAMBLE + text)
    # contract: a product and a sum become one operation where the processor has it; nothing is reordered
    make = numba.cfunc(signature, error_model="numpy", fastmath={"contract"})
    keep = [make(names[name]) for name in ("rhs", "jacobian") if name in names]
    return {f.__name__: f.address for f in keep}, keep
