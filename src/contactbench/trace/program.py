"""A time loop as two recorded functions: one computes constants once, the other one computes the steps.

`record` runs a function of (numbers, h, n, state) on recorded numbers and makes of it

    setup(numbers, spans, data, shape, w)   row u of w: everything that depends on (h, n) = spans[u] only
    run(start, w, shape, after)             the states after all intervals in one row, the j-th by row which[j] of w
    run(start, w, shape, times, after)      the same of states with a time, the j-th interval's dates in row j of times

`setup` is called once per choice of steps, `run` at every call.  Vectors made by ``xp.asarray``, such as
the coefficients of a composition, are data of the program and not part of it, as are their lengths and the
lengths of loops: compositions that are the same loop over flows have the same functions.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Hashable, Sequence
from contextlib import suppress
from functools import partial, reduce
from operator import and_
from typing import Any, NamedTuple

import numpy as np

from contactbench.numbers.control import Repeat
from contactbench.numbers.dual import Dual, leaves, rebuild, slope, value
from contactbench.numbers.protocol import Abilities, Arithmetic, CannotRecord, Count
from contactbench.trace.form import (
    Allocate,
    Assign,
    Combine,
    Element,
    Function,
    Loop,
    Operand,
    Operation,
    Statement,
    Store,
    Update,
    While,
)
from contactbench.trace.recording import Block, Recorded, RecordedNumbers, Tape, attempt

Numbers = Sequence[Arithmetic]


class Program(NamedTuple):
    """A recorded time loop.

    data, shape : arguments of the functions; `run` gets (*shape, *which).  width : length of a row of w.  size : number
    of components of a state.
    """

    setup: Function
    run: Function
    data: np.ndarray
    shape: np.ndarray
    width: int
    size: int
    #: whether `run` performs all the tests of `Watch`
    watched: bool = False


class Watch(NamedTuple):
    """Further tests of `run`, functions of (numbers, state): a finite slope, an energy and its allowed rise."""

    slope: Callable[[Numbers, Numbers], list[Arithmetic]]
    energy: Callable[[Numbers, Numbers], tuple[Arithmetic, Arithmetic]] | None


#: names of the dates of an interval, see `methods.dates`
DATES = ("begins", "low", "high")
#: the entry that another thread sets to end a run early; the number of steps between two tests of it
STOP, TURN = Element("shape", (0,), kind="stop"), 2**12


class Column(Block):
    """The expressions computed for every element of a vector; `data` has its elements, in ranges as they are picked."""

    def __init__(self, tape: ProgramTape, values: tuple[float, ...]) -> None:
        super().__init__(tape.root)
        self.values, self.data = values, []  # type: tuple[float, ...], list[float]
        self.picked: dict[tuple[int, ...], int] = {}
        self.stored: list[str] = []
        self.element = tape.name("c")
        tape.columns.append(self)

    def pick(self, rows: Sequence[int]) -> int:
        """Return the place of the elements of these rows in `data`."""
        rows = tuple(int(row) % len(self.values) for row in rows)
        if rows not in self.picked:
            self.picked[rows] = len(self.data)
            self.data += [self.values[row] for row in rows]
        return self.picked[rows]


class Vector(Recorded):
    """An expression for some elements of a column: ``v[3]``, ``v[rows]``, and ``v[k]`` for a recorded k."""

    __slots__ = ("rows",)

    def __init__(
        self, tape: ProgramTape, name: str, column: Column, rows: Sequence[int] | None = None
    ) -> None:
        super().__init__(tape, name, "f", column)
        self.rows = range(len(column.values)) if rows is None else rows

    def __getitem__(self, key: Any) -> Recorded:
        tape, column = self.tape, self.block
        assert isinstance(tape, ProgramTape)
        assert isinstance(column, Column)
        known = not isinstance(key, Recorded)
        if known and np.ndim(key):
            return Vector(tape, self.name, column, [self.rows[row] for row in key])
        rows = [self.rows[key]] if known else self.rows
        if known:
            return tape.assign(self.place(rows), "f", tape.main)
        return tape.assign(self.place(rows, tape.read(key, key.block, "i")), "f", key.block)

    def place(self, rows: Sequence[int], shift: Operand = 0) -> Element:
        tape, column = self.tape, self.block
        assert isinstance(tape, ProgramTape)
        assert isinstance(column, Column)
        return Element("w", ("u", tape.place(column, self.name, column.pick(rows)).name), shift)


class KeptRows:
    """Rows in a local array of the program; like : an example of a row."""

    def __init__(self, tape: Tape, count: int, like: Sequence[Arithmetic]) -> None:
        self.tape, self.like, self.width = tape, like, len(leaves(like))
        self.array, self.total = tape.name("rows"), tape.name("total")
        self.add(Allocate(self.array, count * self.width), Allocate(self.total, self.width))

    def add(self, *statements: Statement) -> None:
        self.tape.block.statements += statements

    def start(self, i: Count) -> Operand:
        return self.tape.read(i * self.width, self.tape.block, "i")

    def __getitem__(self, i: Count) -> Sequence[Arithmetic]:
        return self.load(self.array, self.start(i))

    def load(self, array: str, start: Operand) -> Sequence[Arithmetic]:
        names = [self.tape.name() for _ in range(self.width)]
        self.add(*(Assign(name, Element(array, (start,), c)) for c, name in enumerate(names)))
        return rebuild(self.like, [Recorded(self.tape, name, "f", self.tape.block) for name in names])

    def __setitem__(self, i: Count, row: Sequence[Arithmetic]) -> None:
        start = self.start(i)
        whole = leaves(
            [
                Dual(value(v), slope(v)) if isinstance(a, Dual) else v
                for a, v in zip(self.like, row, strict=True)
            ]
        )
        values = [self.tape.read(v, self.tape.block) for v in whole]
        self.add(*(Store(Element(self.array, (start,), c), v) for c, v in enumerate(values)))

    def combine(self, weights: Any, first: Count, count: Count, late: int = 0) -> Sequence[Arithmetic]:
        shift, times = (self.tape.read(number, self.tape.block, "i") for number in (first, count))
        element = weights.place(weights.rows, shift)
        self.add(Combine(self.total, element, self.array, times, self.width, late))
        return self.load(self.total, 0)


class ProgramTape(Tape):
    def __init__(self) -> None:
        super().__init__()
        #: whole numbers for both functions, known when everything is recorded
        self.whole = Block()
        self.shape: list[Callable[[], Count]] = [lambda: 0]  # the first is STOP
        self.root = Block(self.whole)
        self.main = self.block = Block(self.root)
        self.columns: list[Column] = []
        #: numbers of `setup` that `run` reads, with their kinds
        self.exported: dict[str, str] = {}

    def given(self, numbers: int) -> tuple[list[Recorded], Recorded, Recorded]:
        """Return the arguments of `setup`: a scene's numbers, and the step and the count of an interval."""
        own = [self.assign(Element("numbers", (i,)), "f", self.root) for i in range(numbers)]
        h = self.assign(Element("spans", ("u", 0)), "f", self.root)
        return own, h, self.assign(Element("spans", ("u", 1), kind="i"), "i", self.root)

    @property
    def loads(self) -> list[Assign]:
        """Return the statements of `run` that read numbers of `setup` from a row of w."""
        exported = enumerate(self.exported.items())
        return [Assign(name, Element("w", ("u", i), kind=kind)) for i, (name, kind) in exported]

    @property
    def constants(self) -> tuple[np.ndarray, np.ndarray, int]:
        """Return the data, the shape and the width of the program."""
        data = np.array([value for column in self.columns for value in column.data], dtype=float)
        width = len(self.exported) + sum(len(column.data) * len(column.stored) for column in self.columns)
        return data, np.array([number() for number in self.shape], dtype=np.int64), width

    def size(self, key: Hashable, number: Callable[[], Count]) -> Recorded:
        if key not in self.whole.known:
            i, name = len(self.shape), f"i0{len(self.shape)}"
            self.whole.known[key] = name
            self.whole.statements.append(Assign(name, Element("shape", (i,), kind="i")))
            self.shape.append(number)
        return Recorded(self, self.whole.known[key], "i", self.whole)

    def place(self, column: Column, name: str, offset: int) -> Recorded:
        """Return the place of an expression of a column in a row of w, from an offset in the column."""
        if name not in column.stored:
            column.stored.append(name)
        at = column.stored.index(name)

        def start() -> int:
            before = self.columns[: self.columns.index(column)]
            sizes = sum(len(other.data) * len(other.stored) for other in before)
            return len(self.exported) + sizes + at * len(column.data) + offset

        return self.size((id(column), at, offset), start)

    def read(self, x: object, block: Block, kind: str = "f") -> Operand:
        operand = super().read(x, block, kind)
        if isinstance(x, Recorded) and x.block is self.root and block.within(self.main):
            self.exported[x.name] = x.kind
        return operand

    def assign(self, value: Operation | Element, kind: str, block: Block) -> Recorded:
        made = super().assign(value, kind, block)
        return Vector(self, made.name, block) if isinstance(block, Column) else made

    def repeat[X](self, n: Count, body: Callable[[X], X], x: X) -> X:
        times = n if isinstance(n, Recorded) else self.size(("times", n), lambda: n)
        return super().repeat(times, body, x)


