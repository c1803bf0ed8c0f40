"""Which calls the speed part times: every method and engine, every scene, many saved times, the public calls."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import pandas as pd

from contactbench.methods import METHODS
from contactbench.solution import printed_setting

#: one of each kind, their kernels have no code in common; and a long one, where a fast loop outweighs its call
SCENES = ("particle", "particle_long", "rigid_body")
#: the methods that are timed on every other scene too, and the scene of the runs with many saved times
EVERYWHERE, MANY_ON = ("contact-rkn6", "rk4", "heyoka-taylor"), "particle"
#: how many saved times are many
MANY = 1000
#: of a method's settings the finest that takes at most so long; a method that has none is not timed there
LONGEST = 3e-3


@dataclass(frozen=True)
class Cell:
    """One call that is timed.

    saves : how many equidistant times are saved, the end among them.  call : a key of `speed_worker.CALLS`.
    """

    scene: str
    method: str
    engine: str
    control: str
    value: float
    carry: tuple[str, ...]
    saves: int = 1
    call: str = "prepared"

    @property
    def kind(self) -> str:
        """Its method, or the public call that it is."""
        return self.method if self.call == "prepared" else self.call

    @property
    def setting(self) -> str:
        many = f", {self.saves} saved times" if self.saves > 1 else ""
        call = f", {self.call}" if self.call != "prepared" else ""
        return f"{printed_setting(self.control, self.value)}{many}{call}"

    def request(self) -> dict[str, Any]:
        return asdict(self)


#: what a user calls, on standard scenes; references on those where they take little
PUBLIC = tuple(
    Cell(scene, "contact-rkn6", "numba", "step", 0.1, (), call=call)
    for scene, call in (
        ("particle", "solve"), ("particle", "run(q=…)"), ("particle", "ensemble"), ("oscillator", "reference"),
        ("saddle_edge", "live reference"), ("particle", "import"),
    )
)  # fmt: skip


def workload(work: pd.DataFrame) -> list[Cell]:
    """Cells for every method and engine of the work–precision table, at settings that are worth timing.

    On every scene but those named `EVERYWHERE` alone; with many saved times the first engine of each method; and
    the public calls.
    """
    timed = work[(work["variant"] == "") & (work["family"] != "limit") & (work["time_median_s"] <= LONGEST)]
    slowest = timed.sort_values("time_median_s").groupby(["scene", "method", "engine"], sort=False).tail(1)
    cells: list[Cell] = []
    many: dict[str, Cell] = {}
    for _, row in slowest.sort_index().iterrows():
        carry = tuple(field for field in ("s", "R") if field in row["carried"].split())
        words = row["scene"], row["method"], row["engine"], row["control"], float(row["value"]), carry
        if row["scene"] in SCENES or row["method"] in EVERYWHERE:
            cells.append(Cell(*words))
        if row["scene"] == MANY_ON:
            cell = Cell(*words, saves=MANY)
            many[cell.method] = min(many.get(cell.method, cell), cell, key=preference)
    return [*cells, *many.values(), *PUBLIC] if cells else []


def preference(cell: Cell) -> int:
    """Where the engine of a cell stands among those of its method."""
    engines = METHODS[cell.method].engines if cell.method in METHODS else ()
    return engines.index(cell.engine) if cell.engine in engines else len(engines)
