"""One step of a method as a pure function of plain tuples, for users' own code: `step_map`."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from operator import and_
from typing import Any

import numpy as np

from contactbench.checks import refuse
from contactbench.errors import BadInput, unknown_name
from contactbench.methods.base import lookup
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.loops import advanced
from contactbench.numbers.control import XlaNumbers
from contactbench.numbers.protocol import Arithmetic, CannotRecord, Condition, Namespace
from contactbench.scene import Scene, Vector
from contactbench.trace.form import Function, Unpack, Update, execute
from contactbench.trace.formula import argument_names, formula

Numbers = Sequence[Arithmetic]


@dataclass(frozen=True, eq=False, repr=False)
class OneStep:
    """Take one step: ``step(y, h, numbers=None, **parameters) -> y``, of size h from the packed state y.

    y is a tuple with an entry for each of `labels`.  numbers are the scene's parameters as a tuple in the order of
    `names`, by default its own; any of them can also be given by name, as in ``step(y, h, gamma=0.2)``.
    All of it may be floats, NumPy arrays (entry by entry), or JAX values under ``jit``, ``vmap`` and ``grad``,
    for which ``jax_enable_x64`` must be set.  In a function compiled with ``numba.njit`` call it as
    ``step(y, h)`` or ``step(y, h, numbers)``, of floats; a method that iterates is not compiled.  A step map has no
    state and keeps none.

    Numbers with another sign of κ or another order of the moments of inertia need other flows.  Plain numbers, and a
    traced κ, select them.  If the method or the carried fields do not allow that, and for a mass ≤ 0, the step raises
    `BadInput`, and under JAX it is nan; compiled code always raises.

    Parameters
    ----------
    scene, method, carry
        As of `step_map`.
    """

    scene: Scene
    method: FixedStep
    carry: tuple[str, ...]

    def __repr__(self) -> str:
        y = ", ".join(self.labels)
        return f"<step map of {self.method.name} on {self.scene.name}: step(y, h), y = ({y})>"

    @property
    def labels(self) -> list[str]:
        """Return the names of the entries of y."""
        return self.scene.labels(self.carry)

    @property
    def names(self) -> list[str]:
        """Return the names of the entries of `numbers`."""
        return self.scene.number_names()

    @property
    def start(self) -> Vector:
        """Return the scene's initial state, packed."""
        return tuple(map(float, self.scene.pack(self.scene.initial(self.carry))))

    def __call__(
        self,
        y: Vector,
        h: Arithmetic,
        numbers: Numbers | None = None,
        **parameters: Arithmetic,
    ) -> Vector:
        given: list[Any] = list(self.scene.numbers() if numbers is None else numbers)
        for name, value in parameters.items():
            if name not in self.names:
                raise unknown_name(f"parameter of scene {self.scene.name!r}", name, filter(None, self.names))
            if isinstance(value, str) or (
                isinstance(value, float | np.ndarray) and not np.all(np.isfinite(value))
            ):
                refuse(name, value, "a finite number")
            given[self.names.index(name)] = value
        if len(y) != len(self.start):
            raise BadInput(f"y has {len(y)} entries: must be {len(self.start)}, {', '.join(self.labels)}")
        y = tuple(y)
        xp = namespace(*y, h, *given)
        if numbers is None and not parameters:
            return self.step(y, h, self.scene, xp)
        if shape := np.broadcast_shapes(*map(np.shape, given)):  # each entry has stage constants of its own
            h = xp.broadcast_to(h, shape)
        if xp is math or xp is np:
            scene = self.scene.with_numbers(given) if np.all(self.fits(given)) else self.rebuilt(given)
            return self.step(y, h, scene, xp)
        return self.traced(y, h, given, xp)

    def fits(self, numbers: Numbers) -> Condition:
        """Return whether numbers fit the flows of the scene, entry by entry."""
        known = [*numbers, 0.0]
        orders = self.scene.orders()
        return reduce(
            and_, [known[i] < known[j] if strict else known[i] <= known[j] for i, j, strict in orders], True
        )

    def rebuilt(self, numbers: Numbers) -> Scene:
        """Return the scene that numbers with other flows make; `BadInput` if the method has no step on it."""
        scene = self.scene.decided_by(numbers)
        why = self.method.refuses(scene)
        if missing := set(scene.required) - set(self.carry):
            why = f"{', '.join(missing)} must be carried then"
        if why is not None:
            told = ", ".join(f"{name} = {x!r}" for name, x in zip(self.names, numbers, strict=True) if name)
            raise BadInput(f"{told}: makes scene {scene.name!r} another problem: {why}")
        return scene

    def traced(self, y: Vector, h: Arithmetic, numbers: Numbers, xp: Any) -> Vector:
        """Step with traced numbers; the result and its derivatives are nan where there is no such step."""
        scene = self.scene.with_numbers(numbers)
        place = self.names.index("kappa") if "kappa" in scene.coefficients else None
        if place is None or numbers[place] is self.scene.numbers()[place]:
            fits = self.fits(numbers)
            return self.step(y, h, scene, xp, 0.0 if fits is True else xp.where(fits, 0.0, math.nan))
        general = scene._replaced(kappa_sign=None)
        if "s" in self.carry and self.method.refuses(general) is None:
            return self.step(y, h, general, xp)
        kappa = xp.asarray(numbers[place])
        return self.step(y, h, scene, xp, xp.where(kappa == 0, xp.sqrt(kappa * kappa), math.nan))

    def step(
        self, y: Vector, h: Arithmetic, scene: Scene, xp: Namespace, lack: Arithmetic | None = None
    ) -> Vector:
        x = scene.unpack(y, self.carry)
        clock = (x.t, 0.0, -math.inf, math.inf) if scene.keeps_dates else ()
        after, _ = advanced(self.method, scene, x, h, 1, xp, clock, bounded=False)
        end = tuple(scene.pack(after._replace(t=x.t + h) if clock else after))
        return end if lack is None else tuple(c + lack for c in end)

    @property
    def _numba_type_(self) -> object:
        """Return the type of the compiled function, for numba."""
        return self.compiled._numba_type_

    @cached_property
    def compiled(self) -> Any:
        """The step compiled by numba; raises `CannotRecord` if scene or method branch on values or a step iterates."""
        import numba

        if self.method.iterates:
            instead = "call it outside, on floats, NumPy arrays or under jax.jit, or use cb.prepare"
            why = "iterates until nothing changes, and numba.njit takes no step map that does"
            raise CannotRecord(f"method {self.method.name!r} {why}: {instead}")

        d = len(self.labels)

        def whole(y: Vector, h: Arithmetic, numbers: Numbers, xp: Namespace) -> Vector:
            return self.step(y, h, self.scene.with_numbers(numbers), xp)

        recorded = formula(whole, (d, 0, len(self.names), "xp"), ())
        names = argument_names(recorded.arguments, ())
        arguments = (Unpack(names[:d], "y"), Update((names[d],), ("h",)), Unpack(names[d + 1 :], "numbers"))
        own = f"numbers={tuple(map(float, self.scene.numbers()))!r}"
        step = Function("step", ("y", "h", own), (*arguments, *recorded.body), recorded.results)
        plain = numba.njit(execute(step), error_model="numpy")
        default, orders = tuple(map(float, self.scene.numbers())), tuple(self.scene.orders())
        if not orders:
            return plain
        why = f"numbers: make scene {self.scene.name!r} another problem: step_map of that one"

        @numba.njit
        def guarded(y, h, numbers=default):  # type: ignore[no-untyped-def]
            known = (*numbers, 0.0)
            for i, j, strict in orders:
                low, high = known[i], known[j]
                if not (low < high or (low == high and not strict)):
                    raise BadInput(why)
            return plain(y, h, numbers)

        return guarded


