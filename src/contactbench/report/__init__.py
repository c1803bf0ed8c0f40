"""Reports: documents, figures and one page, from the tables alone.

A chapter answers one question with views and figures as data (chapters.py, views.py, drawing.py; its prose is in
chapters.toml); a module here that adds one is imported without being listed anywhere.
markdown.py, draw.py and page/ render them.
"""

from contactbench.registry import import_modules

import_modules(__name__, without=("draw", "write"))  # these need matplotlib, which takes long to load
