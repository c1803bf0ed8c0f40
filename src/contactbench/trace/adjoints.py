"""Reverse mode: the derivatives of a recorded result along what it was computed from."""

from __future__ import annotations

from heapq import heappop, heappush
from typing import Any

from contactbench.numbers.dual import DERIVATIVES
from contactbench.numbers.protocol import CannotRecord
from contactbench.trace.recording import FormulaTape, Place, Recorded, RecordedNumbers

#: factors a product is written out to
LONGEST = 8
#: a product of the numbers at some places, and sums of them: place … place → coefficient
Product = tuple[int, ...]
Sum = dict[Product, float]


class Adjoints:
    """Derivatives of one result along what it was computed from, the last operation first.

    They are kept as sums of products of numbers, so that equal products meet, constants are multiplied ahead of
    the run, and what all products share is multiplied once: short code, which is what a force is to be.

    Griewank, Walther, Evaluating Derivatives, 2nd ed., SIAM 2008, §3.2, doi:10.1137/1.9780898717761.
    """

    def __init__(self, tape: FormulaTape, parameters: range) -> None:
        self.tape, self.parameters = tape, parameters
        self.found: dict[int, Sum] = {}
        self.waiting: list[int] = []

    def along(self, result: Place, n: int) -> list[Any]:
        """The derivatives of a result along the first n arguments."""
        first = len(self.tape.arguments)
        self.add(result, {(): 1.0})
        while self.waiting:
            place = -heappop(self.waiting)
            function, _, operands = self.tape.steps[place - first]
            self.share(function, operands, place, self.found.pop(place))
        return [self.number(self.found[i]) if i in self.found else 0.0 for i in range(n)]

    def add(self, operand: Place, amount: Sum) -> None:
        """Add to the derivative along an operand."""
        if isinstance(operand, float):
            return
        if operand not in self.found:
            self.found[operand] = {}
            if operand >= len(self.tape.arguments):
                heappush(self.waiting, -operand)
        found = self.found[operand]
        for product, coefficient in amount.items():
            found[product] = found.get(product, 0.0) + coefficient
            if not found[product]:
                del found[product]

    def share(self, function: str, operands: tuple[Place, ...], place: int, adjoint: Sum) -> None:
        """Add to the operands of an operation what its adjoint is worth to them."""
        xp, y = RecordedNumbers(self.tape), self.tape.at(place)
        x = [self.tape.value(operand) for operand in operands]
        match function:
            case "add":
                self.add(operands[0], adjoint)
                self.add(operands[1], adjoint)
            case "sub":
                self.add(operands[0], adjoint)
                self.add(operands[1], {product: -c for product, c in adjoint.items()})
            case "div" if operands[0] == 1.0 and isinstance(operands[0], float):
                self.add(operands[1], self.times(adjoint, -1.0, (place, place)))
            case "neg" | "mul" | "div":
                coefficient, factors = self.product(place)
                for factor in dict.fromkeys(factors):
                    rest = list(factors)
                    rest.remove(factor)
                    times = coefficient * factors.count(factor)
                    self.add(factor, self.times(adjoint, times, tuple(rest)))
            case "pow" if isinstance(x[1], float):
                self.chain(operands[0], adjoint, x[0] ** (x[1] - 1), x[1])
            case "pow":
                if not isinstance(x[0], float):
                    self.chain(operands[0], adjoint, x[1] * x[0] ** (x[1] - 1))
                self.chain(operands[1], adjoint, y * xp.log(x[0]))
            case "abs":
                self.chain(operands[0], adjoint, xp.where(x[0] < 0, -1.0, 1.0))
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

    def chain(self, operand: Place, adjoint: Sum, slope: Any, coefficient: float = 1.0) -> None:
        """Add adjoint · coefficient · slope to the derivative along an operand."""
        if isinstance(slope, Recorded):
            times, factors = self.product(self.tape.operand(slope))
            self.add(operand, self.times(adjoint, coefficient * times, factors))
        elif slope:
            self.add(operand, self.times(adjoint, coefficient * slope, ()))

    def product(self, operand: Place) -> tuple[float, Product]:
        """An operand as a product of a constant and numbers, quotients as products with reciprocals."""
        if isinstance(operand, float):
            return operand, ()
        first = len(self.tape.arguments)
        if operand < first:
            return 1.0, (operand,)
        function, _, operands = self.tape.steps[operand - first]
        if function == "neg":
            coefficient, factors = self.product(operands[0])
            return -coefficient, factors
        if function == "div" and isinstance(operands[1], float):
            coefficient, factors = self.product(operands[0])
            return coefficient / operands[1], factors
        if function == "div":
            if isinstance(operands[0], float) and operands[0] == 1.0:
                return 1.0, (operand,)
            inverse = self.tape.operation("div", "f", 1.0, self.tape.value(operands[1]))
            operands = (operands[0], self.tape.operand(inverse))
        elif function != "mul":
            return 1.0, (operand,)
        (a, left), (b, right) = map(self.product, operands)
        if len(left) + len(right) > LONGEST:
            return 1.0, (operand,) if function == "mul" else tuple(o for o in operands if isinstance(o, int))
        return a * b, tuple(sorted(left + right))

    def times(self, adjoint: Sum, coefficient: float, factors: Product) -> Sum:
        """A sum times a product."""
        if not adjoint:
            return adjoint
        if len(adjoint) > 1 and (factors or coefficient != 1.0):
            adjoint = self.collected(adjoint)
        found: Sum = {}
        for product, c in adjoint.items():
            if len(product) + len(factors) > LONGEST:
                product = (self.tape.operand(self.number({product: 1.0})),)  # type: ignore[assignment]
            found[tuple(sorted(product + factors))] = c * coefficient
        return found

    def collected(self, adjoint: Sum) -> Sum:
        """A sum as one product: what all its products share, and a sum of what is left of them."""
        shared: list[int] = list(next(iter(adjoint)))
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
        return {tuple(sorted([*shared, self.tape.places[total.name]])): size}

    def number(self, adjoint: Sum) -> Any:
        """The value of a sum; constants and parameters are multiplied first: that is done ahead of a run."""
        if len(adjoint) > 1:
            adjoint = self.collected(adjoint)
        for product, coefficient in adjoint.items():
            value: Any = None if abs(coefficient) == 1 else abs(coefficient)
            for x in sorted(dict.fromkeys(product), key=lambda x: (x not in self.parameters, -x)):
                factor = self.tape.at(x) ** product.count(x)
                value = factor if value is None else value * factor
            value = 1.0 if value is None else value
            return -value if coefficient < 0 else value
        return 0.0
