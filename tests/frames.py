"""Small tables made by hand, typed as those that are read."""

from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any

import pandas as pd

from contactbench.report.chapters import Tables
from contactbench.runs.search import Attempt, Question, Search
from contactbench.runs.settings import ENDS, carry_of, times
from contactbench.scenes import SCENES
from contactbench.solution import Counts, Status
from contactbench.tables.schema import TABLES
from contactbench.tables.store import set_types
from contactbench.truth import reference

FAMILIES = {"contact": "contact", "herglotz": "variational"}


def row(scene: str, method: str, setting: float, **more: Any) -> dict[str, Any]:
    """A row of runs.csv that ended ok: a method with a step, or with a tolerance if it is `control="rtol"`."""
    family = next((f for start, f in FAMILIES.items() if method.startswith(start)), "established")
    made = {
        "scene": scene,
        "method": method,
        "family": family,
        "engine": "llvm",
        "status": "ok",
        "message": "",
    }
    return made | {"control": "step", "setting": setting, "saved": 25, "truth": "ok"} | more


def timed(runs: Iterable[Mapping[str, Any]], seconds: Iterable[float], **more: Any) -> list[dict[str, Any]]:
    """The rows of times.csv of some runs; both halves of the visits agree."""
    key = TABLES["times"].key
    return [
        {name: run[name] for name in key} | {"least_s": each, "halves": 1.0} | more
        for run, each in zip(runs, seconds, strict=True)
    ]


@cache
def empty(name: str) -> pd.DataFrame:
    return set_types(pd.DataFrame(columns=[*TABLES[name].columns]), TABLES[name])


def table(name: str, rows: Iterable[Mapping[str, Any]] = ()) -> pd.DataFrame:
    """Rows as a frame of a table; what they do not say is blank."""
    if not rows:
        return empty(name).copy()
    columns = [*TABLES[name].columns]
    frame = pd.DataFrame(list(rows))
    assert not (unknown := set(frame) - set(columns)), unknown
    return set_types(frame.reindex(columns=columns), TABLES[name])


def frames(**tables: Iterable[Mapping[str, Any]]) -> Tables:
    """All tables, empty but for those given."""
    return Tables({name: table(name, tables.get(name, ())) for name in TABLES})


# -- races -----------------------------------------------------------------------------------------
def race_of(*names: str, errors: tuple[float, ...] = (1e-2,), scene: str = "particle") -> list[Search]:
    """The searches of a race before it begins; their question has all the time there is."""
    own = SCENES[scene]
    truth = reference(own, times(own, ENDS), carry_of(own))
    question = Question(own, truth, errors, longest=1.0)
    return [Search(question, name) for name in names]


def tried(
    search: Search, seconds: float, error: float, value: float = 0.1, run: Any = None, **counts: Any
) -> Attempt:
    """A setting of a method in a race, as if it had been tried."""
    own = Attempt(value, f"step={value:g}", Status.ok, "", seconds, error, Counts(**counts), run)
    search.attempts.append(own)
    return own
