"""A time loop as recorded source: what is computed once, and what is computed at every step.

`record` runs a function of (numbers, h, n, state) on recorded numbers and writes two functions,

    setup(numbers, spans, data, shape, w)    row u of w: everything that depends on (h, n) = spans[u] only
    run(start, w, shape, after)              the states after all intervals in turn, of j from row which[j] of w

`setup` is called once per choice of steps, `run` at every call.  Vectors made by ``xp.asarray``, such as
the coefficients of a composition, are data of the program and not part of it, as are their lengths and the
lengths of loops: compositions that are the same loop over flows have the same source.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from contactbench.numbers.control import Repeat
from contactbench.numbers.protocol import Abilities
from contactbench.trace.recording import Block, CannotRecord, Recorded, RecordedNumbers, Tape, recorded


class Program(NamedTuple):
    """A recorded time loop.

    setup, run : source of the two functions, to be compiled after `source.PREAMBLE`.
    many : source of ``many(starts, w, shape, ends, part)``, `run` for many states of one scene side by side.
    data : floating-point numbers and shape : whole numbers it is called with; `run` takes (*shape, *which).
    width : how long a row of w is.
    """

    setup: str
    run: str
    many: str
    data: np.ndarray
    shape: np.ndarray
    width: int


class Column(Block):
    """A vector: what is computed for every element of it, beside the elements it starts from.

    data : those elements, one range after another, as often as they are picked.
    """

    def __init__(self, tape: ProgramTape, values: tuple[float, ...]) -> None:
        super().__init__(tape.root, tape.root.indent + 1)
        self.values, self.data = values, []  # type: tuple[float, ...], list[float]
        self.picked: dict[tuple[int, ...], int] = {}
        self.stored: list[str] = []
        self.element = tape.name("c")
        tape.columns.append(self)

    def pick(self, rows: Sequence[int]) -> int:
        """Where the elements of these rows begin in `data`."""
        rows = tuple(int(row) % len(self.values) for row in rows)
        if rows not in self.picked:
            self.picked[rows] = len(self.data)
            self.data += [self.values[row] for row in rows]
        return self.picked[rows]


class Vector(Recorded):
    """An element of a column, standing for all of them: ``v[3]``, ``v[rows]`` and ``v[k]`` for a recorded k."""

    __slots__ = ()

    def __getitem__(self, key: Any) -> Any:
        column = self.block
        assert isinstance(column, Column)
        if isinstance(key, Recorded):
            return Picked(self, range(len(column.values)))[key]
        rows = np.atleast_1d(key)
        return Picked(self, rows) if np.ndim(key) else Picked(self, rows)[0]


class Picked:
    """Some elements of a vector, in an order of their own."""

    def __init__(self, vector: Vector, rows: Sequence[int]) -> None:
        self.vector, self.rows = vector, rows

    def __getitem__(self, k: Any) -> Any:
        vector, rows = self.vector, self.rows
        if not isinstance(k, Recorded):
            rows, k = [rows[k]], 0
        tape, column = vector.tape, vector.block
        assert isinstance(tape, ProgramTape)
        assert isinstance(column, Column)
        first = tape.place(column, vector.name, column.pick(rows))
        if isinstance(k, int):
            return tape.assign(f"w[u, {first.name}]", "f", tape.main)
        return tape.operation(f"w[u, {first.name} + {{0}}]", "f", k)


class ProgramTape(Tape):
    """A recording with vectors, and with a part that is computed once."""

    def __init__(self) -> None:
        super().__init__()
        self.root.indent = 2
        self.main = self.block = Block(self.root, 2)
        self.columns: list[Column] = []
        #: numbers of `setup` that `run` reads, with their kinds
        self.exported: dict[str, str] = {}
        #: whole numbers both are called with: known when everything is recorded
        self.shape: list[Callable[[], int]] = []
        self.lengths: dict[Any, str] = {}

    def whole(self, key: Any, number: Callable[[], int]) -> Recorded:
        """A whole number that is an argument of the program."""
        if key not in self.lengths:
            self.lengths[key] = f"i0{len(self.shape)}"
            self.shape.append(number)
        return Recorded(self, self.lengths[key], "i", self.root)

    def place(self, column: Column, name: str, offset: int) -> Recorded:
        """Where in a row of w an expression of a column is stored, from an offset in the column on."""
        if name not in column.stored:
            column.stored.append(name)
        at = column.stored.index(name)
        return self.whole((id(column), at, offset), lambda: self.start(column, at) + offset)

    def start(self, column: Column, at: int) -> int:
        before = self.columns[: self.columns.index(column)]
        sizes = sum(len(other.data) * len(other.stored) for other in before)
        return len(self.exported) + sizes + at * len(column.data)

    def read(self, x: Any, block: Block, kind: str = "f") -> str:
        text = super().read(x, block, kind)
        if text.startswith("i0"):  # an argument of both functions
            return text
        if isinstance(x, Recorded) and x.block is self.root and block.within(self.main):
            self.exported[text] = x.kind
        return text

    def assign(self, text: str, kind: str, block: Block) -> Recorded:
        value = super().assign(text, kind, block)
        return Vector(self, value.name, kind, block) if isinstance(block, Column) else value

    def repeat(self, n: Any, body: Callable[[Any], Any], x: Any) -> Any:
        times = n if isinstance(n, Recorded) else self.whole(("times", n), lambda: n)
        return super().repeat(times, body, x)


class RecordedArrays(RecordedNumbers):
    """The namespace of recorded programs, with vectors for the constants of stages."""

    abilities = Abilities(vectors=True)

    class multiply:
        @staticmethod
        def outer(vector: Any, number: Any) -> Any:
            return vector * number

    def asarray(self, values: Sequence[Any]) -> Any:
        if all(isinstance(value, int | np.integer) for value in values):
            return np.array(values)
        tape = self.tape
        assert isinstance(tape, ProgramTape)
        column = Column(tape, tuple(map(float, values)))
        return Vector(tape, column.element, "f", column)


def record(advance: Callable[..., list[Any]], numbers: int, d: int, bounded: int, factor: float) -> Program:
    """The program of ``advance(numbers, h, n, y, xp, repeat) -> y``, on packed states of d components.

    `run` returns the first interval that ends with a number that is not finite, or with one of the first
    `bounded` components larger than `factor` times their norm at the start (1 if that is zero); −1 if none.
    Raises `CannotRecord`.
    """
    tape = ProgramTape()
    given = [tape.assign(f"numbers[{i}]", "f", tape.root) for i in range(numbers)]
    h, n = tape.assign("spans[u, 0]", "f", tape.root), tape.assign("int(spans[u, 1])", "i", tape.root)
    state = [Recorded(tape, f"x{i}", "f", tape.main) for i in range(d)]
    loop = Repeat(tape.repeat, over_stages=True)
    end = recorded(lambda: advance(given, h, n, state, RecordedArrays(tape), loop))
    if len(end) != d:
        raise CannotRecord(f"a step from {d} components to {len(end)}")
    ends = [tape.read(value, tape.main) for value in end]
    return Program(
        *assembled(tape, ends, bounded, factor),
        np.array([value for column in tape.columns for value in column.data], dtype=float),
        np.array([number() for number in tape.shape], dtype=np.int64),
        len(tape.exported) + sum(len(column.data) * len(column.stored) for column in tape.columns),
    )


def assembled(tape: ProgramTape, ends: list[str], bounded: int, factor: float) -> tuple[str, str, str]:
    """The three functions written out."""
    setup, run = Block(), Block()
    columns = Block(indent=tape.root.indent)
    for j, column in enumerate(tape.columns):
        length = tape.whole(("length", j), lambda j=j: len(tape.columns[j].data))  # type: ignore[misc]
        first = tape.whole(("first", j), lambda j=j: sum(len(c.data) for c in tape.columns[:j]))  # type: ignore[misc]
        columns.add(f"for k in range({length.name}):")
        columns.lines.append("    " * column.indent + f"{column.element} = data[{first.name} + k]")
        columns.lines += column.lines
        for name in column.stored:
            place = tape.place(column, name, 0)
            columns.lines.append("    " * column.indent + f"w[u, {place.name} + k] = {name}")
    state = [f"x{i}" for i in range(len(ends))]
    sizes = [f"{name} = shape[{i}]" for i, name in enumerate(tape.lengths.values())]

    setup.add(*sizes, "for u in range(len(spans)):")
    setup.lines += tape.root.lines
    for slot, (name, kind) in enumerate(tape.exported.items()):
        tape.root.lines.clear()
        tape.root.add(f"w[u, {slot}] = {f'1.0 if {name} else 0.0' if kind == 'b' else name}")
        setup.lines += tape.root.lines
    setup.lines += columns.lines

    # a sum of all of them in one expression would be too deep for Python's parser
    squares = [f"size = {'size + ' if i else ''}{x} * {x}" for i, x in enumerate(state[:bounded])]
    run.add(*sizes, *(f"{x} = start[{i}]" for i, x in enumerate(state)))
    begins = len(run.lines)
    run.add(*squares, "size = sqrt(size)", f"bound = {factor!r} * (size if size != 0.0 else 1.0)", "bad = -1")
    known = len(tape.shape)
    run.add(f"for j in range(len(shape) - {known}):", f"    u = shape[{known} + j]")
    loads = {"f": "{} = w[u, {}]", "i": "{} = int(w[u, {}])", "b": "{} = w[u, {}] != 0.0"}
    run.add(*("    " + loads[kind].format(name, i) for i, (name, kind) in enumerate(tape.exported.items())))
    run.lines += tape.main.lines
    run.add(f"    {', '.join(state)}, = {', '.join(ends)},")
    run.add(*(f"    after[{len(state)} * j + {i}] = {x}" for i, x in enumerate(state)))
    healthy = [f"abs({x}) <= {'bound' if i < bounded else 'LARGEST'}" for i, x in enumerate(state)]
    run.add(f"    if bad < 0 and not ({' and '.join(healthy)}):", "        bad = j", "return bad")
    start = run.lines.index("    bad = -1") + 1
    many = [
        *(line for line in run.lines[:begins] if "start[" not in line),
        *(f"    {x} = starts[{i}]" for i, x in enumerate(state)),
        *(line.replace(f"after[{len(state)} * j + ", "ends[j, ") for line in run.lines[start:-3]),
    ]
    return (
        "\n".join(["def setup(numbers, spans, data, shape, w):", *setup.lines, ""]),
        "\n".join(["def run(start, w, shape, after):", *run.lines, ""]),
        "\n".join(["def many(starts, w, shape, ends, part):", *many, ""]),
    )
