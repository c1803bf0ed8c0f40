"""A column for each law, in the tables that have them all."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from contactbench.measure.law import Law
from contactbench.measure.laws import LAWS
from contactbench.measure.round_off import JUDGEMENT
from contactbench.results.schema import Column, Rule


def law_column(law: Law) -> Column:
    """How it is gated and where it is shown, the law says."""
    return Column(
        law.definition, "whole" if law.gate.value == "count" else "number", Rule[law.gate.value],
        label=law.label or law.name.replace("_", " "), shown=law.shown,
    )  # fmt: skip


def judgement_columns(law: Law) -> dict[str, Column]:
    """Of a structural law whether it is claimed, kept or undecided, and the bound that decides."""
    follows = "it follows from the deviation, which is compared, and what round-off may amount to"
    if not law.structural:
        return {}
    kinds: dict[str, Column] = {
        name: Column(f"{law.name}: {meaning}", "number" if name == "bound" else "answer", ungated=follows)
        for name, meaning in JUDGEMENT.items() if name != "claimed"
    }  # fmt: skip
    claimed = Column(f"{law.name}: {JUDGEMENT['claimed']}", "flag", Rule.same)
    return {f"{law.name}_{name}": column for name, column in {"claimed": claimed, **kinds}.items()}


class WithLaws(Mapping[str, Column]):
    """Columns among which is one for each law that is registered at the moment: a plug-in may bring some."""

    def __init__(self, before: Mapping[str, Column], after: Mapping[str, Column]) -> None:
        self.before, self.after = before, after

    def now(self) -> dict[str, Column]:
        judged = {name: column for law in LAWS.values() for name, column in judgement_columns(law).items()}
        return {
            **self.before,
            **{name: law_column(law) for name, law in LAWS.items()},
            **judged,
            **self.after,
        }

    def __getitem__(self, name: str) -> Column:
        for columns in (self.after, self.before):
            if name in columns:
                return columns[name]
        if name not in LAWS:
            return self.now()[name]
        return law_column(LAWS[name])

    def __iter__(self) -> Iterator[str]:
        return iter(self.now())

    def __len__(self) -> int:
        return len(self.now())
