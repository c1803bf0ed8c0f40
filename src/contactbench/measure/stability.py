"""Linear stability: the one-step map of a fixed-step method on q'' + γ q' + ω² q = 0, a 2×2 matrix.

The map acts on (q, p) alone.  With s carried, an iteration must converge for s too, and a run may fail earlier.
A processed method π χⁿ π* repeats its kernel χ if only the end is saved, and π χ π* if every step is saved.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from typing import TypeGuard

import numpy as np
import scipy  # its parts are loaded when first used

from contactbench.methods import METHODS
from contactbench.methods.base import Method
from contactbench.methods.contact import ContactMethod
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.loops import loop_of
from contactbench.numbers.protocol import CannotRecord, Numbers
from contactbench.scene import Mechanical, Scene, State
from contactbench.scenes import SCENES
from contactbench.splitting.composition import Stage

#: |tr/(1 + det)| and |det| may exceed one by this round-off, which lets no orbit grow by more than 1.4·10⁻⁶ a step
SLACK = 1e-12
#: range of step sizes ωh, and the number of samples in it, a quarter of a per cent apart
SHORTEST, LONGEST, SCANNED = 1e-3, 1e3, 5600
#: intervals of stability shorter than this part of the step are ignored
ISLAND = 0.01
#: a bracket shrinks by the factor PARTS per iteration, of an extremum by half of it; number of iterations for an
#: extremum, which is flat, and for a border; a method that iterates is followed by so many steps at a time
PARTS, ZOOMS, CLOSE, FOLLOWED = 16, 5, 14, 400


class Elementwise(Numbers):
    """NumPy's functions for an array of step sizes, without vectors of stages."""

    def __getattr__(self, name: str) -> object:
        return getattr(np, name)


ELEMENTWISE = Elementwise()


def oscillator(gamma: float, omega: float = 1.0) -> Mechanical:
    scene: Mechanical = SCENES["oscillator"].with_(gamma=gamma, omega=omega)
    return scene


def fixed_step_methods() -> list[FixedStep]:
    """Return the methods that oscillators tell something about: they are not exact there, and have a step map."""
    scene, equal = SCENES["oscillator"], [m for m in METHODS.values() if m.control == "step" and m.one_step]
    return [m for m in equal if m.refuses(scene) is None and not m.solves(scene)]


def is_processed(method: Method) -> TypeGuard[ContactMethod]:
    return isinstance(method, ContactMethod) and bool(method.composition.processor)


def of_stages(method: ContactMethod, stages: Sequence[Stage]) -> FixedStep:
    own = replace(method.composition, stages=tuple(stages), processor=(), postprocessor=())
    return replace(method, composition=own)


def kernel(method: FixedStep) -> FixedStep:
    return of_stages(method, method.composition.stages) if is_processed(method) else method


def step_matrix(method: FixedStep, gamma: float, omega: float, h: float | np.ndarray) -> np.ndarray:
    """Return the map (q, p) → (q, p) of one step of size h: (2, 2), or (…, 2, 2) for an array of step sizes."""
    scene, steps = oscillator(gamma, omega), np.asarray(h, dtype=float)
    if method.iterates:
        with suppress(CannotRecord):  # on arrays an iteration ends only when all entries have converged
            return by_compiled_steps(method, scene, steps)
    q, p = (np.multiply.outer(unit, np.ones_like(steps)) for unit in np.eye(2))  # both unit vectors at once
    with np.errstate(all="ignore"):  # e^{γ|a|h} of a negative substep may overflow: it is unstable then
        x = method.advance(scene, State((q,), (p,)), steps, 1, ELEMENTWISE)  # type: ignore[arg-type]
    entries = [np.broadcast_to(row, q.shape) for row in (*x.q, *x.p)]
    return np.moveaxis(np.array(entries), (0, 1), (-2, -1))


def by_compiled_steps(method: FixedStep, scene: Scene, steps: np.ndarray) -> np.ndarray:
    """Return the maps of `step_matrix` from the compiled loop, one step each; nan where the iteration fails."""
    loop = loop_of(method, scene, ())
    spans = np.column_stack([steps.ravel(), np.ones(steps.size)])
    rows, shape = loop.table(np.array(scene.numbers()), spans), np.append(loop.program.shape, 0)
    ends = np.full((2, steps.size, 2), math.nan)
    for unit, of_unit in zip(np.eye(2), ends, strict=True):
        for k, end in enumerate(of_unit):
            loop.run(unit, rows[k : k + 1], shape, end)
    return ends.transpose(1, 2, 0).reshape(*steps.shape, 2, 2)


def spectral_radius(method: FixedStep, gamma: float, omega: float, h: float | np.ndarray) -> np.ndarray:
    """Return the spectral radius of a step; orbits are unbounded if it exceeds 1."""
    matrix = step_matrix(method, gamma, omega, h)
    with np.errstate(all="ignore"):
        half = np.abs(matrix[..., 0, 0] + matrix[..., 1, 1]) / 2
        difference = (matrix[..., 0, 0] - matrix[..., 1, 1]) / 2
        square = difference**2 + matrix[..., 0, 1] * matrix[..., 1, 0]
        root = np.sqrt(np.abs(square))
        radius = np.where(square < 0, np.hypot(half, root), half + root)
    return np.where(np.isfinite(radius), radius, np.inf)


