"""Time loops on fields: a number at every site of a lattice.

A step map that is run on recorded fields becomes *sweeps*, loops over the sites.  What a site does by itself joins the
sweep before; a new one begins where a neighbour's value is read that a sweep computes, or a sum over all sites.  Loops
over steps and stages are recorded around them, as in `program.py`.  A field that outlives its sweep is in a row of one
array.  Rows have names that loops exchange: nothing is copied, and no two names ever have one row.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from contactbench.numbers.control import Repeat
from contactbench.numbers.dual import Dual, leaves, rebuild, value
from contactbench.numbers.protocol import Arithmetic, CannotRecord, Count, Vector
from contactbench.trace.form import (
    Assign,
    Element,
    Function,
    Loop,
    Operand,
    Operation,
    Pairs,
    Sites,
    Statement,
    Update,
    text,
)
from contactbench.trace.program import ProgramTape, RecordedArrays, setup
from contactbench.trace.recording import Block, Recorded, attempt


class Sweep(Block):
    """What is computed at every site in the k-th sweep of an epoch of its parent."""

    def __init__(self, owner: Owner, k: int) -> None:
        super().__init__(owner)
        self.owner, self.order = owner, (owner.epoch, k)
        #: rows by the values that are stored there; names of sums by what is summed
        self.rows: dict[str, str] = {}
        self.sums: dict[str, str] = {}


class Owner(Block):
    """A block with sweeps: scalars, a sweep, scalars that need its sums, a sweep, …; an epoch ends with a loop."""

    def __init__(self, parent: Block) -> None:
        super().__init__(parent)
        self.epoch = 0
        self.levels: list[tuple[list[Statement], Sweep]] = []

    def level(self, k: int) -> tuple[list[Statement], Sweep]:
        while len(self.levels) <= k:
            self.levels.append(([], Sweep(self, len(self.levels))))
        return self.levels[k]

    def close(self, *statements: Statement | LoopOf) -> None:
        """End the epoch; the sweeps are written down when everything is recorded."""
        self.statements += [*self.levels, *statements]
        self.levels, self.epoch = [], self.epoch + 1


class Field(Recorded):
    """A number at every site: the value `name` of a sweep, or what is in a row."""

    __slots__ = ("row",)

    def __init__(
        self, tape: FieldTape, name: str, block: Block, row: str | None = None, kind: str = "f"
    ) -> None:
        super().__init__(tape, name, kind, block)
        self.row = row

    @property
    def owner(self) -> Owner:
        return self.block.owner if isinstance(self.block, Sweep) else self.block  # type: ignore[return-value]


class FieldTape(ProgramTape):
    def __init__(self) -> None:
        super().__init__()
        self.main: Owner = Owner(self.root)
        self.block = self.main
        #: at which level of which epoch of its owner a scalar is known
        self.known_at: dict[str, tuple[Owner, int, int]] = {}
        #: where each row is read: the owner of the sweep, its order, how many places off
        self.reads: dict[str, list[tuple[Owner, tuple[int, int], int]]] = {}
        #: known at every call: how often, once or never, to look at the start and at the end
        self.looks = [Recorded(self, f"look{k}", "i", self.whole) for k in range(2)]
        #: rows that a loop has taken over
        self.taken: set[str] = set()

    def row(self) -> str:
        name = self.name("row")
        self.reads[name] = []
        return name

    # -- scalars -----------------------------------------------------------------------------------
    def assign(self, value: Operation | Element, kind: str, block: Block) -> Recorded:
        if not isinstance(block, Owner):
            return super().assign(value, kind, block)
        key = (value.function, *map(text, value.operands)) if isinstance(value, Operation) else value
        if key not in block.known:
            block.known[key] = name = self.name(kind)
            operands = value.operands if isinstance(value, Operation) else (*value.indices, value.shift)
            k = max((self.level(x, block) for x in operands), default=0)
            block.level(k)[0].append(Assign(name, value))
            self.known_at[name] = block, block.epoch, k
        return Recorded(self, block.known[key], kind, block)

    def level(self, operand: Operand, owner: Owner) -> int:
        """The first level of an owner's epoch at which a scalar is known."""
        of, epoch, k = self.known_at.get(operand, (None, 0, 0)) if isinstance(operand, str) else (None, 0, 0)
        return k if of is owner and epoch == owner.epoch else 0

    # -- fields ------------------------------------------------------------------------------------
    def operation(self, function: str, kind: str, *operands: object) -> Recorded:
        if not any(isinstance(x, Field) for x in operands):
            return super().operation(function, kind, *operands)
        sweep = self.sweep(*((x, 0) for x in operands))
        names = tuple(self.at_site(x, sweep) for x in operands)
        made = self.assign(Operation(function, names), kind, sweep)
        return Field(self, made.name, sweep, kind=kind)

    def sweep(self, *reads: tuple[object, int]) -> Sweep:
        """The first sweep in which numbers are known, each at so many sites beyond the own one."""
        owners = [x.owner if isinstance(x, Field) else x.block for x, _ in reads if isinstance(x, Recorded)]
        owner = max((o for o in owners if isinstance(o, Owner)), key=lambda o: o.depth)
        k = 0
        for x, shift in reads:
            if isinstance(x, Field) and isinstance(x.block, Sweep) and x.owner is owner:
                epoch, at = x.block.order
                if epoch == owner.epoch:
                    k = max(k, at + (shift != 0))
            elif isinstance(x, Recorded) and not isinstance(x, Field):
                k = max(k, self.level(x.name, owner))
        return owner.level(k)[1]

    def at_site(self, x: object, sweep: Sweep, shift: int = 0) -> Any:
        """Return a number as an operand in a sweep."""
        if not isinstance(x, Field):
            return self.read(x, sweep)
        if x.block is sweep:
            return x.name
        row = self.read_row(x, sweep, shift)
        return super().assign(Element("fields", (row, "site"), shift), "f", sweep).name

    def read_row(self, x: Field, sweep: Sweep, shift: int) -> str:
        """Return the row of a field that is read in a sweep."""
        row = self.stored(x)
        if row in self.taken or not sweep.within(x.owner):
            raise CannotRecord("a state from before a loop, or from within it, is used after it")
        self.reads[row].append((sweep.owner, sweep.order, shift))
        return row

    def stored(self, x: Field) -> str:
        """Return the row of a field, which its sweep stores there from now on."""
        if x.row is not None:
            return x.row
        if x.kind == "b":
            raise CannotRecord("a truth value outlives its sweep")
        assert isinstance(x.block, Sweep)
        if x.name not in x.block.rows:
            x.block.rows[x.name] = self.row()
        return x.block.rows[x.name]

    def shift(self, x: Field, places: int) -> Field:
        """Return the value at the next site (places = 1) or the one before (−1)."""
        sweep = self.sweep((x, places))
        return Field(self, self.at_site(x, sweep, places), sweep)

    def pairs(
        self, function: Callable[..., Vector], x: Sequence[Arithmetic], weights: Sequence[Arithmetic]
    ) -> Vector:
        """Return Σ_{j ≠ i} function(x_i − x_j, w_i, w_j, …), as `numbers.sites.pairs` does."""
        sweep = self.sweep(*((part, 1) for c in (*x, *weights) for part in leaves(c)))
        loop = Block(sweep)

        def sides(c: Any) -> tuple[Arithmetic, Arithmetic]:
            if isinstance(c, Dual):
                (a, b), (da, db) = sides(c.a), sides(c.b)
                return Dual(a, da), Dual(b, db)
            other = Element("fields", (self.read_row(c, sweep, 1), "other"))
            mine = Recorded(self, str(self.at_site(c, sweep)), "f", sweep)
            return mine, super(FieldTape, self).assign(other, "f", loop)

        apart = [mine - other for mine, other in map(sides, x)]
        distance: Arithmetic = 0.0
        for c in apart:
            distance = value(c) * value(c) + distance
        same, xp = distance == 0, RecordedArrays(self)
        apart[0] = apart[0] + xp.where(same, 1.0, 0.0)
        found = function(tuple(apart), *(side for w in weights for side in sides(w)))
        made, sums = [], []
        for result in found:
            fields = []
            for part in leaves(result):
                name = self.name()
                sums.append((name, self.read(xp.where(same, 0.0, part), loop)))
                fields.append(Field(self, name, sweep))
            made.append(Dual(*fields) if isinstance(result, Dual) else fields[0])
        sweep.statements.append(Pairs(tuple(loop.statements), tuple(sums)))
        return tuple(made)

    def total(self, x: Field) -> Recorded:
        sweep = self.sweep((x, 0))
        name = self.at_site(x, sweep)
        if name not in sweep.sums:
            sweep.sums[name] = self.name()
            self.known_at[sweep.sums[name]] = sweep.owner, sweep.order[0], sweep.order[1] + 1
        return Recorded(self, sweep.sums[name], "f", sweep.owner)

    def repeat[X](self, n: Count, body: Callable[[X], X], x: X) -> X:
        outer: Any = self.block
        start = leaves(x)
        times = n if isinstance(n, Recorded) else self.size(("times", n), lambda: n)
        inner = Owner(outer)
        carried: list[Recorded] = []
        before: list[tuple[str, Operand]] = []
        for v in start:
            if isinstance(v, Field):
                row = self.row()
                before += exchange(row, self.stored(v))
                self.taken.add(self.stored(v))
                carried.append(Field(self, f"@{row}", inner, row))
            else:
                kind = "i" if isinstance(v, int) else getattr(v, "kind", "f")
                carried.append(Recorded(self, self.name(kind), kind, inner))
                before.append((carried[-1].name, self.read(v, outer, kind)))
        self.block = inner
        try:
            end = leaves(body(rebuild(x, carried)))
        finally:
            self.block = outer
        if len(end) != len(start):
            raise CannotRecord("a loop whose body returns a state of another shape")
        after: list[tuple[str, Operand]] = []
        moves: dict[str, str] = {}
        pairs = [*zip(carried, end, strict=True)]
        both = ((own.row, v.row) for own, v in pairs if isinstance(own, Field) and isinstance(v, Field))
        passed = {theirs for mine, theirs in both if theirs != mine}
        for own, v in pairs:
            if isinstance(own, Field):
                moves |= self.keep(own, v, inner, passed)
            else:
                after.append((own.name, self.read(v, inner, own.kind)))
        after += permutation(moves)
        inner.close(*updates(after))
        outer.close(*updates(before), LoopOf(self.read(times, outer, "i"), inner))

        def outside(v: Recorded) -> Recorded:
            if isinstance(v, Field):
                return Field(self, v.name, outer, v.row)
            return Recorded(self, v.name, v.kind, outer)

        return rebuild(x, list(map(outside, carried)))

    def keep(self, own: Field, v: object, inner: Owner, passed: set[str | None]) -> dict[str, str]:
        """Return which row the carried field of the next turn takes over; passed : rows that others take over."""
        assert own.row is not None
        self.taken.discard(own.row)
        if not isinstance(v, Field):
            raise CannotRecord("a field becomes a number")
        if v.owner is not inner:
            raise CannotRecord("a loop ends with a field from before it")
        if isinstance(v.block, Sweep) and v.name not in v.block.rows and own.row not in passed:
            order = v.block.order
            if not any(
                of is not inner or at > order or (shift and at == order)
                for of, at, shift in self.reads[own.row]
            ):
                v.block.rows[v.name] = own.row  # in place
                return {}
        return {own.row: self.stored(v)}


