"""Documents and figures from the tables of a folder alone: nothing is solved here."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from contactbench.errors import BadInput
from contactbench.report import draw, glossary, headline, markdown, page
from contactbench.report.drawing import Figure
from contactbench.report.page import Said
from contactbench.report.rooms import Frames, Tables, figures, once, rooms
from contactbench.results.provenance import runs
from contactbench.results.schema import TABLES
from contactbench.results.store import read, replacing

Runs = Sequence[Mapping[str, Any]]  #: the records of the benchmark runs, oldest first
README_PART = ("<!-- computed from results/: begin -->\n", "<!-- computed from results/: end -->")


def tables(results: Path) -> Tables:
    """Every table of a folder; those without a file have no rows."""
    return Tables({name: read(table, results) for name, table in TABLES.items()})


def heard(frames: Frames, recorded: Runs) -> Iterator[Said]:
    """Every room that has something to say, with its parts and findings."""
    for room in rooms(frames):
        parts = tuple(room.sections(frames))
        if room.name == "headline":
            parts = (*parts, headline.machines(recorded))
        yield Said(room, parts, tuple(once(room.findings, frames)))


def documents(said: Iterable[Said], registries: glossary.Registries) -> dict[str, str]:
    """File name → text."""
    texts = {one.room.file: markdown.document(one.room, one.parts, one.findings) for one in said}
    if texts:
        texts["glossary.md"] = f"# Glossary\n\n{markdown.parts(glossary.sections(registries))}\n"
    return texts


def excerpt(frames: Frames, folder: str) -> str:
    """The computed part of a README that stands beside the results' folder."""
    return markdown.parts(headline.excerpt(frames), 3).replace("](#", f"]({folder}/README.md#")


def parts_beside(readme: Path) -> tuple[str, str]:
    """A README's text before its computed part and after it.  Raises `BadInput` without its marks."""
    text = readme.read_text(encoding="utf-8")
    begin, end = README_PART
    if text.count(begin) != 1 or text.count(end) != 1:
        raise BadInput(f"{readme}: needs the lines {begin.strip()!r} and {end!r}, once each")
    return text.partition(begin)[0], text.partition(end)[2]


def with_excerpt(readme: Path, results: Path, frames: Frames) -> str:
    """A README's text with its computed part as the tables of a folder have it."""
    (before, after), (begin, end) = parts_beside(readme), README_PART
    return f"{before}{begin}\n{excerpt(frames, results.name)}\n\n{end}{after}"


def into_readme(readme: Path, results: Path, frames: Frames) -> None:
    text = with_excerpt(readme, results, frames)
    with replacing(readme) as file:
        file.write(text)


def made(
    results: Path,
    frames: Frames,
    registries: glossary.Registries,
    have_saved: Callable[[Figure], object] = lambda figure: None,
) -> tuple[dict[str, str], dict[str, Figure]]:
    """What the tables of a folder allow: documents and the page, file name → text, and figures by name.

    have_saved : called with each figure as soon as there is one.
    """
    recorded = runs(results)
    said: list[Said] = []
    drawn: dict[str, Figure] = {}
    for one in heard(frames, recorded):
        said.append(one)
        for figure in figures(one.parts):
            if figure.name not in drawn:
                drawn[figure.name] = figure
                have_saved(figure)
    texts = documents(said, registries)
    if texts:
        texts["report.html"] = page.page(said, recorded, glossary.sections(registries), page.LINKS)
    return texts, drawn


def remove_others(names: Container[str], folder: Path) -> None:
    """Remove figures drawn here, known by their digest, that have none of these names."""
    for vector in folder.glob("*.svg"):
        if vector.stem not in names and draw.digest_of(vector):
            vector.unlink()
            vector.with_suffix(".png").unlink(missing_ok=True)


def report(results: Path, registries: glossary.Registries, readme: Path | None = None) -> list[Path]:
    """Write every document and figure the tables allow, and the page; returns the paths.

    Figures of an earlier report that no table gives any more are removed.
    readme : a file whose computed part is filled in too.
    """
    frames = tables(results)
    with draw.in_background(results / "figures") as have_saved:
        texts, drawn = made(results, frames, registries, have_saved)
        written = []
        for name, text in texts.items():
            with replacing(results / name) as file:
                file.write(text)
            written.append(results / name)
        remove_others(drawn, results / "figures")
    written += [path for figure in drawn.values() for path in draw.files(figure, results / "figures")]
    if readme is not None:
        into_readme(readme, results, frames)
        written.append(readme)
    return written
