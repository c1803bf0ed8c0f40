"""The tables of the benchmark, one per question: tables.toml says what their columns are."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from contactbench.results.columns import COMMON, COUNTS, DRIFTS, TIMING, column, law_columns
from contactbench.results.schema import Column, Table, table

DECLARED = tomllib.loads(Path(__file__).with_name("tables.toml").read_text(encoding="utf-8"))["tables"]


def columns(declared: Mapping[str, Any]) -> dict[str, Column]:
    """Return the columns of a table, those of the laws that are registered by now among them."""
    groups = {"+common": COMMON, "+counts": COUNTS, "+timing": TIMING, "+drifts": DRIFTS}
    found: dict[str, Column] = {}
    for name, entry in declared.items():
        if name == "+laws":
            found |= law_columns()
        elif name == "+laws_at_equal_cost":
            found |= {law: law_columns()[law] for law in entry}
        else:
            found |= groups.get(name) or {name: column(**entry)}
    return found


def declare(name: str) -> Table:
    """Register a table as it is declared."""
    given = DECLARED[name]
    own = given["columns"]
    by_law = any(entry.startswith("+laws") for entry in own)
    options = {option: given[option] for option in ("version",) if option in given}
    options |= {option: tuple(given[option]) for option in ("key", "whole") if option in given}
    return table(name, given["about"], (lambda: columns(own)) if by_law else columns(own), **options)


CONVERGENCE = declare("convergence")
LAWS_TABLE = declare("laws")
LAWS_TIME = declare("laws_time")
DECAY_LAWS = declare("decay_laws")
WORK_PRECISION = declare("work_precision")
ENSEMBLE_TABLE = declare("ensemble")
DEFINITIONS = declare("definitions")
CLAIMS_TABLE = declare("claims")
PAPER_FIGURES = declare("paper_figures")
STABILITY = declare("stability")
STABILITY_LIMITS = declare("stability_limits")
ONE_STEP = declare("one_step")
DAMPING_RATES = declare("damping_rates")
STRONG_DAMPING = declare("strong_damping")
LONG_TIME = declare("long_time")
