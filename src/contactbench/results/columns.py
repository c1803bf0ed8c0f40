"""The columns that tables have in common, and those of the laws."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from contactbench.measure.law import Law
from contactbench.measure.laws import DRIFT_COLUMNS, LAWS
from contactbench.measure.round_off import JUDGEMENT
from contactbench.results.schema import Column, Rule

#: why a column has no rule
ROUND_OFF = "an estimate of round-off, no reproducible number"
FOLLOWS = "it follows from the deviation, which is compared, and what round-off may amount to"


def column(meaning: str, rule: str | None = None, **more: Any) -> Column:
    """Return a column as it is declared in tables.toml."""
    return Column(meaning, rule=Rule[rule] if rule else None, **more)


def number(meaning: str, rule: Rule | None = None, **more: Any) -> Column:
    return Column(meaning, "number", rule, **more)


COMMON, COUNTS, TIMING = (
    {name: column(**entry) for name, entry in group.items()}
    for group in tomllib.loads(Path(__file__).with_name("tables.toml").read_text(encoding="utf-8"))[
        "groups"
    ].values()
)


def law_column(law: Law) -> Column:
    """Return the column of a law: how it is gated and where it is shown, the law says."""
    label, counts = law.label or law.name.replace("_", " "), law.gate.value == "count"
    kind: Any = "whole" if counts else "number"
    return Column(law.definition, kind, Rule[law.gate.value], label=label, shown=law.shown)


def law_columns() -> dict[str, Column]:
    """Return a column for each law that is registered by now, and of the structural ones the judgement."""
    columns = {name: law_column(law) for name, law in LAWS.items()}
    for law in filter(lambda law: law.structural, LAWS.values()):
        for name, meaning in JUDGEMENT.items():
            about = f"{law.name}: {meaning}"
            columns[f"{law.name}_{name}"] = {
                "claimed": Column(about, "flag", Rule.same),
                "bound": number(about, ungated=FOLLOWS),
            }.get(name, Column(about, "answer", ungated=FOLLOWS))
    return columns


def drift_column(name: str, meaning: str) -> Column:
    """Return a column that belongs to the drifts: error bars, clamps, and where the derivative is from."""
    if name.endswith("_clamped"):
        return Column(meaning, "whole", Rule.count)
    if name.endswith("_uncertainty"):
        return number(meaning, ungated=ROUND_OFF)
    return Column(meaning, rule=Rule.same) if name == "derivative" else number(meaning, Rule.value)


DRIFTS = {name: drift_column(name, meaning) for name, meaning in DRIFT_COLUMNS.items()}