class LoopOf(NamedTuple):
    """A loop whose body is still being recorded."""

    times: Operand
    block: Owner


def updates(pairs: list[tuple[str, Operand]]) -> list[Update]:
    return [Update(tuple(name for name, _ in pairs), tuple(to for _, to in pairs))] if pairs else []


def permutation(moves: dict[str, str]) -> list[tuple[str, Operand]]:
    """Return the new rows of all names, of which some take over those of others: no two have one."""
    sources = [*dict.fromkeys(moves.values())]
    if len(sources) < len(moves):
        raise CannotRecord("a loop that ends with one field twice")
    new, free = (
        [name for name in names if name not in others]
        for names, others in ((sources, moves), (moves, sources))
    )
    pairs = [*moves.items(), *zip(new, free, strict=True)]
    return [(name, row) for name, row in pairs if name != row]


def exchange(a: str, b: str) -> list[tuple[str, Operand]]:
    return [] if a == b else [(a, b), (b, a)]


class FieldProgram(NamedTuple):
    """As `Program`; `run` gives the rows of all fields, the given first, and scalars; sums : of one sweep at most."""

    setup: Function
    run: Function
    data: np.ndarray
    shape: np.ndarray
    width: int
    rows: int
    sums: int


def sweeps(owner: Owner) -> list[Sweep]:
    found: list[Sweep] = []
    for item in owner.statements:
        if isinstance(item, LoopOf):
            found += sweeps(item.block)
        elif isinstance(item, tuple) and isinstance(item[-1], Sweep):
            found.append(item[-1])
    return found


