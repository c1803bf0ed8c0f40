"""Recorded source to LLVM instructions, inside a function that numba compiles.

Recorded programs are long, and use little of Python: assignments of scalar arithmetic, loops over a range, and
elements of contiguous arrays.  numba spends a second and more on finding out the types of every line of
one; here they follow line by line from floating-point literals, whole literals and comparisons, and the whole
program is one intrinsic function to numba, which does all the rest: arguments, optimisation, its cache.
"""

from __future__ import annotations

import ast
import sys
from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

#: functions LLVM knows; all others are the C library's
INTRINSICS = {
    "abs": "llvm.fabs",
    **{
        name: f"llvm.{name}"
        for name in ("sqrt", "floor", "ceil", "pow", "exp", "log", "log2", "log10", "sin", "cos")
    },
}
CONSTANTS = {"inf": float("inf"), "nan": float("nan"), "LARGEST": sys.float_info.max}
COMPARISONS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
#: products and sums may be fused
CONTRACT = ("contract",)


class Array(NamedTuple):
    """A contiguous array: where it begins, its length, and the length of a row of it (None in one dimension)."""

    first: Any
    length: Any
    row: Any = None


class Lowering:
    """The instructions of one function.

    Names that are assigned more than once are variables on the stack, which LLVM makes registers of.
    """

    def __init__(
        self,
        function: ast.FunctionDef,
        builder: Any,
        arrays: dict[str, Array],
        numbers: dict[str, Any],
        fused: bool = True,
    ) -> None:
        from llvmlite import ir

        self.ir, self.builder, self.arrays = ir, builder, arrays
        self.flags = CONTRACT if fused else ()
        self.double, self.whole, self.truth = ir.DoubleType(), ir.IntType(64), ir.IntType(1)
        self.values = dict(numbers)
        self.variables: dict[str, Any] = {}
        names = (node for node in ast.walk(function) if isinstance(node, ast.Name))
        stores = [name.id for name in names if isinstance(name.ctx, ast.Store)]
        self.changing = {name for name, times in Counter(stores).items() if times > 1}
        #: where `break` leads to
        self.after: Any = None
        self.returned = self.whole(0)
        self.run(function.body)

    # -- statements --------------------------------------------------------------------------------
    def run(self, body: list[ast.stmt]) -> None:
        for statement in body:
            getattr(self, f"_{type(statement).__name__}")(statement)

    def _Assign(self, statement: ast.Assign) -> None:
        (target,) = statement.targets
        if isinstance(target, ast.Tuple):
            assert isinstance(statement.value, ast.Tuple)
            values = [self.value(part) for part in statement.value.elts]
            for part, value in zip(target.elts, values, strict=True):
                self.store(part, value)
        else:
            self.store(target, self.value(statement.value))

    def store(self, target: ast.expr, value: Any) -> None:
        if isinstance(target, ast.Subscript):
            self.builder.store(self.floating(value), self.element(target))
            return
        assert isinstance(target, ast.Name)
        if target.id not in self.changing:
            self.values[target.id] = value
            return
        if target.id not in self.variables:
            with self.builder.goto_entry_block():
                self.variables[target.id] = self.builder.alloca(value.type)
        slot = self.variables[target.id]
        self.builder.store(self.floating(value) if slot.type.pointee == self.double else value, slot)

    def _For(self, loop: ast.For) -> None:
        from numba.core.cgutils import for_range

        assert isinstance(loop.iter, ast.Call)
        assert isinstance(loop.target, ast.Name)
        with for_range(self.builder, self.value(loop.iter.args[0])) as turn:
            self.values[loop.target.id] = turn.index
            self.changing.discard(loop.target.id)
            self.run(loop.body)

    def _While(self, loop: ast.While) -> None:
        """``while True:``, left by `break`."""
        begin, self.after = (self.builder.append_basic_block(name) for name in ("while", "after"))
        self.builder.branch(begin)
        self.builder.position_at_end(begin)
        self.run(loop.body)
        self.builder.branch(begin)
        self.builder.position_at_end(self.after)

    def _Break(self, statement: ast.Break) -> None:
        self.builder.branch(self.after)

    def _If(self, choice: ast.If) -> None:
        with self.builder.if_then(self.value(choice.test)):
            self.run(choice.body)

    def _Return(self, statement: ast.Return) -> None:
        assert statement.value is not None
        self.returned = self.value(statement.value)

    # -- expressions -------------------------------------------------------------------------------
    def value(self, node: ast.expr) -> Any:
        return getattr(self, f"_{type(node).__name__}")(node)

    def alike(self, *values: Any) -> list[Any]:
        """Numbers as floating-point numbers of one type."""
        return [self.floating(value) for value in values]

    def floating(self, value: Any) -> Any:
        return self.builder.sitofp(value, self.double) if value.type == self.whole else value

    def _Constant(self, node: ast.Constant) -> Any:
        kind = {bool: self.truth, int: self.whole, float: self.double}[type(node.value)]
        return self.ir.Constant(kind, node.value)

    def _Name(self, node: ast.Name) -> Any:
        if node.id in self.variables:
            return self.builder.load(self.variables[node.id])
        if node.id in CONSTANTS:
            return self.ir.Constant(self.double, CONSTANTS[node.id])
        return self.values[node.id]

    def element(self, node: ast.Subscript) -> Any:
        assert isinstance(node.value, ast.Name)
        array = self.arrays[node.value.id]
        if array.row is None:
            return self.builder.gep(array.first, [self.value(node.slice)], inbounds=True)
        assert isinstance(node.slice, ast.Tuple)
        i, j = map(self.value, node.slice.elts)
        return self.builder.gep(
            array.first, [self.builder.add(self.builder.mul(i, array.row), j)], inbounds=True
        )

    def _Subscript(self, node: ast.Subscript) -> Any:
        return self.builder.load(self.element(node))

    def _BinOp(self, node: ast.BinOp) -> Any:
        a, b = self.value(node.left), self.value(node.right)
        sign = type(node.op).__name__
        if a.type == b.type == self.whole and sign in ("Add", "Sub", "Mult"):
            return getattr(self.builder, {"Add": "add", "Sub": "sub", "Mult": "mul"}[sign])(a, b)
        a, b = self.alike(a, b)
        if sign == "Pow":
            return self.call("pow", a, b)
        names = {"Add": "fadd", "Sub": "fsub", "Mult": "fmul", "Div": "fdiv"}
        return getattr(self.builder, names[sign])(a, b, flags=self.flags)

    def _UnaryOp(self, node: ast.UnaryOp) -> Any:
        x = self.value(node.operand)
        if isinstance(node.op, ast.Not):
            return self.builder.not_(x)
        return self.builder.neg(x) if x.type == self.whole else self.builder.fneg(x, flags=self.flags)

    def _BoolOp(self, node: ast.BoolOp) -> Any:
        result, *rest = map(self.value, node.values)
        join: Callable[..., Any] = self.builder.and_ if isinstance(node.op, ast.And) else self.builder.or_
        for value in rest:
            result = join(result, value)
        return result

    def _Compare(self, node: ast.Compare) -> Any:
        a, b, sign = self.value(node.left), self.value(node.comparators[0]), COMPARISONS[type(node.ops[0])]
        if a.type == b.type == self.whole:
            return self.builder.icmp_signed(sign, a, b)
        compare = self.builder.fcmp_unordered if sign == "!=" else self.builder.fcmp_ordered
        return compare(sign, *self.alike(a, b))

    def _IfExp(self, node: ast.IfExp) -> Any:
        a, b = self.value(node.body), self.value(node.orelse)
        return self.chosen(self.value(node.test), *self.alike(a, b))

    def chosen(self, condition: Any, a: Any, b: Any) -> Any:
        return self.builder.select(condition, a, b)

    def _Call(self, node: ast.Call) -> Any:
        assert isinstance(node.func, ast.Name)
        if node.func.id == "len":
            assert isinstance(node.args[0], ast.Name)
            return self.arrays[node.args[0].id].length
        x = [self.value(argument) for argument in node.args]
        if node.func.id == "int":
            return x[0] if x[0].type == self.whole else self.builder.fptosi(x[0], self.whole)
        return self.call(node.func.id, *self.alike(*x))

    def call(self, name: str, *x: Any) -> Any:
        from numba.core.cgutils import get_or_insert_function

        module = self.builder.module
        if name in INTRINSICS:
            function = module.declare_intrinsic(INTRINSICS[name], [self.double])
        else:
            kind = self.ir.FunctionType(self.double, [self.double] * len(x))
            function = get_or_insert_function(module, kind, name)
        return self.builder.call(function, x)


