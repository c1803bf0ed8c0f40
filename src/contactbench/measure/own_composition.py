"""Register a contact integrator from a user's coefficients after measuring its order: `composition`."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from itertools import zip_longest

from contactbench.checks import items_of, switch, text, whole
from contactbench.errors import BadInput, excerpt
from contactbench.measure.order import local_order
from contactbench.methods.base import METHODS
from contactbench.methods.contact import ContactMethod, contact_method
from contactbench.methods.fixed_step import MOST
from contactbench.scenes import SCENES
from contactbench.splitting.composition import Composition, Stage

#: allowed rounding of each coefficient in the sum of a part, which must be one
ROUNDED = Fraction(1, 10**14)
#: the step whose halving gives the order, and the digits of the computation: coefficients of sixteen digits show an
#: order up to eight at this step
STEP, DIGITS = "0.1", 50
#: allowed difference between the measured and the claimed order
NEAR = 0.4


def composition(
    name: str,
    order: int,
    kick: Sequence[float | str | Fraction],
    drift: Sequence[float | str | Fraction],
    *,
    nystrom: bool = False,
    about: str = "composition of one's own coefficients",
) -> ContactMethod:
    """Register the contact integrator that applies kicks and damped drifts in turn.

    The order is measured, on the particle and, unless `nystrom`, on the rigid body.  The method is then one of
    METHODS: it has its row in `compare`, and from a plug-in in every table.

    Parameters
    ----------
    name
        A key in tables and a word on the command line.
    order
        The claimed order of convergence.
    kick, drift
        Coefficients in the order in which they act, numbers or strings of digits; the longer list begins and ends
        (lists of the same length begin with a kick).  Each list adds up to one; the rounding error of printed digits
        is added to the middle, so that the conformal factor of a step is e^{−γh}.
    nystrom
        Whether the order requires a potential that depends on q alone; then rigid bodies are refused.
    about
        One line with the source.

    Returns
    -------
    ContactMethod
        The method, which is in `METHODS` by its name.

    Raises
    ------
    BadInput
        For lists whose lengths differ by more than one, sums that are not one, a name that is taken, or a wrong order.

    Examples
    --------
    >>> import contactbench as cb
    >>> leapfrog = cb.composition("my-leapfrog", order=2, kick=[0.5, 0.5], drift=[1])
    """
    switch("nystrom", nystrom)
    text("about", about)
    order = whole("order", order, MOST)
    made = Composition(name, order, stages(exact("kick", kick), exact("drift", drift)), about, nystrom)
    method = contact_method(made)
    check_order(method)
    METHODS.add(method)
    return method


def exact(part: str, coefficients: Sequence[float | str | Fraction]) -> list[Fraction]:
    """Return the coefficients as exact decimals with sum one; a palindrome stays a palindrome."""
    found: list[Fraction] = []
    for i, coefficient in enumerate(items_of(part, coefficients, "a list of coefficients")):
        try:
            found.append(Fraction(str(coefficient)))
        except (ValueError, ZeroDivisionError):
            why = f"{part}[{i}] = {excerpt(coefficient)}: must be a number, as 0.25 or '1/4'"
            raise BadInput(why) from None
    if not found:
        raise BadInput(f"{part} = {excerpt(coefficients)}: must have at least one coefficient")
    rest, n = 1 - sum(found, Fraction(0)), len(found)
    if abs(rest) > ROUNDED * n:
        raise BadInput(f"{part}: coefficients add up to {float(1 - rest)!r}, must be 1")
    for i in {(n - 1) // 2, n // 2}:
        found[i] += rest / (2 - n % 2)
    return found


def stages(kick: Sequence[Fraction], drift: Sequence[Fraction]) -> tuple[Stage, ...]:
    if abs(len(kick) - len(drift)) > 1:
        numbers = f"kick has {len(kick)} coefficients and drift {len(drift)}"
        raise BadInput(f"{numbers}: as they alternate, the numbers differ by one at most")
    names, lists = ("kick", "drift_damp"), (kick, drift)
    if len(drift) > len(kick):
        names, lists = names[::-1], lists[::-1]
    pairs = zip_longest(*lists)
    return tuple((name, c) for pair in pairs for name, c in zip(names, pair, strict=True) if c is not None)


def check_order(method: ContactMethod) -> None:
    for scene in (SCENES["particle"], SCENES["rigid_body"]):
        if method.refuses(scene) is not None:
            continue
        measured = local_order(method, scene, STEP, DIGITS)
        if abs(measured - method.order) > NEAR:
            hint = "; nystrom=True if it is meant for potentials only" if scene.name == "rigid_body" else ""
            raise BadInput(f"order = {method.order}: measured {measured:.2f} on {scene.name}{hint}")
