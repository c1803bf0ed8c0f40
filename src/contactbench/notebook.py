"""How notebooks show what has a name and a few facts."""

from collections.abc import Mapping
from html import escape


def html_table(rows: Mapping[str, object], title: str = "") -> str:
    """Return two columns as a table of HTML."""
    cells = (f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>" for name, value in rows.items())
    return f"<table><caption>{escape(title)}</caption>{''.join(cells)}</table>"
