"""Verification of a user's scene: its gradient is the potential's, its Hessian the gradient's, its damping's parts
fit each other, its symmetry is there.  A wrong one would be integrated without a word, the reference included.

Derivatives are compared with differences near the initial data and along the motion, not with dual numbers, since a
user's functions may be ones that these cannot pass through.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import isfinite
from typing import Any, TypeGuard

import numpy as np

from contactbench.boundary import is_ours, their_code
from contactbench.errors import BadInput, excerpt, is_number
from contactbench.scene.base import Scene
from contactbench.scene.cache import Cache, key
from contactbench.scene.driven import Driven
from contactbench.scene.general_damping import GeneralDamping
from contactbench.scene.mechanical import Mechanical
from contactbench.trace.formula import Formula

#: points near the initial one, and how far from it, in parts of the size of each component
POINTS, SPREAD = 3, 0.1
#: steps of the differences, in parts of that size; the one is used at which two estimates agree best
STEPS = (1e-2, 1e-3, 1e-4, 1e-5)
#: a derivative is wrong when it is off by more than this part of its terms and by more than differences are
TOLERANCE = 1e-6
SAFETY = 8.0
#: where differences are worse than this nothing can be said: a kink, a singularity
UNSURE = 1e-3

#: evaluations that a motion is followed for, and places on every step of it
FOLLOWED, BETWEEN = 3000, 4
#: states of a motion at which is compared what is called state by state, and the step of its flows in parts of t_end
SOME, LATER = 32, 1e-2

_verified: Cache[bool] = Cache(1024)


def verify(scene: Scene) -> None:
    """Raise `BadInput` unless a scene's functions fit each other near its start; once per definition.

    The functions of this package have tests of their own.
    """
    _once(scene, "near the start", _verify)


def verify_along(scene: Scene) -> None:
    """Raise `BadInput` unless they fit along the motion, as far as some thousand evaluations lead."""
    _once(scene, "along the motion", lambda scene: _check(scene, _motion(scene)))


def verify_at(scene: Scene, y: np.ndarray) -> None:
    """Raise `BadInput` unless they fit at packed states (k, d)."""
    if _has_functions(scene):
        with their_code(f"scene {scene.name!r}"), np.errstate(all="ignore"):
            _check(scene, y)


def _has_functions(scene: Scene) -> TypeGuard[Mechanical]:
    """Return whether a user has written any of them."""
    given = (getattr(scene, name) for name in scene.functions)
    return isinstance(scene, Mechanical) and not all(part is None or is_ours(part) for part in given)


def _once(scene: Scene, where: str, check: Callable[[Mechanical], None]) -> None:
    if not _has_functions(scene):
        return

    def passes() -> bool:
        with their_code(f"scene {scene.name!r}"), np.errstate(all="ignore"):
            check(scene)
        return True

    start = tuple(getattr(scene, name) for name in scene.initial_fields)
    data = (where, tuple(scene.numbers()), start, scene.t_end, scene.rotation_invariant)
    _verified.get(key(scene.identity, *data), passes)


@contextmanager
def _within_the_domain() -> Iterator[None]:
    """Leave out what is to be compared where a function is not defined."""
    try:
        yield
    except BadInput:  # a ValueError too
        raise
    except (ArithmeticError, ValueError):
        return


def _is_given(function: Any) -> bool:
    """Return whether a function was not derived from another one."""
    return function is not None and not (isinstance(function, Formula) and function.live is None)


# -- states ----------------------------------------------------------------------------------------
def _verify(scene: Mechanical) -> None:
    """Compare near the start, the Hessian too; what is wrong with the scene's own data is reported."""
    carry, n, rng = scene.carry(("s",)), len(scene.q), np.random.default_rng(1)
    start = np.array(scene.pack(scene.initial(carry)))
    _potential(scene, *_place(scene, start))
    states = np.tile(start, (POINTS, 1))
    states[:, :n] += SPREAD * _size(start[:n]) * rng.uniform(-1, 1, (POINTS, n))
    states[:, -1] += SPREAD * rng.uniform(-1, 1, POINTS)
    _check(scene, states)
    for y in states if _is_given(scene.hessian) else ():
        with _within_the_domain():
            _hessian(scene, y[:n])


def _motion(scene: Mechanical) -> np.ndarray:
    """Return packed states (k, d) along the motion, by a solver of its own."""
    from scipy.integrate import DOP853

    carry = scene.carry(("s",))

    def slope(t: float, y: np.ndarray) -> list[float]:
        return scene.pack(scene.rhs(scene.unpack(y.tolist(), carry)))

    start = scene.pack(scene.initial(carry))
    path = [np.empty((0, len(start)))]
    with _within_the_domain():  # the motion ends there
        solver = DOP853(slope, 0.0, start, scene.t_end, rtol=1e-6, atol=1e-9)
        while solver.status == "running" and solver.nfev < FOLLOWED and isfinite(solver.h_abs):
            before = solver.t
            solver.step()
            path.append(solver.dense_output()(np.linspace(before, solver.t, BETWEEN + 1)[1:]).T)
    return np.concatenate(path)


