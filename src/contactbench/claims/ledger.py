"""The ledger: what a claim is, what counts as evidence, and how a verdict follows from numbers.

A claim is a function that measures and returns `Evidence`.  The numbers are computed and the verdict follows from
them by `verdict`; of a claim that fails, whether its correction repairs or replaces it is argued, in its `correction`.
"""

from __future__ import annotations

import inspect
import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from contactbench.errors import Registry
from contactbench.results.schema import SEPARATOR

CLAIMS = Registry("claim")


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


RELATIONS: dict[str, Callable[[float, float], bool]] = {"≤": operator.le, "≥": operator.ge}


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
        """Whether the number keeps its bound (never, if it is not finite)."""
        return math.isfinite(self.value) and RELATIONS[self.relation](self.value, self.bound)

    def __str__(self) -> str:
        mark = "" if self.passes else " fails"
        return f"{self.quantity}: {self.value:.3g} {self.relation} {self.bound:.3g}{mark} ({self.why})"


def at_most(quantity: str, value: Any, bound: float, why: str) -> Measurement:
    """A number that must not exceed its bound."""
    return Measurement(quantity, float(value), "≤", float(bound), why)


def at_least(quantity: str, value: Any, bound: float, why: str) -> Measurement:
    """A number that must reach its bound."""
    return Measurement(quantity, float(value), "≥", float(bound), why)


@dataclass(frozen=True)
class Evidence:
    """The measurements of the paper's statement, and of the corrected one where there is one."""

    statement: Sequence[Measurement]
    corrected: Sequence[Measurement] = ()

    def __iter__(self) -> Any:
        return iter([*self.statement, *self.corrected])


def verdict(evidence: Evidence, correction: Correction | None) -> Verdict:
    """The verdict that follows from the measurements.

    The statement holds if all its measurements pass, and so does a correction.  A statement that fails
    is `corrected` if a correction that repairs it passes, and otherwise `refuted`.  A statement that
    holds is `corrected` if a sharper one holds.
    """
    holds = all(m.passes for m in evidence.statement)
    mended = bool(evidence.corrected) and all(m.passes for m in evidence.corrected)
    if holds:
        return Verdict.corrected if correction is Correction.sharpens and mended else Verdict.holds
    return Verdict.corrected if correction is Correction.repairs and mended else Verdict.refuted


def shown(measurements: Sequence[Measurement]) -> Measurement | None:
    """The measurement a row shows: the first that fails, else the first."""
    return next((m for m in measurements if not m.passes), measurements[0] if measurements else None)


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
    method: str
    measure: Callable[..., Evidence]
    kind: Correction | None = None
    correction: str = ""
    figures: tuple[str, ...] = ()

    @property
    def parameters(self) -> dict[str, Any]:
        """What may be varied (seed, damping, inertia, …), with the values the table is measured at."""
        return {name: p.default for name, p in inspect.signature(self.measure).parameters.items()}

    def row(self, **parameters: Any) -> dict[str, Any]:
        """The claim's row of the table, measured now; an exception becomes a row without a verdict.

        parameters : values other than the defaults, see `parameters`.
        """
        row: dict[str, Any] = {
            "id": self.name,
            "where": self.where,
            "claim": self.says,
            "scene": self.scene,
            "method": self.method,
            "command": f"contactbench claim {self.name}",
            "figures": " ".join(self.figures),
        }
        try:
            evidence = self.measure(**parameters)
        except Exception as error:
            return {**row, "status": "failed", "message": f"{type(error).__name__}: {error}"}
        if not all(math.isfinite(m.value) for m in evidence):
            broken = "; ".join(str(m) for m in evidence if not math.isfinite(m.value))
            return {**row, "status": "failed", "message": f"not finite: {broken}"}
        main, mended = shown(evidence.statement), shown(evidence.corrected)
        assert main is not None
        result = verdict(evidence, self.kind)
        row |= {
            "quantity": main.quantity,
            "measured": main.value,
            "relation": main.relation,
            "bound": main.bound,
            "bound_reason": main.why,
            "verdict": str(result),
            "correction_kind": str(self.kind or ""),
            "correction": self.correction,
            "evidence": SEPARATOR.join(map(str, evidence.statement)),
            "status": "ok",
        }
        if mended is not None:
            row |= {
                "corrected_quantity": mended.quantity,
                "corrected_measured": mended.value,
                "corrected_relation": mended.relation,
                "corrected_bound": mended.bound,
                "corrected_bound_reason": mended.why,
                "corrected_evidence": SEPARATOR.join(map(str, evidence.corrected)),
            }
        return row


def claim(
    name: str,
    where: str,
    says: str,
    *,
    scene: str,
    method: str = "none: the equations themselves",
    kind: Correction | None = None,
    correction: str = "",
    figures: tuple[str, ...] = (),
) -> Callable[[Callable[..., Evidence]], Claim]:
    """Decorator that registers a measuring function as the claim `name`."""

    def register(measure: Callable[..., Evidence]) -> Claim:
        return CLAIMS.add(Claim(name, where, says, scene, method, measure, kind, correction, figures))

    return register
