"""The base class of scenes, and the contract of a new kind (see `contactbench.testing.check_scene`)."""

from __future__ import annotations

import copyreg
import dataclasses
import inspect
import math
import pickle
import tomllib
from abc import ABCMeta, abstractmethod
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import cache, cached_property
from itertools import pairwise
from pathlib import Path
from threading import Lock
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from contactbench.blame import is_ours, their_code
from contactbench.checks import finite, function, items_of, positive, switch, text, vector
from contactbench.errors import BadInput, excerpt, unknown_name
from contactbench.notebook import html_table
from contactbench.numbers.dual import leaves, rebuild
from contactbench.numbers.protocol import Arithmetic, CannotRecord, Namespace, Vector
from contactbench.registry import Registry
from contactbench.scene.algebra import AnyState, shifted
from contactbench.scene.flow import Flow
from contactbench.scene.scales import at_least, known, larger, scale_of
from contactbench.trace.formula import Formula, formula

#: allowed relative difference between a function of floats and its formula, which computes powers by products
SAME = 1e-6
#: names of the arguments of functions of scenes and of step maps, which parameters may not have
ARGUMENTS = frozenset({"self", "q", "t", "h", "xp", "y", "numbers"})
#: the step over which a user's function is tried at the start, relative to the end time
TRIED = 1e-3
#: a state of the scene: `State`, `DrivenState`, `BodyState`, or a user's own class
OwnState = Any
#: a number, or an array if the components of the state are arrays
Numeric = Any
#: a packed state: a sequence of numbers, or an array with one component after the other along its first axis
Packed = Any
#: the sizes of the components of a motion, and of the action
Sizes = tuple[Sequence[Any], Any]
#: parameters of a kind of scene that takes none
NO_PARAMETERS: Mapping[str, float] = {}
#: a function of the name and the given value of a field that returns the value to keep, or raises `BadInput`
Check = Callable[[str, object], object]


def optional(check: Check) -> Check:
    return lambda name, value: None if value is None else check(name, value)


def durations(name: str, value: object) -> tuple[float, ...]:
    return tuple(positive(name, each) for each in items_of(name, value, "a tuple of numbers > 0"))


def named_numbers(name: str, value: object) -> dict[str, float]:
    if isinstance(value, Mapping) and all(isinstance(key, str) and key.isidentifier() for key in value):
        return {key: finite(key, number) for key, number in value.items()}
    raise BadInput(f"{name} = {excerpt(value)}: must be a dict of numbers by name")


def reciprocal[X](value: X) -> X:
    """Return 1/value, for a tuple entry by entry."""
    return rebuild(value, [1 / number for number in leaves(value)])


def with_duration(given: dict[str, Any], clocked: bool) -> dict[str, Any]:
    """Return arguments with t and t_end for `t_span=(start, end)`; clocked : whether there is a t."""
    span = given.pop("t_span", None)
    if span is None:
        return given
    if both := [name for name in ("t", "t_end") if name in given]:
        raise BadInput(f"t_span = {excerpt(span)}: say it or {' and '.join(both)}, not both")
    start, end = map(float, vector("t_span", span, 2))
    if not end > start:
        raise BadInput(f"t_span = {excerpt(span)}: must end later than it begins")
    if start and not clocked:
        raise BadInput(f"t_span = {excerpt(span)}: nothing here depends on the time: must begin at 0")
    return given | {"t_end": time_between(start, end)} | ({"t": start} if clocked else {})


class Elapsed(NamedTuple):
    """Times since the start, for arguments that are times of the scene's clock otherwise."""

    times: Any


def time_between(start: float, end: float) -> float:
    """Return end − start, computed from their printed decimals: 2.05 − 0.75 is 1.3."""
    return float(Decimal(repr(end)) - Decimal(repr(start))) if start else end


def as_formula(function: Callable[..., object], sizes: tuple[int, ...], names: Iterable[str] = ()) -> Formula:
    """Return a function as a formula; raise `CannotRecord` if it cannot be recorded."""
    return function if isinstance(function, Formula) else formula(function, sizes, tuple(names))


class Kind(ABCMeta):
    """Kinds of scene, made with `t_span=(start, end)` as well."""

    def __call__[Made](cls: Callable[..., Made], *values: Any, **given: Any) -> Made:
        clocked = "t" in getattr(cls, "__dataclass_fields__", ())
        return super().__call__(*values, **with_duration(given, clocked))  # type: ignore[misc, no-any-return]

    @property
    def __signature__(cls) -> inspect.Signature:
        own = inspect.signature(cls.__init__)  # type: ignore[misc]
        span = inspect.Parameter("t_span", inspect.Parameter.KEYWORD_ONLY, default=None)
        return own.replace(parameters=[*[*own.parameters.values()][1:], span])


