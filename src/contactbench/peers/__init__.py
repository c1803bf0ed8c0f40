"""The established solvers.  Each module registers its own; to add one, write a module and import it here."""

# ruff: noqa: I001 (imported to be registered, in table order)

from contactbench.peers import scipy, sundials, cyrk, diffrax, heyoka
