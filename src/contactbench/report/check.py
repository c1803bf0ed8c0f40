"""Do the committed documents and figures say what the committed tables say?"""

from __future__ import annotations

import re
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

from contactbench.report import draw, glossary
from contactbench.report.write import made, tables, with_excerpt

#: points by which what is drawn may be elsewhere
APART = 0.01
#: by how much a colour may be another, and the share of them that may be more: less than a marker
COLOUR, SPOTS = 0.1, 1e-5
NUMBER = re.compile(r"(?<![\w#.])[-+]?\d+\.?\d*(?:e[-+]?\d+)?")


def differing(results: Path, readme: Path | None, registries: glossary.Registries) -> list[str]:
    """One line for each document, figure or README that is not what the tables of the folder give.

    Documents and the page are compared as text; figures are drawn again, and what is drawn is compared.
    """
    frames = tables(results)
    with TemporaryDirectory() as scratch:
        with draw.in_background(Path(scratch)) as have_saved:
            texts, _ = made(results, frames, registries, have_saved)
        wanted = {results / name: text for name, text in texts.items()}
        if readme is not None:
            wanted[readme] = with_excerpt(readme, results, frames)
        found = []
        for path, text in wanted.items():
            if not path.exists():
                found.append(f"{path}: missing")
            elif path.read_text(encoding="utf-8") != text:
                found.append(f"{path}: not what the tables say")
        drawn = {results / "figures" / path.name: path for path in Path(scratch).iterdir()}
        there = {path for kind in ("svg", "png") for path in (results / "figures").glob(f"*.{kind}")}
        found += [f"{path}: missing" for path in sorted(drawn.keys() - there)]
        for path in sorted(drawn.keys() & there):
            same = same_vectors if path.suffix == ".svg" else same_pictures
            if not same(path, drawn[path]):
                found.append(f"{path}: not what the tables say")
    left = {path for kind in ("md", "html") for path in results.glob(f"*.{kind}")}
    others = (there - drawn.keys()) | (left - set(wanted))
    return found + [f"{path}: no table gives it" for path in sorted(others)]


def shapes(path: Path) -> tuple[list[str], np.ndarray]:
    """What an .svg file draws: everything but numbers, in order, and the numbers; whatever is not drawn is left out.

    Paths that are defined once and used again have names by content, which here are numbers in order.
    """
    text = path.read_text(encoding="utf-8")
    text = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", text, flags=re.DOTALL)
    names: dict[str, str] = {}
    text = re.sub(
        r"\b[a-z]+[0-9a-f]{10}\b", lambda name: names.setdefault(name[0], f"name {len(names)}"), text
    )
    return NUMBER.split(text), np.array([float(number) for number in NUMBER.findall(text)])


def same_vectors(one: Path, other: Path) -> bool:
    """Whether two .svg files draw the same: paths, points, colours and text, but for the last digits of places."""
    (words, numbers), (other_words, other_numbers) = shapes(one), shapes(other)
    return words == other_words and bool(np.allclose(numbers, other_numbers, rtol=0, atol=APART))


def same_pictures(one: Path, other: Path) -> bool:
    """Whether two .png files show the same, but for spots."""
    try:
        pixels, others = plt.imread(one), plt.imread(other)
    except (OSError, SyntaxError, ValueError):  # as the reader calls a damaged file
        return False
    return pixels.shape == others.shape and float(np.mean(np.abs(pixels - others) > COLOUR)) <= SPOTS
