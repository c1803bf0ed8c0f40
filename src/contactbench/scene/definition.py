"""Verify that a user's functions are consistent: derivatives, flows, integrals, a symmetry.

Derivatives are compared with differences near the initial data and along the motion.  Dual numbers cannot be used,
since a user's functions may not take them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import isfinite
from time import perf_counter
from typing import Any, NamedTuple, TypeGuard

import numpy as np

from contactbench.blame import is_ours, their_code
from contactbench.checks import is_number
from contactbench.errors import BadInput, excerpt
from contactbench.scene.algebra import State
from contactbench.scene.base import Cache, Scene, key
from contactbench.scene.driven import Driven
from contactbench.scene.general_damping import GeneralDamping
from contactbench.scene.mechanical import Mechanical
from contactbench.trace.formula import Formula

#: number of points near the initial one, and their distance relative to the size of each component
POINTS, SPREAD = 3, 0.1
#: steps of differences relative to that size; the step with the best agreement of two estimates is used
STEPS = (1e-2, 1e-3, 1e-4, 1e-5)
#: a derivative is wrong if its error exceeds TOLERANCE of its terms and SAFETY times the error of differences
TOLERANCE = 1e-6
SAFETY = 8.0
#: differences with a larger relative error decide nothing (a kink, a singularity)
UNSURE = 1e-3

#: flows are not tested for s below this part of its start: it may be round-off of other terms
DECAYED = 1e-3
#: spans over which flows and integrals are tested, relative to the end time
TRIED = (1e-3, 1e-1)

#: evaluations and seconds for following a motion, and number of points on each of its steps
FOLLOWED, FOLLOWED_SECONDS, BETWEEN = 3000, 2.0, 4
#: number of states of a motion at which functions are compared
SOME = 32

_verified: Cache[bool] = Cache(1024)


def verify(scene: Scene) -> None:
    """Raise `BadInput` unless a user's functions are consistent near the start; test each definition once."""
    _once(scene, "near the start", _verify)


def verify_along(scene: Scene) -> None:
    """Raise `BadInput` unless they are consistent along the motion, followed for some thousand evaluations."""
    claims = isinstance(scene, GeneralDamping) or _is_given(getattr(scene, "gradient", None))
    if claims or scene.has_momentum_law:  # else there is nothing to compare
        _once(scene, "along the motion", lambda scene: _check(scene, _motion(scene), _claims))


def verify_at(scene: Scene, y: np.ndarray) -> None:
    """Raise `BadInput` unless they are consistent at packed states (k, d)."""
    if _has_functions(scene):
        with their_code(f"scene {scene.name!r}"), np.errstate(all="ignore"):
            _check(scene, y, _claims)


def _has_functions(scene: Scene) -> TypeGuard[Mechanical]:
    return isinstance(scene, Mechanical) and scene.has_users_functions


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
    """End a comparison without an error where a function is not defined."""
    try:
        yield
    except BadInput:  # a ValueError too
        raise
    except (ArithmeticError, ValueError):
        return


def _verify(scene: Mechanical) -> None:
    """Compare near the start, including the Hessian."""
    carry, n, rng = scene.carry(("s",)), len(scene.q), np.random.default_rng(1)
    start = np.array(scene.pack(scene.initial(carry)))
    _potential(scene, start[:n], _time(scene, start))
    states = np.tile(start, (POINTS, 1))
    states[:, :n] += SPREAD * _size(start[:n]) * rng.uniform(-1, 1, (POINTS, n))
    states[:, -1] += SPREAD * rng.uniform(-1, 1, POINTS)
    _check(scene, states, _claims)
    _check(scene, states, _hessian)


def _motion(scene: Mechanical) -> np.ndarray:
    from scipy.integrate import DOP853

    begin = scene.initial(scene.carry(("s",)))
    start, scales = scene.pack(begin), scene.scales(begin, scene.t_end).tolist()
    atol = 1e-9 * np.array(scene.with_clock(scales, 1.0))
    path = [np.empty((0, len(start)))]
    with _within_the_domain():  # the motion ends there
        solver = DOP853(lambda t, y: _slope(scene, y), 0.0, start, scene.t_end, rtol=1e-6, atol=atol)
        until = perf_counter() + FOLLOWED_SECONDS
        while solver.status == "running" and solver.nfev < FOLLOWED and isfinite(solver.h_abs):
            if perf_counter() > until:
                break
            before = solver.t
            solver.step()
            path.append(solver.dense_output()(np.linspace(before, solver.t, BETWEEN + 1)[1:]).T)
    return np.concatenate(path)


