"""The table of averages over long runs."""

from __future__ import annotations

from contactbench.results.columns import COMMON, COUNTS, number, whole
from contactbench.results.schema import KEY, Column, Rule, table

#: why averages have no rule
CHAOS = "of chaotic runs: other roundings give another number within the error bar"
#: the quantities that are averaged: H0 once in a period, where the force vanishes; Lyapunov's exponent per unit of
#: time; the dimension of Kaplan and Yorke, of the section once in a period; and what is 0 for the true flow
ENERGY, EXPONENT = "mean H0 at phase 0", "largest exponent"
DIMENSION, SUM = "dimension", "sum of exponents plus γ"

LONG_TIME = table(
    "long_time",
    "averages over long runs of a chaotic scene, with their error bars and what they cost",
    {
        **COMMON,
        "quantity": Column(
            f"{ENERGY} (once in a period, where the force vanishes: no average over the period), {EXPONENT} "
            f"(Lyapunov's), {DIMENSION} (of Kaplan and Yorke, of the section), {SUM} (0 for the true flow)"
        ),
        "reference": Column("whether the others are compared with it", "flag", Rule.same),
        "trajectories": whole("trajectories averaged over", Rule.same),
        "periods": whole("periods of the force that each is averaged over", Rule.same),
        "evaluations_per_time": number(
            "evaluations of one trajectory per unit of time, tangents included", Rule.count
        ),
        "jacobians_per_time": number("Jacobians, of an implicit method", Rule.count),
        "evaluation_kind": COUNTS["evaluation_kind"],
        "mean": number("the average over trajectories and time", ungated=CHAOS),
        "error": number("its standard error, from independent trajectories", ungated=CHAOS),
        "pairing_defect": number(
            "root mean square of log(σ₁σ₂e^{γt})/t, σ the singular values of the tangent map; with their sum",
            Rule.structure,
        ),
    },
    key=(*KEY, "quantity"),
    whole=("scene", "method", "engine"),
)
