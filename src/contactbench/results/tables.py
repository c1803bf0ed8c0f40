"""The tables of the benchmark, one per question, and the columns they have in common."""

from __future__ import annotations

from contactbench.measure.laws import DRIFT_COLUMNS, LAWS
from contactbench.results.columns import (
    COMMON,
    COUNTS,
    ERROR,
    ONE_CELL,
    TIMING,
    length_timing,
    number,
    seconds,
    whole,
    words,
)
from contactbench.results.law_columns import WithLaws, law_column
from contactbench.results.schema import KEY, SPREAD, Column, Rule, table

#: why an error bar has no rule
ROUND_OFF = "an estimate of round-off, no reproducible number"


def drift_column(name: str, meaning: str) -> Column:
    """What belongs to the drifts: error bars, clamps, and where the derivative is from."""
    if name.endswith("_clamped"):
        return whole(meaning, Rule.count)
    if name.endswith("_uncertainty"):
        return number(meaning, ungated=ROUND_OFF)
    return Column(meaning, rule=Rule.same) if name == "derivative" else number(meaning, Rule.value)


SAVED_TIMES = whole("number of saved times", Rule.same)
DRIFTS = {name: drift_column(name, meaning) for name, meaning in DRIFT_COLUMNS.items()}


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
            ungated="the last points of a fit come and go with rounding; the order itself is compared",
        ),
        "order": number(
            "order of the method on this scene, extrapolated from the pairwise slopes (the same in every row)",
            Rule.order,
        ),
        "last_slope": number("pairwise slope of the two finest points the order rests on", Rule.order),
        "order_uncertainty": number(
            "of the order: from the spread of successive extrapolations, and round-off",
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
    WithLaws({**COMMON, "saved_times": SAVED_TIMES}, {**DRIFTS, **COUNTS}),
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

DECAY_LAWS = table(
    "decay_laws",
    "errors and decay laws of every method at equal cost, the largest at five times",
    {
        **COMMON,
        "value": number("the step or tolerance that meets the cost", Rule.value, exact=True),
        "cost": number("right-hand sides per unit of time asked for", Rule.same),
        "solution_error": ERROR,
        **{
            name: law_column(LAWS[name])
            for name in ("energy_law", "hamiltonian_law", "momentum_law", "contact_drift")
        },
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
        "carried": Column("fields integrated", rule=Rule.same),
        "solution_error": number(
            "max ‖y − y*‖ / max ‖y*‖ over five end times, each the end of its own run", Rule.error
        ),
        **COUNTS,
        SPREAD: number(
            "largest over fewest evaluations, less 1, of runs whose initial data differ by a few roundings; of "
            "solvers that choose their order",
            ungated="it is what the gate allows the counts",
        ),
        "compile_s": seconds(
            "trace and compile, once per scene structure (once per tolerance for heyoka); a program that an "
            "earlier process has compiled is loaded"
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
            "max ‖y(T) − y₁(T)‖ / max ‖y₁(T)‖ over all trajectories, y₁ the run of each by itself: with the same fixed "
            "steps; of a method that chooses them the most accurate run of heyoka-taylor; blank where that takes long",
            Rule.structure,
        ),
        "steps": whole("accepted steps of one trajectory, the most taken by any where they differ", Rule.count),
        "evaluations": whole(
            "evaluations of evaluation_kind for one trajectory, where the solver says", Rule.count
        ),
        "evaluation_kind": Column("gradient, rhs or taylor", rule=Rule.same),
        "first_call_s": seconds("first call, compilation included"),
        **TIMING,
        **length_timing(
            "few the trajectories: from calls with a quarter and all of them, time = fixed + marginal · n",
            "one more trajectory",
        ),
    },
    key=(*KEY, "question", "trajectories", "cores"),
    version=4,
)  # fmt: skip

DEFINITIONS = table(
    "definitions",
    "what every scene and every method is, in a digest of its own numbers and not of anything measured",
    {
        "scene": Column("name of the scene; blank in the row of a method"),
        "method": Column("name of the method; blank in the row of a scene"),
        "declared": Column("what it declares, as data", rule=Rule.same),
        "digest": Column(
            "of a scene's numbers and functions, of a method's steps, with 50 digits: the same on every machine",
            rule=Rule.same,
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
        "scene": Column("what it is measured on", rule=Rule.same),
        "method": Column("integrator, or how the equations themselves are tested", rule=Rule.same),
        "quantity": words("what was measured; of several measurements the first that fails, else the first"),
        "measured": number("its value", Rule.measured),
        "relation": Column("how it must compare with the bound for the claim to hold", rule=Rule.same),
        "bound": number("the bound", Rule.value),
        "bound_reason": words("why the bound is what it is"),
        "verdict": Column(
            "holds; holds, corrected; refuted: computed from the measurements", rule=Rule.same
        ),
        "correction_kind": Column(
            "repairs (substance survives), replaces (contradicts), sharpens, extends", rule=Rule.same
        ),
        "correction": words("the corrected statement"),
        "corrected_quantity": words("what was measured of it"),
        "corrected_measured": number("its value", Rule.measured),
        "corrected_relation": Column("how it must compare with its bound", rule=Rule.same),
        "corrected_bound": number("its bound", Rule.value),
        "corrected_bound_reason": words("why that bound"),
        "evidence": words("all measurements of the claim, separated by //"),
        "corrected_evidence": words("all measurements of the corrected statement, separated by //"),
        "figures": Column("the paper's figures drawn for it", rule=Rule.same),
        "command": words("the command that measures it again"),
        "status": Column("ok, or failed: not measured, no verdict", rule=Rule.same),
        "message": Column("why, when the status is not ok", ungated="a solver's words, which change with its version"),
    },
    key=("id",),
    version=2,
)  # fmt: skip

PAPER_FIGURES = table(
    "paper_figures",
    "the data of the paper's figures, corrected where the claim behind them fell",
    {
        "figure": Column("paper_N, or the name of a figure of ours"),
        "panel": Column("panel of the figure"),
        "curve": Column("curve in the panel"),
        "point": whole("number of the point along its curve"),
        "kind": Column(
            "what it is: truth, law, method, conservative, dissipative, flow, criterion; or its stability",
            rule=Rule.same,
        ),
        "x": number("abscissa", Rule.point),
        "y": number("ordinate", Rule.point),
        "z": number("third coordinate, fitted order or growth rate where the figure has one", Rule.point),
    },
    key=("figure", "panel", "curve", "point"),
    whole=("figure",),
    version=2,
)

STABILITY = table(
    "stability",
    "the hard scenes: how every method ends, its errors and laws, at a fixed ladder of costs",
    WithLaws(
        {
        **COMMON,
        "saved_times": SAVED_TIMES,
        "end_time": number("how far the run got", Rule.end),
        "blow_up_time": number("when the true motion reaches infinity, if it does", Rule.value),
        "condition_number": number(
            "max ‖∂x(t)/∂x(0)‖₂ of the true motion, where stored: what errors grow to", Rule.value
        ),
        "end_error": number(
            "‖(q, p) − (q, p)*‖ / ‖(q, p)*‖ at the end (a body: M), relative to what is left then", Rule.error
        ),
        },
        {
        **DRIFTS,
        **COUNTS,
        "time_s": seconds(
            "fastest of a few public calls, of a long one the first or second, 25 saved times; other work may run "
            "beside it"
        ),
        },
    ),
    whole=ONE_CELL,
)  # fmt: skip

STABILITY_LIMITS = table(
    "stability_limits",
    "largest step with a bounded orbit of the oscillator q'' + γq' + ω²q = 0",
    {
        "method": Column("name of the method"),
        "family": COMMON["family"],
        "gamma": number("damping γ"),
        "omega": number("frequency ω"),
        "limit": number(
            "first loss of stability: the step from which an eigenvalue of the one-step map leaves the unit circle",
            Rule.value,
            infinite=True,
        ),
        "limit_kernel": number(
            "of a processed method saved at the end only: its kernel's limit", Rule.value, infinite=True
        ),
        "limit_saved": number("of a processed method saved at every step", Rule.value, infinite=True),
        "windows": Column(
            "intervals of unstable steps below the last stable step, a…b; blank: none", rule=Rule.same
        ),
        "last": number(
            "the last stable step; islands of stability shorter than a hundredth of the step not counted",
            Rule.value,
            infinite=True,
        ),
        "theory": number("what theory gives, where it does", Rule.value, infinite=True),
        "per_evaluation": number("the limit over the evaluations of a step", Rule.value, infinite=True),
    },
    key=("method", "gamma", "omega"),
)

ONE_STEP = table(
    "one_step",
    "spectral radius of the one-step map of the oscillator, ω = 1, beside that of the exact flow",
    {
        "method": Column("name of the method"),
        "family": COMMON["family"],
        "gamma": number("damping γ"),
        "step": number("step size h", Rule.value),
        "radius": number(
            "largest |eigenvalue| of the one-step map, of a processed method that of its kernel",
            Rule.value,
            infinite=True,
        ),
        "radius_saved": number(
            "the same of a processed method where every step is saved", Rule.value, infinite=True
        ),
        "true_radius": number(
            "of the exact flow: e^{−γh/2}, e^{−λh} with the slow rate λ where overdamped", Rule.value
        ),
    },
    key=("method", "gamma", "step"),
)

DAMPING_RATES = table(
    "damping_rates",
    "measured damping rates: the slow rate of the overdamped oscillator, the rate of weak damping",
    {
        "experiment": Column("overdamped or weak"),
        **COMMON,
        "t_end": number("span of the run", Rule.same),
        "damping_per_step": number("γh, fixed steps", Rule.value),
        "evaluations": whole("evaluations in one run", Rule.count),
        "rate": number("measured rate", ungated="rate_error is the same number, and counts its round-off"),
        "true_rate": number("the same measured on the truth", Rule.value),
        "ratio": number(
            "measured over true", ungated="rate_error is the same number, and counts its round-off"
        ),
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
        "error_saved": number("the same of a processed method where every step is saved", Rule.error, infinite=True),
        "radius": number(
            "largest |eigenvalue| of the one-step map, of a processed method that of its kernel",
            Rule.value,
            infinite=True,
        ),
    },
    key=("method", "gamma", "damping_per_evaluation"),
)  # fmt: skip
