"""Names removed or changed on purpose; ``removed.toml``, beside the tables being judged, lists them."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import pandas as pd

from contactbench.tables.schema import Table
from contactbench.tables.store import set_types


@dataclass(frozen=True)
class Removed:
    """The list of removed names.  Their rows are left out of an older table; all other rows are compared as usual.

    columns : patterns of TABLE.COLUMN.  engines : old name → new one.  engine_of : engine → the pattern of the
    methods that still run on it.
    """

    tables: Sequence[str] = ()
    scenes: Sequence[str] = ()
    methods: Sequence[str] = ()
    columns: Sequence[str] = ()
    engines: dict[str, str] = field(default_factory=dict)
    engine_of: dict[str, str] = field(default_factory=dict)

    @classmethod
    def read(cls, results: Path) -> Removed:
        path = results / "removed.toml"
        return cls(**tomllib.loads(path.read_text(encoding="utf-8"))) if path.exists() else cls()

    def take_out(self, table: Table, rows: pd.DataFrame) -> pd.DataFrame:
        gone = pd.Series(table.name in self.tables, rows.index)
        for name, names in {"scene": self.scenes, "method": self.methods}.items():
            if name in table.key:
                gone |= rows[name].isin(names)
        if "engine" in table.columns:
            for engine, methods in self.engine_of.items():
                others = [not fnmatchcase(method, methods) for method in rows["method"]]
                gone |= (rows["engine"] == engine) & np.array(others, dtype=bool)
            rows = rows.assign(engine=rows["engine"].replace(self.engines))
        free = [name for name in rows if name not in table.key]
        lost = [n for n in free if any(fnmatchcase(f"{table.name}.{n}", each) for each in self.columns)]
        return set_types(rows[~gone].drop(columns=lost).reindex(columns=rows.columns), table)

    def remains(self, table: Table, rows: pd.DataFrame) -> bool:
        """Return whether a table still contains something listed as removed."""
        return not self.take_out(table, rows).equals(rows)
