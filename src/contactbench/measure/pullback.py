"""Quantities from the derivative of a numerical map: the pullback Φ*η of the contact form, pairs of singular values.

If Γ = γs, then s does not act on (q, p), and Φ*η = e^{−γt} η implies AᵀJA = e^{−γt} J for the tangent map A of (q, p).
For every singular value σ of A, e^{−γt}/σ is another one: σ_i σ_{2n+1−i} = e^{−γt} at every time, and in the limit
λ_i + λ_{2n+1−i} = −γ for the Lyapunov exponents (Dressler, Phys. Rev. A 38, 2103 (1988),
doi:10.1103/PhysRevA.38.2103).  If γ depends on the time, e^{−∫γ} replaces e^{−γt}.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from contactbench.methods.base import prepare
from contactbench.numbers.dual import Dual, slope
from contactbench.numbers.protocol import Arithmetic, Vector
from contactbench.scene import AnyState, Equations, Scene, norm
from contactbench.scene.base import Elapsed
from contactbench.solution import SAFETY, Differential, Solution, closest


class Pulled(NamedTuple):
    """A form pulled back by the map at every saved time, (k, m).

    start : the form at the start, (m,).  terms : the size of its terms, (k,).  uncertainty : error bar in the norm over
    m, (k,); None if there is only round-off.
    """

    values: np.ndarray
    start: np.ndarray
    terms: np.ndarray
    uncertainty: np.ndarray | None


def pullback(solution: Solution, differential: Differential) -> Pulled | None:
    """Return η(Φ)·DΦ on the m tangents from a derivative of the run's map; None if it was not taken.

    If the derivative has several estimates, each tangent uses the one that differs least from the next over all saved
    times, relative to the largest value; `SAFETY` times that difference is the error bar.  The terms are
    ‖|∂s| + ‖p‖‖∂q‖‖.
    """
    if not differential.taken:
        return None
    scene, start = solution.scene, solution.start()
    units = units_of(scene, start)[:, None]
    form = np.array([float(scene.contact_form(start, v)) for v in scene.tangents(start)]) * units[:, 0]
    # (l, k, d, m) → a state of arrays (l, m, k)
    pushed = scene.unpack(np.moveaxis(differential.estimates, (2, 3), (0, 2)), solution.carry)
    here = solution.states()
    values = np.asarray(scene.contact_form(here, pushed)) * units
    terms = np.asarray(scene.contact_terms(here, pushed)) * units
    if len(values) == 1:
        return Pulled(values[0].T, form, np.linalg.norm(terms[0], axis=0), None)
    gaps = np.abs(np.diff(values, axis=0))  # (l - 1, m, k)
    scale = np.abs(values[-1]).max(axis=0) + np.finfo(float).tiny
    best = closest((gaps / scale).max(axis=2))
    chosen = np.arange(len(best))
    size, gap = (norm(tuple(each[best, chosen])) for each in (terms, gaps))
    return Pulled(values[best, chosen].T, form, size, SAFETY * gap)


def variational(solution: Solution) -> Differential:
    """Return dΦ by the variational equations y' = f(y), v' = Df(y) v, solved by the method of the run.

    Its tolerance bounds the errors of y and v alike.  Dieci, Van Vleck, Appl. Numer. Math. 17, 275 (1995),
    doi:10.1016/0168-9274(95)00033-Q, §1.
    """
    assert solution.run is not None
    scene, carry, request = solution.scene, solution.carry, solution.run.request
    begins, y0 = scene.split_clock(solution.y0)
    tangents = [scene.without_clock(scene.pack(v)) for v in scene.tangents(solution.start())]
    d, m = len(y0), len(tangents)

    def rhs(t: Arithmetic, z: Vector) -> list[Arithmetic]:
        y, *moved = (z[i : i + d] for i in range(0, len(z), d))
        rates = [scene.slopes(t, list(map(Dual, y, v)), carry) for v in moved]
        return [*scene.slopes(t, y, carry), *(slope(c) for rate in rates for c in rate)]

    kind: Any = Equations  # not abstract, although `rhs` is an argument
    larger = kind(rhs=rhs, y0=np.concatenate([y0, *tangents]), t=begins, t_end=scene.t_end)
    given: Any = {"rtol": request.rtol, "engine": request.engine, "save_at": Elapsed(request.save_at)}
    v = prepare(larger, solution.method, **given)().y[:, d:-1].reshape(-1, m, d)
    v = v if scene.clock is None else np.insert(v, scene.clock, 0.0, axis=2)
    return Differential("variational equations", np.moveaxis(v, 1, 2)[None])


def growth(differential: Differential) -> float:
    """Return max ‖DΦ(t)‖₂ over the saved times; nan if it is not finite, as for an iteration without a derivative."""
    if not np.isfinite(differential.value).all():
        return math.nan
    return float(np.linalg.norm(differential.value, ord=2, axis=(1, 2)).max())


def units_of(scene: Scene, x: AnyState) -> np.ndarray:
    """Return the units of the tangents: the scales if each component has a unit of its own, else 1."""
    if scene.canonical and scene.mixed:
        return scene.scales(x, scene.t_end)
    return np.ones(len(scene.tangents(x)))


def in_units(solution: Solution) -> Differential:
    """Return the derivative of a run's map with all components and displacements in their units."""
    scene, differential = solution.scene, solution.differential
    if not (scene.canonical and scene.mixed):
        return differential
    units = units_of(scene, solution.start())
    rows = np.array(scene.with_clock(units.tolist(), 1.0))
    return differential._replace(estimates=differential.estimates * units / rows[:, None])


def pairs(differential: Differential, n: int, units: np.ndarray | None = None) -> Pulled | None:
    """Return σ_i σ_{2n+1−i} for n degrees of freedom, σ_1 the largest; None without a finite derivative.

    If the derivative has several estimates, the one that agrees best with the next is used.  The terms are
    σ_1 ‖(σ_1, …, σ_n)‖: the smaller value of a pair has the round-off of σ_1.  units : sizes of q and p; q is scaled by
    √(q/p) and p by its inverse, which keeps the pairs.
    """
    a = np.ones(n) if units is None else np.sqrt(units[:n] / units[n : 2 * n])
    sides = np.concatenate([a, 1 / a])
    tangent = differential.estimates[:, :, : 2 * n, : 2 * n] * sides / sides[:, None]
    if not differential.taken or not np.isfinite(tangent).all():
        return None
    sigma = np.linalg.svd(tangent, compute_uv=False)
    values = sigma[..., :n] * sigma[..., : n - 1 : -1]
    terms = sigma[..., 0] * np.linalg.norm(sigma[..., :n], axis=-1)
    if len(values) == 1:
        return Pulled(values[0], np.ones(n), terms[0], None)
    gaps = np.linalg.norm(np.diff(values, axis=0), axis=-1)
    best = int(np.argmin(gaps.max(axis=1)))
    return Pulled(values[best], np.ones(n), terms[best], SAFETY * gaps[best])