def lowered(text: str, lanes: int = 1, fused: bool = True) -> Any:
    """The function of a source as a numba intrinsic.

    fused : whether a product and a sum may be one operation.
    Its arguments are contiguous arrays of one or two dimensions, pointers to numbers, and numbers.
    """
    from numba.core import cgutils, types
    from numba.extending import intrinsic
    from numba.np.arrayobj import make_array

    (function,) = ast.parse(text).body
    assert isinstance(function, ast.FunctionDef)
    names = [argument.arg for argument in function.args.args]

    def typed(typingctx: Any, *arguments: Any) -> Any:
        def instructions(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            arrays, numbers = {}, {}
            for name, kind, value in zip(names, signature.args, values, strict=True):
                if isinstance(kind, types.Float):
                    numbers[name] = value
                elif isinstance(kind, types.CPointer):
                    arrays[name] = Array(value, None)
                else:
                    array = make_array(kind)(context, builder, value)
                    sizes = cgutils.unpack_tuple(builder, array.shape)
                    arrays[name] = Array(array.data, *sizes[:2])
            if lanes > 1:
                return Lanes(function, builder, arrays, lanes, fused).returned
            return Lowering(function, builder, arrays, numbers, fused).returned

        return types.int64(*arguments), instructions

    # numba reads the number of arguments off the function
    scope = {"typed": typed}
    exec(
        f"def {function.name}(typingctx, {', '.join(names)}):\n    return typed(typingctx, {', '.join(names)})",
        scope,
    )
    return intrinsic(scope[function.name])


class Lanes(Lowering):
    """The same instructions for many states at once: a vector of LLVM's for every number of the state.

    starts : (d, n), ends : (k, d, n), n a multiple of `lanes`.  part : the first tile of so many states, and the last.
    """

    def __init__(
        self,
        function: ast.FunctionDef,
        builder: Any,
        arrays: dict[str, Array],
        lanes: int,
        fused: bool = True,
    ) -> None:
        from llvmlite import ir

        self.lanes, self.wide = lanes, ir.VectorType(ir.DoubleType(), lanes)
        super().__init__(function, builder, arrays, {}, fused)

    def run(self, body: list[ast.stmt]) -> None:
        from numba.core.cgutils import for_range

        if hasattr(self, "first"):
            return super().run(body)
        part = self.arrays["part"].first
        tiles = [self.builder.load(self.builder.gep(part, [self.whole(i)])) for i in (0, 1)]
        with for_range(self.builder, tiles[1], tiles[0]) as turn:
            #: the first state of the tile
            self.first = self.builder.mul(turn.index, self.whole(self.lanes))
            super().run(body)

    def element(self, node: ast.Subscript) -> Any:
        assert isinstance(node.value, ast.Name)
        name = node.value.id
        if name not in ("starts", "ends"):
            return super().element(node)
        array = self.arrays[name]
        where = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        place = self.value(where[-1])
        if len(where) > 1:  # ends[j, i]
            size = self.arrays["starts"].length
            place = self.builder.add(self.builder.mul(self.value(where[0]), size), place)
        offset = self.builder.add(self.builder.mul(place, self.arrays["starts"].row), self.first)
        pointer = self.builder.gep(array.first, [offset], inbounds=True)
        return self.builder.bitcast(pointer, self.wide.as_pointer())

    def _Subscript(self, node: ast.Subscript) -> Any:
        return self.builder.load(self.element(node), align=8)

    def store(self, target: ast.expr, value: Any) -> None:
        if isinstance(target, ast.Subscript):
            self.builder.store(self.spread(value), self.element(target), align=8)
        else:  # the state may be wide from the second turn of a loop on
            changes = isinstance(target, ast.Name) and target.id in self.changing
            super().store(target, self.spread(value) if changes and value.type == self.double else value)

    def alike(self, *values: Any) -> list[Any]:
        values = [self.floating(value) for value in values]  # type: ignore[assignment]
        return (
            list(map(self.spread, values))
            if any(value.type == self.wide for value in values)
            else list(values)
        )

    def chosen(self, condition: Any, a: Any, b: Any) -> Any:
        each = isinstance(condition.type, self.ir.VectorType)
        return super().chosen(condition, *(map(self.spread, (a, b)) if each else (a, b)))

    def call(self, name: str, *x: Any) -> Any:
        if x[0].type == self.double:
            return super().call(name, *x)
        if name in INTRINSICS:
            kind = self.ir.FunctionType(self.wide, [self.wide] * len(x))
            full = f"{INTRINSICS[name]}.v{self.lanes}f64"
            known = self.builder.module.globals.get(full)
            return self.builder.call(known or self.ir.Function(self.builder.module, kind, full), x)
        result = self.ir.Constant(self.wide, self.ir.Undefined)
        for i in map(self.ir.IntType(32), range(self.lanes)):
            each = super().call(name, *(self.builder.extract_element(v, i) for v in x))
            result = self.builder.insert_element(result, each, i)
        return result

    def spread(self, value: Any) -> Any:
        """A number as a vector of it."""
        value = super().floating(value)
        if value.type != self.double:
            return value
        from llvmlite import ir

        one = self.builder.insert_element(ir.Constant(self.wide, ir.Undefined), value, ir.IntType(32)(0))
        zeros = ir.Constant(ir.VectorType(ir.IntType(32), self.lanes), [0] * self.lanes)
        return self.builder.shuffle_vector(one, ir.Constant(self.wide, ir.Undefined), zeros)
