"""The contract of a method, and `prepare` and `solve`."""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import fields, replace
from functools import cache
from typing import Any, ClassVar, Self

import numpy as np

from contactbench.blame import blame
from contactbench.checks import missing, positive, switch, text, vector, whole
from contactbench.errors import BadInput, excerpt
from contactbench.methods.dense import Source, densely
from contactbench.methods.prepared import METHODS, Prepared, Refused, Request, require_start
from contactbench.methods.prescribed import SHORTEST_RUN, default_times, saved_times, steps_of, steps_until
from contactbench.numbers.protocol import CannotRecord
from contactbench.scene import Scene
from contactbench.scene.base import scene_of
from contactbench.scene.definition import verify_at
from contactbench.solution import EXACT, Solution
from contactbench.trace.compiled import COMPILES
from contactbench.trace.recording import reason_of

#: families of methods: compositions of exact contact flows, methods from a discrete action, and general-purpose
#: solvers of differential equations
FAMILIES = ("contact", "variational", "established")
#: the tightest rtol of libraries without a limit of their own, and of CVODE, which refuses less than ε
ROUNDING = 2.3e-16
#: the tightest rtol of SciPy and CyRK, which raise a smaller one to 100 ε
CLAMPED = 2.3e-14
#: a step below this part of the span means that a singularity is ahead
SHORTEST = 1e-15

#: engine → "compiled" (solver and right-hand side are machine code) or "callbacks" (the right-hand side,
#: or the solver too, is Python)
ENGINES = dict.fromkeys(("llvm", "jax", "c", "c++"), "compiled")
ENGINES |= dict.fromkeys(("python", "c+python"), "callbacks")
CALLBACKS = tuple(engine for engine, kind in ENGINES.items() if kind == "callbacks")
#: engine → the optional package that it needs
PACKAGES = {"jax": "jax"}

DEFAULT_MAX_STEPS = 10**8
ADAPTIVE_MAX_STEPS = 10**6
#: the largest budget: a year at ten steps in a microsecond is less
MOST_STEPS = 10**14


