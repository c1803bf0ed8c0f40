"""Reports: documents, figures and one page, from the tables alone.

A chapter answers one question with views and figures as data (chapters.py, views.py, drawing.py; its prose is in
chapters.toml); a module here that adds one is found without being listed anywhere.
markdown.py, draw.py and page/ render them.
"""
