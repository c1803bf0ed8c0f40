"""Measures along a trajectory: solution error, decay laws, drifts; `law` registers another one."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from contactbench.checks import is_real, refuse
from contactbench.errors import BadInput
from contactbench.measure.law import (
    ATTAINABLE,
    MEANINGFUL,
    OF_THE_STATE,
    STRUCTURE,
    WRECKED,
    Deviation,
    Gate,
    Law,
    Measured,
    Undefined,
    conformal,
    is_kept,
    round_off_bound,
)
from contactbench.measure.pullback import Pulled, growth, in_units, pairs, pullback, units_of
from contactbench.methods.base import METHODS
from contactbench.methods.prepared import Patience
from contactbench.registry import Registry
from contactbench.scene import Scene
from contactbench.scene.base import Elapsed
from contactbench.scene.definition import verify_along
from contactbench.scene.scales import errors
from contactbench.solution import Solution
from contactbench.truth import OutOfTime, Reference, condition_number, reference

if TYPE_CHECKING:
    import pandas as pd

LAWS = Registry("law", Law)


def law(
    definition: str, label: str, **properties: Any
) -> Callable[[Callable[[Solution], Deviation | float]], Law]:
    """Return a decorator that registers a measure under the name of its function; `properties` are fields of `Law`."""

    def register(measure: Callable[[Solution], Deviation | float]) -> Law:
        made = Law(measure.__name__, definition, label, measure, **properties)
        LAWS.add(made)
        return made

    return register


def laws_of(scene: Scene) -> list[Law]:
    return [item for item in LAWS.values() if item.applies(scene)]


def has_linear_damping(scene: Scene) -> bool:
    """Return whether H = T + V + γs, where γ may depend on the time."""
    return scene.canonical and (scene.conformal_rate is not None or scene.clock is not None)


# -- comparisons with the truth --------------------------------------------------------------------
def truth(solution: Solution) -> Reference:
    """Return the true states at the saved times of a run; cache them, or the error, in the run."""
    if solution.truth is None:
        scene = solution.scene
        own = scene.pack(scene.initial(solution.carry))
        if solution.y0 is not None and not np.array_equal(own, solution.y0):
            scene = scene.with_(**scene.data(solution.start()))
        limit = {} if solution.patience is None else {"seconds": solution.patience.left}
        try:
            solution.truth = reference(scene, Elapsed(solution.elapsed), solution.carry, **limit)
        except BadInput as why:
            solution.truth = why
    if isinstance(solution.truth, BadInput):
        raise solution.truth
    known: Reference = solution.truth
    return known


def errors_of(runs: Sequence[Solution]) -> np.ndarray:
    """Return the errors of runs from one start at all their saved times, on common scales: see `errors`."""
    one = runs[0]
    start = one.scene.pack(one.scene.initial(one.carry)) if one.y0 is None else one.y0
    y, true = (np.vstack(rows) for rows in ([run.y for run in runs], [truth(run).y for run in runs]))
    return errors(one.scene, y, true, start, one.carry)


@law(
    "max ‖y − y*‖ / max ‖y*‖, the start included, y* the true state: the largest of q, p, M, R and every component "
    "with a unit of its own, each taken by itself",
    "solution error",
)
def solution_error(solution: Solution) -> float:
    return float(errors_of([solution]).max())


def energies(solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    scene = solution.scene
    return scene.energy(solution.states()), scene.energy(truth(solution).states())


@law("max |H0(y) − H0(y*)| / |H0(y₀)|", "H0 law", applies=lambda scene: scene.has_energy)
def energy_law(solution: Solution) -> float:
    numerical, exact = energies(solution)
    first = abs(float(solution.scene.energy(solution.start())))
    return float(np.abs(numerical - exact).max()) / first if first else math.nan


#: the meaning of ∫Γ' in the definitions of the laws
RATE = (
    "∫Γ' = γt, or the integral of γ(t); where Γ' depends on s, e^{−∫Γ'} = H*(t)/H(y₀) of the true motion; relative to "
    "no less than a thousandth of the terms that cancel"
)


# -- conformal laws --------------------------------------------------------------------------------
def decay_rate(solution: Solution) -> float | np.ndarray:
    """Return γ with which e^{−γt} is the conformal factor of the exact flow at the saved times.

    If Γ'(s) changes, return the mean rate up to each saved time, (k,), from the truth: H' = −Γ'(s) H, hence
    e^{−∫Γ'(s)dt} = H*(t)/H(0).  Raises `Undefined` if H(0) = 0.
    """
    scene = solution.scene
    if (rate := scene.conformal_rate) is not None:
        return float(rate)
    damped = scene.damped_by(solution.start(), solution.elapsed, np)
    if damped is None:
        start = float(scene.hamiltonian_at(solution.start()))
        if start == 0:
            raise Undefined(f"scene {scene.name!r}: H(0) = 0, the conformal factor cannot be read off H")
        damped = -np.log(scene.hamiltonian_at(truth(solution).states()) / start)
    mean: np.ndarray = np.divide(
        damped, solution.elapsed, out=np.zeros(len(damped)), where=solution.elapsed > 0
    )
    return mean


@law(
    f"max |H e^{{∫Γ'}} − H(y₀)| / |H(y₀)|; {RATE}",
    "H law",
    needs=("s",),
    applies=lambda scene: scene.has_hamiltonian_law,
)
def hamiltonian_law(solution: Solution) -> Deviation:
    scene, states = solution.scene, solution.states()
    value, terms = scene.hamiltonian_at(states), scene.hamiltonian_terms(states)
    start = np.array([scene.hamiltonian_at(solution.start())])
    return conformal(value[:, None], start, solution.elapsed, decay_rate(solution), terms)


@law(
    "max |H̃ e^{γt} − H̃(y₀)| / |H̃(y₀)|, H̃ = H + O(h^p) the modified Hamiltonian up to h⁴; blank for a method "
    "without a known one",
    "modified H law",
    needs=("s",),
    applies=lambda scene: has_linear_damping(scene) and scene.has_hamiltonian_law,
)
def modified_hamiltonian(solution: Solution) -> Deviation | float:
    scene, states, run = solution.scene, solution.states(), solution.run
    value = None
    with suppress(TypeError):  # a user's potential that takes no dual numbers
        if run is not None:
            value, start = (run.modified_hamiltonian(x) for x in (states, solution.start()))
    if value is None:
        return math.nan
    terms = scene.hamiltonian_terms(states)
    return conformal(value[:, None], np.array([start]), solution.elapsed, decay_rate(solution), terms)


def is_of_contact_flows(solution: Solution) -> bool:
    """Return whether the method composes its runs of exact contact flows."""
    method = METHODS.get(solution.method)
    return method is not None and method.family == "contact"


def knows_factor(solution: Solution) -> bool:
    """Return whether the method is a contact one and ∫Γ' does not depend on the motion."""
    known = solution.scene.damped_by(solution.start(), solution.elapsed, np) is not None
    return is_of_contact_flows(solution) and known


def is_of_symmetric_flows(solution: Solution) -> bool:
    """Return whether the flows also have the symmetry of the scene, which an expansion about a point may lack."""
    return knows_factor(solution) and not METHODS[solution.method].expands


def is_contact_map(solution: Solution) -> bool:
    """Return whether the method claims contact maps with the known factor of the exact flow."""
    return knows_factor(solution) and METHODS[solution.method].contact


def is_composed(solution: Solution) -> bool:
    """Return whether the run is a composition of contact maps, with any factors."""
    return solution.run is not None and solution.run.composed


@law(
    f"max ‖J e^{{∫Γ'}} − J(y₀)‖ / ‖J(y₀)‖; {RATE}",
    "J law",
    needs=("R",),
    applies=lambda scene: scene.is_contact and scene.has_momentum_law,
    gate=Gate.structure,
    claimed=is_of_symmetric_flows,
)
def momentum_law(solution: Solution) -> Deviation:
    scene, states = solution.scene, solution.states()
    value, terms = np.array(scene.momentum_at(states)).T, scene.momentum_terms(states)
    start = np.array(scene.momentum_at(solution.start()))
    return conformal(value, start, solution.elapsed, decay_rate(solution), terms)


# -- contact structure -----------------------------------------------------------------------------
#: common properties of the laws of Φ*η
CONTACT: dict[str, object] = {"needs": ("R", "s"), "gate": Gate.structure, "differentiates": True}
CONTACT["applies"] = lambda scene: scene.is_contact


def pulled_deviation(solution: Solution, pulled: Pulled | None) -> Deviation | float:
    if pulled is None:
        return math.nan
    values, start, terms, error = pulled
    return conformal(values, start, solution.elapsed, decay_rate(solution), terms, error)


@law(
    f"‖Φ*η − e^{{−∫Γ'}} η‖ / ‖e^{{−∫Γ'}} η‖; {RATE}",
    "contact drift",
    claimed=is_contact_map,
    **CONTACT,
)
def contact_drift(solution: Solution) -> Deviation | float:
    return pulled_deviation(solution, pullback(solution, solution.differential))


@law("sine of the angle between Φ*η and η", "ker η drift", claimed=is_composed, **CONTACT)
def distribution_drift(solution: Solution) -> Deviation | float:
    pulled = pullback(solution, solution.differential)
    if pulled is None:
        return math.nan
    unit = pulled.start / np.linalg.norm(pulled.start)
    whole, attainable = np.linalg.norm(pulled.values, axis=1), ATTAINABLE * pulled.terms
    length = np.maximum(whole, attainable)
    length = np.where(length > MEANINGFUL, length, math.inf)
    values = pulled.values / length[:, None]
    across = np.linalg.norm(values - (values @ unit)[:, None] * unit, axis=1)
    error = None if pulled.uncertainty is None else pulled.uncertainty / length
    return Deviation(across, error, attainable > whole)


@law(
    "max ‖σ_i σ_{2n+1−i} − e^{−γt}‖ / ‖e^{−γt}‖ over the n pairs of singular values of the tangent map of (q, p), "
    "e^{−∫γ} where γ changes with time; relative to no less than a thousandth of σ_1‖σ‖",
    "pairing drift",
    applies=has_linear_damping,
    gate=Gate.structure,
    differentiates=True,
    claimed=is_contact_map,
)
def pairing_drift(solution: Solution) -> Deviation | float:
    start = solution.start()
    units = units_of(solution.scene, start)
    return pulled_deviation(solution, pairs(solution.differential, len(start.q), units))


@law(
    "max ‖RᵀR − 1‖_F; R is quadratic in a quaternion that is not normalised",
    "attitude drift",
    needs=("R",),
    applies=lambda scene: "R" in scene.optional,
    gate=Gate.structure,
    claimed=is_of_contact_flows,
)
def attitude_drift(solution: Solution) -> float:
    R = solution.R
    assert R is not None
    return float(np.linalg.norm(np.swapaxes(R, 1, 2) @ R - np.eye(3), axis=(1, 2)).max())


@law(
    "max of | |q|/R − 1 | and |q·p|/RP over the points, P the size of the momenta, estimated at the start",
    "sphere drift",
    applies=lambda scene: scene.constrained,
    gate=Gate.structure,
    claimed=is_of_contact_flows,
)
def sphere_drift(solution: Solution) -> float:
    departure = solution.scene.departure(solution.states(), solution.start())
    return float(np.max(np.array(departure)))


@law(
    "number of saved steps on which H0 grows although γ > 0",
    "H0 grows",
    applies=lambda scene: not scene.may_gain_energy,
    gate=Gate.count,
)
def energy_increases(solution: Solution) -> float:
    energy = solution.scene.energy(solution.states())
    energy = np.concatenate([[solution.scene.energy(solution.start())], energy])
    grows = np.diff(energy) > 4 * np.finfo(float).eps * np.abs(energy[:-1])  # more than round-off
    return float(np.count_nonzero(grows))


# -- all laws of a run ----------------------------------------------------------------------------
def measured_row(item: Law, solution: Solution) -> tuple[float, bool, str, str]:
    """Return the deviation from a law, whether it is an upper bound, a note if it is missing, and the definition."""
    try:
        found, note = item.measured(solution), "" if solution.ok else str(solution.status)
        if solution.ok and item.differentiates and not solution.differential.taken:
            note = solution.differential.source
    except BadInput as error:  # no reference to compare with, or H(0) = 0
        found, note = Measured(math.nan), str(error)
    return found.value, found.bound, note, item.definition


def laws(solution: Solution, seconds: float = 60.0) -> pd.DataFrame:
    """Measure the deviation of a run from every law of its scene whose fields it carries.

    Parameters
    ----------
    solution : Solution
        The run.
    seconds : float
        Limit of time, mostly for the reference and, for an adaptive solver, for the runs that give the derivative of
        its map; ``math.inf`` for no limit.

    Returns
    -------
    DataFrame
        Indexed by the law's name; deviation (the maximum over the saved times), upper_bound (whether it is only a
        bound, because a derivative by differences does not resolve it), note (why there is no number), definition.

    Raises
    ------
    BadInput
        If the gradient of the scene is not the derivative of its potential along the motion, and for seconds ≤ 0.
    """
    import pandas as pd
    from tqdm import tqdm

    if not (hasattr(seconds, "__float__") and is_real(seconds) and seconds > 0):
        refuse("seconds", seconds, "a number > 0")
    until = perf_counter() + float(seconds)
    verify_along(solution.scene)
    rows = {}
    bar = tqdm(laws_of(solution.scene), "laws", unit="law", delay=1.0, leave=False, disable=None)
    judged = solution.at_steps
    solution.patience = judged.patience = patience = Patience(until, bar.set_postfix_str)
    try:
        for item in bar:
            bar.set_postfix_str(item.label)
            if set(item.needs_on(solution.scene)) <= set(solution.carry):
                with np.errstate(all="ignore"):  # states may be huge
                    rows[item.name] = measured_row(item, solution)
    finally:  # results that ran out of time are computed again by a later call
        solution.patience = judged.patience = None
        if patience.over:
            vars(judged).pop("differential", None)
        if isinstance(solution.truth, OutOfTime):
            solution.truth = None
    return pd.DataFrame.from_dict(
        rows, orient="index", columns=["deviation", "upper_bound", "note", "definition"]
    ).rename_axis("law")


# -- all laws as a row ----------------------------------------------------------------------------
def row(
    solution: Solution, without: str = "", leave_out: Callable[[str], bool] = lambda name: False
) -> dict[str, object]:
    """Return the laws of a run as columns: NAME, of a structural law NAME_claimed and NAME_kept, and `bound`.

    without : why no derivative is taken.  leave_out : whether a law, by its name, is not measured; "solution_error"
    always is, since a run that does not follow the motion is not judged.
    """
    if not solution.ok:
        return {}
    scene, found, judged = solution.scene, dict[str, Measured](), solution.at_steps
    for item in laws_of(scene):
        wanted = item.name == "solution_error" or not leave_out(item.name)
        if wanted and not (without and item.differentiates):
            with suppress(Undefined):
                found[item.name] = item.measured(solution)
    columns: dict[str, Any] = {name: measured.value for name, measured in found.items()}
    known = scene.is_contact and not without and judged.differential.taken
    magnified = (growth(in_units(judged)) if known else 0.0) or condition_number(scene) or 1.0
    evaluations = solution.counts.evaluations or 0
    of_state, of_map = (max(STRUCTURE, round_off_bound(each, evaluations)) for each in (1.0, magnified))
    follows = not columns["solution_error"] > WRECKED
    for name, measured in found.items():
        if LAWS[name].structural and not math.isnan(measured.value):
            bound, faded = of_state if name in OF_THE_STATE else of_map, measured.clamped == len(judged.t)
            columns[f"{name}_claimed"] = LAWS[name].claimed(judged)
            kept = is_kept(measured.value, bound, measured.bound, faded) if follows else None
            columns[f"{name}_kept"] = kept
    return columns | {"bound": of_map if follows else math.nan}