class Method(ABC):
    """Declare a method and prepare its runs, so that it can be compared with the other methods.

    To bring a step map ``(scene, x, h, xp) -> x``, use `fixed_step` or subclass `FixedStep`; to bring a solver
    that chooses its own steps, subclass `Adaptive` and write `prepare`.  Everything else here has a default.

     1. It declares itself: `name` (a key in tables and a word on the command line), `about` (one line with its
        source), `family` (one of `FAMILIES`), `engines` (keys of `ENGINES`, the default first), `order`.
     2. ``refuses(scene)`` is None or one sentence: why the scene is out of reach.  A run of a refused scene ends
        `unsupported` with that sentence, and never raises.
     3. ``prepare(request)`` does everything that depends on scene, setting and saved times alone (recording,
        compiling, allocating).  It raises `CannotRecord` where that fails for one engine, and the next engine is
        tried.  Its result may be called any number of times, with other initial data too.  Calls are independent:
        equal data give equal bits.
     4. A run gives the states at exactly the saved times, the initial state bit for bit where 0 is among them.  With a
        `source` it takes its own steps, and interpolates between them.
     5. ``bare(y0)`` is the fastest call of the solver itself, and is timed.  It returns the last state of the run to
        round-off.  Where more states are saved, ``bare_states(y0)`` is timed, which returns them all.
     6. The setting controls the error.  Not `adaptive`: takes `step`; steps are equal between breaks, or saved times,
        and no longer than `step` (for a method that `follows` the motion they are equal in its own variable), and the
        error falls as step^order.  `adaptive`: takes `rtol` within `rtol_range` and `atol`, and `tolerance` says what
        they bound; the error falls with them.  `exact`: takes neither and has no truncation error.
     7. A run never exceeds `max_steps`: a run that needs more ends as `budget`, and the states it did not reach are
        NaN, as after `failed` and `diverged`.  The time of divergence is known to the step.
     8. `Counts.evaluations` counts all evaluations of a run, including those for a Jacobian, an interpolant or a
        pilot, in the unit `Counts.kind`; None where the solver does not count.
     9. All engines give the same result: to round-off for given steps, else within the tolerance.
    10. Claims hold on every scene that is not refused, and are made wherever they hold: `contact` (every run is a
        composition of contact maps with the factors of the exact flow), `symmetric` (Φ_{−h} ∘ Φ_h = id).
    11. Unless `Prepared.sensitivity_source` is empty, `sensitivity` is the derivative of the saved states along the
        scene's tangents, with the steps fixed.
    12. ``step_cost(scene, engine)`` is about the number of right-hand sides of a step that Python computes; None
        where steps are so cheap that no experiment limits their number.
    """

    name: str
    about: str
    family: str = "established"
    engines: tuple[str, ...]

    def __init_subclass__(cls) -> None:
        """Compare methods by identity, not by their fields: a step need not be hashable."""
        super().__init_subclass__()
        cls.__eq__, cls.__hash__ = object.__eq__, object.__hash__  # type: ignore[method-assign]

    #: order of convergence; None where it varies
    order: int | None
    #: whether it takes rtol and chooses its own steps
    adaptive: bool
    #: whether it has no truncation error, and no setting
    exact: bool = False
    contact: bool = False
    symmetric: bool = False
    rtol_range: tuple[float, float] = (1e-13, 1e-1)
    #: whether it takes an absolute tolerance beside rtol
    takes_atol: bool = True
    #: what rtol and atol bound
    tolerance: str
    #: most components that it compiles one by one, which takes some ten seconds
    largest: int = 256
    #: whether its solver keeps the time itself, so that it does not integrate the clock of a scene
    own_time: bool = False
    #: whether equal steps are powers of one map of the state, which has a stability limit and a `step_map`
    one_step: bool = True
    #: whether steps are equal in a variable that follows the motion instead of the time: the number of steps to a
    #: saved time depends on the motion, and the last one is taken in part
    follows: bool = False
    #: whether a step iterates to convergence: its evaluations are counted as it runs (see contact_gauss.py), and
    #: `counts` is a typical number
    iterates: ClassVar[bool] = False
    #: the message of a run that fails because the equations of an implicit step are not solved
    unsolved: ClassVar[str] = ""
    #: the package that runs it; blank for this one
    package: str = ""
    #: whether the benchmark is about it; then it runs on all of its engines
    mission: bool = False
    #: whether it solves the linear part of the force about a point exactly
    expands: bool = False
    #: whether it is meant for stiff problems
    stiff: bool = False
    #: the method of another maker with the same formulas; blank for a method that is run for its own sake
    like: str = ""

    @property
    def control(self) -> str:
        """Return its control: "step", "rtol" or "exact"."""
        return EXACT if self.exact else "rtol" if self.adaptive else "step"

    @property
    def stepping(self) -> str:
        """Return how it steps: "fixed", "adaptive" or "exact"."""
        return {"step": "fixed", "rtol": "adaptive"}.get(self.control, EXACT)

    def refuses(self, scene: Scene) -> str | None:
        """Return why the scene is out of reach, or None."""
        return None

    def on(self, scene: Scene) -> Self:
        """Return the method with what it takes from a scene beforehand."""
        return self

    def lacks(self, engine: str) -> str | None:
        """Return a message if a package that an engine needs is not installed, else None."""
        package = self.package or PACKAGES.get(engine)
        return missing(package) if package else None

    def solves(self, scene: Scene) -> bool:
        """Return whether its steps are the motion itself on an accepted scene, which proves nothing of the method."""
        return False

    def source(self, request: Request) -> Source | None:
        """Return its own steps for dense output, or None: then steps end at saved times, or it interpolates itself."""
        return None

    @abstractmethod
    def prepare(self, request: Request) -> Prepared:
        """Return a run for the request, compiled."""

    @abstractmethod
    def step_cost(self, scene: Scene, engine: str) -> float | None:
        """Return about how many right-hand sides, called back from Python, a step costs."""


METHODS.of = Method


class Adaptive(Method):
    adaptive = True
    tolerance = "the local error of a step, by rtol |y| + atol in every component"
    #: right-hand sides of a typical step
    evaluations_per_step: int = 1

    def step_cost(self, scene: Scene, engine: str) -> float | None:
        return self.evaluations_per_step if engine in CALLBACKS else None


