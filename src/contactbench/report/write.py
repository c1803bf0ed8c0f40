"""Documents and figures from the tables of a folder alone: nothing is solved here."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from contactbench.errors import BadInput
from contactbench.report import draw, glossary, headline, markdown, page
from contactbench.report.model import Frames, figures, rooms
from contactbench.report.page import Said
from contactbench.results.schema import TABLES
from contactbench.results.store import read, replacing

README_PART = ("<!-- computed from results/: begin -->\n", "<!-- computed from results/: end -->")


def tables(results: Path) -> Frames:
    """Every table of a folder; those without a file have no rows."""
    return {name: read(table, results) for name, table in TABLES.items()}


def environment(results: Path) -> dict[str, Any]:
    path = results / "environment.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def heard(frames: Frames, runs: dict[str, Any]) -> list[Said]:
    """Every room that has something to say, with its parts and findings."""
    said = []
    for room in rooms(frames):
        parts = tuple(room.sections(frames))
        if room.name == "headline":
            parts = (*parts, headline.machines(runs))
        said.append(Said(room, parts, tuple(room.findings(frames))))
    return said


def documents(said: Iterable[Said], registries: glossary.Registries) -> dict[str, str]:
    """File name → text."""
    texts = {one.room.file: markdown.document(one.room, one.parts, one.findings) for one in said}
    if texts:
        texts["glossary.md"] = f"# Glossary\n\n{markdown.parts(glossary.sections(registries))}\n"
    return texts


def excerpt(frames: Frames, folder: str) -> str:
    """The computed part of a README that stands beside the results' folder."""
    return markdown.parts(headline.excerpt(frames), 3).replace("](#", f"]({folder}/README.md#")


def with_excerpt(readme: Path, results: Path) -> str:
    """A README's text with its computed part as the tables have it.  Raises `BadInput` without its marks."""
    text = readme.read_text(encoding="utf-8")
    begin, end = README_PART
    if text.count(begin) != 1 or text.count(end) != 1:
        raise BadInput(f"{readme}: needs the lines {begin.strip()!r} and {end!r}, once each")
    before, after = text.partition(begin)[0], text.partition(end)[2]
    return f"{before}{begin}\n{excerpt(tables(results), results.name)}\n\n{end}{after}"


def into_readme(readme: Path, results: Path) -> None:
    text = with_excerpt(readme, results)
    with replacing(readme) as file:
        file.write(text)


def differing(results: Path, readme: Path | None, registries: glossary.Registries) -> list[Path]:
    """The documents in `results`, and the README, that do not say what the tables say."""
    texts = documents(heard(tables(results), environment(results)), registries)
    wanted = {results / name: text for name, text in texts.items()}
    if readme is not None:
        wanted[readme] = with_excerpt(readme, results)
    return [path for path, text in wanted.items() if not path.exists() or path.read_text(encoding="utf-8") != text]


def report(results: Path, registries: glossary.Registries) -> list[Path]:
    """Write every document and figure the tables allow, and the page; returns the paths."""
    runs = environment(results)
    said = heard(tables(results), runs)
    texts = documents(said, registries) | {"report.html": page.page(said, list(runs.values()))}
    written = []
    for name, text in texts.items():
        with replacing(results / name) as file:
            file.write(text)
        written.append(results / name)
    drawn = {figure.name: figure for one in said for figure in figures(one.parts)}
    for figure in drawn.values():
        written += draw.save(figure, results / "figures")
    return written
