"""Read and write result tables as CSV, and merge new rows by key.

New rows replace rows of the same key and leave the rest, so that a partial run updates only its own part.  Rows have a
fixed order and numbers six significant digits (times three, round-off one), so that a rerun on the same machine gives
the same file.  Files are replaced atomically.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Collection, Iterable, Sequence
from functools import cache
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from contactbench.errors import BadInput
from contactbench.files import replacing
from contactbench.tables.schema import Column, Row, Table, floor

DIGITS, TIME_DIGITS, ROUND_OFF_DIGITS = 6, 3, 1
FLAGS = {"True": True, "False": False, True: True, False: False}
#: pandas types, and words for messages, by type of column
DTYPES = {"text": "str", "number": "float64", "whole": "Int64", "flag": "bool", "answer": "boolean"}
WORDS = {"number": "finite number", "whole": "whole number", "flag": "truth value", "answer": "truth value"}
LOG = logging.getLogger("contactbench")

type Key = tuple[object, ...]  #: the values of a row's key columns


class OldTable(BadInput):
    """Report a table that another version wrote, with other columns."""


# -- reading ---------------------------------------------------------------------------------------
def read(table: Table, results: Path) -> pd.DataFrame:
    """Return the rows of a table with typed columns; no rows if there is no file.

    Columns that the file lacks are blank; unknown columns are left out with a warning.  Raises `OldTable` if the file
    lacks a key column, since another version wrote it, and `BadInput` if it is damaged or another table.
    """
    path = table.path(results)
    frame = read_file(table, path) if path.exists() else pd.DataFrame()
    return set_types(frame.reindex(columns=[*table.columns]), table)


def read_file(table: Table, path: Path) -> pd.DataFrame:
    try:
        frame = pd.read_csv(path, dtype=str, keep_default_na=False)
    except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError) as error:
        why = " ".join(str(error).split())
        raise BadInput(f"{path}: not a readable CSV ({why}); move it away or restore it") from None
    if not set(table.key) & set(frame):
        raise BadInput(f"{path}: columns are not those of table {table.name!r}; move it away or restore it")
    if lacking := [name for name in table.key if name not in frame]:
        raise OldTable(
            f"{path}: no column {lacking[0]!r}, of another version; run the benchmark (tox -e bench)"
        )
    last = pd.Series(frame.index == len(frame) - 1)
    require(path, last & (not path.read_bytes().endswith(b"\n")), ": cut short; restore the file")
    unknown = [name for name in frame if name not in table.columns]
    if unknown:
        note(f"{path}: columns {unknown} are not known to this version and left out")
    frame = frame.drop(columns=unknown)
    typed = {}
    for name, values in frame.items():
        column = table.columns[str(name)]
        typed[name] = parse(values, column)
        if (wrong := lost(values, typed[name])).any():
            value = repr(values[wrong].iloc[0])[:100]
            require(path, wrong, f", column {name!r}: {value} is no {WORDS[column.type]}; restore the file")
    frame = pd.DataFrame(typed, index=frame.index)
    double = frame.duplicated(list(table.key))
    require(path, double, f": the key {table.key} of an earlier row; move it away or restore it")
    return frame


def require(path: Path, wrong: pd.Series, why: str) -> None:
    if wrong.any():
        raise BadInput(f"{path}, line {int(np.flatnonzero(wrong)[0]) + 2}{why}")


@cache
def note(message: str) -> None:
    LOG.warning(message)


def set_types(frame: pd.DataFrame, table: Table) -> pd.DataFrame:
    """Convert columns to the types of the table; missing flags become False, infinities that are no value blank."""
    found = {}
    for name, values in frame.items():
        column = table.columns[str(name)]
        typed = parse(values, column)
        found[name] = typed.to_numpy(bool, na_value=False) if column.type == "flag" else typed
    return pd.DataFrame(found, index=frame.index)


def parse(values: pd.Series, column: Column) -> Any:
    """Return the values as an array of the column's type, blank where they have none."""
    given = values.dtype == DTYPES[column.type]
    if column.type == "text":
        return (values if given else values.astype(object)).fillna("").astype(str).array
    if given and column.type != "number":
        return values.array
    if column.type in ("flag", "answer"):
        return pd.array([FLAGS.get(value) for value in values], dtype="boolean")
    numbers = (values if given else pd.to_numeric(values, errors="coerce")).to_numpy(float, na_value=math.nan)
    if column.type == "whole":
        fits = (numbers == np.round(numbers)) & (np.abs(numbers) <= 2**53)
        return pd.array(np.where(fits, numbers, math.nan), dtype="Int64")
    return numbers if column.infinite else np.where(np.isinf(numbers), math.nan, numbers)


def lost(values: pd.Series, typed: Any) -> pd.Series:
    """Return where a text of a file has no value of its column's type."""
    missing = np.asarray(pd.isna(typed))
    if missing.any():
        missing &= (values.notna() & (values != "")).to_numpy(bool)
    return pd.Series(missing, values.index)


