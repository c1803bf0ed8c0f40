"""Scenes: what is solved.

A scene is its energy, force and right-hand side, written once as plain arithmetic on tuples of
components.  The same functions run on Python floats, NumPy arrays (one array per component: an
ensemble), JAX tracers, mpmath numbers and heyoka expressions, because every number a scene holds
can be replaced (`Scene.with_numbers`) by a number of another kind.

Conventions: contact form η = ds − p·dq, contact Hamiltonian H = H0 + Γ(s), Γ(s) = γ s + ½ κ s²;
q' = ∂H/∂p, p' = −∂H/∂q − p Γ'(s), s' = p·∂H/∂p − H  (paper, eq. canonical-contact-equations).
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from contactbench.errors import BadInput, finite, positive, unknown_name, vector

Vector = tuple[Any, ...]


class State(NamedTuple):
    """State of a mechanical scene: q and p are n-tuples, s a number or None when not carried."""

    q: Vector
    p: Vector
    s: Any = None


class BodyState(NamedTuple):
    """State of a rigid body: body momentum M, attitude R as a quaternion (w, x, y, z), and s.

    R and s are None when not carried.
    """

    M: Vector
    R: Vector | None = None
    s: Any = None


def shifted(x: Any, h: Any, slope: Any) -> Any:
    """x + h·slope, component by component, fields that are not carried left alone."""
    parts: list[Any] = []
    for part, rate in zip(x, slope, strict=True):
        if isinstance(part, tuple):
            parts.append(tuple(a + h * b for a, b in zip(part, rate, strict=True)))
        else:
            parts.append(None if part is None else part + h * rate)
    return type(x)(*parts)


def dot(a: Sequence[Any], b: Sequence[Any]) -> Any:
    """a·b, summed left to right."""
    total = a[0] * b[0]
    for x, y in zip(a[1:], b[1:], strict=True):
        total = total + x * y
    return total


def cross(a: Vector, b: Vector) -> Vector:
    """a × b in R³."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def quaternion_product(a: Vector, b: Vector) -> Vector:
    """Hamilton product a ⊗ b of quaternions (w, x, y, z)."""
    w = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    y = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    z = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]
    return (w, x, y, z)


def rotation_matrix(R: Vector) -> tuple[Vector, Vector, Vector]:
    """The 3×3 matrix of a quaternion.

    Homogeneous of degree two and deliberately not normalised: what a solver lets drift in the
    quaternion's length shows up in RᵀR − 1 and in J = R M, as it would with a drifting matrix.
    """
    w, x, y, z = R
    return (
        (w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z),
    )


def rotate(R: Vector, v: Vector) -> Vector:
    """R v for an attitude quaternion R."""
    return tuple(dot(row, v) for row in rotation_matrix(R))


def quaternion_of(value: Any) -> Vector:
    """An attitude given as 1 (identity), a unit quaternion or a rotation matrix, as a quaternion."""
    if np.ndim(value) == 0 and value == 1:
        return (1.0, 0.0, 0.0, 0.0)
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape == (4,) and abs(np.linalg.norm(array) - 1) < 1e-12:
        return tuple(array.tolist())
    if array.shape == (3, 3) and np.allclose(array.T @ array, np.eye(3), rtol=0, atol=1e-12):
        from scipy.spatial.transform import Rotation

        if np.linalg.det(array) > 0:
            return tuple(Rotation.from_matrix(array).as_quat(scalar_first=True).tolist())
    raise BadInput(f"R = {value!r}: must be 1, a unit quaternion (w, x, y, z) or a 3×3 rotation matrix")


