"""Compile functions on arrays that are written as plain Python: loops, numbers, and elements of flat arrays.

Such a function has local numbers that keep their type, ``for … in range(n)``, ``while``, ``if``, arithmetic,
comparisons, ``len`` of an argument, ``int`` of an element, and functions of `math`.  Both branches of a conditional
expression are computed.  Other names are constants of its module.
"""

from __future__ import annotations

import ast
import inspect
from collections.abc import Callable, Sequence
from functools import cached_property
from textwrap import dedent
from typing import Any

import numpy as np

from contactbench.numbers.protocol import CannotRecord
from contactbench.trace.compiled import compile_function
from contactbench.trace.form import (
    Assign,
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
from contactbench.trace.native_call import Native

OPERATIONS: dict[type[ast.AST], str] = {
    ast.Add: "add",
    ast.Sub: "sub",
    ast.Mult: "mul",
    ast.Div: "div",
    ast.USub: "neg",
    ast.Not: "not",
    ast.Lt: "lt",
    ast.LtE: "le",
    ast.Gt: "gt",
    ast.GtE: "ge",
    ast.Eq: "eq",
    ast.NotEq: "ne",
    ast.And: "and",
    ast.Or: "or",
}


class Kernel:
    """A function of arrays that writes to the last one, compiled at its first call; Python runs it where LLVM may not.

    Arrays are contiguous and one-dimensional, of doubles; all but the last may be read only.
    """

    def __init__(self, function: Callable[..., None]) -> None:
        self.function, self.__doc__ = function, function.__doc__

    @cached_property
    def form(self) -> Function:
        return Translation(self.function).form

    @cached_property
    def native(self) -> Native:
        return compile_function(self.form)

    def __call__(self, *arrays: np.ndarray) -> None:
        try:
            self.native(*arrays)
        except CannotRecord:
            self.function(*arrays)


class Translation:
    """The translation of one function; every part of an expression has a name of its own."""

    def __init__(self, function: Callable[..., None]) -> None:
        self.constants, self.names, self.body = function.__globals__, 0, list[Statement]()
        (tree,) = ast.parse(dedent(inspect.getsource(function))).body
        assert isinstance(tree, ast.FunctionDef)
        arguments = tuple(argument.arg for argument in tree.args.args)
        self.form = Function(tree.name, arguments, self.block(tree.body))

    def name(self) -> str:
        self.names += 1
        return f"part{self.names}"

    def block(self, nodes: Sequence[ast.stmt]) -> tuple[Statement, ...]:
        outer, self.body = self.body, []
        for node in nodes:
            self.statement(node)
        inner, self.body = self.body, outer
        return tuple(inner)

    def statement(self, node: ast.stmt) -> None:
        match node:
            case ast.Expr(ast.Constant()):  # the docstring
                pass
            case ast.Assign([target], value):
                self.assign(target, self.operand(value))
            case ast.AugAssign(target, operator, value):
                self.assign(target, self.operation(operator, target, value))
            case ast.For(ast.Name(counter), ast.Call(_, [count]), body):
                self.body.append(Loop(counter, self.operand(count), self.block(body)))
            case ast.While(test, body):
                outer, self.body = self.body, []
                condition = self.operand(test)
                before, self.body = tuple(self.body), outer
                self.body.append(While(before, condition, self.block(body)))
            case ast.If(test, body, others):
                condition = self.operand(test)
                for once, part in (((1, 0), body), ((0, 1), others)):
                    times = self.kept(Operation("where", (condition, *once)))
                    self.body.append(Loop(self.name(), times, self.block(part)))
            case _:
                raise CannotRecord(f"a kernel has no {type(node).__name__}")

    def assign(self, target: ast.expr, value: Operand) -> None:
        match target:
            case ast.Name(name):
                self.body.append(Update((name,), (value,)))
            case ast.Subscript():
                self.body.append(Store(self.element(target), value))

    def kept(self, value: Operation | Element) -> str:
        self.body.append(Assign(name := self.name(), value))
        return name

    def operation(self, operator: ast.AST, *operands: ast.expr) -> str:
        return self.kept(Operation(OPERATIONS[type(operator)], tuple(map(self.operand, operands))))

    def element(self, node: ast.expr, kind: str = "f") -> Element:
        assert isinstance(node, ast.Subscript)
        assert isinstance(node.value, ast.Name)
        return Element(node.value.id, (self.operand(node.slice),), kind=kind)

    def operand(self, node: ast.expr) -> Operand:
        match node:
            case ast.Constant(value):
                return value  # type: ignore[return-value]
            case ast.Name(name):
                constant: Any = self.constants.get(name, name)
                return constant if isinstance(constant, int | float) else name
            case ast.Subscript():
                return self.kept(self.element(node))
            case ast.BinOp(left, operator, right) | ast.Compare(left, [operator], [right]):
                return self.operation(operator, left, right)
            case ast.BoolOp(operator, [left, right]):
                return self.operation(operator, left, right)
            case ast.UnaryOp(operator, operand):
                return self.operation(operator, operand)
            case ast.IfExp(test, body, other):
                return self.kept(
                    Operation("where", (self.operand(test), self.operand(body), self.operand(other)))
                )
            case ast.Call(ast.Name("int"), [argument]):
                return self.kept(self.element(argument, "i"))
            case ast.Call(ast.Name("len"), [ast.Name(array)]):
                return self.kept(Operation("len", (array,)))
            case ast.Call(ast.Name(function), arguments):
                return self.kept(Operation(function, tuple(map(self.operand, arguments))))
        raise CannotRecord(f"a kernel has no {type(node).__name__}")
