"""The columns that tables have in common, and how columns are written down."""

from __future__ import annotations

from contactbench.results.schema import Column, Rule


def number(
    meaning: str, rule: Rule | None = None, exact: bool = False, ungated: str = "", infinite: bool = False
) -> Column:
    return Column(meaning, "number", rule, exact=exact, ungated=ungated, infinite=infinite)


def whole(meaning: str, rule: Rule | None = None, ungated: str = "") -> Column:
    return Column(meaning, "whole", rule, ungated=ungated)


def words(meaning: str) -> Column:
    """Text that is written for a reader."""
    return Column(meaning, ungated="wording; what it says of the numbers stands in columns of their own")


def seconds(meaning: str) -> Column:
    return Column(meaning, "number", timed=True)


COMMON = {
    "scene": Column("name of the scene"),
    "method": Column("name of the method"),
    "family": Column(
        "contact, variational or established, as the method declares; limit: a plain C loop", rule=Rule.same
    ),
    "engine": Column(
        "what runs it: numba, jax, python, c+python (compiled solver, Python callbacks), llvm, c, c++, mpmath",
        rule=Rule.same,
    ),
    "control": Column("what is set: step, rtol or, of an exact method, nothing", rule=Rule.same),
    "value": number("its value, in full; 0 for nothing", Rule.same, exact=True),
    "variant": Column("which of several ways to run it; of a C loop, the kernel", rule=Rule.same),
    "setting": Column("variant, control and value, printed", rule=Rule.same),
    "status": Column("ok, diverged, budget, failed, timeout, unsupported", rule=Rule.same),
    "message": Column("why, when the status is not ok", ungated="a solver's words, which change with its version"),
}  # fmt: skip

COUNTS = {
    "steps": whole("accepted steps", Rule.count),
    "evaluations": whole("evaluations of evaluation_kind in one run", Rule.count),
    "evaluation_kind": Column("gradient, rhs, taylor (orders of Taylor coefficients) or rotation", rule=Rule.same),
    "rhs_equivalents": number(
        "evaluations on the scale of one right-hand side (two rotations count as one)", Rule.count
    ),
    "jacobians": whole("Jacobian evaluations", Rule.count),
    "rejected": whole("rejected steps of an adaptive method; empty where the solver does not tell them", Rule.count),
}  # fmt: skip

ERROR = number("max ‖y − y*‖ / max ‖y*‖", Rule.error)

#: what one cell makes as a whole in the tables of laws, orders and hard scenes: a method's whole ladder
ONE_CELL = ("scene", "method", "engine")

#: how often and how long
TIMING = {
    "time_min_s": seconds("the estimate: least round of all visits, seconds per call"),
    "time_median_s": seconds("median over rounds, seconds per call"),
    "time_iqr_s": seconds("interquartile range over rounds"),
    "time_halves_ratio": seconds("least round of the even visits over that of the odd ones: the cell's own spread"),
    "time_process_ratio": seconds(
        "least round in a second process over time_min_s, of a sample of cells: what processes differ by"
    ),
    "visits": Column("visits to the cell, spread over the whole timed part", "whole", timed=True),
    "rounds": Column("timed rounds of all visits together", "whole", timed=True),
    "iterations": Column("calls per round", "whole", timed=True),
}  # fmt: skip


def length_timing(what: str, of_more: str) -> dict[str, Column]:
    """Return the columns of fixed and marginal cost, from the least rounds of two lengths of a run."""
    return {
        "fixed_s": seconds(f"what a call takes however {what}"),
        "marginal_s": seconds(f"what {of_more} takes"),
        "marginal_halves_ratio": seconds(
            "marginal_s from the even visits over that from the odd ones; blank where either is no larger than 0"
        ),
        "marginal_process_ratio": seconds(
            "marginal_s from a second process over that of the first, of a sample of cells"
        ),
    }