@dataclass(frozen=True, kw_only=True)
class Scene:
    """What every scene has: a name, initial data, an end time, and numbers that can be replaced."""

    name: str
    t_end: float
    s: float = 0.0
    #: closed form: ``exact(scene, t, xp) -> state`` with the fields it knows, others None
    exact: Callable[[Any, Any, Any], Any] | None = None
    about: str = ""
    #: only the stability experiment runs it
    hard: bool = False

    #: optional state fields, in packing order
    optional: ClassVar[tuple[str, ...]] = ("s",)
    initial_fields: ClassVar[tuple[str, ...]] = ()

    def with_(self, **changes: Any) -> Self:
        """A copy with some parameters changed, any of them by keyword.

        Raises `BadInput` for an unknown parameter or a value that is not allowed.
        """
        allowed = [f.name for f in dataclasses.fields(self) if f.init]
        extra = dict(getattr(self, "parameters", {}))
        fields: dict[str, Any] = {}
        for key, value in changes.items():
            if key in extra:
                extra[key] = finite(key, value)
            elif key in allowed:
                fields[key] = value
            else:
                raise unknown_name(f"parameter of scene {self.name!r}", key, [*extra, *allowed])
        if extra and "parameters" not in fields:
            fields["parameters"] = extra
        return dataclasses.replace(self, **fields)

    # -- packing -------------------------------------------------------------------------------
    def carry(self, names: Sequence[str] | None = None) -> tuple[str, ...]:
        """The optional fields to integrate, validated; None means all the scene has."""
        if names is None:
            return self.optional
        names = (names,) if isinstance(names, str) else tuple(names)
        for name in names:
            if name not in self.optional:
                what = ", ".join(self.optional) or "nothing: this scene has no optional fields"
                raise BadInput(f"carry = {names!r}: scene {self.name!r} can carry {what}")
        return tuple(name for name in self.optional if name in names or name in self.required)

    @property
    def required(self) -> tuple[str, ...]:
        """Optional fields the dynamics cannot do without."""
        return ()

    def labels(self, carry: Sequence[str]) -> list[str]:
        """Component names of the packed state, in order."""
        raise NotImplementedError

    @property
    def motion(self) -> int:
        """How many leading components of a packed state are (q, p) or M: what may not leave its scale."""
        return len(self.labels(()))

    def initial(self, carry: Sequence[str], **data: Any) -> Any:
        """The initial state; `data` overrides the scene's own initial values."""
        raise NotImplementedError

    def unpack(self, y: Sequence[Any], carry: Sequence[str]) -> Any:
        """A packed state as a NamedTuple of components."""
        raise NotImplementedError

    @staticmethod
    def pack(state: Any) -> list[Any]:
        """A state as a flat list, fields that are not carried left out."""
        flat: list[Any] = []
        for part in state:
            if isinstance(part, tuple):
                flat.extend(part)
            elif part is not None:
                flat.append(part)
        return flat

    def checked(self, data: Mapping[str, Any]) -> dict[str, Any]:
        """Initial data given by keyword, validated against the scene's own."""
        for key in data:
            if key not in self.initial_fields:
                raise unknown_name(f"initial value of scene {self.name!r}", key, self.initial_fields)
        if not data:
            return {f: getattr(self, f) for f in self.initial_fields}
        changed = self.with_(**data)
        return {f: getattr(changed, f) for f in self.initial_fields}

    # -- numbers -------------------------------------------------------------------------------
    def numbers(self) -> list[float]:
        """The scene's parameters as a flat list (initial data and end time are not among them)."""
        raise NotImplementedError

    def number_names(self) -> list[str]:
        """What `with_` calls each of `numbers`; empty where it is part of a larger parameter."""
        raise NotImplementedError

    def with_numbers(self, numbers: Sequence[Any]) -> Self:
        """The same scene with its parameters replaced, unchecked: tracers, mpmath numbers, …"""
        raise NotImplementedError

    @property
    def structure(self) -> tuple[Any, ...]:
        """What compiled code depends on: everything but the numbers."""
        raise NotImplementedError

    def _replaced(self, **attributes: Any) -> Self:
        twin = copy.copy(self)
        for key, value in attributes.items():
            object.__setattr__(twin, key, value)
        return twin

    # -- physics -------------------------------------------------------------------------------
    def rhs(self, x: Any) -> Any:
        """Time derivative of the state, a state of the same fields."""
        raise NotImplementedError

    def energy(self, x: Any) -> Any:
        """Mechanical energy H0."""
        raise NotImplementedError

    def hamiltonian(self, x: Any) -> Any:
        """Contact Hamiltonian H = H0 + Γ(s); needs s."""
        raise NotImplementedError

    def jacobian(self, x: Any) -> Any:
        """∂(rhs)/∂(state) in packed order, or None where the scene does not provide it."""
        raise NotImplementedError

    def momentum(self, x: Any) -> Vector | None:
        """Momentum map J of the rotations, None where there is none."""
        raise NotImplementedError

    def tangents(self, x: Any) -> list[Any]:
        """A basis of the tangent space at x, as states."""
        raise NotImplementedError

    def contact_form(self, x: Any, dx: Any) -> Any:
        """η(dx) at x."""
        raise NotImplementedError

    @property
    def conformal_rate(self) -> Any:
        """γ when φ_t*η = e^{−γt} η holds with a constant rate, else None."""
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class Mechanical(Scene):
    """H = ‖p‖²/2m + V(q) + γ s + ½ κ s² on T*Rⁿ × R.

    potential : ``V(q, **parameters) -> number``; gradient : ``dV(q, **parameters) -> n-tuple``;
    hessian : ``(q, **parameters) -> n×n`` nested tuples, or None (solvers then difference).
    q, p : n numbers; gamma, kappa : damping (κ ≠ 0 makes s part of the dynamics); mass > 0.
    rotation_invariant : V(Rq) = V(q), so that the angular momentum obeys J' = −Γ'(s) J.
    Raises `BadInput` for lengths that differ, values that are not finite, mass ≤ 0, t_end ≤ 0.
    """

    potential: Callable[..., Any]
    gradient: Callable[..., Vector]
    q: Vector
    p: Vector
    gamma: float = 0.0
    kappa: float = 0.0
    mass: float = 1.0
    hessian: Callable[..., Any] | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    rotation_invariant: bool = False
    #: kept so that no division is left in the right-hand side: compiled loops run up to twice as fast
    inverse_mass: Any = field(init=False, repr=False, default=1.0)

    initial_fields: ClassVar[tuple[str, ...]] = ("q", "p", "s")

    def __post_init__(self) -> None:
        fix = object.__setattr__
        fix(self, "q", vector("q", self.q))
        fix(self, "p", vector("p", self.p))
        if len(self.q) != len(self.p):
            raise BadInput(f"q has {len(self.q)} components and p {len(self.p)}: they must agree")
        for name in ("gamma", "kappa", "s"):
            fix(self, name, finite(name, getattr(self, name)))
        fix(self, "mass", positive("mass", self.mass))
        fix(self, "inverse_mass", 1 / self.mass)
        fix(self, "t_end", positive("t_end", self.t_end))
        fix(self, "parameters", {k: finite(k, v) for k, v in self.parameters.items()})
        self._check_dimension()

    def _check_dimension(self) -> None:
        try:
            force = self.gradient(self.q, **self.parameters)
        except ZeroDivisionError:
            raise BadInput(f"q = {self.q!r}: the force of scene {self.name!r} is singular there") from None
        except (ValueError, IndexError, TypeError) as error:
            raise BadInput(
                f"q = {self.q!r}: wrong for scene {self.name!r}, whose gradient says: {error}"
            ) from None
        if len(force) != len(self.q):
            raise BadInput(f"q = {self.q!r}: scene {self.name!r} needs {len(force)} components")

    @property
    def required(self) -> tuple[str, ...]:
        return ("s",) if self.kappa else ()

    def labels(self, carry: Sequence[str]) -> list[str]:
        n = len(self.q)
        names = [f"q{i + 1}" for i in range(n)] + [f"p{i + 1}" for i in range(n)]
        return names + [c for c in self.optional if c in carry]

    def initial(self, carry: Sequence[str], **data: Any) -> State:
        values = {f: getattr(self, f) for f in self.initial_fields} | data
        return State(tuple(values["q"]), tuple(values["p"]), values["s"] if "s" in carry else None)

    def unpack(self, y: Sequence[Any], carry: Sequence[str]) -> State:
        n = len(self.q)
        return State(tuple(y[:n]), tuple(y[n : 2 * n]), y[2 * n] if "s" in carry else None)

    def numbers(self) -> list[float]:
        return [self.gamma, self.kappa, self.mass, *self.parameters.values()]

    def number_names(self) -> list[str]:
        return ["gamma", "kappa", "mass", *self.parameters]

    def with_numbers(self, numbers: Sequence[Any]) -> Self:
        gamma, kappa, mass, *rest = numbers
        parameters = dict(zip(self.parameters, rest, strict=True))
        nonlinear = self.nonlinear_damping
        return self._replaced(
            gamma=gamma,
            kappa=kappa,
            mass=mass,
            inverse_mass=1 / mass,
            parameters=parameters,
            _nonlinear=nonlinear,
        )

    @property
    def nonlinear_damping(self) -> bool:
        """Whether Γ has its quadratic term (decided by the original κ, not by a tracer)."""
        return self.__dict__.get("_nonlinear", self.kappa != 0)

    @property
    def structure(self) -> tuple[Any, ...]:
        return (
            Mechanical, self.potential, self.gradient, self.hessian, len(self.q),
            tuple(self.parameters), self.nonlinear_damping,
        )  # fmt: skip

    # -- physics -------------------------------------------------------------------------------
    def kinetic(self, p: Vector) -> Any:
        """T(p) = ‖p‖²/2m."""
        return dot(p, p) * self.inverse_mass / 2

    def V(self, q: Vector) -> Any:
        return self.potential(q, **self.parameters)

    def dV(self, q: Vector) -> Vector:
        return self.gradient(q, **self.parameters)

    def energy(self, x: State) -> Any:
        """H0 = T + V."""
        return self.kinetic(x.p) + self.V(x.q)

    def dissipation(self, s: Any) -> Any:
        """Γ(s) = γ s + ½ κ s²."""
        linear = self.gamma * s
        return linear + self.kappa * s * s / 2 if self.nonlinear_damping else linear

    def dissipation_rate(self, s: Any) -> Any:
        """Γ'(s) = γ + κ s."""
        return self.gamma + self.kappa * s if self.nonlinear_damping else self.gamma

    def hamiltonian(self, x: State) -> Any:
        """H = H0 + Γ(s); needs s."""
        return self.energy(x) + self.dissipation(x.s)

    def rhs(self, x: State) -> State:
        rate = self.dissipation_rate(x.s)
        velocity = tuple(p * self.inverse_mass for p in x.p)
        force = tuple(-g - rate * p for g, p in zip(self.dV(x.q), x.p, strict=True))
        if x.s is None:
            return State(velocity, force)
        return State(velocity, force, self.kinetic(x.p) - self.V(x.q) - self.dissipation(x.s))

    def jacobian(self, x: State) -> list[list[Any]] | None:
        """∂(rhs)/∂(state) in packed order, or None when the scene has no Hessian."""
        if self.hessian is None:
            return None
        n = len(x.q)
        hess = self.hessian(x.q, **self.parameters)
        rate = self.dissipation_rate(x.s)
        tail: list[Any] = [] if x.s is None else [0.0]
        rows = [[0.0] * n + [self.inverse_mass if i == j else 0.0 for j in range(n)] + tail for i in range(n)]
        for i in range(n):
            damping = [-rate if i == j else 0.0 for j in range(n)]
            column = [] if x.s is None else [-self.kappa * x.p[i] if self.nonlinear_damping else 0.0]
            rows.append([-hess[i][j] for j in range(n)] + damping + column)
        if x.s is not None:
            rows.append([-g for g in self.dV(x.q)] + [p * self.inverse_mass for p in x.p] + [-rate])
        return rows

    def momentum(self, x: State) -> Vector | None:
        """Angular momentum q × p (one component in the plane, three in space), else None."""
        q, p = x.q, x.p
        if len(q) == 2:
            return (q[0] * p[1] - q[1] * p[0],)
        return cross(q, p) if len(q) == 3 else None

    def torque(self, x: State) -> Vector | None:
        """−q × ∇V, the rate at which the potential changes the angular momentum."""
        return self.momentum(State(x.q, tuple(-g for g in self.dV(x.q))))

    @property
    def has_momentum_law(self) -> bool:
        return self.rotation_invariant and len(self.q) in (2, 3)

    def contact_form(self, x: State, dx: State) -> Any:
        """η(dx) = ds − p·dq at x."""
        return dx.s - dot(x.p, dx.q)

    def tangents(self, x: State) -> list[State]:
        """The coordinate basis of the tangent space at x, in packed order."""
        flat = self.pack(x)
        carry = ("s",) if x.s is not None else ()
        size = len(flat)
        return [self.unpack([1.0 if i == j else 0.0 for j in range(size)], carry) for i in range(size)]

    @property
    def conformal_rate(self) -> Any:
        return None if self.nonlinear_damping else self.gamma


