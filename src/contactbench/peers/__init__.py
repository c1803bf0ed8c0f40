"""The established solvers; every module here registers its solvers when this package is imported."""

from contactbench.registry import import_modules

#: in table order; all other modules follow by name
FIRST = ("scipy", "sundials", "cyrk", "diffrax", "heyoka")

import_modules(__name__, FIRST)
