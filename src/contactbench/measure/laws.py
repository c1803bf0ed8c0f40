"""What is measured along a trajectory: solution error, decay laws, drifts.

Every law is a named object ``law(solution) -> float``, the maximum over the saved times unless it
says otherwise, and nan where the run did not end `ok`.  To add one, decorate a function with `law`.

Quantities that decay are compared on the scale of their decay, and in a form that stays finite when
e^{−γt} underflows: a saved value whose true size is below the smallest normal number divided by the
machine precision carries no relative information and must merely be as small.

H, J and Φ*η are differences of larger terms: T, V and Γ; the products of q and p; ∂s and p·∂q.  Strong
damping makes the terms cancel to e^{−γt} of their size, below any round-off, and an unstable motion makes
the derivatives grow.  A deviation is therefore measured against the true size of the quantity, but not
against less than `ATTAINABLE` of the terms it is the difference of: round-off of the terms stays round-off.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from contactbench.errors import BadInput, Registry
from contactbench.scene import Mechanical, RigidBody, Scene, rotation_matrix
from contactbench.solution import Solution
from contactbench.truth import reference

LAWS = Registry("law")

#: where a law may be shown: the first table of the results, the tables of laws, those of the hard scenes
VIEWS = ("overview", "laws", "stability")

#: below this a float64 has lost relative precision to gradual underflow
MEANINGFUL = np.finfo(float).tiny / np.finfo(float).eps
#: part of the cancelling terms below which a quantity is not resolved: round-off of a few ε stays below 10⁻¹²
ATTAINABLE = 1e-3


@dataclass(frozen=True)
class Law:
    """A measure: `definition` is its label in tables and figures, `needs` the fields it reads."""

    name: str
    definition: str
    measure: Callable[[Solution], float]
    needs: tuple[str, ...]
    applies: Callable[[Scene], bool]
    #: whether a contact method keeps it to round-off whatever the step size (see `structural_on`)
    structural: bool = False
    #: whether it compares with the decay e^{−∫Γ'} of the truth
    compares_decay: bool = False
    #: its short name in headings, and the views that show it (VIEWS); how the gate compares it: the name of a
    #: rule of the result tables, by default structure or error
    label: str = ""
    shown: tuple[str, ...] = ("laws",)
    gated: str = ""

    @property
    def gate(self) -> str:
        return self.gated or ("structure" if self.structural else "error")

    def __call__(self, solution: Solution) -> float:
        """The measure; nan unless the run ended `ok`.

        Raises `BadInput` when the scene has no such law or the run did not carry what it needs.
        """
        if not self.applies(solution.scene):
            raise BadInput(f"law {self.name!r} is not defined for scene {solution.scene.name!r}")
        missing = [f for f in self.needs_on(solution.scene) if f not in solution.carry]
        if missing:
            raise BadInput(f"law {self.name!r} needs carry=({', '.join(map(repr, missing))},)")
        return self.measure(solution) if solution.ok else math.nan

    def structural_on(self, scene: Scene) -> bool:
        """Whether a contact method keeps it to round-off on this scene.

        Where Γ'(s) changes, the factor of a contact map follows the numerical s and has its error.
        """
        return self.structural and not (self.compares_decay and scene.conformal_rate is None)

    def needs_on(self, scene: Scene) -> tuple[str, ...]:
        """The optional fields it reads on this scene."""
        return tuple(field for field in self.needs if field in scene.optional)


def law(
    definition: str,
    needs: tuple[str, ...] = (),
    applies: Callable[[Scene], bool] = lambda scene: True,
    structural: bool = False,
    compares_decay: bool = False,
    **display: Any,
) -> Callable[[Callable[[Solution], float]], Law]:
    """Decorator that registers a measure under its function's name; display: label, shown, gated."""

    def register(measure: Callable[[Solution], float]) -> Law:
        return LAWS.add(
            Law(measure.__name__, definition, measure, needs, applies, structural, compares_decay, **display)
        )

    return register


def laws_of(scene: Scene) -> list[Law]:
    """The laws that are defined for a scene, in table order."""
    return [item for item in LAWS.values() if item.applies(scene)]


# -- what applies where ----------------------------------------------------------------------------
def is_contact(scene: Scene) -> bool:
    """The exact flow is a conformal contact map: φ_t*η = e^{−∫Γ'(s)dt} η."""
    return scene.conformal_rate is not None or has_changing_rate(scene)


