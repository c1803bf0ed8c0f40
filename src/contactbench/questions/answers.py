"""Answers: each counts by a line of pandas over the tables, which its document prints."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import lru_cache
from itertools import groupby

import numpy as np
import pandas as pd

from contactbench.questions import contest, regret
from contactbench.report.chapters import Answer, Fold, Frames
from contactbench.report.numbers import how_often
from contactbench.tables.schema import TABLES

#: what the lines may call beside pandas
FUNCTIONS = {
    name: getattr(contest, name)
    for name in ("contests", "credited", "drawn", "families", "hard_runs", "random_contests", "ring_costs")
} | {"ranked": contest.ranked, "mean_regrets": regret.mean_regrets}
#: other counts that stand beside an answer, in words
BESIDE = {
    "alone": ", leading alone on {}",
    "credited": "; {} after fixed costs, and the cost of calling the right-hand side by its address, are deducted",
    "idle": "; {} undecided or not judged",
}
WORD = re.compile(r"\b[a-z_]+\b")


@lru_cache(256)
def evaluate(query: str, frames: Frames) -> pd.Series:
    """Return what a line of pandas finds; it knows the tables by their names, `FUNCTIONS`, pd and np."""
    found = eval(query, {"pd": pd, "np": np, **FUNCTIONS, **frames})
    assert isinstance(found, pd.Series), query
    return found


def count(frames: Frames, query: str) -> tuple[int, int]:
    """Return of how many entries of a query's series it is true, and how many there are."""
    found = evaluate(query, frames)
    return int(found.sum()), len(found)


def share(frames: Frames, question: str, what: str, query: str, **beside: str) -> Answer | None:
    """Return the answer by the share of true rows, None without rows; beside : queries by the keys of `BESIDE`."""
    part, whole = count(frames, query)
    if not whole:
        return None
    more = "".join(BESIDE[name].format(count(frames, own)[0]) for name, own in beside.items())
    return Answer(
        question, how_often(part, whole), f"{part} of {whole} {what}{more}", (query, *beside.values())
    )


def fold(answers: Iterable[Answer], title: str = "How each count is computed") -> Fold | None:
    """Return the lines that counted, with their imports."""
    found = [(answer, query) for answer in answers for query in answer.queries]
    if not found:
        return None
    words = {word for _, query in found for word in WORD.findall(query)}
    tables, functions = ([name for name in names if name in words] for names in (TABLES, FUNCTIONS))
    lines = ["import numpy as np"] * ("np" in words) + ["import contactbench as cb"]
    for module, some in groupby(functions, key=lambda name: FUNCTIONS[name].__module__):
        lines.append(f"from {module} import {', '.join(some)}")
    lines += [f'{name} = cb.results("{name}")' for name in tables]
    last = ""
    for answer, query in found:
        if answer.question != last:
            lines.append(f"\n# {answer.question} {answer.count}".replace("`", "").rstrip())
            last = answer.question
        lines.append(query)
    return Fold(title, "\n".join(lines))


def made_by(queries: Mapping[str, str]) -> Fold | None:
    """Return the lines that a table is made by, each under its words."""
    made = [Answer(words, "", "", (query,)) for words, query in queries.items()]
    return fold(made, "How the table is computed")
