"""One step of a method as a pure function of plain tuples, for one's own code: `step_map`."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from contactbench.errors import BadInput, unknown_name
from contactbench.methods.entry import lookup
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.fixed_step_run import is_fixed
from contactbench.numbers.control import XlaNumbers
from contactbench.numbers.protocol import CannotRecord
from contactbench.scene import Scene
from contactbench.trace.form import Element, Function, prune
from contactbench.trace.formula import Formula, formula
from contactbench.trace.python import SCOPE, source
from contactbench.trace.recording import Recorded, RecordedNumbers, Tape, attempt


@dataclass(frozen=True, eq=False, repr=False)
class OneStep:
    """``step(y, h, numbers=None, **parameters) -> y``: one step of size h from the packed state y.

    y : a tuple with an entry for each of `labels`.  numbers : the scene's parameters as a tuple in the order of
    `names`, by default its own; any of them can also be given by name, as in ``step(y, h, gamma=0.2)``.
    All of it may be floats, NumPy arrays (entry by entry), or JAX values under ``jit``, ``vmap`` and ``grad``,
    for which ``jax_enable_x64`` must be set.  In a function compiled with ``numba.njit`` call it as
    ``step(y, h)`` or ``step(y, h, numbers)``, of floats.  A step map has no state and keeps none.
    """

    scene: Scene
    method: FixedStep
    carry: tuple[str, ...]
    #: the step of a user's map as it was when it was asked for; None for those of this package
    recorded: Formula | None = None

    def __repr__(self) -> str:
        """One line: of which method and scene, and what its arguments are."""
        return f"<step map of {self.method.name} on {self.scene.name}: step(y, h), y = ({', '.join(self.labels)})>"

    @property
    def labels(self) -> list[str]:
        """What the entries of y are."""
        return self.scene.labels(self.carry)

    @property
    def names(self) -> list[str]:
        """What the entries of `numbers` are."""
        return self.scene.number_names()

    @property
    def start(self) -> tuple[float, ...]:
        """The scene's initial state."""
        return tuple(map(float, self.scene.pack(self.scene.initial(self.carry))))

    def __call__(
        self, y: Sequence[Any], h: Any, numbers: Sequence[Any] | None = None, **parameters: Any
    ) -> tuple[Any, ...]:
        given = list(self.scene.numbers() if numbers is None else numbers)
        for name, value in parameters.items():
            if name not in self.names:
                raise unknown_name(f"parameter of scene {self.scene.name!r}", name, filter(None, self.names))
            given[self.names.index(name)] = value
        return self.apply(tuple(y), h, given, namespace(*y, h, *given))

    def apply(self, y: tuple[Any, ...], h: Any, numbers: list[Any], xp: Any) -> tuple[Any, ...]:
        """The step on the numbers of a namespace."""
        if len(y) != len(self.labels):
            raise BadInput(f"y has {len(y)} entries: must be {len(self.labels)}, {', '.join(self.labels)}")
        if self.recorded is not None:
            return tuple(self.recorded(y, h, numbers, xp))
        return self.advance(y, h, numbers, xp)

    def advance(self, y: tuple[Any, ...], h: Any, numbers: Sequence[Any], xp: Any) -> tuple[Any, ...]:
        scene = self.scene.with_numbers(numbers)
        return tuple(scene.pack(self.method.advance(scene, scene.unpack(y, self.carry), h, 1, xp)))

    # -- numba -------------------------------------------------------------------------------------
    @cached_property
    def source(self) -> str:
        """The step as Python source, ``def step(y, h, numbers)``: straight-line arithmetic.

        Raises `CannotRecord` where scene or method branch on values.
        """
        tape = Tape()
        y, numbers = (
            [tape.assign(Element(name, (i,)), "f", tape.root) for i in range(size)]
            for name, size in (("y", len(self.labels)), ("numbers", len(self.names)))
        )
        h = Recorded(tape, "h", "f", tape.root)
        end = tape.results(attempt(lambda: self.apply(tuple(y), h, numbers, RecordedNumbers(tape))))
        own = f"numbers={tuple(map(float, self.scene.numbers()))!r}"
        return source(Function("step", ("y", "h", own), prune(tape.root.statements, end), end))

    @cached_property
    def compiled(self) -> Any:
        """The same as a function compiled by numba."""
        import numba

        names = dict(SCOPE)
        exec(self.source, names)
        return numba.njit(names["step"], error_model="numpy")

    @property
    def _numba_type_(self) -> Any:
        """What numba takes this for where compiled code calls it: a compiled function."""
        return self.compiled._numba_type_


def namespace(*values: Any) -> Any:
    """The functions that go with some numbers: those of JAX, NumPy or `math`."""
    jax = sys.modules.get("jax")
    if jax is not None and any(isinstance(value, jax.Array) for value in values):
        return XlaNumbers()
    return np if any(isinstance(value, np.ndarray) for value in values) else math


def step_map(scene: Scene | str, method: str, carry: Sequence[str] | None = None) -> OneStep:
    """One step of a fixed-step method on a scene, as a pure function for one's own code: see `OneStep`.

    carry : which of s and R are part of the state; by default all the scene has.
    Raises `BadInput` for a method that is no step map or cannot do the scene.

    >>> import contactbench as cb
    >>> step = cb.step_map("particle", "contact-strang", carry=())
    >>> y = step.start
    >>> for _ in range(100):
    ...     y = step(y, 0.01)
    """
    scene, chosen = lookup(scene, method)
    if not isinstance(chosen, FixedStep):
        raise BadInput(f"method = {method!r}: chooses its own steps, so that there is no map of a single one")
    if (why := chosen.refuses(scene)) is not None:
        raise BadInput(f"method = {method!r}: {why}")
    step = OneStep(scene, chosen, scene.carry(carry))
    if is_fixed(chosen):
        return step
    try:
        sizes = (len(step.labels), 0, len(step.names), "xp")
        return replace(step, recorded=formula(step.advance, sizes, ()))
    except CannotRecord:
        return step
