"""Names removed on purpose; ``removed.toml``, beside the tables being judged, lists them."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from fnmatch import fnmatchcase
from pathlib import Path

import pandas as pd

from contactbench.tables.schema import Table
from contactbench.tables.store import set_types


@dataclass(frozen=True)
class Removed:
    """The list of removed names.  Their rows are left out of an older table; all other rows are compared as usual.

    columns : patterns of TABLE.COLUMN.
    """

    tables: Sequence[str] = ()
    scenes: Sequence[str] = ()
    methods: Sequence[str] = ()
    columns: Sequence[str] = ()

    @classmethod
    def read(cls, results: Path) -> Removed:
        path = results / "removed.toml"
        given = tomllib.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        return cls(**{field.name: given.get(field.name, ()) for field in fields(cls)})

    def take_out(self, table: Table, rows: pd.DataFrame) -> pd.DataFrame:
        gone = pd.Series(table.name in self.tables, rows.index)
        for name, names in {"scene": self.scenes, "method": self.methods}.items():
            if name in table.key:
                gone |= rows[name].isin(names)
        free = [name for name in rows if name not in table.key]
        lost = [n for n in free if any(fnmatchcase(f"{table.name}.{n}", each) for each in self.columns)]
        if not lost and not gone.any():
            return rows
        kept = rows[~gone].drop(columns=lost)
        return set_types(kept.reindex(columns=rows.columns), table)

    def remains(self, table: Table, rows: pd.DataFrame) -> bool:
        """Return whether a table still contains something listed as removed."""
        return not self.take_out(table, rows).equals(rows)
