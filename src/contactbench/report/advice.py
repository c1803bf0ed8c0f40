"""Advice to read: one screen of text."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from contactbench.report.numbers import count, power, scientific, times


def text(frame: pd.DataFrame) -> str:
    return "\n".join(lines(frame))


def lines(frame: pd.DataFrame) -> Iterator[str]:
    said = frame.attrs
    known = said["features"]
    yield (
        f"{said['scene']}: angular frequency about {known['omega']:.3g}, damping {known['damping']:.2g} of it, "
        f"{known['span']:.3g} periods, time scales {known['spread']:.2g} apart, a force worth "
        f"{known['cost']:.0f} additions"
    )
    if said["far"]:
        yield "It is far from every problem of the population: this is a guess; `contactbench compare` measures."
    if said["stiff"]:
        yield (
            "Damping is stronger than of any problem of the population: where more than a few digits are wanted, try "
            "cyrk-radau, cyrk-lsoda and cvode-bdf (which.md, question 3)."
        )
    yield f"Most like it: {', '.join(said['nearest'])}"
    yield f"For an error of {power(said['error'])}, by {said['cost']}:"
    yield f"  {'method':20} {'begin with':>16} {'evaluations':>12} {'cost':>6}  {'best':>6}  regret: median, 90 %"
    for row in frame.itertuples():
        begin = "" if row.setting == "exact" else f"{row.setting} {scientific(row.value)}"
        yield (
            f"  {row.method:20} {begin:>16} {count(row.evaluations):>12} {times(row.expected):>6}  "
            f"{row.best:>6.0%}  {times(row.regret)}, {times(row.regret_90)}"
        )
    if any(frame["tried"]):
        names = ", ".join(frame.loc[frame["tried"], "method"])
        yield f"Tried on this very motion, in Python: {names}."
    yield "Best and regret, the cost over the least, are those on the twelve problems most like it."
