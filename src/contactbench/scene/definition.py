"""Verification of a user's scene: its gradient is the potential's, its Hessian the gradient's, its damping's parts
fit each other, its symmetry is there.  A wrong one would be integrated without a word, the reference included.

Derivatives are compared with differences near the initial data and along the motion, not with dual numbers, since a
user's functions may be ones that these cannot pass through.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from math import isfinite
from typing import Any, TypeGuard

import numpy as np

from contactbench.boundary import is_ours, their_code
from contactbench.errors import BadInput, excerpt, is_real
from contactbench.scene.base import Scene
from contactbench.scene.cache import Cache, key
from contactbench.scene.driven import Driven
from contactbench.scene.general_damping import GeneralDamping
from contactbench.scene.mechanical import Mechanical, derived_gradient
from contactbench.trace.formula import Formula

#: points besides the initial one, and how far from it, in parts of the size of each component
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
    _once(scene, "along the motion", _verify_along)


def verify_at(scene: Scene, y: np.ndarray) -> None:
    """Raise `BadInput` unless they fit at packed states (k, d)."""
    if _has_functions(scene):
        with their_code(f"scene {scene.name!r}"), np.errstate(all="ignore"):
            _check(scene, y.T)


def _has_functions(scene: Scene) -> TypeGuard[Mechanical]:
    """Return whether a user has written any of them."""
    return isinstance(scene, Mechanical) and not all(
        is_ours(part) for name in scene.functions if (part := getattr(scene, name)) is not None
    )


@contextmanager
def _within_the_domain() -> Iterator[None]:
    """Leave out what is to be compared where a function is not defined."""
    try:
        yield
    except BadInput:  # a ValueError too
        raise
    except (ArithmeticError, ValueError):
        return


def _places(scene: Mechanical, states: np.ndarray) -> np.ndarray:
    """Return the coordinates of packed states (d, k), the time below them if it is a component."""
    n = len(scene.q)
    return states[:n] if scene.clock is None else np.vstack([states[:n], states[scene.clock]])


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


def _verify_along(scene: Mechanical) -> None:
    """Follow the motion by a solver of its own and compare at every place of it."""
    from scipy.integrate import DOP853

    carry = scene.carry(("s",))

    def slope(t: float, y: np.ndarray) -> list[float]:
        return scene.pack(scene.rhs(scene.unpack(y.tolist(), carry)))

    path: list[np.ndarray] = []
    with _within_the_domain():  # the motion ends there
        start = scene.pack(scene.initial(carry))
        solver = DOP853(slope, 0.0, start, scene.t_end, rtol=1e-6, atol=1e-9)
        while solver.status == "running" and solver.nfev < FOLLOWED and isfinite(solver.h_abs):
            before = solver.t
            solver.step()
            path.append(solver.dense_output()(np.linspace(before, solver.t, BETWEEN + 1)[1:]))
    if path:
        _check(scene, np.concatenate(path, axis=1))


def _check(scene: Mechanical, states: np.ndarray) -> None:
    """Compare the gradient at packed states (d, k), and symmetry and damping at some of them."""
    _compare(scene, _places(scene, states))
    some = states[:, :: max(1, states.shape[1] // SOME)].T
    if scene.has_momentum_law:
        _symmetry(scene, some[:, : len(scene.q)])
    for y in some:
        with _within_the_domain():
            _damping(scene, y)


def _compare(scene: Mechanical, places: np.ndarray) -> None:
    """Raise `BadInput` unless the gradient is that of the potential at `_places`."""
    n = len(scene.q)
    q, rest = tuple(places[:n]), () if scene.clock is None else (places[n],)
    if not _has_formulas(scene):
        for place in places[:, :: max(1, places.shape[1] // SOME)].T:
            with _within_the_domain():
                _gradient(scene, place[:n], np.ones(n), np.where(place[:n] == 0, 1.0, np.abs(place[:n])))
        return
    assert isinstance(scene.potential, Formula)
    assert isinstance(scene.gradient, Formula)
    try:
        wanted = derived_gradient(scene.potential)
    except BadInput:  # a function whose derivative is not known
        return
    a, b = (
        np.array(np.broadcast_arrays(*g(q, *rest, **scene.parameters), places[0])[:n], dtype=float)
        for g in (scene.gradient, wanted)
    )
    size = np.abs(b).max(axis=0)
    off = np.abs(a - b).max(axis=0)
    known = np.isfinite(off) & np.isfinite(size)
    # at an equilibrium a force is the rounding of its terms: how large it is nearby tells
    beside = tuple(x + SPREAD * (np.abs(places[:n]).max() or 1.0) for x in q)
    nearby = [np.abs(np.asarray(x, dtype=float)) for x in wanted(beside, *rest, **scene.parameters)]
    scale = max([float(x[np.isfinite(x)].max(initial=0.0)) for x in nearby] + [size[known].max(initial=0.0)])
    wrong = known & (off > TOLERANCE * size + 1e-3 * TOLERANCE * scale)
    if wrong.any():
        k = int(np.argmax(np.where(wrong, off, 0.0)))
        i = int(np.argmax(np.abs(a - b)[:, k]))
        raise BadInput(
            f"scene {scene.name!r}: its gradient is not the potential's: component {i + 1} is {a[i, k]:.6g} at "
            f"q = {_at(places[:n, k])}, the derivative of the potential there {b[i, k]:.6g}"
        )


def _verify(scene: Mechanical) -> None:
    start = np.array(scene.q)
    size = np.where(start == 0, np.abs(start).max() or 1.0, np.abs(start))
    rng = np.random.default_rng(1)
    _number(scene, start)  # the scene's own data: whatever is wrong here is reported
    beside = []
    for _ in range(POINTS):
        q = start + SPREAD * size * rng.uniform(-1, 1, len(start))
        direction = size * rng.uniform(0.5, 1, len(start)) * rng.choice([-1, 1], len(start))
        with _within_the_domain():
            if _has_formulas(scene):
                time = [] if scene.clock is None else [scene.pack(scene.initial(()))[scene.clock]]
                _compare(scene, np.array([*q, *time])[:, None])
            else:
                _gradient(scene, q, direction, size)
            if scene.hessian is not None and not _follows(scene):
                _hessian(scene, q, direction, size)
            beside.append(q)
    if scene.has_momentum_law:
        _symmetry(scene, beside)
    s = scene.s + SPREAD * rng.uniform(-1, 1)
    with _within_the_domain():
        _damping(scene, np.array(scene.pack(scene.initial(scene.carry(("s",)), s=s))))


def _number(scene: Mechanical, q: np.ndarray) -> float:
    """Return V(q), a real number."""
    value = scene.V(tuple(q.tolist()))
    if not is_real(value) or not hasattr(value, "__float__"):
        raise BadInput(
            f"scene {scene.name!r}: its potential is {excerpt(value)} at q = {_at(q)}: must be a number"
        )
    return float(value)


def _force(scene: Mechanical, q: np.ndarray) -> np.ndarray:
    """Return ∇V(q), n real numbers; a number of another length is told as soon as the scene is made."""
    return np.array(scene.dV(tuple(q.tolist())), dtype=float)


def _rows(scene: Mechanical, q: np.ndarray) -> np.ndarray:
    """Return the Hessian at q, n rows of n real numbers."""
    assert scene.hessian is not None
    n, rows = len(q), scene.hessian(tuple(q.tolist()), **scene.parameters)
    try:
        array = np.array([list(row) for row in rows])
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (n, n) or array.dtype.kind not in "fiub":
        raise BadInput(
            f"scene {scene.name!r}: its Hessian is {excerpt(rows)}: must be {n} rows of {n} real numbers"
        )
    return array.astype(float)


def _gradient(scene: Mechanical, q: np.ndarray, direction: np.ndarray, size: np.ndarray) -> None:
    def potential(q: np.ndarray) -> np.ndarray:
        return np.array([_number(scene, q)])

    given = _force(scene, q)
    if _agree(
        potential, q, direction, np.array([given @ direction]), float(np.abs(given) @ np.abs(direction))
    ):
        return
    found = [difference(potential, q, unit)[0][0] / unit[i] for i, unit in enumerate(np.diag(size))]
    i = int(np.argmax(np.abs(found - given) * size))
    raise BadInput(
        f"scene {scene.name!r}: its gradient is not the potential's: component {i + 1} is {given[i]:.6g} at "
        f"q = {_at(q)}, the derivative of the potential there {found[i]:.6g}"
    )


def _has_formulas(scene: Mechanical) -> bool:
    """Return whether potential and gradient are formulas, and those that a kind of a user's own goes by."""
    both = isinstance(scene.potential, Formula) and isinstance(scene.gradient, Formula)
    return both and is_ours(type(scene))


