"""The ledger: what a claim is, what counts as evidence, and how a verdict follows from numbers.

A claim is a statement, in ``statements.toml``, and a function that measures it.  The verdict follows from the
numbers by `verdict`; whether a correction repairs or replaces a statement that fails is argued, in its `correction`.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from importlib.resources import files
from typing import SupportsFloat

from contactbench.registry import Registry
from contactbench.results.schema import SEPARATOR

CLAIMS = Registry("claim")
#: by id, the fields of `Claim`
STATEMENTS = tomllib.loads(files(__package__).joinpath("statements.toml").read_text(encoding="utf-8"))
#: stands in a claim's evidence between the measurements of the paper's statement and those of the corrected one
CORRECTED = "corrected"


class Verdict(StrEnum):
    """What the measurements say about a claim."""

    holds = "holds"
    corrected = "holds, corrected"
    refuted = "refuted"


class Correction(StrEnum):
    """How a corrected statement relates to the paper's, declared with the claim.

    repairs : the claim's substance survives once the correction is made; the claim *holds, corrected*.
    replaces : what is true contradicts the claim; it is *refuted*.
    sharpens : the claim is true, but says less than what is true.
    extends : the claim is true as it stands; the correction says how far it goes.
    """

    repairs = "repairs"
    replaces = "replaces"
    sharpens = "sharpens"
    extends = "extends"


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


Evidence = Iterable[Measurement | str]


def at_most(quantity: str, value: SupportsFloat, bound: float, why: str) -> Measurement:
    return Measurement(quantity, float(value), "≤", float(bound), why)


def at_least(quantity: str, value: SupportsFloat, bound: float, why: str) -> Measurement:
    return Measurement(quantity, float(value), "≥", float(bound), why)


def verdict(
    statement: Sequence[Measurement], corrected: Sequence[Measurement], correction: Correction | None
) -> Verdict:
    """Return the verdict: a statement that fails is `corrected` by a repair that passes, and otherwise refuted.

    One that holds is `corrected` by a sharper one that holds.
    """
    mended = bool(corrected) and all(m.passes for m in corrected)
    if all(m.passes for m in statement):
        return Verdict.corrected if correction is Correction.sharpens and mended else Verdict.holds
    return Verdict.corrected if correction is Correction.repairs and mended else Verdict.refuted


def columns(measurements: Sequence[Measurement], prefix: str = "") -> dict[str, object]:
    """Return the columns of the measurement that a row shows: the first that fails, else the first."""
    m = next((m for m in measurements if not m.passes), measurements[0])
    found = {"quantity": m.quantity, "measured": m.value, "relation": m.relation, "bound": m.bound}
    found |= {"bound_reason": m.why, "evidence": SEPARATOR.join(map(str, measurements))}
    return {f"{prefix}{name}": value for name, value in found.items()}


@dataclass(frozen=True)
class Claim:
    """One claim of the paper, or beyond it.

    name : its id.  where : section and equation or figure of the paper, numbered as it is printed, or `BEYOND`.
    says : the claim in our words.  scene, method : what it is measured on.  kind, correction : how and
    in which words it is corrected.  figures : the paper's figures redrawn for it.  measure :
    ``(**parameters) -> Evidence``; every parameter has a default, which is what the table shows.
    """

    name: str
    where: str
    says: str
    scene: str
    measure: Callable[..., Evidence]
    method: str = "none: the equations themselves"
    kind: Correction | None = None
    correction: str = ""
    figures: tuple[str, ...] = ()

    def row(self, **parameters: object) -> dict[str, object]:
        """Measure the claim, with parameters of `measure`, and return its row; without a verdict if that fails."""
        row: dict[str, object] = {"id": self.name, "where": self.where, "claim": self.says}
        row |= {"scene": self.scene, "method": self.method, "figures": " ".join(self.figures)}
        row |= {"command": f"contactbench claim {self.name}"}
        try:
            measured = list(self.measure(**parameters))
        except Exception as error:
            return {**row, "status": "failed", "message": f"{type(error).__name__}: {error}"}
        end = measured.index(CORRECTED) if CORRECTED in measured else len(measured)
        halves = measured[:end], measured[end:]
        statement, corrected = ([m for m in half if isinstance(m, Measurement)] for half in halves)
        broken = [str(m) for m in (*statement, *corrected) if not math.isfinite(m.value)]
        if broken:
            return {**row, "status": "failed", "message": f"not finite: {'; '.join(broken)}"}
        row |= columns(statement) | {"verdict": str(verdict(statement, corrected, self.kind))}
        row |= {"correction_kind": str(self.kind or ""), "correction": self.correction, "status": "ok"}
        return row | columns(corrected, "corrected_") if corrected else row


def claim(name: str) -> Callable[[Callable[..., Evidence]], Claim]:
    """Return a decorator that registers a measuring function for the statement `name`."""
    given = STATEMENTS[name]
    fields = {field: " ".join(text.split()) for field, text in given.items() if isinstance(text, str)}
    kind, figures = fields.pop("kind", None), tuple(given.get("figures", ()))

    def register(measure: Callable[..., Evidence]) -> Claim:
        own = Claim(name, measure=measure, kind=Correction(kind) if kind else None, figures=figures, **fields)
        CLAIMS.add(own)
        return own

    return register
