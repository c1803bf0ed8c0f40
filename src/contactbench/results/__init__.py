"""The result tables: what their columns are, how they are stored, and where they were made."""

# isort: off  (imported is registered, in this order)
from contactbench.results import long_time as long_time
from contactbench.results import selfcheck as selfcheck
from contactbench.results import tables as tables
