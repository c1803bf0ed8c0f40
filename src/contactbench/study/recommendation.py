"""What to take: the end of a race as one sentence for each error."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from contactbench.measure.statistics import WIDEST, Verdict
from contactbench.methods.base import METHODS
from contactbench.questions.contest import CONTACT, CUT
from contactbench.report.numbers import count, duration, exact_power, names, times
from contactbench.study.race import kept_and_unknown

#: solvers of other libraries that are named beside the fastest
PEERS = 2


def recommendation(frame: pd.DataFrame) -> Iterator[str]:
    """Yield what to take for each error of a race, or what is missing to say so."""
    for error, rows in frame.groupby("error_asked", sort=False):
        timed, goal = rows[rows["time_s"].notna()], exact_power(float(str(error)))
        compiled = timed[timed["kind"] == "compiled"]
        ranked = (timed if compiled.empty else compiled).sort_values("time_s", kind="stable")
        reached = rows[rows["status"] == "ok"].sort_values("evaluations", kind="stable")
        if len(ranked):
            yield f"{best(ranked, goal, frame)}."
        elif len(reached):
            first = reached.iloc[0]
            counted = first["evaluations"] > 0
            cost = f"{count(first['evaluations'])} evaluations" if counted else "evaluations not counted"
            yield f"Take {named(first)}: {cost} for {goal}, the fewest; no time was left to time it (--budget)."
        else:
            yield f"Nothing to take for {goal}: {lack(rows)}."


def named(row: pd.Series) -> str:
    """Return a method and its setting in words."""
    return f"{row['method']}, {str(row['setting']).replace('=', ' ', 1)}"


def best(ranked: pd.DataFrame, goal: str, frame: pd.DataFrame) -> str:
    """Return the fastest and all that are about as fast, and beside them a contact method and other libraries."""

    def keeps(row: pd.Series) -> str:
        kept, unknown = kept_and_unknown(frame[frame["method"] == row["method"]])
        unclear = f" ({names(unknown)} not measured)" if unknown and row["family"] == CONTACT else ""
        return f" (keeps {names(kept)})" if kept else unclear

    def beside(rows: pd.DataFrame) -> list[str]:
        return [f"{row['method']} {times(row['ratio'])}{keeps(row)}" for _, row in rows.iterrows()]

    first, near = ranked.iloc[0], (ranked["verdict"] != Verdict.loss) & (ranked["ratio"] <= WIDEST)
    alike, slower = ranked[near].iloc[1:], ranked[~near]
    python = "" if first["kind"] == "compiled" else ", calling back into Python"
    parts = [f"Take {named(first)}: {duration(first['time_s'])} for {goal}{keeps(first)}{python}"]
    if len(alike):
        parts.append(f"within {WIDEST - 1:.0%} of it {names(beside(alike))}")
    packages = slower["method"].map(lambda name: METHODS[name].package)
    foreign = slower[(packages != "") & ~packages.duplicated()].iloc[:PEERS]
    contact = slower[(slower["family"] == CONTACT) & (CONTACT not in {*ranked[near]["family"]})].iloc[:1]
    parts += beside(pd.concat([contact, foreign]))
    if first["verdict"] == Verdict.undecided:
        parts.append(f"who is fastest is undecided: {first['reason']}")
    return "; ".join(parts)


def lack(rows: pd.DataFrame) -> str:
    """Return why no method reaches an error."""
    unresolved, cut = rows[rows["status"] == "unresolved"], rows[rows["status"].isin(CUT)]
    reached = rows[rows["error_reached"].notna()].sort_values("error_reached", kind="stable")
    if len(unresolved):
        why = str(unresolved["reason"].iloc[0])
    elif reached.empty:
        why = "no time was left (--budget)" if len(cut) else "no method ran to the end"
    else:
        last, number = reached.iloc[0], len(cut)
        more = f"; {number} method{'s' * (number > 1)} cut off for want of time (--budget)" if number else ""
        why = f"the most accurate is {named(last)}, with {last['error_reached']:.1e}{more}"
    return why
