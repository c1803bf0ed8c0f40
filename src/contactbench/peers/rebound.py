"""REBOUND's WHFast, for orbits, and IAS15, Gauss–Radau of order 15, adaptive and iterated to round-off.

WHFast alternates Kepler orbits about the heaviest body with kicks by the other attractions; drag is an additional
force, −(1 − e^{−γh})/h v, by which a kick ends in velocities times e^{−γh}.  It leaves the centre of mass without
additional forces: the orbits are taken about it, and its own motion is known.  The action follows by midpoints.

IAS15 integrates second-order equations of particles in space: momenta of a scene are taken three to a particle as its
velocities, the action is one more, gravity is off, and the whole force, drag included, is an additional one.

Rein, Tamayo, Mon. Not. R. Astron. Soc. 452, 376 (2015), doi:10.1093/mnras/stv1257; Rein, Spiegel, ibid. 446, 1424
(2015), doi:10.1093/mnras/stu2164, with the steps of Pham, Rein, Spiegel, Open J. Astrophys. 7 (2024),
doi:10.21105/astro.2401.02849.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from ctypes import addressof
from typing import Any, cast

import numpy as np

from contactbench.methods.base import METHODS, ROUNDING, unfit
from contactbench.methods.prepared import NO_NUMBER, Request
from contactbench.peers.base import Peer
from contactbench.peers.by_numba import entry
from contactbench.peers.compiled import SUCCESS, TOO_MANY_STEPS, Compiled, Connection
from contactbench.peers.stepping import LibrarySteps, Stepper
from contactbench.scene import Mechanical, Scene, State, norm
from contactbench.scene.many import Many, Particles
from contactbench.solution import Counts, Status

#: of all masses so much at least is one body's
DOMINANT = 0.9
#: squares of distances with masses, and places, at which a potential is tried
PAIRS = ((1.0, 1.0, 1.0), (2.25, 0.7, 1.9), (0.16, 3.0, 0.2))
PLACES = ((0.3, -1.1, 0.7), (2.0, 0.4, -0.9), (-0.5, 0.2, 0.1))
#: steps of IAS15 between two looks at signals
PIECE = 1000
#: its epsilon is this power of rtol: steps grow as its 7th root, and errors as their 15th power
POWER = 7 / 15


class Orbits(LibrarySteps):
    """Take the steps of WHFast."""

    def __init__(self, method: Stepper, request: Request) -> None:
        from contactbench.peers.abi import rebound as abi

        super().__init__(method, request)
        found = attraction(self.scene)
        assert found is not None
        K, masses, weights, inertia = found
        first = int(np.argmax(masses))
        bodies = np.array([first, *np.delete(np.arange(len(masses)), first)])
        order = np.argsort(bodies)[len(masses) - len(inertia) :]
        over_m = np.repeat(1 / inertia, self.scene.motion // 2 // len(inertia))
        own = np.array([self.scene.gamma, K, "s" in self.carry, *[0.0] * 7, *weights[bodies]])
        self.simulation = abi.simulation("whfast", masses[bodies], abi.drag, own, K)
        self.simulation.integrator.safe_mode = 0
        self.place = addressof(self.simulation), own, order, over_m, masses[bodies]
        self.abi = abi

    def advance(self, y: np.ndarray, h: float, n: int) -> np.ndarray:
        return self.abi.advance(y, h, n, *self.place)

    def last(self, ready: list[tuple[float, int]]) -> Callable[[np.ndarray], np.ndarray]:
        if len(ready) > 1:
            return super().last(ready)
        rest = (*ready[0], *self.place)
        advance = entry(self.abi.advance, np.empty(len(self.scene.labels(self.carry))), *rest)
        # addresses are good as long as this object lives
        return lambda y0, owner=self: advance(y0, *rest)  # type: ignore[misc]


def attraction(scene: Any) -> tuple[float, np.ndarray, np.ndarray, np.ndarray] | None:
    """K, masses for REBOUND, weights w of V = −K Σ w_a w_b/r, and masses of the scene's bodies; None: another V.

    A centre that attracts is a body that nothing moves, the first.
    """
    with suppress(*NO_NUMBER):
        if isinstance(scene, Particles) and scene.dimensions > 1:
            found = [-scene.call("pair", r2, a, b) * r2**0.5 / (a * b) for r2, a, b in PAIRS]
            masses = np.array(scene.masses)
            numbers = masses, masses, masses
        elif scene.kind == "mechanical" and len(scene.q) in (2, 3) and isinstance(scene.mass, float):
            found = [-scene.V(q) * norm(q) for q in (place[: len(scene.q)] for place in PLACES)]
            numbers = np.array([1 / scene.mass, 0.0]), np.ones(2), np.array([scene.mass])
        else:
            return None
        if found[0] > 0 and np.allclose(found, found[0], rtol=1e-12, atol=0):
            return (found[0], *numbers)
    return None


class WisdomHolman(Stepper):
    def unfit(self, scene: Scene) -> str | None:
        found = attraction(scene)
        if found is None or scene.nonlinear_damping:
            needs = (
                "bodies that attract each other, or a centre that does, V = −K m_a m_b/r, and damping Γ = γ s"
            )
            return f"{self.name} needs {needs}, which scene {scene.name!r} does not have"
        if found[1].max() < DOMINANT * found[1].sum():
            return f"{self.name} needs a body of nine tenths of all masses; scene {scene.name!r} has none"
        return scene.own_equations


class Ias15(Compiled):
    first_order = False

    def connect(self, clock: int) -> Connection:
        from contactbench.peers.abi import rebound as abi

        r, scene = self.request, cast("Mechanical | Many", self.scene)
        assert r.rtol is not None
        size, n = len(self.split_clock(r.start)[1]), scene.motion // 2
        unit = scene.velocity(tuple(1.0 + 0 * c for c in scene.initial(()).p))
        over_m = np.array(scene.pack(State(unit, unit)), dtype=float)[:n]
        self.y, self.dy, self.name = np.zeros(size), np.zeros(size), np.frombuffer(b"ias15\0", np.uint8)
        addresses = [each.ctypes.data for each in (self.data, self.y, self.dy, over_m)]
        self.user = np.array([self.functions.rhs, *addresses, n, size], dtype=np.intp)
        particles = np.zeros(-(-(size - n) // 3))
        self.simulation = abi.simulation("ias15", particles, abi.forces, self.user, 0.0)
        self.simulation.gravity = "none"
        fields = self.simulation.integrator.callbacks.field_descriptor_list
        offset = fields.field_descriptor_for_name("epsilon").offset
        settings, place = (self.name.ctypes.data, offset, r.rtol**POWER), (self.y, self.data, over_m, clock)
        return abi, (addressof(self.simulation), settings, place, self.end, r.max_steps)

    def run(self, y0: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """In pieces, of the same steps: between two of them Python looks at signals."""
        simulation, settings, place, _, most = self.arguments
        rows, saved, taken = np.empty((len(self.later), len(y0))), 0, 0
        self.library.begin(y0, simulation, settings, place)
        while True:
            facts = self.library.on(self.later, saved, rows, simulation, place, min(PIECE, most - taken))
            saved, taken = int(facts[2]), taken + int(facts[3])
            if facts[0] != TOO_MANY_STEPS or taken == most:
                facts[3] = taken
                return facts, rows

    def counts(self, steps: int, evaluations: int, jacobians: int, rejected: float) -> Counts:
        return Counts(steps, evaluations, jacobians, None)

    def ending(self, flag: int) -> tuple[Status, str]:
        if flag == SUCCESS:
            return Status.ok, ""
        return (
            (Status.budget, self.spent)
            if flag == TOO_MANY_STEPS
            else (Status.failed, "its time stands still")
        )


class SecondOrder(Peer):
    def refuses(self, scene: Any) -> str | None:
        if (why := super().refuses(scene)) is not None or isinstance(scene, Many):
            return why
        if (why := unfit(self, scene, isinstance(scene, Mechanical), "q' = p/m")) is not None:
            return why
        if len(scene.q) == 1:
            return (
                f"{self.name} takes steps as short as its force is small, and a single one passes through 0"
            )
        return None


METHODS.add(
    WisdomHolman(
        "whfast",
        2,
        "Wisdom–Holman's map by WHFast: Kepler orbits and kicks, drag as an additional force, C",
        *(Orbits, "rebound"),
    )
)
METHODS.add(
    SecondOrder(
        "ias15",
        "Gauss–Radau of order 15, iterated to round-off; its epsilon is rtol^{7/15}, C",
        *(Ias15, ("c",), (ROUNDING, 1e-1)),
        package="rebound",
        takes_atol=False,
        order=15,
    )
)
