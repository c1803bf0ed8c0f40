"""Lyapunov exponents of a numerical map, and averages along it, from an ensemble of trajectories.

Tangents follow by the derivative of the very steps that are taken, and are made orthonormal after every interval,
A_k Q_{k−1} = Q_k R_k; the exponents are the means of log diag R_k over time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from contactbench.checks import positive, whole
from contactbench.ensembles.members import members, within
from contactbench.errors import BadInput
from contactbench.measure.statistics import Average, blocks, jackknife
from contactbench.methods.base import lookup, prepare
from contactbench.methods.fixed_step_run import FixedStepRun
from contactbench.methods.many import loop_on
from contactbench.methods.prepared import Refused, furthest
from contactbench.numbers.protocol import CannotRecord
from contactbench.peers.base import PeerRun
from contactbench.peers.compiled import FACTS, KNOWN, SUCCESS
from contactbench.peers.cyrk import Cyrk
from contactbench.scene import Scene

#: ``(x, v) -> (x, v, evaluations)``: states (d, n) and tangents (m, d, n) over one interval, and what it cost, (n,)
TangentMap = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, float | np.ndarray]]
MOST_INTERVALS = 10**7
#: log of how many times as much one tangent may grow as another in an interval: rounding takes e^16 ε = 2·10⁻⁹ of
#: what grows least
APART = 16.0
#: share of intervals in which that may happen: near an escape, say
FEW = 1e-3


@dataclass(frozen=True, eq=False)
class Lyapunov:
    """Hold the result of `lyapunov`; errors are standard errors.

    Attributes
    ----------
    scene, method
        What was integrated, and the name of the method.
    exponents
        Per unit of time, (m,), in the order of the orthonormalisation, the largest first; of a scene of many sites
        with more than 65 numbers the four largest.
    total
        Their sum, the mean rate at which volume grows.  nan, as the dimension, where not all exponents are known.
    dimension
        Of Kaplan and Yorke; of a scene with time in it that of a section at one phase.
    energy
        Mean of H0 at the ends of the intervals.
    evaluations
        Per trajectory and unit of time, of the kind that the method's counts name; nan of methods that iterate.
    diverged
        How many trajectories were left out because they left the scene's scale.
    rates
        Log diag R over the length of an interval, (intervals, m, n), the settling and the diverged left out.
    """

    scene: Scene = field(repr=False)
    method: str
    exponents: Average
    total: Average
    dimension: Average
    energy: Average
    evaluations: float
    diverged: int
    rates: np.ndarray = field(repr=False)


def kaplan_yorke(exponents: np.ndarray) -> float:
    """Return j + (λ₁ + … + λ_j)/|λ_{j+1}|, j the most exponents, largest first, whose sum is not negative.

    Frederickson, Kaplan, Yorke, Yorke, J. Differ. Equ. 49, 185 (1983), doi:10.1016/0022-0396(83)90011-6.
    """
    ordered = np.sort(exponents)[::-1]
    sums = np.cumsum(ordered)
    if sums[-1] >= 0:
        return float(len(ordered))
    j = int(np.argmax(sums < 0))
    return j + float(sums[j - 1] if j else 0.0) / abs(float(ordered[j]))


def lyapunov(
    scene: Scene | str,
    method: str,
    *,
    every: float,
    intervals: int,
    settle: int = 16,
    step: float | None = None,
    rtol: float | None = None,
    initial_conditions: Mapping[str, object] | None = None,
    carry: Sequence[str] = (),
) -> Lyapunov:
    """Return the Lyapunov spectrum of a scene under a method, with its error bar.

    The error bar is that of sampling, from independent trajectories or blocks of a few (see `measure.statistics`).  It
    does not contain the bias of a finite time, which is all there is where motion is not chaotic: 1/T where tangents
    turn or are sheared on the way.  The exponents are those of R: they come in pairs in the limit only.
    Where every trajectory leaves the scene's scale all is nan.

    Parameters
    ----------
    scene
        Itself, or the name of a registered one.
    method
        The name of a fixed-step one, or of CyRK's: they solve the variational equations with the tangents in their
        error control, afresh in every interval.
    every
        Time between two orthonormalisations, at whose ends the energy is taken.
    intervals, settle
        How many intervals count, and how many come before, at least one, for trajectories and tangents to settle.
    step
        As in `solve`; equal steps in every interval.
    rtol
        As in `solve`.
    initial_conditions
        As in `ensemble`, an entry per trajectory; by default one, the scene's own.  Where trajectories end on
        different attractors the result is the mean over them.
    carry
        As in `solve`; by default nothing that does not act back on the motion.

    Returns
    -------
    Lyapunov
        The exponents, their sum, the dimension of Kaplan and Yorke and the mean energy, with standard errors.

    Raises
    ------
    BadInput
        For a method whose steps are not fixed, a value that is out of range, and an interval in which tangents
        grow so far apart that rounding loses the small ones.

    References
    ----------
    Benettin, Galgani, Giorgilli, Strelcyn, Meccanica 15, 9 (1980), doi:10.1007/BF02128236.
    Geist, Parlitz, Lauterborn, Prog. Theor. Phys. 83, 875 (1990), doi:10.1143/PTP.83.875.
    Dieci, Van Vleck, Appl. Numer. Math. 17, 275 (1995), doi:10.1016/0168-9274(95)00033-Q.

    Examples
    --------
    >>> import contactbench as cb
    >>> found = cb.lyapunov("oscillator", "contact-strang", step=0.1, every=1.0, intervals=64)
    >>> round(float(found.total.value), 12)  # −γ
    -0.1
    """
    scene, _ = lookup(scene, method)
    every, settle = positive("every", every), whole("settle", settle, MOST_INTERVALS)
    count = whole("intervals", intervals, MOST_INTERVALS)
    if scene.breaks_until(math.inf):
        raise BadInput(
            f"scene {scene.name!r}: its breaks end steps once, and every interval has the same steps"
        )
    run = prepare(scene, method, step=step, rtol=rtol, carry=carry, save_at=[every])
    if isinstance(run, Refused):
        raise BadInput(run.why)
    if isinstance(run, FixedStepRun):
        follow = side_by_side(run)
    elif isinstance(run, PeerRun) and isinstance(run.call, Cyrk):
        follow = one_by_one(run)
    else:
        raise BadInput(f"method = {run.method!r}: takes methods with a given step, and those of CyRK")
    own, given = run.request.carry, initial_conditions
    x = run.start[:, None] if given is None else np.array(members(scene, own, given, {})[0])
    n = x.shape[1]
    v = np.array([run.tangents(start) for start in x.T])  # (n, m, d)
    start, first = x.copy(), np.ascontiguousarray(np.moveaxis(v, 0, 2))
    v = first.copy()
    bound, alive = furthest(scene, own, x, every * (settle + count)), np.ones(n, dtype=bool)
    rates, energy, spent = np.empty((count, len(v), n)), np.empty((count, 1, n)), np.zeros(n)
    with np.errstate(all="ignore"):
        for k in range(-settle, count):
            x, v, evaluations = follow(x, v)
            alive &= within(x, bound)
            # those that left begin again, and are not counted
            x, v = np.where(alive, x, start), np.where(alive, v, first)
            v, logs = orthonormal(v)
            if k >= 0:
                rates[k], energy[k, 0] = logs / every, scene.energy(scene.unpack(scene.components(x), own))
                spent += evaluations
    rates[:, :, ~alive] = energy[:, :, ~alive] = np.nan
    kept = alive if alive.any() else ~alive
    # log of how much more one tangent grew than another
    apart = np.ptp(rates[:, :, alive], axis=1) * every
    if apart.size and np.mean(~(apart <= APART)) > FEW:
        grows = f"one tangent grows more than e^{APART:g} times as much as another within that"
        raise BadInput(f"every = {every:g}: {grows}, and rounding loses the other: take a shorter interval")
    means = blocks(rates[:, :, kept])
    whole_spectrum = len(v) == v.shape[1] - (scene.clock is not None)
    of_all = (np.sum, kaplan_yorke) if whole_spectrum else (lambda each: math.nan,) * 2
    exponents, total, dimension = (jackknife(means, f) for f in (np.array, *of_all))
    cost, diverged = float(spent[kept].mean()) / (every * count), int((~alive).sum())
    averages = exponents, total, dimension, jackknife(blocks(energy[:, :, kept]), np.sum)
    return Lyapunov(scene, method, *averages, cost, diverged, rates[:, :, kept])


def orthonormal(v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return Q (m, d, n) and log diag R (m, n) of n sets of m vectors, by the modified Gram–Schmidt process."""
    v, logs = v.copy(), np.empty((len(v), v.shape[2]))
    for j in range(len(v)):
        for i in range(j):
            v[j] -= (v[i] * v[j]).sum(axis=0) * v[i]
        length = np.sqrt((v[j] * v[j]).sum(axis=0))
        v[j] /= length
        logs[j] = np.log(length)
    return v, logs


