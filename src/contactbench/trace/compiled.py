"""Recorded functions compiled by LLVM inside a function of numba's, and kept: once, not once per process.

Recorded programs are long, and numba would spend a second and more on finding out the types of every line of one.
Here the types follow from floating-point constants, whole constants and comparisons, and the whole program is one
intrinsic function to numba, which does all the rest: arguments, optimisation, its cache.  It is imported when the
first program is compiled.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

from contactbench.files import replacing
from contactbench.numbers.protocol import CannotRecord
from contactbench.trace import form
from contactbench.trace.form import Statement

if TYPE_CHECKING:
    from llvmlite.ir import IRBuilder, Value
    from numba.core.base import BaseContext
    from numba.core.codegen import CPUCodegen
    from numba.core.cpu import CPUContext
    from numba.core.types import Type
    from numba.core.typing import Context, Signature

#: a function that numba makes or compiles
Compiled = Callable[..., Any]

#: folder for compiled programs; by default the user's cache folder
VARIABLE = "CONTACTBENCH_CACHE"
#: whether numba is allowed to
COMPILES = os.environ.get("NUMBA_DISABLE_JIT", "0").strip() in ("", "0")
#: the arrays a program works on: how many dimensions, and of whole numbers
DIMENSIONS = {"spans": 2, "w": 2, "y": 2, "starts": 2, "ends": 3}
WHOLE = ("shape", "part")
#: functions LLVM knows, and its names for them; all others are the C library's
INTRINSICS = {
    "abs": "fabs",
    **{name: name for name in ("sqrt", "floor", "ceil", "pow", "exp", "log", "log2", "log10", "sin", "cos")},
}
#: bytes of a digest
DIGEST = hashlib.sha256().digest_size
ARITHMETIC = ("add", "sub", "mul", "div")
COMPARISONS = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!="}
#: products and sums may be fused
CONTRACT = ("contract",)
#: arrays whose last index is that of a state in a tile
TILED = ("starts", "ends")


class Array(NamedTuple):
    """A contiguous array: where it begins, its length, and the length of a row of it (None in one dimension)."""

    first: Value
    length: Value
    row: Value | None = None


class Lowering:
    """The instructions of one function.

    Variables live on the stack, from where LLVM takes them into registers.
    lanes : how many states it runs on at a time, with a vector of LLVM's for every number of the state.  They are
    the columns of starts (d, n) and ends (k, d, n), n a multiple of `lanes`; part : the first tile and the last.
    """

    def __init__(
        self, builder: IRBuilder, arrays: dict[str, Array], numbers: dict[str, Value], fused: bool, lanes: int
    ) -> None:
        from llvmlite import ir

        self.ir, self.builder, self.arrays, self.values = ir, builder, arrays, dict(numbers)
        self.flags, self.lanes = CONTRACT if fused else (), lanes
        self.double, self.whole, self.truth = ir.DoubleType(), ir.IntType(64), ir.IntType(1)
        self.wide = ir.VectorType(self.double, lanes) if lanes > 1 else self.double
        self.variables: dict[str, Value] = {}
        #: the first state of the tile
        self.first: Value | None = None

    def lower(self, function: form.Function) -> Value:
        from numba.core.cgutils import for_range

        if self.lanes == 1:
            self.run(function.body)
            return self.value(function.result)
        begin, end = (self.load(form.Element("part", (i,))) for i in (0, 1))
        with for_range(self.builder, end, begin) as turn:
            self.first = self.builder.mul(turn.index, self.whole(self.lanes))
            self.run(function.body)
        return self.whole(0)

    # -- statements --------------------------------------------------------------------------------
    def run(self, body: Sequence[Statement]) -> None:
        from numba.core.cgutils import for_range

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
                case form.Loop(counter, times, inner):
                    with for_range(self.builder, self.value(times)) as turn:
                        self.values[counter] = turn.index
                        self.run(inner)
                case form.While():
                    self.repeat(statement)

    def update(self, name: str, value: Value) -> None:
        if value.type == self.double:
            value = self.spread(value)  # the state may be wide from the second turn of a loop on
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
        more = self.value(loop.condition)
        if isinstance(more.type, self.ir.VectorType):  # as long as it holds for one of them
            whole = self.ir.IntType(more.type.count)
            more = self.builder.icmp_unsigned("!=", self.builder.bitcast(more, whole), whole(0))
        self.builder.cbranch(more, body, after)
        self.builder.position_at_end(body)
        self.run(loop.body)
        self.builder.branch(test)
        self.builder.position_at_end(after)

    # -- elements of arrays ------------------------------------------------------------------------
    def place(self, element: form.Element) -> Value:
        array, add, mul = self.arrays[element.array], self.builder.add, self.builder.mul
        *rows, last = map(self.value, element.indices)
        offset = last if element.shift == 0 else add(last, self.value(element.shift))
        tiled = element.array in TILED
        row = self.arrays["starts"].length if tiled else array.row
        if rows:
            offset = add(mul(rows[0], row), offset)
        if tiled:
            offset = add(mul(offset, self.arrays["starts"].row), self.first)
        pointer = self.builder.gep(array.first, [offset], inbounds=True)
        return self.builder.bitcast(pointer, self.wide.as_pointer()) if tiled else pointer

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
        value = self.spread(value) if element.array in TILED else self.floating(value)
        self.builder.store(value, self.place(element), align=8)

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

    def spread(self, value: Value) -> Value:
        value = self.floating(value)
        if value.type != self.double or self.lanes == 1:
            return value
        empty, index = self.ir.Constant(self.wide, self.ir.Undefined), self.ir.IntType(32)
        one = self.builder.insert_element(empty, value, index(0))
        zeros = self.ir.Constant(self.ir.VectorType(index, self.lanes), [0] * self.lanes)
        return self.builder.shuffle_vector(one, empty, zeros)

    def alike(self, values: Sequence[Value]) -> list[Value]:
        wide = any(value.type == self.wide for value in values)
        return [self.spread(value) if wide else self.floating(value) for value in values]

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
            return compare(sign, *self.alike(x))
        if function == "neg":
            return self.builder.neg(*x) if whole else self.builder.fneg(*x, flags=self.flags)
        if function in ARITHMETIC:
            if whole and function != "div":
                return getattr(self.builder, function)(*x)
            return getattr(self.builder, f"f{function}")(*self.alike(x), flags=self.flags)
        return self.call(function, *self.alike(x))

    def choose(self, condition: Value, a: Value, b: Value) -> Value:
        if isinstance(condition.type, self.ir.VectorType):
            a, b = self.spread(a), self.spread(b)
        elif not a.type == b.type == self.whole:
            a, b = self.alike((a, b))
        return self.builder.select(condition, a, b)

    def call(self, name: str, *x: Value) -> Value:
        from numba.core.cgutils import get_or_insert_function

        kind = x[0].type
        if name in INTRINSICS:
            name = f"llvm.{INTRINSICS[name]}.{'f64' if kind == self.double else f'v{self.lanes}f64'}"
        elif kind != self.double:
            return self.call_each(name, *x)
        signature = self.ir.FunctionType(kind, [kind] * len(x))
        return self.builder.call(get_or_insert_function(self.builder.module, signature, name), x)

    def call_each(self, name: str, *x: Value) -> Value:
        """Emit calls of a function that LLVM has for numbers only, one for each lane; return the vector of results."""
        result = self.ir.Constant(self.wide, self.ir.Undefined)
        for i in map(self.ir.IntType(32), range(self.lanes)):
            each = self.call(name, *(self.builder.extract_element(v, i) for v in x))
            result = self.builder.insert_element(result, each, i)
        return result


def intrinsic(function: form.Function, lanes: int = 1, fused: bool = True) -> Compiled:
    """The function of arrays, pointers and numbers as a numba intrinsic; lanes, fused : see `compile_function`."""
    from numba.core import cgutils, types
    from numba.extending import intrinsic
    from numba.np.arrayobj import make_array

    def typed(typingctx: Context, *kinds: Type) -> tuple[Signature, Compiled]:
        def instructions(
            context: BaseContext, builder: IRBuilder, signature: Signature, given: Sequence[Value]
        ) -> Value:
            arrays, numbers = {}, {}
            for name, kind, value in zip(function.arguments, signature.args, given, strict=True):
                if isinstance(kind, types.Float):
                    numbers[name] = value
                elif isinstance(kind, types.CPointer):
                    arrays[name] = Array(value, None)
                else:
                    array = make_array(kind)(context, builder, value)
                    arrays[name] = Array(array.data, *cgutils.unpack_tuple(builder, array.shape)[:2])
            return Lowering(builder, arrays, numbers, fused, lanes).lower(function)

        return types.int64(*kinds), instructions

    # numba reads the number of arguments off the function
    arguments, scope = ", ".join(function.arguments), {"typed": typed}
    exec(f"def {function.name}(typingctx, {arguments}):\n    return typed(typingctx, {arguments})", scope)
    made: Compiled = intrinsic(scope[function.name])
    return made


# -- kept in files ----------------------------------------------------------------------------------
@cache
def folder() -> Path:
    """Where programs are kept; a folder of this process alone where that cannot be written to."""
    from platformdirs import user_cache_path

    chosen = os.environ.get(VARIABLE)
    path = Path(chosen) if chosen else user_cache_path("contactbench")
    try:
        path = path / "programs"
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            return path
    except OSError:
        return Path(tempfile.mkdtemp(prefix="contactbench-"))


@cache
def back_end() -> str:
    """What a compiled program depends on besides what was recorded, and the processor."""
    return hashlib.sha256(Path(__file__).read_bytes()).hexdigest()


class Kept:
    """The cache of one function, in the place of numba's own, which fails for good on a file that is damaged.

    A file begins with the SHA-256 of the rest: one that is not what was written is compiled anew and replaced.
    """

    cache_path = property(lambda self: str(folder()))

    def __init__(self, key: str) -> None:
        self.key = key

    def path(self, signature: Signature, codegen: CPUCodegen) -> Path:
        from numba import __version__

        key = form.digest(self.key, str(signature), codegen.magic_tuple(), __version__, sys.version)
        return folder() / f"{key}.program"

    def load_overload(self, signature: Signature, context: CPUContext) -> Any:
        from numba.core.compiler import CompileResult

        context.refresh()
        with suppress(Exception):  # whatever is wrong with the file
            content = self.path(signature, context.codegen()).read_bytes()
            if content[:DIGEST] == hashlib.sha256(content[DIGEST:]).digest():
                return CompileResult._rebuild(context, *pickle.loads(content[DIGEST:]))
        return None

    def save_overload(self, signature: Signature, compiled: Any) -> None:
        from numba.core.serialize import dumps

        if compiled.lifted or compiled.library.has_dynamic_globals:
            return
        content = dumps(compiled._reduce())
        with (
            suppress(OSError),
            replacing(self.path(signature, compiled.codegen), sync=False, mode="wb") as file,
        ):
            file.write(hashlib.sha256(content).digest() + content)


def calling(lowered: Compiled, name: str, arguments: str, body: str, key: str) -> Compiled:
    """Return a function of a module of its own, by which numba names what it compiles, that calls an intrinsic."""
    if not COMPILES:
        raise CannotRecord("NUMBA_DISABLE_JIT is set: numba compiles nothing")
    module = ModuleType(f"contactbench_program_{key[:32]}")
    vars(module)["lowered"] = lowered
    sys.modules[module.__name__] = module
    exec(f"def {name}({arguments}): {body}", vars(module))
    made: Compiled = getattr(module, name)
    return made


def keep(function: Compiled, *key: str, signature: str = "", **options: Any) -> Any:
    """Compile as numba's `njit` with a cache; key : what the function depends on besides its name."""
    from numba import njit

    made = njit(**options)(function)
    made._cache = Kept(form.digest(function.__module__, function.__qualname__, *key))
    if signature:
        made.compile(signature)
        made.disable_compile()
    return made


