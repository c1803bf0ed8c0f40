"""Recorded functions printed as Python, and run by Python itself: arrays are lists of lists there."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from contactbench.trace import form
from contactbench.trace.form import text

#: operations that are no calls
NAMES = ("add", "sub", "mul", "div", "pow", "lt", "le", "gt", "ge", "eq", "ne", "and", "or")
SIGNS = ("+", "-", "*", "/", "**", "<", "<=", ">", ">=", "==", "!=", "and", "or")
FORMS = {
    **{name: f"{{}} {sign} {{}}" for name, sign in zip(NAMES, SIGNS, strict=True)},
    "neg": "-{}",
    "not": "not {}",
    "where": "{1} if {0} else {2}",
}
#: the names that printed functions use
SCOPE = {name: getattr(math, name) for name in (*form.FUNCTIONS, "atan2", "hypot", "inf", "nan")}
READ = {"f": "{}", "i": "int({})", "b": "{} != 0.0"}


def execute(
    function: form.Function, forms: Mapping[str, str] = FORMS, scope: Mapping[str, Any] = SCOPE
) -> Callable[..., Any]:
    """The function, run by Python; forms : how operations are written, scope : what names stand for."""
    names = dict(scope)
    exec(source(function, forms), names)
    return names[function.name]


def source(function: form.Function, forms: Mapping[str, str] = FORMS) -> str:
    head = f"def {function.name}({', '.join(function.arguments)}):"
    return "\n".join([head, *lines(function.body, forms), f"    return {render(function.result)}", ""])


def render(results: form.Results) -> str:
    if isinstance(results, tuple):
        return f"({''.join(f'{render(part)}, ' for part in results)})"
    return text(results)


def place(element: form.Element) -> str:
    *rows, last = map(text, element.indices)
    if element.shift != 0:
        last = f"{last} + {text(element.shift)}"
    return "".join([element.array, *(f"[{index}]" for index in (*rows, last))])


def value(expression: form.Operation | form.Element, forms: Mapping[str, str]) -> str:
    if isinstance(expression, form.Element):
        return READ[expression.kind].format(place(expression))
    function, operands = expression
    template = forms.get(function) or f"{function}({', '.join(['{}'] * len(operands))})"
    return template.format(*map(text, operands))


def lines(body: Sequence[Any], forms: Mapping[str, str] = FORMS, indent: str = "    ") -> Iterator[str]:
    within = indent + "    "
    for statement in body:
        match statement:
            case form.Assign(target, expression):
                yield f"{indent}{target} = {value(expression, forms)}"
            case form.Update(variables, values):
                yield f"{indent}{', '.join(variables)} = {', '.join(map(text, values))}"
            case form.Unpack(targets, sequence):
                yield f"{indent}{', '.join(targets)}, = {sequence}"
            case form.Store(element, stored):
                number = f"1.0 if {text(stored)} else 0.0" if element.kind == "b" else text(stored)
                yield f"{indent}{place(element)} = {number}"
            case form.Loop(index, times, inner):
                yield f"{indent}for {index} in range({text(times)}):"
                yield from lines(inner, forms, within)
            case form.While(test, condition, inner):
                yield f"{indent}while True:"
                yield from lines(test, forms, within)
                yield f"{within}if not {text(condition)}:"
                yield f"{within}    break"
                yield from lines(inner, forms, within)
