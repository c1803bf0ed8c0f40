"""Recorded functions compiled by LLVM, and kept: once, not once per process.

Recorded programs are long, and numba would spend a second and more on finding out the types of every line of one.
Here the types follow from floating-point constants, whole constants and comparisons, and a program becomes a module
of the LLVM that numba brings, at once.  What takes arrays from Python and calls a program with them is such a module
too, one for every kind of arguments.  Numba itself, which takes as long to import as all else, is for solvers in C.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import pickle
import struct
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache, wraps
from pathlib import Path
from threading import Lock, RLock
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from contactbench.files import replacing
from contactbench.numbers.protocol import CannotRecord
from contactbench.trace import form
from contactbench.trace.form import Statement

if TYPE_CHECKING:
    from llvmlite.ir import IRBuilder, Type, Value
    from numba.core.codegen import CPUCodegen
    from numba.core.cpu import CPUContext
    from numba.core.typing import Signature

#: a function that numba makes or compiles
Compiled = Callable[..., Any]
#: writes the instructions of a function, given its arguments, and returns its result
type Instructions = Callable[[IRBuilder, Sequence[Value]], Value | None]

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
        if self.lanes == 1:
            self.run(function.body)
            return self.value(function.result)
        begin, end = (self.load(form.Element("part", (i,))) for i in (0, 1))
        with self.counted(begin, end) as tile:
            self.first = self.builder.mul(tile, self.whole(self.lanes))
            self.run(function.body)
        return self.whole(0)

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
                case form.Loop(counter, times, inner):
                    with self.counted(self.whole(0), self.value(times)) as self.values[counter]:
                        self.run(inner)
                case form.While():
                    self.repeat(statement)

    @contextmanager
    def counted(self, begin: Value, end: Value, over: Callable[[], Value] | None = None) -> Iterator[Value]:
        """Repeat the instructions of a block for begin, begin + 1, …, end − 1, or until it is over."""
        builder, entry = self.builder, self.builder.block
        test, body, after = (builder.append_basic_block(name) for name in ("test", "body", "after"))
        builder.branch(test)
        builder.position_at_end(test)
        index = builder.phi(self.whole)
        index.add_incoming(begin, entry)
        more = builder.icmp_signed("<", index, end)
        builder.cbranch(more if over is None else builder.and_(more, builder.not_(over())), body, after)
        builder.position_at_end(body)
        yield index
        index.add_incoming(builder.add(index, self.whole(1)), builder.block)
        builder.branch(test)
        builder.position_at_end(after)

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
        kind = x[0].type
        if name in INTRINSICS:
            name = f"llvm.{INTRINSICS[name]}.{'f64' if kind == self.double else f'v{self.lanes}f64'}"
        elif kind != self.double:
            return self.call_each(name, *x)
        signature = self.ir.FunctionType(kind, [kind] * len(x))
        return self.builder.call(self.external(name, signature), x)

    def external(self, name: str, signature: Type) -> Value:
        """Return a function of the C library's or of LLVM's, declared once in a module."""
        known = self.builder.module.globals.get(name)
        return known or self.ir.Function(self.builder.module, signature, name)

    def call_each(self, name: str, *x: Value) -> Value:
        """Emit calls of a function that LLVM has for numbers only, one for each lane; return the vector of results."""
        result = self.ir.Constant(self.wide, self.ir.Undefined)
        for i in map(self.ir.IntType(32), range(self.lanes)):
            each = self.call(name, *(self.builder.extract_element(v, i) for v in x))
            result = self.builder.insert_element(result, each, i)
        return result


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


def read_kept(path: Path) -> bytes | None:
    """Return what was kept, None where a file is missing or damaged: it begins with the SHA-256 of the rest."""
    with suppress(OSError):
        content = path.read_bytes()
        if content[:DIGEST] == hashlib.sha256(content[DIGEST:]).digest():
            return content[DIGEST:]
    return None


def write_kept(path: Path, content: bytes) -> None:
    with suppress(OSError), replacing(path, sync=False, mode="wb") as file:
        file.write(hashlib.sha256(content).digest() + content)


# -- by LLVM -----------------------------------------------------------------------------------------
class Machine:
    """LLVM for the processor of this machine, and what it has compiled in this process."""

    def __init__(self) -> None:
        from llvmlite import binding

        binding.initialize_native_target()
        binding.initialize_native_asmprinter()
        processor, features = binding.get_host_cpu_name(), ""
        with suppress(RuntimeError):  # not known on every platform
            features = binding.get_host_cpu_features().flatten()
        self.triple = binding.get_process_triple()
        target = binding.Target.from_triple(self.triple)
        self.target = target.create_target_machine(cpu=processor, features=features, opt=3, jit=True)
        self.engine = binding.create_mcjit_compiler(binding.parse_assembly(""), self.target)
        self.key = form.digest(self.triple, processor, features, binding.llvm_version_info)
        self.alone = Lock()
        #: functions compiled in this process, which were not kept
        self.compiled = 0

    def address(self, key: str, result: str, kinds: Sequence[str], instructions: Instructions) -> int:
        """Return where a function is whose instructions a call writes, compiled or as it was kept.

        kinds : of its arguments, "double", "i64", "object", or pointers to them, "doubles", "i64s", "objects"; result :
        the same, or "void".
        """
        from llvmlite.binding import ObjectFileRef

        name = f"program_{form.digest(key, self.key)}"
        path = folder() / f"{name}.object"
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
        types |= {"void": ir.VoidType(), "object": ir.IntType(8).as_pointer()}
        types["objects"] = types["object"].as_pointer()
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


#: held while what there is once in a process is made
MAKING = RLock()


def once[**P, R](function: Callable[P, R]) -> Callable[P, R]:
    """Make it once, and never free it: `cache` makes it twice for threads that begin together, and frees one."""
    made: Any = cache(function)

    @wraps(function)
    def waiting(*args: P.args, **kwargs: P.kwargs) -> R:
        with MAKING:
            known: R = made(*args, **kwargs)
        return known

    return waiting


@once
def machine() -> Machine:
    if not COMPILES:
        raise CannotRecord("NUMBA_DISABLE_JIT is set: nothing is compiled")
    return Machine()


def compile_c(key: str, instructions: Instructions) -> int:
    """Return the address of the C function ``void (double *out, double t, double *y, double *data)``.

    instructions : writes them, given the builder and the arguments; key : what they depend on.
    """
    kinds = ("doubles", "double", "doubles", "doubles")
    return machine().address(form.digest(back_end(), key, kinds), "void", kinds, instructions)


def compile_recorded_c(function: form.Function) -> int:
    """Return the address of a recorded function of (out, t, y, data) as a C function."""

    def instructions(builder: IRBuilder, given: Sequence[Value]) -> None:
        named = dict(zip(function.arguments, given, strict=True))
        numbers = {"t": named.pop("t")}
        arrays = {name: Array(value, None) for name, value in named.items()}
        Lowering(builder, arrays, numbers, True, 1).lower(function)

    return compile_c(function.digest, instructions)


@cache
def compile_function(function: form.Function, lanes: int = 1, fused: bool = True) -> Callable[..., int]:
    """Return the function, compiled for the arrays that its arguments name, contiguous ones of the right kind.

    Raise `CannotRecord` where nothing is to be compiled.

    lanes : states it runs on at a time.  fused : products and sums may be one operation, which Python's are not.
    """
    dimensions = [DIMENSIONS.get(name, 1) for name in function.arguments]
    kinds: list[str] = []
    for name, n in zip(function.arguments, dimensions, strict=True):
        kinds += ["i64s" if name in WHOLE else "doubles"] + ["i64"] * n

    def instructions(builder: IRBuilder, given: Sequence[Value]) -> Value:
        values, arrays = iter(given), {}
        for name, n in zip(function.arguments, dimensions, strict=True):
            first, *shape = (next(values) for _ in range(1 + n))
            arrays[name] = Array(first, *shape[:2])
        return Lowering(builder, arrays, {}, fused, lanes).lower(function)

    key = form.digest(back_end(), function.digest, lanes, fused)
    address = machine().address(key, "i64", kinds, instructions)
    taken = tuple(Taken(n, name in WHOLE) for name, n in zip(function.arguments, dimensions, strict=True))
    return builtin(address, taken)


# -- from Python -------------------------------------------------------------------------------------
class Taken(NamedTuple):
    """What a program takes: a contiguous array of so many dimensions, of whole numbers or of doubles."""

    dimensions: int
    whole: bool


class MethodDef(ctypes.Structure):
    """CPython's PyMethodDef."""

    _fields_ = (
        ("name", ctypes.c_char_p),
        ("function", ctypes.c_void_p),
        ("flags", ctypes.c_int),
        ("about", ctypes.c_char_p),
    )


