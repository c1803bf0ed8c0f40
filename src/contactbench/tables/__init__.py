"""The result tables: what their columns are, how they are stored, and where they were made."""

from contactbench.tables import declared as declared  # importing registers them
