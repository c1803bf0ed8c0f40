"""Reports: documents, figures and one page, from the tables alone.

A chapter answers one question with a summary, views and figures as data (chapters.py, views.py, drawing.py);
markdown.py, draw.py and page/ render them.
"""

from contactbench.report import (  # registers the chapters, in no particular order
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
