"""What a fixed-step method declares and computes, whatever engine runs it."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from contactbench.boundary import is_ours, their_code
from contactbench.errors import BadInput, excerpt, is_number
from contactbench.methods.base import CALLBACKS, Method
from contactbench.numbers.control import Repeat, repeat
from contactbench.numbers.dual import Dual, DualNumbers, slope, value
from contactbench.numbers.protocol import CannotRecord
from contactbench.scene import Scene
from contactbench.scene.base import TRIED
from contactbench.scene.cache import Cache
from contactbench.solution import DIVERGENCE
from contactbench.trace.program import Program, record

Step = Callable[[Any, Any, Any, Any], Any]  # (scene, x, h, xp) -> x
Factor = Callable[[Any, Any, Any], Any]  # (scene, h, xp) -> conformal factor of one step


@dataclass(frozen=True)
class StepMap(Method):
    """A one-step method given by its step map ``step(scene, x, h, xp) -> x``.

    The map is written on the scene's own components, so it runs on Python floats, NumPy arrays (an ensemble),
    mpmath numbers, traced and recorded numbers alike; xp is the number namespace that goes with them.

    evaluations : of `kind` per step.  A method that can merge the end of one step with the start of the next
    overrides `advance` and `counts` (see contact.py).
    """

    name: str
    order: int
    step: Step
    evaluations: int = 1
    #: what is counted: "rhs", "gradient" or "rotation"
    kind: str = "rhs"
    about: str = ""
    engines: tuple[str, ...] = ("numba", "jax", "python")
    family: str = "established"
    contact: bool = False  # every step is an exact conformal contact map with factor e^{−γh}
    symmetric: bool = False
    factor: Factor | None = None  # every step is a conformal contact map with this factor instead
    adaptive = False
    tolerance = (
        "the largest error over the saved times, relative to the largest state: pilots choose the step"
    )

    def advance(self, scene: Any, x: Any, h: Any, n: Any, xp: Any, repeat: Repeat = repeat) -> Any:
        """n ≥ 1 steps of size h."""
        return repeat(n, lambda x: self.step(scene, x, h, xp), x)

    def conformal_factor(self, scene: Scene, h: Any, xp: Any = math) -> Any | None:
        """The constant c of Φ_h*η = c η, e^{−γh} for a `contact` method; None where none is claimed."""
        if self.refuses(scene) is not None or scene.conformal_rate is None:
            return None
        if self.factor is not None:
            return self.factor(scene, h, xp)
        return xp.exp(-scene.conformal_rate * h) if self.contact else None

    def log_factor(self, scene: Scene, x: Any, h: float, n: int) -> float | None:
        """Log of the conformal factor of n steps of size h from x; None where the steps are no contact maps.

        nan where the factor is negative, as that of a Herglotz step may be.
        """
        factor = self.conformal_factor(scene, h)
        if factor is None:
            return None
        return n * math.log(factor) if factor > 0 else math.nan

    def modified_hamiltonian(self, scene: Scene, x: Any, h: float) -> Any | None:
        """H̃ at x of which steps of size h are the flow, up to a power of h; None where none is known."""
        return None

    def counts(self, scene: Scene, n: int, carry: Sequence[str] | None = None) -> int:
        """Evaluations in n uninterrupted steps; carry : as in `solve`."""
        return n * self.evaluations

    def per_step(self, scene: Scene, carry: Sequence[str] | None = None) -> int:
        """Evaluations of a step in the middle of a run."""
        return self.counts(scene, 2, carry) - self.counts(scene, 1, carry)

    def kind_on(self, scene: Scene) -> str:
        """What `counts` counts on this scene."""
        return self.kind

    def step_cost(self, scene: Scene, engine: str) -> float | None:
        return self.per_step(scene) if engine in CALLBACKS else None


def program_of(method: StepMap, scene: Scene, carry: tuple[str, ...], tangent: bool = False) -> Program:
    """The recorded loop of a method on a scene.

    tangent : packed states are followed by a tangent vector, which is carried along.
    Raises `CannotRecord` where the method or the scene branches on values.
    """
    d = len(scene.labels(carry))

    def advance(numbers: Any, h: Any, n: Any, y: Any, xp: Any, repeat: Any) -> list[Any]:
        if tangent:
            y, xp = list(map(Dual, y[:d], y[d:])), DualNumbers(xp)
        start = scene.unpack(y, carry)
        end = scene.pack(method.advance(scene.with_numbers(numbers), start, h, n, xp, repeat))
        return [*map(value, end), *map(slope, end)] if tangent else end

    return record(advance, len(scene.numbers()), d * (1 + tangent), scene.motion, DIVERGENCE)


def is_fixed(method: StepMap) -> bool:
    """Whether a step map is one of this package, which computes the same tomorrow."""
    return is_ours(type(method)) and is_ours(getattr(method, "step", type(method)))


def tangent_program(method: StepMap, scene: Scene, carry: tuple[str, ...]) -> Program | None:
    """The loop of a user's step map with a tangent, as the map is now: it may change before the derivative is asked
    for.  None for the maps of this package, and where it cannot be recorded."""
    if is_fixed(method):
        return None
    try:
        return program_of(method, scene, carry, tangent=True)
    except CannotRecord:
        return None


def identity(method: StepMap, scene: Scene, carry: tuple[str, ...]) -> Hashable | None:
    """What a compiled loop of a method on a scene depends on besides the numbers; None where nobody can tell.

    A user's step map counts by what it was recorded with, as the scene's functions do.
    """
    if (own := scene.identity) is None:
        return None
    if is_fixed(method):
        return method, own, carry
    try:
        program = program_of(method, scene, carry)
    except CannotRecord:
        return None
    return (
        program.setup.digest,
        program.run.digest,
        program.data.tobytes(),
        program.shape.tobytes(),
        own,
        carry,
    )


def trajectory(method: StepMap, scene: Any, x: Any, spans: Any, xp: Any) -> Iterator[Any]:
    """States after each (h, n) of `spans`, on whatever numbers scene, x and xp are made of."""
    for h, n in spans:
        x = method.advance(scene, x, h, n, xp)
        yield x


# -- what is tried before a run is prepared ----------------------------------------------------------
_tried: Cache[bool] = Cache(1024)


def try_step(method: StepMap, scene: Scene, carry: tuple[str, ...], step: float | None) -> None:
    """Raise `BadInput` unless a user's step map takes a state of the scene to a state of the same fields.

    Once for what the method and the scene compute; what this package brings has tests of its own.
    """
    if is_ours(type(method)) and is_ours(method.step):
        return
    with their_code(f"method {method.name!r}"):
        known = identity(method, scene, carry)
    _tried.get(known, lambda: _try_step(method, scene, carry, step))


def _try_step(method: StepMap, scene: Scene, carry: tuple[str, ...], step: float | None) -> bool:
    x, h, what = scene.initial(carry), TRIED * scene.t_end, f"method {method.name!r}"
    with their_code(what):
        try:
            after = method.advance(scene, x, min(h, step or h), 1, math)
        except ArithmeticError:  # Python's way to say inf; the run will end as diverged
            return False
    if type(after) is not type(x):
        raise BadInput(f"{what}: its step map returns {excerpt(after)}: must be a {type(x).__name__}")
    for name, old, new in zip(x._fields, x, after, strict=True):
        if not _alike(old, new):
            raise BadInput(
                f"{what}: its step map returns {name} = {excerpt(new)}: must be like {excerpt(old)}"
            )
    return True


def _alike(old: Any, new: Any) -> bool:
    """Whether a field after a step is what it was before: so many real numbers, one, or None."""
    if old is None or new is None:
        return old is new
    if isinstance(old, tuple):
        return isinstance(new, tuple) and len(new) == len(old) and all(map(_alike, old, new))
    return is_number(new)
