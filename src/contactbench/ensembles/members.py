"""What an ensemble is given, one entry per trajectory, what is measured of each, and the statistics over all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from contactbench.checks import finite, real_array
from contactbench.errors import BadInput, excerpt, unknown_name
from contactbench.measure.law import conformal_deviation
from contactbench.measure.laws import LAWS
from contactbench.numbers.protocol import ArrayNamespace
from contactbench.scene import AnyState, BodyState, DrivenState, Scene, State, quaternion_of
from contactbench.solution import Status

#: of NumPy, or of JAX, which are used alike
Array = np.ndarray
#: the largest deviation from each law, which trajectories have not diverged, and the last time each reached
Marks = tuple[dict[str, Array], Array, Array]


def members(
    scene: Scene, carry: tuple[str, ...], given: AnyState | Mapping[str, Any], parameters: Mapping[str, Any]
) -> tuple[np.ndarray, dict[int, np.ndarray]]:
    """Return packed initial states (d, n), and by its place among the scene's numbers each parameter (n,)."""
    if isinstance(given, State | BodyState | DrivenState):
        given = scene.data(given)
    if not isinstance(given, Mapping):
        raise BadInput(f"initial_conditions = {type(given).__name__}: must be a state of the scene or a dict")
    if not isinstance(parameters, Mapping):
        raise BadInput(f"parameters = {excerpt(parameters)}: must be a dict of arrays by name")
    for name in given:
        if name not in scene.initial_fields:
            raise unknown_name(f"initial value of scene {scene.name!r}", name, scene.initial_fields)
    columns: dict[str, np.ndarray] = {}
    for name, carried in scene.initial(carry)._asdict().items():
        if carried is not None and name in scene.initial_fields:
            columns |= components(name, given.get(name, getattr(scene, name)), getattr(scene, name))
    states = list(columns)
    columns |= {name: parameter(scene, name, value) for name, value in parameters.items()}
    sizes = {name: len(column) for name, column in columns.items() if column.ndim}
    if len(set(sizes.values())) != 1:
        told = ", ".join(f"{name} {size}" for name, size in sizes.items()) or "none is an array"
        raise BadInput(f"initial_conditions: arrays of one length, one entry per trajectory; got {told}")
    (n,) = set(sizes.values())
    if n == 0:
        raise BadInput("initial_conditions: no trajectories, arrays of length 0")
    y0 = np.array([np.broadcast_to(columns[name], n) for name in states])
    if "R" in carry and (worst := np.abs(np.linalg.norm(y0[3:7], axis=0) - 1).max()) > 1e-12:
        raise BadInput(f"R: must be unit quaternions (w, x, y, z); one is off by {worst:.3g}")
    x = scene.unpack(scene.components(y0), carry)
    if scene.constrained and (worst := np.max(scene.departure(x, x))) > 1e-12:
        raise BadInput(
            f"q, p: must be on the sphere, |q| = R and q·p = 0; a trajectory is off by {worst:.3g}"
        )
    places = scene.number_names()
    return y0, {places.index(name): np.broadcast_to(columns[name], n) for name in parameters}


def components(name: str, value: Any, default: object) -> dict[str, np.ndarray]:
    """Return the columns of an initial value by the names of its components; `default` : the scene's own."""
    if isinstance(default, np.ndarray):
        rows = real_array(name, value, f"{len(default)} numbers, or {len(default)} × n of them")
        if rows.ndim > 2 or len(np.atleast_1d(rows)) != len(default):
            raise BadInput(f"{name} has shape {rows.shape}: must be ({len(default)},) or ({len(default)}, n)")
        return {f"{name}[{i}]": column(f"{name}[{i}]", row) for i, row in enumerate(rows)}
    if not isinstance(default, tuple):
        return {name: column(name, value)}
    try:
        given = tuple(value)
    except TypeError:  # one number: the identity may be written as 1
        given = quaternion_of(value) if name == "R" else (value,)
    if len(given) != len(default):
        wanted = f"{len(default)} components, each a number or an array"
        raise BadInput(f"{name}: must be {wanted}; got {len(given)}")
    return {f"{name}[{i}]": column(f"{name}[{i}]", part) for i, part in enumerate(given)}


def column(name: str, value: object) -> np.ndarray:
    """Return a number or a one-dimensional array of finite numbers, or `BadInput`."""
    numbers = real_array(name, value, "a number or an array of numbers")
    if numbers.ndim > 1:
        raise BadInput(f"{name}: must be a number or an array (n,), got shape {numbers.shape}")
    if not np.isfinite(numbers).all():
        where = int(np.argmin(np.isfinite(numbers)))
        raise BadInput(f"{name}: must be finite numbers, entry {where} is {numbers.flat[where]}")
    return numbers


def parameter(scene: Scene, name: str, value: object) -> np.ndarray:
    """Return values of a parameter, each of which the scene accepts without becoming another problem."""
    allowed = [known for known in scene.number_names() if known]
    if name not in allowed:
        raise unknown_name(f"parameter of an ensemble of scene {scene.name!r}", name, allowed)
    numbers = column(name, value)
    for extreme in (numbers.min(initial=np.inf), numbers.max(initial=-np.inf)) if numbers.size else ():
        if scene.with_(**{name: finite(name, extreme)}).structure != scene.structure:
            raise BadInput(f"{name}: {extreme} makes scene {scene.name!r} another problem; change the scene")
    return numbers


