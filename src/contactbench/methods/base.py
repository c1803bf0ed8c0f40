"""The contract of a method.

`METHODS` holds everything that is compared.  What a method must be, and what experiments, laws and tables rely
on, are the numbered rules of `Method`; `contactbench.testing.check_method` tests every one of them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

from contactbench.methods.prepared import METHODS, Prepared, Request
from contactbench.scene import Scene
from contactbench.solution import EXACT

#: what a method may be compared as: composed of exact contact flows, derived from a discrete action, or in use
#: for differential equations at large
FAMILIES = ("contact", "variational", "established")
#: the tightest rtol of a library without a limit of its own, and of CVODE, which refuses less than a rounding
ROUNDING = 2.3e-16
#: the tightest of SciPy and CyRK, which raise any below 100 ε to that
CLAMPED = 2.3e-14
#: a step this small against the span hardly moves the clock: a singularity is ahead
SHORTEST = 1e-15

#: engine → "compiled" (solver and right-hand side are machine code) or "callbacks" (the right-hand side,
#: or the solver too, is Python)
ENGINES = {
    "numba": "compiled",
    "jax": "compiled",
    "llvm": "compiled",
    "c": "compiled",
    "c++": "compiled",
    "python": "callbacks",
    "c+python": "callbacks",
}
CALLBACKS = tuple(engine for engine, kind in ENGINES.items() if kind == "callbacks")


class Method(ABC):
    """What can be compared with the other methods.

    To bring a step map ``(scene, x, h, xp) -> x``, use `fixed_step` or subclass `FixedStep`; to bring a solver
    that chooses its own steps, subclass `Adaptive` and write `prepare`.  Everything else here has a default.

     1. It declares itself: `name` (a key in tables and a word on the command line), `about` (one line with its
        source), `family` (one of `FAMILIES`), `engines` (keys of `ENGINES`, the default first), `order`.
     2. ``refuses(scene)`` is None or one sentence: why the scene is out of reach.  A run of a refused scene ends
        `unsupported` with that sentence, and never raises.
     3. ``prepare(request)`` does all that depends on scene, setting and saved times alone (recording, compiling,
        allocating); where that fails for one engine it raises `CannotRecord`, and the next one is tried.  The
        result is called any number of times, with other initial data if wanted; no call leaves a trace: equal
        data, equal bits.
     4. A run gives the states at exactly the saved times, the initial state bit for bit where 0 is among them.
     5. ``bare(y0)`` is the solver's own call, by its fastest way: the last state of the run to within the
        roundings of another way to the same time.  It is what is timed.
     6. The setting controls the error.  Not `adaptive`: takes `step`; steps are equal between saved times and no
        longer than `step`, and the error falls as step^order.  `adaptive`: takes `rtol` within `rtol_range` and
        `atol`, and says in `tolerance` what they bound; the error falls as they do.  `exact`: takes neither
        and has no truncation error.
     7. `max_steps` is never exceeded: a run that needs more ends as `budget`, and the states it did not reach
        are NaN.  So are they after `diverged` (which comes with the time, to the step) and `failed`.
     8. `Counts.evaluations` are all evaluations that a run made, of the kind the counts name, those for a
        Jacobian, an interpolant or a pilot included; None where the solver does not say.
     9. All engines compute the same: to round-off where the steps are given, else within the tolerance.
    10. Claims hold on every scene that is not refused, and are not left out where they hold: `contact` (every
        run is a composition of contact maps whose factors are those of the exact flow), `symmetric`
        (Φ_{−h} ∘ Φ_h = id).
    11. Where `Prepared.sensitivity_source` says how, `sensitivity` is the derivative of the saved states of the
        map of the steps taken, along the scene's tangents.
    12. ``step_cost(scene, engine)`` is about what a step costs where the right-hand side is called back from
        Python, in right-hand sides; None where a step is so cheap that no experiment need limit their number.
    """

    name: str
    about: str
    family: str = "established"
    engines: tuple[str, ...]

    def __init_subclass__(cls) -> None:
        """Methods are told apart by identity, whatever `dataclass` would compare: a step need not be hashable."""
        super().__init_subclass__()
        cls.__eq__, cls.__hash__ = object.__eq__, object.__hash__  # type: ignore[method-assign]

    #: of convergence; None where it varies
    order: int | None
    #: whether it takes rtol and chooses its own steps
    adaptive: bool
    #: whether there is no truncation error, and nothing to be set
    exact: bool = False
    contact: bool = False
    symmetric: bool = False
    rtol_range: tuple[float, float] = (1e-13, 1e-1)
    #: whether it takes an absolute tolerance beside rtol
    takes_atol: bool = True
    #: what rtol and atol bound
    tolerance: str
    #: components at most that it compiles one by one: that takes some ten seconds
    largest: int = 256
    #: whether its solver has a time of its own: that of a scene is then no part of what it integrates
    own_time: bool = False

    @property
    def control(self) -> str:
        """What is set: "step", "rtol" or nothing, "exact"."""
        return EXACT if self.exact else "rtol" if self.adaptive else "step"

    def refuses(self, scene: Scene) -> str | None:
        """Why the scene is out of reach, or None."""
        return None

    @abstractmethod
    def prepare(self, request: Request) -> Prepared:
        """A run for the request, compiled."""

    @abstractmethod
    def step_cost(self, scene: Scene, engine: str) -> float | None:
        """About the right-hand sides, called back from Python, that a step costs as much as."""


METHODS.of = Method


class Adaptive(Method):
    """Base of the solvers that choose their own steps from rtol."""

    adaptive = True
    tolerance = "the local error of a step, by rtol |y| + atol in every component"
    #: right-hand sides of a typical step
    evaluations_per_step: int = 1

    def step_cost(self, scene: Scene, engine: str) -> float | None:
        return self.evaluations_per_step if engine in CALLBACKS else None
