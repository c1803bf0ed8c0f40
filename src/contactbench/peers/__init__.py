"""The established solvers.  A module here registers its own and is imported without being listed anywhere."""

from contactbench.registry import import_modules

#: in table order; what other modules register comes after them
FIRST = ("scipy", "sundials", "cyrk", "diffrax", "heyoka")

import_modules(__name__, FIRST)
