"""Faults for the gate to find, planted as a user's plug-in would: by what is registered.

`plugin` writes the plug-in file that calls one of the functions below; it is given to the benchmark
(``--plugin``) or named in the environment of the processes that are timed.
"""

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import contactbench as cb
from contactbench.methods import METHODS
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.prepared import Prepared, Request
from contactbench.splitting.composition import Composition

LARGER = Fraction(1001, 1000)


def plugin(path: Path, call: str) -> Path:
    """A plug-in file that plants a fault: ``call`` is that of a function of this module."""
    here = str(Path(__file__).parent)
    text = f"import sys\nsys.path.append({here!r})\nimport planted_faults\nplanted_faults.{call}\n"
    path.write_text(text, encoding="utf-8")
    return path


def put(method: Any) -> None:
    """Register a method, or what stands in for one, in the place of the one of its name."""
    assert method.name in METHODS
    dict.__setitem__(METHODS, method.name, method)


# -- coefficients ----------------------------------------------------------------------------------
def faulty(composition: Composition) -> list[Composition]:
    """The composition with one coefficient a part in a thousand larger, for each of them."""
    found = []
    for which in ("stages", "processor"):
        stages = getattr(composition, which)
        for k, (name, c) in enumerate(stages):
            other = (*stages[:k], (name, c * LARGER), *stages[k + 1 :])
            found.append(replace(composition, **{which: other}))
    return found


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