# -- what is measured --------------------------------------------------------------------------------
#: laws of the numerical solution alone, with the quantity that must decay as e^{−γt}
DECAYING = {"hamiltonian_law": "hamiltonian", "momentum_law": "momentum"}
#: H0(y(T))/H0(y₀) − 1: no law, but how much of the energy is gone
ENERGY = "energy_change"


def decaying(scene: Scene, carry: tuple[str, ...]) -> list[str]:
    """Return the decay laws that are defined on a scene and read only what is carried."""
    if scene.conformal_rate is None:  # the rate follows s: what is true is not known
        return []
    laws = {name: LAWS[name] for name in DECAYING}
    return [name for name, law in laws.items() if law.applies(scene) and {*law.needs_on(scene)} <= {*carry}]


def within(y: Array, bound: Array, xp: ArrayNamespace = np) -> Array:
    """Return which of the states y (d, m) are finite, and their first entries, the motion, within `bound`."""
    fine: Array = xp.isfinite(y).all(axis=0) & (xp.abs(y[: len(bound)]) <= bound).all(axis=0)
    return fine


class Watch:
    """What is measured along trajectories from a packed start y0 (d, m), by NumPy or JAX; names : `ENERGY`, then laws.

    bound : as from `furthest`.  begun : the first marks: the largest deviation from each law, which have not diverged,
    and the last time reached.
    """

    def __init__(
        self,
        scene: Scene,
        carry: tuple[str, ...],
        names: Sequence[str],
        bound: Array,
        y0: Array,
        xp: ArrayNamespace = np,
    ) -> None:
        self.scene, self.bound, self.xp = scene, bound, xp
        self.start = scene.unpack(scene.components(y0), carry)
        self.origin = {name: self.quantity(name, self.start) for name in names[1:]}
        nothing = xp.zeros(y0.shape[1])
        self.begun = dict.fromkeys(self.origin, nothing), xp.ones(y0.shape[1], bool), nothing

    def quantity(self, name: str, x: AnyState) -> Array:
        value = getattr(self.scene, f"{DECAYING[name]}_at")(x)
        vector = value if isinstance(value, tuple) else (value,)
        stacked: Array = self.xp.stack(self.xp.broadcast_arrays(*vector), axis=-1)
        return stacked

    def deviation(self, name: str, x: AnyState, t: float | Array) -> Array:
        terms = getattr(self.scene, f"{DECAYING[name]}_terms")(x)
        rate = self.scene.conformal_rate
        found: Array = conformal_deviation(self.quantity(name, x), self.origin[name], t, rate, terms, self.xp)
        return found

    def at(self, marks: Marks, x: AnyState, y: Array, t: float | Array) -> Marks:
        worst, alive, end = marks
        alive = alive & within(y, self.bound, self.xp)
        worst = {name: self.xp.maximum(most, self.deviation(name, x, t)) for name, most in worst.items()}
        return worst, alive, self.xp.where(alive, t, end)

    def result(self, marks: Marks, x: AnyState, y: Array) -> tuple[Array, Array, Array]:
        """Return final states (d, m), measures (·, m) and end times (m,), nan where a trajectory diverged."""
        (worst, alive, end), xp = marks, self.xp
        energy = self.scene.energy(x) / self.scene.energy(self.start) - 1
        measures = xp.stack([energy, *worst.values()])
        return xp.where(alive, y, np.nan), xp.where(alive, measures, np.nan), end


class Statistic(NamedTuple):
    """Over the trajectories that ended `ok`; nan if none did."""

    mean: float
    max: float


def tally(measures: np.ndarray, ok: np.ndarray) -> np.ndarray:
    """Return one row: how many are ok, how many not, and the sums and maxima of the measures of those that are."""
    good = measures if ok.all() else measures[:, ok]
    return np.array([ok.sum(), (~ok).sum(), *good.sum(axis=1), *good.max(axis=1, initial=-np.inf)])


def overall(names: list[str], rows: list[np.ndarray]) -> tuple[dict[str, Statistic], dict[Status, int]]:
    """Return statistics and endings from the rows of all chunks of all processes."""
    from jax.experimental import multihost_utils

    from contactbench.xla import jax

    def join(rows: ArrayLike) -> np.ndarray:
        rows, split = np.asarray(rows), 2 + len(names)
        return np.concatenate([rows[:, :split].sum(axis=0), rows[:, split:].max(axis=0)])

    row = join(rows)
    if jax.process_count() > 1:
        row = join(multihost_utils.process_allgather(row))
    ok, diverged, rest = int(row[0]), int(row[1]), row[2:].reshape(2, len(names))
    total, largest = rest if ok else np.full_like(rest, np.nan)
    pairs = (Statistic(float(s) / max(ok, 1), float(m)) for s, m in zip(total, largest, strict=True))
    return dict(zip(names, pairs, strict=True)), {Status.ok: ok, Status.diverged: diverged}
