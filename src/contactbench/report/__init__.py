"""Reports: documents, figures and one page, from the tables alone.

A chapter answers one question with views and figures as data (chapters.py, views.py, drawing.py; its prose is in
chapters.toml);
markdown.py, draw.py and page/ render them.
"""

# headline imports the others
from contactbench.report import damping, ensemble, gradients, headline, long_time, scaling, stability
