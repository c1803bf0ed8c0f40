"""Contact variational integrators: discrete Herglotz principles, as one-step maps (q, p, s) → (q, p, s).

From s₁ = s₀ + h L(q₀, q₁, s₀, s₁) and the discrete Legendre transforms p₀ = −h D₁L / (1 + h ∂L/∂s₀) and
p₁ = h D₂L / (1 − h ∂L/∂s₁) follows ds₁ − p₁·dq₁ = σ (ds₀ − p₀·dq₀), σ = (1 + h ∂L/∂s₀) / (1 − h ∂L/∂s₁).
Vermeeren, Bravetti, Seri, J. Phys. A 52, 445206 (2019), doi:10.1088/1751-8121/ab4767; the paper, §5.1, eq. (79).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from contactbench.methods.base import METHODS, unfit
from contactbench.methods.fixed_step import FixedStep
from contactbench.numbers.control import Repeat, repeat
from contactbench.numbers.protocol import Arithmetic, Count, Namespace
from contactbench.scene import Mechanical, Scene, State, Vector, mechanical
from contactbench.scene.base import OwnState


@dataclass(frozen=True)
class Herglotz(FixedStep):
    """Mechanical scenes with Γ = γ s, one gradient a step."""

    def composed(self, scene: Scene) -> bool:
        return scene.is_contact

    def refuses(self, scene: Scene) -> str | None:
        fits = scene.separable and not scene.nonlinear_damping
        return unfit(self, scene, fits, "a configuration q in Rⁿ and damping Γ = γ s")


def explicit_kick(
    scene: Mechanical, x: State, h: Arithmetic, force: Vector, potential: Arithmetic | None
) -> State:
    """p → (1 − γh) p − h ∇V, s → (1 − γh) s − h V: potential and damping by one step forward."""
    keep = 1 - scene.damping_at(x) * h
    p = tuple(keep * p - h * g for p, g in zip(x.p, force, strict=True))
    return x._replace(p=p, s=None if x.s is None else keep * x.s - h * potential)


def implicit_kick(
    scene: Mechanical, x: State, h: Arithmetic, force: Vector, potential: Arithmetic | None
) -> State:
    """p → (p − h ∇V)/(1 + γh), s → (s − h V)/(1 + γh): the adjoint, one step backward."""
    grown = 1 + scene.damping_at(x) * h
    p = tuple((p - h * g) / grown for p, g in zip(x.p, force, strict=True))
    return x._replace(p=p, s=None if x.s is None else (x.s - h * potential) / grown)


def pull(scene: Mechanical, x: State) -> tuple[Vector, Arithmetic | None]:
    return scene.gradient_at(x), None if x.s is None else scene.potential_at(x)


def drift(scene: Mechanical, x: OwnState, h: Arithmetic, xp: Namespace) -> State:
    x = mechanical.drift(scene, x, h, xp)
    after: State = x if scene.clock is None else x._replace(t=x.t + h)
    return after


def herglotz1(scene: Mechanical, x: State, h: Arithmetic, xp: Namespace) -> State:
    """s_{k+1} = s_k + h L(q_k, q_{k+1}, s_k), L = ½m‖(q_{k+1} − q_k)/h‖² − V(q_k) − γ s_k.

    V is taken at the left end, as s is.  D₂L = m(q_{k+1} − q_k)/h² and 1 + h ∂L/∂s = 1 − γh, hence
    m(q₁ − q₀)/h = (1 − γh) p₀ − h ∇V(q₀) = p₁: explicit.
    """
    return drift(scene, explicit_kick(scene, x, h, *pull(scene, x)), h, xp)


def herglotz2(scene: Mechanical, x: State, h: Arithmetic, xp: Namespace) -> State:
    """L = ½m‖(q_{k+1} − q_k)/h‖² − ½(V(q_k) + V(q_{k+1})) − ½γ(s_k + s_{k+1}), solved for s_{k+1}.

    m(q₁ − q₀)/h = (1 − ½γh) p₀ − ½h ∇V(q₀) and p₁ = (m(q₁ − q₀)/h − ½h ∇V(q₁))/(1 + ½γh): explicit.
    """
    x = drift(scene, explicit_kick(scene, x, h / 2, *pull(scene, x)), h, xp)
    return implicit_kick(scene, x, h / 2, *pull(scene, x))


def factor1(scene: Mechanical, h: Arithmetic, xp: Namespace) -> Arithmetic:
    return 1 - scene.gamma * h


def factor2(scene: Mechanical, h: Arithmetic, xp: Namespace) -> Arithmetic:
    return (1 - scene.gamma * h / 2) / (1 + scene.gamma * h / 2)


@dataclass(frozen=True)
class SecondHerglotz(Herglotz):
    def advance(
        self, scene: Any, x: OwnState, h: Arithmetic, n: Count, xp: Namespace, repeat: Repeat = repeat
    ) -> State:
        half = h / 2

        def joined(x: State) -> State:
            here = pull(scene, x)
            x = explicit_kick(scene, implicit_kick(scene, x, half, *here), half, *here)
            return drift(scene, x, h, xp)

        x = drift(scene, explicit_kick(scene, x, half, *pull(scene, x)), h, xp)
        x = repeat.steps(n - 1, joined, x, h)
        return implicit_kick(scene, x, half, *pull(scene, x))

    def counts(self, scene: Scene, n: int, carry: Sequence[str] | None = None) -> int:
        return n + 1


_first = "discrete Herglotz recursion s + h L(q, q⁺, s); the paper, §5.1, eq. (79)"
_second = "Vermeeren, Bravetti, Seri, J. Phys. A 52, 445206 (2019), doi:10.1088/1751-8121/ab4767"
_both: dict[str, Any] = {"kind": "gradient", "family": "variational"}
METHODS.add(Herglotz("herglotz1", 1, herglotz1, about=_first, factor=factor1, **_both))
METHODS.add(SecondHerglotz("herglotz2", 2, herglotz2, about=_second, symmetric=True, factor=factor2, **_both))
