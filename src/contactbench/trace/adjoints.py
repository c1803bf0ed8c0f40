"""Reverse mode: the derivatives of a recorded result along what it was computed from."""

from __future__ import annotations

from collections.abc import Container, Sequence
from heapq import heappop, heappush
from typing import Any

from contactbench.numbers.dual import DERIVATIVES
from contactbench.numbers.protocol import CannotRecord
from contactbench.trace.form import Operand, Operation
from contactbench.trace.recording import Recorded, RecordedNumbers, Tape

#: factors a product is written out to
LONGEST = 8
#: a product of named numbers, in the order they were computed in, and sums of such: product → coefficient
Product = tuple[str, ...]
Sum = dict[Product, float]


class Adjoints:
    """Derivatives of one result along what it was computed from, the last operation first.

    They are kept as sums of products of numbers, so that equal products meet, constants are multiplied ahead of
    the run, and what all products share is multiplied once: short code, which is what a force is to be.

    Griewank, Walther, Evaluating Derivatives, 2nd ed., SIAM 2008, §3.2, doi:10.1137/1.9780898717761.
    """

    def __init__(self, tape: Tape, arguments: Sequence[str], parameters: Container[str]) -> None:
        self.tape, self.parameters = tape, parameters
        #: of every argument and operation which one it is
        self.places = {name: i for i, name in enumerate(arguments)}
        self.operations: dict[str, Operation] = {}
        self.found: dict[str, Sum] = {}
        self.waiting: list[tuple[int, str]] = []

    def place(self, name: str) -> int:
        """Which argument or operation a name is: derivatives add operations of their own."""
        for target, operation in self.tape.root.statements[len(self.operations) :]:
            self.operations[target] = operation
            self.places[target] = len(self.places)
        return self.places[name]

    def number_of(self, operand: Operand) -> Any:
        """The recorded number of a name; a constant as it is."""
        return Recorded(self.tape, operand, "f", self.tape.root) if isinstance(operand, str) else operand

    def along(self, result: Operand, arguments: Sequence[str]) -> list[Any]:
        """The derivatives of a result along some of the arguments."""
        self.found.clear()
        self.add(result, {(): 1.0})
        while self.waiting:
            _, name = heappop(self.waiting)
            function, operands = self.operations[name]
            self.share(function, operands, name, self.found.pop(name))
        return [self.number(self.found[name]) if name in self.found else 0.0 for name in arguments]

    def add(self, operand: Operand, amount: Sum) -> None:
        """Add to the derivative along an operand."""
        if not isinstance(operand, str):
            return
        if operand not in self.found:
            self.found[operand] = {}
            place = self.place(operand)
            if operand in self.operations:
                heappush(self.waiting, (-place, operand))
        found = self.found[operand]
        for product, coefficient in amount.items():
            found[product] = found.get(product, 0.0) + coefficient
            if not found[product]:
                del found[product]

    def share(self, function: str, operands: Sequence[Operand], name: str, adjoint: Sum) -> None:
        """Add to the operands of an operation what its adjoint is worth to them."""
        xp, y = RecordedNumbers(self.tape), self.number_of(name)
        x = list(map(self.number_of, operands))
        match function:
            case "add":
                self.add(operands[0], adjoint)
                self.add(operands[1], adjoint)
            case "sub":
                self.add(operands[0], adjoint)
                self.add(operands[1], {product: -c for product, c in adjoint.items()})
            case "div" if operands[0] == 1.0:
                self.add(operands[1], self.times(adjoint, -1.0, (name, name)))
            case "neg" | "mul" | "div":
                coefficient, factors = self.product(name)
                for factor in dict.fromkeys(factors):
                    rest = list(factors)
                    rest.remove(factor)
                    times = coefficient * factors.count(factor)
                    self.add(factor, self.times(adjoint, times, tuple(rest)))
            case "pow" if not isinstance(x[1], Recorded):
                self.chain(operands[0], adjoint, x[0] ** (x[1] - 1), x[1])
            case "pow":
                if isinstance(x[0], Recorded):
                    self.chain(operands[0], adjoint, x[1] * x[0] ** (x[1] - 1))
                self.chain(operands[1], adjoint, y * xp.log(x[0]))
            case "sqrt":
                self.chain(operands[0], adjoint, 1.0 / y, 0.5)
            case "atan2":
                square = x[0] * x[0] + x[1] * x[1]
                self.chain(operands[0], adjoint, x[1] / square)
                self.chain(operands[1], adjoint, x[0] / square, -1.0)
            case "hypot":
                self.chain(operands[0], adjoint, x[0] / y)
                self.chain(operands[1], adjoint, x[1] / y)
            case "where":
                amount = self.number(adjoint)
                self.chain(operands[1], {(): 1.0}, xp.where(x[0], amount, 0.0))
                self.chain(operands[2], {(): 1.0}, xp.where(x[0], 0.0, amount))
            case _:
                if function not in DERIVATIVES:
                    raise CannotRecord(f"no derivative of {function} is known")
                self.chain(operands[0], adjoint, DERIVATIVES[function](xp, x[0], y))

    def chain(self, operand: Operand, adjoint: Sum, slope: Any, coefficient: float = 1.0) -> None:
        """Add adjoint · coefficient · slope to the derivative along an operand."""
        if isinstance(slope, Recorded):
            times, factors = self.product(slope.name)
            self.add(operand, self.times(adjoint, coefficient * times, factors))
        elif slope:
            self.add(operand, self.times(adjoint, coefficient * slope, ()))

    def product(self, operand: Operand) -> tuple[float, Product]:
        """An operand as a product of a constant and numbers, quotients as products with reciprocals."""
        if not isinstance(operand, str):
            return operand, ()
        self.place(operand)
        if operand not in self.operations:
            return 1.0, (operand,)
        function, operands = self.operations[operand]
        if function == "neg":
            coefficient, factors = self.product(operands[0])
            return -coefficient, factors
        if function == "div" and not isinstance(operands[1], str):
            coefficient, factors = self.product(operands[0])
            return coefficient / operands[1], factors
        if function == "div":
            if operands[0] == 1.0:
                return 1.0, (operand,)
            inverse = self.tape.operation("div", "f", 1.0, self.number_of(operands[1]))
            operands = (operands[0], inverse.name)
        elif function != "mul":
            return 1.0, (operand,)
        (a, left), (b, right) = map(self.product, operands)
        if len(left) + len(right) > LONGEST:
            return 1.0, (operand,) if function == "mul" else tuple(o for o in operands if isinstance(o, str))
        return a * b, self.product_of(left + right)

    def product_of(self, factors: Product) -> Product:
        return tuple(sorted(factors, key=self.place))

    def times(self, adjoint: Sum, coefficient: float, factors: Product) -> Sum:
        """A sum times a product."""
        if not adjoint:
            return adjoint
        if len(adjoint) > 1 and (factors or coefficient != 1.0):
            adjoint = self.collect(adjoint)
        found: Sum = {}
        for product, c in adjoint.items():
            if len(product) + len(factors) > LONGEST:
                product = (self.number({product: 1.0}).name,)
            found[self.product_of(product + factors)] = c * coefficient
        return found

    def collect(self, adjoint: Sum) -> Sum:
        """A sum as one product: what all its products share, and a sum of what is left of them."""
        shared: list[str] = list(next(iter(adjoint)))
        for product in adjoint:
            shared = [x for x in dict.fromkeys(shared) for _ in range(min(shared.count(x), product.count(x)))]
        size = min(map(abs, adjoint.values()))
        total: Any = None
        for product, coefficient in sorted(adjoint.items(), key=lambda item: item[1] < 0):
            rest = list(product)
            for x in shared:
                rest.remove(x)
            share = coefficient / size
            if total is None:
                total = self.number({tuple(rest): share})
            elif share < 0:
                total = total - self.number({tuple(rest): -share})
            else:
                total = total + self.number({tuple(rest): share})
        if isinstance(total, float):
            return {tuple(shared): total * size}
        return {self.product_of((*shared, total.name)): size}

    def number(self, adjoint: Sum) -> Any:
        """The value of a sum; constants and parameters are multiplied first: that is done ahead of a run."""
        if len(adjoint) > 1:
            adjoint = self.collect(adjoint)
        for product, coefficient in adjoint.items():
            value: Any = None if abs(coefficient) == 1 else abs(coefficient)
            for x in sorted(dict.fromkeys(product), key=lambda x: (x not in self.parameters, -self.place(x))):
                factor = self.number_of(x) ** product.count(x)
                value = factor if value is None else value * factor
            value = 1.0 if value is None else value
            return -value if coefficient < 0 else value
        return 0.0