class Cache[Made]:
    """Cache the latest `size` items by key, none by the key None; threads share the first item made of a key."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.items: dict[Hashable, Made] = {}
        self.alone = Lock()

    def get(self, key: Hashable | None, make: Callable[[], Made]) -> Made:
        if key is None:
            return make()
        made = self.items.get(key)
        if made is None:
            made = make()
            with self.alone:
                made = self.items.setdefault(key, made)
                if len(self.items) > self.size:
                    del self.items[next(iter(self.items))]
        return made


def key(identity: Hashable | None, *rest: Hashable) -> Hashable | None:
    """Return a cache key of an identity and further values; None if the identity is None."""
    return None if identity is None else (identity, *rest)


@cache
def written_anew(kind: type) -> str:
    """Return the names of the equations that a user's own kind of scene overrides."""
    base = next(each for each in kind.__mro__ if is_ours(each))
    names = ("rhs", "kinetic", "dissipation", "dissipation_rate", "damping_at", "damp_matrix_function")
    return ", ".join(name for name in names if getattr(kind, name, None) is not getattr(base, name, None))


@cache
def instead() -> dict[str, str]:
    """Return hints for arguments that no kind of scene takes, by name."""
    return tomllib.loads(Path(__file__).with_name("instead.toml").read_text(encoding="utf-8"))


