"""Derivative and momentum map of a numerical map in extended precision."""

from typing import Any

from contactbench.measure.order import DIGITS, march
from contactbench.scene import Scene
from contactbench.truth import decimal_context, with_decimals

#: a map is differentiated by central differences of step 10^{-50} at 150 digits: truncation and
#: cancellation both leave 10^{-100}
DERIVATIVE_DIGITS = 150
DIFFERENCE = -50


def pullback(method: Any, scene: Scene, step: str, n: int) -> tuple[list[Any], list[Any]]:
    """η(Φ)·DΦ and η at the start, each on the scene's tangents, for n steps; mpmath numbers."""
    context = decimal_context(DERIVATIVE_DIGITS)
    twin = with_decimals(scene, context.mpf)
    x = twin.initial(scene.carry())
    start, delta = twin.pack(x), context.mpf(10) ** DIFFERENCE
    end = twin.unpack(march(method, scene, step, n, context), scene.carry())
    pulled, form = [], []
    for v in twin.tangents(x):
        ahead, behind = (
            march(
                method, scene, step, n, context, [a + d * b for a, b in zip(start, twin.pack(v), strict=True)]
            )
            for d in (delta, -delta)
        )
        pushed = [(a - b) / (2 * delta) for a, b in zip(ahead, behind, strict=True)]
        pulled.append(twin.contact_form(end, twin.unpack(pushed, scene.carry())))
        form.append(twin.contact_form(x, v))
    return pulled, form


def contact_defect(method: Any, scene: Scene, step: str, n: int) -> Any:
    """‖Φ*η − cⁿ η‖ / ‖cⁿ η‖ for n steps, c the method's own conformal factor."""
    context = decimal_context(DERIVATIVE_DIGITS)
    pulled, form = pullback(method, scene, step, n)
    twin = with_decimals(scene, context.mpf)
    factor = method.conformal_factor(twin, context.mpf(step), context) ** n
    difference = context.norm([a - factor * b for a, b in zip(pulled, form, strict=True)])
    return difference / abs(factor) / context.norm(form)


def momentum_defect(method: Any, scene: Scene, step: str, n: int) -> Any:
    """‖J(y_n) − cⁿ J(y_0)‖ / ‖cⁿ J(y_0)‖ after n steps, c the method's own conformal factor."""
    context = decimal_context(DIGITS)
    twin = with_decimals(scene, context.mpf)
    before = twin.momentum_at(twin.initial(scene.carry()))
    after = twin.momentum_at(twin.unpack(march(method, scene, step, n, context), scene.carry()))
    factor = method.conformal_factor(twin, context.mpf(step), context) ** n
    assert before is not None
    assert after is not None
    difference = context.norm([a - factor * b for a, b in zip(after, before, strict=True)])
    return difference / abs(factor) / context.norm(before)
