"""Mechanical scenes with a damping Γ(s) of their own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

from contactbench.errors import BadInput, function, require_number
from contactbench.scene.algebra import State
from contactbench.scene.base import Check, optional
from contactbench.scene.mechanical import Mechanical


@dataclass(frozen=True, kw_only=True)
class GeneralDamping(Mechanical):
    """H = ‖p‖²/2m + V(q) + Γ(s) for any smooth Γ, on the three-part splitting: kick, drift and damping.

    Nyström tables, Herglotz's recursion and `contact-adaptive` refuse it: their flows need a Γ at most quadratic.

        GeneralDamping(name="cubic", potential=V, gradient=dV, q=(1.0,), p=(0.0,), s=0.5, t_end=10.0,
                       damping=lambda s: 0.1 * s + s**3, damping_slope=lambda s: 0.1 + 3 * s * s)

    Parameters
    ----------
    damping, damping_slope
        ``Γ(s) -> number`` and ``Γ'(s) -> number``, plain arithmetic like the force.
    damping_flow
        ``(s, h, xp) -> s(h)``, the solution of s' = −Γ(s) where it is known in closed form; by default it is found
        by quadrature (`splitting.dissipation`), many evaluations of Γ a step.

    Raises
    ------
    BadInput
        As `Mechanical` does, and for a gamma or kappa beside Γ.
    """

    damping: Callable[[Any], Any]
    damping_slope: Callable[[Any], Any]
    damping_flow: Callable[[Any, Any, Any], Any] | None = None

    kind: ClassVar[str] = "general damping"
    functions: ClassVar[dict[str, tuple[str, ...]]] = {
        **Mechanical.functions,
        **dict.fromkeys(("damping", "damping_slope"), ("s",)),
        "damping_flow": ("s", "h", "xp"),
    }

    coefficients: ClassVar[tuple[str, ...]] = ("mass",)
    checks: ClassVar[dict[str, Check]] = {
        **Mechanical.checks,
        "damping": function,
        "damping_slope": function,
        "damping_flow": optional(function),
    }

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.gamma or self.kappa:
            raise BadInput(f"gamma = {self.gamma!r}, kappa = {self.kappa!r}: Γ has them in it")
        for name in ("damping", "damping_slope", "damping_flow"):
            if getattr(self, name) is not None:
                require_number(name, self._value(name))

    required = ("s",)

    nonlinear_damping = True

    def dissipation(self, s: Any) -> Any:
        return self.damping(s)

    def dissipation_rate(self, s: Any) -> Any:
        return self.damping_slope(s)

    #: Γ'' is not asked for: solvers difference
    has_jacobian = False

    def jacobian(self, x: State) -> None:
        """Return None."""