class Claim(NamedTuple):
    """A claim that `given`, (m, n), is the derivative at x of f, a function of (n,) with m values.

    size : of the components of x.  says, of, where : of the message "{says} 1.0 at {where}, {of} there 1.1", whose
    first number is the user's: the given derivative, or if `derived` the derivative of f.
    """

    f: Callable[[np.ndarray], object]
    x: object
    given: object
    size: object
    says: str
    of: str
    where: str
    derived: bool = False


def _check(scene: Mechanical, states: np.ndarray, claims: Callable[..., Iterator[Claim]]) -> None:
    some = states[:: max(1, len(states) // SOME)]
    for y in some:
        with _within_the_domain():
            for claim in claims(scene, y):
                _compare(scene, claim)
    if scene.has_momentum_law:
        _symmetry(scene, some[:, : len(scene.q)])


def _is_given(function: object) -> bool:
    return function is not None and not (isinstance(function, Formula) and function.live is None)


def _time(scene: Mechanical, y: np.ndarray) -> list[float]:
    return [] if scene.clock is None else [float(y[scene.clock])]


def _state(scene: Mechanical, y: np.ndarray) -> State:
    return scene.unpack(y.tolist(), scene.carry(("s",)))


def _slope(scene: Mechanical, y: np.ndarray) -> list[float]:
    return scene.pack(scene.rhs(_state(scene, y)))


def _potential(scene: Mechanical, q: np.ndarray, time: list[float]) -> float:
    value = scene.V(tuple(q.tolist()), *time)
    if not is_number(value):
        there = f"{excerpt(value)} at q = {_at(q)}"
        raise BadInput(f"scene {scene.name!r}: its potential is {there}: must be a number")
    return float(value)


def _force(scene: Mechanical, q: np.ndarray, time: list[float]) -> np.ndarray:
    return np.array(scene.dV(tuple(q.tolist()), *time), dtype=float)


def _claims(scene: Mechanical, y: np.ndarray) -> Iterator[Claim]:
    q, time = y[: len(scene.q)], _time(scene, y)
    if _is_given(scene.gradient):
        says = "its gradient is not the potential's: component {j} is"
        force, potential = [_force(scene, q, time)], lambda q: [_potential(scene, q, time)]
        of = "the derivative of the potential"
        yield Claim(potential, q, force, _size(q), says, of, f"q = {_at(q)}")
    if isinstance(scene, GeneralDamping):
        s, where = float(y[-1]), f"s = {y[-1]:.6g}"
        says = "damping_slope is not the damping's: it is"
        slope = [[scene.damping_slope(s)]]
        of = "the derivative of the damping"
        yield Claim(lambda s: [scene.damping(float(s[0]))], [s], slope, [1.0], says, of, where)
        if scene.damping_flow is not None and abs(s) >= DECAYED * abs(scene.s or 0.0):
            yield from _flow(scene, s)
    if isinstance(scene, Driven) and scene.span is not None:
        yield from _span(scene, time[0])
    if not is_ours(type(scene)) and scene.has_jacobian:
        rows, of = scene.jacobian(_state(scene, y)), "the derivative of the right-hand side"
        says = "its jacobian is wrong: entry ({i}, {j}) is"
        yield Claim(lambda y: _slope(scene, y), y, rows, _size(y), says, of, f"the state {_at(y)}")


def _flow(scene: GeneralDamping, s: float) -> Iterator[Claim]:
    """Yield the claims of a flow of s' = −Γ(s); raise `BadInput` unless it starts at s."""
    flow: Any = scene.damping_flow
    _starts(scene, "damping_flow", flow(s, 0.0, math), s, f"s = {s:.6g}, h = 0")
    for h in (part * scene.t_end for part in TRIED):
        with _within_the_domain():
            says, where = "damping_flow is not the damping's: its slope is", f"s = {s:.6g}, h = {h:.6g}"
            rate = [[-scene.damping(flow(s, h, math))]]
            yield Claim(lambda h: [flow(s, float(h[0]), math)], [h], rate, [h], says, "−Γ(s(h))", where, True)


def _span(scene: Driven, t: float) -> Iterator[Claim]:
    """Yield the claims of the integrals of a rate; raise `BadInput` unless they begin at 0."""
    pair: Any = lambda h: scene.spent(t, float(h), math)  # noqa: E731
    for value, name in zip(pair(0.0), ("G", "φ"), strict=True):
        _starts(scene, f"span's {name}", value, 0.0, f"t = {t:.6g}, h = 0")
    for h in (part * scene.t_end for part in TRIED):
        with _within_the_domain():
            slopes = (scene.rate_at(t + h), "G", "its rate"), (math.exp(-pair(h)[0]), "φ", "e^{−G}")
            where = f"t = {t:.6g}, h = {h:.6g}"
            for k, (slope, name, of) in enumerate(slopes):
                says = f"span is not its rate's: the slope of its {name} is"
                part = lambda h, k=k: [pair(h[0])[k]]  # noqa: E731
                yield Claim(part, [h], [[slope]], [h], says, of, where, True)


def _starts(scene: Scene, what: str, given: float, wanted: float, where: str) -> None:
    if isfinite(given) and abs(given - wanted) > TOLERANCE * max(abs(wanted), abs(given)):
        raise BadInput(f"scene {scene.name!r}: its {what} is {given:.6g} at {where}: must be {wanted:.6g}")


def _hessian(scene: Mechanical, y: np.ndarray) -> Iterator[Claim]:
    """Yield the claim of a Hessian; raise `BadInput` unless it is n rows of n numbers."""
    if scene.hessian is None or not _is_given(scene.hessian):
        return
    n = len(scene.q)
    q, rows = y[:n], scene.hessian(tuple(y[:n].tolist()), **scene.parameters)
    try:
        given = np.array([list(row) for row in rows])
    except (TypeError, ValueError):
        given = np.empty(0)
    if given.shape != (n, n) or given.dtype.kind not in "fiub":
        wanted = f"must be {n} rows of {n} real numbers"
        raise BadInput(f"scene {scene.name!r}: its Hessian is {excerpt(rows)}: {wanted}")
    says = "its Hessian is not the gradient's derivative: entry ({i}, {j}) is"
    of = "the derivative of the gradient"
    yield Claim(lambda q: _force(scene, q, []), q, given, _size(q), says, of, f"q = {_at(q)}")


def _symmetry(scene: Mechanical, places: np.ndarray) -> None:
    """Raise `BadInput` unless the torque, J with ∇V in place of p, vanishes at each place."""
    found = []
    for q in places:
        with _within_the_domain():
            pair = State(tuple(q.tolist()), tuple(_force(scene, q, []).tolist()))
            torque = math.hypot(*scene.momentum(pair) or ())
            found.append((torque, float(scene.momentum_terms(pair)), q))
    largest = max((terms for _, terms, _ in found if isfinite(terms)), default=0.0)
    for torque, terms, q in found:
        if torque > TOLERANCE * (terms + 1e-3 * largest):  # at an equilibrium a force is rounding
            raise BadInput(
                f"scene {scene.name!r}: {scene.symmetry}, but the potential exerts a torque, "
                f"‖q × ∇V‖ = {torque:.6g} at q = {_at(q)}"
            )


def _compare(scene: Mechanical, claim: Claim) -> None:
    f = lambda x: np.array(claim.f(x), dtype=float)  # noqa: E731
    x, given, size = (np.array(part, dtype=float) for part in (claim.x, claim.given, claim.size))
    rng = np.random.default_rng(1)
    direction = size * rng.uniform(0.5, 1, len(x)) * rng.choice([-1, 1], len(x))
    found, error = difference(f, x, direction)
    if not (np.isfinite(given).all() and np.isfinite(found).all()):
        return
    off = np.abs(found - given @ direction).max()
    scale = max((np.abs(given) @ np.abs(direction)).max(), np.abs(found).max())
    if off <= TOLERANCE * scale + SAFETY * error or error > UNSURE * scale:
        return
    true = np.array([difference(f, x, unit)[0] / unit[j] for j, unit in enumerate(np.diag(size))]).T
    i, j = np.unravel_index(np.argmax(np.abs(true - given) * size), given.shape)
    theirs, expected = (true, given) if claim.derived else (given, true)
    raise BadInput(
        f"scene {scene.name!r}: {claim.says.format(i=i + 1, j=j + 1)} {theirs[i, j]:.6g} at {claim.where}, "
        f"{claim.of} there {expected[i, j]:.6g}"
    )


def difference(
    f: Callable[..., np.ndarray], q: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, float]:
    """Return the derivative along a direction by central differences of order 4, and an estimate of its error."""
    best, error = np.full_like(f(q), math.nan), math.inf
    for step in STEPS:
        ends = [(f(q + h * direction), f(q - h * direction)) for h in (step, step / 2)]
        wide, narrow = ((a - b) / (2 * h) for (a, b), h in zip(ends, (step, step / 2), strict=True))
        rounding = 2 * np.finfo(float).eps * max(float(np.abs(x).max()) for pair in ends for x in pair)
        gap = float(np.abs(wide - narrow).max()) + rounding / step
        if gap > error:  # round-off inside f: two estimates of it may agree by chance
            break
        if gap < error:
            best, error = narrow + (narrow - wide) / 3, gap
    return best, error


def _size(q: np.ndarray) -> np.ndarray:
    return np.where(q == 0, np.abs(q).max() or 1.0, np.abs(q))


def _at(q: np.ndarray) -> str:
    return f"({', '.join(f'{x:.6g}' for x in q[:4])}{', …' if len(q) > 4 else ''})"
