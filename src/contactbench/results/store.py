"""Result tables in and out of CSV: typed reading, merging by key, digits that mean something.

New rows replace rows of the same key and leave the rest, so a partial run updates its own part.  Rows
stand in a fixed order and numbers have six significant digits (an error that is round-off one, a time
three), so that a rerun on the same machine gives the same file.  Files are replaced atomically.
"""

from __future__ import annotations

import contextlib
import csv
import logging
import math
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from contactbench.errors import BadInput
from contactbench.results.round_off import floor
from contactbench.results.schema import Column, Table

DIGITS, TIME_DIGITS, ROUND_OFF_DIGITS = 6, 3, 1
FLAGS = {"True": True, "False": False, True: True, False: False}
DTYPES = {"text": "str", "number": "float64", "whole": "Int64", "flag": "bool", "answer": "boolean"}
#: entries of a column, in a message
WORDS = {
    "number": "finite number",
    "whole": "whole number",
    "flag": "True or False",
    "answer": "True or False",
}
LOG = logging.getLogger("contactbench")


class OldTable(BadInput):
    """A table written by another version, whose columns meant something else."""


# -- reading ---------------------------------------------------------------------------------------
def read(table: Table, results: Path) -> pd.DataFrame:
    """Return the table's rows, typed, timed columns included; none if there is no file.

    Columns that the files lack are blank, columns that the table does not know are left out with a note.
    Raises `OldTable` for a file of another version and `BadInput` for one that is not this table.
    """
    untimed, *times = table.files(results)
    if not untimed.exists():
        return no_rows(table)
    frame = part(table, untimed)
    for path in times:
        if path.exists():
            clock = part(table, path).drop(columns="schema")
            frame = frame.drop(columns=[name for name in table.timed if name in frame])
            frame = frame.merge(clock, how="left", on=list(table.key))
    return set_types(frame.reindex(columns=[*table.every_column]), table)


def no_rows(table: Table) -> pd.DataFrame:
    """Return the table without rows."""
    return set_types(pd.DataFrame(columns=[*table.every_column]), table)


def part(table: Table, path: Path) -> pd.DataFrame:
    """Return the rows of one of the table's files, typed."""
    try:
        frame = pd.read_csv(path, dtype=str, keep_default_na=False)
    except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError) as error:
        why = " ".join(str(error).split())
        raise BadInput(f"{path}: not a readable CSV ({why}); move it away or restore it") from None
    if "schema" not in frame or not set(table.key) & set(frame.columns):
        raise BadInput(f"{path}: columns are not those of table {table.name!r}; move it away or restore it")
    check(
        path, frame, frame["schema"].isin(["", np.nan]), "cut short; restore the file"
    )  # every row ends with it
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
        column = table.every_column[name]
        damaged = ~fits(frame[name], column)
        check(path, frame, damaged, f"is no {WORDS.get(column.type)}; restore the file", name)
    frame = set_types(frame, table)
    double = frame.duplicated(list(table.key))
    check(path, frame, double, f"the key {table.key} of an earlier row; move it away or restore it")
    return frame


def check(path: Path, frame: pd.DataFrame, wrong: pd.Series, why: str, column: str = "") -> None:
    """Raise `BadInput` with the line of the first row that is wrong, if one is; the header is the first line."""
    if not wrong.any():
        return
    row = int(np.flatnonzero(wrong)[0])
    with path.open(encoding="utf-8", newline="") as file:
        lines = csv.reader(file)
        for _ in range(row + 2):
            next(lines)
        at = f"{path}, line {lines.line_num}"
    if column:
        raise BadInput(f"{f'{at}, column {column!r}: {frame[column].iloc[row]!r}'[:200]} {why}")
    raise BadInput(f"{at}: {why}")


@cache
def note(message: str) -> None:
    """Log a message once."""
    LOG.warning(message)


def fits(values: pd.Series, column: Column) -> pd.Series:
    """Return which entries of a column that was read as text are of its type; blanks are of every type."""
    blank = values == ""
    if column.type == "text":
        return blank | True
    if column.type in ("flag", "answer"):
        return blank | values.isin([*FLAGS])
    numbers = pd.to_numeric(values, errors="coerce").astype(float)
    if column.type == "whole":
        return blank | ((numbers == numbers.round()) & (numbers.abs() <= 2**53))
    return blank | np.isfinite(numbers) | (column.infinite & values.isin(["inf", "-inf"]))


def set_types(frame: pd.DataFrame, table: Table) -> pd.DataFrame:
    """Return the frame with its columns in the types of the table."""
    try:
        return pd.DataFrame({name: convert(frame[name], table.every_column[name]) for name in frame})
    except (ValueError, TypeError) as error:
        raise BadInput(f"table {table.name!r}, column {error}") from None


