"""The prose of the chapters, from chapters.toml: titles, questions and legends."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Mapping
from importlib.resources import files
from typing import Any

import pandas as pd

from contactbench.report.chapters import CHAPTERS, Answer, Chapter, Frames, Part
from contactbench.report.views import Show, View

PROSE: dict[str, dict[str, Any]] = tomllib.loads(
    files(__package__).joinpath("chapters.toml").read_text(encoding="utf-8")
)
VIEWS = {
    name: {"source": f"{chapter['tables'][0]}.csv"} | entry
    for chapter in PROSE.values()
    for name, entry in chapter.pop("views", {}).items()
}

type Parts = Callable[[Frames], Iterable[Part | None]]


def chapter(
    name: str, answers: Callable[[Frames], Iterable[Answer]] = lambda frames: ()
) -> Callable[[Parts], Parts]:
    """Return a decorator that registers the parts of a chapter of chapters.toml."""
    own = PROSE[name] | {"tables": tuple(PROSE[name]["tables"])}

    def register(parts: Parts) -> Parts:
        CHAPTERS.add(Chapter(name, parts=parts, answers=answers, **own))
        return parts

    return register


def view(name: str, frame: pd.DataFrame, show: Mapping[str, Show] | None = None, **values: object) -> View:
    """Return a table to read with the title and legend of chapters.toml, `values` filled into the legend."""
    prose = VIEWS[name]
    legend = " ".join(prose.get("legend", "").format(**values).split())
    return View(name, prose["title"], frame, legend, prose["source"], show or {})
