"""The cost of a derivative at equal error, by how it is computed, and the round-off of a run taken back."""

from __future__ import annotations

import pandas as pd

from contactbench.measure.statistics import COUNTED, ties
from contactbench.report.chapters import CHAPTERS, Chapter, Frames, Part, summary
from contactbench.report.numbers import duration, names, power, scientific, times
from contactbench.report.views import Mark, Show, View, as_cell, frame_of, pick

#: modes that are none in reverse: what is timed without a derivative, and six tangents
ALONE, FORWARD = "loss alone", "forward"
CASE = ["scene", "t_end", "error_asked"]


def reaching(frame: pd.DataFrame) -> pd.DataFrame:
    """Return the timed rows that have the error asked for; ratio : to the time of the method's loss alone."""
    rows = frame[(frame["gradient_error"] <= frame["error_asked"]) & frame["time_min_s"].notna()]
    rows = rows.sort_values([*CASE, "time_min_s"], ascending=[True, True, False, True], kind="stable")
    alone = rows[rows["mode"] == ALONE].set_index([*CASE, "method"])["time_min_s"].rename("ratio")
    return rows.assign(ratio=rows["time_min_s"] / rows.join(alone, on=[*CASE, "method"])["ratio"])


def answers(frames: Frames) -> pd.DataFrame:
    rows, lines = reaching(frames["gradients"]), []
    for (scene, end, asked), own in rows[rows["mode"] != ALONE].groupby(CASE, sort=False):
        for how, part in own.groupby(own["mode"].ne(FORWARD).map({False: "forward", True: "in reverse"})):
            least = float(part["time_min_s"].iloc[0])
            who = part["method"] + ("" if how == FORWARD else ", " + part["mode"])
            first = ties(part["time_min_s"], least, COUNTED)
            others = zip(who[~first], part["time_min_s"][~first], strict=True)
            beside = [f"{name} {times(seconds / least)}" for name, seconds in others]
            case = f"`{scene}`, T = {end:g}, {power(asked)}"
            question = f"Who has a derivative {how} in the least time, {case}?"
            lines.append((question, names(list(who[first])), "; ".join([duration(least), *beside])))
    return summary(*lines)


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
    legend = (
        "A derivative in six parameters at the coarsest setting tried that has the error; least round. Ratio: to "
        "the method's loss alone. Memory: XLA's temporary memory; that of checkpoints follows `max_steps`. Bold: the "
        f"least of a derivative, to a factor {COUNTED:g}."
    )
    show: dict[str, Show] = {"error": scientific, "ratio": times, "memory, kB": "{:.3g}".format}
    return View(
        "gradient_costs", "Cost of a derivative", frame_of(lines, labels), legend, "gradients.csv", show
    )


def growth_view(frame: pd.DataFrame) -> View:
    errors = {"growth": "e^{γT}", "start_error": "error of the start"}
    errors |= {"gradient_error": "error of the derivative"}
    table = pick(frame, "method", gamma="γ", force="force", t_end="T", **errors)
    legend = "A forced oscillator, ω = 1, whose steps are taken back. Flows have exact inverses: this is round-off."
    show = dict.fromkeys(errors.values(), scientific)
    return View("reversibility", "Runs taken back", table, legend, "reversibility.csv", show)


def parts(frames: Frames) -> list[Part | None]:
    return [costs_view(frames["gradients"]), growth_view(frames["reversibility"])]


TITLE, QUESTION = "Derivatives", "What does the derivative of a loss in the parameters cost?"
CHAPTERS.add(Chapter("gradients", TITLE, QUESTION, 64, ("gradients", "reversibility"), parts, answers))