@dataclass(frozen=True, kw_only=True)
class RigidBody(Scene):
    """Damped rigid body: M' = M × I⁻¹M − D M, R' = R Ω̂, s' = ½ M·Ω − γ s on T*SO(3) × R.

    inertia : three principal moments > 0.  Exactly one of gamma (isotropic, D = γ 1: a contact
    system with H = ½ M·I⁻¹M + γ s) and damping (three rates ≥ 0, or a symmetric 3×3 D ≥ 0: no
    contact Hamiltonian, hence no s).  M : body angular momentum; R : attitude (see `quaternion_of`).
    Momentum map of the left action: the spatial momentum J = R M.
    Raises `BadInput` for a negative inertia, a D that is not symmetric ≥ 0, t_end ≤ 0.
    """

    inertia: Vector
    M: Vector
    gamma: Any = None
    damping: Any = None
    R: Any = 1
    #: eigenvalues of an anisotropic D, and its eigenvectors as columns (None when D is diagonal)
    rates: Vector = field(init=False, repr=False, default=())
    axes: Any = field(init=False, repr=False, default=None)
    #: kept so that no division is left in the right-hand side
    inverse_inertia: Vector = field(init=False, repr=False, default=())
    #: the axes of the smallest, intermediate and largest moment (decided by the original moments)
    by_inertia: tuple[int, ...] = field(init=False, repr=False, default=())

    initial_fields: ClassVar[tuple[str, ...]] = ("M", "R", "s")

    def __post_init__(self) -> None:
        fix = object.__setattr__
        fix(self, "inertia", vector("inertia", self.inertia, 3))
        if min(self.inertia) <= 0:
            raise BadInput(f"inertia = {self.inertia!r}: all three moments must be > 0")
        fix(self, "inverse_inertia", tuple(1 / i for i in self.inertia))
        fix(self, "by_inertia", tuple(sorted(range(3), key=lambda i: self.inertia[i])))
        fix(self, "M", vector("M", self.M, 3))
        fix(self, "R", quaternion_of(self.R))
        fix(self, "s", finite("s", self.s))
        fix(self, "t_end", positive("t_end", self.t_end))
        if (self.gamma is None) == (self.damping is None):
            raise BadInput("give exactly one of gamma (isotropic) and damping (a matrix D)")
        if self.gamma is not None:
            fix(self, "gamma", finite("gamma", self.gamma))
            return
        matrix = damping_matrix(self.damping)
        fix(self, "damping", tuple(map(tuple, matrix.tolist())))
        diagonal = not np.any(matrix - np.diag(np.diag(matrix)))
        rates, axes = (np.diag(matrix), None) if diagonal else np.linalg.eigh(matrix)
        fix(self, "rates", tuple(np.maximum(rates, 0.0).tolist()))
        fix(self, "axes", None if axes is None else tuple(map(tuple, axes.tolist())))

    def with_(self, **changes: Any) -> Self:
        if changes.get("gamma") is not None and "damping" not in changes:
            changes["damping"] = None
        if changes.get("damping") is not None and "gamma" not in changes:
            changes["gamma"] = None
        return super().with_(**changes)

    @property
    def isotropic(self) -> bool:
        return self.damping is None

    @property
    def optional(self) -> tuple[str, ...]:  # type: ignore[override]
        return ("R", "s") if self.isotropic else ("R",)

    def labels(self, carry: Sequence[str]) -> list[str]:
        names = ["M1", "M2", "M3"]
        names += ["R_w", "R_x", "R_y", "R_z"] if "R" in carry else []
        return names + (["s"] if "s" in carry else [])

    def initial(self, carry: Sequence[str], **data: Any) -> BodyState:
        values = {f: getattr(self, f) for f in self.initial_fields} | data
        R = tuple(values["R"]) if "R" in carry else None
        return BodyState(tuple(values["M"]), R, values["s"] if "s" in carry else None)

    def unpack(self, y: Sequence[Any], carry: Sequence[str]) -> BodyState:
        R = tuple(y[3:7]) if "R" in carry else None
        return BodyState(tuple(y[:3]), R, y[7 if R is not None else 3] if "s" in carry else None)

    def numbers(self) -> list[float]:
        if self.gamma is not None:
            return [*self.inertia, self.gamma]
        axes = [] if self.axes is None else [v for row in self.axes for v in row]
        return [*self.inertia, *self.rates, *axes]

    def number_names(self) -> list[str]:
        return ["", "", "", "gamma"] if self.isotropic else [""] * len(self.numbers())

    def with_numbers(self, numbers: Sequence[Any]) -> Self:
        inertia, rest = tuple(numbers[:3]), tuple(numbers[3:])
        moments = {"inertia": inertia, "inverse_inertia": tuple(1 / i for i in inertia)}
        if self.isotropic:
            return self._replaced(**moments, gamma=rest[0])
        axes = None if self.axes is None else (rest[3:6], rest[6:9], rest[9:12])
        return self._replaced(**moments, rates=rest[:3], axes=axes)

    @property
    def structure(self) -> tuple[Any, ...]:
        return (RigidBody, self.isotropic, self.isotropic or self.axes is None, self.by_inertia)

    # -- physics -------------------------------------------------------------------------------
    def angular_velocity(self, M: Vector) -> Vector:
        """Ω = I⁻¹ M."""
        return tuple(m * i for m, i in zip(M, self.inverse_inertia, strict=True))

    def damp_matrix_function(self, M: Vector, f: Callable[[Any], Any]) -> Vector:
        """f(D) M through the eigen-decomposition of D."""
        if self.isotropic:
            return tuple(f(self.gamma) * m for m in M)
        if self.axes is None:
            return tuple(f(d) * m for d, m in zip(self.rates, M, strict=True))
        columns = tuple(zip(*self.axes, strict=True))
        modal = tuple(f(d) * dot(c, M) for d, c in zip(self.rates, columns, strict=True))
        return tuple(dot(row, modal) for row in self.axes)

    def energy(self, x: BodyState) -> Any:
        """H0 = ½ M·I⁻¹M."""
        return dot(x.M, self.angular_velocity(x.M)) / 2

    def hamiltonian(self, x: BodyState) -> Any:
        """H = H0 + γ s; needs s."""
        return self.energy(x) + self.gamma * x.s

    def rhs(self, x: BodyState) -> BodyState:
        omega = self.angular_velocity(x.M)
        damped = self.damp_matrix_function(x.M, lambda rate: rate)
        dM = tuple(c - d for c, d in zip(cross(x.M, omega), damped, strict=True))
        dR = None
        if x.R is not None:
            half = tuple(w / 2 for w in omega)
            a, b, c, d = x.R
            dR = (  # ½ R ⊗ (0, Ω), the zero products left out
                -b * half[0] - c * half[1] - d * half[2],
                a * half[0] + c * half[2] - d * half[1],
                a * half[1] - b * half[2] + d * half[0],
                a * half[2] + b * half[1] - c * half[0],
            )
        ds = None if x.s is None else dot(x.M, omega) / 2 - self.gamma * x.s
        return BodyState(dM, dR, ds)

    def jacobian(self, x: BodyState) -> list[list[Any]]:
        """∂(rhs)/∂(state) in packed order."""
        inv = self.inverse_inertia
        omega = self.angular_velocity(x.M)
        width = 3 + (4 if x.R is not None else 0) + (1 if x.s is not None else 0)
        rows = [[0.0] * width for _ in range(width)]
        unit = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        for j, e in enumerate(unit):
            gyroscopic = cross(x.M, tuple(inv[k] * e[k] for k in range(3)))
            other = cross(e, omega)
            damped = self.damp_matrix_function(e, lambda rate: rate)
            for i in range(3):
                rows[i][j] = other[i] + gyroscopic[i] - damped[i]
        if x.R is not None:
            for j, e in enumerate(unit):
                column = quaternion_product(x.R, (0.0, *(inv[j] * c / 2 for c in e)))
                for i in range(4):
                    rows[3 + i][j] = column[i]
            for j in range(4):
                e4 = tuple(1.0 if i == j else 0.0 for i in range(4))
                column = quaternion_product(e4, (0.0, *(w / 2 for w in omega)))
                for i in range(4):
                    rows[3 + i][3 + j] = column[i]
        if x.s is not None:
            rows[-1][:3] = list(omega)
            rows[-1][-1] = -self.gamma
        return rows

    def momentum(self, x: BodyState) -> Vector | None:
        """J = R M, the spatial angular momentum; None when R is not carried."""
        return None if x.R is None else rotate(x.R, x.M)

    @property
    def has_momentum_law(self) -> bool:
        return self.isotropic

    def contact_form(self, x: BodyState, dx: BodyState) -> Any:
        """η(dx) = ds − M·ξ, ξ = 2 Im(R̄ ⊗ dR) the body-frame displacement (left trivialisation)."""
        assert x.R is not None
        assert dx.R is not None
        w, a, b, c = x.R
        xi = quaternion_product((w, -a, -b, -c), dx.R)[1:]
        return dx.s - 2 * dot(x.M, xi)

    def tangents(self, x: BodyState) -> list[BodyState]:
        """Basis of the tangent space: ∂/∂M_i, the body-frame rotations e_i (and ∂/∂s)."""
        zero3, zero4 = (0.0,) * 3, (0.0,) * 4
        s0 = 0.0 if x.s is not None else None
        R0 = zero4 if x.R is not None else None
        unit = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
        basis = [BodyState(e, R0, s0) for e in unit]
        if x.R is not None:
            for e in unit:
                half = quaternion_product(x.R, (0.0, *(c / 2 for c in e)))
                basis.append(BodyState(zero3, half, s0))
        if x.s is not None:
            basis.append(BodyState(zero3, R0, 1.0))
        return basis

    @property
    def conformal_rate(self) -> Any:
        return self.gamma


def damping_matrix(value: Any) -> np.ndarray:
    """D as a 3×3 array, from three rates or a matrix; `BadInput` unless symmetric and ≥ 0."""
    message = f"damping = {value!r}: must be three rates ≥ 0 or a symmetric positive semi-definite 3×3 matrix"
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise BadInput(message) from None
    matrix = np.diag(array) if array.shape == (3,) else array
    if matrix.shape != (3, 3) or not np.all(np.isfinite(matrix)) or not np.array_equal(matrix, matrix.T):
        raise BadInput(message)
    scale = np.abs(matrix).max()
    if np.linalg.eigvalsh(matrix).min() < -4 * math.ulp(1.0) * scale:
        raise BadInput(message)
    return matrix
