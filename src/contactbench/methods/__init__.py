"""Our methods; those of other libraries are in `peers`.

A module here registers its own and is imported without being listed anywhere.
"""

from contactbench.methods.base import METHODS, prepare, solve
from contactbench.methods.fixed_step import fixed_step
from contactbench.registry import import_modules

#: in table order; what other modules register comes after them
FIRST = ("contact", "contact_exact", "contact_gauss", "runge_kutta", "herglotz", "multistep")

import_modules(__name__, FIRST)
