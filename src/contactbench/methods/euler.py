"""Symplectic Euler with the damping treatments of game engines: v ← d v + h a, x ← x + h v.

They differ in d alone, which damps both s and p: every step is a conformal contact map with the factor d.  The motion
has the factor e^{−γh}, the exact flow of γ s.  The others damp at the rates −log(1 − γh)/h ≈ γ + γ²h/2 and
log(1 + γh)/h ≈ γ − γ²h/2, which change with the step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from contactbench.methods.base import METHODS, unfit
from contactbench.methods.fixed_step import FixedStep
from contactbench.numbers.protocol import Arithmetic, Namespace
from contactbench.scene import Mechanical, Scene, State, mechanical

#: d, as a function of γh
Damped = Callable[[Arithmetic, Namespace], Arithmetic]
#: name → d, whether the motion has this factor, and who does it
TREATMENTS: dict[str, tuple[Damped, bool, str]] = {
    "euler-explicit-damping": (lambda z, xp: 1 - z, False, "damping 1 − γh, as of Godot's bodies"),
    "euler-implicit-damping": (lambda z, xp: 1 / (1 + z), False, "damping 1/(1 + γh), as of Box2D's bodies"),
    "euler-contact": (lambda z, xp: xp.exp(-z), True, "damping e^{−γh}, the exact contact flow"),
}


@dataclass(frozen=True)
class DampedEuler(FixedStep):
    """Separable scenes with constant damping, one gradient a step."""

    def refuses(self, scene: Scene) -> str | None:
        fits = scene.separable and scene.conformal_rate is not None and scene.clock is None
        return unfit(
            self, scene, fits, "a configuration q in Rⁿ, forces free of the time and damping Γ = γ s"
        )


def euler(name: str, damped: Damped, exact: bool, about: str) -> DampedEuler:
    def factor(scene: Mechanical, h: Arithmetic, xp: Namespace) -> Arithmetic:
        return damped(scene.gamma * h, xp)

    def step(scene: Mechanical, x: State, h: Arithmetic, xp: Namespace) -> State:
        d = factor(scene, h, xp)
        p, s = tuple(d * c for c in x.p), None if x.s is None else d * x.s
        return mechanical.drift(scene, mechanical.kick(scene, x._replace(p=p, s=s), h, xp), h, xp)

    family, own = ("contact", None) if exact else ("established", factor)
    about = f"symplectic Euler, {about}"
    return DampedEuler(name, 1, step, kind="gradient", about=about, family=family, contact=exact, factor=own)


for _name, _treatment in TREATMENTS.items():
    METHODS.add(euler(_name, *_treatment))
