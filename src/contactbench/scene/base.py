"""What every scene has, and the contract of one that is written anew (see `contactbench.testing.check_scene`)."""

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
from contactbench.scene.scales import at_least, in_order, known
from contactbench.trace.formula import Formula, formula

#: by how much a function of floats may differ from its formula: powers are products there
SAME = 1e-6
#: what a scene may ask to be run by
EXPERIMENTS = ("convergence", "laws", "decay_laws", "work_precision", "stability")
#: what the functions of scenes, and step maps, are called with besides the parameters
ARGUMENTS = frozenset({"self", "q", "t", "h", "xp", "y", "numbers"})
#: the step over which a user's function is tried at the start, in parts of the scene's end time
TRIED = 1e-3
#: a state of the kind of scene at hand: `State`, `DrivenState`, `BodyState`, or one of a user's own kind
OwnState = Any
#: a number, or an array of them where the state is one of arrays: the caller knows which
Numeric = Any
#: a packed state: a sequence of numbers, or an array with one component after the other along its first axis
Packed = Any
#: the sizes of the components of a motion, and of the action
Sizes = tuple[Sequence[float], float]
#: what returns the value of a field as it is kept, or raises `BadInput`; called with its name and the value given
Check = Callable[[str, object], object]


def optional(check: Check) -> Check:
    return lambda name, value: None if value is None else check(name, value)


def experiment_names(name: str, value: object) -> tuple[str, ...]:
    if isinstance(value, tuple) and all(isinstance(e, str) and e in EXPERIMENTS for e in value):
        return value
    raise BadInput(f"{name} = {excerpt(value)}: must be a tuple of names among {', '.join(EXPERIMENTS)}")


def named_numbers(name: str, value: object) -> dict[str, float]:
    if isinstance(value, Mapping) and all(isinstance(key, str) and key.isidentifier() for key in value):
        return {key: finite(key, number) for key, number in value.items()}
    raise BadInput(f"{name} = {excerpt(value)}: must be a dict of numbers by name")


def reciprocal[X](value: X) -> X:
    """Return 1/value, of each number in a tuple."""
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
    """Times since the start, where times of the scene's clock are expected."""

    times: Any


def time_between(start: float, end: float) -> float:
    """Return end − start, computed from their printed decimals: 2.05 − 0.75 is 1.3."""
    return float(Decimal(repr(end)) - Decimal(repr(start))) if start else end


def as_formula(function: Callable[..., object], sizes: tuple[int, ...], names: Iterable[str] = ()) -> Formula:
    """Return a function as a formula, itself where it is one; raise `CannotRecord` where it cannot be."""
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
    """Keep the latest `size` things made, by key; a thing whose key is None is made at every call.

    Several threads may ask at once: those that do not find a thing make it, and all get the first one made.
    """

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
    """Return the key of an item that depends on a scene or a method, and on more; None where the first is None."""
    return None if identity is None else (identity, *rest)


@cache
def written_anew(kind: type) -> str:
    """Return the names of the equations that a user's own kind of scene writes anew."""
    base = next(each for each in kind.__mro__ if is_ours(each))
    names = ("rhs", "kinetic", "dissipation", "dissipation_rate", "damping_at", "damp_matrix_function")
    return ", ".join(name for name in names if getattr(kind, name, None) is not getattr(base, name, None))


