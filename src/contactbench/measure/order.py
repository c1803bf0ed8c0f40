"""Orders of convergence from errors at several step sizes, or from a few steps at 50 digits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from contactbench.methods.contact_exact import ExactMethod
from contactbench.methods.contact_log import Logarithmic
from contactbench.methods.fixed_step import FixedStep
from contactbench.numbers.protocol import Arithmetic
from contactbench.scene import Scene
from contactbench.scene.base import Elapsed
from contactbench.truth import decimal_context, reference, with_decimals

if TYPE_CHECKING:
    from mpmath import MPContext

#: number of neighbouring points for an order: three slopes, two extrapolations of each power
WINDOW = 4
#: powers of h in the leading correction of the slope
POWERS = (1, 2)
#: slopes further than this from the extrapolated order are not asymptotic
ASYMPTOTIC = 0.5
#: an order with a larger uncertainty is not reported
USELESS = 0.5
#: round-off in an error, as a fraction of the floor
ROUND_OFF = 0.03
#: factors on the last difference of extrapolations, which estimates the error: with and without another difference to
#: check it
SAFETY, UNCHECKED = 3.0, 9.0


@dataclass(frozen=True)
class OrderFit:
    """An extrapolated order of convergence.

    order : the limit of the pairwise slopes as h → 0; nan if no window of points has one.  uncertainty : from the
    spread of neighbouring extrapolations and round-off.  last_slope : slope of the two finest points used.  used :
    mask of the points used.  pairwise : slope between each point and the next larger step.
    """

    order: float
    uncertainty: float
    last_slope: float
    used: np.ndarray
    pairwise: np.ndarray


def fit_order(steps: Sequence[float], errors: Sequence[float], floor: float = 0.0) -> OrderFit:
    """Fit an order to the four neighbouring points that give it the least uncertainty; errors < floor are round-off.

    e(h) = C h^p (1 + a h^k + …), k = 1 in general and k = 2 for a symmetric method.  The slope of log e against log h
    between neighbours is p + a k m + … with m = (h₁^k − h₀^k) / (k log(h₁/h₀)), the logarithmic mean of the two h^k.
    Two neighbouring slopes are extrapolated to m = 0 (Richardson), for steps of any ratio.
    """
    h, e = np.asarray(steps, dtype=float), np.asarray(errors, dtype=float)
    order = np.argsort(h)
    back = np.argsort(order)
    h, e = h[order], e[order]
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = np.diff(np.log(e)) / np.diff(np.log(h))
    sound = np.isfinite(e) & (e > floor)
    found = []
    for i in range(len(h) - WINDOW + 1):
        if not sound[i : i + WINDOW].all():
            continue
        more = WINDOW + int(sound[i : i + WINDOW + 1].sum() > WINDOW)  # the next point checks the trend
        blur = ROUND_OFF * floor / e[i : i + WINDOW]
        limit, uncertainty = extrapolate(h[i : i + more], slopes[i : i + more - 1], blur)
        strays = np.abs(slopes[i : i + WINDOW - 1] - limit).max()
        if uncertainty <= USELESS and strays <= ASYMPTOTIC:
            found.append((uncertainty, i, limit, float(slopes[i])))
    uncertainty, first, limit, last_slope = min(found, default=(math.nan, len(h), math.nan, math.nan))
    used = np.zeros(len(h), dtype=bool)
    used[first : first + WINDOW] = True
    return OrderFit(limit, uncertainty, last_slope, used[back], np.append(slopes, math.nan)[back])


def extrapolate(h: np.ndarray, slopes: np.ndarray, blur: np.ndarray) -> tuple[float, float]:
    """Return the limit of three or four slopes, finest first, and its uncertainty.

    blur : the relative round-off in the errors.  The uncertainty is the difference of successive extrapolations, scaled
    to the finest step like h², times a safety factor, plus the effect of round-off.  The power of h is the one among
    `POWERS` with the least differences.
    """
    spans = np.log(h[1:] / h[:-1])
    noise = blur[1:3] + blur[:2]
    candidates = []
    for k in POWERS:
        mean = (h[1:] ** k - h[:-1] ** k) / (k * spans)
        weight = mean[:-1] / (mean[1:] - mean[:-1])  # limit = s₀ − weight (s₁ − s₀)
        limits = slopes[:-1] - weight * (slopes[1:] - slopes[:-1])
        ratios = (h[1 : len(limits)] / h[: len(limits) - 1]) ** 2
        differences = np.abs(np.diff(limits)) * np.maximum(1.0, 1 / (ratios - 1))
        differences *= (h[0] / h[: len(differences)]) ** 2
        shaken = ((1 + weight[0]) * noise[0] + weight[0] * noise[1]) / spans[0]
        candidates.append((differences.max(), limits[0], shaken))
    spread, limit, shaken = min(candidates)
    safety = SAFETY if len(slopes) == WINDOW else UNCHECKED
    return float(limit), float(safety * spread + shaken)


# -- in extended precision -------------------------------------------------------------------------
DIGITS = 50


#: methods with steps on any kind of number
type Stepping = FixedStep | Logarithmic | ExactMethod


def fastest(context: MPContext) -> Any:
    """Return the fastest namespace of numbers of as many digits: gmpy2's if it is installed."""
    try:
        from contactbench.numbers.decimals import of_precision
    except ImportError:
        return context
    return of_precision(context.prec)


