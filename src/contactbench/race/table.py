"""The rows of a comparison, and who is cheapest."""

from __future__ import annotations

import math
from typing import Any

import pandas as pd

from contactbench.measure.statistics import PROCESSES, Verdict, margin, verdict
from contactbench.methods.base import METHODS
from contactbench.race.keeping import kept, laws_shown
from contactbench.race.scout import Attempt, Question, Scouted
from contactbench.report.numbers import times as written

#: types of the columns beside the laws
COLUMNS = {
    "scene": "str", "method": "str", "family": "str", "engine": "str", "kind": "str", "error_asked": "float64",
    "setting": "str", "error_reached": "float64", "time_s": "float64", "evaluations": "float64", "ratio": "float64",
    "margin": "float64", "verdict": "str", "laws_kept": "str", "status": "str", "reason": "str",
}  # fmt: skip


def table(
    question: Question,
    scouted: list[Scouted],
    chosen: dict[tuple[str, float], Attempt],
    times: dict[int, dict[str, Any]],
    laws: dict[int, dict[str, float]],
    untimed: dict[int, str],
) -> pd.DataFrame:
    """One row for each method and error asked; every run in ``attrs``."""
    rows = []
    for each in scouted:
        for error in question.errors:
            attempt = cheapest(each.method, error, question.errors, chosen, times)
            timed, kept_at = (times.get(id(attempt), {}), laws.get(id(attempt), {})) if attempt else ({}, {})
            rows.append({
                "scene": question.scene.name, "method": each.method, "family": METHODS[each.method].family,
                "engine": each.engine, "kind": each.kind, "error_asked": error,
                **(reached(question, attempt) if attempt else unreached(question, each, error)),
                **({"reason": untimed[id(attempt)]} if id(attempt) in untimed else {}),
                "time_s": timed.get("time_min_s", math.nan),
                "time_halves_ratio": timed.get("time_halves_ratio", math.nan), **kept_at,
            })  # fmt: skip
    frame = pd.DataFrame(rows)
    names = [law.name for law in laws_shown(question.scene)]
    frame = frame.reindex(columns=[*frame.columns, *(name for name in names if name not in frame)])
    frame = judged(frame)
    frame["laws_kept"] = kept(frame, question.scene)
    frame = frame.reindex(columns=[*COLUMNS, *names, "map_growth", "time_halves_ratio"]).astype(COLUMNS)
    frame.attrs = {"runs": runs(scouted)}
    return frame


def cheapest(
    method: str,
    error: float,
    errors: tuple[float, ...],
    chosen: dict[tuple[str, float], Attempt],
    times: dict[int, dict[str, Any]],
) -> Attempt | None:
    """Of the settings timed that reach an error, that error's own or a smaller one's, the one that is soonest done."""
    reach = [a for e in sorted(errors, reverse=True) if e <= error and (a := chosen.get((method, e)))]
    return min(reach, key=lambda a: times.get(id(a), {}).get("time_median_s", math.inf), default=None)


def reached(question: Question, attempt: Attempt) -> dict[str, Any]:
    return {
        "setting": attempt.setting, "error_reached": max(attempt.error, question.floor()),
        "evaluations": attempt.counts.rhs_equivalents, "status": "ok", "reason": "",
    }  # fmt: skip


def unreached(question: Question, each: Scouted, error: float) -> dict[str, Any]:
    """How far it got, and why no further."""
    ended = [a for a in each.attempts if a.ok]
    best = min(ended, key=lambda a: a.error) if ended else None
    row = {
        "setting": best.setting if best else "",
        "error_reached": max(best.error, question.floor()) if best else math.nan, "evaluations": math.nan,
    }  # fmt: skip
    if error < question.floor():
        return row | {
            "status": "unresolved",
            "reason": f"the reference is known to {question.floor():.1e} only",
        }
    if each.why is not None:
        return row | dict(zip(("status", "reason"), each.why, strict=True))
    last = each.finest()
    if last is not None and not last.ok:
        return row | {"status": str(last.status), "reason": f"{last.setting}: {last.message}"}
    assert last is not None
    return row | {"status": "unreached", "reason": f"no setting is as accurate, tried down to {last.setting}"}


def judged(frame: pd.DataFrame) -> pd.DataFrame:
    """Add what every time is beside the least of its kind at its error.

    ratio, margin : to the least, and the ratio up to which the two cannot be told apart.
    verdict : cheapest; tie or undecided (with the cheapest); by how much slower; blank where nothing was timed.
    """
    frame = frame.assign(ratio=math.nan, margin=math.nan, verdict="")
    for _, part in frame[frame["time_s"].notna()].groupby(["kind", "error_asked"]):
        least = part.loc[part["time_s"].idxmin()]
        alike: set[Verdict] = set()
        for i, row in part.drop(least.name).iterrows():
            ratio = row["time_s"] / least["time_s"]
            most = margin((row["time_halves_ratio"], least["time_halves_ratio"]), PROCESSES)
            said = verdict(ratio, most)
            alike |= {said} - {Verdict.loss}
            text = written(ratio) if said is Verdict.loss else str(said)
            frame.loc[i, ["ratio", "margin", "verdict"]] = ratio, most, text
        text = str(min(alike, key=list(Verdict).index, default="cheapest"))
        frame.loc[least.name, ["ratio", "verdict"]] = 1.0, text
    return frame


class Runs(tuple):
    """Rows that are not copied: pandas makes a deep copy of all ``attrs`` in every operation on a frame."""

    def __deepcopy__(self, memo: object) -> Runs:
        return self


def runs(scouted: list[Scouted]) -> Runs:
    """Every setting tried."""
    return Runs(
        {
            "method": each.method, "engine": each.engine, "kind": each.kind, "setting": a.setting, "value": a.value,
            "status": str(a.status), "message": a.message, "error": a.error,
            "evaluations": math.nan if a.counts.rhs_equivalents is None else a.counts.rhs_equivalents,
        }
        for each in scouted for a in sorted(each.attempts, key=lambda a: -a.value)
    )  # fmt: skip