def keep_c(function: Compiled, signature: Signature, *key: str) -> Any:
    """Compile as numba's `cfunc` with a cache."""
    from numba.core.ccallback import CFunc
    from numba.core.sigutils import normalize_signature

    made: Any = CFunc(function, normalize_signature(signature), {}, {})
    made._cache = Kept(form.digest(function.__module__, function.__qualname__, *key))
    made.compile()
    return made


def compile_c(lowered: Compiled, name: str, given: str, key: str) -> Any:
    """Return the C function ``name(out, t, y, data)`` of pointers and a number, which calls an intrinsic."""
    from numba import types

    pointer = types.CPointer(types.float64)
    signature = types.void(pointer, types.float64, pointer, pointer)
    return keep_c(calling(lowered, name, "out, t, y, data", f"lowered({given})", key), signature)


@cache
def compile_function(function: form.Function, lanes: int = 1, fused: bool = True) -> Any:
    """Return the function, compiled for the arrays that its arguments name.

    Raise `CannotRecord` where numba is not to compile.

    lanes : states it runs on at a time.  fused : products and sums may be one operation, which Python's are not.
    """
    kinds = []
    for array in function.arguments:
        dimensions = ", ".join([":"] * (DIMENSIONS.get(array, 1) - 1) + ["::1"])
        kinds.append(f"{'int64' if array in WHOLE else 'float64'}[{dimensions}]")
    key, arguments = form.digest(back_end(), function.digest, lanes, fused), ", ".join(function.arguments)
    body = f"return lowered({arguments})"
    made = calling(intrinsic(function, lanes, fused), function.name, arguments, body, key)
    signature = f"int64({', '.join(kinds)})"
    return keep(made, signature=signature, nogil=True, no_cfunc_wrapper=True)