def march(
    method: Stepping,
    scene: Scene,
    step: str | Arithmetic,
    n: int,
    context: MPContext,
    start: Sequence[Arithmetic] | None = None,
) -> list[Arithmetic]:
    """Return the packed state, all fields carried, after n steps from the scene's or another packed start."""
    xp, carry = fastest(context), scene.carry()
    with getattr(xp, "context", nullcontext()):
        twin = with_decimals(scene, xp.mpf)
        x = twin.initial(carry) if start is None else twin.unpack([*map(xp.mpf, start)], carry)
        try:
            end = twin.pack(method.advance(twin, x, xp.mpf(step), n, xp))
        except ArithmeticError as why:
            raise OverflowError(f"a number beyond any scale ({why})") from why
        return end if xp is context else [context.mpf(str(c)) for c in end]


def error_at(method: Stepping, scene: Scene, t: float, n: int) -> Arithmetic:
    """Return ‖y_n − y*(t)‖₂ after n steps of size t/n, as an mpmath number; the reference has up to 40 digits."""
    context = decimal_context(DIGITS)
    truth = [context.mpf(c) for c in reference(scene, Elapsed([t])).decimals[0]]
    return apart(march(method, scene, context.mpf(repr(t)) / n, n, context), truth, context)


def apart(a: list[Arithmetic], b: list[Arithmetic], context: MPContext) -> Arithmetic:
    found: Arithmetic = context.norm([x - y for x, y in zip(a, b, strict=True)])
    return found


def order_at(method: Stepping, scene: Scene, t: float, n: int) -> float:
    """Return the order from n, 2n and 4n steps to time t, extrapolated to h → 0, in h² for a symmetric method."""
    context = decimal_context(DIGITS)
    coarse, middle, fine = (error_at(method, scene, t, n * 2**k) for k in range(3))
    first, second = context.log(coarse / middle, 2), context.log(middle / fine, 2)
    weight = 4 if method.symmetric else 2
    return float((weight * second - first) / (weight - 1))


def local_order(method: Stepping, scene: Scene, step: str = "1e-6", digits: int = 150) -> float:
    """Return the order p from ‖Φ_h − Φ_{h/2}∘Φ_{h/2}‖ = O(h^{p+1}) at a small h."""
    context = decimal_context(digits)

    def defect(h: Arithmetic) -> Arithmetic:
        once, twice = march(method, scene, h, 1, context), march(method, scene, h / 2, 2, context)
        return apart(once, twice, context)

    h = context.mpf(step)
    return float(context.log(defect(h) / defect(h / 2), 2)) - 1