def has_changing_rate(scene: Scene) -> bool:
    """Γ'(s) is not constant."""
    return isinstance(scene, Mechanical) and scene.nonlinear_damping


def has_momentum_law(scene: Scene) -> bool:
    return is_contact(scene) and bool(getattr(scene, "has_momentum_law", False))


def has_torque(scene: Scene) -> bool:
    return isinstance(scene, Mechanical) and len(scene.q) == 2 and not scene.rotation_invariant


def is_body(scene: Scene) -> bool:
    return isinstance(scene, RigidBody)


# -- comparisons with the truth --------------------------------------------------------------------
def observed(scene: Scene, y: np.ndarray, carry: tuple[str, ...]) -> np.ndarray:
    """Packed states with the attitude as its nine matrix entries: what q and −q have in common."""
    if "R" not in carry:
        return y
    turned = scene.unpack(tuple(y.T), carry)
    matrix = [entry for row in rotation_matrix(turned.R) for entry in row]
    rest = [] if turned.s is None else [turned.s]
    return np.array([*turned.M, *matrix, *rest]).T


def truth(solution: Solution) -> Any:
    """The reference at the saved times, from the run's own initial data."""
    scene = solution.scene
    if solution.y0 is not None:
        own = scene.pack(scene.initial(solution.carry))
        if not np.array_equal(own, solution.y0):
            start = solution.start()._asdict()
            scene = scene.with_(**{k: v for k, v in start.items() if v is not None})
    return reference(scene, solution.t, solution.carry)


def absolute_error(solution: Solution) -> tuple[np.ndarray, float]:
    """‖y_k − y*(t_k)‖₂ at every saved time, and max_k ‖y*‖₂."""
    exact = observed(solution.scene, truth(solution).y, solution.carry)
    numerical = observed(solution.scene, solution.y, solution.carry)
    return np.linalg.norm(numerical - exact, axis=1), float(np.linalg.norm(exact, axis=1).max())


@law("max ‖y − y*‖ / max ‖y*‖", label="solution error", shown=("laws", "stability"))
def solution_error(solution: Solution) -> float:
    error, size = absolute_error(solution)
    return float(error.max() / size)


@law("‖y(T) − y*(T)‖ / max ‖y*‖", label="error at the end", shown=())
def solution_error_end(solution: Solution) -> float:
    error, size = absolute_error(solution)
    return float(error[-1] / size)


def energies(solution: Solution) -> tuple[np.ndarray, np.ndarray, float]:
    """H0 along the run, along the truth, and at the start."""
    scene = solution.scene
    exact = truth(solution).states()
    return scene.energy(solution.states()), scene.energy(exact), float(scene.energy(solution.start()))


@law("max |H0(y) − H0(y*)| / |H0(y₀)|", label="H0 law", shown=VIEWS)
def energy_law(solution: Solution) -> float:
    numerical, exact, start = energies(solution)
    return float(np.abs(numerical - exact).max() / abs(start))


@law("max |H0(y) / H0(y*) − 1|", label="H0 law, relative")
def energy_law_relative(solution: Solution) -> float:
    numerical, exact, _ = energies(solution)
    return float(relative_deviation(numerical, exact).max())