def _follows(scene: Mechanical) -> bool:
    """Return whether the Hessian was derived from the gradient."""
    return isinstance(scene.hessian, Formula) and scene.hessian.live is None


def _hessian(scene: Mechanical, q: np.ndarray, direction: np.ndarray, size: np.ndarray) -> None:
    def gradient(q: np.ndarray) -> np.ndarray:
        return _force(scene, q)

    given = _rows(scene, q)
    if _agree(gradient, q, direction, given @ direction, float((np.abs(given) @ np.abs(direction)).max())):
        return
    found = np.array([difference(gradient, q, unit)[0] / unit[j] for j, unit in enumerate(np.diag(size))]).T
    i, j = np.unravel_index(np.argmax(np.abs(found - given) * size), given.shape)
    raise BadInput(
        f"scene {scene.name!r}: its Hessian is not the gradient's derivative: entry ({i + 1}, {j + 1}) is "
        f"{given[i, j]:.6g} at q = {_at(q)}, the derivative of the gradient there {found[i, j]:.6g}"
    )


def _symmetry(scene: Mechanical, places: Iterable[np.ndarray]) -> None:
    """Raise `BadInput` unless V(Rq) = V(q), so that ∇V is along q, at each place."""
    found = []
    for q in places:
        with _within_the_domain():
            force, size = _force(scene, q), float(np.linalg.norm(q))
            across = force - q * (q @ force) / size**2
            found.append((float(np.linalg.norm(across)) * size, float(np.linalg.norm(force)) * size, q))
    largest = max((terms for _, terms, _ in found if isfinite(terms)), default=0.0)
    for torque, terms, q in found:
        if torque > TOLERANCE * (terms + 1e-3 * largest):  # at an equilibrium a force is rounding
            raise BadInput(
                f"scene {scene.name!r}: rotation_invariant = True, but the potential exerts a torque, "
                f"‖q × ∇V‖ = {torque:.6g} at q = {_at(q)}"
            )