#: CPython's PyCFunction_NewEx: a built-in function of a definition, which is to outlive it, and of the object it is of
new_builtin = ctypes.PYFUNCTYPE(
    ctypes.py_object, ctypes.POINTER(MethodDef), ctypes.py_object, ctypes.c_void_p
)(("PyCFunction_NewEx", ctypes.pythonapi))


#: functions of CPython's that a call from Python needs, and METH_FASTCALL
CPYTHON = ("PyEval_SaveThread", "PyEval_RestoreThread", "PyLong_FromLongLong", "PyErr_BadArgument")
FASTCALL = 0x80
#: the header of an object, whose last word is its type; where the characters of a bytes object are
HEADER, CHARACTERS = object.__basicsize__, bytes.__basicsize__ - 1
#: fields of NumPy's PyArrayObject after the header (NumPy C-API, "Array structure and data access"), in bytes
DATA, DIMENSION_COUNT, SHAPE, DTYPE, FLAGS = (HEADER + 8 * k for k in (0, 1, 2, 5, 6))
#: the bit of the flags that says C-contiguous
CONTIGUOUS = 1
#: fields of NumPy's PyArray_Descr: a character that says the order of bytes, and the number of the type
ORDER, NUMBER = HEADER + 10, HEADER + 12
#: the numbers of doubles and of whole numbers; a type that was pickled is another object of the same number
NUMBERS = np.dtype(np.float64).num, np.dtype(np.int64).num


