"""Faults for the gate to find, planted as a user's plug-in would: by what is registered.

`plugin` writes the plug-in file that calls one of the functions below; it is given to the benchmark
(``--plugin``) or named in the environment of the processes that are timed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import contactbench as cb
from contactbench.methods import METHODS
from contactbench.methods.contact import ContactMethod, contact_method
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.prepared import Prepared, Request
from contactbench.numbers.control import Repeat, repeat
from contactbench.scene import Scene
from contactbench.splitting.composition import ONE, Composition
from contactbench.splitting.tables import STRANG

LARGER = Fraction(1001, 1000)
#: the contact method that most faults are planted in
PLANTED = STRANG.name


def plugin(path: Path, call: str) -> Path:
    """A plug-in file that plants a fault: ``call`` is that of a function of this module."""
    lines = (
        "import sys",
        f"sys.path.append({str(Path(__file__).parent)!r})",
        "import planted_faults",
        f"planted_faults.{call}",
    )
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def put(method: Any) -> None:
    """Register a method, or what stands in for one, in the place of the one of its name."""
    assert method.name in METHODS
    dict.__setitem__(METHODS, method.name, method)


def remade(kind: type, method: Any) -> Any:
    """A registered method as one of another class with the same fields."""
    return kind(**{field.name: getattr(method, field.name) for field in fields(method)})


# -- coefficients ----------------------------------------------------------------------------------
def faulty(composition: Composition) -> list[Composition]:
    """The composition with one coefficient a part in a thousand larger, for each of them."""
    return [
        replace(
            composition, **{which: tuple((n, c * LARGER if i == k else c) for i, (n, c) in enumerate(stages))}
        )
        for which, stages in (("stages", composition.stages), ("processor", composition.processor))
        for k in range(len(stages))
    ]


def wrong_coefficient(k: int) -> None:
    """The k-th coefficient of the contact method is a part in a thousand larger."""
    put(contact_method(faulty(STRANG)[k]))


# -- other faults ----------------------------------------------------------------------------------
def order_one() -> None:
    """The composition of order 2 replaced by one of order 1, under its name and with its claims."""
    lie = replace(STRANG, stages=(("kick", ONE), ("drift_damp", ONE)))
    put(replace(contact_method(lie), symmetric=True))


def joints_left_apart() -> None:
    """Neighbouring stages are not merged from step to step: a gradient more for each step."""
    of = METHODS[PLANTED]
    claims = {"kind": "gradient", "family": "contact", "contact": True, "symmetric": True}
    put(FixedStep(of.name, of.order, of.step, evaluations=2, about=of.about, **claims))


class Refusing(ContactMethod):
    def refuses(self, scene: Scene) -> str:
        return "planted"


def refusal() -> None:
    """A method refuses every scene."""
    put(remade(Refusing, METHODS[PLANTED]))


class StrongerDamping(ContactMethod):
    def advance(self, scene: Any, x: Any, h: Any, n: Any, xp: Any, repeat: Repeat = repeat) -> Any:
        gamma, *rest = scene.numbers()
        return super().advance(scene.with_numbers([gamma * (1 + 1e-9), *rest]), x, h, n, xp, repeat)


def stronger_damping() -> None:
    """A mechanical scene is damped more strongly by a part in 10⁹."""
    put(remade(StrongerDamping, METHODS[PLANTED]))


# -- speed -----------------------------------------------------------------------------------------
class Slower:
    """A fixed-step method whose every run is preceded by one over a share of its time, at the same step."""

    def __init__(self, method: FixedStep, share: float) -> None:
        self.method, self.share = method, share

    def __getattr__(self, name: str) -> Any:
        return getattr(self.method, name)

    def prepare(self, request: Request) -> Prepared:
        run = self.method.prepare(request)
        once = run.integrate
        part = self.method.prepare(replace(request, save_at=self.share * request.save_at))

        def integrate(y0: Any) -> Any:
            part.integrate(y0)
            return once(y0)

        run.integrate = integrate
        return run


def slower(names: Sequence[str], factor: float, tree: str) -> None:
    """Methods take `factor` times as long, in processes that run the sources of `tree`."""
    if Path(cb.__file__).is_relative_to(tree):
        for name in names:
            put(Slower(METHODS[name], factor - 1))
