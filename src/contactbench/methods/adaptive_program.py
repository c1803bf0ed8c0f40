"""The loop of `contact-adaptive` (see there) as recorded source: over its steps and the saved times."""

from __future__ import annotations

from typing import Any

from contactbench.methods.base import SHORTEST
from contactbench.methods.step_density import first_density, next_density
from contactbench.numbers.dual import Dual, DualNumbers, slope, value
from contactbench.scene import Mechanical, dot
from contactbench.solution import DIVERGENCE
from contactbench.splitting.composition import Composition, advance
from contactbench.trace.recording import Block, Recorded, RecordedNumbers, Tape, text_of


def recorded_loop(
    composition: Composition, scene: Mechanical, carry: tuple[str, ...], tangent: bool, moving: bool = False
) -> str:
    """Source of ``run(start, numbers, options, times, y, facts)``, the loop over steps and saved times.

    options : ε, the span, the budget of steps.  y : states at the saved times, NaN where not reached.
    facts : time, density and steps at the end of the sequence, and the state there.
    tangent : the state is followed by a tangent, which is carried along with the steps as they are; moving : and
    through their choice, by the tangents of time and density.
    """
    tape, d = Tape(), len(scene.labels(carry))
    outer = tape.root
    interval = Block(outer)
    inner = Block(interval)
    size = d * (1 + tangent)
    twin: Any = scene.with_numbers(
        [tape.assign(f"numbers[{i}]", "f", outer) for i in range(len(scene.numbers()))]
    )
    epsilon, span, budget = (tape.assign(f"options[{i}]", "f", outer) for i in range(3))
    xp: Any = RecordedNumbers(tape)
    largest = DualNumbers(xp).maximum if moving else xp.maximum

    def variable(name: str, block: Block) -> Any:
        """A number of the loop, with its tangent where it has one."""
        plain = Recorded(tape, name, "f", block)
        return Dual(plain, Recorded(tape, f"d{name}", "f", block)) if moving else plain

    def assigned(name: str, number: Any) -> list[str]:
        lines = [f"{name} = {text_of(value(number))}"]
        return [*lines, f"d{name} = {text_of(slope(number))}"] if moving else lines

    def carried(block: Block) -> tuple[list[Recorded], Any, Any, Recorded]:
        x = [Recorded(tape, f"x{i}", "f", block) for i in range(size)]
        return x, variable("time", block), variable("density", block), Recorded(tape, "steps", "f", block)

    def advanced(x: list[Any], h: Any) -> list[str]:
        """One step of size h."""
        numbers: Any = xp
        if tangent:
            x, numbers = list(map(Dual, x[:d], x[d:])), DualNumbers(xp)
        end = scene.pack(advance(composition, twin, scene.unpack(x, carry), h, 1, numbers))
        return [text_of(c) for c in ([*map(value, end), *map(slope, end)] if tangent else end)]

    def followed(x: list[Recorded]) -> Any:
        """The state whose density is asked for."""
        return scene.unpack(list(map(Dual, x[:d], x[d:])) if moving else x[:d], carry)

    def going(x: list[Any], time: Any, density: Any, steps: Any, due: Any) -> tuple[Any, Any]:
        time, density = value(time), value(density)
        healthy = (steps < budget) & (epsilon > SHORTEST * span * density)
        for c in x[: scene.motion]:
            healthy = healthy & (c * c <= bound)
        return time + epsilon / density <= due, healthy

    start = [tape.assign(f"start[{i}]", "f", outer) for i in range(size)]
    square = dot(start[: scene.motion], start[: scene.motion])
    bound = DIVERGENCE**2 * xp.where(square > 0, square, 1.0)
    first = first_density(twin, followed(start), epsilon, span, largest)
    outer.add(*(f"x{i} = {text_of(c)}" for i, c in enumerate(start)))
    outer.add("steps = 0.0", *assigned("time", 0.0), *assigned("density", first))

    # a step of the sequence
    x, time, density, steps = carried(inner)
    due = tape.assign("times[j]", "f", interval)
    ahead, healthy = going(x, time, density, steps, due)
    inner.add(f"if not ({text_of(ahead)} and {text_of(healthy)}):", "    break")
    h = epsilon / density
    end = advanced(x, h)
    inner.add(f"{', '.join(f'x{i}' for i in range(size))} = {', '.join(end)}", *assigned("time", time + h))
    inner.add("steps = steps + 1.0")
    after = Block(inner, inner.indent)
    moved = [Recorded(tape, f"x{i}", "f", after) for i in range(size)]
    following = assigned("density", next_density(twin, followed(moved), density, epsilon, span, largest))
    inner.lines += after.lines
    inner.add(*following)

    # the shortened one to the saved time
    interval.add("while True:")
    interval.lines += inner.lines
    x, time, density, steps = carried(interval)
    ahead, healthy = going(x, time, density, steps, due)
    complete = healthy & ~ahead
    there = advanced(x, due - time)
    interval.add(*(f"y[j, {i}] = {c} if {text_of(complete)} else nan" for i, c in enumerate(there)))

    outer.add("for j in range(len(times)):")
    outer.lines += interval.lines
    outer.add("facts[0] = time", "facts[1] = density", "facts[2] = steps")
    outer.add(*(f"facts[{3 + i}] = x{i}" for i in range(size)), "return 0")
    return "\n".join(["def run(start, numbers, options, times, y, facts):", *outer.lines, ""])
