"""A damped rigid body about a fixed point, in a potential that is linear in one of its directions: the heavy top."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from contactbench.errors import BadInput, finite, vector
from contactbench.scene.algebra import BodyState, Vector, cross, dot, rotate
from contactbench.scene.base import Check
from contactbench.scene.rigid_body import RigidBody


@dataclass(frozen=True, kw_only=True)
class HeavyTop(RigidBody):
    """Damped top: M' = M × Ω + w u × χ − γ M, R' = R Ω̂, s' = ½ M·Ω − w u·χ − γ s, u = Rᵀe₃ the vertical in the body.

    H = ½ M·I⁻¹M + w e₃·Rχ + γ s.  Rotations about the vertical are a symmetry: e₃·RM decays as e^{−γt}.  With two equal
    moments and χ along the third axis it is Lagrange's top, whose M·χ decays so, too.

    Parameters
    ----------
    inertia
        Three principal moments about the fixed point > 0.
    weight
        w = mgl, the torque that the weight has at most.
    axis
        χ, from the fixed point to the centre of mass: three numbers in the body, of length one where w = mgl.
    M
        As of `RigidBody`.
    R
        As of `RigidBody`; the attitude is always carried.
    gamma
        Isotropic damping.

    Raises
    ------
    BadInput
        As `RigidBody` does, and for an anisotropic damping.
    """

    weight: float
    axis: Vector = (0.0, 0.0, 1.0)
    gamma: float = 0.0

    kind: ClassVar[str] = "heavy top"  # type: ignore[misc]
    required: ClassVar[tuple[str, ...]] = ("R",)
    checks: ClassVar[dict[str, Check]] = {
        **RigidBody.checks,
        "gamma": finite,
        "weight": finite,
        "axis": lambda name, value: vector(name, value, 3),
    }
    #: derivatives are by differences or dual numbers
    has_jacobian: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if self.damping is not None:
            raise BadInput("damping: a heavy top has isotropic damping; give gamma")
        super().__post_init__()

    @property
    def coefficients(self) -> tuple[str, ...]:  # type: ignore[override]
        return ("inertia", "gamma", "weight", "axis")

    def vertical(self, R: Any) -> Vector:
        """Return Rᵀe₃."""
        w, x, y, z = R
        return rotate((w, -x, -y, -z), (0.0, 0.0, 1.0))

    def potential_at(self, x: BodyState) -> Any:
        return self.weight * dot(self.vertical(x.R), self.axis)

    def torque(self, x: BodyState) -> Vector:
        """Return w u × χ, by which M changes."""
        return tuple(self.weight * c for c in cross(self.vertical(x.R), self.axis))

    def energy(self, x: BodyState) -> Any:
        return self.kinetic(x) + self.potential_at(x)

    def rhs(self, x: BodyState) -> BodyState:
        free = super().rhs(x)
        dM = tuple(a + b for a, b in zip(free.M, self.torque(x), strict=True))
        return free._replace(M=dM, s=None if x.s is None else free.s - self.potential_at(x))

    def jacobian(self, x: BodyState) -> Any:
        """Return None."""

    def momentum(self, x: BodyState) -> Vector:
        """Return e₃·RM, the vertical component of the spatial momentum."""
        return (dot(self.vertical(x.R), x.M),)

    has_momentum_law = True  # type: ignore[assignment]

    @property
    def may_gain_energy(self) -> bool:  # type: ignore[override]
        return self.gamma < 0

    def hamiltonian_terms(self, x: BodyState) -> Any:
        return self.kinetic(x) + abs(self.potential_at(x)) + abs(self.gamma * x.s)