def builtin(address: int, taken: tuple[Taken, ...]) -> Callable[..., int]:
    """Return what calls the program at an address with arrays, without the GIL: a built-in function of CPython's.

    Others than such arrays, each of its own number, are refused with `TypeError`.
    """
    known = struct.pack("2P", address, id(np.ndarray))
    made: Callable[..., int] = new_builtin(ctypes.byref(method_of(taken)), known, None)
    return made


@once
def method_of(taken: tuple[Taken, ...]) -> MethodDef:
    from llvmlite import binding, ir

    for name in CPYTHON:
        binding.add_symbol(name, ctypes.cast(getattr(ctypes.pythonapi, name), ctypes.c_void_p).value)
    whole, half, byte = ir.IntType(64), ir.IntType(32), ir.IntType(8)
    pointer = byte.as_pointer()

    def instructions(builder: IRBuilder, given: Sequence[Value]) -> Value:
        own, arguments, count = given
        bad = builder.append_basic_block("bad")

        def called(name: str, result: Type, *values: Value) -> Value:
            kind = ir.FunctionType(result, [value.type for value in values])
            return builder.call(ir.Function(builder.module, kind, name), values)

        def read(base: Value, offset: int, kind: Type) -> Value:
            place = builder.gep(base, [whole(offset)])
            return builder.load(builder.bitcast(place, kind.as_pointer()), align=4)

        def demand(condition: Value) -> None:
            good = builder.append_basic_block()
            builder.cbranch(condition, good, bad)
            builder.position_at_end(good)

        demand(builder.icmp_signed("==", count, whole(len(taken))))
        program, array = (read(own, CHARACTERS + 8 * k, whole) for k in (0, 1))
        passed: list[Value] = []
        for k, (dimensions, of_whole) in enumerate(taken):
            value = builder.load(builder.gep(arguments, [whole(k)]), align=8)
            demand(builder.icmp_signed("==", read(value, HEADER - 8, whole), array))
            kind = read(value, DTYPE, pointer)
            number, order = read(kind, NUMBER, half), builder.load(builder.gep(kind, [whole(ORDER)]))
            right = builder.icmp_signed("==", number, half(NUMBERS[of_whole]))
            native = builder.icmp_signed("==", order, byte(ord("=")))
            as_many = builder.icmp_signed("==", read(value, DIMENSION_COUNT, half), half(dimensions))
            flag = builder.and_(read(value, FLAGS, half), half(CONTIGUOUS))
            dense = builder.icmp_signed("!=", flag, half(0))
            demand(builder.and_(builder.and_(right, native), builder.and_(as_many, dense)))
            element = (whole if of_whole else ir.DoubleType()).as_pointer()
            passed.append(read(value, DATA, element))
            shape = read(value, SHAPE, pointer)
            passed += [read(shape, 8 * k, whole) for k in range(dimensions)]
        thread = called("PyEval_SaveThread", pointer)
        called_kind = ir.FunctionType(whole, [value.type for value in passed])
        result = builder.call(builder.inttoptr(program, called_kind.as_pointer()), passed)
        called("PyEval_RestoreThread", ir.VoidType(), thread)
        builder.ret(called("PyLong_FromLongLong", pointer, result))
        builder.position_at_end(bad)
        called("PyErr_BadArgument", half)
        return ir.Constant(pointer, None)

    kinds = ("object", "objects", "i64")
    key = form.digest(back_end(), taken, HEADER, CHARACTERS, NUMBERS)
    return MethodDef(b"program", machine().address(key, "object", kinds, instructions), FASTCALL, None)


