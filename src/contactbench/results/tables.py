"""The tables of the benchmark, one per question."""

from __future__ import annotations

from contactbench.measure.laws import LAWS
from contactbench.results.columns import (
    COMMON,
    COUNTS,
    DRIFTS,
    ERROR,
    ONE_CELL,
    SOLVER,
    TIMING,
    law_column,
    law_columns,
    length_timing,
    number,
    same,
    seconds,
    whole,
    words,
)
from contactbench.results.schema import KEY, SPREAD, Column, Rule, table

SAVED_TIMES = whole("number of saved times", Rule.same)

CONVERGENCE = table(
    "convergence",
    "error against step size, and the order fitted to it",
    {
        **COMMON,
        "step": number("step size h", Rule.same, exact=True),
        "solution_error": ERROR,
        "pairwise_order": number("slope between this step and the next larger one", Rule.slope),
        "in_fit": Column(
            "whether the order rests on this point",
            "flag",
            ungated="the last points come and go with rounding",
        ),
        "order": number(
            "order on this scene, extrapolated from the pairwise slopes (the same in every row)", Rule.order
        ),
        "last_slope": number("pairwise slope of the two finest points the order rests on", Rule.order),
        "order_uncertainty": number(
            "of the order: the spread of successive extrapolations, and round-off",
            ungated="an estimate of the error of a number that is compared",
        ),
        "order_nominal": whole("order the method claims", Rule.same),
        **COUNTS,
    },
    whole=ONE_CELL,
)

LAWS_TABLE = table(
    "laws",
    "decay laws and drifts over the whole run, maxima over the saved times",
    lambda: {**COMMON, "saved_times": SAVED_TIMES, **law_columns(), **DRIFTS, **COUNTS},
    whole=ONE_CELL,
)

LAWS_TIME = table(
    "laws_time",
    "energy and the deviation from each law along time",
    {
        **COMMON,
        "t": number("time"),
        "energy": number("H0", Rule.value),
        "energy_deviation": number("|H0(y) / H0(y*) − 1|", Rule.error),
        "hamiltonian_deviation": number("|H e^{∫Γ'} − H(y₀)| / |H(y₀)|", Rule.error),
        "momentum_deviation": number("‖J e^{∫Γ'} − J(y₀)‖ / ‖J(y₀)‖", Rule.structure),
        "contact_deviation": number("‖Φ*η − e^{−∫Γ'} η‖ / ‖e^{−∫Γ'} η‖", Rule.structure),
    },
    key=(*KEY, "t"),
    whole=ONE_CELL,
)

AT_EQUAL_COST = ("energy_law", "hamiltonian_law", "momentum_law", "contact_drift")
DECAY_LAWS = table(
    "decay_laws",
    "errors and decay laws of every method at equal cost, the largest at five times",
    {
        **COMMON,
        "value": number("the step or tolerance that meets the cost", Rule.value, exact=True),
        "cost": number("right-hand sides per unit of time asked for", Rule.same),
        "solution_error": ERROR,
        **{name: law_column(LAWS[name]) for name in AT_EQUAL_COST},
        **DRIFTS,
        **COUNTS,
    },
    key=("scene", "method", "engine", "cost"),
)

WORK_PRECISION = table(
    "work_precision",
    "time and evaluations against error",
    {
        **COMMON,
        "carried": same("fields integrated"),
        "solution_error": number(
            "max ‖y − y*‖ / max ‖y*‖ over five end times, each the end of its own run", Rule.error
        ),
        **COUNTS,
        SPREAD: number(
            "largest over fewest evaluations, less 1, of runs whose initial data differ by a few roundings; of solvers "
            "that choose their order",
            ungated="it is what the gate allows the counts",
        ),
        "compile_s": seconds(
            "trace and compile, once per scene structure (once per tolerance for heyoka), or load"
        ),
        "first_call_s": seconds("first call after compilation"),
        **TIMING,
        **length_timing(
            "short the run: from runs over a fifth of the span and all of it, time = fixed + marginal · T; negative "
            "where later steps are dearer",
            "a unit of the scene's time, over the last four fifths of the span,",
        ),
        "call_s": seconds("what the public call takes beyond the solver's own, which the times are of"),
    },
    version=4,
)

