"""The data of the paper's figures, corrected where the claim behind them fell.

Every function yields rows ``(panel, curve, kind, x, y, z)``, z nan in the plane; `FIGURES` maps a
figure to its function.  `kind` says what a curve or point is: truth, law, method, stable, ….
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Iterator

import numpy as np

from contactbench.paper.integrator import ENERGY_LADDER, NOMINAL, PAPER_STEP, energy_errors, numerical, slope
from contactbench.paper.rigid_body import (
    INERTIA,
    beside_axis,
    criterion,
    direction_growths,
    growths,
    momentum_rate,
)
from contactbench.scenes import SCENES
from contactbench.truth import reference

type Numbers = Iterable[float]
type Point = tuple[str, str, str, float, float, float]
FLAT = itertools.repeat(math.nan)


def rows(name: str) -> Iterator[dict[str, object]]:
    count: Counter[tuple[str, str]] = Counter()
    for panel, curve, kind, x, y, z in FIGURES[name]():
        place = {"point": count[panel, curve], "x": float(x), "y": float(y), "z": float(z)}
        yield {"figure": name, "panel": panel, "curve": curve, "kind": kind, **place}
        count[panel, curve] += 1


def curve(panel: str, name: str, kind: str, x: Numbers, y: Numbers, z: Numbers = FLAT) -> Iterator[Point]:
    for point in zip(x, y, z, strict=False):
        yield (panel, name, kind, *point)


def paper_2() -> Iterator[Point]:
    """Yield the phase portrait of the oscillator: closed orbits at λ = 0, spirals for λ > 0."""
    orbit, spiral = np.linspace(0, 2 * math.pi, 61), np.linspace(0, 25.0, 126)
    closed, open_ = (0.0, "conservative", orbit), (0.2, "dissipative", spiral)
    for q0, (gamma, kind, t) in ((0.5, closed), (1.0, closed), (1.5, closed), (1.5, open_)):
        truth = reference(SCENES["oscillator"].with_(gamma=gamma, q=(q0,)), t, ()).states()
        yield from curve("phase", f"λ = {gamma:g}, q(0) = {q0:g}", kind, truth.q[0], truth.p[0])


def paper_3() -> Iterator[Point]:
    """Yield the momentum map of a rotation-invariant force along time, measured and by the law."""
    for gamma in (0.0, 0.05, 0.1, 0.2, 0.4):
        scene = SCENES["central"].with_(gamma=gamma)
        run = numerical(scene, "contact-strang", 0.1, 20)
        J = scene.momentum_at(run.states())[0]
        fine = np.linspace(0, scene.t_end, 21)
        yield from curve("decay", f"λ = {gamma:g}", "law", fine, np.exp(-gamma * fine))
        yield from curve("decay", f"λ = {gamma:g}, contact-strang", "method", run.t, J / J[0])


def paper_4() -> Iterator[Point]:
    """Yield trajectories of the damped body in momentum space, from near each principal axis."""
    for axis in range(3):
        scene = SCENES["rigid_body"].with_(gamma=0.03, M=tuple(beside_axis(axis)), t_end=100.0)
        path = numerical(scene, "contact-abc", 0.05, 125).y
        yield from curve("momentum", f"near axis {axis + 1}", "stable" if axis != 1 else "unstable", *path.T)


def paper_5() -> Iterator[Point]:
    """Yield directions of the momentum: the flow of M/‖M‖, and its six equilibria with their stability."""
    scene = SCENES["rigid_body"]
    of_direction = direction_growths(scene)
    for axis, sign in itertools.product(range(3), (1.0, -1.0)):
        e, rate = sign * np.eye(3)[axis], of_direction[axis]  # the same for e and −e: γ is isotropic
        kind, name = "unstable" if rate > 1e-9 else "stable", f"axis {'+' if sign > 0 else '-'}{axis + 1}"
        residual = float(np.linalg.norm(momentum_rate(scene)(e)))
        yield ("sphere", name, kind, *e)
        yield ("rate", name, kind, axis + 1, residual, rate)
    # from the axis towards axis 2
    for axis, sign, angle in itertools.product((0, 2), (1.0, -1.0), (0.25, 0.5, 0.7)):
        M = np.zeros(3)
        M[axis], M[1] = sign * math.cos(angle), math.sin(angle)
        path = numerical(scene.with_(gamma=0.0, M=tuple(M), t_end=60.0), "contact-abc", 0.1, 100).y
        turns = np.unwrap(np.arctan2(path[:, 1], path[:, 2 - axis]))
        once = int(np.argmax(np.abs(turns - turns[0]) > 2 * math.pi)) or len(path)
        name = f"about {sign:+.0f}·e{axis + 1}, {angle:g} rad"
        yield from curve("sphere", name, "flow", *path[: once + 1].T)


def paper_7() -> Iterator[Point]:
    """Yield, left, H0 along time at h = 0.01.  Right, the error of H0 against the step, with fitted orders."""
    scene = SCENES["particle"]
    t = np.linspace(0, scene.t_end, 101)
    truth = scene.energy(reference(scene, t, ()).states())
    law = lambda t: truth[0] * np.exp(-scene.gamma * t)  # noqa: E731
    yield from curve("energy", "true H0", "truth", t, truth)
    yield from curve("energy", "H0(0) e^{-γt}", "law", t, law(t))
    yield from curve("ratio", "true H0", "truth", t, truth / law(t) - 1)
    for name in ("contact-printed", "rk4"):
        run = numerical(scene, name, PAPER_STEP, 50)
        energy = scene.energy(run.states())
        yield from curve("energy", name, "method", run.t, energy)
        yield from curve("ratio", name, "method", run.t, energy / law(run.t) - 1)
    for name in NOMINAL:
        errors = energy_errors(name, scene, (4, 8, *ENERGY_LADDER))
        order = itertools.repeat(slope(errors))
        yield from curve("convergence", name, "method", errors.keys(), errors.values(), order)


def paper_8() -> Iterator[Point]:
    """Yield the splitting integrator at γ = 0 and γ > 0: phase portrait and energy."""
    for gamma, kind in ((0.0, "conservative"), (0.1, "dissipative")):
        scene = SCENES["particle"].with_(gamma=gamma, t_end=60.0)
        run = numerical(scene, "contact-printed", PAPER_STEP, 240)
        t, energy = run.t[::2], scene.energy(run.states())[::2]
        label = f"γ = {gamma:g}"
        yield from curve("phase", label, kind, run.y[:, 0], run.y[:, 2])
        yield from curve("energy", label, kind, t, energy)
        if gamma == 0:
            yield from curve("bounded", label, kind, t, energy / energy[0] - 1)


def paper_stability() -> Iterator[Point]:
    """Yield the growth rate at M* = e_i in ker D over two slices of D ≥ 0, and the border det = 0 of `criterion`."""
    a, unit, zero = 1 / np.asarray(INERTIA), np.eye(3), 1e-12  # round-off of the eigenvalues
    for axis, reach in enumerate((3.0, 1.0, 1.0)):  # far enough for a full D to destabilise the outer two
        e = unit[axis]
        j, k = sorted({0, 1, 2} - {axis})
        sides = np.linspace(0, 0.6, 11)
        pairs = [(x, y, np.diag(x * unit[j] + y * unit[k])) for x in sides for y in sides]
        off = np.outer(unit[j], unit[k])
        beside = [
            (d, c, np.diag(d * (1 - e)) + np.clip(c, -d, d) * (off + off.T))
            for d in np.linspace(0, reach, 13)
            for c in np.linspace(-reach, reach, 25)
            if abs(c) <= d * (1 + 1e-12)
        ]
        for panel, grid in ((f"axis {axis + 1}, diagonal", pairs), (f"axis {axis + 1}, full", beside)):
            rates = growths([(D, INERTIA, e) for _, _, D in grid])
            for (x, y, _), rate in zip(grid, rates, strict=True):
                kind = "unstable" if rate > zero else "stable" if rate < -zero else "neutral"
                yield (panel, "growth rate", kind, x, y, rate)
        d = np.linspace(0, reach, 61)
        j, k = (axis + 1) % 3, (axis + 2) % 3
        linear, constant = a[j] - a[k], d**2 + (a[axis] - a[j]) * (a[axis] - a[k])
        root = np.sqrt(linear**2 / 4 + constant)
        for name, c in (("lower", linear / 2 - root), ("upper", linear / 2 + root)):
            inside = np.abs(c) <= d
            yield from curve(f"axis {axis + 1}, full", f"det = 0, {name}", "criterion", d[inside], c[inside])
    ab = -criterion(np.zeros((3, 3)), unit[1])[1]  # det = d₁d₃ − ab there
    d = np.linspace(ab / 0.6, 0.6, 31)
    yield from curve("axis 2, diagonal", "det = 0", "criterion", d, ab / d)


DRAWN = paper_2, paper_3, paper_4, paper_5, paper_7, paper_8, paper_stability
FIGURES = {draw.__name__: draw for draw in DRAWN}
