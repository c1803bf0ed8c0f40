"""Scenes of many sites: chains, rings, bodies.  A component of their state is an array, of one number a site."""

from __future__ import annotations

import pickle
from abc import abstractmethod
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields
from functools import cached_property, lru_cache
from inspect import Parameter, signature
from itertools import pairwise
from typing import Any, ClassVar, Self

import numpy as np

from contactbench.blame import their_code
from contactbench.checks import function, real_array, whole
from contactbench.errors import BadInput, excerpt
from contactbench.numbers.functions import namespace
from contactbench.numbers.protocol import Arithmetic, CannotRecord, Namespace
from contactbench.numbers.sites import BOUNDARIES, neighbour, pairs, total
from contactbench.scene.algebra import AnyState, State, Vector, cross, dot, scaled
from contactbench.scene.base import Check, Packed, Scene, named_numbers, optional
from contactbench.scene.flow import Constants, Flow, plain, time_and_damping
from contactbench.scene.mechanical import (
    Canonical,
    Mechanical,
    damping_rate,
    drift,
    drift_damp,
)
from contactbench.trace.formula import Formula, formula
from contactbench.trace.recording import reason_of

#: sites at most: an array of so many numbers has 8 GB
MOST_SITES = 10**9
#: tangents of a larger state are a few at random, from this seed, instead of all
ALL_TANGENTS, SOME_TANGENTS, SEED = 65, 4, 2026


@lru_cache(256)
def derivative(potential: Formula) -> Formula:
    """Return the derivative by the first argument.  Raises `BadInput` where it is not known."""
    try:
        return potential.gradient()
    except CannotRecord as why:
        raise BadInput(f"a potential cannot be differentiated: {why}") from why


def many_drift(scene: Many, x: State, h: Arithmetic, xp: Namespace) -> State:
    """A on many sites, whose masses may differ."""
    return drift(scene._replaced(inverse_mass=like(scene.inverse_mass, x.p[0])), x, h, xp)