ENSEMBLE_TABLE = table(
    "ensemble",
    "throughput of ensembles: against C loops, at equal error, with their number and with the cores",
    {
        **COMMON,
        "question": Column("what the row is for: arithmetic (same steps as C loops), error, size or cores"),
        "trajectories": whole("number of trajectories"),
        "cores": whole("cores used"),
        "solution_error": number(
            "max ‖y(T) − y*(T)‖ / max ‖y*(T)‖ over the first four trajectories", Rule.error
        ),
        "member_deviation": number(
            "max ‖y(T) − y₁(T)‖ / max ‖y₁(T)‖ over all trajectories, y₁ the run of each by itself with the same fixed "
            "steps; of a method that chooses them the most accurate run of heyoka-taylor; blank where that takes long",
            Rule.structure,
        ),
        "steps": whole(
            "accepted steps of one trajectory, the most taken by any where they differ", Rule.count
        ),
        "evaluations": whole(
            "evaluations of evaluation_kind for one trajectory, where the solver says", Rule.count
        ),
        "evaluation_kind": same("gradient, rhs or taylor"),
        "first_call_s": seconds("first call, compilation included"),
        **TIMING,
        **length_timing(
            "few the trajectories: from calls with a quarter and all of them, time = fixed + marginal · n",
            "one more trajectory",
        ),
    },
    key=(*KEY, "question", "trajectories", "cores"),
    version=4,
)

DEFINITIONS = table(
    "definitions",
    "what every scene and every method is, in a digest of its own numbers and not of anything measured",
    {
        "scene": Column("name of the scene; blank in the row of a method"),
        "method": Column("name of the method; blank in the row of a scene"),
        "declared": same("what it declares, as data"),
        "digest": same(
            "of a scene's numbers and functions, of a method's steps, with 50 digits: alike everywhere"
        ),
    },
    key=("scene", "method"),
    version=1,
)

CLAIMS_TABLE = table(
    "claims",
    "every claim of the paper, and some beyond it, with a measured number and the verdict that follows",
    {
        "id": Column("number of the claim"),
        "where": words("section, equation or figure of the paper, or beyond it"),
        "claim": words("what is claimed, in our words"),
        "scene": same("what it is measured on"),
        "method": same("integrator, or how the equations themselves are tested"),
        "quantity": words("what was measured; of several measurements the first that fails, else the first"),
        "measured": number("its value", Rule.measured),
        "relation": same("how it must compare with the bound for the claim to hold"),
        "bound": number("the bound", Rule.value),
        "bound_reason": words("why the bound is what it is"),
        "verdict": same("holds; holds, corrected; refuted: computed from the measurements"),
        "correction_kind": same("repairs (substance survives), replaces (contradicts), sharpens, extends"),
        "correction": words("the corrected statement"),
        "corrected_quantity": words("what was measured of it"),
        "corrected_measured": number("its value", Rule.measured),
        "corrected_relation": same("how it must compare with its bound"),
        "corrected_bound": number("its bound", Rule.value),
        "corrected_bound_reason": words("why that bound"),
        "evidence": words("all measurements of the claim, separated by //"),
        "corrected_evidence": words("all measurements of the corrected statement, separated by //"),
        "figures": same("the paper's figures drawn for it"),
        "command": words("the command that measures it again"),
        "status": same("ok, or failed: not measured, no verdict"),
        "message": Column("why, when the status is not ok", ungated=SOLVER),
    },
    key=("id",),
    version=2,
)

PAPER_FIGURES = table(
    "paper_figures",
    "the data of the paper's figures, corrected where the claim behind them fell",
    {
        "figure": Column("paper_N, or the name of a figure of ours"),
        "panel": Column("panel of the figure"),
        "curve": Column("curve in the panel"),
        "point": whole("number of the point along its curve"),
        "kind": same("truth, law, method, conservative, dissipative, flow, criterion; or its stability"),
        "x": number("abscissa", Rule.point),
        "y": number("ordinate", Rule.point),
        "z": number("third coordinate, fitted order or growth rate where the figure has one", Rule.point),
    },
    key=("figure", "panel", "curve", "point"),
    whole=("figure",),
    version=2,
)

