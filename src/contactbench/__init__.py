"""contactbench: contact splitting integrators against the established ones, measured."""

from typing import TYPE_CHECKING, Any

from contactbench.ensembles import Ensemble, ensemble
from contactbench.errors import BadInput, UnknownName
from contactbench.measure.laws import LAWS
from contactbench.measure.own_composition import composition
from contactbench.methods import METHODS, fixed_step, prepare, solve
from contactbench.methods.one_step import step_map
from contactbench.numbers import functions as math
from contactbench.plugins import load_installed
from contactbench.results.shipped import results
from contactbench.scene import GeneralDamping, Mechanical, RigidBody, shifted
from contactbench.scenes import SCENES
from contactbench.solution import Counts, Solution, Status
from contactbench.truth import reference

if TYPE_CHECKING:
    from contactbench.race.comparison import compare

__all__ = [
    "LAWS",
    "METHODS",
    "SCENES",
    "BadInput",
    "Counts",
    "Ensemble",
    "GeneralDamping",
    "Mechanical",
    "RigidBody",
    "Solution",
    "Status",
    "UnknownName",
    "compare",
    "composition",
    "ensemble",
    "fixed_step",
    "math",
    "prepare",
    "reference",
    "results",
    "shifted",
    "solve",
    "step_map",
]
__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """What needs pandas and matplotlib, imported when first asked for."""
    if name == "compare":
        from contactbench.race.comparison import compare as found

        return found
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """The public names."""
    return sorted([*__all__, "__version__"])


load_installed()
