"""``report.html``: all chapters on one page that needs no network.

A renderer: it knows no question, no table and no method.  Figures are the SVG files beside the page; tables are
embedded as JSON and drawn when they are opened.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence

import jinja2
from markupsafe import Markup, escape

from contactbench.report.chapters import Contents, Part, every
from contactbench.report.views import Cell, View

#: where readers go from here: documents beside the page, and the source above it
LINKS = {
    "which method?": "which.md",
    "results as text": "README.md",
    "the paper and its claims": "claims.md",
    "glossary": "glossary.md",
    "source": "../README.md",
}

# -- inline Markdown and simple mathtext as HTML; everything else is escaped -----------------------
INLINE = re.compile(
    r"\$(?P<math>[^$]+)\$|\^\{(?P<sup>[^{}]+)\}|`(?P<code>[^`]+)`|\*\*(?P<strong>.+?)\*\*|\*(?P<em>[^*]+)\*"
    r"|\[(?P<text>[^]]+)\]\((?P<to>[^)]+)\)"
)
#: an address that is not a file beside the page, an anchor, or a page of the web
SCHEME = re.compile(r"\s*(?!https?:)[a-z][a-z0-9+.-]*:", re.IGNORECASE)
SYMBOLS = {r"\Vert": "‖", r"\int": "∫", r"\Gamma": "Γ", r"\ast": "*", r"\mu": "µ", r"\,": " ", "\\": ""}
SHIFTED = re.compile(r"(?P<sign>[\^_])(?:\{(?P<group>[^}]*)\}|(?P<letter>.))")


def inline(text: str, addresses: Mapping[str, str] | None = None) -> Markup:
    """Return inline Markdown (see views.py) as HTML; addresses : file name → anchor of what is on this page."""

    def mark(found: re.Match[str]) -> Markup:
        kind = str(found.lastgroup)
        if kind == "math":
            return mathematics(found["math"])
        if kind == "code":
            return Markup("<code>{}</code>").format(found["code"])
        if kind != "to":
            return Markup(f"<{kind}>{{}}</{kind}>").format(inline(found[kind], addresses))
        if SCHEME.match(found["to"]):
            return escape(found[0])
        address = (addresses or {}).get(found["to"], found["to"])
        return Markup('<a href="{}">{}</a>').format(address, inline(found["text"]))

    return substitute(INLINE, text, mark)


def mathematics(text: str) -> Markup:
    for sign, symbol in SYMBOLS.items():
        text = text.replace(sign, symbol)

    def shift(found: re.Match[str]) -> Markup:
        tag = "sup" if found["sign"] == "^" else "sub"
        return Markup(f"<{tag}>{{}}</{tag}>").format(found["group"] or found["letter"])

    return substitute(SHIFTED, text, shift)


def substitute(pattern: re.Pattern[str], text: str, mark: Callable[[re.Match[str]], Markup]) -> Markup:
    out, last = Markup(), 0
    for found in pattern.finditer(text):
        out += escape(text[last : found.start()]) + mark(found)
        last = found.end()
    return out + escape(text[last:])


# -- tables as JSON --------------------------------------------------------------------------------
#: a text, or a text, what it is sorted by, its mark and its link, as far as there are such
type Entry = str | list[str | float | None]


def cell(of: Cell, addresses: Mapping[str, str]) -> Entry:
    value = None if of.value is None else float(f"{of.value:.6g}")
    text, link = str(inline(of.text, addresses)), addresses.get(of.link, of.link)
    more: list[str | float | None] = [text, value, of.mark or "", link]
    while not more[-1] and len(more) > 1:
        more.pop()
    return more if more[1:] else text


def table(view: View, addresses: Mapping[str, str]) -> dict[str, object]:
    heads = [[str(inline(head.label)), int(head.words), head.group] for head in view.columns]
    return {
        "title": view.title,
        "legend": str(inline(view.legend, addresses)),
        "source": view.source,
        "heads": heads,
        "rows": [[cell(entry, addresses) for entry in row] for row in view.rows],
    }


# -- the page --------------------------------------------------------------------------------------
def page(
    contents: Sequence[Contents],
    recorded: Sequence[Mapping[str, object]] = (),
    glossary: Sequence[Part] = (),
    links: Mapping[str, str] | None = None,
    images: Mapping[str, str] | None = None,
) -> str:
    """Return the HTML.

    recorded : runs behind the tables.  images : addresses of figures that are no files beside the page, by name.
    """
    addresses = {one.chapter.file: f"#{one.chapter.name}" for one in contents}
    shown = [*(part for one in contents for part in one.parts), *glossary]
    views = {view.name: table(view, addresses) for view in every(View, shown)}
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("contactbench.report", "page"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters["inline"] = lambda text: inline(text, addresses)
    environment.filters["kind"] = lambda part: type(part).__name__
    text = json.dumps(views, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return environment.get_template("page.html").render(
        data=text.replace("<", "\\u003c"),  # it stands inside a script element
        contents=contents,
        images=images or {},
        runs=recorded,
        glossary=glossary,
        links=links or {},
    )