def written(items: Sequence[Any]) -> list[Statement]:
    """Return the statements of an owner, with its sweeps and loops as they are now."""
    out: list[Statement] = []
    for item in items:
        match item:
            case LoopOf(times, block):
                out.append(Loop("_", times, tuple(written(block.statements))))
            case (list() as scalars, Sweep() as sweep):
                out += scalars
                if sweep.rows or sweep.sums:
                    stores = tuple((row, name) for name, row in sweep.rows.items())
                    sums = tuple((name, of) for of, name in sweep.sums.items())
                    out.append(Sites(tuple(sweep.statements), stores, sums))
            case _:
                out.append(item)
    return out


def record_fields(
    advance: Callable[..., list[Any]],
    numbers: int,
    fields: int,
    scalars: int,
    constants: int,
    seen: int = 0,
) -> FieldProgram:
    """The program of ``advance(numbers, h, n, fields, scalars, constants, xp, repeat) -> [*fields, *scalars, *seen]``.

    In `shape` follow the row of w, and whether to look at the start and at the end (`FieldTape.looks`).
    """
    tape = FieldTape()
    given, h, n = tape.given(numbers)
    rows = [tape.row() for _ in range(fields + constants)]
    held = [Field(tape, f"@{row}", tape.main, row) for row in rows]
    plain = [Recorded(tape, f"x{i}", "f", tape.main) for i in range(scalars)]
    loop = Repeat(tape.repeat, over_stages=True, joint_first=True)
    state = held[:fields], plain, held[fields:]
    end = attempt(lambda: advance(given, h, n, *state, RecordedArrays(tape), loop))
    if len(end) != fields + scalars + seen:
        raise CannotRecord("a step to a state of another shape")
    kept = [tape.stored(x) for x in end[:fields]]
    values = [tape.read(x, tape.main) for x in end[fields:]]
    tape.main.close()
    once = setup(tape)
    known = len(tape.shape)
    most = max((len(s.sums) for s in sweeps(tape.main)), default=0)
    head = *tape.whole.statements, Assign("u", Element("shape", (known,), kind="i")), *tape.loads
    head += (
        *(
            Assign(look.name, Element("shape", (known + k,), kind="i"))
            for k, look in enumerate(tape.looks, 1)
        ),
    )
    first = Update(tuple(tape.reads), tuple(range(len(tape.reads))))
    body = *head, first, *written(tape.main.statements)
    run = Function("run", (), body, (tuple(kept), tuple(values)))
    return FieldProgram(once, run, *tape.constants, len(tape.reads), most)
