"""The distance of two pilots of one problem, which is about the error of the coarser one."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import accumulate

import numpy as np

from contactbench.methods.prepared import Request
from contactbench.scene.scales import gaps, sizes_of
from contactbench.trace.compiled import compile_function
from contactbench.trace.form import Assign, Element, Function, Loop, Operation, Statement, Store, Update


def widen(most: str, name: str, load: tuple[Statement, ...]) -> tuple[Statement, ...]:
    """Return statements that compute the squared norm of a vector and keep the largest one in `most`.

    name : the variable that `load` puts a component into.  `lost` becomes nan if the norm is not finite.
    """
    square, total = f"{name}_square", f"{name}_sum"
    each = (
        *load,
        Assign(square, Operation("mul", (name, name))),
        Assign(f"{total}_more", Operation("add", (total, square))),
        Update((total,), (f"{total}_more",)),
    )
    return (
        Update((total,), (0.0,)),
        Loop("i", "length", each),
        Assign(f"{name}_larger", Operation("gt", (total, most))),
        Assign(f"{name}_most", Operation("where", (f"{name}_larger", total, most))),
        Assign(f"{name}_none", Operation("sub", (total, total))),
        Assign(f"{name}_lost", Operation("add", ("lost", f"{name}_none"))),
        Update((most, "lost"), (f"{name}_most", f"{name}_lost")),
    )


_start = Assign("first", Element("start", ("at",), "i"))
_fine = Assign("fine_c", Element("fine", ("at",), "i"))
_apart = (
    Assign("coarse_c", Element("coarse", ("at",), "i")),
    Assign("fine_d", Element("fine", ("at",), "i")),
    Assign("apart", Operation("sub", ("coarse_c", "fine_d"))),
)
#: computes the squares of max ‖coarse − fine‖ and max ‖fine‖ of a vector over all rows of states and the start;
#: `after` holds the number of rows, the place and the length of the vector, and then the two results
SQUARES = Function(
    "squares",
    ("start", "coarse", "fine", "after"),
    (
        Assign("width", Operation("len", ("start",))),
        Assign("rows", Element("after", (0,), kind="i")),
        Assign("begins", Element("after", (1,), kind="i")),
        Assign("length", Element("after", (2,), kind="i")),
        Update(("gap", "size", "lost", "at"), (0.0, 0.0, 0.0, "begins")),
        *widen("size", "first", (_start,)),
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
        Store(Element("after", (3,)), "gap_or_lost"),
        Store(Element("after", (4,)), "size"),
    ),
)


def distance(
    request: Request, start: np.ndarray, coarse: np.ndarray, fine: np.ndarray
) -> Callable[[], float]:
    """Return a function that computes the error of `coarse` against `fine` from the present content of the arrays.

    The arrays are packed states, (d,) and (k, d); the start belongs to both runs.  Infinite unless all are finite.
    """
    scene, carry = request.scene, request.carry
    acting = "s" in scene.carry(())
    if request.engine == "llvm" and not (scene.mixed or acting or scene.scale is not None or "R" in carry):
        return compiled(list(scene.vectors), start, coarse, fine)

    def distance() -> float:
        with np.errstate(all="ignore"):
            rows = np.vstack([start, fine])
            gap = float(gaps(scene, coarse, fine, sizes_of(scene, rows, carry), carry).max())
        return gap if math.isfinite(gap) and np.isfinite(fine).all() else math.inf

    return distance


def compiled(
    lengths: list[int], start: np.ndarray, coarse: np.ndarray, fine: np.ndarray
) -> Callable[[], float]:
    """Return the same, compiled; each vector counts relative to its largest norm, or to 1 if it is always zero."""
    squares, calls = compile_function(SQUARES), []
    for begins, length in zip(accumulate(lengths, initial=0), lengths, strict=False):
        after = np.array([len(fine), begins, length, 0.0, 0.0])
        calls.append((squares.closed(start, coarse.reshape(-1), fine.reshape(-1), after), after))

    def distance() -> float:
        largest = 0.0
        for call, after in calls:
            call()
            *_, gap, size = after.tolist()
            if not (gap < math.inf and size < math.inf):
                return math.inf
            largest = max(largest, gap / size if size > 0 else gap)
        return math.sqrt(largest)

    return distance
