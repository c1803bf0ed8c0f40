"""contactbench: contact splitting integrators against the established ones, measured."""

from contactbench.ensembles import Ensemble, ensemble
from contactbench.errors import BadInput, UnknownName
from contactbench.measure.laws import LAWS
from contactbench.methods import METHODS, fixed_step, prepare, solve
from contactbench.plugins import load_installed
from contactbench.scene import Mechanical, RigidBody, shifted
from contactbench.scenes import SCENES
from contactbench.solution import Counts, Solution, Status
from contactbench.truth import reference

__all__ = [
    "LAWS",
    "METHODS",
    "SCENES",
    "BadInput",
    "Counts",
    "Ensemble",
    "Mechanical",
    "RigidBody",
    "Solution",
    "Status",
    "UnknownName",
    "ensemble",
    "fixed_step",
    "prepare",
    "reference",
    "shifted",
    "solve",
]
__version__ = "0.1.0"

load_installed()
