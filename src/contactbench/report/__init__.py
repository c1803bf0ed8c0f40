"""Documents, page and figures, from the tables alone: nothing is solved here.

A room (one file) answers one question with views, figures and findings as data (model.py); markdown.py,
draw.py and page/ write them down.
"""

from contactbench.report import (  # noqa: F401  registers the rooms, in no particular order
    claims,
    convergence,
    ensemble,
    gate_selfcheck,
    headline,
    laws,
    stability,
    work_precision,
)
