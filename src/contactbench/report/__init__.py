"""Reports: documents, figures and one page, from the tables alone.

A chapter answers one question with a summary, views and figures as data (chapters.py, views.py, drawing.py);
markdown.py, draw.py and page/ render them.
"""

from contactbench.report import (
    claims,
    damping,
    ensemble,
    gradients,
    headline,
    long_time,
    scaling,
    stability,
    structure,
)
