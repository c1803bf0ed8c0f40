"""Result tables in and out of CSV: typed reading, merging by key, digits that mean something.

New rows replace rows of the same key and leave the rest, so a partial run updates its own part.  Rows
stand in a fixed order and numbers have six significant digits (an error that is round-off one, a time
three), so that a rerun on the same machine gives the same file.  Files are replaced atomically.
"""

from __future__ import annotations

import contextlib
import csv
import logging
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from contactbench.errors import BadInput
from contactbench.results.round_off import floor
from contactbench.results.schema import Column, Table, Type

DIGITS, TIME_DIGITS, ROUND_OFF_DIGITS = 6, 3, 1
FLAGS = {"True": True, "False": False}
DTYPES = {"text": "str", "number": "float64", "whole": "Int64", "flag": "bool", "answer": "boolean"}
LOG = logging.getLogger("contactbench")
_said: set[str] = set()


class OldTable(BadInput):
    """A table written by another version, whose columns meant something else."""


# -- reading ---------------------------------------------------------------------------------------
def read(table: Table, results: Path) -> pd.DataFrame:
    """The table's rows, typed, timed columns included; empty if there is no file.

    Columns that the files lack are blank, columns that the table does not know are left out with a note.
    Raises `OldTable` for a file of another version and `BadInput` for one that is not this table.
    """
    untimed, *times = table.files(results)
    if not untimed.exists():
        return no_rows(tuple((name, column.type) for name, column in table.every_column.items())).copy()
    frame = part(table, untimed)
    for path in times:
        if path.exists():
            clock = part(table, path).drop(columns="schema")
            frame = frame.drop(columns=[name for name in table.timed if name in frame])
            frame = frame.merge(clock, how="left", on=list(table.key))
    return typed(frame.reindex(columns=[*table.every_column]), table)


def part(table: Table, path: Path) -> pd.DataFrame:
    """The rows of one of the table's files, keys typed, the rest as text."""
    try:
        frame = pd.read_csv(path, dtype=str, keep_default_na=False)
    except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError) as error:
        why = " ".join(str(error).split())
        raise BadInput(f"{path}: not a readable CSV ({why}); move it away or restore it") from None
    if "schema" not in frame or not set(table.key) & set(frame.columns):
        raise BadInput(f"{path}: columns are not those of table {table.name!r}; move it away or restore it")
    short = frame["schema"].isna() | (frame["schema"] == "")  # every row ends with it
    if short.any():
        at = line(path, int(np.flatnonzero(short)[0]))
        raise BadInput(f"{path}, line {at}: cut short; restore the file")
    old = sorted(set(frame["schema"]) - {str(table.version)})
    if old:
        raise OldTable(
            f"{path}: schema {', '.join(old)}, this version reads {table.version}; run the benchmark (tox -e bench)"
        )
    missing = [name for name in table.key if name not in frame]
    if missing:
        raise BadInput(
            f"{path}: no key columns {missing} of table {table.name!r}; move it away or restore it"
        )
    unknown = [name for name in frame if name not in table.every_column]
    if unknown:
        note(f"{path}: columns {unknown} are not known to this version and left out")
    frame = frame.drop(columns=unknown)
    for name in frame:
        bad = damaged(frame[name], table.every_column[name])
        if bad is not None:
            what = f"{path}, line {line(path, bad)}, column {name!r}: {frame[name].iloc[bad]!r}"
            raise BadInput(f"{what[:200]} is no {WORDS[table.every_column[name].type]}; restore the file")
    frame = typed(frame, table)
    double = frame.duplicated(list(table.key))
    if double.any():
        at = line(path, int(np.flatnonzero(double)[0]))
        raise BadInput(
            f"{path}, line {at}: the key {table.key} of an earlier row; move it away or restore it"
        )
    return frame


#: what the entries of a column are, in a message
WORDS = {
    "text": "text",
    "number": "finite number",
    "whole": "whole number",
    "flag": "True or False",
    "answer": "True or False",
}