def true_radius(gamma: float, omega: float, h: float) -> float:
    return math.exp(-slow_rate(gamma, omega) * h)


def slow_rate(gamma: float, omega: float = 1.0) -> float:
    """Return the decay rate of the slowest motion: γ/2, or γ/2 − √(γ²/4 − ω²) if overdamped."""
    if gamma <= 2 * omega:
        return gamma / 2
    return omega**2 / (gamma / 2 + math.sqrt(gamma**2 / 4 - omega**2))


# -- where orbits stay bounded ----------------------------------------------------------------------
@dataclass(frozen=True)
class Stability:
    """Steps with bounded orbits: up to `limit`, and up to `last` outside `windows`; inf: no border up to ωh = 10³."""

    limit: float
    windows: tuple[tuple[float, float], ...]
    last: float


def stability(method: FixedStep, gamma: float, omega: float) -> Stability:
    """Return the borders of stability of a method: those of ω = 1, in units of 1/ω."""
    unit = borders(method, gamma / omega)
    windows = tuple((start / omega, end / omega) for start, end in unit.windows)
    return Stability(unit.limit / omega, windows, unit.last / omega)


@cache
def borders(method: FixedStep, gamma: float) -> Stability:
    """Return the borders of stability of one step of `method` from its trace and determinant, for ω = 1.

    Both eigenvalues are in the unit disc if |s| ≤ 1, s = tr/(1 + det), and |det| ≤ 1.  A window in which s passes ±1
    and returns may be narrower than the grid, but it contains an extremum of s.  So the extrema of s and det are
    located, and every border between neighbours of grid and extrema is bracketed.  An excess below 10⁻¹² is no window
    (a double root); an interval of stability of less than a per cent of the step does not end a window.  A method that
    iterates has no windows: it is followed to its first border.
    """

    def invariants(h: np.ndarray) -> np.ndarray:
        matrix = step_matrix(method, gamma, 1.0, h)
        with np.errstate(all="ignore"):
            trace = matrix[..., 0, 0] + matrix[..., 1, 1]
            det = matrix[..., 0, 0] * matrix[..., 1, 1] - matrix[..., 0, 1] * matrix[..., 1, 0]
            # the determinant of a conformal contact map is its factor, without cancellation
            factor = method.conformal_factor(oscillator(gamma), h, ELEMENTWISE)  # type: ignore[arg-type]
            det = det if factor is None else factor
            return np.array([trace / (1 + det), det])

    def unbounded(values: np.ndarray) -> np.ndarray:
        with np.errstate(invalid="ignore"):
            found: np.ndarray = ~(np.abs(values) <= 1 + SLACK).all(axis=0)  # nan: overflow
        return found

    grid, parts = np.geomspace(SHORTEST, LONGEST, SCANNED), list[np.ndarray]()
    together = FOLLOWED if method.iterates else SCANNED
    for begin in range(0, SCANNED, together):
        parts.append(invariants(grid[begin : begin + together]))
        if method.iterates and (lost := unbounded(parts[-1])).any():  # beyond, iterations fail here and there
            parts[-1] = parts[-1][:, : np.argmax(lost) + 1]
            break
    values = np.concatenate(parts, axis=1)
    grid = grid[: values.shape[1]]
    of_trace = turning_points(lambda h: invariants(h)[0], grid, values[0])
    of_det = turning_points(lambda h: invariants(h)[1], grid, values[1])
    extrema = np.concatenate([of_trace, of_det])
    steps, first = np.unique(np.concatenate([grid, extrema]), return_index=True)
    beyond = np.concatenate([unbounded(values), unbounded(invariants(extrema))])[first]
    if beyond[0]:
        return Stability(0.0, (), 0.0)
    changes = np.flatnonzero(beyond[1:] != beyond[:-1])
    sides = steps[changes], steps[changes + 1], beyond[changes]
    borders = bracket_changes(lambda h: unbounded(invariants(h)), *sides).tolist()
    lost, found = borders[::2], borders[1::2]
    ends = [*lost[1:], math.inf][: len(found)]
    usable = [(start, end) for start, end in zip(found, ends, strict=True) if end - start > ISLAND * start]
    stable = [(0.0, lost[0] if lost else math.inf), *usable]
    windows = tuple((end, start) for (_, end), (start, _) in itertools.pairwise(stable))
    return Stability(stable[0][1], windows, stable[-1][1])


