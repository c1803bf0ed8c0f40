"""Do the committed documents and figures say what the committed tables say?"""

from __future__ import annotations

import re
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from contactbench.report import draw, glossary
from contactbench.report.write import render, tables, with_answers

#: points by which what is drawn may be elsewhere
APART = 0.02
NUMBER = re.compile(r"(?<![\w#.])[-+]?\d+\.?\d*(?:e[-+]?\d+)?")


def differing(results: Path, readme: Path | None, registries: glossary.Registries) -> list[str]:
    """Return one line for each document, figure or README that is not what the tables of the folder give.

    Documents and the page are compared as text; figures are drawn again, and what is drawn is compared.
    """
    frames = tables(results)
    texts, drawn = render(results, frames, registries)
    wanted = {results / name: text for name, text in texts.items()}
    if readme is not None:
        wanted[readme] = with_answers(readme, frames)
    there = {path for pattern in ("*.md", "*.html", "figures/*.svg") for path in results.glob(pattern)}
    found = {
        path: path.read_text(encoding="utf-8") == text if path.exists() else None
        for path, text in wanted.items()
    }
    with TemporaryDirectory() as scratch:
        for figure in drawn:
            fresh = draw.save(figure, Path(scratch))[0]
            path = results / "figures" / fresh.name
            found[path] = same_drawing(path, fresh) if path in there else None
    said = {None: "missing", False: "not what the tables say"}
    lines = [f"{path}: {said[same]}" for path, same in found.items() if same is not True]
    return lines + [f"{path}: no table gives it" for path in sorted(there - found.keys())]


def shapes(path: Path) -> tuple[list[str], np.ndarray]:
    """Return everything that an .svg file draws but numbers, in order, and the numbers.

    Paths that are defined once and used again have names by content, which here are numbers in order.
    """
    text = path.read_text(encoding="utf-8")
    text = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", text, flags=re.DOTALL)
    names: dict[str, str] = {}
    text = re.sub(
        r"\b[a-z]+[0-9a-f]{10}\b", lambda name: names.setdefault(name[0], f"name {len(names)}"), text
    )
    return NUMBER.split(text), np.array([float(number) for number in NUMBER.findall(text)])


def same_drawing(one: Path, other: Path) -> bool:
    """Return whether two .svg files draw the same, but for the last digits of places."""
    (words, numbers), (other_words, other_numbers) = shapes(one), shapes(other)
    return words == other_words and bool(np.allclose(numbers, other_numbers, rtol=0, atol=APART))