def side_by_side(run: FixedStepRun) -> TangentMap:
    """Return the map by dual numbers through the compiled steps: a trajectory for every tangent of every member."""
    r, counted = run.request, run.totals.evaluations
    try:
        loop = loop_on(run.method_, r.scene, r.carry, tangent=True)
    except CannotRecord as error:
        raise BadInput(f"method = {run.method!r}: {error}") from error
    evaluations = math.nan if counted is None else counted
    rows = None if r.scene.by_sites else loop.rows(np.array(r.scene.numbers()), run.h, run.n)

    def ends(starts: np.ndarray) -> np.ndarray:
        if rows is not None:
            return np.asarray(loop.side_by_side(starts, *rows)[-1])
        return np.stack([loop.states(r.scene, start, run.h, run.n)[-1] for start in starts.T], axis=-1)

    def follow(x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, float | np.ndarray]:
        m, d, n = v.shape
        end = ends(np.concatenate([np.tile(x, m), np.concatenate(v, axis=1)]))
        return end[:d, :n], np.array(np.split(end[d:], m, axis=1)), evaluations

    return follow


def one_by_one(run: PeerRun) -> TangentMap:
    larger: Any = run.variational().call
    clock = larger.scene.clock

    def follow(x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, float | np.ndarray]:
        m, d, n = v.shape
        moved = v if clock is None else np.delete(v, clock, axis=1)
        outcomes = larger.many(np.ascontiguousarray(np.concatenate([x, moved.reshape(-1, n)]).T))
        ends = np.where(outcomes[:, :1] == SUCCESS, outcomes[:, KNOWN:], np.nan).T
        moved = ends[d:].reshape(m, -1, n)
        v = moved if clock is None else np.insert(moved, clock, 0.0, axis=1)
        return ends[:d], v, outcomes[:, FACTS.index("evaluations")]

    return follow
