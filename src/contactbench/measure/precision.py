"""Fixed-step methods in extended precision: what round-off hides in float64.

The step maps run on mpmath numbers as they are.  Numbers of a scene are taken as the decimals they
print as, so that results compare with `references.reference` to all its digits.
"""

from __future__ import annotations

from typing import Any

from contactbench.scene import Scene
from contactbench.truth import decimal_context, reference, with_decimals

DIGITS = 50


def march(
    method: Any, scene: Scene, step: Any, n: int, context: Any, start: list[Any] | None = None
) -> list[Any]:
    """The packed state, every optional field carried, after n steps of size `step`.

    step : decimal string or mpmath number.  start : packed initial state, by default the scene's own.
    """
    twin = with_decimals(scene, context.mpf)
    x = twin.initial(scene.carry()) if start is None else twin.unpack(start, scene.carry())
    return twin.pack(method.advance(twin, x, context.mpf(step), n, context))


def error_at(method: Any, scene: Scene, t: float, n: int) -> Any:
    """‖y_n − y*(t)‖₂ after n steps of size t/n, as an mpmath number.

    The digits of the reference (up to 40) bound what this can resolve.
    """
    context = decimal_context(DIGITS)
    truth = [context.mpf(c) for c in reference(scene, [t]).decimals[0]]
    y = march(method, scene, context.mpf(repr(t)) / n, n, context)
    return context.norm([a - b for a, b in zip(y, truth, strict=True)])


def order_at(method: Any, scene: Scene, t: float, n: int) -> float:
    """Order of convergence from n, 2n and 4n steps to time t.

    The two slopes are extrapolated to h → 0: their own error is O(h), and O(h²) for a symmetric
    method, whose error has an expansion in h².
    """
    context = decimal_context(DIGITS)
    coarse, middle, fine = (error_at(method, scene, t, n * 2**k) for k in range(3))
    first, second = context.log(coarse / middle, 2), context.log(middle / fine, 2)
    weight = 4 if method.symmetric else 2
    return float((weight * second - first) / (weight - 1))


def local_order(method: Any, scene: Scene, step: str = "1e-6", digits: int = 150) -> float:
    """Order from one step against two half steps, ‖Φ_h − Φ_{h/2}∘Φ_{h/2}‖ = O(h^{p+1}).

    No reference is needed, and at so small a step the lowest power of h stands out however small its
    coefficient is.  It is the order towards the flow of what the method is consistent with.
    """
    context = decimal_context(digits)

    def defect(h: Any) -> Any:
        once, twice = march(method, scene, h, 1, context), march(method, scene, h / 2, 2, context)
        return context.norm([a - b for a, b in zip(once, twice, strict=True)])

    h = context.mpf(step)
    return float(context.log(defect(h) / defect(h / 2), 2)) - 1
