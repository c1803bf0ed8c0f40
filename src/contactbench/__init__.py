"""Measure contact splitting integrators against the established ones.

All quantities are without dimension.  Shapes in docstrings: k saved times, n degrees of freedom or trajectories, d
components of a packed state, m tangent directions.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from contactbench import peers
from contactbench.errors import BadInput, UnknownName
from contactbench.measure.laws import LAWS
from contactbench.methods import METHODS, fixed_step, prepare, solve
from contactbench.methods.adaptive import adaptive
from contactbench.methods.contact_gauss import gauss
from contactbench.methods.one_step import step_map
from contactbench.methods.prescribed import geometric_steps
from contactbench.numbers import functions as math
from contactbench.plugins import load_installed
from contactbench.scene import (
    ContactSystem,
    Driven,
    Equations,
    GeneralDamping,
    HeavyTop,
    Mechanical,
    RigidBody,
    Spheres,
    shifted,
)
from contactbench.scenes import SCENES
from contactbench.solution import Counts, Solution, Status
from contactbench.tables.declared import results
from contactbench.truth import reference

if TYPE_CHECKING:
    from contactbench.interop import diffrax, scipy
    from contactbench.measure.own_composition import composition
    from contactbench.study.compare import compare

__all__ = ["LAWS", "METHODS", "SCENES", "BadInput", "ContactSystem", "Counts", "Driven"]
__all__ += ["adaptive"]
__all__ += ["Equations", "GeneralDamping", "HeavyTop", "Mechanical"]
__all__ += ["RigidBody", "Solution", "Spheres", "Status", "UnknownName", "compare", "composition"]
__all__ += [
    "fixed_step",
    "gauss",
    "geometric_steps",
    "math",
    "prepare",
    "reference",
    "results",
]
__all__ += ["shifted", "solve", "step_map"]
__version__ = "0.2.0"


#: public name → module; they are imported at the first access
LATER = {"composition": "measure.own_composition", "compare": "study.compare"}
#: parts that are modules, named as the library that they go with
PARTS = ("diffrax", "scipy")


def __getattr__(name: str) -> Any:
    if name in PARTS:
        globals()[name] = part = import_module(f"{__name__}.interop.{name}")
        return part
    if name not in LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = found = getattr(import_module(f"{__name__}.{LATER[name]}"), name)
    return found


def __dir__() -> list[str]:
    return sorted([*__all__, *PARTS, "__version__"])


load_installed()
