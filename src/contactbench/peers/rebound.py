"""REBOUND's IAS15: Gauss–Radau of order 15, adaptive, iterated to round-off.

Rein, Spiegel, Mon. Not. R. Astron. Soc. 446, 1424 (2015), doi:10.1093/mnras/stu2164; the choice of steps: Pham, Rein,
Spiegel, Open J. Astrophys. 7 (2024), doi:10.21105/astro.2401.02849.

It integrates second-order equations of particles in space: coordinates of a scene are taken three to a particle, the
action is the velocity of one more, gravity is off, and the whole force, drag included, is an additional one, compiled.
"""

from __future__ import annotations

from ctypes import addressof, c_void_p, cast
from types import ModuleType
from typing import Any

import numpy as np

from contactbench.methods.base import METHODS, ROUNDING, unfit
from contactbench.peers.base import Peer
from contactbench.peers.compiled import SUCCESS, TOO_MANY_STEPS, Compiled
from contactbench.scene import Mechanical, State
from contactbench.scene.many import Many
from contactbench.solution import Counts, Status

#: steps between two looks at signals
PIECE = 1000
#: epsilon of IAS15 is a power of rtol: steps grow as its 7th root, and errors as their 15th power
POWER = 7 / 15


class Ias15(Compiled):
    first_order = False

    def connect(self, clock: int) -> tuple[ModuleType, tuple[Any, ...]]:
        import rebound

        from contactbench.peers.abi import rebound as abi

        r, scene = self.request, self.scene
        size, n = len(self.split_clock(r.start)[1]), scene.motion // 2
        unit = scene.velocity(tuple(1.0 + 0 * c for c in scene.initial(()).p))
        over_m = np.array(scene.pack(State(unit, unit)), dtype=float)[:n]
        self.y, self.dy, self.name = np.zeros(size), np.zeros(size), np.frombuffer(b"ias15\0", np.uint8)
        addresses = [each.ctypes.data for each in (self.data, self.y, self.dy, over_m)]
        self.user = np.array([self.functions.rhs, *addresses, n, size], dtype=np.intp)
        self.simulation = simulation = rebound.Simulation()
        for _ in range(-(-(size - n) // 3)):
            simulation.add(m=0.0)
        simulation.gravity, simulation.save_messages = "none", 1
        simulation.force_is_velocity_dependent, simulation.extras = 1, self.user.ctypes.data
        simulation._additional_forces = cast(abi.forces.address, type(simulation._additional_forces))
        fields = simulation.integrator.callbacks.field_descriptor_list
        offset = fields.field_descriptor_for_name("epsilon").offset
        settings = self.name.ctypes.data, offset, r.rtol**POWER
        place = self.y, self.data, over_m, clock
        return abi, (addressof(simulation), settings, place, self.end, r.max_steps)

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
        return (Status.budget, self.spent) if flag == TOO_MANY_STEPS else (Status.failed, "its time stands still")


class SecondOrder(Peer):
    """A solver of second-order equations, whose step follows the size of the force."""

    def refuses(self, scene: Any) -> str | None:
        if (why := super().refuses(scene)) is not None or isinstance(scene, Many):
            return why
        if (why := unfit(self, scene, isinstance(scene, Mechanical), "q' = p/m")) is not None:
            return why
        if len(scene.q) == 1:
            return f"{self.name} takes steps as short as its force is small, and a single one passes through 0"
        return None


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