def relative_deviation(numerical: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """|numerical/exact − 1| where the exact value is meaningful, the excess over that range where not."""
    meaningful = np.abs(exact) > MEANINGFUL
    ratio = np.divide(numerical, exact, out=np.ones_like(exact), where=meaningful)
    return np.where(meaningful, np.abs(ratio - 1), np.maximum(np.abs(numerical) / MEANINGFUL - 1, 0.0))


#: what ∫Γ' means in the definitions of the laws
RATE = (
    "∫Γ' = γt, where Γ' changes that of the truth: e^{−∫Γ'} = H*(t)/H(y₀); relative to no less than a "
    "thousandth of the terms that cancel"
)


# -- conformal laws --------------------------------------------------------------------------------
def decay_rate(solution: Solution) -> float | np.ndarray:
    """γ with which e^{−γt} is the conformal factor of the exact flow at the saved times.

    Where Γ'(s) changes it is the mean rate up to each saved time, shape (k,), from the truth:
    H' = −Γ'(s) H, hence e^{−∫Γ'(s)dt} = H*(t)/H(0).  Raises `BadInput` if H(0) = 0.
    """
    scene = solution.scene
    if scene.conformal_rate is not None:
        return scene.conformal_rate
    start = float(scene.hamiltonian(solution.start()))
    if start == 0:
        raise BadInput(f"scene {scene.name!r}: H(0) = 0, the conformal factor cannot be read off H")
    ratio = scene.hamiltonian(truth(solution).states()) / start
    return np.divide(-np.log(ratio), solution.t, out=np.zeros(len(ratio)), where=solution.t > 0)


def scaled(values: Any, t: Any, gamma: Any, xp: Any = np) -> Any:
    """values · e^{γt}, in two halves so that neither factor overflows before the product would."""
    with np.errstate(over="ignore", invalid="ignore"):
        half = xp.exp(xp.minimum(gamma * t / 2, 700.0))
        half = half[..., None] if values.ndim > half.ndim else half
        return values * half * half


def conformal_deviation(values: Any, start: Any, t: Any, gamma: Any, terms: Any = 0.0, xp: Any = np) -> Any:
    """‖values − e^{−γt} start‖ / max(e^{−γt} ‖start‖, ATTAINABLE · terms) at each time.

    values : (k, m), start : (m,), terms : (k,), the size of the terms whose differences the values are.
    Where the denominator is below the meaningful range, the deviation is how far the value exceeds that
    range (0 when it has underflowed as it should).  For an ensemble k counts its members, and t, γ and
    start may differ from one to the next.
    """
    norm = xp.linalg.norm(start, axis=-1)
    norm = xp.where(norm > 0, norm, 1.0)
    true_log = xp.log(norm) - gamma * t
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        # where the true size rules, values are scaled up rather than the start down: it may underflow
        deviation = xp.linalg.norm(scaled(values, t, gamma, xp) - start, axis=-1) / norm
        attainable = ATTAINABLE * (terms + xp.zeros(len(values)))
        resolved = xp.log(attainable) <= true_log
        true = xp.asarray(xp.exp(-gamma * t))[..., None] * start
        unresolved = xp.linalg.norm(values - true, axis=-1) / attainable
    excess = xp.maximum(xp.abs(values).max(axis=-1) / MEANINGFUL - 1, 0.0)
    meaningful = xp.where(resolved, true_log > math.log(MEANINGFUL), attainable > MEANINGFUL)
    return xp.where(meaningful, xp.where(resolved, deviation, unresolved), excess)


def size(part: Any) -> Any:
    """‖·‖ of a tuple of components, each a number or an array over time."""
    return sum(c * c for c in part) ** 0.5


def hamiltonian_terms(scene: Scene, states: Any) -> Any:
    """The size of the terms of H."""
    kinetic = scene.kinetic(states.p) if isinstance(scene, Mechanical) else scene.energy(states)
    return abs(kinetic) + abs(scene.hamiltonian(states) - kinetic)


def momentum_terms(scene: Scene, states: Any) -> Any:
    """The size of the terms of J."""
    return size(states.q) * size(states.p) if isinstance(scene, Mechanical) else size(states.M)


def hamiltonian_deviation(solution: Solution) -> np.ndarray:
    scene, states = solution.scene, solution.states()
    value = scene.hamiltonian(states)
    start = np.array([scene.hamiltonian(solution.start())])
    terms = hamiltonian_terms(scene, states)
    return conformal_deviation(value[:, None], start, solution.t, decay_rate(solution), terms)


@law(
    f"max |H e^{{∫Γ'}} − H(y₀)| / |H(y₀)|; {RATE}",
    needs=("s",), applies=is_contact, compares_decay=True, label="H law", shown=VIEWS,
)  # fmt: skip
def hamiltonian_law(solution: Solution) -> float:
    return float(hamiltonian_deviation(solution).max())


def momentum_deviation(solution: Solution) -> np.ndarray:
    scene, states = solution.scene, solution.states()
    value = np.array(scene.momentum(states)).T
    start = np.array(scene.momentum(solution.start()))
    terms = momentum_terms(scene, states)
    return conformal_deviation(value, start, solution.t, decay_rate(solution), terms)


@law(
    f"max ‖J e^{{∫Γ'}} − J(y₀)‖ / ‖J(y₀)‖; {RATE}",
    needs=("R",), applies=has_momentum_law, structural=True, compares_decay=True, label="J law", shown=VIEWS,
)  # fmt: skip
def momentum_law(solution: Solution) -> float:
    return float(momentum_deviation(solution).max())


@law(
    "max |J − J*| e^{γt} / max |J* e^{γt}|, J* of the truth: J' = −γJ − ∂V/∂θ",
    applies=lambda scene: scene.conformal_rate is not None and has_torque(scene),
    label="J balance", shown=("overview", "laws"),
)  # fmt: skip
def momentum_balance(solution: Solution) -> float:
    scene, t = solution.scene, solution.t
    weight = np.exp(scene.conformal_rate * (t - t[-1]))  # e^{γt} up to a factor that drops out
    exact, numerical = (
        np.array(scene.momentum(states))[0] * weight
        for states in (truth(solution).states(), solution.states())
    )
    return float(np.abs(numerical - exact).max() / np.abs(exact).max())


# -- contact structure -----------------------------------------------------------------------------
def pullbacks(solution: Solution) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """η(Φ)·DΦ at every saved time, shape (k, m), and η at the start, shape (m,), on the tangents.

    Also ‖|∂s| + |p·∂q|‖ (with ‖p‖‖∂q‖ for the last) at every time, shape (k,): the terms of η(Φ)·DΦ.
    """
    scene, carry, start = solution.scene, solution.carry, solution.start()
    form = np.array([float(scene.contact_form(start, v)) for v in scene.tangents(start)])
    y, derivative = solution.linearised  # (k, d), (k, d, m)
    here = scene.unpack(tuple(y.T), carry)
    pushed = [scene.unpack(tuple(derivative[:, :, j].T), carry) for j in range(derivative.shape[2])]
    pulled = np.array([scene.contact_form(here, v) for v in pushed]).T
    if isinstance(scene, Mechanical):
        terms = [np.abs(v.s) + size(here.p) * size(v.q) for v in pushed]
    else:  # ‖ξ‖ = 2‖dR‖
        terms = [np.abs(v.s) + 2 * size(here.M) * size(v.R) for v in pushed]
    return pulled, form, size(terms)


def contact_deviation(solution: Solution) -> np.ndarray:
    pulled, form, terms = pullbacks(solution)
    return conformal_deviation(pulled, form, solution.t, decay_rate(solution), terms)


@law(
    f"‖Φ*η − e^{{−∫Γ'}} η‖ / ‖e^{{−∫Γ'}} η‖; {RATE}",
    needs=("R", "s"), applies=is_contact, structural=True, compares_decay=True,
    label="contact drift", shown=VIEWS,
)  # fmt: skip
def contact_drift(solution: Solution) -> float:
    return float(contact_deviation(solution).max())


@law(
    "sine of the angle between Φ*η and η",
    needs=("R", "s"), applies=is_contact, structural=True, label="ker η drift",
)  # fmt: skip
def distribution_drift(solution: Solution) -> float:
    pulled, form, terms = pullbacks(solution)
    unit = form / np.linalg.norm(form)
    length = np.maximum(np.linalg.norm(pulled, axis=1), ATTAINABLE * terms)
    pulled = pulled / np.where(length > 0, length, 1.0)[:, None]
    across = pulled - (pulled @ unit)[:, None] * unit  # the part of Φ*η that is not along η
    return float(np.linalg.norm(across, axis=1)[length > MEANINGFUL].max(initial=0.0))


@law(
    "max ‖RᵀR − 1‖_F",
    needs=("R",), applies=is_body, structural=True, label="attitude drift", shown=("laws", "stability"),
)  # fmt: skip
def attitude_drift(solution: Solution) -> float:
    R = solution.R
    assert R is not None
    return float(np.linalg.norm(np.swapaxes(R, 1, 2) @ R - np.eye(3), axis=(1, 2)).max())


@law(
    "saved steps on which H0 grows although γ > 0",
    applies=lambda scene: not may_gain_energy(scene), label="H0 grows", gated="count",
)  # fmt: skip
def energy_increases(solution: Solution) -> float:
    energy = solution.scene.energy(solution.states())
    energy = np.concatenate([[solution.scene.energy(solution.start())], energy])
    grows = np.diff(energy) > 4 * np.finfo(float).eps * np.abs(energy[:-1])  # more than round-off
    return float(np.count_nonzero(grows))


def may_gain_energy(scene: Scene) -> bool:
    """H0 need not decay: no damping, negative damping, or damping whose sign follows s."""
    if isinstance(scene, Mechanical):
        return scene.nonlinear_damping or scene.gamma <= 0
    return isinstance(scene, RigidBody) and scene.isotropic and (scene.gamma or 0) <= 0
