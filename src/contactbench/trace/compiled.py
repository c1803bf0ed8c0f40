"""Recorded functions compiled by LLVM.

Recorded programs are long, and numba would spend a second and more on finding out the types of every line of one.
Here the types follow from floating-point constants, whole constants and comparisons, and a program becomes a module
of the LLVM that numba brings, at once.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from contactbench.numbers.protocol import CannotRecord
from contactbench.trace import form
from contactbench.trace.form import Statement
from contactbench.trace.kept import kept_file, read_kept, write_kept
from contactbench.trace.native_call import DOUBLE, WORDS, Native

if TYPE_CHECKING:
    from llvmlite.ir import IRBuilder, Value

#: writes the instructions of a function, given its arguments, and returns its result
type Instructions = Callable[[IRBuilder, Sequence[Value]], Value | None]

#: whether numba is allowed to
COMPILES = os.environ.get("NUMBA_DISABLE_JIT", "0").strip() in ("", "0")
#: arrays of a program that are not one-dimensional arrays of doubles
KINDS = {**dict.fromkeys(("spans", "w", "times"), (DOUBLE, 2)), "shape": (np.dtype(np.int64), 1)}
#: functions of LLVM and its names for them; the C library has the others
INTRINSICS = {
    "abs": "fabs",
    **{name: name for name in ("sqrt", "floor", "ceil", "pow", "exp", "log", "log2", "log10", "sin", "cos")},
}
ARITHMETIC = ("add", "sub", "mul", "div")
COMPARISONS = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}
#: entries of a row that one instruction adds: longer vectors slow down scalar arithmetic on some processors; entries
#: that are added at once, few enough for the registers of every processor
VECTOR, WIDE = 4, 32
#: products and sums may be fused
CONTRACT = ("contract",)


class Array(NamedTuple):
    """A contiguous array: its address, and if known its length and the length of a row."""

    first: Value
    length: Value | None = None
    row: Value | None = None


class Lowering:
    """The instructions of one function, with variables on the stack; fused : products and sums may be one operation."""

    def __init__(
        self, builder: IRBuilder, arrays: dict[str, Array], numbers: dict[str, Value], fused: bool
    ) -> None:
        from llvmlite import ir

        self.ir, self.builder, self.arrays, self.values = ir, builder, arrays, dict(numbers)
        self.flags = CONTRACT if fused else ()
        self.double, self.whole, self.truth = ir.DoubleType(), ir.IntType(64), ir.IntType(1)
        self.variables: dict[str, Value] = {}

    def lower(self, function: form.Function) -> Value:
        self.run(function.body)
        return self.value(function.result)

    # -- statements --------------------------------------------------------------------------------
    def run(self, body: Sequence[Statement]) -> None:
        for statement in body:
            match statement:
                case form.Assign(target, form.Element() as element):
                    self.values[target] = self.load(element)
                case form.Assign(target, form.Operation(function, operands)):
                    self.values[target] = self.operation(function, operands)
                case form.Store(element, value):
                    self.store(element, self.value(value))
                case form.Update(variables, values):
                    for name, value in zip(variables, list(map(self.value, values)), strict=True):
                        self.update(name, value)
                case form.Allocate(array, size):
                    with self.builder.goto_entry_block():
                        self.arrays[array] = Array(self.builder.alloca(self.double, size))
                case form.Combine():
                    self.combine(statement)
                case form.Loop(counter, times, inner):
                    with self.counted(self.value(times)) as self.values[counter]:
                        self.run(inner)
                case form.While():
                    self.repeat(statement)

    @contextmanager
    def counted(self, times: Value) -> Iterator[Value]:
        """Repeat the instructions of a block for 0, 1, …, times − 1."""
        builder, entry = self.builder, self.builder.block
        test, body, after = (builder.append_basic_block(name) for name in ("test", "body", "after"))
        builder.branch(test)
        builder.position_at_end(test)
        index = builder.phi(self.whole)
        index.add_incoming(self.whole(0), entry)
        builder.cbranch(builder.icmp_signed("<", index, times), body, after)
        builder.position_at_end(body)
        yield index
        index.add_incoming(builder.add(index, self.whole(1)), builder.block)
        builder.branch(test)
        builder.position_at_end(after)

    def combine(self, sum_: form.Combine) -> None:
        """Add rows, `WIDE` entries at a time, which stay in registers from the first row to the last."""
        builder, ir, weights = self.builder, self.ir, self.place(sum_.weights)
        rows, into = self.arrays[sum_.rows].first, self.arrays[sum_.into].first

        def part(array: Value, at: Value, kind: Any) -> Value:
            return builder.bitcast(builder.gep(array, [at], inbounds=True), kind.as_pointer())

        for begin in range(0, sum_.width, WIDE):
            parts = range(begin, min(begin + WIDE, sum_.width), VECTOR)
            kinds = [ir.VectorType(self.double, min(VECTOR, sum_.width - first)) for first in parts]
            with builder.goto_entry_block():
                totals = [builder.alloca(kind) for kind in kinds]
            pieces = list(zip(parts, kinds, totals, strict=True))
            for _, kind, total in pieces:
                builder.store(kind(None), total)

            def add(j: Value, pieces: Any = pieces) -> None:
                weight = builder.load(builder.gep(weights, [j], inbounds=True), align=8)
                start = builder.mul(j, self.whole(sum_.width))
                for first, kind, total in pieces:
                    row = builder.load(part(rows, builder.add(start, self.whole(first)), kind), align=8)
                    all_ = kind(ir.Undefined)
                    for k in range(kind.count):
                        all_ = builder.insert_element(all_, weight, ir.IntType(32)(k))
                    term = builder.fmul(all_, row, flags=self.flags)
                    builder.store(builder.fadd(builder.load(total), term, flags=self.flags), total)

            with self.counted(builder.sub(self.value(sum_.terms), self.whole(sum_.late))) as j:
                add(builder.add(j, self.whole(sum_.late)))
            for j in range(sum_.late):
                add(self.whole(j))
            for first, kind, total in pieces:
                builder.store(builder.load(total), part(into, self.whole(first), kind), align=8)

    def update(self, name: str, value: Value) -> None:
        if name not in self.variables:
            with self.builder.goto_entry_block():
                self.variables[name] = self.builder.alloca(value.type)
        slot = self.variables[name]
        self.builder.store(self.floating(value) if slot.type.pointee == self.double else value, slot)

    def repeat(self, loop: form.While) -> None:
        test, body, after = (self.builder.append_basic_block(name) for name in ("test", "body", "after"))
        self.builder.branch(test)
        self.builder.position_at_end(test)
        self.run(loop.test)
        self.builder.cbranch(self.value(loop.condition), body, after)
        self.builder.position_at_end(body)
        self.run(loop.body)
        self.builder.branch(test)
        self.builder.position_at_end(after)

    # -- elements of arrays ------------------------------------------------------------------------
    def place(self, element: form.Element) -> Value:
        array, add, mul = self.arrays[element.array], self.builder.add, self.builder.mul
        *rows, last = map(self.value, element.indices)
        offset = last if element.shift == 0 else add(last, self.value(element.shift))
        if rows:
            offset = add(mul(rows[0], array.row), offset)
        return self.builder.gep(array.first, [offset], inbounds=True)

    def load(self, element: form.Element) -> Value:
        if element.kind == "stop":
            return self.builder.load_atomic(self.place(element), "monotonic", align=8)
        value = self.builder.load(self.place(element), align=8)
        if element.kind == "b":
            return self.builder.fcmp_unordered("!=", value, self.double(0.0))
        whole = element.kind == "i" and value.type == self.double
        return self.builder.fptosi(value, self.whole) if whole else value

    def store(self, element: form.Element, value: Value) -> None:
        if element.kind == "b":
            value = self.builder.select(value, self.double(1.0), self.double(0.0))
        self.builder.store(self.floating(value), self.place(element), align=8)

    # -- operations --------------------------------------------------------------------------------
    def value(self, operand: form.Operand) -> Value:
        if operand in self.variables:
            return self.builder.load(self.variables[operand])
        if isinstance(operand, str):
            return self.values[operand]
        kind = {bool: self.truth, int: self.whole, float: self.double}[type(operand)]
        return self.ir.Constant(kind, operand)

    def floating(self, value: Value) -> Value:
        return self.builder.sitofp(value, self.double) if value.type == self.whole else value

    def operation(self, function: str, operands: Sequence[form.Operand]) -> Value:
        if function == "len":
            return self.arrays[str(operands[0])].length
        x = [self.value(operand) for operand in operands]
        whole = all(value.type == self.whole for value in x)
        if function == "where":
            return self.choose(*x)
        if function in ("and", "or", "not"):
            return getattr(self.builder, f"{function}_")(*x)
        if function in COMPARISONS:
            sign = COMPARISONS[function]
            if whole:
                return self.builder.icmp_signed(sign, *x)
            compare = self.builder.fcmp_unordered if sign == "!=" else self.builder.fcmp_ordered
            return compare(sign, *map(self.floating, x))
        if function == "neg":
            return self.builder.neg(*x) if whole else self.builder.fneg(*x, flags=self.flags)
        if function in ARITHMETIC:
            if whole and function != "div":
                return getattr(self.builder, function)(*x)
            return getattr(self.builder, f"f{function}")(*map(self.floating, x), flags=self.flags)
        return self.call(function, *map(self.floating, x))

    def choose(self, condition: Value, a: Value, b: Value) -> Value:
        if not a.type == b.type == self.whole:
            a, b = self.floating(a), self.floating(b)
        return self.builder.select(condition, a, b)

    def call(self, name: str, *x: Value) -> Value:
        """Call a function of the C library's or of LLVM's, which is declared once in a module."""
        name = f"llvm.{INTRINSICS[name]}.f64" if name in INTRINSICS else name
        known = self.builder.module.globals.get(name)
        signature = self.ir.FunctionType(self.double, [self.double] * len(x))
        return self.builder.call(known or self.ir.Function(self.builder.module, signature, name), x)


# -- by LLVM -----------------------------------------------------------------------------------------
class Machine:
    """LLVM for the processor of this machine, with the programs compiled in this process."""

    def __init__(self) -> None:
        from llvmlite import __version__, binding

        binding.initialize_native_target()
        binding.initialize_native_asmprinter()
        processor, features = binding.get_host_cpu_name(), ""
        with suppress(RuntimeError):  # not known on every platform
            features = binding.get_host_cpu_features().flatten()
        self.triple = binding.get_process_triple()
        target = binding.Target.from_triple(self.triple)
        self.target = target.create_target_machine(cpu=processor, features=features, opt=3, jit=True)
        self.engine = binding.create_mcjit_compiler(binding.parse_assembly(""), self.target)
        self.key = form.digest(self.triple, processor, features, binding.llvm_version_info, __version__)
        self.alone = Lock()
        #: functions compiled in this process, which were not kept
        self.compiled = 0

    def address(self, key: str, result: str, kinds: Sequence[str], instructions: Instructions) -> int:
        """Return the address of a function, kept or compiled; kinds : "double", "i64", "doubles", "i64s", "void"."""
        from llvmlite.binding import ObjectFileRef

        name = f"program_{form.digest(key, self.key)}"
        path = kept_file(f"{name}.object")
        with self.alone:
            if (address := self.engine.get_function_address(name)) == 0:
                code = read_kept(path)
                if code is None:
                    code = self.compile(name, result, kinds, instructions)
                    write_kept(path, code)
                self.engine.add_object_file(ObjectFileRef.from_data(code))
                self.engine.finalize_object()
                address = self.engine.get_function_address(name)
        return int(address)

    def compile(self, name: str, result: str, kinds: Sequence[str], instructions: Instructions) -> bytes:
        from llvmlite import binding, ir

        double, whole = ir.DoubleType(), ir.IntType(64)
        types = {"double": double, "i64": whole, "doubles": double.as_pointer(), "i64s": whole.as_pointer()}
        types["void"] = ir.VoidType()
        module = ir.Module(name)
        module.triple, module.data_layout = self.triple, str(self.target.target_data)
        made = ir.Function(module, ir.FunctionType(types[result], [types[kind] for kind in kinds]), name)
        builder = ir.IRBuilder(made.append_basic_block("entry"))
        value = instructions(builder, made.args)
        builder.ret_void() if value is None else builder.ret(value)
        parsed = binding.parse_assembly(str(module))
        options = binding.create_pipeline_tuning_options(speed_level=3)
        options.loop_vectorization = True
        builder_of_passes = binding.create_pass_builder(self.target, options)
        builder_of_passes.getModulePassManager().run(parsed, builder_of_passes)
        self.compiled += 1
        return bytes(self.target.emit_object(parsed))


#: held while LLVM is set up: with `cache` alone, two threads could do that at once
MAKING = Lock()


def machine() -> Machine:
    with MAKING:
        return only_machine()


@cache
def only_machine() -> Machine:
    if not COMPILES:
        raise CannotRecord("NUMBA_DISABLE_JIT is set: nothing is compiled")
    return Machine()


@cache
def back_end() -> str:
    """Return the digest of this module, on which every compiled program depends."""
    return hashlib.sha256(Path(__file__).read_bytes()).hexdigest()


def compile_recorded_c(function: form.Function) -> int:
    """Return the address of a recorded function as ``void (double *out, double t, double *y, double *data)``."""

    def instructions(builder: IRBuilder, given: Sequence[Value]) -> None:
        named = dict(zip(function.arguments, given, strict=True))
        numbers = {"t": named.pop("t")}
        arrays = {name: Array(value) for name, value in named.items()}
        Lowering(builder, arrays, numbers, True).lower(function)

    kinds = ("doubles", "double", "doubles", "doubles")
    return machine().address(form.digest(back_end(), function.digest, kinds), "void", kinds, instructions)


@cache
def compile_function(function: form.Function, fused: bool = True) -> Native:
    """Return the function, compiled for the arrays that its arguments name; fused : as of `Lowering`."""
    kinds = tuple(KINDS.get(name, (DOUBLE, 1)) for name in function.arguments)

    def instructions(builder: IRBuilder, given: Sequence[Value]) -> Value:
        lowering = Lowering(builder, {}, {}, fused)
        for k, (name, (kind, _)) in enumerate(zip(function.arguments, kinds, strict=True)):
            places = [builder.gep(given[0], [lowering.whole(WORDS * k + i)]) for i in range(WORDS)]
            first, *shape = (builder.load(place, align=8) for place in places)
            pointer = (lowering.double if kind == DOUBLE else lowering.whole).as_pointer()
            lowering.arrays[name] = Array(builder.inttoptr(first, pointer), *shape)
        return lowering.lower(function)

    key = form.digest(back_end(), function.digest, fused, WORDS)
    return Native(machine().address(key, "i64", ("i64s",), instructions), kinds)
