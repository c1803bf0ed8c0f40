"""The ledger: what a claim is, what counts as evidence, and how a verdict follows from numbers.

A claim *holds* if it is true as printed, in the paper's own setting and by its own definitions.  It *holds, corrected*
if a number or formula is wrong, and the statement in words survives the correction.  Else it is *refuted*.

Statements and bounds are in ``statements.toml``, functions return the numbers, `verdict` follows from them; whether a
correction repairs or replaces a statement that fails is argued in its `correction`.
"""

from __future__ import annotations

import inspect
import math
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from importlib.resources import files
from typing import Any, SupportsFloat

from contactbench.registry import Registry
from contactbench.tables.schema import SEPARATOR

CLAIMS = Registry("claim")
#: by id, the fields of `Claim`
STATEMENTS = tomllib.loads(files(__package__).joinpath("statements.toml").read_text(encoding="utf-8"))
#: by name, the bounds that several claims share, each with its reason
BOUNDS = STATEMENTS.pop("bounds")


class Verdict(StrEnum):
    """What the measurements say about a claim."""

    holds = "holds"
    corrected = "holds, corrected"
    refuted = "refuted"


class Correction(StrEnum):
    """How a corrected statement relates to the paper's, declared with the claim."""

    repairs = "repairs"  # a number or formula is corrected, the statement in words survives
    replaces = "replaces"  # the statement in words fails, and the correction contradicts it
    sharpens = "sharpens"  # the claim holds, and more is true than it says
    extends = "extends"  # the claim holds; how far it goes, or how another reading of it fares


@dataclass(frozen=True)
class Measurement:
    """A measured number against its bound: ``value relation bound``, and why the bound is what it is."""

    quantity: str
    value: float
    relation: str
    bound: float
    why: str

    @property
    def passes(self) -> bool:
        """Return whether the number keeps its bound; never if it is not finite."""
        sign = 1 if self.relation == "≤" else -1
        return math.isfinite(self.value) and sign * self.value <= sign * self.bound

    def __str__(self) -> str:
        mark = "" if self.passes else " fails"
        return f"{self.quantity}: {self.value:.3g} {self.relation} {self.bound:.3g}{mark} ({self.why})"


#: a quantity, "≤" or "≥", and a bound with its reason, or its name in `BOUNDS`, or the reason of one that is computed
type Row = Sequence[str | float]
#: a number; or a number and its bound, where that is computed too; or what stands in the text of the quantities
type Found = SupportsFloat | tuple[SupportsFloat, SupportsFloat] | Mapping[str, object]
type Evidence = Iterable[Found]


def compare(row: Row, found: Found, words: Mapping[str, object]) -> Measurement:
    """Return the measurement of a row of the statement; words : by name, what its text shows with ``%(name)g``."""
    quantity, relation, *rest = row
    *bound, why = BOUNDS.get(rest[0], rest)
    value, limit = found if isinstance(found, tuple) else (found, *bound)
    return Measurement(str(quantity) % words, float(value), str(relation), float(limit), why)


def verdict(
    statement: Sequence[Measurement], corrected: Sequence[Measurement], correction: Correction | None
) -> Verdict:
    """Return the verdict: a statement that fails is `corrected` by a repair that passes, and otherwise refuted."""
    if all(m.passes for m in statement):
        return Verdict.holds
    mended = correction is Correction.repairs and bool(corrected) and all(m.passes for m in corrected)
    return Verdict.corrected if mended else Verdict.refuted


def columns(measurements: Sequence[Measurement], prefix: str = "") -> dict[str, object]:
    """Return the columns of the measurement that a row shows: the first that fails, else the first."""
    m = next((m for m in measurements if not m.passes), measurements[0])
    found: dict[str, object] = {"measured": m.value, "relation": m.relation, "bound": m.bound}
    found["evidence"] = SEPARATOR.join(map(str, measurements))
    return {f"{prefix}{name}": value for name, value in found.items()}


@dataclass(frozen=True)
class Claim:
    """One claim of the paper, or beyond it.

    where : section and equation or figure of the paper, or `BEYOND`.  says : the claim in our words.  measure :
    ``(**parameters) -> Evidence``, by default with the table's, of the rows `measured` of the paper's statement
    and then `corrected`.  kind, correction : how and in which words it is corrected.  figures : of the paper.  dear :
    it takes longer than a second.
    """

    name: str
    where: str
    says: str
    scene: str
    measure: Callable[..., Evidence]
    measured: Sequence[Row]
    corrected: Sequence[Row] = ()
    method: str = "none: the equations themselves"
    kind: Correction | None = None
    correction: str = ""
    figures: Sequence[str] = ()
    dear: bool = False

    @property
    def words(self) -> dict[str, str]:
        """Return what the ledger says beside the numbers."""
        said = {"where": self.where, "claim": self.says, "scene": self.scene, "method": self.method}
        return said | {"correction": self.correction}

    def measurements(self, **parameters: object) -> list[Measurement]:
        defaults = inspect.signature(self.measure).parameters.items()
        words = {name: parameter.default for name, parameter in defaults} | parameters
        found = list(self.measure(**parameters))
        for own in found:
            words |= own if isinstance(own, Mapping) else {}
        numbers = (own for own in found if not isinstance(own, Mapping))
        rows = zip((*self.measured, *self.corrected), numbers, strict=True)
        return [compare(row, number, words) for row, number in rows]

    def row(self, **parameters: object) -> dict[str, object]:
        """Measure the claim, with parameters of `measure`, and return its row; without a verdict if that fails."""
        row: dict[str, object] = {"id": self.name}
        try:
            found = self.measurements(**parameters)
        except Exception as error:
            return {**row, "status": "failed", "message": f"{type(error).__name__}: {error}"}
        if broken := [str(m) for m in found if not math.isfinite(m.value)]:
            return {**row, "status": "failed", "message": f"not finite: {'; '.join(broken)}"}
        statement, corrected = found[: len(self.measured)], found[len(self.measured) :]
        row |= columns(statement) | {"verdict": str(verdict(statement, corrected, self.kind))}
        row |= {"correction_kind": str(self.kind or ""), "status": "ok"}
        return row | columns(corrected, "corrected_") if corrected else row


def claim(name: str) -> Callable[[Callable[..., Evidence]], Claim]:
    """Return a decorator that registers a measuring function for the statement `name`."""
    fields: dict[str, Any] = {
        k: " ".join(v.split()) if isinstance(v, str) else v for k, v in STATEMENTS[name].items()
    }
    if "kind" in fields:
        fields["kind"] = Correction(fields["kind"])

    def register(measure: Callable[..., Evidence]) -> Claim:
        own = Claim(name, measure=measure, **fields)
        CLAIMS.add(own)
        return own

    return register