def unfit(method: Method, scene: Scene, fits: bool, needs: str) -> str | None:
    """Return why a method refuses a scene, or None."""
    if not fits:
        return f"{method.name} needs {needs}, which scene {scene.name!r} does not have{scene.lacks}"
    return scene.own_equations


# -- from arguments to a prepared solver --------------------------------------------------------------------
def lookup(scene: Scene | str, method: Method | str) -> tuple[Scene, Method]:
    """Return a scene and a method, each itself or by name."""
    if isinstance(method, str) or not isinstance(method, Method):
        return scene_of(scene), METHODS[method]
    text("method name", method.name)
    return scene_of(scene), method


def prepare(
    scene: Scene | str,
    method: Method | str,
    *,
    step: float | Sequence[float] | np.ndarray | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    save_at: Sequence[float] | np.ndarray | None = None,
    carry: Sequence[str] | None = None,
    engine: str | None = None,
    max_steps: int | None = None,
    dense: bool = True,
    about: Sequence[float] | None = None,
) -> Prepared:
    """Return a solver compiled for a scene: ``run = prepare(…); run(); run(q=…, p=…)``.

    Parameters
    ----------
    scene
        A scene, or the name of a registered one.
    method
        A method, or the name of a registered one.
    step
        Size of the steps of a fixed-step method.  The time to the last saved one, and between two breaks of a scene, is
        divided into the fewest equal steps not longer than `step`; the solution's `step` is the longest one.

        A sequence of steps is used as given, so that every step of a contact method is a contact map.  Saved times must
        be ends of steps; by default they are all ends, or every k-th.  Steps after the last saved time are left out.
        A method starts anew where the step changes or a state is saved, so that a method with a processor
        (contact-rkn8) is cheapest on runs of equal steps: see `geometric_steps`.
    rtol, atol
        Tolerances of an adaptive method.  They bound the error of a step; the error of the run may be larger.  By
        default atol is rtol times the scale of the motion, for every component: the scene's `scale`, or the size that
        follows from force and velocity at the start; a scale from 0.01 to 1000 counts as 1 if all components share a
        unit.  A fixed-step method given rtol instead of step chooses its step by pilot runs, which are part of every
        call and of its counts; the solution's `step_chosen` is that step.  Then rtol bounds the error of the run at
        every saved time: the run ends as `ok` if the pilots agree, else as `budget`, `failed` or `diverged`.  An exact
        method takes neither.
    save_at
        Increasing times from the scene's t on (from 0 on where nothing depends on the time), also beyond t + t_end;
        by default the start and every k-th step, at most 1001 of them, for fixed steps, and 201 equally spaced times
        for others.
    dense
        Whether states at saved times between ends of steps are interpolated; the solution's `interpolated` says which.
        The difference of two polynomials estimates their error; it is at most twice the error of a step, or a tenth of
        the tolerance, and near ends and breaks the error itself may be several times as large.  Where steps are too
        long for that, parts of steps are taken and counted.  If False, steps end at every saved time: each interval
        between saved times is divided into the fewest equal steps, and a method starts anew there.  So does
        contact-log8, and a run that does not end well.  Interpolation takes some ten milliseconds for a thousand
        times, so False is faster where forces are cheap and compiled.  A fixed step is chosen from `rtol` at five of
        the saved times.
    carry
        Which of s and R to integrate; by default all the scene has.
    engine
        "llvm", "python", …; by default the method's first that can run this scene: a step map or a force
        that branches on values cannot be compiled.  Under NUMBA_DISABLE_JIT Python comes first.
    max_steps
        Budget; a run that needs more ends with status `budget`.
    about
        Of a method that solves the linear part of the force exactly (contact-linear2): the point about which the
        potential is expanded, a number for each q; by default the minimum of the potential downhill from the start,
        or nothing is expanded where there is none.  About any other point long steps lose their order.

    Returns
    -------
    Prepared
        A function of other initial data by name, ``run(q=…, p=…)``, that returns a `Solution`.

    Raises
    ------
    BadInput
        For an unknown name, and a value that is not allowed or does not go with the scene or the method.

    Examples
    --------
    >>> import contactbench as cb
    >>> run = cb.prepare("oscillator", "contact-strang", step=0.1, save_at=[1.0])
    >>> run(q=(0.5,)).y0[0]
    np.float64(0.5)
    """
    scene, chosen = lookup(scene, method)
    request = make_request(
        scene, chosen, step, rtol, atol, save_at, carry, engine, max_steps, switch("dense", dense)
    )
    if isinstance(request, Refused):
        return request
    if about is not None:
        if not chosen.expands:
            raise BadInput(f"about = {excerpt(about)}: {chosen.name} expands nothing about a point")
        request = replace(request, about=vector("about", about, scene.motion // 2))
    refused: list[Refused] = []
    try:
        for each in engines_of(chosen) if engine is None else (engine,):
            asked = request if each == request.engine else replace(request, engine=each)
            try:
                run = chosen.prepare(asked)
            except CannotRecord as error:
                run = uncompiled(chosen, asked, error)
            if not isinstance(run, Refused):
                return densely(chosen, asked, run) if asked.dense else run
            refused.append(run)
    except BaseException as error:
        raise blame(f"{chosen.name} on scene {scene.name!r}", error) from error.__cause__
    return refused[0]


def uncompiled(method: Method, request: Request, error: CannotRecord) -> Refused:
    what = f"{method.name} on {request.scene.name!r} cannot be compiled"
    plain = [engine for engine in method.engines if engine in CALLBACKS]
    others = "".join(f"; engine {engine!r} calls it as it is" for engine in plain)
    return Refused(method.name, request, f"{what}: {reason_of(error)}{others}")


def make_request(
    scene: Scene,
    chosen: Method,
    step: object,
    rtol: object = None,
    atol: object = None,
    save_at: object = None,
    carry: Sequence[str] | None = None,
    engine: str | None = None,
    max_steps: int | None = None,
    dense: bool = True,
) -> Request | Refused:
    """Return the checked request for the first engine; `Refused` where the method refuses the scene."""
    if engine is not None and not (isinstance(engine, str) and engine in chosen.engines):
        raise BadInput(f"engine = {excerpt(engine)}: {chosen.name} runs on {', '.join(chosen.engines)}")
    step, rtol, atol = setting_of(chosen, step, rtol, atol)
    if max_steps is None:
        budget = ADAPTIVE_MAX_STEPS if chosen.adaptive or chosen.exact else DEFAULT_MAX_STEPS
    else:
        budget = whole("max_steps", max_steps, MOST_STEPS)
    times = (
        default_times(scene, None if chosen.follows else step, budget)
        if save_at is None
        else saved_times(save_at, scene)
    )
    dense = dense and (save_at is not None or step is None)  # by default steps end at saved times
    steps = None
    if isinstance(step, np.ndarray):
        steps = step[: steps_until(step, times[times > 0])[-1]]
        step = float(steps.max())
    if times[-1] < SHORTEST_RUN:
        raise BadInput(f"the run ends at t = {times[-1]:.3g}: must be {SHORTEST_RUN:g} or later")
    engine = engine or engines_of(chosen)[0]
    request = Request(scene, engine, scene.carry(carry), times, step, rtol, atol, budget, steps, dense=dense)
    why, most = chosen.refuses(scene), chosen.largest
    if why is None and engine not in CALLBACKS and scene.motion > 2 * most:  # compiled one by one
        size = f"the {scene.motion // 2} components of scene {scene.name!r}, more than {most}"
        plain = ": take engine='python'" if "python" in chosen.engines else ""
        why = f"{chosen.name} would compile {size}, one by one{plain}"
    if why is not None:
        return Refused(chosen.name, request, why)
    require_start(scene, request.carry)
    if chosen.adaptive and atol is None and (chosen.takes_atol or chosen.own_time):
        request = request.to_scale(chosen.takes_atol)
    return request


def setting_of(
    method: Method, step: object, rtol: object, atol: object
) -> tuple[float | np.ndarray | None, float | None, float | None]:
    """Return step, or an array of them, rtol and atol, all checked."""
    name = method.name
    given = {key: v for key, v in (("step", step), ("rtol", rtol), ("atol", atol)) if v is not None}
    told = (f"{key} = {excerpt(value)}" for key, value in given.items())  # in this order
    if method.exact:
        if given:
            raise BadInput(f"{', '.join(told)}: {name} is exact and takes neither step nor tolerance")
        return None, None, None
    if method.adaptive:
        if step is not None:
            raise BadInput(f"{next(told)}: {name} chooses its own steps; give rtol")
        if rtol is None:
            raise BadInput(f"rtol is missing: {name} is adaptive; give rtol")
        if atol is not None and not method.takes_atol:
            raise BadInput(f"atol = {excerpt(atol)}: {name} takes rtol alone")
        return None, tolerance(method, rtol), None if atol is None else positive("atol", atol)
    if atol is not None:
        raise BadInput(f"atol = {excerpt(atol)}: {name} has a fixed step and takes no atol")
    if len(given) == 2:
        what = "takes one of them, a fixed step or a tolerance to choose it from"
        raise BadInput(f"{' and '.join(told)}: {name} {what}")
    if not given:
        raise BadInput(f"step is missing: {name} has a fixed step; give step, or rtol to have it chosen")
    if step is None:
        if not (method.one_step or method.follows):
            raise BadInput(f"{next(told)}: no step of {name} is chosen from a tolerance; give step")
        return None, tolerance(method, rtol), None
    plain = isinstance(step, float | int | str | bytes) or not np.iterable(step)
    return positive("step", step) if plain else steps_of(step), None, None


def tolerance(method: Method, rtol: object) -> float:
    value, (low, high) = positive("rtol", rtol), method.rtol_range
    if not low <= value <= high:
        raise BadInput(f"rtol = {value!r}: {method.name} takes {low:g} to {high:g}")
    return value


@cache
def engines_of(method: Method) -> tuple[str, ...]:
    """Return a method's engines in the order to try them: Python first where numba is told not to compile."""
    return method.engines if COMPILES else tuple(sorted(method.engines, key=lambda e: e not in CALLBACKS))


#: the keywords of `prepare`
OPTIONS = inspect.signature(prepare).parameters.keys() - {"scene", "method"}


def solve(scene: Scene | str, method: Method | str, **options: Any) -> Solution:
    """Solve a scene once, by the keywords of `prepare`.

    Parameters
    ----------
    scene, method
        As of `prepare`.
    step, rtol, atol, save_at, carry, engine, max_steps, dense, about
        As of `prepare`.

    Returns
    -------
    Solution
        The saved states, how the run ended and what it cost; a run that fails does not raise, see its `status`.

    Raises
    ------
    BadInput
        As `prepare` does, and if a given gradient is not the derivative of the potential at a saved state.

    Examples
    --------
    >>> import contactbench as cb
    >>> sol = cb.solve("oscillator", "contact-strang", step=0.1, save_at=[1.0])
    >>> sol.status.value, sol.counts.steps, sol.q.shape
    ('ok', 10, (1, 1))
    """
    for name in options.keys() - OPTIONS:
        raise BadInput(f"{name}: solve takes none: {instead(name, scene_of(scene))}")
    solution = prepare(scene, method, **options)()
    if solution.scene.has_users_functions and solution.ok:
        verify_at(solution.scene, solution.y)
    return solution


#: what `help` and notebooks show: the keywords of `prepare` with their defaults
solve.__signature__ = inspect.signature(prepare).replace(  # type: ignore[attr-defined]
    return_annotation="Solution"
)


def instead(option: str, scene: Scene) -> str:
    """Return what to write for an option that `solve` does not take."""
    if option in {"events", "dense_output", "t_eval"}:
        how = "solve_ivp(…, method=cb.scipy.Contact(method, scene), max_step=…)"
        return f"it saves states at save_at; events and dense output are SciPy's, in {how}"
    if option in {f.name for f in fields(scene)} | scene.parameters.keys():
        return f"it is the scene's: scene.with_({option}=…)"
    return f"choose from {', '.join(sorted(OPTIONS))}"
