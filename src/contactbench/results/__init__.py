"""The result tables: what their columns are, how they are stored, and where they were made."""

# importing registers them, in this order
from contactbench.results import tables as tables  # isort: skip
from contactbench.results import long_time as long_time  # isort: skip
