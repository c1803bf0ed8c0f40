"""The tables of the benchmark, one per question: tables.toml says what their columns are."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from contactbench.measure.law import Law
from contactbench.measure.laws import LAWS
from contactbench.measure.round_off import JUDGEMENT
from contactbench.results.schema import Column, Rule, Table, table

DECLARED = tomllib.loads(Path(__file__).with_name("tables.toml").read_text(encoding="utf-8"))
#: why a column has no rule
FOLLOWS = "it follows from the deviation, which is compared, and what round-off may amount to"


def column(meaning: str, rule: str | None = None, **more: Any) -> Column:
    return Column(meaning, rule=Rule[rule] if rule else None, **more)


def number(meaning: str, rule: Rule | None = None, **more: Any) -> Column:
    return Column(meaning, "number", rule, **more)


COMMON, COUNTS, TIMING, DRIFTS = (
    {name: column(**entry) for name, entry in group.items()} for group in DECLARED["groups"].values()
)


def law_column(law: Law) -> Column:
    label, counts = law.label or law.name.replace("_", " "), law.gate.value == "count"
    kind: Any = "whole" if counts else "number"
    return Column(law.definition, kind, Rule[law.gate.value], label=label, shown=law.shown)


def law_columns() -> dict[str, Column]:
    """Return a column for each law that is registered by now, and of the structural ones the judgement."""
    columns = {name: law_column(law) for name, law in LAWS.items()}
    for law in filter(lambda law: law.structural, LAWS.values()):
        about = {what: f"{law.name}: {meaning}" for what, meaning in JUDGEMENT.items()}
        columns[f"{law.name}_claimed"] = Column(about["claimed"], "flag", Rule.same)
        for what in ("kept", "undecided"):
            columns[f"{law.name}_{what}"] = Column(about[what], "answer", ungated=FOLLOWS)
        columns[f"{law.name}_bound"] = number(about["bound"], ungated=FOLLOWS)
    return columns


# -- tables ---------------------------------------------------------------------------------------
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
    given = DECLARED["tables"][name]
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
SCALING = declare("scaling")
DEFINITIONS = declare("definitions")
CLAIMS_TABLE = declare("claims")
PAPER_FIGURES = declare("paper_figures")
STABILITY = declare("stability")
STABILITY_LIMITS = declare("stability_limits")
ONE_STEP = declare("one_step")
DAMPING_RATES = declare("damping_rates")
STRONG_DAMPING = declare("strong_damping")
LONG_TIME = declare("long_time")
#: the quantities that long runs are averaged for: H0 once in a period, where the force vanishes; Lyapunov's exponent
#: per unit of time; the dimension of Kaplan and Yorke, of the section once in a period; and 0 for the true flow
ENERGY, EXPONENT, DIMENSION = "mean H0 at phase 0", "largest exponent", "dimension"
SUM = "sum of exponents plus γ"