def convert(values: pd.Series, column: Column) -> pd.Series:
    """Return the values in the type of a column; blanks are missing, and missing text is empty.

    No flag is not set, no answer is missing.  Infinity is blank as well, where it is no value of the column.
    """
    if (
        values.dtype == DTYPES[column.type]
        and column.type != "number"
        and not (column.type == "text" and values.hasnans)
    ):
        return values
    if column.type == "text":
        return values.astype(object).where(values.notna(), "").astype(str)
    if values.dtype == object or values.dtype == "str":
        values = values.mask(values == "")
    if column.type in ("flag", "answer"):
        answers = values.map(FLAGS).astype("boolean")
        if (answers.isna() & values.notna()).any():
            raise ValueError(f"{values.name!r}: neither True nor False")
        return answers.fillna(False).astype(bool) if column.type == "flag" else answers
    numbers = pd.to_numeric(values)
    if column.type == "whole":
        try:
            return numbers.astype("Int64")
        except (TypeError, ValueError) as error:
            raise ValueError(f"{values.name!r}: {error}") from None
    numbers = numbers.astype(float)
    return numbers if column.infinite else numbers.mask(np.isinf(numbers))


# -- writing ---------------------------------------------------------------------------------------
def merge(
    table: Table,
    rows: Iterable[Mapping[str, Any]],
    results: Path,
    made: Iterable[tuple[Any, ...]] | None = None,
    profiles: Sequence[str] = (),
) -> pd.DataFrame:
    """Put rows into the table's files; return the merged table.

    made : the keys of all rows of these profiles, where the table was made as a whole: others are dropped.
    A file of an older version is replaced: nobody can read it any more.
    """
    try:
        old = read(table, results)
    except OldTable as error:
        note(f"{error}; replaced")
        old = no_rows(table)
    new = canonical(table, rows)
    replaced = list(table.whole or table.key)
    frame = pd.concat([old[~index(old, replaced).isin(index(new, replaced))], new], ignore_index=True)
    if made is not None:
        stale = frame["profile"].isin(profiles) & ~index(frame, list(table.key)).isin(
            pd.Index(made, tupleize_cols=False)
        )
        frame = frame[~stale]
    if new.empty and len(frame) == len(old):
        return old
    frame = set_types(in_order(frame, table), table)
    write(frame, table, results)
    return frame


def canonical(table: Table, rows: Iterable[Mapping[str, Any]]) -> pd.DataFrame:
    """Return rows as the table has them: typed, with the digits that are written, the last of each key."""
    frame = pd.DataFrame(list(rows))
    unknown = set(frame.columns) - set(table.every_column)
    if unknown:
        raise BadInput(f"table {table.name!r} has no columns {sorted(unknown)}")
    frame["schema"] = table.version
    frame = set_types(frame.reindex(columns=[*table.every_column]), table)
    return round_digits(frame, table).drop_duplicates(list(table.key), keep="last")


def keys(table: Table, rows: Iterable[Mapping[str, Any]]) -> list[tuple[Any, ...]]:
    """Return the key of each row as it stands in the table."""
    named = pd.DataFrame([{name: row.get(name) for name in table.key} for row in rows], columns=[*table.key])
    return list(index(round_digits(set_types(named, table), table), list(table.key)))


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
        text = pd.DataFrame({name: as_text(part[name], table.every_column[name]) for name in names})
        with replacing(path) as file:
            text.to_csv(file, index=False, lineterminator="\n")


def as_text(values: pd.Series, column: Column) -> list[str]:
    """A column as text; errors in scientific notation."""
    if column.type != "number":
        return ["" if pd.isna(value) else str(value) for value in values]
    decades = column.rule is not None and column.rule.decades
    return [number_text(value, column.exact, decades) for value in values.astype(float).tolist()]


def number_text(value: float, exact: bool, decades: bool) -> str:
    """Return a number as it is written: in full, scientific where it counts in decades, or in six digits."""
    if math.isnan(value):
        return ""
    if exact or math.isinf(value):
        return repr(value)
    if decades:
        return np.format_float_scientific(value, unique=True, trim="-")
    return f"{value:.{DIGITS}g}"


def round_digits(frame: pd.DataFrame, table: Table) -> pd.DataFrame:
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
def replacing(path: Path, sync: bool = True) -> Iterator[Any]:
    """Open a text file that takes the place of `path` when the block ends without an exception.

    sync : whether it is on the disk then, so that not even a failure of power takes it away.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="") as file:
            yield file
            file.flush()
            if sync:
                os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(temporary)
        raise
