"""How far two runs of one problem are apart: the error of the coarser one, as pilots are compared by it."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from contactbench.trace.compiled import compile_function
from contactbench.trace.form import (
    Assign,
    Element,
    Function,
    Loop,
    Operation,
    Statement,
    Store,
    Update,
    execute,
)


def widen(most: str, name: str, load: tuple[Statement, ...]) -> tuple[Statement, ...]:
    """Return what takes the norm of what is loaded as `name` for every component, in units, and keeps the largest.

    The norm is squared; `lost` is nan from then on if it is not finite.
    """
    part, square, total = f"{name}_part", f"{name}_square", f"{name}_sum"
    each = (
        *load,
        Assign(f"{name}_unit", Element("units", ("i",))),
        Assign(part, Operation("div", (name, f"{name}_unit"))),
        Assign(square, Operation("mul", (part, part))),
        Assign(f"{total}_more", Operation("add", (total, square))),
        Update((total,), (f"{total}_more",)),
    )
    return (
        Update((total,), (0.0,)),
        Loop("i", "motion", each),
        Assign(f"{name}_larger", Operation("gt", (total, most))),
        Assign(f"{name}_most", Operation("where", (f"{name}_larger", total, most))),
        Assign(f"{name}_none", Operation("sub", (total, total))),
        Assign(f"{name}_lost", Operation("add", ("lost", f"{name}_none"))),
        Update((most, "lost"), (f"{name}_most", f"{name}_lost")),
    )


_fine = Assign("fine_c", Element("fine", ("at",), "i"))
_apart = (
    Assign("coarse_c", Element("coarse", ("at",), "i")),
    Assign("fine_d", Element("fine", ("at",), "i")),
    Assign("apart", Operation("sub", ("coarse_c", "fine_d"))),
)
#: the squares of max ‖coarse − fine‖ and max ‖fine‖ over rows of states, in units, the start included
SQUARES = Function(
    "squares",
    ("start", "coarse", "fine", "units", "after"),
    (
        Assign("width", Operation("len", ("start",))),
        Assign("motion", Operation("len", ("units",))),
        Update(("gap", "size", "lost", "at"), (0.0, 0.0, 0.0, 0)),
        *widen("size", "first", (Assign("first", Element("start", ("i",))),)),
        Assign("rows", Element("after", (1,), kind="i")),
        Loop(
            "row",
            "rows",
            (
                *widen("gap", "apart", _apart),
                *widen("size", "fine_c", (_fine,)),
                Assign("next", Operation("add", ("at", "width"))),
                Update(("at",), ("next",)),
            ),
        ),
        Assign("gap_or_lost", Operation("add", ("gap", "lost"))),
        Store(Element("after", (0,)), "gap_or_lost"),
        Store(Element("after", (2,)), "size"),
    ),
)


def distance(
    start: np.ndarray, coarse: np.ndarray, fine: np.ndarray, units: np.ndarray, compiled: bool
) -> Callable[[], float]:
    """Return the function that gives max ‖coarse − fine‖ / max ‖fine‖ of what these arrays hold when it is called.

    They are packed states, (d,) and (k, d), the start is part of both runs; units : of the first components, all others
    are left out.  Infinite unless all are finite.
    """
    after = np.array([0.0, len(fine), 0.0])
    given = start, coarse.reshape(-1), fine.reshape(-1), units, after
    if compiled:
        call: Callable[[], object] = compile_function(SQUARES).closed(*given)
    else:
        in_python = execute(SQUARES)

        def call() -> None:
            *read, found = (part.tolist() for part in given)
            in_python(*read, found)
            after[:] = found

    def distance() -> float:
        call()
        gap, _, size = after.tolist()
        if gap < math.inf and size < math.inf:
            return math.sqrt(gap / size) if size > 0 else 0.0
        return math.inf

    return distance