class RecordedArrays(RecordedNumbers):
    """The namespace of recorded programs, with vectors for the constants of stages."""

    abilities = Abilities(vectors=True)

    class multiply:
        @staticmethod
        def outer(vector: Arithmetic, number: Arithmetic) -> Arithmetic:
            return vector * number

    def asarray(self, values: Sequence[Arithmetic]) -> np.ndarray | Vector:
        if all(isinstance(value, int | np.integer) for value in values):
            return np.array(values)
        tape = self.tape
        assert isinstance(tape, ProgramTape)
        column = Column(tape, tuple(map(float, values)))
        return Vector(tape, column.element, column)


def record(
    advance: Callable[..., list[Arithmetic]],
    numbers: int,
    d: int,
    bounded: int,
    factor: float,
    watch: Watch | None = None,
    clock: int | None = None,
) -> Program:
    """Return the program of ``advance(numbers, h, n, y, xp, repeat) -> y`` on packed states of d components.

    clock : the index of the time, if there is one; then `advance` also gets an origin and `DATES`.

    `run` returns −1, or the number of the first interval that ends with a number that is not finite, with one of the
    first `bounded` numbers above `factor` times their norm at the start (at least 1), or with a risen energy; 0 if the
    slope is not finite.  Raises `CannotRecord`.
    """
    tape = ProgramTape()
    given, h, n = tape.given(numbers)
    state = [Recorded(tape, f"x{i}", "f", tape.main) for i in range(d)]
    loop = Repeat(tape.repeat, partial(KeptRows, tape))
    dates = () if clock is None else (f"start{clock}", *DATES)
    dated = [Recorded(tape, name, "f", tape.main) for name in dates]
    end = attempt(lambda: advance(given, h, n, state, RecordedArrays(tape), loop, *dated))
    if len(end) != d:
        raise CannotRecord(f"a step from {d} components to {len(end)}")
    ends = tuple(tape.read(value, tape.main) for value in end)
    head, last = looks(tape, given, d, bounded, factor, None)
    watched = False
    if watch is not None:
        with suppress(CannotRecord):  # a function that runs on plain numbers alone
            head, last = looks(tape, given, d, bounded, factor, watch)
            watched = True
    once = setup(tape)  # adds to the shape
    arrays = ("start", "w", "shape", *(("times",) if dates else ()), "after")
    run = Function("run", arrays, steps(tape, ends, head, last, dates[1:]), "bad")
    return Program(once, run, *tape.constants, d, watched)