def damaged(values: pd.Series, column: Column) -> int | None:
    """The first row of a column read as text whose entry is not of its type; blanks are no damage."""
    text = values.to_numpy(dtype=object)
    filled = np.flatnonzero(text != "")
    if column.type == "text" or not len(filled):
        return None
    given = text[filled]
    if column.type in ("flag", "answer"):
        wrong = np.array([entry not in FLAGS for entry in given])
    else:
        numbers = pd.to_numeric(given, errors="coerce").astype(float)
        wrong = ~np.isfinite(numbers)
        if column.type == "whole":
            wrong |= (numbers != np.round(numbers)) | (np.abs(numbers) > 2**53)
        if column.infinite:
            wrong &= (given != "inf") & (given != "-inf")
    return int(filled[wrong][0]) if wrong.any() else None


def line(path: Path, row: int) -> int:
    """The line of a file on which a row ends; the header is the first."""
    with path.open(encoding="utf-8", newline="") as file:
        lines = csv.reader(file)
        for number, _ in enumerate(lines):
            if number > row:
                break
        return lines.line_num


def note(message: str) -> None:
    """Say it once."""
    if message not in _said:
        _said.add(message)
        LOG.warning(message)


def typed(frame: pd.DataFrame, table: Table) -> pd.DataFrame:
    """The frame with its columns in the types of the table."""
    columns = table.every_column
    if frame.empty:
        return pd.DataFrame({name: pd.Series(dtype=DTYPES[columns[name].type]) for name in frame})
    for name in frame.columns:
        values = frame[name]
        try:
            right = converted(values, columns[name])
        except (ValueError, TypeError) as error:
            raise BadInput(f"table {table.name!r}, column {name!r}: {error}") from None
        if right is not values:
            frame[name] = right
    return frame


def converted(values: pd.Series, column: Column) -> pd.Series:
    """The values in the type of a column; blanks are missing, and empty text stays text.

    Infinity is blank as well, where it is no value of the column.
    """
    if values.dtype == DTYPES[column.type] and (column.type != "text" or not values.hasnans):
        if column.type != "number" or column.infinite or not np.isinf(values).any():
            return values
        return values.mask(np.isinf(values))
    if column.type == "text":
        return values.astype(object).where(values.notna(), "").astype(str)
    objects = values.to_numpy(dtype=object)
    filled = np.flatnonzero(~pd.isna(objects))
    filled = filled[objects[filled] != ""]
    if column.type in ("flag", "answer"):  # no flag is not set, no answer is none
        answers = pd.Series(
            False if column.type == "flag" else pd.NA, values.index, dtype=DTYPES[column.type]
        )
        for i in filled:
            if str(objects[i]) not in FLAGS:
                raise ValueError("neither True nor False")
            answers.iloc[i] = FLAGS[str(objects[i])]
        return answers
    numbers = np.full(len(values), np.nan)
    numbers[filled] = pd.to_numeric(objects[filled])
    if column.type == "whole":
        return pd.Series(numbers, values.index).astype("Int64")
    if not column.infinite:
        numbers[np.isinf(numbers)] = np.nan
    return pd.Series(numbers, values.index)


@cache
def no_values(kind: Type) -> pd.Series:
    """A column of this type without rows."""
    return converted(pd.Series([], dtype=object), Column("", kind))


@cache
def no_rows(columns: tuple[tuple[str, Type], ...]) -> pd.DataFrame:
    """A table without rows; shared, so to be copied."""
    return pd.DataFrame({name: no_values(kind) for name, kind in columns})


# -- writing ---------------------------------------------------------------------------------------
def merge(table: Table, rows: Iterable[Mapping[str, Any]], results: Path) -> pd.DataFrame:
    """Fold rows into the table's files; returns the merged table.

    A file of an older version is replaced: what it says can no longer be read.
    """
    try:
        old = read(table, results)
    except OldTable as error:
        note(f"{error}; replaced")
        old = pd.DataFrame(columns=[*table.every_column])
    new = canonical(table, rows)
    if new.empty:
        return old
    replaced = list(table.whole or table.key)
    kept = old[~index(old, replaced).isin(index(new, replaced))]
    frame = new if kept.empty else pd.concat([kept, new], ignore_index=True)
    frame = typed(in_order(frame, table), table)
    write(frame, table, results)
    return frame