@dataclass(frozen=True, kw_only=True)
class Scene(metaclass=Kind):
    """Describe a system with an energy, a contact Hamiltonian and a momentum map, initial data and an end time.

    A kind of scene of one's own (most need none: `Mechanical` takes any potential) writes the abstract methods
    and keeps these rules, which `contactbench.testing.check_scene` tests:

     1. It declares itself: `name`, `t_end` > 0, `initial_fields` among its own fields, `optional` those of them
        that a run may leave out.
     2. ``pack`` and ``unpack`` are each other's inverse for every choice of optional fields, in the order of
        ``labels``; a slope has the fields of its state.
     3. ``with_numbers(numbers())`` is the same scene; ``with_`` changes each number that has a name.
     4. Everything is plain arithmetic on tuples of components, without branches on values, so that it runs on
        floats, arrays, traced, recorded and mpmath numbers, with the same result.
     5. ``jacobian`` is the derivative of ``rhs``, where it `has_jacobian`.
     6. Where it `is_contact`, the right-hand side X is the contact vector field of ``hamiltonian``: η(X) = −H
        and L_X η = −Γ' η, Γ' = ∂H/∂s; a `conformal_rate` that is not None is Γ'.
     7. H0 does not grow unless it `may_gain_energy`; J' = −Γ' J where it `has_momentum_law`.
     8. ``tangents`` are a basis of the tangent space, in which the right-hand side lies;
        ``displaced`` leaves along them.
     9. ``exact``, where given, starts at the initial state and solves the equations.

    Parameters
    ----------
    name, about
        A key in tables and a word on the command line, and one line with the source.
    t_end
        The length of a run, > 0.  A run starts at 0 and ends at t_end; a driven scene starts at its t.
        `t_span=(start, end)` may replace t and t_end.
    s
        The action at the start.
    exact
        Closed form: ``exact(scene, t, xp) -> state`` with the fields it knows, others None.
    scale
        The scale of each component of the motion (q, then p; M; y), numbers > 0: errors are relative to it, and the
        default atol and the bound of divergence follow from it.  By default the largest true size of each vector with
        one unit: q with one mass, p, M, R, a point of a sphere.  Components with masses of their own, and all
        components of a `ContactSystem` or `Equations`, have separate scales.
    slows_after
        The time after which the motion slows down as 1/t, so that growing steps suit it (`geometric_steps`).
    hard
        Whether runs on it may end badly; the benchmark looks at how they end and which laws they keep.
    stiff
        Whether stability, not accuracy, limits the step of explicit methods.
    mission
        Whether the benchmark runs every method on it, with every engine.
    pace
        Time per evaluation of the benchmark's runs along the motion, from coarse to fine.  A single value is the
        coarsest (default: t_end/400); each of the others is a quarter of the one before.

    Raises
    ------
    BadInput
        For a name that is no argument, and a value that is not allowed.
    """

    name: str
    t_end: float
    s: float = 0.0
    exact: Callable[..., OwnState] | None = None
    about: str = ""
    scale: Any = None
    slows_after: float | None = None
    hard: bool = False
    stiff: bool = False
    mission: bool = False
    pace: tuple[float, ...] = ()

    #: the NamedTuple of its states
    state: ClassVar[Any] = None
    #: fields with the initial data: the fields of its states
    initial_fields: ClassVar[tuple[str, ...]] = ()
    #: fields with its parameters, in order; those in `parameters` come last
    coefficients: ClassVar[tuple[str, ...]] = ()
    #: coefficient → field with its reciprocal: compiled loops run up to twice as fast without divisions
    reciprocals: ClassVar[dict[str, str]] = {}
    #: further parameters by name, of kinds that take them
    parameters = NO_PARAMETERS
    #: field → check of its value
    checks: ClassVar[dict[str, Check]] = {
        "name": text,
        "about": text,
        "slows_after": optional(positive),
        "hard": switch,
        "stiff": switch,
        "mission": switch,
        "pace": durations,
        "exact": optional(function),
        "scale": optional(vector),
        "t_end": positive,
        "s": finite,
    }
    #: the kind of scene, which decides on the formulas that apply
    kind: ClassVar[str] = ""
    #: functions given by the user → their arguments: fields, "xp" for a namespace of numbers, "**" for parameters by
    #: name
    functions: ClassVar[dict[str, tuple[str, ...]]] = {}
    #: optional state fields, in packing order
    optional: ClassVar[tuple[str, ...]] = ("s",)
    #: optional fields that the dynamics need
    required: ClassVar[tuple[str, ...]] = ()
    #: whether `jacobian` exists; without it implicit solvers difference the right-hand side
    has_jacobian: ClassVar[bool] = True
    #: its exact subflows by name, and the subflows of a two-part composition in order
    flows: ClassVar[Mapping[str, Flow]] = {}
    parts: ClassVar[tuple[str, ...]] = ()
    #: flows for the paper's A, B and C, if they are not `drift`, `kick` and `damp`
    paper_flows: ClassVar[Mapping[str, str]] = {}
    #: whether it has an energy H0; a hint for methods that need a Hamiltonian
    has_energy: ClassVar[bool] = True
    lacks: ClassVar[str] = ""
    #: whether the state is (q, p, s) with η = ds − p dq
    canonical: ClassVar[bool] = False
    #: whether it is canonical and H = T(p) + V(q) + Γ(s)
    separable: ClassVar[bool] = False
    #: whether Γ(s) is not γ s
    nonlinear_damping: ClassVar[bool] = False
    #: choices of its equations or flows that follow from its original numbers
    decided: ClassVar[tuple[Hashable, ...]] = ()
    #: whether φ_t*η = e^{−∫Γ'} η with a Γ' that is not constant
    rate_changes: ClassVar[bool] = False
    #: whether e^{γt} times the damped variables move undamped in the time τ = (1 − e^{−γt})/γ, see `RigidBody.decayed`
    slows_its_clock: ClassVar[bool] = False
    #: whether J' = −Γ'(s) J
    has_momentum_law: ClassVar[bool] = False
    #: whether R is part of the compared motion
    attitude: ClassVar[bool] = True
    #: whether its states lie on a manifold that methods may leave, see `departure`
    constrained: ClassVar[bool] = False
    #: whether H0 may grow: no damping, negative damping, or damping of changing sign
    may_gain_energy: ClassVar[bool] = False

    def __new__(cls, *_: object, **given: object) -> Self:
        for name in given.keys() - cls.__dataclass_fields__.keys():
            taken = inspect.signature(cls.__init__).parameters  # of a subclass too
            if name not in taken and not any(p.kind is p.VAR_KEYWORD for p in taken.values()):
                near = instead().get(name, f"choose from {', '.join([*taken][1:])}")
                raise BadInput(f"{name}: {cls.__name__} takes none: {near}")
        return super().__new__(cls)

    def __post_init__(self) -> None:
        taken = {f.name for f in dataclasses.fields(self)} | ARGUMENTS
        wanted = f"must have a name of its own, none of {', '.join(sorted(taken))}"
        for name, check in self.checks.items():
            self._fix(name, check(name, getattr(self, name)))
        for name in self.parameters:
            if name in taken:
                raise BadInput(f"parameter {name!r}: {wanted}")
        for name in self.given:
            self._require_arguments(name)
        for name, kept in self.reciprocals.items():
            value = getattr(self, name)
            self._fix(kept, reciprocal(value))
            if not all(map(math.isfinite, leaves(getattr(self, kept)))):
                raise BadInput(f"{name} = {excerpt(value)}: 1/{name} must be finite")
        if (scale := self.scale) is not None and not (len(scale) == self.motion and min(scale) > 0):
            names = ", ".join(self.without_clock(self.labels(()))[: self.motion])
            raise BadInput(f"scale = {excerpt(scale)}: must be {self.motion} numbers > 0, for {names}")

    def _require_arguments(self, name: str) -> None:
        """Raise `BadInput` with a hint unless a function takes its arguments."""
        function, called = getattr(self, name), self.functions[name]
        parameters = dict(self.parameters) if "**" in called else {}
        if isinstance(function, Formula) or is_ours(function):
            return
        try:
            inspect.signature(function).bind(*(each for each in called if each != "**"), **parameters)
        except TypeError as why:
            plain = [each.removesuffix("0") for each in called if each != "**"]
            taken = [p.name for p in inspect.signature(function).parameters.values() if p.default is p.empty]
            more = [x for x in taken if x not in parameters and x not in plain]
            known = (x for x in more if f"argument {x}" in instead())
            other = next(known, taken[-1] if len(taken) > len(plain) + len(parameters) else "")
            named = f", then {', '.join(parameters)} by name" if parameters else ""
            way = instead().get(f"argument {other}", f"another is given by parameters={{{other!r}: …}}")
            says = (
                f"{name}: is called with {', '.join(plain)}{named}; it takes {', '.join(taken) or 'nothing'}"
            )
            raise BadInput(f"{says}: {way}" if other else says) from why
        except ValueError:  # a function written in C has no signature
            pass

    def _fix(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def with_(self, **changes: Any) -> Self:
        """Return a copy with some parameters changed, any of them by keyword.

        Raises `BadInput` for an unknown parameter or a value that is not allowed.
        """
        allowed = [f.name for f in dataclasses.fields(self) if f.init]
        changes = with_duration(changes, "t" in allowed)
        extra = dict(self.parameters)
        for name in changes:
            if name not in extra and name not in allowed:
                raise unknown_name(f"parameter of scene {self.name!r}", name, [*extra, *allowed])
        named = {name: finite(name, changes.pop(name)) for name in extra if name in changes}
        if extra:
            changes = {"parameters": extra | named} | changes
        return dataclasses.replace(self, **changes)

    def values(self) -> dict[str, Any]:
        """Return its initial data, coefficients, end time and parameters, to be shown."""
        names = (*self.initial_fields, *self.coefficients, "t_end")
        shown: dict[str, Any] = {name: excerpt(getattr(self, name)) for name in names if hasattr(self, name)}
        return {**shown, **self.parameters}

    def _repr_html_(self) -> str:
        return html_table(self.values(), f"{self.name}: {self.about or self.kind}")

    def numbers(self) -> list[float]:
        own = Scene.pack([getattr(self, name) for name in self.coefficients])
        return [*own, *self.parameters.values()]

    def number_names(self) -> list[str]:
        """Return the names of `numbers` in `with_`; empty for a number inside a tuple."""
        names: list[str] = []
        for name in self.coefficients:
            value = getattr(self, name)
            names += [""] * len(leaves(value)) if isinstance(value, tuple) else [name]
        return [*names, *self.parameters]

    def with_numbers(self, numbers: Sequence[Arithmetic]) -> Self:
        own = [getattr(self, name) for name in self.coefficients]
        changed = dict(zip(self.coefficients, rebuild(own, numbers), strict=True))
        changed |= {kept: reciprocal(changed[name]) for name, kept in self.reciprocals.items()}
        if names := list(self.parameters):
            changed["parameters"] = dict(zip(names, numbers[len(leaves(own)) :], strict=True))
        return self._replaced(**changed)

    @property
    def layout(self) -> Sequence[object]:
        """Return further data on which the motion depends."""
        return ()

    def orders(self) -> list[tuple[int, int, bool]]:
        """Return the order that its numbers must keep, as (i, j, strict): number i < number j, or ≤; 0 comes last."""
        own = [getattr(self, name) for name in self.coefficients]
        ends = np.cumsum([0, *(len(leaves(value)) for value in own)]).tolist()
        spans = zip(self.coefficients, pairwise(ends), strict=True)
        zero = len(self.numbers())
        return [(zero, i, True) for name, span in spans if name in self.reciprocals for i in range(*span)]

    def decided_by(self, numbers: Sequence[Arithmetic]) -> Self:
        """Return the scene with other numbers, or arrays, and the choices they decide, or raise `BadInput`."""
        own, ends = [getattr(self, name) for name in self.coefficients], []
        for end in (np.min, np.max):
            extreme = [float(end(np.asarray(number))) for number in numbers]
            for name, value in zip(self.coefficients, rebuild(own, extreme), strict=True):
                self.checks.get(name, lambda *_: None)(name, value)
            ends.append(self.with_numbers(extreme)._decide())
        least, most = ends
        if least.decided != most.decided:
            both = f"{least.numbers()} and {most.numbers()}"
            raise BadInput(f"numbers: {both} make two problems of scene {self.name!r}: one call for each")
        return least.with_numbers(numbers)

    def _decide(self) -> Self:
        """Return the scene with the choices that its numbers decide."""
        return self

    @property
    def structure(self) -> tuple[Hashable, ...]:
        functions = (getattr(self, name) for name in self.functions)
        values = ((name, getattr(self, name)) for name in (*self.initial_fields, *self.coefficients))
        sizes = ((name, len(value) if isinstance(value, tuple) else 1) for name, value in values)
        return (self.kind, *functions, *sizes, *self.parameters, *self.decided)

    # -- packing -------------------------------------------------------------------------------
    def carry(self, names: Sequence[str] | None = None) -> tuple[str, ...]:
        """Return the optional fields to integrate, validated; None means all the scene has."""
        if names is None:
            return self.optional
        what = ", ".join(self.optional) or "nothing: this scene has no optional fields"
        wanted = f"names of fields; scene {self.name!r} can carry {what}"
        given = [names] if isinstance(names, str) else items_of("carry", names, wanted)
        if not all(isinstance(name, str) and name in self.optional for name in given):
            raise BadInput(f"carry = {excerpt(names)}: must be {wanted}")
        return tuple(name for name in self.optional if name in given or name in self.required)

    @cached_property
    def motion(self) -> int:
        """Return the number of leading components of a packed state, (q, p) or M, that must stay within their scale."""
        return len(self.without_clock(self.labels(())))

    @property
    def clock(self) -> int | None:
        """Return the index of the time in the packed state, or None."""
        return None

    def breaks_until(self, end: float, begin: float = 0.0) -> list[tuple[float, float]]:
        """Return the breaks between `begin` and `end` as times since the start, each with its uncertainty."""
        return []

    #: function from the time of a state to the time that functions take; None for the identity
    dated: ClassVar[Any] = None
    #: whether its functions depend on the time, by `time`
    keeps_dates: ClassVar[bool] = False

    @cached_property
    def begins(self) -> float:
        """Return the time at the start, 0 without a clock."""
        return 0.0 if self.clock is None else float(self.pack(self.initial(()))[self.clock])

    def time(self, t: Numeric) -> Numeric:
        """Return the time that functions take for a state at the time t, see `since`."""
        return t if self.dated is None else self.dated(t)

    def since(self, dated: Callable[[Numeric], Numeric]) -> Self:
        """Return the scene with a function from the time of a state to the time that functions take."""
        return self._replaced(dated=dated)

    def without_clock[X](self, y: Sequence[X]) -> Sequence[X]:
        """Return a packed state without the time, for solvers that keep the time themselves."""
        return y if self.clock is None else [*y[: self.clock], *y[self.clock + 1 :]]

    def with_clock(self, y: Packed, t: Numeric) -> Sequence[Numeric]:
        """Return a packed state with the time inserted."""
        return y if self.clock is None else [*y[: self.clock], t, *y[self.clock :]]

    def split_clock(self, y0: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the time of a packed state, 0 without a clock, and the other components."""
        clock = self.clock
        if clock is None:
            return 0.0, y0
        y = y0[:clock] if clock == len(y0) - 1 else np.concatenate((y0[:clock], y0[clock + 1 :]))
        return float(y0[clock]), y

    def insert_clock(self, y: np.ndarray, start: float, times: np.ndarray | float) -> np.ndarray:
        """Return packed states with the time start + times inserted, (k, ·), or a single state."""
        clock = self.clock
        if clock is None:
            return y
        packed = np.empty((*y.shape[:-1], y.shape[-1] + 1))  # a tenth of the time of np.insert
        packed[..., :clock], packed[..., clock + 1 :] = y[..., :clock], y[..., clock:]
        packed[..., clock] = start + times
        return packed

    @abstractmethod
    def unpack(self, y: Packed, carry: Sequence[str]) -> OwnState:
        """Return a packed state as a NamedTuple of components."""

    def entries(self, y: Packed) -> Sequence[Numeric]:
        """Return a packed state as a sequence for `unpack`."""
        return y.tolist() if isinstance(y, np.ndarray) else list(y)

    @staticmethod
    def pack(state: Iterable[object]) -> list[Any]:
        """Return a state as a flat list, without fields that are not carried."""
        flat: list[Any] = []
        for each in state:
            if isinstance(each, tuple):
                flat.extend(each)
            elif each is not None:
                flat.append(each)
        return flat

    # -- numbers -------------------------------------------------------------------------------
    @property
    def given(self) -> dict[str, Callable[..., object]]:
        """Return its functions by name."""
        return {name: f for name in self.functions if (f := getattr(self, name)) is not None}

    @cached_property
    def identity(self) -> Hashable | None:
        """Return a key for everything but the numbers that compiled code depends on; None if that is not known."""
        known = all(isinstance(f, Formula) or is_ours(f) for f in self.given.values())
        return self.structure if known and is_ours(type(self)) else None

    @cached_property
    def has_users_functions(self) -> bool:
        """Return whether any of its functions or their derivatives comes from a user."""
        return not all(map(is_ours, self.given.values()))

    @property
    def functions_of_floats(self) -> list[str]:
        """Return the names of user functions that cannot be recorded, such as SciPy's splines."""
        theirs = (name for name, f in self.given.items() if not (is_ours(f) or isinstance(f, Formula)))
        return [name for name in theirs if self._formula(name) is None]

    @property
    def own_equations(self) -> str | None:
        """Return why the flows of its kind do not solve it (a subclass overrides equations), or None."""
        anew = written_anew(type(self))
        own = f"{type(self).__name__} has {anew} of its own"
        return f"its flows are those of {self.kind}, and {own}" if anew else None

    def recorded(self) -> Self:
        """Return the scene with its functions as formulas, where possible; raise `BadInput` if the two differ."""
        if not self.has_users_functions:
            return self
        found = {name: made for name in self.functions if (made := self._formula(name)) is not None}
        return self._replaced(**found) if found else self

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle the scene with recorded functions; raise `BadInput` for one that cannot be pickled."""
        scene = self.recorded()
        for name in (*self.functions, "exact"):
            try:
                pickle.dumps(function := getattr(scene, name, None))
            except Exception as error:
                raise BadInput(
                    f"scene {self.name!r}: its {name} {excerpt(function)} cannot be pickled: it must be a function "
                    "that can be recorded, or stand at the top of a module"
                ) from error
        return copyreg.__newobj__, (type(self),), scene.__dict__  # type: ignore[attr-defined]

    def _start(self, name: str) -> tuple[list[object], dict[str, float]]:
        given, wanted = {"xp": math, "h": TRIED * self.t_end}, self.functions[name]
        plain = [given[each] if each in given else getattr(self, each) for each in wanted if each != "**"]
        return plain, dict(self.parameters) if "**" in wanted else {}

    def _value(self, name: str) -> object:
        plain, parameters = self._start(name)
        with their_code(f"scene {self.name!r}"):
            return getattr(self, name)(*plain, **parameters)

    def _formula(self, name: str) -> Formula | None:
        """Return a user's function as a formula; None if it needs none or cannot be recorded."""
        function = getattr(self, name)
        if function is None or isinstance(function, Formula) or is_ours(function):
            return None
        plain, parameters = self._start(name)
        shape = tuple("xp" if v is math else len(v) if isinstance(v, tuple) else 0 for v in plain)
        with their_code(f"scene {self.name!r}"):
            try:
                made = formula(function, shape, tuple(parameters))
            except CannotRecord:
                return None
            try:
                now, then = (leaves(f(*plain, **parameters)) for f in (function, made))
            except (ArithmeticError, ValueError):  # Python's way to say inf or nan
                return made
        for a, b in zip(now, then, strict=True):
            if abs(a - b) > SAME * max(abs(a), abs(b)):
                raise BadInput(
                    f"scene {self.name!r}: its {name} is {excerpt(a)} of floats and {excerpt(b)} of other numbers at "
                    "the start: a function may not depend on the kind of number, on chance or on its own calls"
                )
        return made

    def _replaced(self, **attributes: object) -> Self:
        twin = object.__new__(type(self))
        twin.__dict__.update(self.__dict__ | attributes)
        for derived in ("identity", "has_users_functions", "motion", "begins"):
            twin.__dict__.pop(derived, None)
        return twin

    def __deepcopy__(self, memo: object = None) -> Self:
        return self  # it is immutable

    __copy__ = __deepcopy__

    # -- equations -----------------------------------------------------------------------------
    @abstractmethod
    def rhs(self, x: OwnState) -> OwnState:
        """Return the time derivative of the state, a state of the same fields."""

    def bend(self, x: OwnState, f: OwnState) -> Sequence[Numeric] | None:
        """Return the packed second derivatives of the state with slope f, nan where not known; None if unknown."""
        return None

    def settled(self, y: np.ndarray, carry: Sequence[str]) -> np.ndarray:
        """Return packed states (k, d) near the manifold of states, on it."""
        return y

    def jacobian(self, x: OwnState) -> Any:
        """Return ∂(rhs)/∂(state) in packed order, or None."""
        return None

    def slopes(self, t: Numeric, y: Packed, carry: Sequence[str]) -> Sequence[Numeric]:
        """Return f(t, y) on packed components without the time, for solvers that keep the time."""
        return self.without_clock(self.pack(self.rhs(self.unpack(self.with_clock(y, t), carry))))

    # -- units ---------------------------------------------------------------------------------
    #: whether components of the motion have units of their own
    mixed: ClassVar[bool] = True

    @property
    def alike(self) -> Sequence[int]:
        """Return the lengths of the vectors of the motion whose components share a unit."""
        return [1] * self.motion

    @property
    def vectors(self) -> Sequence[int]:
        """Return `alike`, or ones if the user gives a scale for each component."""
        return self.alike if self.scale is None else [1] * self.motion

    def groups(self, carry: Sequence[str]) -> list[int]:
        """Return the lengths of all vectors of a packed state without the time."""
        return [*self.vectors, *[4] * ("R" in carry), *[1] * ("s" in carry)]

    @abstractmethod
    def sizes(self, x: OwnState, end: float) -> Sizes:
        """Return estimates of the largest components, and of the action, of the motion from x until `end`."""

    def scales(self, x: OwnState, end: float) -> np.ndarray:
        """Return the scale of every packed component but the time for the motion from x, see `scene.scales`."""
        with np.errstate(all="ignore"):
            if not self.mixed:
                return np.array(self.scales_in(x, end, math), dtype=float)
            motion, rest = self._sizes(x, end, math)
            if hasattr(x, "p"):
                motion = at_least(self, x, np.array(motion, dtype=float)).tolist()
            sizes = known(np.array([*motion, *rest], dtype=float))
            if self.scale is not None:
                sizes[: self.motion] = self.scale
            return sizes

    def scales_in(self, x: OwnState, end: Arithmetic, xp: Namespace) -> list[Arithmetic]:
        """Return the scales of components that share units, in numbers of any kind."""
        motion, rest = self._sizes(x, end, xp)
        scales = [scale_of(size, xp) for size in (*motion, *rest)]
        return scales if self.scale is None else [*self.scale, *scales[self.motion :]]

    def _sizes(self, x: OwnState, end: Any, xp: Namespace) -> tuple[Sequence[Any], list[Any]]:
        """Return the sizes of the motion, and those of R and s where they are carried."""
        motion, action = self.sizes(x, end)
        attitude = [1.0] * 4 if getattr(x, "R", None) is not None else []
        return motion, attitude if x.s is None else [*attitude, larger(abs(x.s), action, xp)]

    def fields_in(self, carry: Sequence[str]) -> list[str]:
        defaults = self.state._field_defaults
        return [name for name in self.initial_fields if name in carry or name not in defaults]

    def labels(self, carry: Sequence[str]) -> list[str]:
        found: list[str] = []
        for name in self.fields_in(carry):
            value = getattr(self, name)
            found += [f"{name}{i + 1}" for i in range(len(value))] if isinstance(value, tuple) else [name]
        return found

    def initial(self, carry: Sequence[str], **data: object) -> OwnState:
        values = {name: getattr(self, name) for name in self.initial_fields} | data
        vectors = {name for name in values if isinstance(getattr(self, name), tuple)}
        kept = self.fields_in(carry)
        return self.state(**{name: tuple(values[name]) if name in vectors else values[name] for name in kept})

    def data(self, x: OwnState) -> dict[str, object]:
        """Return a state as initial data by name, for `with_`."""
        return {name: value for name, value in x._asdict().items() if value is not None}

    def checked(self, data: Mapping[str, object]) -> dict[str, object]:
        """Return all initial data, with validated changes by keyword."""
        for key in data:
            if key not in self.initial_fields:
                raise unknown_name(f"initial value of scene {self.name!r}", key, self.initial_fields)
        changed = self.with_(**data) if data else self
        return {name: getattr(changed, name) for name in self.initial_fields}

    # -- physics -------------------------------------------------------------------------------
    @abstractmethod
    def energy(self, x: OwnState) -> Numeric:
        """Return the mechanical energy H0."""

    @abstractmethod
    def hamiltonian(self, x: OwnState) -> Numeric:
        """Return the contact Hamiltonian H = H0 + Γ(s); needs s."""

    @abstractmethod
    def momentum(self, x: OwnState) -> Vector | None:
        """Return the momentum map J of the rotations, or None."""

    def hamiltonian_at(self, x: OwnState) -> Numeric:
        """Return H at a state; a kind may define `hamiltonian` otherwise."""
        return self.hamiltonian(x)

    def momentum_at(self, x: OwnState) -> Vector | None:
        """Return J at a state; a kind may define `momentum` otherwise."""
        return self.momentum(x)

    def tangents(self, x: OwnState) -> Sequence[OwnState]:
        """Return a basis of the tangent space at x as states: unit vectors, without the time."""
        size = len(self.pack(x))
        carry = [name for name in self.optional if getattr(x, name) is not None]
        units = ([1.0 if i == j else 0.0 for j in range(size)] for i in range(size) if i != self.clock)
        return [self.unpack(unit, carry) for unit in units]

    def displaced[X: AnyState](self, x: X, v: X, amount: float) -> X:
        """Return the state at `amount` along a curve that leaves x with tangent v."""
        return shifted(x, amount, v)

    def departure(self, x: OwnState, start: OwnState) -> Vector:
        """Return dimensionless distances of x from the manifold of states."""
        return ()

    @abstractmethod
    def contact_form(self, x: OwnState, dx: OwnState) -> Numeric:
        """Return η(dx) at x."""

    @abstractmethod
    def contact_terms(self, x: OwnState, dx: OwnState) -> Numeric:
        """Return the size of the terms of η(dx)."""

    def energy_terms(self, x: OwnState) -> Numeric:
        return abs(self.energy(x))

    @abstractmethod
    def hamiltonian_terms(self, x: OwnState) -> Numeric:
        """Return the size of the terms of H."""

    @abstractmethod
    def momentum_terms(self, x: OwnState) -> Numeric:
        """Return the size of the terms of J."""

    @property
    @abstractmethod
    def conformal_rate(self) -> Numeric:
        """Return γ if φ_t*η = e^{−γt} η with a constant rate, else None."""

    @property
    def is_undamped(self) -> bool:
        """Return whether there is no damping at all, which every run reports."""
        return bool(self.conformal_rate == 0)

    def damping_at(self, x: OwnState) -> Arithmetic:
        """Return ∂H/∂s at a state."""
        rate: Arithmetic = self.conformal_rate
        return rate

    def damped_by(self, x: OwnState, t: Arithmetic, xp: Namespace) -> Numeric:
        """Return ∫Γ' over the time t from x; None if it depends on the motion."""
        return None if self.conformal_rate is None else self.conformal_rate * t

    def damped_within(self, x: OwnState, h: Arithmetic, xp: Namespace) -> Numeric:
        """Return the same over a step, for any kind of numbers."""
        return self.damped_by(x, h, xp)

    @property
    def is_contact(self) -> bool:
        """Return whether the exact flow is a conformal contact map, with any rate."""
        return self.conformal_rate is not None or self.rate_changes

    @property
    def has_hamiltonian_law(self) -> bool:
        """Return whether H' = −Γ'(s) H."""
        return self.is_contact

    @property
    def bounds_energy(self) -> bool:
        """Return whether H0 never exceeds its value at the start."""
        return not self.may_gain_energy


#: name → scene, in table order
SCENES = Registry("scene", Scene)


def scene_of(scene: object) -> Scene:
    """Return a scene, given itself or by name, with recorded functions; raise `UnknownName` with a suggestion."""
    if isinstance(scene, str):
        scene = SCENES[scene]
    if not isinstance(scene, Scene):
        wanted = f"a scene or the name of one: {', '.join(SCENES)}"
        if callable(scene):
            wanted = "a scene; of a right-hand side f(t, y) it is cb.Equations(rhs=f, y0=…, t_end=…)"
        raise BadInput(f"scene = {excerpt(scene)}: must be {wanted}")
    return scene.recorded()
