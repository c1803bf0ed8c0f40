"""Inline Markdown and simple mathtext (see rooms.py) as HTML, as plain words, or as runs of words."""

from __future__ import annotations

import re
from collections.abc import Mapping

from markupsafe import Markup, escape

INLINE = re.compile(
    r"\$(?P<math>[^$]+)\$|\^\{(?P<sup>[^{}]+)\}|`(?P<code>[^`]+)`|\*\*(?P<strong>.+?)\*\*|\*(?P<em>[^*]+)\*|\[(?P<text>[^]]+)\]\((?P<to>[^)]+)\)"
)
#: an address that is not a file beside the page, an anchor, or a page of the web
SCHEME = re.compile(r"\s*(?!https?:)[a-z][a-z0-9+.-]*:", re.IGNORECASE)


def inline(text: str, addresses: Mapping[str, str] | None = None) -> Markup:
    """Inline Markdown (see rooms.py) as HTML, everything else escaped.

    addresses : where documents are on this page (file name → anchor); other files are linked beside it.
    """
    out, last = Markup(), 0
    for found in INLINE.finditer(text):
        out += escape(text[last : found.start()])
        kind = str(found.lastgroup)
        if kind == "to" and SCHEME.match(found["to"]):
            out += escape(found[0])
        elif kind == "to":
            to = found["to"]
            out += Markup('<a href="{}">{}</a>').format((addresses or {}).get(to, to), inline(found["text"]))
        else:
            inside = escape(found[kind]) if kind == "code" else inline(found[kind], addresses)
            out += (
                mathematics(found[0])
                if kind == "math"
                else Markup("<{0}>{1}</{0}>").format(Markup(kind), inside)
            )
        last = found.end()
    return out + escape(text[last:])


def mathematics(text: str) -> Markup:
    """Simple mathtext with its superscripts and subscripts."""
    tags = {1: "<sup>{}</sup>", -1: "<sub>{}</sub>"}
    return Markup().join(Markup(tags.get(level, "{}")).format(word) for word, level in runs(text))


def plain(text: str) -> str:
    """Inline Markdown and simple mathtext as plain words."""
    return "".join({1: "^", -1: "_"}.get(level, "") + word for word, level in runs(text))


def worded(found: re.Match[str]) -> str:
    """Marked words without their marks; a superscript as it is typed."""
    if found.lastgroup == "sup":
        return f"^({found['sup']})"
    return found["text" if found.lastgroup == "to" else str(found.lastgroup)]


SYMBOLS = {r"\Vert": "‖", r"\int": "∫", r"\Gamma": "Γ", r"\ast": "*", r"\mu": "µ", r"\,": " ", "\\": ""}
SHIFTED = re.compile(r"([\^_])(?:\{([^}]*)\}|(.))")


def runs(text: str) -> list[tuple[str, int]]:
    """Inline Markdown and simple mathtext as words and their level: 1 a superscript, −1 a subscript."""
    out: list[tuple[str, int]] = []
    for i, part in enumerate(text.split("$")):
        if i % 2 == 0:
            words = INLINE.sub(worded, part)
            out.append((words, 0))
            continue
        for sign, symbol in SYMBOLS.items():
            part = part.replace(sign, symbol)
        last = 0
        for found in SHIFTED.finditer(part):
            out.append((part[last : found.start()], 0))
            out.append((found[2] or found[3], 1 if found[1] == "^" else -1))
            last = found.end()
        out.append((part[last:], 0))
    return [(word, level) for word, level in out if word]


def breakable(text: str) -> Markup:
    """Text that may be broken after an underscore."""
    return Markup(str(escape(text)).replace("_", "_<wbr>"))