def many_drift_damp(scene: Many, x: State, constants: Constants, xp: Namespace) -> State:
    """AC on many sites, whose masses may differ."""
    phi, keep, lose = constants
    moved: State = drift_damp(scene, x, (phi * like(scene.inverse_mass, x.p[0]), phi, keep, lose), xp)
    return moved


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Many(Canonical):
    """What `Lattice` and `Particles` share: H = Σ ‖p_i‖²/2m_i + V(q) + γ s."""

    q: Any
    p: Any
    gamma: float = 0.0
    parameters: Mapping[str, float] = field(default_factory=dict)
    inverse_mass: Any = field(init=False, repr=False, default=1.0)
    #: whether all masses are one number
    uniform: bool = field(init=False, repr=False, default=True)

    kind = "many"
    by_sites = True
    flows: ClassVar[Mapping[str, Flow]] = {
        **Mechanical.flows,
        "drift": Flow(plain, many_drift, {}),
        "drift_damp": Flow(time_and_damping, many_drift_damp, {}),
    }
    parts: ClassVar[tuple[str, ...]] = ("kick", "drift_damp")
    state: ClassVar[type[AnyState]] = State
    checks: ClassVar[dict[str, Check]] = {**Scene.checks, "gamma": damping_rate, "parameters": named_numbers}
    initial_fields: ClassVar[tuple[str, ...]] = ("q", "p", "s")
    #: what is beyond the ends
    boundary: ClassVar[str] = "fixed"
    #: how many coordinates a site has
    dimensions: ClassVar[int] = 1
    #: the parameter that masses are given by
    weights: ClassVar[str] = "mass"
    #: where the potentials are tried
    probe: ClassVar[float]

    # -- what a kind of them says ----------------------------------------------------------------
    @property
    @abstractmethod
    def sites(self) -> int:
        """Return how many there are."""

    @property
    def weight(self) -> Any:
        """Return the mass: one number, or an array with one for every site."""
        return getattr(self, self.weights)

    @property
    def constants(self) -> dict[str, np.ndarray]:
        """Return the arrays of one number a site that the equations read, by the attribute they are."""
        return {} if self.uniform else {"inverse_mass": self.inverse_mass}

    @property
    def layout(self) -> Sequence[object]:
        return [self.sites, self.boundary, *self.constants.values()]

    @abstractmethod
    def unrolled(self) -> Mechanical:
        """Return the same scene component by component, for solvers that know no arrays."""

    def __post_init__(self) -> None:
        wanted = f"one number > 0, or {self.sites}"
        masses = real_array(self.weights, self.weight, wanted)
        if masses.shape not in ((), (self.sites,)):
            raise BadInput(f"{self.weights} has shape {masses.shape}: must be {wanted}")
        with np.errstate(divide="ignore", over="ignore"):
            inverse = 1 / masses
        if not (np.isfinite(masses) & np.isfinite(inverse) & (masses > 0)).all():
            least = float(masses.min())
            why = f"{self.weights}: must be > 0 and finite, and so 1/{self.weights}; the least is {least!r}"
            raise BadInput(why)
        self._fix("uniform", masses.ndim == 0)
        for name, numbers in ((self.weights, masses), ("inverse_mass", inverse)):
            self._fix(name, float(numbers) if self.uniform else frozen(numbers))
        super().__post_init__()
        self._fix("_given", {name: given for name in ("q", "p") if callable(given := getattr(self, name))})
        for name in ("q", "p"):
            self._fix(name, self._field(name, getattr(self, name)))
        self._check_functions()
        with their_code(f"scene {self.name!r}"), np.errstate(all="ignore"):
            x = self.initial(())
            start = np.array([*np.ravel(np.asarray(self.gradient_at(x))), self.potential_at(x)])
        if not np.isfinite(start).all():
            raise BadInput(f"q: the force or the potential of scene {self.name!r} is not finite at the start")

    def _check_functions(self) -> None:
        for name in self.given:
            self.recording(name)
            probes = (np.full(1, self.probe),) * (len(self.functions[name]) - 1)
            with their_code(f"scene {self.name!r}"), np.errstate(all="ignore"):
                value = self.call(name, *probes)
            if not isinstance(value, np.ndarray) or value.shape != (1,):
                why = f"{name}: must be one number that depends on its arguments; it is {excerpt(value)}"
                raise BadInput(why)
        for parameter in self.parameters:
            if not any(parameter in self.named(name) for name in self.given):
                raise BadInput(f"parameter {parameter!r}: is taken by none of {', '.join(self.given)}")

    def _field(self, name: str, given: object) -> np.ndarray:
        """Return initial data as an array of one number for every degree of freedom."""
        size = self.sites * self.dimensions
        if callable(given):
            index = np.arange(self.sites)
            with their_code(f"scene {self.name!r}"), np.errstate(all="ignore"):
                wanted = [p for p in signature(given).parameters.values() if p.default is p.empty]
                number = (self.sites,) if len(wanted) > 1 else ()
                try:
                    values = np.asarray(given(index, *number), dtype=float)
                except (TypeError, ValueError):  # of one index at a time
                    values = np.empty(0)
                if values.shape[:1] != (self.sites,):
                    values = np.array([given(int(i), *number) for i in index], dtype=float)
            given = values
        shape = f"{self.sites} × {self.dimensions} numbers" if self.dimensions > 1 else f"{size} numbers"
        values = real_array(name, given, f"{shape}, or a function of the index")
        if values.shape not in ((size,), (self.sites, self.dimensions)):
            raise BadInput(f"{name} has shape {values.shape}: must be {shape}, or a function of the index")
        if not np.isfinite(values).all():
            why = f"{name}: must be finite; entry {int(np.argmin(np.isfinite(values.ravel())))} is not"
            raise BadInput(why)
        return frozen(values.reshape(size))

    def with_(self, **changes: object) -> Self:
        """Return a copy with some parameters changed; q and p given as functions of the index follow their number."""
        if changes.keys() & {"n", "q", "p", *([self.weights] if self.dimensions > 1 else [])}:
            changes = self._given | changes  # type: ignore[attr-defined]
        return super().with_(**changes)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name}: {self.sites} sites>"

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and all(
            np.array_equal(getattr(self, f.name), getattr(other, f.name)) for f in fields(self)
        )

    __hash__ = None  # type: ignore[assignment]

    def __reduce__(self) -> tuple[object, ...]:
        twin = self._replaced(_given={name: f for name, f in self._given.items() if picklable(f)})  # type: ignore[attr-defined]
        return super(Many, twin).__reduce__()

    # -- packing -----------------------------------------------------------------------------------
    def size(self, carry: Sequence[str]) -> int:
        return self.motion + ("s" in carry)

    @property
    def motion(self) -> int:
        return 2 * self.sites * self.dimensions

    def labels(self, carry: Sequence[str]) -> list[str]:
        half = self.motion // 2
        return [f"{f}{i + 1}" for f in "qp" for i in range(half)] + [c for c in self.optional if c in carry]

    def initial(self, carry: Sequence[str], **data: object) -> State:
        values = {f: getattr(self, f) for f in self.initial_fields} | data
        s = values["s"] if "s" in carry else None
        return State(self._columns(values["q"]), self._columns(values["p"]), s)

    def _columns(self, block: Any) -> Vector:
        block = block.reshape(self.sites, self.dimensions, *block.shape[1:])
        return tuple(block[:, j] for j in range(self.dimensions))

    def unpack(self, y: Packed, carry: Sequence[str]) -> State:
        """Return a packed state, its components along the first axis, as a state of arrays."""
        block: Any = y if hasattr(y, "reshape") else np.array(y)
        half = self.motion // 2
        s = block[2 * half] if "s" in carry else None
        return State(self._columns(block[:half]), self._columns(block[half : 2 * half]), s)

    def data(self, x: State) -> dict[str, object]:
        flat = self.pack(x._replace(s=None))
        flat = flat.reshape(2, self.motion // 2, *flat.shape[1:])
        return {"q": flat[0], "p": flat[1]} | ({} if x.s is None else {"s": x.s})

    def entries(self, y: Packed) -> Packed:
        return y

    components = entries

    def pack(self, state: State) -> Any:  # type: ignore[override]
        xp = namespace(state.q[0])
        rest = xp.shape(state.q[0])[1:]
        flat = [
            part[0] if len(part) == 1 else xp.stack(part, axis=1).reshape(-1, *rest) for part in state[:2]
        ]
        if state.s is not None:
            flat.append(xp.broadcast_to(xp.asarray(state.s), rest)[None])
        return xp.concatenate(flat)

    # -- numbers -----------------------------------------------------------------------------------

    @property
    def coefficients(self) -> tuple[str, ...]:  # type: ignore[override]
        return ("gamma", self.weights) if self.uniform else ("gamma",)

    @property
    def reciprocals(self) -> dict[str, str]:  # type: ignore[override]
        return {self.weights: "inverse_mass"} if self.uniform else {}

    @property
    def structure(self) -> tuple[Hashable, ...]:
        """Return everything but the numbers; programs for arrays of one length serve no other."""
        return (*self.equations, self.sites, *(value.tobytes() for value in self.constants.values()))

    @property
    def equations(self) -> tuple[Hashable, ...]:
        """Return what is computed at a site, however many there are."""
        functions = tuple(getattr(self, name) for name in self.functions)
        return (type(self), *functions, self.dimensions, tuple(self.parameters), self.uniform)

    def named(self, name: str) -> dict[str, float]:
        """Return the parameters that one of the scalar functions takes."""
        given = getattr(self, name)
        if isinstance(given, Formula):
            return given.taken(self.parameters)
        accepted = signature(given).parameters
        every = any(p.kind is Parameter.VAR_KEYWORD for p in accepted.values())
        own = [*accepted][len(self.functions[name]) - 1 :]
        return {key: value for key, value in self.parameters.items() if every or key in own}

    def call(self, name: str, *arguments: Arithmetic) -> Any:
        return getattr(self, name)(*arguments, **self.named(name))

    def slope(self, name: str, *arguments: Arithmetic) -> Any:
        """Return its derivative by the first argument."""
        return derivative(self.recording(name))(*arguments, **self.named(name))[0]

    def recording(self, name: str) -> Formula:
        """Return one of the functions as a formula; `BadInput` where it cannot be recorded."""
        given = getattr(self, name)
        if isinstance(given, Formula):
            return given
        with their_code(f"scene {self.name!r}"):
            try:
                return formula(given, (0,) * (len(self.functions[name]) - 1), tuple(self.named(name)))
            except CannotRecord as why:
                raise BadInput(
                    f"scene {self.name!r}: its {name} cannot be recorded: {reason_of(why)}"
                ) from why

    def _formula(self, name: str) -> Formula | None:
        given = getattr(self, name)
        return None if given is None or isinstance(given, Formula) else self.recording(name)

    # -- physics -------------------------------------------------------------------------------------
    def kinetic(self, p: Vector) -> Arithmetic:
        if not self.uniform:
            return self.product(p, self.velocity(p)) / 2
        inverse_mass: Arithmetic = self.inverse_mass
        return self.product(p, p) * inverse_mass / 2

    def velocity(self, p: Vector) -> Vector:
        return scaled(self.inverse_mass if self.uniform else like(self.inverse_mass, p[0]), p)

    def product(self, a: Vector, b: Vector) -> Arithmetic:
        """Return a·b, also of one vector with each of many."""
        return total(dot([like(x, y) for x, y in zip(a, b, strict=True)], b))

    #: derivatives are by differences or dual numbers
    has_jacobian = False

    def momentum(self, x: State) -> Vector:
        """Return the total momentum; of particles in a plane or in space the angular one, one component or three."""
        if self.dimensions == 1:
            return (total(x.p[0]),)
        q, p, _ = x
        return tuple(map(total, cross(q, p) if len(q) == 3 else (q[0] * p[1] - q[1] * p[0],)))

    def momentum_terms(self, x: State) -> Arithmetic:
        """Return Σ|p_i|, of the angular momentum Σ‖q_i‖‖p_i‖."""
        if self.dimensions == 1:
            return total(abs(x.p[0]))
        return total((dot(x.q, x.q) * dot(x.p, x.p)) ** 0.5)

    def tangents(self, x: State) -> list[State]:
        """Return the coordinate basis of the tangent space; of a large one a few unit vectors at random."""
        carry = ("s",) if x.s is not None else ()
        size = self.size(carry)
        if size <= ALL_TANGENTS:
            return [self.unpack(row, carry) for row in np.eye(size)]
        some = np.random.default_rng(SEED).normal(size=(SOME_TANGENTS, size))
        return [self.unpack(row / np.linalg.norm(row), carry) for row in some]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Lattice(Many):
    """Describe a chain or ring of n sites: V = Σ onsite(q_i) + Σ bond(q_{i+1} − q_i).

    Parameters
    ----------
    name, about, t_end, s, exact, slows_after, hard, experiments
        As of `Scene`.
    n
        Sites, ≥ 2.
    boundary
        "ring"; "fixed", between two more sites that stay at 0; "free".
    onsite, bond
        ``onsite(q, **parameters)`` and ``bond(r, **parameters)``, potentials of one number, at least one of them;
        their derivatives are found by recording them.
    mass
        One number > 0, or one for every site.
    gamma
        Linear damping.
    q, p
        Coordinates and momenta at the start: n numbers each, or functions of the index 0 … n − 1, or of the index
        and n.
    parameters
        Numbers by name that the potentials take.

    Raises
    ------
    BadInput
        For n < 2, lengths that differ, a mass ≤ 0, a bond that is not finite at rest.
    """

    n: int
    boundary: str = "ring"  # type: ignore[misc]
    onsite: Callable[..., Arithmetic] | None = None
    bond: Callable[..., Arithmetic] | None = None
    mass: float | np.ndarray = 1.0

    functions: ClassVar[dict[str, tuple[str, ...]]] = dict.fromkeys(("onsite", "bond"), ("probe", "**"))
    checks: ClassVar[dict[str, Check]] = Many.checks | dict.fromkeys(functions, optional(function))
    probe: ClassVar[float] = 0.25

    def __post_init__(self) -> None:
        self._fix("n", whole("n", self.n, MOST_SITES, least=2))
        if not isinstance(self.boundary, str) or self.boundary not in BOUNDARIES:
            raise BadInput(f"boundary = {excerpt(self.boundary)}: must be one of {', '.join(BOUNDARIES)}")
        if self.onsite is None and self.bond is None:
            raise BadInput(f"scene {self.name!r}: needs an onsite potential, a bond, or both")
        super().__post_init__()

    def _check_functions(self) -> None:
        super()._check_functions()
        if self.bond is not None:
            with their_code(f"scene {self.name!r}"), np.errstate(all="ignore"):
                at_rest = self.call("bond", np.zeros(1)) + self.slope("bond", np.zeros(1))
            if not np.isfinite(at_rest).all():
                raise BadInput("bond: must be finite at rest, r = 0, with its derivative")

    @property
    def sites(self) -> int:
        return self.n

    @property
    def equations(self) -> tuple[Hashable, ...]:
        return (*super().equations, self.boundary)

    @cached_property
    def first(self) -> np.ndarray:
        """1 where there is a bond to the site before, else 0."""
        return frozen(np.array([0.0 if self.boundary == "free" else 1.0] + [1.0] * (self.n - 1)))

    @cached_property
    def last(self) -> np.ndarray:
        """1 where there is a bond to the next site, else 0."""
        return frozen(self.first[::-1].copy())

    @cached_property
    def end(self) -> np.ndarray:
        """1 at the last site, else 0."""
        return frozen(np.array([0.0] * (self.n - 1) + [1.0]))

    @property
    def constants(self) -> dict[str, np.ndarray]:
        names = {"ring": (), "fixed": ("end",), "free": ("first", "last")}[self.boundary]
        return super().constants | {name: getattr(self, name) for name in names if self.bond is not None}

    def potential_at(self, x: State) -> Arithmetic:
        (q,) = x.q
        V: Arithmetic = 0.0
        if self.onsite is not None:
            V = total(self.call("onsite", q))
        if self.bond is None:
            return V
        before = self.call("bond", q - neighbour(q, -1, self.boundary))
        if self.boundary == "ring":
            return V + total(before)
        if self.boundary == "free":
            return V + total(before * like(self.first, before))
        after = self.call("bond", neighbour(q, 1, self.boundary) - q)  # of the last site, to the wall
        return V + total(before + after * like(self.end, after))

    def gradient_at(self, x: State) -> Vector:
        (q,) = x.q
        force: Arithmetic = 0.0 if self.onsite is None else self.slope("onsite", q)
        if self.bond is None:
            return (force,)
        before = self.slope("bond", q - neighbour(q, -1, self.boundary))
        after = self.slope("bond", neighbour(q, 1, self.boundary) - q)
        if self.boundary == "free":
            before, after = before * like(self.first, before), after * like(self.last, after)
        return (force + (before - after) if self.onsite is not None else before - after,)

    @property
    def has_momentum_law(self) -> bool:  # type: ignore[override]
        """ΣP decays as e^{−γt} where nothing holds the chain."""
        return self.onsite is None and self.boundary != "fixed"

    def unrolled(self) -> Mechanical:
        onsite, bond = (getattr(self, name) and self.recording(name) for name in ("onsite", "bond"))
        return unrolled(self, Chain(onsite, bond, self.boundary))


@dataclass(frozen=True)
class Chain:
    """The potential of a chain as a function of its components."""

    onsite: Formula | None
    bond: Formula | None
    boundary: str

    def __call__(self, q: Vector, **parameters: Arithmetic) -> Arithmetic:
        V: Arithmetic = 0.0
        if self.onsite is not None:
            for c in q:
                V = V + self.onsite(c, **self.onsite.taken(parameters))
        if self.bond is None:
            return V
        ends = {"ring": (*q, q[0]), "fixed": (0.0, *q, 0.0), "free": q}[self.boundary]
        for a, b in pairwise(ends):
            V = V + self.bond(b - a, **self.bond.taken(parameters))
        return V


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Particles(Many):
    """Describe N bodies in a plane or in space, each acting on each: V = Σ_{a<b} pair(‖x_a − x_b‖², m_a, m_b).

    Parameters
    ----------
    name, about, t_end, s, exact, slows_after, hard, experiments
        As of `Scene`.
    masses
        N numbers > 0, N ≥ 2.
    dimensions
        Of a position: 1, 2 or 3.
    pair
        ``pair(r2, a, b, **parameters)``, the potential of two bodies of masses a and b at the squared distance r2.
    gamma
        Linear damping.
    q, p
        N × dimensions numbers, flat or body by body, or functions of the index.
    parameters
        Numbers by name that the potential takes.

    Raises
    ------
    BadInput
        For one body, lengths that differ, a mass ≤ 0, two bodies at one place.
    """

    masses: np.ndarray
    dimensions: int = 3  # type: ignore[misc]
    pair: Callable[..., Arithmetic]

    functions: ClassVar[dict[str, tuple[str, ...]]] = {"pair": ("probe", "probe", "probe", "**")}
    weights: ClassVar[str] = "masses"
    checks: ClassVar[dict[str, Check]] = Many.checks | {"pair": function}
    probe: ClassVar[float] = 1.25

    def __post_init__(self) -> None:
        self._fix("dimensions", whole("dimensions", self.dimensions, 3))
        if np.ndim(real_array("masses", self.masses, "a sequence of numbers")) != 1 or len(self.masses) < 2:
            raise BadInput(f"masses = {excerpt(self.masses)}: must be 2 numbers or more")
        super().__post_init__()
        places = self.q.reshape(self.sites, self.dimensions)
        if len(np.unique(places, axis=0)) < self.sites:
            raise BadInput("q: two bodies are at one place")

    @property
    def sites(self) -> int:
        return len(self.masses)

    @property
    def constants(self) -> dict[str, np.ndarray]:
        return super().constants | {"masses": self.masses}

    def potential_at(self, x: State) -> Arithmetic:
        def potential(apart: Vector, a: Arithmetic, b: Arithmetic) -> Vector:
            return (self.call("pair", dot(apart, apart), a, b),)

        return total(pairs(potential, x.q, self.masses)[0]) / 2

    def gradient_at(self, x: State) -> Vector:
        def force(apart: Vector, a: Arithmetic, b: Arithmetic) -> Vector:
            slope = 2 * self.slope("pair", dot(apart, apart), a, b)
            return tuple(slope * c for c in apart)

        return pairs(force, x.q, self.masses)

    has_momentum_law = True

    def unrolled(self) -> Mechanical:
        return unrolled(self, Bodies(self.recording("pair"), tuple(self.masses.tolist()), self.dimensions))


@dataclass(frozen=True)
class Bodies:
    """The potential of bodies as a function of their components."""

    pair: Formula
    masses: tuple[float, ...]
    dimensions: int

    def __call__(self, q: Vector, **parameters: Arithmetic) -> Arithmetic:
        d, V = self.dimensions, 0.0
        for i, a in enumerate(self.masses):
            for j, b in enumerate(self.masses[:i]):
                apart = tuple(q[d * i + k] - q[d * j + k] for k in range(d))
                V = V + self.pair(dot(apart, apart), a, b, **self.pair.taken(parameters))
        return V


def unrolled(scene: Many, potential: Callable[..., Arithmetic]) -> Mechanical:
    """Return a scene of many sites component by component."""
    masses = scene.weight
    if not scene.uniform:
        masses = tuple(np.repeat(masses, scene.dimensions).tolist())
    same = {name: getattr(scene, name) for name in ("name", "s", "gamma", "parameters", "t_end", "about")}
    q, p = (tuple(block.tolist()) for block in (scene.q, scene.p))
    return Mechanical(potential=potential, q=q, p=p, mass=masses, **same)


def picklable(f: object) -> bool:
    with suppress(Exception):
        return bool(pickle.dumps(f))
    return False


def like(f: Any, other: Any) -> Any:
    """Return a field with axes of length one, as many as another has more."""
    if not isinstance(f, np.ndarray) or f.ndim == 0 or f.ndim >= np.ndim(other):
        return f
    return f.reshape(f.shape[0], *(1,) * (np.ndim(other) - f.ndim), *f.shape[1:])


def frozen(values: np.ndarray) -> np.ndarray:
    """Return an array of our own that nobody can write to."""
    values = np.array(values, dtype=float)
    values.flags.writeable = False
    return values
