"""Do the committed documents say what the committed tables say?"""

from __future__ import annotations

from pathlib import Path

from contactbench.report import draw, glossary
from contactbench.report.write import made, tables, with_excerpt


def differing(results: Path, readme: Path | None, registries: glossary.Registries) -> list[str]:
    """One line for each document, figure or README that is not what the tables of the folder give.

    Documents and the page are compared as text; figures by the digest of their data, because how they are
    drawn depends on the fonts of the machine.
    """
    frames = tables(results)
    texts, figures = made(results, frames, registries)
    wanted = {results / name: text for name, text in texts.items()}
    if readme is not None:
        wanted[readme] = with_excerpt(readme, results, frames)
    found = []
    for path, text in wanted.items():
        if not path.exists():
            found.append(f"{path}: missing")
        elif path.read_text(encoding="utf-8") != text:
            found.append(f"{path}: not what the tables say")
    drawn = {results / "figures" / f"{name}.{kind}" for name in figures for kind in ("svg", "png")}
    there = {path for kind in ("svg", "png") for path in (results / "figures").glob(f"*.{kind}")}
    left = {path for kind in ("md", "html") for path in results.glob(f"*.{kind}")}
    found += [f"{path}: missing" for path in sorted(drawn - there)]
    for name, figure in figures.items():
        path = results / "figures" / f"{name}.svg"
        if path in there and not draw.shows(path, figure):
            found.append(f"{path}: not what the tables say")
    return found + [f"{path}: no table gives it" for path in sorted((there - drawn) | (left - set(wanted)))]
