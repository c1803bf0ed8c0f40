"""Compiled code between REBOUND's C library and a scene: forces as REBOUND's additional ones, and loops of steps.

What is read and written of REBOUND's structures lies where the classes of its Python package say.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from ctypes import c_void_p, cast, sizeof
from typing import Any

import numpy as np
import rebound
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from rebound.particle import Particle
from rebound.simulation import Simulation

from contactbench.peers.abi import external, join, kept, kept_c, split
from contactbench.peers.abi.cvode import call
from contactbench.peers.compiled import KNOWN, RHS_CALLS, SUCCESS, TOO_MANY_STEPS

#: offsets of fields in a simulation and in a particle, and the size of a particle, in units of 8 bytes; CHANGED of 4
TIME, STEP, STEP_DONE, NUMBER, PARTICLES, EXTRAS = (
    getattr(Simulation, name).offset // 8 for name in ("t", "dt", "dt_last_done", "N", "_particles", "extras")
)
CHANGED = Simulation.did_modify_particles.offset // 4
VELOCITY, FORCE, WIDTH = Particle.vx.offset // 8, Particle.ax.offset // 8, sizeof(Particle) // 8
#: a step that ends this near to a time, relative to it, ends there
NEAR = 1e-12
#: the first step, as a fraction of the time in which the state changes by its own size; each later one grows at
#: most fourfold
FIRST = 1e-3
#: the flag of a run whose steps no longer advance the time
STUCK = 0


def pointer_to(kind: types.Type, width: ir.Type) -> Callable[..., Any]:
    @intrinsic
    def view(typing: object, address: object) -> tuple[object, object]:
        def generate(
            context: object, builder: ir.IRBuilder, signature: object, arguments: Sequence[ir.Value]
        ) -> ir.Value:
            return builder.inttoptr(arguments[0], ir.PointerType(width))

        return types.CPointer(kind)(types.intp), generate

    return view


doubles = pointer_to(types.float64, ir.DoubleType())
integers = pointer_to(types.intp, ir.IntType(64))
flags = pointer_to(types.int32, ir.IntType(32))


def function(name: str, word: str) -> Callable[..., Any]:
    address = cast(getattr(rebound.clibrebound, name), c_void_p).value
    return external(f"contactbench_{name}", address, word)


steps, set_integrator = (
    function("reb_simulation_steps", "vpz"),
    function("reb_simulation_set_integrator", "ppp"),
)


def simulation(integrator: str, masses: np.ndarray, force: Any, extras: np.ndarray, G: float) -> Simulation:
    """Return a simulation of so many particles with a force that depends on velocities; extras : what it reads."""
    made = rebound.Simulation()
    for mass in masses:
        made.add(m=mass)
    made.integrator, made.G, made.save_messages = integrator, G, 1
    made.force_is_velocity_dependent, made.extras = 1, extras.ctypes.data
    made._additional_forces = cast(force.address, type(made._additional_forces))
    return made


# -- any equations of second order: momenta three to a particle as velocities, and the action as one more
@kept
def gather(p, y, over_m, n, size):  # type: ignore[no-untyped-def]
    for i in range(size - n):
        at = WIDTH * (i // 3) + i % 3
        if i < n:
            y[i] = p[at] * over_m[i]
        y[n + i] = p[at + VELOCITY]


@kept_c(types.void(types.intp))
def forces(simulation):  # type: ignore[no-untyped-def]
    user, p = integers(integers(simulation)[EXTRAS]), doubles(integers(simulation)[PARTICLES])
    n, size = user[5], user[6]
    gather(p, doubles(user[2]), doubles(user[4]), n, size)
    call(user[0], user[3], doubles(simulation)[TIME], user[2], user[1])
    for i in range(size - n):
        p[WIDTH * (i // 3) + i % 3 + FORCE] = doubles(user[3])[n + i]


@kept
def begin(start, simulation, settings, place):  # type: ignore[no-untyped-def]
    """A packed state at time 0; settings : the name of the integrator, where its tolerance is, and this."""
    (name, offset, epsilon), (y, data, over_m, clock), n = settings, place, len(place[2])
    user, now, p = (
        integers(integers(simulation)[EXTRAS]),
        doubles(simulation),
        integers(simulation)[PARTICLES],
    )
    split(start, y, data, clock)
    data[RHS_CALLS] = size = change = 0.0
    call(user[0], user[3], 0.0, user[2], user[1])
    for i in range(len(y)):
        size, change = size + y[i] * y[i], change + doubles(user[3])[i] ** 2
    doubles(set_integrator(simulation, name) + offset)[0] = epsilon
    scale = math.sqrt(size / change) if size > 0 and change > 0 else 1.0
    now[TIME], now[STEP], now[STEP_DONE] = 0.0, FIRST * scale, 0.0
    for i in range(len(y) - n):
        at = WIDTH * (i // 3) + i % 3
        doubles(p)[at], doubles(p)[at + VELOCITY] = y[i] / over_m[i] if i < n else 0.0, y[n + i]


@kept
def on(times, saved, out, simulation, place, most):  # type: ignore[no-untyped-def]
    """At most so many more steps, each saved time the end of one; `FACTS` and the state reached."""
    y, data, over_m, clock = place
    now, flag, taken = doubles(simulation), TOO_MANY_STEPS, 0
    while taken < most and saved < len(times):
        before, full = now[TIME], now[STEP]
        now[STEP] = min(full, times[saved] - before)
        steps(simulation, 1)
        taken += 1
        gather(doubles(integers(simulation)[PARTICLES]), y, over_m, len(over_m), len(y))
        if not (now[TIME] > before and np.isfinite(y).all()):
            flag, now[TIME] = STUCK, before
            break
        if abs(now[TIME] - times[saved]) <= NEAR * times[saved]:
            join(y, times[saved], data, clock, out[saved])
            now[STEP], saved = max(full, now[STEP]), saved + 1
    facts = np.empty(KNOWN + out.shape[1])
    facts[0], facts[1], facts[2], facts[3] = SUCCESS if saved == len(times) else flag, now[TIME], saved, taken
    facts[4], facts[5], facts[6] = data[RHS_CALLS], 0.0, 0.0
    join(y, now[TIME], data, clock, facts[KNOWN:])
    return facts


@kept
def to_end(start, simulation, settings, place, end, most):  # type: ignore[no-untyped-def]
    begin(start, simulation, settings, place)
    return on(np.full(1, end), 0, np.empty((1, len(start))), simulation, place, most)


# -- bodies about a heavy one, drag as an additional force
#: of an orbit's own numbers: γ, K, whether the action is carried, its integral, centre of mass and its velocity, and
#: from OWN on the weights of bodies in V = −K Σ w_a w_b/r
GAMMA, K, ACTION, INTEGRAL, CENTRE, DRIFT, OWN = 0, 1, 2, 3, 4, 7, 10


@kept_c(types.void(types.intp))
def drag(simulation):  # type: ignore[no-untyped-def]
    """Make a kick by h end in velocities times e^{−γh}; the integral of e^{γt}(q·∇V/2 − V) goes by midpoints."""
    now, p = doubles(simulation), doubles(integers(simulation)[PARTICLES])
    own, h, total = doubles(integers(simulation)[EXTRAS]), now[STEP], 0.0
    rate = math.expm1(-own[GAMMA] * h) / h
    for i in range(integers(simulation)[NUMBER]):
        a = WIDTH * i
        for j in range(3):
            p[a + FORCE + j] += rate * p[a + VELOCITY + j]
        for k in range(i if own[ACTION] > 0 else 0):
            b = WIDTH * k
            x, y, z = p[a] - p[b], p[a + 1] - p[b + 1], p[a + 2] - p[b + 2]
            total += own[OWN + i] * own[OWN + k] / math.sqrt(x * x + y * y + z * z)
    own[INTEGRAL] += 1.5 * own[K] * total * h * math.exp(own[GAMMA] * now[TIME])


@kept
def advance(state, h, steps_, simulation, own, order, over_m, masses) -> np.ndarray:  # type: ignore[no-untyped-def]
    """From a packed state to another, about the centre of mass, which REBOUND leaves without drag."""
    now, p, gamma, action = (
        doubles(simulation),
        doubles(integers(simulation)[PARTICLES]),
        own[GAMMA],
        own[ACTION] > 0,
    )
    n, d, product, end = len(over_m), len(over_m) // len(order), 0.0, np.empty(len(state))
    for i in range(len(masses)):
        for j in range(6):
            p[WIDTH * i + j] = 0.0
    for i in range(n):
        at = WIDTH * order[i // d] + i % d
        p[at], p[at + VELOCITY] = state[i], state[n + i] * over_m[i]
        product += state[i] * state[n + i]
    for j in range(6):
        own[CENTRE + j] = 0.0
        for i in range(len(masses)):
            own[CENTRE + j] += masses[i] / masses.sum() * p[WIDTH * i + j]
        for i in range(len(masses)):
            p[WIDTH * i + j] -= own[CENTRE + j]
    own[INTEGRAL] = state[-1] - product / 2 if action else 0.0
    now[TIME], now[STEP], flags(simulation)[CHANGED] = 0.0, h, 1
    steps(simulation, steps_)
    t, product = now[TIME], 0.0
    decay, span = math.exp(-gamma * t), -math.expm1(-gamma * t) / gamma if gamma != 0 else t
    for i in range(n):
        at, j = WIDTH * order[i // d] + i % d, i % d
        end[i] = p[at] + own[CENTRE + j] + span * own[DRIFT + j]
        end[n + i] = (p[at + VELOCITY] + decay * own[DRIFT + j]) / over_m[i]
        product += end[i] * end[n + i]
    if action:
        end[-1] = decay * own[INTEGRAL] + product / 2
    return end
