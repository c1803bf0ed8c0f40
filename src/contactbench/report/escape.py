"""How runs end whose motion reaches infinity, and when."""

from __future__ import annotations

import pandas as pd

from contactbench.report.views import Cell, Mark, View, as_cell, frame_of

#: how a run that escapes is stopped
OUT_OF_SCALE, NO_FURTHER = "stopped out of scale", "went as far as it could"


def criterion(rows: pd.DataFrame) -> pd.Series:
    """Return how each run that escapes is stopped: our loops look at the state after every step, others go on."""
    ours = (rows["control"] == "step") | (rows["family"] == "contact")
    return ours.map({True: OUT_OF_SCALE, False: NO_FURTHER})


def escapes(frame: pd.DataFrame) -> pd.DataFrame:
    """Return runs that diverged as the true motion does; `off`: their end, relative to the true time, in per cent."""
    out = frame[(frame["status"] == "diverged") & frame["blow_up_time"].notna() & frame["end_time"].notna()]
    off = 100 * (out["end_time"].astype(float) / out["blow_up_time"].astype(float) - 1)
    return out.assign(off=off, criterion=criterion(out))


def blow_up_view(frame: pd.DataFrame) -> View | None:
    """Return when a run is said to have diverged against the true time of blow-up: one line per method."""
    part = frame[frame["blow_up_time"].notna() & (frame["status"] != "unsupported")]
    if not len(part):
        return None
    out, rows = escapes(part), []
    for method, own in part.groupby("method", sort=False):
        right = Mark.right if set(own["status"]) == {"diverged"} else Mark.bad
        cells = [Cell(", ".join(dict.fromkeys(own["status"])), mark=right)]
        for how in (OUT_OF_SCALE, NO_FURTHER):
            off = out[(out["method"] == method) & (out["criterion"] == how)]["off"]
            ends = (off.iloc[-1], off.min(), off.max()) if len(off) else (None, None, None)
            cells += [as_cell(end, "{:+.3f} %".format) for end in ends]
        rows.append((method, *cells))
    labels = [("", "method"), ("", "status")]
    labels += [(how, name) for how in (OUT_OF_SCALE, NO_FURTHER) for name in ("finest", "earliest", "latest")]
    scene, time = part["scene"].iloc[0], part["blow_up_time"].iloc[0]
    legend = (
        f"The motion of `{scene}` reaches infinity at t = {time:.10g}; ends are relative to that. Two criteria, not to "
        "be compared: our loops stop once the state is 10⁶ times the scale of the scene, which the true motion passes "
        "before it reaches infinity; the solvers of others go on."
    )
    return View("blow_up", "Blow-up", frame_of(rows, labels), legend, "stability.csv")