BEFORE_LAWS = {
    **COMMON,
    "saved_times": SAVED_TIMES,
    "end_time": number("how far the run got", Rule.end),
    "blow_up_time": number("when the true motion reaches infinity, if it does", Rule.value),
    "condition_number": number(
        "max ‖∂x(t)/∂x(0)‖₂ of the true motion, where stored: what errors grow to", Rule.value
    ),
    "end_error": number(
        "‖(q, p) − (q, p)*‖ / ‖(q, p)*‖ at the end (a body: M), relative to what is left", Rule.error
    ),
}
CALL_TIME = seconds(
    "fastest of a few public calls, of a long one the first or second; other work may run beside it"
)
STABILITY = table(
    "stability",
    "the hard scenes: how every method ends, its errors and laws, at a fixed ladder of costs",
    lambda: {**BEFORE_LAWS, **law_columns(), **DRIFTS, **COUNTS, "time_s": CALL_TIME},
    whole=ONE_CELL,
)


def value(meaning: str) -> Column:
    """Return a column of a number that may be infinite."""
    return number(meaning, Rule.value, infinite=True)


STABILITY_LIMITS = table(
    "stability_limits",
    "largest step with a bounded orbit of the oscillator q'' + γq' + ω²q = 0",
    {
        "method": Column("name of the method"),
        "family": COMMON["family"],
        "gamma": number("damping γ"),
        "omega": number("frequency ω"),
        "limit": value(
            "first loss of stability: where an eigenvalue of the one-step map leaves the unit circle"
        ),
        "limit_kernel": value("of a processed method saved at the end only: its kernel's limit"),
        "limit_saved": value("of a processed method saved at every step"),
        "windows": same("intervals of unstable steps below the last stable step, a…b; blank: none"),
        "last": value("the last stable step; islands of stability shorter than 1 % of the step not counted"),
        "theory": value("what theory gives, where it does"),
        "per_evaluation": value("the limit over the evaluations of a step"),
    },
    key=("method", "gamma", "omega"),
)

RADIUS = value("largest |eigenvalue| of the one-step map, of a processed method that of its kernel")
ONE_STEP = table(
    "one_step",
    "spectral radius of the one-step map of the oscillator, ω = 1, beside that of the exact flow",
    {
        "method": Column("name of the method"),
        "family": COMMON["family"],
        "gamma": number("damping γ"),
        "step": number("step size h", Rule.value),
        "radius": RADIUS,
        "radius_saved": value("the same of a processed method where every step is saved"),
        "true_radius": number(
            "of the exact flow: e^{−γh/2}, e^{−λh} with the slow rate λ where overdamped", Rule.value
        ),
    },
    key=("method", "gamma", "step"),
)

SAME_NUMBER = "rate_error is the same number, and counts its round-off"
DAMPING_RATES = table(
    "damping_rates",
    "measured damping rates: the slow rate of the overdamped oscillator, the rate of weak damping",
    {
        "experiment": Column("overdamped or weak"),
        **COMMON,
        "t_end": number("span of the run", Rule.same),
        "damping_per_step": number("γh, fixed steps", Rule.value),
        "evaluations": whole("evaluations in one run", Rule.count),
        "rate": number("measured rate", ungated=SAME_NUMBER),
        "true_rate": number("the same measured on the truth", Rule.value),
        "ratio": number("measured over true", ungated=SAME_NUMBER),
        "rate_error": number("|measured/true − 1|", Rule.error),
        "q_error": number("|q/q* − 1| at the end, overdamped", Rule.error),
        "p_error": number("|p/p* − 1| at the end, overdamped: what is kicked last is not damped", Rule.error),
    },
    key=("experiment", "scene", "method", "setting", "t_end"),
    whole=("experiment", "scene", "method", "t_end"),
)

STRONG_DAMPING = table(
    "strong_damping",
    "error of fixed-step methods at equal cost as damping gets strong, oscillator, ω = 1",
    {
        "method": Column("name of the method"),
        "family": COMMON["family"],
        "gamma": number("damping γ"),
        "damping_per_evaluation": number(
            "γh over the evaluations of a step: the damping between two evaluations"
        ),
        "step": number("step size h", Rule.value),
        "error": number(
            "‖M − Φ_T‖₂/‖Φ_T‖₂ of a run M over the time T in which the motion falls by e, the end saved",
            Rule.error,
            infinite=True,
        ),
        "error_saved": number(
            "the same of a processed method where every step is saved", Rule.error, infinite=True
        ),
        "radius": RADIUS,
    },
    key=("method", "gamma", "damping_per_evaluation"),
)
