"""How runs end whose motion reaches infinity, and when."""

from __future__ import annotations

import numpy as np
import pandas as pd

from contactbench.report.cells import Head, Mark, View, number, word

#: how a run that escapes is stopped
OUT_OF_SCALE, NO_FURTHER = "stopped out of scale", "went as far as it could"


def criterion(rows: pd.DataFrame) -> pd.Series:
    """How a run that escapes is stopped: our loops look at the state after every step, others' solvers go on."""
    ours = (rows["control"] == "step") | (rows["family"] == "contact")
    return ours.map({True: OUT_OF_SCALE, False: NO_FURTHER})


def escapes(frame: pd.DataFrame) -> pd.DataFrame:
    """Runs that diverged as the true motion does; `off`: their end, relative to the true time, in per cent."""
    out = frame[(frame["status"] == "diverged") & frame["blow_up_time"].notna() & frame["end_time"].notna()]
    off = 100 * (out["end_time"].astype(float) / out["blow_up_time"].astype(float) - 1)
    return out.assign(off=off, criterion=criterion(out))


def blow_up_view(frame: pd.DataFrame) -> View | None:
    """When a run is said to have diverged against the true time of blow-up: one line per method."""
    part = frame[frame["blow_up_time"].notna() & (frame["status"] != "unsupported")]
    if not len(part):
        return None
    out, rows = escapes(part), []
    finest: list[float] = []
    for method, mine in part.groupby("method", sort=False):
        told = Mark.right if set(mine["status"]) == {"diverged"} else Mark.bad
        cells = [word(method), word(", ".join(dict.fromkeys(mine["status"])), told)]
        for how in (OUT_OF_SCALE, NO_FURTHER):
            off = out[(out["method"] == method) & (out["criterion"] == how)]["off"]
            said = (off.iloc[-1], off.min(), off.max()) if len(off) else (None, None, None)
            cells += [number(value, "{:+.3f} %".format) for value in said]
            finest += [float(off.iloc[-1])] if how == OUT_OF_SCALE and len(off) else []
        rows.append(tuple(cells))
    heads = [Head("method", words=True), Head("status", "over all settings", words=True)]
    for group in (OUT_OF_SCALE, NO_FURTHER):
        heads += [
            Head("finest", "at the finest setting that diverged", group=group),
            Head("earliest", "over all settings", group=group), Head("latest", "over all settings", group=group),
        ]  # fmt: skip
    scene, time = part["scene"].iloc[0], part["blow_up_time"].iloc[0]
    meaning = (
        f"The motion of `{scene}` reaches infinity at t = {time:.10g}; all times are relative to that. Two criteria, "
        "not to be compared. The loops of this suite (fixed steps, and contact methods that choose theirs) stop after "
        "the step that takes the state beyond 10⁶ times the scale of the scene. The true motion passes there before it "
        "reaches infinity"
    )
    if finest:
        meaning += f": by {-float(np.median(finest)):.3f} %, as the finest runs have it (median)"
    meaning += (
        ". The solvers of others go on until they can go no further; an accurate one stops at the blow-up."
    )
    return View("blow_up", "Blow-up", meaning, tuple(heads), tuple(rows), "stability.csv")
