"""The columns that tables have in common, and how columns are written down."""

from __future__ import annotations

from contactbench.measure.law import Law
from contactbench.measure.laws import DRIFT_COLUMNS, LAWS
from contactbench.measure.round_off import JUDGEMENT
from contactbench.results.schema import Column, Rule

#: why a column has no rule
WORDING = "wording; what it says of the numbers stands in columns of their own"
ROUND_OFF = "an estimate of round-off, no reproducible number"
FOLLOWS = "it follows from the deviation, which is compared, and what round-off may amount to"
SOLVER = "a solver's words, which change with its version"


def number(meaning: str, rule: Rule | None = None, **more: bool | str) -> Column:
    return Column(meaning, "number", rule, **more)  # type: ignore[arg-type]


def whole(meaning: str, rule: Rule | None = None) -> Column:
    return Column(meaning, "whole", rule)


def same(meaning: str) -> Column:
    """Return a column of text that is compared."""
    return Column(meaning, rule=Rule.same)


def words(meaning: str) -> Column:
    """Return a column of text that is written for a reader."""
    return Column(meaning, ungated=WORDING)


def seconds(meaning: str) -> Column:
    return Column(meaning, "number", timed=True)


def clock_count(meaning: str) -> Column:
    return Column(meaning, "whole", timed=True)


COMMON = {
    "scene": Column("name of the scene"),
    "method": Column("name of the method"),
    "family": same("contact, variational or established, as the method declares; limit: a plain C loop"),
    "engine": same(
        "what runs it: numba, jax, python, c+python (compiled, Python callbacks), llvm, c, c++, mpmath"
    ),
    "control": same("what is set: step, rtol or, of an exact method, nothing"),
    "value": number("its value, in full; 0 for nothing", Rule.same, exact=True),
    "variant": same("which of several ways to run it; of a C loop, the kernel"),
    "setting": same("variant, control and value, printed"),
    "status": same("ok, diverged, budget, failed, timeout, unsupported"),
    "message": Column("why, when the status is not ok", ungated=SOLVER),
}

COUNTS = {
    "steps": whole("accepted steps", Rule.count),
    "evaluations": whole("evaluations of evaluation_kind in one run", Rule.count),
    "evaluation_kind": same("gradient, rhs, taylor (orders of Taylor coefficients) or rotation"),
    "rhs_equivalents": number("evaluations in right-hand sides (two rotations count as one)", Rule.count),
    "jacobians": whole("Jacobian evaluations", Rule.count),
    "rejected": whole(
        "rejected steps of an adaptive method; empty where its solver does not count them", Rule.count
    ),
}

ERROR = number("max ‖y − y*‖ / max ‖y*‖", Rule.error)

#: what one cell makes as a whole in the tables of laws, orders and hard scenes: a method's whole ladder
ONE_CELL = ("scene", "method", "engine")

#: how often and how long
TIMING = {
    "time_min_s": seconds("the estimate: least round of all visits, seconds per call"),
    "time_median_s": seconds("median over rounds, seconds per call"),
    "time_iqr_s": seconds("interquartile range over rounds"),
    "time_halves_ratio": seconds(
        "least round of the even visits over that of the odd ones: the cell's own spread"
    ),
    "time_process_ratio": seconds("least round in a second process over time_min_s, of a sample of cells"),
    "visits": clock_count("visits to the cell, spread over the whole timed part"),
    "rounds": clock_count("timed rounds of all visits together"),
    "iterations": clock_count("calls per round"),
}


def length_timing(what: str, of_more: str) -> dict[str, Column]:
    """Return the columns of fixed and marginal cost, from the least rounds of two lengths of a run."""
    return {
        "fixed_s": seconds(f"what a call takes however {what}"),
        "marginal_s": seconds(f"what {of_more} takes"),
        "marginal_halves_ratio": seconds(
            "marginal_s of the even visits over that of the odd ones; blank unless > 0"
        ),
        "marginal_process_ratio": seconds(
            "marginal_s of a second process over that of the first, of a sample of cells"
        ),
    }


# -- laws ------------------------------------------------------------------------------------------
def law_column(law: Law) -> Column:
    """Return the column of a law: how it is gated and where it is shown, the law says."""
    kind, label = "whole" if law.gate.value == "count" else "number", law.label or law.name.replace("_", " ")
    return Column(law.definition, kind, Rule[law.gate.value], label=label, shown=law.shown)  # type: ignore[arg-type]


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
        return whole(meaning, Rule.count)
    if name.endswith("_uncertainty"):
        return number(meaning, ungated=ROUND_OFF)
    return same(meaning) if name == "derivative" else number(meaning, Rule.value)


DRIFTS = {name: drift_column(name, meaning) for name, meaning in DRIFT_COLUMNS.items()}