def setup(tape: ProgramTape) -> Function:
    body = [*tape.root.statements]
    for slot, (name, kind) in enumerate(tape.exported.items()):
        body.append(Store(Element("w", ("u", slot), kind=kind), name))
    for j, column in enumerate(tape.columns):
        length = tape.size(("length", j), lambda j=j: len(tape.columns[j].data))  # type: ignore[misc]
        first = tape.size(("first", j), lambda j=j: sum(len(c.data) for c in tape.columns[:j]))  # type: ignore[misc]
        places = ((tape.place(column, name, 0).name, name) for name in column.stored)
        stores = (Store(Element("w", ("u", place), "k"), name) for place, name in places)
        load = Assign(column.element, Element("data", (first.name,), "k"))
        body.append(Loop("k", length.name, (load, *column.statements, *stores)))
    rows = Assign("rows", Operation("len", ("spans",)))
    arguments = ("numbers", "spans", "data", "shape", "w")
    return Function("setup", arguments, (*tape.whole.statements, rows, Loop("u", "rows", tuple(body))))


def looks(
    tape: ProgramTape, numbers: Numbers, d: int, bounded: int, factor: float, watch: Watch | None
) -> tuple[list[Statement], list[Statement]]:
    """Return the statements of `run` before its loop and at the end of each interval that find the first bad one."""
    xp, head, last = RecordedNumbers(tape), Block(tape.main), Block(tape.main)
    start, state = ([Recorded(tape, f"x{i}", "f", block) for i in range(d)] for block in (head, last))
    size = xp.sqrt(sum((c * c for c in start[1:bounded]), start[0] * start[0]))
    bound: Any = factor * xp.where(size > 1.0, size, 1.0)
    if watch is not None:
        rate = attempt(lambda: sum(map(abs, watch.slope(numbers, start))))
        bound = xp.where(rate <= sys.float_info.max, bound, math.nan)
    bound = Recorded(tape, bound.name, "f", tape.whole)  # known from the head on
    most = [bound if i < bounded else sys.float_info.max for i in range(d)]
    healthy = reduce(and_, (abs(x) <= end for x, end in zip(state, most, strict=True)))
    if watch is not None and watch.energy is not None:
        energy, room = attempt(lambda: watch.energy(numbers, start))  # type: ignore[misc]
        top: Any = energy + room
        highest = Recorded(tape, top.name, "f", tape.whole)
        healthy = healthy & (attempt(lambda: watch.energy(numbers, state))[0] <= highest)  # type: ignore[misc]
    first = ~healthy & (Recorded(tape, "bad", "i", last) < 0)
    mark = Assign("first", Operation("where", (first.name, "j", "bad")))
    return [*head.statements, Update(("bad",), (-1,))], [*last.statements, mark, Update(("bad",), ("first",))]