def _check(scene: Mechanical, states: np.ndarray) -> None:
    """Compare the gradient at packed states (k, d), and symmetry and damping at some of them."""
    some = states[:: max(1, len(states) // SOME)]
    for y in some if _is_given(scene.gradient) else ():
        with _within_the_domain():
            _gradient(scene, *_place(scene, y))
    if scene.has_momentum_law:
        _symmetry(scene, some[:, : len(scene.q)])
    for y in some:
        with _within_the_domain():
            _damping(scene, y)


# -- gradient, Hessian, symmetry -------------------------------------------------------------------
def _place(scene: Mechanical, y: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """Return the coordinates of a packed state, and what else potential and gradient take: the time, or nothing."""
    return y[: len(scene.q)], [] if scene.clock is None else [float(y[scene.clock])]


def _potential(scene: Mechanical, q: np.ndarray, time: list[float]) -> float:
    """Return V, a real number."""
    value = scene.V(tuple(q.tolist()), *time)
    if not is_number(value):
        raise BadInput(
            f"scene {scene.name!r}: its potential is {excerpt(value)} at q = {_at(q)}: must be a number"
        )
    return float(value)


def _force(scene: Mechanical, q: np.ndarray, time: list[float]) -> np.ndarray:
    """Return ∇V, n real numbers; a number of another length is told as soon as the scene is made."""
    return np.array(scene.dV(tuple(q.tolist()), *time), dtype=float)


def _gradient(scene: Mechanical, q: np.ndarray, time: list[float]) -> None:
    """Raise `BadInput` unless the gradient is the potential's."""

    def potential(q: np.ndarray) -> np.ndarray:
        return np.array([_potential(scene, q, time)])

    _compare(scene, WRONG_GRADIENT, potential, q, _force(scene, q, time)[None], _size(q), f"q = {_at(q)}")


def _hessian(scene: Mechanical, q: np.ndarray) -> None:
    """Raise `BadInput` unless the Hessian at q is n rows of n numbers, the derivative of the gradient."""
    assert scene.hessian is not None
    n, given = len(q), scene.hessian(tuple(q.tolist()), **scene.parameters)
    try:
        rows = np.array([list(row) for row in given])
    except (TypeError, ValueError):
        rows = np.empty(0)
    if rows.shape != (n, n) or rows.dtype.kind not in "fiub":
        raise BadInput(
            f"scene {scene.name!r}: its Hessian is {excerpt(given)}: must be {n} rows of {n} real numbers"
        )
    where = f"q = {_at(q)}"
    _compare(scene, WRONG_HESSIAN, lambda q: _force(scene, q, []), q, rows.astype(float), _size(q), where)


def _symmetry(scene: Mechanical, places: np.ndarray) -> None:
    """Raise `BadInput` unless V(Rq) = V(q), so that ∇V is along q, at each place."""
    found = []
    for q in places:
        with _within_the_domain():
            force, size = _force(scene, q, []), float(np.linalg.norm(q))
            across = force - q * (q @ force) / size**2
            found.append((float(np.linalg.norm(across)) * size, float(np.linalg.norm(force)) * size, q))
    largest = max((terms for _, terms, _ in found if isfinite(terms)), default=0.0)
    for torque, terms, q in found:
        if torque > TOLERANCE * (terms + 1e-3 * largest):  # at an equilibrium a force is rounding
            raise BadInput(
                f"scene {scene.name!r}: rotation_invariant = True, but the potential exerts a torque, "
                f"‖q × ∇V‖ = {torque:.6g} at q = {_at(q)}"
            )


# -- damping ---------------------------------------------------------------------------------------
def _damping(scene: Mechanical, y: np.ndarray) -> None:
    """Raise `BadInput` unless the parts of a damping that is the user's fit each other at a packed state."""
    h = LATER * scene.t_end
    if isinstance(scene, GeneralDamping):
        s, flow = float(y[-1]), scene.damping_flow
        _slope(scene, WRONG_SLOPE, scene.damping, s, 1.0, scene.damping_slope(s), f"s = {s:.6g}")
        if flow is not None:
            rate = -scene.damping(flow(s, h, math))
            _flow(scene, "damping_flow", lambda h: flow(s, h, math), s, h, rate, f"s = {s:.6g}")
    if isinstance(scene, Driven) and scene.span is not None:
        t, where = float(y[scene.clock]), f"t = {y[scene.clock]:.6g}"
        rates = (scene.rate_at(t + h), math.exp(-scene.spent(t, h, math)[0]))
        for i, rate in enumerate(rates):
            _flow(scene, f"span[{i}]", lambda h, i=i: scene.spent(t, h, math)[i], 0.0, h, rate, where)  # type: ignore[misc]


def _flow(
    scene: Mechanical, name: str, f: Callable[[float], Any], start: float, h: float, rate: float, where: str
) -> None:
    """Raise `BadInput` unless a function of h begins with `start` and has a slope at h."""
    if abs(f(0.0) - start) > TOLERANCE * max(abs(start), abs(f(h))):
        raise BadInput(f"scene {scene.name!r}: {name} is {f(0.0):.6g} at {where}, h = 0: must be {start:.6g}")
    says = (f"{name} has not the slope of its definition: this is", "function by h")
    _slope(scene, says, f, h, h / 2, rate, f"{where}, h = {h:.6g}")


def _slope(
    scene: Mechanical,
    says: tuple[str, str],
    f: Callable[[float], Any],
    x: float,
    size: float,
    given: float,
    where: str,
) -> None:
    """Raise `BadInput` unless `given` is the derivative of f at x."""

    def vector(x: np.ndarray) -> np.ndarray:
        return np.array([f(float(x[0]))], dtype=float)

    _compare(scene, says, vector, np.array([x]), np.array([[given]]), np.array([size]), where)


# -- derivatives -----------------------------------------------------------------------------------
#: what is wrong, and what it is not the derivative of
WRONG_GRADIENT = ("its gradient is not the potential's: component {j} is", "potential")
WRONG_HESSIAN = ("its Hessian is not the gradient's derivative: entry ({i}, {j}) is", "gradient")
WRONG_SLOPE = ("damping_slope is not the damping's: it is", "damping")


def _compare(
    scene: Mechanical,
    says: tuple[str, str],
    f: Callable[[np.ndarray], np.ndarray],
    x: np.ndarray,
    given: np.ndarray,
    size: np.ndarray,
    where: str,
) -> None:
    """Raise `BadInput` unless `given` (m, n) is the derivative of f, (m,), at x (n,), or differences cannot tell."""
    rng = np.random.default_rng(1)
    direction = size * rng.uniform(0.5, 1, len(x)) * rng.choice([-1, 1], len(x))
    found, error = difference(f, x, direction)
    if not (np.isfinite(given).all() and np.isfinite(found).all()):
        raise FloatingPointError
    off = np.abs(found - given @ direction).max()
    scale = max((np.abs(given) @ np.abs(direction)).max(), np.abs(found).max())
    if off > TOLERANCE * scale + SAFETY * error and error <= UNSURE * scale:
        columns = [difference(f, x, unit)[0] / unit[j] for j, unit in enumerate(np.diag(size))]
        _refuse(scene, says, given, np.array(columns).T, size, where)


def _refuse(
    scene: Mechanical,
    says: tuple[str, str],
    given: np.ndarray,
    found: np.ndarray,
    size: np.ndarray,
    where: str,
) -> None:
    """Raise `BadInput` that names the entry of a derivative that is farthest off."""
    i, j = np.unravel_index(np.argmax(np.abs(found - given) * size), given.shape)
    entry, function = says
    raise BadInput(
        f"scene {scene.name!r}: {entry.format(i=i + 1, j=j + 1)} {given[i, j]:.6g} at {where}, "
        f"the derivative of the {function} there {found[i, j]:.6g}"
    )


def difference(
    f: Callable[[np.ndarray], np.ndarray], q: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, float]:
    """Return the derivative of f along a direction by central differences of order 4, and about its error.

    Two estimates may agree by luck where rounding leaves f but a few values: it adds ε |f| over the step.
    """
    best, error = np.full_like(f(q), math.nan), math.inf
    for step in STEPS:
        ends = [(f(q + h * direction), f(q - h * direction)) for h in (step, step / 2)]
        wide, narrow = ((a - b) / (2 * h) for (a, b), h in zip(ends, (step, step / 2), strict=True))
        rounding = 2 * np.finfo(float).eps * max(float(np.abs(x).max()) for pair in ends for x in pair) / step
        gap = float(np.abs(wide - narrow).max()) + rounding
        if gap < error:
            best, error = narrow + (narrow - wide) / 3, gap
    return best, error


def _size(q: np.ndarray) -> np.ndarray:
    """Return the size of each component, the largest for those that are zero."""
    return np.where(q == 0, np.abs(q).max() or 1.0, np.abs(q))


def _at(q: np.ndarray) -> str:
    return f"({', '.join(f'{x:.6g}' for x in q[:4])}{', …' if len(q) > 4 else ''})"
