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


def largest(name: str, value: str) -> tuple[Statement, ...]:
    """Return what makes of a variable the larger of itself and a value, and of `lost` nan where that is not finite."""
    return (
        Assign(f"{value}_more", Operation("gt", (value, name))),
        Assign(f"{value}_most", Operation("where", (f"{value}_more", value, name))),
        Assign(f"{value}_none", Operation("sub", (value, value))),
        Assign(f"{value}_lost", Operation("add", ("lost", f"{value}_none"))),
        Update((name, "lost"), (f"{value}_most", f"{value}_lost")),
    )


_component = (
    Assign("unit", Element("units", ("i",))),
    Assign("a", Element("coarse", ("at",), "i")),
    Assign("b", Element("fine", ("at",), "i")),
    Assign("a_b", Operation("sub", ("a", "b"))),
    Assign("apart", Operation("div", ("a_b", "unit"))),
    Assign("away", Operation("div", ("b", "unit"))),
    Assign("apart_2", Operation("mul", ("apart", "apart"))),
    Assign("away_2", Operation("mul", ("away", "away"))),
    Assign("gap_more", Operation("add", ("gap", "apart_2"))),
    Assign("size_more", Operation("add", ("size", "away_2"))),
    Update(("gap", "size"), ("gap_more", "size_more")),
)
_row = (
    Assign("at", Operation("mul", ("row", "width"))),
    Update(("gap", "size"), (0.0, 0.0)),
    Loop("i", "motion", _component),
    *largest("widest", "gap"),
    *largest("longest", "size"),
)
#: the squares of max ‖coarse − fine‖ and max ‖fine‖ over rows of states, in units; nan where one is not finite
SQUARES = Function(
    "squares",
    ("coarse", "fine", "units", "shape", "after"),
    (
        Assign("rows", Element("shape", (0,), kind="i")),
        Assign("width", Element("shape", (1,), kind="i")),
        Assign("motion", Operation("len", ("units",))),
        Update(("widest", "longest", "lost"), (0.0, 0.0, 0.0)),
        Loop("row", "rows", _row),
        Assign("square", Operation("add", ("widest", "lost"))),
        Store(Element("after", (0,)), "square"),
        Store(Element("after", (1,)), "longest"),
    ),
)


class Distance:
    """Return max ‖coarse − fine‖ / max ‖fine‖ of rows of packed states, (k, d); infinite unless all are finite.

    units : of the first components, all others are left out.  compiled : by LLVM, in no time.
    """

    def __init__(self, rows: int, width: int, units: np.ndarray, compiled: bool) -> None:
        self.shape, self.units, self.compiled = (rows, width), np.array(units, dtype=float), compiled
        self.spare: list[tuple[np.ndarray, np.ndarray, Callable[[], object], np.ndarray]] = []

    def memory(self) -> tuple[np.ndarray, np.ndarray, Callable[[], object], np.ndarray]:
        """Return room for two runs, the call that compares them, and where it writes to."""
        coarse, fine, after = np.empty(self.shape), np.empty(self.shape), np.empty(2)
        shape = np.array(self.shape, dtype=np.int64)
        given = coarse.reshape(-1), fine.reshape(-1), self.units, shape, after
        if self.compiled:
            return coarse, fine, compile_function(SQUARES).closed(*given), after
        in_python = execute(SQUARES)

        def call() -> None:
            *read, found = (part.tolist() for part in given)
            in_python(*read, found)
            after[:] = found

        return coarse, fine, call, after

    def __call__(self, coarse: np.ndarray, fine: np.ndarray) -> float:
        try:
            own = self.spare.pop()  # no other thread has it meanwhile
        except IndexError:
            own = self.memory()
        a, b, call, after = own
        a[...] = coarse
        b[...] = fine
        call()
        gap, size = after.tolist()
        self.spare.append(own)
        if not (gap < math.inf and size < math.inf):
            return math.inf
        return math.sqrt(gap / size) if size > 0 else 0.0