def _damping(scene: Mechanical, y: np.ndarray) -> None:
    """Raise `BadInput` unless the parts of a damping that is the user's fit each other at a packed state."""
    h = LATER * scene.t_end
    if isinstance(scene, GeneralDamping):
        s, flow = float(y[-1]), scene.damping_flow
        there = f"at s = {s:.6g}, the derivative of the damping there"
        _slope(
            scene, scene.damping, s, 1.0, scene.damping_slope(s), "damping_slope is not the damping's", there
        )
        if flow is not None:
            end = flow(s, h, math)
            _begins(
                scene, "damping_flow", lambda h: flow(s, h, math), s, h, -scene.damping(end), f"s = {s:.6g}"
            )
    if isinstance(scene, Driven) and scene.span is not None:
        t, there = float(y[scene.clock]), f"t = {y[scene.clock]:.6g}"
        total, _ = scene.spent(t, h, math)
        _begins(scene, "span[0]", lambda h: scene.spent(t, h, math)[0], 0.0, h, scene.rate_at(t + h), there)
        _begins(scene, "span[1]", lambda h: scene.spent(t, h, math)[1], 0.0, h, math.exp(-total), there)


def _begins(
    scene: Mechanical, name: str, f: Callable[[float], Any], start: float, h: float, slope: float, where: str
) -> None:
    """Raise `BadInput` unless a function of h begins with `start` and has a slope at h."""
    if abs(f(0.0) - start) > TOLERANCE * max(abs(start), abs(f(h))):
        raise BadInput(f"scene {scene.name!r}: {name} is {f(0.0):.6g} at {where}, h = 0: must be {start:.6g}")
    there = f"at {where}, h = {h:.6g}, the derivative by h of the function"
    _slope(scene, f, h, h / 2, slope, f"{name} has not the slope of its definition", there)


def _slope(
    scene: Mechanical, f: Callable[[float], Any], x: float, size: float, given: float, says: str, where: str
) -> None:
    """Raise `BadInput` unless `given` is the derivative of f at x, by differences of up to `size`."""

    def along(x: np.ndarray) -> np.ndarray:
        return np.array([f(float(x[0]))], dtype=float)

    here, unit = np.array([x]), np.array([size])
    if not _agree(along, here, unit, np.array([given * size]), abs(given * size)):
        found = difference(along, here, unit)[0][0] / size
        raise BadInput(f"scene {scene.name!r}: {says}: {given:.6g} {where} {found:.6g}")


def _agree(
    f: Callable[[np.ndarray], np.ndarray],
    q: np.ndarray,
    direction: np.ndarray,
    given: np.ndarray,
    terms: float,
) -> bool:
    """Return whether `given` is the derivative of f along a direction, or differences cannot tell."""
    found, error = difference(f, q, direction)
    if not (np.isfinite(given).all() and np.isfinite(found).all()):
        raise FloatingPointError
    off = float(np.abs(found - given).max())
    scale = max(terms, float(np.abs(found).max()))
    return off <= TOLERANCE * scale + SAFETY * error or error > UNSURE * scale


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


def _at(q: np.ndarray) -> str:
    return f"({', '.join(f'{x:.6g}' for x in q[:4])}{', …' if len(q) > 4 else ''})"
