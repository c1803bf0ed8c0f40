"""Documents, page and figures, from the tables alone: nothing is solved here.

A room answers one question with views, figures and findings as data (cells.py, drawing.py, rooms.py);
markdown.py, draw.py and page/ write them down.
"""

from contactbench.report import (  # registers the rooms, in no particular order
    claims,
    convergence,
    damping,
    definitions,
    ensemble,
    headline,
    laws,
    limits,
    long_time,
    stability,
    work_precision,
)
