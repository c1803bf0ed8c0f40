"""Documents and figures from the tables of a folder alone: nothing is solved here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from contactbench.errors import BadInput
from contactbench.report import draw, glossary, headline, markdown, page
from contactbench.report.chapters import Contents, Frames, Tables, contents, figures
from contactbench.report.drawing import Figure
from contactbench.report.figures.work_precision import live
from contactbench.results.provenance import runs
from contactbench.results.schema import TABLES
from contactbench.results.store import read, replacing

README_PART = ("<!-- computed from results/: begin -->\n", "<!-- computed from results/: end -->")


def tables(results: Path) -> Tables:
    """Return every table of a folder; those without a file have no rows."""
    return Tables({name: read(table, results) for name, table in TABLES.items()})


def chapters_of(frames: Frames, recorded: Sequence[Mapping[str, Any]]) -> list[Contents]:
    """Return every chapter that has something to say; the first ends with the machine.

    recorded : the records of the benchmark runs.
    """
    return [
        replace(one, parts=(*one.parts, headline.machine(recorded)))
        if one.chapter.name == headline.NAME
        else one
        for one in contents(frames)
    ]


def documents(found: Sequence[Contents], registries: glossary.Registries) -> dict[str, str]:
    """Return the documents, file name → text."""
    texts = {one.chapter.file: markdown.document(one) for one in found}
    if texts:
        texts["glossary.md"] = f"# Glossary\n\n{markdown.parts(glossary.parts(registries))}\n"
    return texts


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


def into_readme(readme: Path, frames: Frames) -> None:
    """Fill in the computed part of a README."""
    text = with_answers(readme, frames)
    with replacing(readme) as file:
        file.write(text)


def render(
    results: Path, frames: Frames, registries: glossary.Registries
) -> tuple[dict[str, str], list[Figure]]:
    """Return documents and the page, file name → text, and the figures that the tables of a folder allow."""
    recorded = runs(results)
    found = chapters_of(frames, recorded)
    texts = documents(found, registries)
    if texts:
        texts["report.html"] = page.page(
            found, recorded, glossary.parts(registries), page.LINKS, live(frames)
        )
    drawn = {figure.name: figure for one in found for figure in figures(one.parts)}
    return texts, list(drawn.values())


def report(
    results: Path, registries: glossary.Registries, readme: Path | None = None, png: bool = False
) -> list[Path]:
    """Write every document and figure the tables allow, and the page; return the paths.

    Figures of an earlier report that no table gives any more are removed.
    readme : a file whose computed part is filled in too.  png : whether figures are saved as pictures too.
    """
    frames = tables(results)
    texts, drawn = render(results, frames, registries)
    written = []
    for name, text in texts.items():
        with replacing(results / name) as file:
            file.write(text)
        written.append(results / name)
    for figure in drawn:
        written += draw.save(figure, results / "figures", png)
    for path in (results / "figures").glob("*.svg"):
        if path not in written and draw.MADE_HERE in path.read_text(encoding="utf-8"):
            path.unlink()
    if readme is not None:
        into_readme(readme, frames)
        written.append(readme)
    return written
