"""A damped rigid body about a fixed point, in a potential of one direction as the body sees it: the heavy top."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

from contactbench.checks import finite, function, require_number, vector
from contactbench.errors import BadInput
from contactbench.numbers.functions import namespace
from contactbench.numbers.protocol import Arithmetic, CannotRecord, Namespace
from contactbench.scene.algebra import BodyState, Vector, conjugate, cross, dot, norm, rotate
from contactbench.scene.base import Check, Numeric, Sizes, as_formula, optional
from contactbench.scene.flow import Flow, plain
from contactbench.scene.mechanical import derived_gradient
from contactbench.scene.rigid_body import BODY, RigidBody, one_rate
from contactbench.scene.scales import larger, size


def top_kick(scene: HeavyTop, x: BodyState, h: Arithmetic, xp: Namespace) -> BodyState:
    """B: M += h w u × χ, s −= h w u·χ; R does not change."""
    M = tuple(m + h * c for m, c in zip(x.M, scene.torque(x), strict=True))
    return BodyState(M, x.R, None if x.s is None else x.s - h * scene.potential_at(x))


@dataclass(frozen=True, kw_only=True)
class HeavyTop(RigidBody):
    """Describe a damped heavy top by M, its attitude R and s.

    M' = M × Ω + w u × χ − γ M, R' = R Ω̂, s' = ½ M·Ω − w u·χ − γ s, u = Rᵀe₃ the vertical in the body.
    H = ½ M·I⁻¹M + w e₃·Rχ + γ s.  Rotations about the vertical are a symmetry: e₃·RM decays as e^{−γt}.  With two equal
    moments and χ along the third axis it is Lagrange's top, whose M·χ decays likewise.

    Parameters
    ----------
    name, about, t_end, s, exact, scale, slows_after, hard, stiff, mission, pace
        As of `Scene`.
    inertia
        Three principal moments about the fixed point > 0.
    weight
        The largest torque of the weight, w = mgl.
    axis
        Vector χ, from the fixed point to the centre of mass: three numbers in the body, of length one where w = mgl.
    potential
        ``V(u) -> number``, a further potential of the vertical in the body, three numbers, as of gravity's gradient on
        a satellite, 3/2 n² u·Iu.  Its torque is u × ∂V/∂u, derived: it has to be one that can be recorded.
    M
        As of `RigidBody`.
    R
        As of `RigidBody`; the attitude is always carried.
    attitude
        True: the weight follows it.
    gamma
        Isotropic damping.
    damping
        None: an anisotropic damping is refused.

    Raises
    ------
    BadInput
        As `RigidBody` does, for an anisotropic damping, and for a potential that cannot be differentiated.
    """

    weight: float = 0.0
    axis: Vector = (0.0, 0.0, 1.0)
    gamma: float = 0.0
    potential: Callable[..., Arithmetic] | None = None
    #: ∂V/∂u
    slope: Callable[..., Vector] | None = field(init=False, repr=False, default=None)

    kind = "heavy top"
    flows: ClassVar[Mapping[str, Flow]] = {**BODY, "kick": Flow(plain, top_kick, {"gradient": 1})}
    parts: ClassVar[tuple[str, ...]] = ("kick", "turn", "damp", "top")
    functions: ClassVar[dict[str, tuple[str, ...]]] = {"potential": ("u",)}
    required: ClassVar[tuple[str, ...]] = ("R",)
    checks: ClassVar[dict[str, Check]] = {
        **RigidBody.checks,
        "gamma": one_rate,
        "weight": finite,
        "axis": lambda name, value: vector(name, value, 3),
        "potential": optional(function),
    }
    #: derivatives are by differences or dual numbers
    has_jacobian: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if self.damping is not None:
            raise BadInput(
                "damping: of a heavy top it is isotropic: give gamma; SciPy's solve_ivp takes any other"
            )
        super().__post_init__()
        if not self.attitude:
            raise BadInput("attitude = False: the weight of a heavy top follows its attitude; leave it out")
        if self.potential is not None:
            require_number("potential", self._value("potential"))
            self.recorded()

    @property
    def u(self) -> Vector:
        """Return the vertical in the body at the start."""
        return self.vertical(self.R)

    def recorded(self) -> Self:
        """Return the scene recorded, with the derivative of its potential."""
        scene = super().recorded()
        if scene.potential is None or scene.slope is not None:
            return scene
        try:
            return scene._replaced(slope=derived_gradient(as_formula(scene.potential, (3,))))
        except CannotRecord as why:
            raise BadInput(f"scene {self.name!r}: its potential cannot be differentiated: {why}") from why

    @property
    def coefficients(self) -> tuple[str, ...]:  # type: ignore[override]
        return ("inertia", "gamma", "weight", "axis")

    def vertical(self, R: Any) -> Vector:
        """Return Rᵀe₃."""
        return rotate(conjugate(R), (0.0, 0.0, 1.0))

    def potential_at(self, x: BodyState) -> Arithmetic:
        u = self.vertical(x.R)
        weight = self.weight * dot(u, self.axis)
        return weight if self.potential is None else weight + self.potential(u)

    def torque(self, x: BodyState) -> Vector:
        """Return u × (w χ + ∂V/∂u), by which M changes."""
        u = self.vertical(x.R)
        if self.potential is None:
            return tuple(self.weight * c for c in cross(u, self.axis))
        slope = (self.slope or self.recorded().slope)(u)  # type: ignore[misc]
        return cross(u, tuple(self.weight * c + d for c, d in zip(self.axis, slope, strict=True)))

    def energy(self, x: BodyState) -> Arithmetic:
        return self.kinetic(x) + self.potential_at(x)

    def sizes(self, x: BodyState, end: float) -> Sizes:
        _, most = super().sizes(x, end)
        xp = namespace(most)
        turned: Any = abs(self.potential_at(x)) + norm(self.torque(x))
        most = larger(most, (2 * size(self.inertia, xp) * turned) ** 0.5, xp)
        return [most] * 3, most

    def rhs(self, x: BodyState) -> BodyState:
        free = super().rhs(x)
        dM = tuple(a + b for a, b in zip(free.M, self.torque(x), strict=True))
        return free._replace(M=dM, s=None if x.s is None else free.s - self.potential_at(x))

    def jacobian(self, x: BodyState) -> None:  # type: ignore[override]
        """Return None."""

    def momentum(self, x: BodyState) -> Vector:
        """Return e₃·RM, the vertical component of the spatial momentum."""
        return (dot(self.vertical(x.R), x.M),)

    has_momentum_law = True  # type: ignore[assignment]

    @property
    def may_gain_energy(self) -> bool:  # type: ignore[override]
        return self.gamma <= 0

    def hamiltonian_terms(self, x: BodyState) -> Numeric:
        return self.kinetic(x) + abs(self.potential_at(x)) + abs(self.gamma * x.s)