# -- by numba ----------------------------------------------------------------------------------------
class Kept:
    """The cache of one function, in the place of numba's own, which fails for good on a file that is damaged."""

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
            if (content := read_kept(self.path(signature, context.codegen()))) is not None:
                return CompileResult._rebuild(context, *pickle.loads(content))
        return None

    def save_overload(self, signature: Signature, compiled: Any) -> None:
        from numba.core.serialize import dumps

        if not (compiled.lifted or compiled.library.has_dynamic_globals):
            write_kept(self.path(signature, compiled.codegen), dumps(compiled._reduce()))


def keep(function: Compiled, *key: str, **options: Any) -> Any:
    """Compile as numba's `njit` with a cache; key : what the function depends on besides its name."""
    from numba import njit

    made = njit(**options)(function)
    made._cache = Kept(form.digest(function.__module__, function.__qualname__, *key))
    return made


def entry(function: Any, *arguments: object) -> Compiled:
    """Return what `keep` compiles for such arguments: at a call numba looks for it for a third of a microsecond."""
    from numba import typeof

    kinds = tuple(map(typeof, arguments))
    function.compile(kinds)
    made: Compiled = function.overloads[kinds].entry_point
    return made


def keep_c(function: Compiled, signature: Signature, *key: str) -> Any:
    """Compile as numba's `cfunc` with a cache."""
    from numba.core.ccallback import CFunc
    from numba.core.sigutils import normalize_signature

    made: Any = CFunc(function, normalize_signature(signature), {}, {})
    made._cache = Kept(form.digest(function.__module__, function.__qualname__, *key))
    made.compile()
    return made