def steps(
    tape: ProgramTape,
    ends: tuple[Operand, ...],
    head: Sequence[Statement],
    last: Sequence[Statement],
    dates: Sequence[str],
) -> tuple[Statement, ...]:
    """Return the loop over the intervals; head, last : before it, at the end of each; dates : names in `times`."""
    state, known = tuple(f"x{i}" for i in range(len(ends))), len(tape.shape)
    first = tuple(f"start{i}" for i in range(len(ends)))
    given = [Assign(name, Element("start", (i,))) for i, name in enumerate(first)]
    first_row, row = (Assign("u", Element("shape", (known,), j, "i")) for j in (0, "j"))
    at = Assign("at", Operation("mul", ("j", len(ends))))
    stores = [Store(Element("after", ("at",), i), x) for i, x in enumerate(state)]
    steps = (part for statement in tape.main.statements for part in interruptible(statement))
    times = [Assign(name, Element("times", ("j", i))) for i, name in enumerate(dates)]
    body = row, *times, *tape.loads, *steps, Update(state, ends), at, *stores, *last
    count = Assign("all", Operation("len", ("shape",))), Assign("intervals", Operation("sub", ("all", known)))
    before = *given, Update(state, first), first_row, *tape.loads, *head
    return *tape.whole.statements, *before, *count, Loop("j", "intervals", body)


def interruptible(statement: Statement) -> tuple[Statement, ...]:
    """Return a loop over steps so that it ends at `STOP`, in turns where their number is known, else step by step."""
    if isinstance(statement, While):
        go, more = (f"{name}{statement.condition}" for name in ("go", "more"))
        test = *statement.test, *going(go), Assign(more, Operation("and", (statement.condition, go)))
        return (While(test, more, tuple(part for each in statement.body for part in interruptible(each))),)
    if not (isinstance(statement, Loop) and isinstance(statement.times, str)) or statement.times[:2] == "i0":
        return (statement,)
    done, left, more, go, size, after = (f"{name}{statement.times}" for name in TURNS)
    test = (
        Assign(left, Operation("sub", (statement.times, done))),
        Assign(f"{left}0", Operation("gt", (left, 0))),
        *going(go),
        Assign(more, Operation("and", (f"{left}0", go))),
    )
    turn = (
        Assign(f"{size}0", Operation("lt", (left, TURN))),
        Assign(size, Operation("where", (f"{size}0", left, TURN))),
        statement._replace(times=size),
        Assign(after, Operation("add", (done, size))),
        Update((done,), (after,)),
    )
    return Update((done,), (0,)), While(test, more, turn)


def going(go: str) -> tuple[Statement, ...]:
    """Assign to a name whether nobody has set `STOP`."""
    return Assign(f"{go}0", STOP), Assign(go, Operation("eq", (f"{go}0", 0)))


#: prefixes of the variables of such a loop
TURNS = ("done", "left", "more", "go", "turn", "next")
