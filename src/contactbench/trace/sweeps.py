"""Sweeps over the sites of a lattice as LLVM instructions: vectors of sites, chunks, threads that meet.

The fields are rows of one array, with `PAD` places beyond either end for the neighbours there.  A sweep runs over
chunks of sites, which threads share; after it they wait for one another.  Sums are taken chunk by chunk, so that their
round-off is that of pairs, and the same whatever the number of threads.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from contactbench.trace import compiled as llvm
from contactbench.trace import form
from contactbench.trace.compiled import compile_c
from contactbench.trace.form import Pairs, Sites, Statement, digest

if TYPE_CHECKING:
    from llvmlite.ir import IRBuilder, Type, Value

#: places beyond either end of a row: a cache line, so that rows begin at one
PAD = 8
#: sites of a chunk, and how many are computed at a time
CHUNK, LANES = 2048, 8
#: looks at a word, of about a nanosecond each, after which a thread that waits for the leader lets others run
PATIENCE = 2000
#: looks, and more for every site of its part, after which the leader leaves a thread out
LATE, LATE_PER_SITE = 50_000, 4
#: words of `sync`: sweeps done by all, whether to stop; then a cache line for every other thread, whose first word is
#: twice the sweeps it has done, 1 more while it does one, or `OUT`
DONE, STOP, LINE, OUT = 0, 1, 8, -1

#: doubles of a page, and by how many two rows are apart in it at least: a load waits for a store just before that seems
#: to go to the same place in it
PAGE, APART = 512, 40

#: places in `data` from `FIRST` on, after what every C function has there: the addresses of arrays, and whole numbers
FIRST, ADDRESSES, WHOLE = 3, ("w", "shape", "fields", "sums", "sync"), ("sites", "stride", "rank", "threads")


def stride_of(sites: int) -> int:
    """Return how far the beginnings of two rows are apart: whole cache lines, and no whole pages."""
    length = LANES * -(-sites // LANES) + 2 * PAD
    return length + max(0, 2 * APART - (length + APART) % PAGE)


class Packing(NamedTuple):
    """How packed states become fields: components of a site, whether s comes last, 2 with a tangent after the state."""

    dimensions: int
    with_s: bool
    blocks: int = 1


class SweepLowering(llvm.Lowering):
    """The instructions of a function with sweeps, between packed states y and out."""

    def __init__(
        self,
        builder: IRBuilder,
        given: Sequence[Value],
        boundary: str,
        sums: int,
        width: int,
        packing: Packing,
    ) -> None:
        super().__init__(builder, {}, {}, True, LANES)
        self.boundary, self.packing, b, whole = boundary, packing, builder, self.whole
        self.vector, self.lanes, self.wide = self.wide, 1, self.double
        self.out, self.y, self.data = given
        addresses, numbers = ([self.entry(name) for name in names] for names in (ADDRESSES, WHOLE))
        self.sites, stride, rank, self.threads = numbers
        self.chunks = b.sdiv(b.add(self.sites, whole(CHUNK - 1)), whole(CHUNK))
        rows = {"w": whole(width), "fields": stride, "sums": self.chunks}
        self.rank, self.leader = rank, b.icmp_signed("==", rank, whole(0))
        for name, address in zip(ADDRESSES, addresses, strict=True):
            kind = whole if name in ("shape", "sync") else self.double
            pointer = b.inttoptr(address, kind.as_pointer())
            self.arrays[name] = llvm.Array(pointer, None, rows.get(name))
        #: sweeps so far, whether this thread is out or to stop, and whether it does a part
        self.count, self.over, self.takes = self.slot(whole), self.slot(self.truth), self.slot(self.truth)
        b.store(whole(0), self.count)
        b.store(self.truth(0), self.over)
        self.totals = [self.slot(self.double) for _ in range(sums)]
        self.partial = {kind: [self.slot(kind) for _ in range(sums)] for kind in (self.vector, self.double)}
        #: where the rows of a sweep begin, the site and the other one
        self.rows: dict[str, Value] = {}
        self.site: Value | None = None

    def entry(self, name: str) -> Value:
        b, place = self.builder, self.whole(FIRST + (*ADDRESSES, *WHOLE).index(name))
        return b.load(b.bitcast(b.gep(self.data, [place]), self.whole.as_pointer()))

    def slot(self, kind: Type) -> Value:
        with self.builder.goto_entry_block():
            return self.builder.alloca(kind)

    def lower(self, function: form.Function) -> None:
        b, (d, with_s, blocks) = self.builder, self.packing
        fields = range(2 * d * blocks)
        last = [b.sub(b.mul(self.length, self.whole(k + 1)), self.whole(1)) for k in range(blocks * with_s)]
        with self.part() as (begin, end):
            for j in fields:
                self.rows = {"row": self.row(self.whole(j))}
                self.copy(self.y, j, self.sites_of(begin, end), True)
                self.ends(Sites((), (("row", 0.0),), ()), *self.sites_of(begin, end))
        for i, place in enumerate(last):
            self.values[f"x{i}"] = b.load(b.gep(self.y, [place]))
        self.run(function.body)
        rows, scalars = function.result
        with self.part() as (begin, end):
            for j, row in zip(fields, rows, strict=True):
                self.rows = {"row": self.row(self.value(row))}
                self.copy(self.out, j, self.sites_of(begin, end), False)
        with b.if_then(self.leader):
            size = b.mul(self.length, self.whole(blocks))
            last += [b.add(size, self.whole(k)) for k in range(len(scalars) - len(last))]
            for place, value in zip(last, scalars, strict=True):
                b.store(self.floating(self.value(value)), b.gep(self.out, [place]))
            b.store(b.fadd(b.load(self.data), self.double(1.0)), self.data)

    @property
    def length(self) -> Value:
        d, with_s, _ = self.packing
        return self.builder.add(self.builder.mul(self.sites, self.whole(2 * d)), self.whole(int(with_s)))

    def copy(self, packed: Value, j: int, sites: tuple[Value, Value], inwards: bool) -> None:
        b, whole, d = self.builder, self.whole, self.packing.dimensions
        block, half, component = j // (2 * d), j // d % 2, j % d
        first = b.add(b.mul(self.length, whole(block)), b.mul(self.sites, whole(half * d)))
        with self.counted(*sites) as site:
            place = b.gep(packed, [b.add(first, b.add(b.mul(site, whole(d)), whole(component)))])
            cell = b.gep(self.rows["row"], [b.add(site, whole(PAD))])
            source, target = (place, cell) if inwards else (cell, place)
            b.store(b.load(source), target)

    def row(self, number: Value) -> Value:
        fields = self.arrays["fields"]
        return self.builder.gep(fields.first, [self.builder.mul(number, fields.row)], inbounds=True)

    def sites_of(self, first: Value, last: Value) -> Value:
        """The sites from a chunk to before another one."""
        b = self.builder
        begin, end = (b.mul(chunk, self.whole(CHUNK)) for chunk in (first, last))
        return begin, b.select(b.icmp_signed("<", end, self.sites), end, self.sites)

    def run(self, body: Sequence[Statement]) -> None:
        for statement in body:
            if isinstance(statement, Sites):
                self.sweep(statement)
            elif isinstance(statement, Pairs):
                self.over_others(statement)
            elif isinstance(statement, form.Loop) and self.site is None:
                times, over = self.value(statement.times), partial(self.builder.load, self.over)
                with self.counted(self.whole(0), times, over) as self.values[statement.counter]:
                    self.run(statement.body)
            else:
                super().run((statement,))

    def place(self, element: form.Element) -> Value:
        if element.array != "fields":
            return super().place(element)
        b, (row, where) = self.builder, element.indices
        site = self.site if where == "site" else self.values["other"]
        offset = b.add(site, self.whole(PAD + int(element.shift)))
        pointer = b.gep(self.rows[str(row)], [offset], inbounds=True)
        return b.bitcast(pointer, self.wide.as_pointer()) if where == "site" else pointer

    # -- sweeps ------------------------------------------------------------------------------------
    def sweep(self, sites: Sites) -> None:
        b, whole = self.builder, self.whole
        self.rows = {row: self.row(self.value(row)) for row in sorted(rows_of(sites))}
        sums = range(len(sites.sums))
        parity = b.and_(b.load(self.count), whole(1))
        with self.part() as part, self.counted(*part) as chunk:
            begin, end = self.sites_of(chunk, b.add(chunk, whole(1)))
            for kind, slots in self.partial.items():
                for i in sums:
                    b.store(self.ir.Constant(kind, None), slots[i])
            vectors = b.sdiv(b.sub(end, begin), whole(LANES))
            self.lanes, self.wide = LANES, self.vector
            with self.counted(whole(0), vectors) as turn:
                self.site = b.add(begin, b.mul(turn, whole(LANES)))
                self.at_site(sites)
            self.lanes, self.wide = 1, self.double
            with self.counted(b.add(begin, b.mul(vectors, whole(LANES))), end) as self.site:
                self.at_site(sites)
            self.site = None
            for i in sums:
                total, vector = b.load(self.partial[self.double][i]), b.load(self.partial[self.vector][i])
                for lane in range(LANES):
                    total = b.fadd(total, b.extract_element(vector, self.ir.IntType(32)(lane)))
                b.store(total, self.chunk_sum(parity, i, chunk))
            self.ends(sites, begin, end)
        for i in sums:
            b.store(self.double(0.0), self.totals[i])
            with self.counted(whole(0), self.chunks) as chunk:
                total = b.load(self.totals[i])
                b.store(b.fadd(total, b.load(self.chunk_sum(parity, i, chunk))), self.totals[i])
            self.values[sites.sums[i][0]] = b.load(self.totals[i])

    def at_site(self, sites: Sites) -> None:
        b = self.builder
        self.run(sites.body)
        for row, value in sites.stores:
            stored = self.spread(self.value(value))
            b.store(stored, self.place(form.Element("fields", (row, "site"))), align=8)
        for slot, (_, value) in zip(self.partial[self.wide], sites.sums, strict=False):
            b.store(b.fadd(b.load(slot), self.spread(self.value(value))), slot)

    def chunk_sum(self, parity: Value, i: int, chunk: Value) -> Value:
        """Where it is: what one sweep leaves is read while the next one writes, and no longer."""
        b, sums = self.builder, self.arrays["sums"]
        row = b.add(b.mul(parity, self.whole(len(self.totals))), self.whole(i))
        return b.gep(sums.first, [b.add(b.mul(row, sums.row), chunk)])

    def ends(self, sites: Sites, begin: Value, end: Value) -> None:
        """The places beyond the ends of what is stored; those of a fixed chain stay zero."""
        b, whole = self.builder, self.whole
        if self.boundary == "fixed":
            return
        low, high = whole(PAD), b.add(self.sites, whole(PAD - 1))
        before, after = whole(PAD - 1), b.add(self.sites, whole(PAD))
        targets = (after, before) if self.boundary == "ring" else (before, after)
        conditions = b.icmp_signed("==", begin, whole(0)), b.icmp_signed("==", end, self.sites)
        for condition, own, target in zip(conditions, (low, high), targets, strict=True):
            with b.if_then(condition):
                for row, _ in sites.stores:
                    b.store(b.load(b.gep(self.rows[str(row)], [own])), b.gep(self.rows[str(row)], [target]))

    def over_others(self, pairs: Pairs) -> None:
        b = self.builder
        slots = [self.slot(self.wide) for _ in pairs.sums]
        for slot in slots:
            b.store(self.ir.Constant(self.wide, None), slot)
        with self.counted(self.whole(0), self.sites) as self.values["other"]:
            self.run(pairs.body)
            for slot, (_, value) in zip(slots, pairs.sums, strict=True):
                b.store(b.fadd(b.load(slot), self.spread(self.value(value))), slot)
        for slot, (name, _) in zip(slots, pairs.sums, strict=True):
            self.values[name] = b.load(slot)

    # -- threads -----------------------------------------------------------------------------------
    @contextmanager
    def part(self) -> Iterator[tuple[Value, Value]]:
        """Each part of the chunks, the first and before which one, that this thread is to do; then all is done."""
        b, one = self.builder, self.whole(1)
        shared = b.icmp_signed(">", self.threads, one)
        count = b.load(self.count)
        with b.if_then(b.icmp_signed("!=", b.load_atomic(self.word(STOP), "monotonic", 8), self.whole(0))):
            b.store(self.truth(1), self.over)
        last = b.select(self.leader, self.threads, b.add(self.rank, one))
        with self.counted(self.rank, last) as rank:
            b.store(b.not_(b.load(self.over)), self.takes)
            with b.if_then(b.and_(shared, b.load(self.takes))), b.if_else(self.leader) as (leads, follows):
                with leads, b.if_then(b.icmp_signed(">", rank, self.whole(0))):
                    self.wait_for(rank, count)
                with follows:
                    self.begin(count)
            with b.if_then(b.load(self.takes)):
                place = rank, b.add(rank, one)
                yield tuple(b.sdiv(b.mul(self.chunks, each), self.threads) for each in place)  # type: ignore[misc]
        done = b.add(count, one)
        b.store(done, self.count)
        with b.if_then(shared), b.if_else(self.leader) as (leads, follows):
            with leads:
                b.store_atomic(done, self.word(DONE), "release", 8)
            with follows, b.if_then(b.not_(b.load(self.over))):
                b.store_atomic(b.mul(done, self.whole(2)), self.state(self.rank), "release", 8)
                self.wait_until(done)

    def word(self, place: int) -> Value:
        return self.builder.gep(self.arrays["sync"].first, [self.whole(place)])

    def state(self, rank: Value) -> Value:
        return self.builder.gep(self.arrays["sync"].first, [self.builder.mul(rank, self.whole(LINE))])

    def begin(self, count: Value) -> None:
        """Begin a part, unless this thread was left out."""
        b, ready = self.builder, self.builder.mul(count, self.whole(2))
        changed = b.cmpxchg(self.state(self.rank), ready, b.add(ready, self.whole(1)), "acq_rel", "acquire")
        mine = b.extract_value(changed, 1)
        b.store(mine, self.takes)
        b.store(b.not_(mine), self.over)

    def wait_until(self, done: Value) -> None:
        """Wait until the leader says that a sweep is done, or leaves this thread out, which `begin` sees."""
        b, state, out = self.builder, self.state(self.rank), self.whole(OUT)

        def there() -> Value:
            reached = b.icmp_signed(">=", b.load_atomic(self.word(DONE), "acquire", 8), done)
            return b.or_(reached, b.icmp_signed("==", b.load_atomic(state, "monotonic", 8), out))

        self.wait(there, lambda count: b.icmp_signed(">", count, self.whole(PATIENCE)))

    def wait_for(self, rank: Value, count: Value) -> None:
        """Wait until another thread has done its part; leave it out if it is late, and take a part not begun."""
        b, whole, state = self.builder, self.whole, self.state(rank)
        ready, out = b.mul(count, whole(2)), whole(OUT)
        done = b.add(ready, whole(2))
        late = b.add(whole(LATE), b.sdiv(b.mul(self.sites, whole(LATE_PER_SITE)), self.threads))

        def there() -> Value:
            now = b.load_atomic(state, "acquire", 8)
            return b.or_(b.icmp_signed("==", now, done), b.icmp_signed("==", now, out))

        def too_late(looks: Value) -> Value:
            tardy = b.icmp_signed(">", looks, late)
            with b.if_then(tardy, likely=False):
                b.cmpxchg(state, ready, out, "acq_rel", "acquire")
            return tardy

        looks = self.wait(there, too_late)
        b.store(b.icmp_signed("==", b.load_atomic(state, "acquire", 8), out), self.takes)
        with b.if_then(b.icmp_signed(">", b.load(looks), late), likely=False):
            b.store_atomic(out, state, "release", 8)

    def wait(self, there: Callable[[], Value], yields: Callable[[Value], Value]) -> Value:
        """Look until it is there, and let others run where the number of looks says so; return that number's slot."""
        b, whole, looks = self.builder, self.whole, self.slot(self.whole)
        b.store(whole(0), looks)
        look, again, after = (b.append_basic_block(name) for name in ("look", "again", "after"))
        b.branch(look)
        b.position_at_end(look)
        b.cbranch(there(), after, again)
        b.position_at_end(again)
        count = b.add(b.load(looks), whole(1))
        b.store(count, looks)
        with b.if_then(yields(count), likely=False):
            signature = self.ir.FunctionType(self.ir.IntType(32), [])
            b.call(self.external("sched_yield", signature), [])
        b.branch(look)
        b.position_at_end(after)
        return looks


def rows_of(sites: Sites) -> set[str]:
    body = [s for statement in sites.body for s in getattr(statement, "body", (statement,))]
    values = (s.value for s in body if isinstance(s, form.Assign))
    read = {str(v.indices[0]) for v in values if isinstance(v, form.Element) and v.array == "fields"}
    return read | {str(row) for row, _ in sites.stores}


@cache
def compile_sweeps(function: form.Function, boundary: str, sums: int, width: int, packing: Packing) -> int:
    """Return the address of a C function ``(out, t, y, data)`` of packed states; may raise `CannotRecord`."""

    def instructions(builder: IRBuilder, given: Sequence[Value]) -> None:
        out, _, y, data = given
        SweepLowering(builder, (out, y, data), boundary, sums, width, packing).lower(function)

    own = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()
    return compile_c(digest(own, function.digest, boundary, sums, width, packing), instructions)
