"""The damped rigid body."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import Any, ClassVar, Self

import numpy as np

from contactbench.checks import finite, real_array, switch, vector
from contactbench.errors import BadInput, excerpt
from contactbench.numbers.control import choose, settle
from contactbench.numbers.protocol import Arithmetic, Namespace
from contactbench.scene.algebra import (
    AnyState,
    BodyState,
    Vector,
    conjugate,
    cross,
    dot,
    norm,
    quaternion_of,
    quaternion_product,
    rotate,
)
from contactbench.scene.base import Check, Numeric, Scene, Sizes, optional
from contactbench.scene.flow import Constants, Flow, damping, plain, time_and_damping
from contactbench.scene.free_body import free

UNIT = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def moments(name: str, value: Any) -> Vector:
    if np.ndim(value) == 2:
        why = "must be the three principal moments, those of the matrix: turn the body to its eigenvectors"
        raise BadInput(f"{name} = {excerpt(value)}: {why}")
    given = vector(name, value, 3)
    if min(given) <= 0:
        raise BadInput(f"{name} = {excerpt(given)}: all three moments must be > 0")
    return given


def one_rate(name: str, value: Any) -> float:
    """Return a finite number; for a function or an array raise `BadInput` with a hint."""
    if callable(value) or np.ndim(value):
        how = "of RigidBody one for each axis is damping=(0.1, 0.2, 0.3); SciPy's solve_ivp takes any other"
        raise BadInput(f"{name} = {excerpt(value)}: must be a number; {how}")
    return finite(name, value)


def damping_matrix(name: str, value: object) -> tuple[Vector, ...]:
    """Return a 3×3 matrix from three rates or a matrix; raise `BadInput` unless it is symmetric and ≥ 0."""
    matrices = "a symmetric positive semi-definite 3×3 matrix (one rate about all axes: gamma=)"
    wanted = f"three rates ≥ 0 or {matrices}"
    given = real_array(name, value, wanted)
    matrix = np.diag(given) if given.shape == (3,) else given
    right = matrix.shape == (3, 3) and np.all(np.isfinite(matrix)) and np.array_equal(matrix, matrix.T)
    if not right or np.linalg.eigvalsh(matrix).min() < -4 * math.ulp(1.0) * np.abs(matrix).max():
        raise BadInput(f"{name} = {excerpt(value)}: must be {wanted}")
    return tuple(map(tuple, matrix.tolist()))


# -- flows -----------------------------------------------------------------------------------------
def rotation(x: BodyState, axis: int, a: Arithmetic, xp: Namespace) -> BodyState:
    """Exact time-1 flow of ½ a M_i²: R → R Rot(e_i, θ) and M → Rot(e_i, −θ) M, θ = a M_i; J = R M stays."""
    j, k = (axis + 1) % 3, (axis + 2) % 3
    M, R, s = x
    angle = a * M[axis]
    half = angle / 2
    cos, sin = xp.cos(half), xp.sin(half)
    cos2, sin2 = 1 - 2 * sin * sin, 2 * sin * cos
    turned = [M[axis]] * 3
    turned[j], turned[k] = cos2 * M[j] + sin2 * M[k], cos2 * M[k] - sin2 * M[j]
    if R is not None:
        w, v = R[0], R[1:]
        quaternion = [cos * w - sin * v[axis], w, w, w]
        quaternion[1 + axis] = cos * v[axis] + sin * w
        quaternion[1 + j] = cos * v[j] + sin * v[k]
        quaternion[1 + k] = cos * v[k] - sin * v[j]
        R = tuple(quaternion)
    return settle(BodyState(tuple(turned), R, None if s is None else s + angle * M[axis] / 2), xp)


def spin(x: BodyState, a: Arithmetic, xp: Namespace) -> BodyState:
    """Exact time-1 flow of ½ a ‖M‖²: M stays, R → R exp(a M̂); it commutes with every rotation, and leaves J alone."""
    if x.R is None and x.s is None:
        return x
    square = dot(x.M, x.M)
    s = None if x.s is None else x.s + a * square / 2
    if x.R is None:
        return BodyState(x.M, None, s)
    still = square == 0
    size = xp.sqrt(choose(still, 1.0, square, xp))  # 1: no derivative of √0 is taken
    scale = choose(still, a / 2, xp.sin(a * size / 2) / size, xp)
    cos = choose(still, 1.0, xp.cos(a * size / 2), xp)
    R = quaternion_product(x.R, (cos, *(scale * m for m in x.M)))
    return settle(BodyState(x.M, R, s), xp)


def half_turn(x: BodyState, dx: BodyState) -> Vector:
    """Return ½ ξ = Im(R̄ ⊗ dR), half the displacement in the frame of the body (left trivialisation)."""
    assert x.R is not None
    assert dx.R is not None
    return quaternion_product(conjugate(x.R), dx.R)[1:]


def turn_rate(scene: RigidBody) -> Arithmetic:
    """Return 1/I_min − 1/I_mid, the part of the energy that `turn` is the flow of, as ½ a M_min²."""
    smallest, middle, _ = scene.by_inertia
    return scene.inverse_inertia[smallest] - scene.inverse_inertia[middle]


def top_rate(scene: RigidBody) -> Arithmetic:
    """Return 1/I_max − 1/I_mid, by which the symmetric top of `top` differs from a sphere."""
    _, middle, largest = scene.by_inertia
    return scene.inverse_inertia[largest] - scene.inverse_inertia[middle]


def turn(scene: RigidBody, x: BodyState, tau: Arithmetic, xp: Namespace) -> BodyState:
    """Flow of ½ (1/I_min − 1/I_mid) M_min², the difference between an asymmetric body and a symmetric top.

    Free body = `turn` + `top`: Touma, Wisdom, Astron. J. 107, 1189 (1994); no two rotations have smaller rates: Fassò,
    J. Comput. Phys. 189, 527 (2003).
    """
    return rotation(x, scene.by_inertia[0], tau * turn_rate(scene), xp)


def top(scene: RigidBody, x: BodyState, tau: Arithmetic, xp: Namespace) -> BodyState:
    """Flow of the symmetric top with moments I_mid, I_mid, I_max: a rotation and a `spin`."""
    x = rotation(x, scene.by_inertia[2], tau * top_rate(scene), xp)
    return spin(x, tau * scene.inverse_inertia[scene.by_inertia[1]], xp)


def _body_damp_constants(scene: RigidBody, h: Arithmetic, xp: Namespace) -> Constants:
    if scene.isotropic:
        return damping(scene.gamma, h, xp)
    return tuple(xp.exp(-rate * h) for rate in scene.rates)


def body_damp(scene: RigidBody, x: BodyState, decay: Constants, xp: Namespace) -> BodyState:
    """C: M → e^{−hD} M (isotropic: M and s *= e^{−γh}); R does not change."""
    if scene.isotropic:
        keep, lose = decay
        s = None if x.s is None else keep * x.s - lose * x.s
        return BodyState(tuple(keep * m - lose * m for m in x.M), x.R, s)
    factor = iter(decay)
    return BodyState(scene.damp_matrix_function(x.M, lambda rate: next(factor)), x.R, None)


def free_damp(scene: RigidBody, x: BodyState, constants: Constants, xp: Namespace) -> BodyState:
    """Advance the free body for the time φ(h), then damp it: the whole flow of the scene, s(h) = e^{−γh} (s + φ H0)."""
    tau, *decay = constants
    return body_damp(scene, free(scene, x, tau, xp), decay, xp)


#: cost of `free` in rotations, by the numbers of square roots, divisions and transcendental functions with loops of
#: fixed length (the tests count them): without and with the attitude
MOMENTUM_COST, FREE_COST = 23, 177
FREE_COSTS = {"rotation": MOMENTUM_COST, "attitude": FREE_COST - MOMENTUM_COST}

BODY = {
    "turn": Flow(plain, turn, {"rotation": 1}),
    "top": Flow(plain, top, {"rotation": 1}),
    "free": Flow(plain, free, FREE_COSTS),
    "damp": Flow(_body_damp_constants, body_damp, {}),
}
ISOTROPIC = BODY | {"free_damp": Flow(time_and_damping, free_damp, FREE_COSTS)}


@dataclass(frozen=True, kw_only=True)
class RigidBody(Scene):
    """Describe a damped rigid body: M' = M × I⁻¹M − D M, R' = R Ω̂, s' = ½ M·Ω − γ s on T*SO(3) × R.

    The momentum map of the left action is the spatial momentum J = R M.

    Parameters
    ----------
    name, about, t_end, s, exact, scale, slows_after, hard, stiff, mission, pace
        As of `Scene`.
    inertia
        Three principal moments > 0.
    M
        Angular momentum in the body at the start.
    R
        Attitude at the start: 1, a quaternion (w, x, y, z) or a rotation matrix; the nearest one where it is off by
        10⁻⁶ at most.
    attitude
        Whether R is part of the compared motion, beside M.
    gamma
        Isotropic damping, D = γ 1: a contact system with H = ½ M·I⁻¹M + γ s.
    damping
        In place of gamma, three rates ≥ 0 or a symmetric 3×3 D ≥ 0: no contact Hamiltonian, hence no s.

    Raises
    ------
    BadInput
        For a negative inertia, a D that is not symmetric ≥ 0, t_end ≤ 0.
    """

    inertia: Vector
    M: Vector
    gamma: Any = None
    damping: Any = None
    R: Any = 1
    attitude: bool = True  # type: ignore[misc]
    #: eigenvalues of an anisotropic D, and the matrix of its eigenvectors, row by row (None when D is diagonal)
    rates: Vector = field(init=False, repr=False, default=())
    axes: Vector | None = field(init=False, repr=False, default=None)
    inverse_inertia: Vector = field(init=False, repr=False, default=())
    #: the axes of the smallest, intermediate and largest moment (decided by the original moments)
    by_inertia: tuple[int, ...] = field(init=False, repr=False, default=())

    state: ClassVar[type[AnyState]] = BodyState
    #: a free one has no B
    paper_flows: ClassVar[Mapping[str, str]] = {"drift": "free", "kick": "kick", "damp": "damp"}
    initial_fields: ClassVar[tuple[str, ...]] = ("M", "R", "s")
    reciprocals: ClassVar[dict[str, str]] = {"inertia": "inverse_inertia"}
    checks: ClassVar[dict[str, Check]] = {
        **Scene.checks,
        "inertia": moments,
        "M": partial(vector, length=3),
        "R": lambda name, value: quaternion_of(value),
        "attitude": switch,
        "gamma": optional(one_rate),
        "damping": optional(damping_matrix),
    }

    def __post_init__(self) -> None:
        super().__post_init__()
        self._fix("by_inertia", self._decide().by_inertia)
        if (self.gamma is None) == (self.damping is None):
            raise BadInput("give exactly one of gamma (isotropic) and damping (a matrix D)")
        if self.damping is None:
            return
        matrix = np.array(self.damping)
        diagonal = not np.any(matrix - np.diag(np.diag(matrix)))
        rates, axes = (np.diag(matrix), None) if diagonal else np.linalg.eigh(matrix)
        self._fix("rates", tuple(np.maximum(rates, 0.0).tolist()))
        self._fix("axes", None if axes is None else tuple(axes.ravel().tolist()))

    def with_(self, **changes: object) -> Self:
        if changes.get("gamma") is not None and "damping" not in changes:
            changes["damping"] = None
        if changes.get("damping") is not None and "gamma" not in changes:
            changes["gamma"] = None
        return super().with_(**changes)

    @property
    def isotropic(self) -> bool:
        return self.damping is None

    @property
    def slows_its_clock(self) -> bool:  # type: ignore[override]
        return "free_damp" in self.flows

    def decayed(self, x: BodyState, factor: Arithmetic) -> BodyState:
        """Return x with M and s times a factor."""
        s = None if x.s is None else factor * x.s
        return BodyState(tuple(factor * m for m in x.M), x.R, s)

    @property
    def flows(self) -> Mapping[str, Flow]:  # type: ignore[override]
        """Return its subflows; compositions of higher order leave out `free`, which is costly."""
        return ISOTROPIC if self.isotropic else BODY

    @property
    def parts(self) -> tuple[str, ...]:  # type: ignore[override]
        return ("turn", "top") if self.isotropic else ("turn", "damp", "top")

    @property
    def kind(self) -> str:  # type: ignore[override]
        return "isotropic body" if self.isotropic else "body"

    @property
    def optional(self) -> tuple[str, ...]:  # type: ignore[override]
        return ("R", "s") if self.isotropic else ("R",)

    def labels(self, carry: Sequence[str]) -> list[str]:
        quaternion = {"R1": "R_w", "R2": "R_x", "R3": "R_y", "R4": "R_z"}
        return [quaternion.get(name, name) for name in super().labels(carry)]

    def unpack(self, y: Sequence[Arithmetic], carry: Sequence[str]) -> BodyState:
        R = tuple(y[3:7]) if "R" in carry else None
        return BodyState(tuple(y[:3]), R, y[7 if R is not None else 3] if "s" in carry else None)

    @property
    def coefficients(self) -> tuple[str, ...]:  # type: ignore[override]
        if self.isotropic:
            return ("inertia", "gamma")
        return ("inertia", "rates") if self.axes is None else ("inertia", "rates", "axes")

    @property
    def decided(self) -> tuple[Hashable, ...]:  # type: ignore[override]
        return self.by_inertia

    def _decide(self) -> Self:
        return self._replaced(by_inertia=tuple(sorted(range(3), key=lambda i: self.inertia[i])))

    def orders(self) -> list[tuple[int, int, bool]]:
        return super().orders() + [(i, j, False) for i, j in pairwise(self.by_inertia)]

    mixed = False

    @property
    def alike(self) -> Sequence[int]:
        return [3]

    def sizes(self, x: BodyState, end: float) -> Sizes:
        most: Any = norm(x.M)
        return [most] * 3, most

    def angular_velocity(self, M: Vector) -> Vector:
        return tuple(m * i for m, i in zip(M, self.inverse_inertia, strict=True))

    def damp_matrix_function(self, M: Vector, f: Callable[[Arithmetic], Arithmetic]) -> Vector:
        """Return f(D) M through the eigen-decomposition of D."""
        if self.isotropic:
            return tuple(f(self.gamma) * m for m in M)
        if self.axes is None:
            return tuple(f(d) * m for d, m in zip(self.rates, M, strict=True))
        modal = tuple(f(d) * dot(self.axes[j::3], M) for j, d in enumerate(self.rates))
        return tuple(dot(self.axes[i : i + 3], modal) for i in (0, 3, 6))

    def kinetic(self, x: BodyState) -> Arithmetic:
        return dot(x.M, self.angular_velocity(x.M)) / 2

    energy = kinetic

    def hamiltonian(self, x: BodyState) -> Numeric:
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

    def settled(self, y: np.ndarray, carry: Sequence[str]) -> np.ndarray:
        if "R" in carry:
            y[:, 3:7] /= np.linalg.norm(y[:, 3:7], axis=1, keepdims=True)
        return y

    def jacobian(self, x: BodyState) -> list[list[Arithmetic]]:
        inv, omega = self.inverse_inertia, self.angular_velocity(x.M)
        width = len(self.pack(x))
        rows: list[list[Arithmetic]] = [[0.0] * width for _ in range(width)]
        for j, e in enumerate(UNIT):
            gyroscopic = cross(x.M, tuple(inv[k] * e[k] for k in range(3)))
            other, damped = cross(e, omega), self.damp_matrix_function(e, lambda rate: rate)
            for i in range(3):
                rows[i][j] = other[i] + gyroscopic[i] - damped[i]
        if x.R is not None:
            R, half = x.R, (0.0, *(w / 2 for w in omega))
            columns = [quaternion_product(R, (0.0, *(inv[j] * c / 2 for c in e))) for j, e in enumerate(UNIT)]
            columns += [quaternion_product(tuple(unit), half) for unit in np.eye(4).tolist()]
            for i in range(4):
                rows[3 + i][:7] = [column[i] for column in columns]
        if x.s is not None:
            rows[-1][:3] = list(omega)
            rows[-1][-1] = -self.gamma
        return rows

    def momentum(self, x: BodyState) -> Vector | None:
        """Return J = R M, the spatial angular momentum, R ~ |quaternion|²; None when R is not carried."""
        return None if x.R is None else rotate(x.R, x.M)

    @property
    def has_momentum_law(self) -> bool:  # type: ignore[override]
        return self.isotropic

    @property
    def may_gain_energy(self) -> bool:  # type: ignore[override]
        return self.isotropic and self.gamma <= 0

    def contact_form(self, x: BodyState, dx: BodyState) -> Numeric:
        """Return η(dx) = ds − M·ξ, ξ the displacement in the frame of the body (`half_turn`)."""
        return dx.s - 2 * dot(x.M, half_turn(x, dx))

    def contact_terms(self, x: BodyState, dx: BodyState) -> Numeric:
        """Return |ds| + ‖M‖‖ξ‖, ‖ξ‖ = 2‖dR‖."""
        assert dx.R is not None
        return abs(dx.s) + 2 * norm(x.M) * norm(dx.R)

    def hamiltonian_terms(self, x: BodyState) -> Numeric:
        energy = self.energy(x)
        return abs(energy) + abs(self.hamiltonian(x) - energy)

    def momentum_terms(self, x: BodyState) -> Numeric:
        return norm(x.M)

    def displaced(self, x: BodyState, v: BodyState, amount: float) -> BodyState:  # type: ignore[override]
        """Return M and s along straight lines, R along the group: R exp(amount ξ̂)."""
        moved = super().displaced(x, v, amount)
        if x.R is None or v.R is None:
            return moved
        half = half_turn(x, v)
        size = norm(half)
        scale = math.sin(size * amount) / size if size > 0 else 0.0
        turned = quaternion_product(x.R, (math.cos(size * amount), *(scale * h for h in half)))
        return moved._replace(R=turned)

    def tangents(self, x: BodyState) -> list[BodyState]:
        """Return a basis of the tangent space: ∂/∂M_i, the body-frame rotations e_i (and ∂/∂s)."""
        zero3, s0 = (0.0,) * 3, None if x.s is None else 0.0
        R0 = None if x.R is None else (0.0,) * 4
        basis = [BodyState(e, R0, s0) for e in UNIT]
        if x.R is not None:
            halves = ((0.0, *(c / 2 for c in e)) for e in UNIT)
            basis += [BodyState(zero3, quaternion_product(x.R, half), s0) for half in halves]
        return basis if x.s is None else [*basis, BodyState(zero3, R0, 1.0)]

    @property
    def conformal_rate(self) -> Numeric:
        return self.gamma