def check(table: Table, row: Row) -> None:
    """Raise `BadInput` for a row with a column or a value that the table cannot take."""
    columns = table.columns
    for name, value in row.items():
        if name not in columns:
            raise BadInput(
                f"table {table.name!r} has no column {name!r}; columns: {', '.join(table.columns)}"
            )
        kind = columns[name].type
        if value is None or kind == "text":
            continue
        if kind in ("flag", "answer"):
            fits = isinstance(value, bool | np.bool_)
        elif kind == "whole" and isinstance(value, Real) and math.isfinite(value):
            fits = value == round(value) and abs(float(value)) <= 2**53
        else:
            fits = isinstance(value, Real)
        if not fits:
            raise BadInput(f"table {table.name!r}, column {name!r}: {value!r} is no {WORDS[kind]}")


# -- writing ---------------------------------------------------------------------------------------
def merge(
    table: Table,
    rows: Iterable[Row],
    results: Path,
    made: Iterable[Key] | None = None,
    profiles: Sequence[str] = (),
    others: Collection[str] = (),
) -> pd.DataFrame:
    """Merge rows into the file of a table and return the merged table; a file of an older version is replaced.

    made : keys of all rows that the profiles make, if a run made the whole table; other rows of these profiles are
    dropped with a warning.  others : scenes and methods whose rows stay anyway.
    """
    try:
        old = read(table, results)
    except OldTable as error:
        note(f"{error}; replaced")
        old = set_types(pd.DataFrame(columns=[*table.columns]), table)
    new = canonical(table, rows)
    replaced = list(table.whole or table.key)
    frame = pd.concat([old[~index(old, replaced).isin(index(new, replaced))], new], ignore_index=True)
    if made is not None:
        known = index(frame, list(table.key)).isin(pd.Index(made, tupleize_cols=False))
        named = [frame[name].isin(["", *others]) for name in ("scene", "method") if name in frame]
        elsewhere = np.logical_and.reduce(named) if others and named else np.zeros(len(frame), bool)
        larger = ~frame["profile"].isin(profiles) if "profile" in frame else "standard" not in profiles
        stays = known | larger | elsewhere
        name_dropped(table, frame[~stays])
        frame = frame[stays]
    if new.empty and len(frame) == len(old):
        return old
    frame = set_types(in_order(frame, table), table)
    write(frame, table, results)
    return frame


MOST_DROPPED_NAMED = 3


def name_dropped(table: Table, rows: pd.DataFrame) -> None:
    if len(rows):
        where = [
            " ".join(filter(None, map(str, key))) for key in index(rows, list(table.key))[:MOST_DROPPED_NAMED]
        ]
        more = ", …" * (len(rows) > MOST_DROPPED_NAMED)
        LOG.warning(
            f"{table.name}: dropped {len(rows)} rows that no profile makes any more: {', '.join(where)}{more}"
        )


def canonical(table: Table, rows: Iterable[Row]) -> pd.DataFrame:
    rows = list(rows)
    for row in rows:
        check(table, row)
    frame = pd.DataFrame(rows)
    frame = set_types(frame.reindex(columns=[*table.columns]), table)
    return round_digits(frame, table).drop_duplicates(list(table.key), keep="last")


def keys(table: Table, rows: Iterable[Row]) -> list[Key]:
    named = pd.DataFrame([{name: row.get(name) for name in table.key} for row in rows], columns=[*table.key])
    return list(index(round_digits(set_types(named, table), table), list(table.key)))


def index(frame: pd.DataFrame, names: list[str]) -> pd.Index:
    return pd.Index(list(frame[names].astype(object).itertuples(index=False, name=None)), tupleize_cols=False)


def in_order(frame: pd.DataFrame, table: Table) -> pd.DataFrame:
    from contactbench.methods import METHODS
    from contactbench.scenes import SCENES

    ranks = {"scene": list(SCENES), "method": list(METHODS)}

    def rank(column: pd.Series) -> pd.Series:
        if column.name in ranks:  # unregistered names, of plug-ins not loaded, come last
            names = dict.fromkeys([*ranks[str(column.name)], *sorted(set(column))])
            return column.map({name: i for i, name in enumerate(names)})
        return -column if column.name == "setting" else column

    return frame.sort_values(list(table.key), key=rank, kind="stable", ignore_index=True)


def write(frame: pd.DataFrame, table: Table, results: Path) -> None:
    text = pd.DataFrame({name: as_text(frame[name], column) for name, column in table.columns.items()})
    with replacing(table.path(results)) as file:
        text.to_csv(file, index=False, lineterminator="\n")


def as_text(values: pd.Series, column: Column) -> list[str]:
    """Return a column as text; numbers in full if exact, in scientific notation if errors, else with six digits."""

    def number_text(value: float) -> str:
        if column.exact or math.isinf(value):
            return repr(value)
        if column.rule is not None and column.rule.decades:
            return np.format_float_scientific(value, unique=True, trim="-")
        return f"{value:.{DIGITS}g}"

    write_one = number_text if column.type == "number" else str
    return ["" if pd.isna(value) else write_one(value) for value in values.tolist()]


def round_digits(frame: pd.DataFrame, table: Table) -> pd.DataFrame:
    for name in frame:
        column = table.columns[name]
        if column.type == "number" and not column.exact and frame[name].notna().any():
            digits = np.full(len(frame), TIME_DIGITS if column.timed else DIGITS)
            digits[(frame[name].abs() <= floor(column.rule, frame)).to_numpy()] = ROUND_OFF_DIGITS
            pairs = zip(frame[name], digits.tolist(), strict=True)
            frame[name] = [float(f"{value:.{n - 1}e}") for value, n in pairs]
    return frame
