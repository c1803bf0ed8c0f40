"""What is measured of every trajectory, and the statistics over all of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from contactbench.measure.law import conformal_deviation
from contactbench.measure.laws import LAWS
from contactbench.scene import Scene
from contactbench.solution import DIVERGENCE, Status

Measured = Callable[[Scene, Any], Any]
#: laws of the numerical solution alone, with the quantity that must decay as e^{−γt} and the size of its terms
DECAYING: dict[str, tuple[Measured, Measured]] = {
    "hamiltonian_law": (
        lambda scene, x: (scene.hamiltonian(x),),
        lambda scene, x: scene.hamiltonian_terms(x),
    ),
    "momentum_law": (lambda scene, x: scene.momentum(x), lambda scene, x: scene.momentum_terms(x)),
}
#: H0(y(T))/H0(y₀) − 1: no law, but how much of the energy is gone
ENERGY = "energy_change"


class Statistic(NamedTuple):
    """Over the trajectories that ended `ok`; nan if none did."""

    mean: float
    max: float


def decaying(scene: Scene, carry: tuple[str, ...]) -> list[str]:
    """Return the decay laws that are defined on a scene and read only what is carried."""
    if scene.conformal_rate is None:  # the rate follows s: what is true is not known
        return []
    laws = {name: LAWS[name] for name in DECAYING}
    return [name for name, law in laws.items() if law.applies(scene) and {*law.needs_on(scene)} <= {*carry}]


def furthest(motion: Any, xp: Any = np) -> Any:
    """Return how large the motion of each trajectory may become, (m,), from its start (·, m)."""
    size = xp.sqrt((motion * motion).sum(axis=0))
    return DIVERGENCE * xp.where(size > 0, size, 1.0)


def within(y: Any, motion: int, bound: Any, xp: Any = np) -> Any:
    """Return which of the states y (d, m) are finite, and their motion, the first entries, within `bound` (m,)."""
    return xp.isfinite(y).all(axis=0) & (xp.abs(y[:motion]).max(axis=0) <= bound)


class Watch:
    """What is measured along trajectories from their packed start y0 (d, m): the same for NumPy and JAX.

    names : `ENERGY`, then decay laws.  begun : its marks at the start, the largest deviation from each law, which
    trajectories have not diverged, and the last time each has reached.
    """

    def __init__(
        self, scene: Scene, carry: tuple[str, ...], names: Sequence[str], motion: int, y0: Any, xp: Any = np
    ) -> None:
        self.scene, self.motion, self.xp = scene, motion, xp
        self.start = scene.unpack(tuple(y0), carry)
        self.bound = furthest(y0[:motion], xp)
        self.origin = {name: self.quantity(name, self.start) for name in names[1:]}
        nothing = xp.zeros(y0.shape[1])
        self.begun = dict.fromkeys(self.origin, nothing), xp.ones(y0.shape[1], bool), nothing

    def quantity(self, name: str, x: Any) -> Any:
        """Return the quantity of a decay law, its components along the last axis."""
        return self.xp.stack(self.xp.broadcast_arrays(*DECAYING[name][0](self.scene, x)), axis=-1)

    def deviation(self, name: str, x: Any, t: Any) -> Any:
        """Return the deviation from a decay law at the time t."""
        terms, rate = DECAYING[name][1](self.scene, x), self.scene.conformal_rate
        return conformal_deviation(self.quantity(name, x), self.origin[name], t, rate, terms, self.xp)

    def at(self, marks: Any, x: Any, y: Any, t: Any) -> Any:
        """Return the marks at the time t, in the states x, packed y."""
        worst, alive, end = marks
        alive = alive & within(y, self.motion, self.bound, self.xp)
        worst = {name: self.xp.maximum(most, self.deviation(name, x, t)) for name, most in worst.items()}
        return worst, alive, self.xp.where(alive, t, end)

    def result(self, marks: Any, x: Any, y: Any) -> Any:
        """Return final states (d, m), measures (·, m) and end times (m,), nan where a trajectory diverged."""
        (worst, alive, end), xp = marks, self.xp
        energy = self.scene.energy(x) / self.scene.energy(self.start) - 1
        measures = xp.stack([energy, *worst.values()])
        return xp.where(alive, y, xp.nan), xp.where(alive, measures, xp.nan), end


def tally(measures: np.ndarray, ok: np.ndarray) -> np.ndarray:
    """Return one row: how many are ok, how many not, and the sums and maxima of the measures of those that are."""
    good = measures if ok.all() else measures[:, ok]
    return np.array([ok.sum(), (~ok).sum(), *good.sum(axis=1), *good.max(axis=1, initial=-np.inf)])


def overall(names: list[str], rows: list[np.ndarray]) -> tuple[dict[str, Statistic], dict[Status, int]]:
    """Return statistics and endings from the rows of all chunks of all processes."""
    from jax.experimental import multihost_utils

    from contactbench.xla import jax

    def join(rows: Any) -> np.ndarray:
        rows, split = np.asarray(rows), 2 + len(names)
        return np.concatenate([rows[:, :split].sum(axis=0), rows[:, split:].max(axis=0)])

    row = join(rows)
    if jax.process_count() > 1:
        row = join(multihost_utils.process_allgather(row))
    ok, diverged, rest = int(row[0]), int(row[1]), row[2:].reshape(2, len(names))
    total, largest = rest if ok else np.full_like(rest, np.nan)
    pairs = (Statistic(float(s) / max(ok, 1), float(m)) for s, m in zip(total, largest, strict=True))
    return dict(zip(names, pairs, strict=True)), {Status.ok: ok, Status.diverged: diverged}
