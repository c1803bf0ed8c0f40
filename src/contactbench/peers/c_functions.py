"""A scene's right-hand side and Jacobian as C functions, for solvers written in C and C++.

    void rhs     (double *dy, double t, const double *y, double *data)
    void jacobian(double *J,  double t, const double *y, double *data)     J column by column, as LAPACK has it

data = (calls of rhs, calls of jacobian, origin, constants…): the functions count their own calls; y is the state
less the time, which is t since the origin, the time a run begins at.  The constants are what the scene's numbers
give before a state is known (1/m, γ/2, …), computed once; so one compiled function serves every scene of the same
structure.  The source is recorded from the scene (trace/recording.py), lowered to instructions (trace/lowering.py) and
compiled by numba.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from contactbench.methods.base import stopwatch
from contactbench.numbers.dual import Dual, slope
from contactbench.scene import Scene
from contactbench.scene.cache import Cache, key
from contactbench.trace.compiled import imported, version
from contactbench.trace.recording import Block, CannotRecord, Tape, is_constant, recorded, text_of
from contactbench.trace.source import PREAMBLE

#: places in data: the two counters, the time a run begins at, then the constants
RHS_CALLS, JACOBIAN_CALLS, ORIGIN, CONSTANTS = 0, 1, 2, 3


#: components of a state up to which its dense Jacobian is compiled; beyond, solvers take differences
LARGEST_JACOBIAN = 64


@dataclass(frozen=True)
class CFunctions:
    """Addresses of the two functions (jacobian 0 where it cannot be had), and how to make their data."""

    rhs: int
    jacobian: int
    constants: Callable[[Sequence[float]], list[float]]
    #: seconds spent recording and compiling
    compile_s: float
    #: the module of the machine code, kept alive
    module: Any

    def data(self, numbers: Sequence[float]) -> np.ndarray:
        """The argument `data` for a scene's numbers."""
        return np.array([0.0] * CONSTANTS + self.constants(numbers))


_compiled: Cache[CFunctions] = Cache(256)


def clock_of(scene: Scene) -> int:
    """Where the time is in a packed state, −1 for nowhere: as compiled code takes it."""
    return -1 if scene.clock is None else scene.clock


def c_functions(scene: Scene, carry: tuple[str, ...]) -> CFunctions:
    """The C functions of a scene, compiled once for its identity and the fields carried.

    Raises `CannotRecord` where the right-hand side branches on values.
    """

    def make() -> CFunctions:
        elapsed = stopwatch()
        m = imported(HEADER.format(version=version()) + source(scene, carry))
        jacobian = m.jacobian.address if hasattr(m, "jacobian") else 0
        return CFunctions(m.rhs.address, jacobian, m.constants, elapsed(), m)

    return _compiled.get(key(scene.identity, carry), make)


def source(scene: Scene, carry: tuple[str, ...]) -> str:
    """Python source of `constants(numbers)`, `rhs(out, t, y, data)` and, where it exists, `jacobian`."""
    tape = Tape()
    numbers = [tape.assign(f"numbers[{i}]", "f", tape.root) for i in range(len(scene.numbers()))]
    twin = scene.with_numbers(numbers)

    def slopes(x: Any) -> list[Any]:
        return list(scene.without_clock(scene.pack(twin.rhs(x))))

    def columns(x: Any) -> list[Any]:
        rows = [scene.without_clock(row) for row in scene.without_clock(derivative(twin, x, carry))]
        return [entry for column in zip(*rows, strict=True) for entry in column]

    bodies = {"rhs": _body(tape, scene, carry, slopes, "rhs")}
    if len(scene.labels(carry)) <= LARGEST_JACOBIAN:
        with suppress(CannotRecord):  # a function that dual numbers do not know: the solver takes differences
            bodies["jacobian"] = _body(tape, scene, carry, columns, "jacobian")
    known = set(tape.root.known.values())
    named = NAMES.findall("\n".join(line for body in bodies.values() for line in body))
    used = [name for name in dict.fromkeys(named) if name in known]
    places = [f"    {name} = data[{i}]" for i, name in enumerate(used, CONSTANTS)]
    text = ["def constants(numbers):", *tape.root.lines, f"    return [{', '.join(used)}]"]
    for calls, (name, body) in enumerate(bodies.items()):
        head = f"def {name}(out, t, y, data):"
        lines = [head, f"    data[{calls}] = data[{calls}] + 1.0", *places, *body]
        text += ["", f'{name}_lowered = lowered("""{"\n".join(lines)}""")', ""]
        text += ["@compiled", head, f"    {name}_lowered(out, t, y, data)"]
    return "\n".join(text) + "\n"


#: what a tape calls its values
NAMES = re.compile(r"\b[fib]\d+\b")


def _body(
    tape: Tape, scene: Scene, carry: tuple[str, ...], function: Callable[[Any], list[Any]], name: str
) -> list[str]:
    """The lines of a function of the state, less what depends on the scene's numbers alone."""
    block = tape.block = Block(tape.root, indent=1)
    size = len(scene.without_clock(scene.labels(carry)))
    y = [tape.assign(f"y[{i}]", "f", block) for i in range(size)]
    t = None if scene.clock is None else tape.assign(f"data[{ORIGIN}] + t", "f", block)
    values = recorded(lambda: function(scene.unpack(scene.with_clock(y, t), carry)))
    # CVODE has cleared the matrix
    stored = [(i, v) for i, v in enumerate(values) if name == "rhs" or not is_constant(v, 0)]
    return block.lines + [f"    out[{i}] = {text_of(v)}" for i, v in stored]


def derivative(scene: Scene, x: Any, carry: tuple[str, ...]) -> list[list[Any]]:
    """Df at x: the scene's own Jacobian, or its right-hand side on dual numbers."""
    with suppress(NotImplementedError):
        rows = scene.jacobian(x)
        if rows is not None:
            return rows
    y = scene.pack(x)
    columns = []
    for j in range(len(y)):
        moved = [Dual(c, 1.0 if i == j else 0.0) for i, c in enumerate(y)]
        columns.append([slope(c) for c in scene.pack(scene.rhs(scene.unpack(moved, carry)))])
    return [list(row) for row in zip(*columns, strict=True)]


HEADER = f'''"""Generated by contactbench, with {{version}}; may be deleted."""
from numba import cfunc, types
from contactbench.trace.lowering import lowered

{PREAMBLE}
pointer = types.CPointer(types.float64)
signature = types.void(pointer, types.float64, pointer, pointer)
compiled = cfunc(signature, cache=True)

'''
