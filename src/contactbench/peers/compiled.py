"""Solvers in C and C++ that call a scene's right-hand side and Jacobian as C functions, without Python.

    void rhs     (double *dy, double t, const double *y, double *data)
    void jacobian(double *J,  double t, const double *y, double *data)     J column by column, as LAPACK has it

data = (calls of rhs, calls of jacobian, origin, constants…): the functions count their own calls.  y is the state
without the time, and t is the time since the origin, the start of a run.  The constants are computed once from the
scene's numbers (1/m, γ/2, …), so that one compiled function serves every scene of the same structure.  The functions
are recorded from the scene and compiled by LLVM.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cached_property
from threading import Lock
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np

from contactbench.methods.prepared import Request, stopwatch
from contactbench.numbers.protocol import Arithmetic, CannotRecord
from contactbench.peers.base import Call, Ending, Peer, derivative
from contactbench.scene import AnyState, Cache, Scene, key
from contactbench.solution import Counts, Status
from contactbench.trace.compiled import compile_recorded_c
from contactbench.trace.form import Assign, Element, Function, Operation, Store, execute, read_by
from contactbench.trace.recording import Block, Tape, attempt, is_constant, operand_of

#: places in data: the two counters, the start of the run, the constants
RHS_CALLS, JACOBIAN_CALLS, ORIGIN, CONSTANTS = 0, 1, 2, 3
#: names of the numbers that a compiled call returns before the packed state reached
FACTS = ("flag", "reached", "saved", "steps", "evaluations", "jacobians", "rejected")
KNOWN = len(FACTS)
#: CyRK's status codes
SUCCESS, TOO_MANY_STEPS, TOO_MANY_STEPS_SO_FAR = 1, -52, -53
#: the major version of SUNDIALS whose C interface is known
MAJOR = 7
#: result of CVode when the budget of steps is spent
TOO_MUCH_WORK = -1
#: most components of a state with a compiled dense Jacobian; beyond, solvers take differences
LARGEST_JACOBIAN = 64


class CFunctions(NamedTuple):
    """Hold the addresses of rhs and jacobian (0: none), the function that makes their data, and the compile time."""

    rhs: int
    jacobian: int
    constants: Callable[[Sequence[float]], Sequence[float]]
    compile_s: float

    def data(self, numbers: Sequence[float]) -> np.ndarray:
        return np.array([0.0] * CONSTANTS + [*self.constants(numbers)])


#: a library's module of compiled calls, and their first arguments
type Connection = tuple[ModuleType, tuple[Any, ...]]

_compiled: Cache[CFunctions] = Cache(256)


def c_functions(scene: Scene, carry: tuple[str, ...]) -> CFunctions:
    """Return the C functions of a scene, compiled once; raises `CannotRecord` if the scene branches on values."""

    def make() -> CFunctions:
        elapsed = stopwatch()
        constants, found = functions(scene, carry)
        at = {name: compile_recorded_c(function) for name, function in found.items()}
        return CFunctions(at["rhs"], at.get("jacobian", 0), execute(constants), elapsed())

    return _compiled.get(key(scene.identity, carry), make)


def functions(scene: Scene, carry: tuple[str, ...]) -> tuple[Function, dict[str, Function]]:
    """Return `constants(numbers)`, which Python runs, and the C functions: `rhs` and, up to a size, `jacobian`."""
    tape = Tape()
    numbers = [tape.assign(Element("numbers", (i,)), "f", tape.root) for i in range(len(scene.numbers()))]
    twin = scene.with_numbers(numbers)

    def slopes(x: AnyState) -> list[Arithmetic]:
        return list(scene.without_clock(scene.pack(twin.rhs(x))))

    def columns(x: AnyState) -> list[Arithmetic]:
        rows = [scene.without_clock(row) for row in scene.without_clock(derivative(twin, x, carry))]
        return [entry for column in zip(*rows, strict=True) for entry in column]

    bodies = {"rhs": _body(tape, scene, carry, slopes, "rhs")}
    if len(scene.labels(carry)) <= LARGEST_JACOBIAN:
        with suppress(CannotRecord):  # a function that dual numbers do not know: the solver takes differences
            bodies["jacobian"] = _body(tape, scene, carry, columns, "jacobian")
    known = set(tape.root.known.values())
    read = [x for body in bodies.values() for statement in body for x in read_by(statement)]
    used = [name for name in dict.fromkeys(read) if name in known]
    loads = [Assign(name, Element("data", (i,))) for i, name in enumerate(used, CONSTANTS)]
    found = {}
    for calls, (name, body) in enumerate(bodies.items()):
        count = Element("data", (calls,))
        more = Assign("calls", count), Assign("more", Operation("add", ("calls", 1.0))), Store(count, "more")
        found[name] = Function(name, ("out", "t", "y", "data"), (*more, *loads, *body))
    return Function("constants", ("numbers",), tuple(tape.root.statements), tuple(used)), found


def _body(
    tape: Tape,
    scene: Scene,
    carry: tuple[str, ...],
    function: Callable[[AnyState], list[Arithmetic]],
    name: str,
) -> list[Assign | Store]:
    block = tape.block = Block(tape.root)
    size = len(scene.without_clock(scene.labels(carry)))
    y = [tape.assign(Element("y", (i,)), "f", block) for i in range(size)]
    t = None
    if scene.clock is not None:
        block.statements.append(Assign("origin", Element("data", (ORIGIN,))))
        t = tape.assign(Operation("add", ("origin", "t")), "f", block)
    values = attempt(lambda: function(scene.unpack(scene.with_clock(y, t), carry)))
    # CVODE has cleared the matrix
    stored = [(i, v) for i, v in enumerate(values) if name == "rhs" or not is_constant(v, 0)]
    return block.statements + [Store(Element("out", (i,)), operand_of(v)) for i, v in stored]


class Compiled(Call):
    """A compiled solver; a subclass connects the library and translates its results."""

    def __init__(self, method: Peer, request: Request) -> None:
        super().__init__(method, request)
        self.functions = c_functions(self.scene, request.carry)
        self.seconds = self.functions.compile_s
        self.data = self.functions.data(self.scene.numbers())
        self.final_only = len(self.later) == 1
        self.alone = Lock()  # calls share memory, so threads take turns
        self.library, self.arguments = self.connect(-1 if self.clock is None else self.clock)

    @cached_property
    def to_end(self) -> Callable[..., np.ndarray]:
        """Return the compiled entry point for these arguments, which numba's dispatcher would find in 0.3 µs."""
        from numba import typeof

        kinds = tuple(map(typeof, (np.empty(len(self.request.start)), *self.arguments)))
        self.library.to_end.compile(kinds)
        entry: Callable[..., np.ndarray] = self.library.to_end.overloads[kinds].entry_point
        return entry

    @abstractmethod
    def connect(self, clock: int) -> Connection:
        """Return the compiled `to_end` and `at_times`, and their arguments but states and times."""

    @abstractmethod
    def ending(self, flag: int) -> tuple[Status, str]:
        """Return how a run ended, by the flag that the library returned, and its message."""

    def counts(self, steps: int, evaluations: int, jacobians: int, rejected: float) -> Counts:
        return Counts(steps, evaluations, jacobians, int(rejected))

    def last(self, y0: np.ndarray) -> np.ndarray:
        return self.to_end(y0, *self.arguments)[KNOWN:]

    def run(self, y0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return `FACTS` with the state reached, and the saved states; states not reached are arbitrary."""
        if self.final_only:
            facts = self.to_end(y0, *self.arguments)
            return facts, facts[None, KNOWN:]
        rows = np.empty((len(self.later), len(y0)))
        return self.library.at_times(y0, self.later, rows, *self.arguments), rows

    def __call__(self, y0: np.ndarray) -> Ending:
        with self.alone:
            facts, rows = self.run(y0)
        flag, reached, saved, steps, evaluations, jacobians, rejected = facts[:KNOWN].tolist()
        counts = self.counts(int(steps), int(evaluations), int(jacobians), rejected)
        status, message = self.ending(int(flag))
        rows = rows[: int(saved)]
        if status is Status.ok:
            return Ending(rows, counts)
        return Ending(rows, counts, status, f"{message} (t = {reached:.6g})", (reached, facts[KNOWN:]))
