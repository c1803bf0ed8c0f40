"""The cost of a derivative at equal error, by how it is computed, and the round-off of a run taken back."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

from contactbench.measure.statistics import COUNTED, ties
from contactbench.report.chapters import Answer, Frames, Part, chapter, view
from contactbench.report.numbers import duration, names, power, scientific, times
from contactbench.report.views import Mark, Show, View, as_cell, frame_of, pick

#: the modes that are not in reverse: the loss without a derivative, and six tangents forward
ALONE, FORWARD = "loss alone", "forward"
CASE = ["scene", "t_end", "error_asked"]


def reaching(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the timed rows that have the error asked for; ratio : to the time of the method's loss alone."""
    rows = frame[(frame["gradient_error"] <= frame["error_asked"]) & frame["time_min_s"].notna()]
    rows = rows.sort_values([*CASE, "time_min_s"], ascending=[True, True, False, True], kind="stable")
    alone = rows[rows["mode"] == ALONE].set_index([*CASE, "method"])["time_min_s"].rename("ratio")
    return rows.assign(ratio=rows["time_min_s"] / rows.join(alone, on=[*CASE, "method"])["ratio"])


def answers(frames: Frames) -> Iterator[Answer]:
    rows = reaching(frames["gradients"])
    for (scene, end, asked), own in rows[rows["mode"] != ALONE].groupby(CASE, sort=False):
        for how, part in own.groupby(own["mode"].ne(FORWARD).map({False: "forward", True: "in reverse"})):
            least = float(part["time_min_s"].iloc[0])
            who = part["method"] + ("" if how == FORWARD else ", " + part["mode"])
            first = ties(part["time_min_s"], least, COUNTED)
            others = zip(who[~first], part["time_min_s"][~first], strict=True)
            beside = [f"{name} {times(seconds / least)}" for name, seconds in others]
            case = f"`{scene}`, T = {end:g}, {power(asked)}"
            question = f"Who has a derivative {how} in the least time, {case}?"
            yield Answer(question, names(list(who[first])), "; ".join([duration(least), *beside]))


def costs_view(frame: pd.DataFrame) -> View:
    rows, lines = reaching(frame), []
    least = rows[rows["mode"] != ALONE].groupby(CASE)["time_min_s"].min()
    for row in rows.to_dict("records"):
        scene, end, asked = case = tuple(row[name] for name in CASE)
        best = row["mode"] != ALONE and row["time_min_s"] <= COUNTED * least[case]
        time = as_cell(row["time_min_s"], duration, Mark.best if best else None)
        which = f"{scene}, T = {end:g}, {power(asked)}", row["method"], row["mode"], row["setting"]
        lines.append([*which, row["gradient_error"], time, row["ratio"], row["memory_kB"]])
    labels = ["case", "method", "mode", "setting", "error", "time", "ratio", "memory, kB"]
    show: dict[str, Show] = {"error": scientific, "ratio": times, "memory, kB": "{:.3g}".format}
    return view("gradient_costs", frame_of(lines, labels), show, counted=COUNTED)


@chapter("gradients", answers)
def parts(frames: Frames) -> list[Part | None]:
    errors = {"growth": "e^{γT}", "start_error": "error of the start"}
    errors |= {"gradient_error": "error of the derivative"}
    back = pick(frames["reversibility"], "method", gamma="γ", force="force", t_end="T", **errors)
    show = dict.fromkeys(errors.values(), scientific)
    return [costs_view(frames["gradients"]), view("reversibility", back, show)]
