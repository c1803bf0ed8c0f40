"""Reports: documents and figures, from the tables alone.

A chapter answers one question with views and figures as data (chapters.py, views.py, drawing.py; its prose is in
chapters.toml); a module here that adds one is found without being listed anywhere.
markdown.py and draw.py render them.
"""
