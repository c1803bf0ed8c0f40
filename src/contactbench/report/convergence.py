"""Measured orders: extrapolated, with the last pairwise slope beside it."""

from __future__ import annotations

from collections.abc import Callable

import pandas as pd

from contactbench.report.cells import DASH, Cell, Head, Mark, View, marks, number, word
from contactbench.report.contest import CONTACT
from contactbench.report.figures import convergence as figures
from contactbench.report.numbers import names, upper
from contactbench.report.raw import raw
from contactbench.report.rooms import ROOMS, Finding, Frames, Part, Room
from contactbench.results.tables import CONVERGENCE

#: a measured order further than this from the claimed one is an exception
AGREES = 0.1


def fits(frame: pd.DataFrame) -> pd.DataFrame:
    """One row per method and scene: what is the same in all rows of a ladder, and how many points were used."""
    first = frame.drop_duplicates(["scene", "method"]).copy()
    used = frame[frame["in_fit"].eq(True)].groupby(["scene", "method"]).size()
    first["points"] = [int(used.get((s, m), 0)) for s, m in zip(first["scene"], first["method"], strict=True)]
    return first


def order_text(row: pd.Series) -> Cell:
    """The extrapolated order and the spread of the extrapolation, or why there is none."""
    if row["status"] == "unsupported":
        return Cell("unsupported", marks=marks(Mark.none))
    if pd.isna(row["order"]):
        return Cell("no asymptotic range")
    order, spread = float(row["order"]), row["order_uncertainty"]
    text = f"{order:.2f}" if pd.isna(spread) else f"{order:.2f} ± {spread:.2f}"
    off = abs(order - float(row["order_nominal"])) > allowed(row)
    return Cell(text, order, marks(Mark.exception if off else None))


def allowed(row: pd.Series) -> float:
    spread = row["order_uncertainty"]
    return AGREES if pd.isna(spread) else max(AGREES, float(spread))


def view(frame: pd.DataFrame, name: str, title: str, meaning: str, cell: Callable[[pd.Series], Cell]) -> View:
    fit = fits(frame)
    scenes = list(dict.fromkeys(fit["scene"]))
    rows = []
    for method, mine in fit.groupby("method", sort=False):
        by_scene = {row["scene"]: row for _, row in mine.iterrows()}
        cells = (cell(by_scene[s]) if s in by_scene else Cell(DASH) for s in scenes)
        rows.append((word(method), number(mine["order_nominal"].max(), "{:.0f}".format), *cells))
    heads = (
        Head("method", words=True),
        Head("claimed", CONVERGENCE.columns["order_nominal"].meaning),
        *map(Head, scenes),
    )
    return View(name, title, meaning, heads, tuple(rows), "convergence.csv")


def findings(frames: Frames) -> list[Finding]:
    fit = fits(frames["convergence"])
    known = fit[fit["order"].notna()]  # whether or not its coarsest step diverged
    if not len(known):
        return []
    off = known[[abs(r["order"] - r["order_nominal"]) > allowed(r) for _, r in known.iterrows()]]
    sentence = (
        f"The measured order agrees with the claimed one in {len(known) - len(off)} of {len(known)} pairs of method "
        f"and scene (within {AGREES:g}, or within the spread of the extrapolation)."
    )
    ours = known[known["family"] == CONTACT]
    if len(ours):
        ranges = []
        for method, rows in ours.groupby("method", sort=False):
            low, high = rows["order"].min(), rows["order"].max()
            shown = f"{low:.2f}" if f"{low:.2f}" == f"{high:.2f}" else f"{low:.2f} to {high:.2f}"
            ranges.append(f"{method} {shown}")
        sentence += f" The contact methods, over all scenes: {', '.join(ranges)}."
    exceptions = [
        f"{r['method']} on `{r['scene']}`: {r['order']:.2f}, claimed {r['order_nominal']:.0f}"
        + ("" if pd.isna(r["last_slope"]) else f", last pairwise slope {r['last_slope']:.2f}")
        for _, r in off.iterrows()
    ]
    blank = fit[(fit["status"] != "unsupported") & fit["order"].isna()]
    covers = f"{known['method'].nunique()} fixed-step methods on {known['scene'].nunique()} scenes"
    if len(blank):
        pairs = [f"{r['method']} on `{r['scene']}`" for _, r in blank.iterrows()]
        covers += f"; no asymptotic range: {names(pairs, 6)}"
    return [Finding("order", "Order", sentence, covers, tuple(exceptions))]


def sections(frames: Frames) -> list[Part]:
    frame = frames["convergence"]
    meaning = {name: column.meaning for name, column in CONVERGENCE.columns.items()}
    orders = view(
        frame, "orders", "Extrapolated order",
        f"{upper(meaning['order'])}; ±: {meaning['order_uncertainty']}. Marked: further from the claimed order "
        f"than {AGREES:g} and than that spread.", order_text,
    )  # fmt: skip
    slopes = view(
        frame, "last_slopes", "Last pairwise slope", f"{upper(meaning['last_slope'])}: what was measured, "
        "before any extrapolation.", lambda row: number(row["last_slope"], "{:.3f}".format),
    )  # fmt: skip
    drawn = figures.figure(frame)
    return [orders, slopes, *([drawn] if drawn else []), raw(CONVERGENCE, frame)]


ROOMS.add(
    Room(
        "convergence",
        "Order of convergence",
        "measured orders",
        30,
        ("convergence",),
        sections,
        findings,
        tab="Order",
    )
)  # fmt: skip
