"""Inline Markdown and simple mathtext as HTML; everything else is escaped."""

from __future__ import annotations

import re
from collections.abc import Mapping

from markupsafe import Markup, escape

INLINE = re.compile(
    r"\$(?P<math>[^$]+)\$|\^\{(?P<sup>[^{}]+)\}|`(?P<code>[^`]+)`|\*\*(?P<strong>.+?)\*\*|\*(?P<em>[^*]+)\*"
    r"|\[(?P<text>[^]]+)\]\((?P<to>[^)]+)\)"
)
#: an address that is not a file beside the page, an anchor, or a page of the web
SCHEME = re.compile(r"\s*(?!https?:)[a-z][a-z0-9+.-]*:", re.IGNORECASE)
SYMBOLS = {r"\Vert": "‖", r"\int": "∫", r"\Gamma": "Γ", r"\ast": "*", r"\mu": "µ", r"\,": " ", "\\": ""}
SHIFTED = re.compile(r"([\^_])(?:\{([^}]*)\}|(.))")


def inline(text: str, addresses: Mapping[str, str] | None = None) -> Markup:
    """Return inline Markdown (see views.py) as HTML.

    addresses : where documents are on this page (file name → anchor); other files are linked beside it.
    """
    out, last = Markup(), 0
    for found in INLINE.finditer(text):
        out += escape(text[last : found.start()])
        kind = str(found.lastgroup)
        if kind == "math":
            out += mathematics(found["math"])
        elif kind == "code":
            out += Markup("<code>{}</code>").format(found["code"])
        elif kind == "to" and SCHEME.match(found["to"]):
            out += escape(found[0])
        elif kind == "to":
            address = (addresses or {}).get(found["to"], found["to"])
            out += Markup('<a href="{}">{}</a>').format(address, inline(found["text"]))
        else:
            out += Markup(f"<{kind}>{{}}</{kind}>").format(inline(found[kind], addresses))
        last = found.end()
    return out + escape(text[last:])


def mathematics(text: str) -> Markup:
    """Return simple mathtext with its superscripts and subscripts as HTML."""
    for sign, symbol in SYMBOLS.items():
        text = text.replace(sign, symbol)
    out, last = Markup(), 0
    for found in SHIFTED.finditer(text):
        tag = "sup" if found[1] == "^" else "sub"
        shifted = Markup(f"<{tag}>{{}}</{tag}>").format(found[2] or found[3])
        out += escape(text[last : found.start()]) + shifted
        last = found.end()
    return out + escape(text[last:])
