"""The step density ρ of `contact-adaptive` (see there) on every kind of number, and its loop as a recorded function."""

from __future__ import annotations

import math
from typing import Any

from contactbench.methods.base import SHORTEST
from contactbench.numbers.dual import Dual, DualNumbers, slope, value
from contactbench.scene import Mechanical, Vector, dot
from contactbench.solution import DIVERGENCE
from contactbench.splitting.composition import Composition, advance
from contactbench.trace.form import Assign, Element, Function, Loop, Operation, Store, Update, While
from contactbench.trace.recording import Block, Recorded, RecordedNumbers, Tape, operand_of

#: the density may fall by this factor in one step, at most: with a tolerance so loose that it would
#: otherwise become negative, symmetry is lost
SLOWEST = 0.25


def squared_curvature(scene: Mechanical, q: Vector, v: Vector) -> Dual:
    """‖∇²V‖²_F at q and its rate of change along v."""
    if scene.hessian is not None:
        rows = scene.hessian(tuple(map(Dual, q, v)), **scene.parameters)
        entries = [entry for row in rows for entry in row]
    else:
        moving, entries = tuple(map(Dual, q, v)), []
        for j in range(len(q)):
            column = scene.dV(tuple(Dual(x, float(i == j)) for i, x in enumerate(moving)))
            entries += [slope(entry) for entry in column]
    total = Dual(0.0, 0.0)
    for entry in entries:
        total = total + entry * entry
    return Dual(value(total), slope(total))


def frequency(scene: Mechanical, x: Any, span: Any) -> tuple[Any, Any]:
    """ω, and d ln ω/dt along the motion."""
    square = scene.inverse_mass * scene.inverse_mass
    curvature = squared_curvature(scene, x.q, tuple(p * scene.inverse_mass for p in x.p))
    damping = scene.gamma * scene.gamma / 64
    fourth = curvature.a * square + damping * damping + 1 / (span * span * span * span)
    return fourth**0.25, curvature.b * square / (4 * fourth)


def first_density(scene: Mechanical, x: Any, epsilon: Any, span: Any, largest: Any) -> Any:
    """ρ of the first step."""
    omega, growth = frequency(scene, x, span)
    return largest(omega + epsilon * growth / 2, SLOWEST * omega)


def next_density(scene: Mechanical, x: Any, density: Any, epsilon: Any, span: Any, largest: Any) -> Any:
    """ρ of the step after x."""
    return largest(density + epsilon * frequency(scene, x, span)[1], SLOWEST * density)


def record_loop(
    composition: Composition, scene: Mechanical, carry: tuple[str, ...], tangent: bool, moving: bool = False
) -> Function:
    """``run(start, numbers, options, times, y, facts)``, the loop over steps and saved times.

    options : ε, the span, the budget of steps.  y : states at the saved times, NaN where not reached.
    facts : time, density and steps at the end of the sequence, and the state there.
    tangent : the state is followed by a tangent, which is carried along with the steps as they are; moving : and
    through their choice, by the tangents of time and density.
    """
    tape, d = Tape(), len(scene.labels(carry))
    outer = tape.root
    interval = Block(outer)
    inner = Block(interval)
    after = Block(inner)
    size = d * (1 + tangent)
    states = tuple(f"x{i}" for i in range(size))
    twin: Any = scene.with_numbers(
        [tape.assign(Element("numbers", (i,)), "f", outer) for i in range(len(scene.numbers()))]
    )
    epsilon, span, budget = (tape.assign(Element("options", (i,)), "f", outer) for i in range(3))
    xp: Any = RecordedNumbers(tape)
    largest = DualNumbers(xp).maximum if moving else xp.maximum

    def variable(name: str, block: Block) -> Any:
        """A number of the loop, with its tangent where it has one."""
        plain = Recorded(tape, name, "f", block)
        return Dual(plain, Recorded(tape, f"d{name}", "f", block)) if moving else plain

    def update(block: Block, name: str, number: Any) -> None:
        names = (name, f"d{name}") if moving else (name,)
        parts = (value(number), slope(number))[: len(names)]
        block.statements.append(Update(names, tuple(map(operand_of, parts))))

    def state(block: Block) -> list[Recorded]:
        return [Recorded(tape, name, "f", block) for name in states]

    def advanced(x: list[Any], h: Any) -> tuple[Any, ...]:
        """One step of size h."""
        numbers: Any = xp
        if tangent:
            x, numbers = list(map(Dual, x[:d], x[d:])), DualNumbers(xp)
        end = scene.pack(advance(composition, twin, scene.unpack(x, carry), h, 1, numbers))
        return tuple(map(operand_of, [*map(value, end), *map(slope, end)] if tangent else end))

    def followed(x: list[Recorded]) -> Any:
        """The state whose density is asked for."""
        return scene.unpack(list(map(Dual, x[:d], x[d:])) if moving else x[:d], carry)

    def going(block: Block, x: list[Any], time: Any, density: Any, due: Any) -> tuple[Any, Any]:
        time, density, steps = value(time), value(density), Recorded(tape, "steps", "f", block)
        healthy = (steps < budget) & (epsilon > SHORTEST * span * density)
        for c in x[: scene.motion]:
            healthy = healthy & (c * c <= bound)
        return time + epsilon / density <= due, healthy

    start = [tape.assign(Element("start", (i,)), "f", outer) for i in range(size)]
    square = dot(start[: scene.motion], start[: scene.motion])
    bound = DIVERGENCE**2 * xp.where(square > 0, square, 1.0)
    first = first_density(twin, followed(start), epsilon, span, largest)
    outer.statements += [Update(states, tuple(map(operand_of, start))), Update(("steps",), (0.0,))]
    update(outer, "time", 0.0)
    update(outer, "density", first)

    # a step of the sequence
    x, time, density = state(inner), variable("time", inner), variable("density", inner)
    due = tape.assign(Element("times", ("j",)), "f", interval)
    ahead, healthy = going(inner, x, time, density, due)
    more = Operation("and", (operand_of(ahead), operand_of(healthy)))
    inner.statements.append(Assign("more", more))
    tests = len(inner.statements)
    h = epsilon / density
    inner.statements.append(Update(states, advanced(x, h)))
    update(inner, "time", time + h)
    inner.statements.append(Assign("next", Operation("add", ("steps", 1.0))))
    inner.statements.append(Update(("steps",), ("next",)))
    following = next_density(twin, followed(state(after)), density, epsilon, span, largest)
    inner.statements += after.statements
    update(inner, "density", following)
    test, body = tuple(inner.statements[:tests]), tuple(inner.statements[tests:])

    # the shortened one to the saved time
    interval.statements.append(While(test, "more", body))
    x, time, density = state(interval), variable("time", interval), variable("density", interval)
    ahead, healthy = going(interval, x, time, density, due)
    complete = healthy & ~ahead
    for i, c in enumerate(advanced(x, due - time)):
        reached = Operation("where", (operand_of(complete), c, math.nan))
        interval.statements += [Assign(f"end{i}", reached), Store(Element("y", ("j", i)), f"end{i}")]

    ends = [
        Store(Element("facts", (i,)), name) for i, name in enumerate(("time", "density", "steps", *states))
    ]
    saves = Assign("saves", Operation("len", ("times",)))
    loop = Loop("j", "saves", tuple(interval.statements))
    arguments = ("start", "numbers", "options", "times", "y", "facts")
    return Function("run", arguments, (*outer.statements, saves, loop, *ends))
