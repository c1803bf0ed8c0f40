"""The result tables: what their columns are, how they are stored, and where they were made."""

from contactbench.results import tables as tables  # importing registers them
