"""SUNDIALS' symplectic partitioned Runge–Kutta methods: ARKODE's SPRKStep, by its own bindings, sundials4py.

In z = e^{γt/2} q a linearly damped motion is Hamiltonian, z'' = γ²z/4 − e^{γt/2} ∇V(q)/m: coordinates change momenta,
and momenta coordinates.  So does S = e^{γt} (s − q·p/2) change, by e^{γt} (q·∇V/2 − V), and every step is a contact map
with the factor of the exact flow.  The time is a coordinate, so that a force that depends on it is met at the time of
the coordinates that it acts with.

McLachlan, Atela, Nonlinearity 5, 541 (1992), doi:10.1088/0951-7715/5/2/011; Sofroniou, Spaletta, Optim. Methods
Softw. 20, 597 (2005), doi:10.1080/10556780500140664.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn, Self

import numpy as np

from contactbench.methods.base import CALLBACKS, METHODS, unfit
from contactbench.methods.prepared import NO_NUMBER, Request
from contactbench.numbers import functions as math
from contactbench.numbers.protocol import Arithmetic
from contactbench.peers.base import Rates, Variational, record_function
from contactbench.peers.by_numba import entry
from contactbench.peers.compiled import c_functions
from contactbench.peers.stepping import LibrarySteps, Stepper
from contactbench.scene import System, Vector, dot, key, scaled
from contactbench.scene.many import Many
from contactbench.scene.mechanical import Canonical

if TYPE_CHECKING:
    from contactbench.peers.abi.arkode import Memory

#: γt beyond which e^{γt} is no longer a double; components that are compiled one by one
LONGEST, MOST = 700.0, 256


class Stretched(NamedTuple):
    """z, the time since the start, that of the start where forces depend on it, z', and S."""

    q: Vector
    t: Arithmetic
    origin: Arithmetic | None
    p: Vector
    s: Arithmetic | None = None


@dataclass(frozen=True, kw_only=True)
class Part(System):
    """What moves momenta, a kick, or else what moves coordinates."""

    base: Canonical
    kick: bool

    def labels(self, carry: Sequence[str]) -> list[str]:
        z, w = ([f"{name}{i + 1}" for i in range(len(self.base.q))] for name in "zw")
        return [*z, "t", *(["origin"] if self.base.clock is not None else []), *w, *carry]

    def initial(self, carry: Sequence[str], **data: object) -> NoReturn:
        raise NotImplementedError("a part of equations has no motion")

    def unpack(self, y: Sequence[Arithmetic], carry: Sequence[str]) -> Stretched:
        n, timed = len(self.base.q), self.base.clock is not None
        p = tuple(y[n + 1 + timed : 2 * n + 1 + timed])
        return Stretched(tuple(y[:n]), y[n], y[n + 1] if timed else None, p, y[-1] if carry else None)

    def numbers(self) -> list[float]:
        return self.base.numbers()

    def with_numbers(self, numbers: Sequence[Arithmetic]) -> Self:
        return self._replaced(base=self.base.with_numbers(numbers))

    @property
    def structure(self) -> tuple[Hashable, ...]:
        return (Part, self.kick, *self.base.structure)

    @property
    def identity(self) -> Hashable | None:  # type: ignore[override]
        return key(self.base.identity, Part, self.kick)

    def rhs(self, x: Stretched) -> Stretched:
        base, rest = self.base, tuple(0.0 * c for c in x.q)
        origin, s = None if x.origin is None else 0.0, None if x.s is None else 0.0
        if not self.kick:
            return Stretched(x.p, 1.0, origin, rest, s)
        grown: Any = math.exp(base.gamma * x.t / 2)
        q = scaled(1 / grown, x.q)
        at = base.state(q, None) if origin is None else base.state(q, None, x.origin + x.t)
        gradient = base.gradient_at(at)
        pull = scaled(base.inverse_mass, gradient)
        p = tuple(base.gamma * base.gamma / 4 * z - grown * g for z, g in zip(x.q, pull, strict=True))
        if s is not None:
            s = grown * grown * (dot(q, gradient) / 2 - base.potential_at(at))
        return Stretched(rest, 0.0, origin, p, s)


class Callbacks:
    """sundials4py as it is, with the interface of `abi.arkode.Memory`."""

    def __init__(self, method: str, functions: Sequence[Rates], size: int) -> None:
        from sundials4py import arkode, core

        def calling(function: Rates) -> Callable[..., int]:
            def call(t: float, y: object, dy: object, _: object) -> int:
                with suppress(*NO_NUMBER):
                    core.N_VGetArrayPointer(dy)[:] = function(t, core.N_VGetArrayPointer(y).tolist())
                    return 0
                return -1

            return call

        self.library, self.y = arkode, np.zeros(size)
        _, self.context = core.SUNContext_Create(core.SUN_COMM_NULL)
        core.SUNContext_ClearErrHandlers(self.context)
        self.vector = core.N_VMake_Serial(size, self.y, self.context)
        self.view = arkode.SPRKStepCreate(*map(calling, functions), 0.0, self.vector, self.context)
        arkode.SPRKStepSetMethodName(self.view.get(), method)
        arkode.ARKodeSetInterpolantType(self.view.get(), arkode.ARK_INTERP_NONE)
        arkode.ARKodeSetMaxNumSteps(self.view.get(), -1)

    def take(self, h: float, n: int) -> None:
        ark, memory = self.library, self.view.get()
        ark.ARKodeReset(memory, 0.0, self.vector)
        ark.ARKodeSetFixedStep(memory, h)
        ark.ARKodeSetStopTime(memory, n * h)
        if ark.ARKodeEvolve(memory, n * h, self.vector, ark.ARK_NORMAL)[0] < 0:
            self.y[:] = np.nan