@cache
def instead() -> dict[str, str]:
    """Return what no kind of scene takes, by name, and the nearest way to it."""
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
     3. ``with_numbers(numbers())`` is the same scene; each number that has a name is changed by it in ``with_``.
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
        How long a run is, > 0.  It starts at 0, and so ends at t_end; a driven scene starts at its t.  In its place
        (and that of t) `t_span=(start, end)` is taken.
    s
        The action at the start.
    exact
        Closed form: ``exact(scene, t, xp) -> state`` with the fields it knows, others None.
    scale
        What is large of each component of the motion (q, then p; M; y), numbers > 0 as many as there are: what errors
        are parts of, and what the default atol and divergence are taken from.  By default the largest true size of
        each vector in one unit: q of one mass, p, M, R, a point of a sphere; components with masses of their own, and
        those of a `ContactSystem` or `Equations`, each by itself.
    slows_after
        The time after which the motion slows down as 1/t: steps that grow with the time suit it
        (`geometric_steps`).
    hard
        Whether only the stability experiment runs it.
    experiments
        The experiments that run it; by default all but the one of stability.

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
    experiments: tuple[str, ...] = ()

    #: the NamedTuple of its states
    state: ClassVar[Any] = None
    #: the fields that are its initial data: those of its states
    initial_fields: ClassVar[tuple[str, ...]] = ()
    #: the fields whose numbers are its parameters, in their order; those in `parameters` come last
    coefficients: ClassVar[tuple[str, ...]] = ()
    #: coefficients that are kept as reciprocals too, and under which name: compiled loops run up to twice as fast
    #: where no division is left in the right-hand side
    reciprocals: ClassVar[dict[str, str]] = {}
    #: how its fields are validated
    checks: ClassVar[dict[str, Check]] = {
        "name": text,
        "about": text,
        "slows_after": optional(positive),
        "hard": switch,
        "experiments": experiment_names,
        "exact": optional(function),
        "scale": optional(vector),
        "t_end": positive,
        "s": finite,
    }
    #: which subflows and which formulas apply
    kind: ClassVar[str] = ""
    #: the functions a user gives, and what each is called with: fields and arguments, "xp" for a namespace of
    #: numbers, "**" for the parameters by name
    functions: ClassVar[dict[str, tuple[str, ...]]] = {}
    #: optional state fields, in packing order
    optional: ClassVar[tuple[str, ...]] = ("s",)
    #: optional fields that the dynamics cannot do without
    required: ClassVar[tuple[str, ...]] = ()
    #: whether `jacobian` is written out; solvers that want one difference the right-hand side otherwise
    has_jacobian: ClassVar[bool] = True
    #: its exact subflows by name, and the two that a composition of two parts takes, in their order
    flows: ClassVar[Mapping[str, Flow]] = {}
    parts: ClassVar[tuple[str, ...]] = ()
    #: its flows for the paper's A, B and C, where they are not `drift`, `kick` and `damp`
    paper_flows: ClassVar[Mapping[str, str]] = {}
    #: whether it has an energy H0, and what stands behind the refusal of a method that wants a Hamiltonian
    has_energy: ClassVar[bool] = True
    lacks: ClassVar[str] = ""
    #: its components are numbers, coordinates q and momenta p as many of each, and η = ds − p dq
    canonical: ClassVar[bool] = False
    #: it is canonical, and H = T(p) + V(q) + Γ(s): velocities are those of p, forces those of q
    separable: ClassVar[bool] = False
    #: Γ(s) is not γ s
    nonlinear_damping: ClassVar[bool] = False
    #: what its equations or flows choose by, computed once of the numbers it was made with
    decided: ClassVar[tuple[Hashable, ...]] = ()
    #: φ_t*η = e^{−∫Γ'} η with a Γ' that is not constant
    rate_changes: ClassVar[bool] = False
    #: what is damped moves, times e^{γt}, as if undamped in the time τ = (1 − e^{−γt})/γ: see `RigidBody.decayed`
    slows_its_clock: ClassVar[bool] = False
    #: J' = −Γ'(s) J
    has_momentum_law: ClassVar[bool] = False
    #: R, where it has one, is part of the motion that runs are raced on
    attitude: ClassVar[bool] = True
    #: its states lie on a manifold that methods may drift off: see `departure`
    constrained: ClassVar[bool] = False
    #: H0 need not decay: no damping, negative damping, or damping whose sign follows the motion
    may_gain_energy: ClassVar[bool] = False

    def __new__(cls, *_: object, **given: object) -> Self:
        for name in given.keys() - cls.__dataclass_fields__.keys():
            taken = inspect.signature(cls.__init__).parameters  # a class of a user's may have its own
            if name not in taken and not any(p.kind is p.VAR_KEYWORD for p in taken.values()):
                near = instead().get(name, f"choose from {', '.join([*taken][1:])}")
                raise BadInput(f"{name}: {cls.__name__} takes none: {near}")
        return super().__new__(cls)

    def __post_init__(self) -> None:
        taken = {f.name for f in dataclasses.fields(self)} | ARGUMENTS
        wanted = f"must have a name of its own, none of {', '.join(sorted(taken))}"
        for name, check in self.checks.items():
            self._fix(name, check(name, getattr(self, name)))
        for name in getattr(self, "parameters", {}):
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
        """Raise `BadInput`, which names another way, unless a function takes what it is called with."""
        function, called = getattr(self, name), self.functions[name]
        parameters = dict(getattr(self, "parameters", {})) if "**" in called else {}
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
        extra = dict(getattr(self, "parameters", {}))
        for name in changes:
            if name not in extra and name not in allowed:
                raise unknown_name(f"parameter of scene {self.name!r}", name, [*extra, *allowed])
        named = {name: finite(name, changes.pop(name)) for name in extra if name in changes}
        if extra:
            changes = {"parameters": extra | named} | changes
        return dataclasses.replace(self, **changes)

    def _repr_html_(self) -> str:
        names = (*self.initial_fields, *self.coefficients, "t_end")
        rows = {name: excerpt(getattr(self, name)) for name in names if hasattr(self, name)}
        rows |= getattr(self, "parameters", {})
        return html_table(rows, f"{self.name}: {self.about or self.kind}")

    def numbers(self) -> list[float]:
        own = Scene.pack([getattr(self, name) for name in self.coefficients])
        return [*own, *getattr(self, "parameters", {}).values()]

    def number_names(self) -> list[str]:
        """Return the names by which `with_` knows each of `numbers`; empty where it is part of a larger parameter."""
        names: list[str] = []
        for name in self.coefficients:
            value = getattr(self, name)
            names += [""] * len(leaves(value)) if isinstance(value, tuple) else [name]
        return [*names, *getattr(self, "parameters", {})]

    def with_numbers(self, numbers: Sequence[Arithmetic]) -> Self:
        own = [getattr(self, name) for name in self.coefficients]
        changed = dict(zip(self.coefficients, rebuild(own, numbers), strict=True))
        changed |= {kept: reciprocal(changed[name]) for name, kept in self.reciprocals.items()}
        if names := list(getattr(self, "parameters", {})):
            changed["parameters"] = dict(zip(names, numbers[len(leaves(own)) :], strict=True))
        return self._replaced(**changed)

    @property
    def layout(self) -> Sequence[object]:
        """Return what the motion depends on besides functions, numbers and initial data."""
        return ()

    def orders(self) -> list[tuple[int, int, bool]]:
        """Return pairs (i, j, strict): number i is below number j, 0 being one more number, or else not above it.

        Flows are those of numbers that are; others are of another structure, or not allowed.
        """
        own = [getattr(self, name) for name in self.coefficients]
        ends = np.cumsum([0, *(len(leaves(value)) for value in own)]).tolist()
        spans = zip(self.coefficients, pairwise(ends), strict=True)
        zero = len(self.numbers())
        return [(zero, i, True) for name, span in spans if name in self.reciprocals for i in range(*span)]

    def decided_by(self, numbers: Sequence[Arithmetic]) -> Self:
        """Return the scene with other numbers, arrays too, and what they decide; `BadInput` for any not allowed."""
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
        """Return the scene with what its numbers decide anew."""
        return self

    @property
    def structure(self) -> tuple[Hashable, ...]:
        functions = (getattr(self, name) for name in self.functions)
        values = ((name, getattr(self, name)) for name in (*self.initial_fields, *self.coefficients))
        sizes = ((name, len(value) if isinstance(value, tuple) else 1) for name, value in values)
        return (self.kind, *functions, *sizes, *getattr(self, "parameters", ()), *self.decided)

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
        """Return how many leading components of a packed state are (q, p) or M: what may not leave its scale."""
        return len(self.without_clock(self.labels(())))

    @property
    def clock(self) -> int | None:
        """Return the component of the packed state that is the time, where there is one."""
        return None

    def breaks_until(self, end: float, begin: float = 0.0) -> list[tuple[float, float]]:
        """Return times since the start, from `begin` to an end, that no step straddles, and how exact they are."""
        return []

    #: the time that functions take, of the time of a state; None: that itself
    dated: ClassVar[Any] = None
    #: whether its functions take `time` of the time of a state
    keeps_dates: ClassVar[bool] = False

    @cached_property
    def begins(self) -> float:
        """Return the time at the start, 0 where there is none."""
        return 0.0 if self.clock is None else float(self.pack(self.initial(()))[self.clock])

    def time(self, t: Numeric) -> Numeric:
        """Return the time that functions take where the time of a state is t: see `since`."""
        return t if self.dated is None else self.dated(t)

    def since(self, dated: Callable[[Numeric], Numeric]) -> Self:
        """Return the scene whose states count their time from somewhere: its functions take dated(t)."""
        return self._replaced(dated=dated)

    def without_clock[X](self, y: Sequence[X]) -> Sequence[X]:
        """Return a packed state less the time, as a solver integrates it that has a time of its own."""
        return y if self.clock is None else [*y[: self.clock], *y[self.clock + 1 :]]

    def with_clock(self, y: Packed, t: Numeric) -> Sequence[Numeric]:
        """Return the packed state again."""
        return y if self.clock is None else [*y[: self.clock], t, *y[self.clock :]]

    def split_clock(self, y0: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the time at which a packed state begins, 0 where it has none, and the components less the time."""
        clock = self.clock
        if clock is None:
            return 0.0, y0
        y = y0[:clock] if clock == len(y0) - 1 else np.concatenate((y0[:clock], y0[clock + 1 :]))
        return float(y0[clock]), y

    def insert_clock(self, y: np.ndarray, start: float, times: np.ndarray | float) -> np.ndarray:
        """Return packed states, of components less the time: (k, ·) at k times since `start`, or a single one."""
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
        """Return the numbers of a packed state, an array, as `unpack` is to get them."""
        return y.tolist() if isinstance(y, np.ndarray) else list(y)

    @staticmethod
    def pack(state: Iterable[object]) -> list[Any]:
        """Return a state, numbers and tuples of them, as a flat list, fields that are not carried left out."""
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
        """Return the functions that it has, by name."""
        return {name: f for name in self.functions if (f := getattr(self, name)) is not None}

    @cached_property
    def identity(self) -> Hashable | None:
        """What compiled code depends on besides the numbers, functions by their operations; None: nobody can tell."""
        known = all(isinstance(f, Formula) or is_ours(f) for f in self.given.values())
        return self.structure if known and is_ours(type(self)) else None

    @cached_property
    def has_users_functions(self) -> bool:
        """Return whether any of its functions, or of their derivatives, is not of this package."""
        return not all(map(is_ours, self.given.values()))

    @property
    def functions_of_floats(self) -> list[str]:
        """Return the names of its user's functions that cannot be recorded, as SciPy's splines cannot."""
        theirs = (name for name, f in self.given.items() if not (is_ours(f) or isinstance(f, Formula)))
        return [name for name in theirs if self._formula(name) is None]

    @property
    def own_equations(self) -> str | None:
        """Why the flows of its kind do not solve a user's own kind, which writes equations anew; None where they do."""
        anew = written_anew(type(self))
        own = f"{type(self).__name__} has {anew} of its own"
        return f"its flows are those of {self.kind}, and {own}" if anew else None

    def recorded(self) -> Self:
        """Return the scene with its functions as formulas, where they can be; `BadInput` where the two differ."""
        if not self.has_users_functions:
            return self
        found = {name: made for name in self.functions if (made := self._formula(name)) is not None}
        return self._replaced(**found) if found else self

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle the scene with its functions recorded; `BadInput` for one that can be neither recorded nor found."""
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
        return plain, dict(getattr(self, "parameters", {})) if "**" in wanted else {}

    def _value(self, name: str) -> object:
        plain, parameters = self._start(name)
        with their_code(f"scene {self.name!r}"):
            return getattr(self, name)(*plain, **parameters)

    def _formula(self, name: str) -> Formula | None:
        """Return a user's function as a formula; None for what needs none or cannot be recorded."""
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
        return self  # nothing of it changes

    __copy__ = __deepcopy__

    # -- equations -----------------------------------------------------------------------------
    @abstractmethod
    def rhs(self, x: OwnState) -> OwnState:
        """Return the time derivative of the state, a state of the same fields."""

    def jacobian(self, x: OwnState) -> Any:
        """Return ∂(rhs)/∂(state) in packed order, or None where the scene does not have it."""
        return None

    def slopes(self, t: Numeric, y: Packed, carry: Sequence[str]) -> Sequence[Numeric]:
        """Return f(t, y) on packed components less the time: what adaptive solvers integrate, y the motion alone."""
        return self.without_clock(self.pack(self.rhs(self.unpack(self.with_clock(y, t), carry))))

    # -- units ---------------------------------------------------------------------------------
    #: components of the motion have units of their own
    mixed: ClassVar[bool] = True

    @property
    def alike(self) -> Sequence[int]:
        """Return the lengths of the vectors of the motion, each of components that share a unit."""
        return [1] * self.motion

    @property
    def vectors(self) -> Sequence[int]:
        """Return `alike`, or ones where the user gives each component a scale of its own."""
        return self.alike if self.scale is None else [1] * self.motion

    def groups(self, carry: Sequence[str]) -> list[int]:
        """Return how many components each vector of a packed state has, less the time."""
        return [*self.vectors, *[4] * ("R" in carry), *[1] * ("s" in carry)]

    @abstractmethod
    def sizes(self, x: OwnState, end: float) -> Sizes:
        """Return how large every component of the motion from x becomes until `end`, and the action: see `scales`."""

    def scales(self, x: OwnState, end: float) -> np.ndarray:
        """Return the scale of every component of a packed state but the time, from x on: see `scene.scales`.

        Where units are shared it is one where of order one.
        """
        with np.errstate(all="ignore"):
            found, action = self.sizes(x, end)
            motion = np.array(found, dtype=float)
            if self.mixed and hasattr(x, "p"):
                motion = at_least(self, x, motion)
            attitude = [1.0] * 4 if getattr(x, "R", None) is not None else []
            sizes = np.array([*motion, *attitude, *([] if x.s is None else [np.fmax(abs(x.s), action)])])
            sizes = known(sizes) if self.mixed else in_order(sizes)
            if self.scale is not None:
                sizes[: self.motion] = self.scale
            return sizes

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
        """Return the initial data that a state is, by name, as `with_` takes them."""
        return {name: value for name, value in x._asdict().items() if value is not None}

    def checked(self, data: Mapping[str, object]) -> dict[str, object]:
        """Return the initial data given by keyword, validated against the scene's own."""
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
        """Return the momentum map J of the rotations, None where there is none."""

    def hamiltonian_at(self, x: OwnState) -> Numeric:
        """Return H at a state, however a kind of scene is given it."""
        return self.hamiltonian(x)

    def momentum_at(self, x: OwnState) -> Vector | None:
        """Return J at a state, however a kind of scene is given it."""
        return self.momentum(x)

    def tangents(self, x: OwnState) -> Sequence[OwnState]:
        """Return a basis of the tangent space at x, as states: the coordinates', the time left out."""
        size = len(self.pack(x))
        carry = [name for name in self.optional if getattr(x, name) is not None]
        units = ([1.0 if i == j else 0.0 for j in range(size)] for i in range(size) if i != self.clock)
        return [self.unpack(unit, carry) for unit in units]

    def displaced[X: AnyState](self, x: X, v: X, amount: float) -> X:
        """Return the state at `amount` along a curve that leaves x with tangent v."""
        return shifted(x, amount, v)

    def departure(self, x: OwnState, start: OwnState) -> Vector:
        """Return how far x is off the manifold of states, as numbers without dimension, 0 on it."""
        return ()

    @abstractmethod
    def contact_form(self, x: OwnState, dx: OwnState) -> Numeric:
        """Return η(dx) at x."""

    @abstractmethod
    def contact_terms(self, x: OwnState, dx: OwnState) -> Numeric:
        """Return the size of the terms that η(dx) is the difference of."""

    def energy_terms(self, x: OwnState) -> Numeric:
        return abs(self.energy(x))

    @abstractmethod
    def hamiltonian_terms(self, x: OwnState) -> Numeric:
        """Return the size of the terms that H is the sum of."""

    @abstractmethod
    def momentum_terms(self, x: OwnState) -> Numeric:
        """Return the size of the terms that J is the sum of."""

    @property
    @abstractmethod
    def conformal_rate(self) -> Numeric:
        """γ when φ_t*η = e^{−γt} η holds with a constant rate, else None."""

    @property
    def is_undamped(self) -> bool:
        """Return whether there is no damping at all, as where `gamma` was left out; it is said with every run."""
        return bool(self.conformal_rate == 0)

    def damping_at(self, x: OwnState) -> Arithmetic:
        """Return ∂H/∂s at a state, the constant one where it is."""
        rate: Arithmetic = self.conformal_rate
        return rate

    def damped_by(self, x: OwnState, t: Arithmetic, xp: Namespace) -> Numeric:
        """Return ∫Γ' over the time t from x, None where it depends on the motion."""
        return None if self.conformal_rate is None else self.conformal_rate * t

    def damped_within(self, x: OwnState, h: Arithmetic, xp: Namespace) -> Numeric:
        """Return the same over a step, of any kind of number."""
        return self.damped_by(x, h, xp)

    @property
    def is_contact(self) -> bool:
        """Return whether the exact flow is a conformal contact map, with a rate that is constant or changes."""
        return self.conformal_rate is not None or self.rate_changes

    @property
    def has_hamiltonian_law(self) -> bool:
        """Return whether H' = −Γ'(s) H."""
        return self.is_contact

    @property
    def bounds_energy(self) -> bool:
        """Return whether H0 never exceeds what it was at the start."""
        return not self.may_gain_energy


#: name → scene, in table order
SCENES = Registry("scene", Scene)


def scene_of(scene: object) -> Scene:
    """Return a scene, itself or by name, its functions recorded; else raise `UnknownName` with a suggestion."""
    if isinstance(scene, str):
        scene = SCENES[scene]
    if not isinstance(scene, Scene):
        wanted = f"a scene or the name of one: {', '.join(SCENES)}"
        if callable(scene):
            wanted = "a scene; of a right-hand side f(t, y) it is cb.Equations(rhs=f, y0=…, t_end=…)"
        raise BadInput(f"scene = {excerpt(scene)}: must be {wanted}")
    return scene.recorded()
