"""Our methods; those of other libraries are in `peers`.

Each module registers its own; to add one, write a module and import it here.
"""

# ruff: noqa: I001 (imported to be registered, in table order)

from contactbench.methods import contact, contact_exact, rk4, herglotz, multistep, implicit
from contactbench.methods.base import METHODS, prepare, solve
from contactbench.methods.fixed_step import fixed_step