def canonical(table: Table, rows: Iterable[Mapping[str, Any]]) -> pd.DataFrame:
    """Rows as the table has them: typed, with the digits that are written, the last of each key."""
    frame = pd.DataFrame(list(rows))
    unknown = set(frame.columns) - set(table.every_column)
    if unknown:
        raise BadInput(f"table {table.name!r} has no columns {sorted(unknown)}")
    frame["schema"] = table.version
    frame = typed(frame.reindex(columns=[*table.every_column]), table)
    return rounded(frame, table).drop_duplicates(list(table.key), keep="last")


def keys(table: Table, rows: Iterable[Mapping[str, Any]]) -> list[tuple[Any, ...]]:
    """The key of each row as it stands in the table; of all rows at once, a thousand times as fast as of each."""
    named = pd.DataFrame([{name: row.get(name) for name in table.key} for row in rows], columns=[*table.key])
    return list(index(rounded(typed(named, table), table), list(table.key)))


def forget(table: Table, made: set[tuple[Any, ...]], profiles: Iterable[str], results: Path) -> int:
    """Remove the rows of these profiles whose key is not among those made; returns how many."""
    frame = read(table, results)
    mine = frame["profile"].isin(list(profiles)).to_numpy(dtype=bool)
    known = np.array([key in made for key in index(frame, list(table.key))], dtype=bool)
    stale = mine & ~known
    if stale.any():
        write(frame[~stale], table, results)
    return int(stale.sum())


def index(frame: pd.DataFrame, names: list[str]) -> pd.Index:
    """The rows by some of their columns, as plain tuples."""
    return pd.Index(list(frame[names].astype(object).itertuples(index=False, name=None)), tupleize_cols=False)


def in_order(frame: pd.DataFrame, table: Table) -> pd.DataFrame:
    """Registry order for scenes and methods, coarse to fine for settings, then the other keys."""
    from contactbench.methods import METHODS
    from contactbench.scenes import SCENES

    ranks = {"scene": list(SCENES), "method": list(METHODS)}
    named = ["variant", "control", "value", "setting"] if "value" in frame and "setting" in table.key else []
    order = [name for key in table.key for name in (named if named and key == "setting" else [key])]

    def rank(column: pd.Series) -> pd.Series:
        if column.name in ranks:  # names of no registry, a plug-in's, after the others
            names = dict.fromkeys([*ranks[str(column.name)], *sorted(set(column))])
            return column.map({name: i for i, name in enumerate(names)})
        return -column if column.name == "value" else column

    return frame.sort_values(order, key=rank, kind="stable", ignore_index=True)


def write(frame: pd.DataFrame, table: Table, results: Path) -> None:
    """The table's files, each replaced atomically; a row without any time is not in the file of times."""
    for path, names in table.files(results).items():
        part = frame[names]
        if path != table.path(results):
            part = part[part[table.timed].notna().any(axis=1)]
            if part.empty:
                path.unlink(missing_ok=True)
                continue
        text = pd.DataFrame({name: written(part[name], table.every_column[name]) for name in names})
        with replacing(path) as file:
            text.to_csv(file, index=False, lineterminator="\n")


def written(values: pd.Series, column: Column) -> list[str]:
    """A column as text; errors in scientific notation."""
    if column.type != "number":
        return ["" if pd.isna(value) else str(value) for value in values]
    scientific = column.rule is not None and column.rule.decades
    return [
        "" if np.isnan(value)
        else np.format_float_scientific(value, unique=True, trim="-") if scientific and np.isfinite(value)
        else repr(value) if column.exact or not np.isfinite(value)
        else f"{value:.{DIGITS}g}"
        for value in values.astype(float).tolist()
    ]  # fmt: skip


def rounded(frame: pd.DataFrame, table: Table) -> pd.DataFrame:
    """The frame with the digits that are written: no more than say something."""
    for name in frame:
        column = table.every_column[name]
        if column.type == "number" and not column.exact and frame[name].notna().any():
            digits = np.full(len(frame), TIME_DIGITS if column.timed else DIGITS)
            digits[(frame[name].abs() <= floor(column.rule, frame)).to_numpy()] = ROUND_OFF_DIGITS
            frame[name] = [
                float(f"{value:.{n - 1}e}") for value, n in zip(frame[name], digits.tolist(), strict=True)
            ]
    return frame


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Any]:
    """A text file that takes the place of `path` when the block ends without an exception."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(temporary)
        raise
