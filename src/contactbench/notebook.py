"""Show named facts as a table in notebooks."""

from collections.abc import Mapping
from html import escape


def html_table(rows: Mapping[str, object], title: str = "") -> str:
    """Return names and values as an HTML table."""
    cells = (f"<tr><th>{escape(name)}</th><td>{escape(str(value))}</td></tr>" for name, value in rows.items())
    return f"<table><caption>{escape(title)}</caption>{''.join(cells)}</table>"
