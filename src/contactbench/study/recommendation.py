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
#: names in one enumeration
SOME = 3


def recommendation(frame: pd.DataFrame) -> Iterator[str]:
    """Yield what to take for each error of a race, or what is missing to say so."""
    for error, rows in frame.groupby("error_asked", sort=False):
        timed = rows[rows["time_s"].notna()]
        compiled = timed[timed["kind"] == "compiled"]
        ranked = (timed if compiled.empty else compiled).sort_values("time_s", kind="stable")
        goal = exact_power(float(str(error)))
        if len(ranked):
            yield f"{best(ranked, goal, rows, frame)}."
        else:
            yield f"{untimed(rows, goal) or f'Nothing to take for {goal}: {lack(rows)}'}."


def named(row: pd.Series) -> str:
    """Return a method and its setting in words."""
    return f"{row['method']}, {str(row['setting']).replace('=', ' ', 1)}"


def best(ranked: pd.DataFrame, goal: str, rows: pd.DataFrame, frame: pd.DataFrame) -> str:
    """Return the fastest with what it keeps, and the best contact method and the best of other libraries beside it."""

    def keeps(row: pd.Series) -> str:
        kept, unknown = kept_and_unknown(frame[frame["method"] == row["method"]])
        if unknown and not kept and row["family"] == CONTACT:
            return f", {names(unknown)} not measured"
        return f", keeps {names(kept)}" if kept else ""

    first, others = ranked.iloc[0], ranked.iloc[1:]
    python = "" if first["kind"] == "compiled" else ", calling back into Python"
    parts = [f"Take {named(first)}: {duration(first['time_s'])} for {goal}{python}"]
    parts[0] += keeps(first)
    within = (others["ratio"] <= others["margin"]) & (others["margin"] <= WIDEST)
    alike = others[(others["verdict"] == Verdict.tie) | ((others["verdict"] == Verdict.undecided) & within)]
    if len(alike):
        parts.append(f"{names(list(alike['method']), SOME)} equal within ×{alike['margin'].max():.2f}")
    packages = others["method"].map(lambda name: METHODS[name].package)
    foreign = others[(packages != "") & ~packages.duplicated()]
    own = others[(others["family"] == CONTACT) & (first["family"] != CONTACT)].iloc[:1]
    beside = pd.concat([own, foreign.iloc[:PEERS]]).drop(index=alike.index, errors="ignore")
    parts += [f"{row['method']} {times(row['ratio'])}{keeps(row)}" for _, row in beside.iterrows()]
    return "; ".join([*parts, *doubts(first, others, rows, frame)])


def doubts(first: pd.Series, others: pd.DataFrame, rows: pd.DataFrame, frame: pd.DataFrame) -> Iterator[str]:
    """Yield why another method may be the fastest all the same."""
    if first["verdict"] != Verdict.undecided:
        return
    near = others[others["verdict"] == Verdict.undecided]
    wide = near[near["margin"] > WIDEST]
    if len(wide):
        margin = wide["margin"].max()
        spread = f"times vary by {times(margin)} on this machine, no more than ×{WIDEST:g} decides"
        yield f"whether faster with {names(list(wide['method']), SOME)} is undecided: {spread}"
    untried = rows[(rows["at_least"] <= first["time_s"]) & (rows["kind"] == first["kind"])]
    if len(untried):
        yield f"whether faster with {names(list(untried['method']), SOME)} is undecided: no time was left (--budget)"


def untimed(rows: pd.DataFrame, goal: str) -> str:
    """Return what reaches an error where no time was left for the clock: of the fewest evaluations, where counted."""
    reach = rows[rows["status"] == "ok"].sort_values("evaluations", kind="stable")
    if reach.empty:
        return ""
    first = reach.iloc[0]
    counted = first["evaluations"] > 0
    cost = f"{count(int(first['evaluations']))} evaluations" if counted else "evaluations not counted"
    return f"Take {named(first)}: {cost} for {goal}, the fewest; no time was left to time it (--budget)"


def lack(rows: pd.DataFrame) -> str:
    if (rows["status"] == "unresolved").any():
        return str(rows.loc[rows["status"] == "unresolved", "reason"].iloc[0])
    reached = rows[rows["error_reached"].notna()].sort_values("error_reached", kind="stable")
    if reached.empty:
        cut = rows["status"].isin(CUT).any()
        return "no time was left (--budget)" if cut else "no method ran to the end"
    cut = rows.loc[rows["status"].isin(CUT), "method"].nunique()
    more = f"; {cut} method{'s' * (cut > 1)} cut off for want of time (--budget)" if cut else ""
    last = reached.iloc[0]
    return f"the most accurate is {named(last)}, with {last['error_reached']:.1e}{more}"