def turning_points(f: Callable[[np.ndarray], np.ndarray], grid: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the extrema of f that may pass ±1, one for each local extremum on an increasing grid.

    An extremum exceeds the value on the grid by less than the larger difference to the neighbours.
    """
    with np.errstate(invalid="ignore"):
        changes = np.diff(values)
        rises = np.sign(changes)
        beyond = np.abs(values[1:-1]) + np.maximum(np.abs(changes[1:]), np.abs(changes[:-1]))
        inner = np.flatnonzero((rises[1:] * rises[:-1] < 0) & (beyond > 1 + SLACK)) + 1
    low, high, sense = grid[inner - 1], grid[inner + 1], rises[inner - 1]
    for _ in range(ZOOMS if len(inner) else 0):
        inside = np.linspace(low, high, PARTS + 1)
        best = np.argmax(sense * f(inside), axis=0)
        columns = np.arange(len(low))
        low, high = inside[np.maximum(best - 1, 0), columns], inside[np.minimum(best + 1, PARTS), columns]
    middle: np.ndarray = (low + high) / 2
    return middle


def bracket_changes(
    truth: Callable[[np.ndarray], np.ndarray], low: np.ndarray, high: np.ndarray, at_low: np.ndarray
) -> np.ndarray:
    """Return the first points between low and high where a truth value changes, to round-off."""
    columns = np.arange(len(low))
    for _ in range(CLOSE if len(low) else 0):
        inside = np.linspace(low, high, PARTS + 1)
        changed = truth(inside) != at_low
        changed[-1] = True
        first = np.argmax(changed, axis=0)
        low, high = inside[first - 1, columns], inside[first, columns]
    middle: np.ndarray = (low + high) / 2
    return middle


# -- theory ----------------------------------------------------------------------------------------
def merged_limit(gamma: float, omega: float) -> float:
    """Return the limit of B½ AC B½: an eigenvalue −1 where ω²h tanh(γh/2) = 2γ; 2/ω as γ → 0, 2γ/ω² as γ → ∞."""
    if gamma == 0:
        return 2 / omega
    scale = 2 / omega + 2 * gamma / omega**2
    return root(lambda h: omega**2 * h * math.tanh(gamma * h / 2) - 2 * gamma, scale)


def printed_limit(gamma: float, omega: float) -> float:
    """Return the limit of B½ C A B½ in the printed order: (ωh)² = 2 (1 + e^{γh})."""
    return root(
        lambda h: (omega * h) ** 2 * math.exp(-gamma * h) - 2 * (1 + math.exp(-gamma * h)), 10 / omega
    )


def rk4_limit(gamma: float, omega: float) -> float:
    """Return the h with |1 + z + z²/2 + z³/6 + z⁴/24| = 1 for z = h λ, λ² + γλ + ω² = 0."""
    rates = np.roots([1.0, gamma, omega**2])

    def growth(h: float) -> float:
        z = h * rates
        return float(np.abs(1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4)))).max()) - 1

    return root(growth, 3 / omega)


def root(f: Callable[[float], float], scale: float) -> float:
    """Return the smallest root above 10⁻³·scale of a function that is negative there; inf if none is below 10·scale."""
    grid = np.geomspace(1e-3, 10, 4000) * scale
    k = next((k for k, h in enumerate(grid.tolist()) if f(h) > 1e-12), None)
    if k is None:
        return math.inf
    return float(grid[0]) if k == 0 else float(scipy.optimize.brentq(f, grid[k - 1], grid[k], xtol=1e-13))


#: name of a method → its theoretical limit; the kick-drift-kick palindrome has 2/ω for every damping
THEORY: dict[str, Callable[[float, float], float]] = {
    "contact-printed": printed_limit,
    "contact-abc": lambda gamma, omega: 2 / omega,
    "contact-strang": merged_limit,
    "rk4": rk4_limit,
    "herglotz1": lambda gamma, omega: 4 / (gamma + math.hypot(gamma, 2 * omega)),  # ω²h² + 2γh = 4
    "herglotz2": lambda gamma, omega: 2 / omega,
}


# -- strong damping --------------------------------------------------------------------------------
def propagation_error(method: FixedStep, gamma: float, h: float) -> float:
    """Return ‖M − Φ_T‖₂/‖Φ_T‖₂ for n steps M over the time T in which a motion falls by e; inf if M overflows."""
    n = max(1, round(1 / slow_rate(gamma) / h))
    exact = scipy.linalg.expm(np.array([[0.0, 1.0], [-1.0, -gamma]]) * (n * h))
    with np.errstate(all="ignore"):
        run = run_matrix(method, gamma, h, n)
        if not np.isfinite(run).all():
            return math.inf
        return float(np.linalg.norm(run - exact, 2) / np.linalg.norm(exact, 2))


def run_matrix(method: FixedStep, gamma: float, h: float, n: int) -> np.ndarray:
    """Return the map (q, p) → (q, p) of n steps of size h with only the end saved; ω = 1."""
    steps = np.linalg.matrix_power(step_matrix(kernel(method), gamma, 1.0, h), n)
    if not is_processed(method):
        return steps
    stages = method.composition.processor
    before, after = (step_matrix(of_stages(method, part), gamma, 1.0, h) for part in (stages, stages[::-1]))
    run: np.ndarray = after @ steps @ before
    return run