class Steps(LibrarySteps):
    """Take the steps of SPRKStep."""

    derivative = "the same steps of the variational equations"

    def __init__(self, method: Stepper, request: Request) -> None:
        from contactbench.peers.abi import arkode

        super().__init__(method, request)
        self.abi, single = arkode, self.scene.unrolled() if isinstance(self.scene, Many) else self.scene
        scene = single.recorded()
        self.parts = [Part(name="", t_end=1.0, base=scene, kick=kick) for kick in (True, False)]
        over_m = np.array(list(scaled(scene.inverse_mass, (1.0,) * len(scene.q))), dtype=float)
        self.place = over_m, scene.gamma, -1 if scene.clock is None else scene.clock
        self.memory: Memory | Callbacks
        if request.engine in CALLBACKS:
            calls = (record_function(each, "rhs", self.carry) for each in self.parts)
            given = [c or partial(p.slopes, carry=self.carry) for c, p in zip(calls, self.parts, strict=True)]
            self.memory = Callbacks(method.solver, given, self.size)
        else:
            self.memory = self.compiled(self.parts, self.size)

    @property
    def size(self) -> int:
        return len(self.parts[0].labels(self.carry))

    def compiled(self, parts: Sequence[Any], size: int) -> Memory:
        kick, drift = (c_functions(part, self.carry, jacobian=False) for part in parts)
        self.seconds += kick.compile_s + drift.compile_s
        return self.abi.Memory(self.method.solver, kick, drift, self.parts[0].numbers(), size)

    def stretched(self, y: np.ndarray) -> np.ndarray:
        return self.abi.stretch(y, *self.place, np.empty(self.size))

    def back(self, y: np.ndarray) -> np.ndarray:
        return self.abi.unstretch(y, *self.place, np.empty(len(self.scene.labels(self.carry))))

    def advance(self, y: np.ndarray, h: float, n: int) -> np.ndarray:
        self.abi.stretch(y, *self.place, self.memory.y)
        self.memory.take(h, n)
        return self.back(self.memory.y)

    def last(self, ready: list[tuple[float, int]]) -> Callable[[np.ndarray], np.ndarray]:
        memory, (h, n) = self.memory, ready[0]
        if len(ready) > 1 or isinstance(memory, Callbacks):
            return super().last(ready)
        rest = *self.place, h, n, memory.y, memory.memory, memory.vector
        advance = entry(self.abi.advance, np.empty(len(self.scene.labels(self.carry))), *rest)
        # addresses are good as long as their memory lives
        return lambda y0, owner=memory: advance(y0, *rest)  # type: ignore[misc]

    @cached_property
    def tangents(self) -> Memory:  # type: ignore[override]
        parts = [Variational(name="", t_end=1.0, base=part, count=1) for part in self.parts]  # type: ignore[arg-type]
        return self.compiled(parts, 2 * self.size)

    def tangent(self, y0: np.ndarray, v: np.ndarray, h: np.ndarray, n: np.ndarray) -> np.ndarray:
        """Both changes of coordinates are of degree two, and central differences exact."""
        memory, d, y, rows = self.tangents, self.size, y0, []
        with self.alone:
            for step, steps in self.ready(h, n):
                memory.y[:d] = self.stretched(y)
                memory.y[d:] = (self.stretched(y + v) - self.stretched(y - v)) / 2
                memory.take(step, steps)
                z, w = memory.y[:d], memory.y[d:]
                y, v = self.back(z), (self.back(z + w) - self.back(z - w)) / 2
                rows.append(v)
        return np.array(rows)


class Sprk(Stepper):
    contact = True
    largest = MOST

    def unfit(self, scene: Any) -> str | None:
        linear = scene.kind in ("mechanical", "driven") and not scene.nonlinear_damping
        fits = linear and getattr(scene, "rate", None) is None
        needs = "forces that depend on q and t alone and damping Γ = γ s of a constant γ"
        if isinstance(scene, Many):
            if scene.motion > 2 * MOST:
                return f"{self.name} compiles every component: scene {scene.name!r} has {scene.motion}"
        elif (why := unfit(self, scene, fits, needs)) is not None:
            return why
        if scene.gamma * scene.t_end > LONGEST:
            return f"{self.name} takes γ t up to {LONGEST:g}; scene {scene.name!r} goes on for longer"
        return None


for _order, _stages, _solver, _symmetric, _authors in (
    (5, 6, "MCLACHLAN_5_6", False, "McLachlan–Atela"),
    (10, 36, "SOFRONIOU_10_36", True, "Sofroniou–Spaletta"),
):
    METHODS.add(
        Sprk(
            f"sprk-{_order}",
            _order,
            f"{_authors}'s symplectic method of {_stages} stages, SUNDIALS' SPRKStep on e^{{γt/2}} q",
            *(Steps, "sundials4py", _stages, f"ARKODE_SPRK_{_solver}", _symmetric, ("c", "c+python")),
        )
    )
