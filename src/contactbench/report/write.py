"""Documents and figures from the tables of a folder alone, and whether the committed ones say what the tables say.

Nothing is solved here.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from contactbench.errors import BadInput
from contactbench.report import draw, headline, markdown, page
from contactbench.report.chapters import Frames, Tables, chapters, every
from contactbench.report.drawing import Figure
from contactbench.report.glossary import Registries, glossary
from contactbench.results.provenance import runs
from contactbench.results.schema import TABLES
from contactbench.results.store import read, replacing

README_PART = ("<!-- computed from results/: begin -->\n", "<!-- computed from results/: end -->")
#: points by which what is drawn may be elsewhere
APART = 0.02
NAME = re.compile(r"\b[a-z]+[0-9a-f]{10}\b")
NUMBER = re.compile(r"(?<![\w#.])[-+]?\d+\.?\d*(?:e[-+]?\d+)?")


def tables(results: Path) -> Tables:
    """Return every table of a folder; those without a file have no rows."""
    return Tables({name: read(table, results) for name, table in TABLES.items()})


def documents(
    results: Path, registries: Registries, readme: Path | None
) -> tuple[dict[Path, str], list[Figure]]:
    """Return the text of every file that the tables of a folder give, and the figures among them."""
    frames, recorded = tables(results), runs(results)
    found = [chapter.fill(frames) for chapter in chapters(frames)]
    if found and found[0].chapter.name == headline.NAME:
        found[0] = replace(found[0], parts=(*found[0].parts, headline.machine(recorded)))
    drawn = list({figure.name: figure for one in found for figure in every(Figure, one.parts)}.values())
    words = glossary(registries)
    texts = {one.chapter.file: markdown.document(one) for one in found}
    texts["glossary.md"] = f"# Glossary\n\n{markdown.parts(words)}\n"
    texts["report.html"] = page.page(found, recorded, words, page.LINKS)
    texts |= {f"figures/{figure.name}.svg": draw.svg(figure) for figure in drawn}
    paths = {results / name: text for name, text in texts.items()}
    return paths | ({readme: with_answers(readme, frames)} if readme else {}), drawn


def parts_beside(readme: Path) -> tuple[str, str]:
    """Return a README's text before its computed part and after it.  Raises `BadInput` without its marks."""
    text = readme.read_text(encoding="utf-8")
    begin, end = README_PART
    if text.count(begin) != 1 or text.count(end) != 1:
        raise BadInput(f"{readme}: needs the lines {begin.strip()!r} and {end!r}, once each")
    return text.partition(begin)[0], text.partition(end)[2]


def with_answers(readme: Path, frames: Frames) -> str:
    """Return a README's text with its computed part as the tables have it."""
    (before, after), (begin, end) = parts_beside(readme), README_PART
    return f"{before}{begin}\n{markdown.answers(headline.answers(frames))}\n\n{end}{after}"


def report(
    results: Path, registries: Registries, readme: Path | None = None, png: bool = False
) -> list[Path]:
    """Write every document and figure the tables allow, and the page; return the paths.

    Figures of an earlier report that no table gives any more are removed.
    readme : a file whose computed part is filled in too.  png : whether figures are saved as pictures too.
    """
    texts, drawn = documents(results, registries, readme)
    (results / "figures").mkdir(exist_ok=True)
    for path, text in texts.items():
        with replacing(path) as file:
            file.write(text)
    for path in (results / "figures").glob("*.svg"):
        if path not in texts and draw.MADE_HERE in path.read_text(encoding="utf-8"):
            path.unlink()
    return [*texts, *(draw.save_png(figure, results / "figures") for figure in drawn if png)]


# -- do the committed documents and figures say what the committed tables say? -----------------------
def differing(results: Path, readme: Path | None, registries: Registries) -> list[str]:
    """Return one line for each document, figure or README that is not what the tables of the folder give."""
    wanted, _ = documents(results, registries, readme)
    lines = []
    for path, text in wanted.items():
        if not path.exists():
            lines.append(f"{path}: missing")
        elif not same(path.read_text(encoding="utf-8"), text, path.suffix == ".svg"):
            lines.append(f"{path}: not what the tables say")
    there = {path for pattern in ("*.md", "*.html", "figures/*.svg") for path in results.glob(pattern)}
    return lines + [f"{path}: no table gives it" for path in sorted(there - wanted.keys())]


def same(one: str, other: str, drawn: bool) -> bool:
    """Return whether two texts are the same; drawings but for the last digits of places."""
    if one == other or not drawn:
        return one == other
    (words, numbers), (other_words, other_numbers) = split(one), split(other)
    return words == other_words and bool(np.allclose(numbers, other_numbers, rtol=0, atol=APART))


def split(drawing: str) -> tuple[list[str], list[float]]:
    """Return what a drawing has but numbers, and the numbers.

    Paths that are defined once and used again have names by content; here they have numbers in order.
    """
    names: dict[str, str] = {}
    text = NAME.sub(lambda name: names.setdefault(name[0], f"name {len(names)}"), drawing)
    return NUMBER.split(text), [float(number) for number in NUMBER.findall(text)]