def namespace(*values: object) -> Any:
    jax = sys.modules.get("jax")
    if jax is not None and any(isinstance(value, jax.Array) for value in values):
        return XlaNumbers()
    return np if any(isinstance(value, np.ndarray) for value in values) else math


def step_map(scene: Scene | str, method: str, carry: Sequence[str] | None = None) -> OneStep:
    """Return one step of a fixed-step method on a scene, as a pure function for users' own code.

    Parameters
    ----------
    scene
        A scene, or the name of a registered one.
    method
        The name of a fixed-step method.
    carry
        Which of s and R are part of the state; by default all the scene has.

    Returns
    -------
    OneStep
        ``step(y, h, numbers=None, **parameters) -> y``, with the initial state as its `start`.

    Raises
    ------
    BadInput
        For a method that is no step map or cannot do the scene.

    Examples
    --------
    >>> import contactbench as cb
    >>> step = cb.step_map("particle", "contact-strang", carry=())
    >>> y = step.start
    >>> for _ in range(100):
    ...     y = step(y, 0.01)
    """
    scene, chosen = lookup(scene, method)
    if not isinstance(chosen, FixedStep):
        raise BadInput(f"method = {method!r}: chooses its own steps, so that there is no map of a single one")
    if not chosen.one_step:
        before = "a step needs those before it, so that there is no map of a single one"
        raise BadInput(f"method = {method!r}: {before}")
    if (why := chosen.refuses(scene)) is not None:
        raise BadInput(f"method = {method!r}: {why}")
    return OneStep(scene, chosen.on(scene), scene.carry(carry))
