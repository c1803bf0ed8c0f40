"""Which methods preserve the laws, and how far the others are from it.

A structural law is kept when its deviation is round-off at every setting on every scene, hard ones
included.  Round-off is 10⁻¹², or what rounding every evaluation comes to; the round-off of a law of the
derivative grows with the numerical map, how far stands in the table (`map_growth`), and where it does not, with
the motion (`condition_number`).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from contactbench.measure.round_off import round_off_bound
from contactbench.report.contest import CONTACT, LIMIT, families
from contactbench.report.curves import by_method, number_axis, round_off
from contactbench.report.model import (
    DASH,
    ROOMS,
    Axis,
    Cell,
    Figure,
    Finding,
    Frames,
    Head,
    Mark,
    Panel,
    Part,
    Room,
    Section,
    Text,
    View,
    marks,
    number,
    word,
)
from contactbench.report.numbers import count, many, names, readable, scientific, upper
from contactbench.report.raw import raw
from contactbench.results.round_off import STRUCTURE
from contactbench.results.schema import Column, Rule, Table
from contactbench.results.tables import DECAY_LAWS, LAWS_TABLE, LAWS_TIME
from contactbench.solution import STEPS

#: a run with a larger error than this does not follow the motion, whose condition number then says little
WILD = 0.01
#: deviations up to so many times the bound of round-off are told together
NEAR = 10.0
#: laws of the state alone: the sensitivity of the motion does not magnify their round-off
OF_THE_STATE = ("momentum_law", "attitude_drift")
#: up to so many error bars a deviation by differences is no more than an upper bound
UNSURE = 2.0
#: the suffix of a law measured with the steps of an adaptive method held fixed
#: growth of the map worth telling
GREW = 2.0
FROZEN = "_frozen"
DAGGER = "†"
#: scenes of the table that stands first, and the scene whose order is quoted where only one is
FIRST = ("central", "rigid_body")
ENERGIES = ("energy_law", "hamiltonian_law")

MEANINGS = {
    "kept": "bold: kept to round-off at every setting tried, however inaccurate the solution",
    "range": f"smallest … largest over the settings tried; {DASH}: the law is not defined there, or not measured",
    "dagger": f"{DAGGER}: where a quantity has all but vanished, its deviation is relative to a "
    "thousandth of the terms that cancel",
}


# -- what is a law, and when is it kept ------------------------------------------------------------
def laws(table: Table, view: str = "laws") -> dict[str, Column]:
    """The laws a table shows in a view, with their columns."""
    return {name: column for name, column in table.columns.items() if view in column.shown}


def structural(table: Table = LAWS_TABLE) -> dict[str, Column]:
    """The laws of the map itself that a method either keeps or does not, whatever its error."""
    return {n: c for n, c in laws(table).items() if c.rule is Rule.structure and not n.endswith(FROZEN)}


def at_equal_cost() -> list[str]:
    """The laws of the table at equal cost, in its order."""
    return [
        n
        for n in DECAY_LAWS.columns
        if n in laws(LAWS_TABLE) and n != "solution_error" and not n.endswith(FROZEN)
    ]


def called(law: str) -> str:
    """The short name of a law in plain text."""
    label = LAWS_TABLE.columns[law].label
    return label if label and "$" not in label else law.replace("_", " ")


def numbers(rows: pd.DataFrame, column: str, default: float = np.nan) -> pd.Series:
    """A column as floats, `default` where it is blank or missing."""
    if column not in rows:
        return pd.Series(default, rows.index, dtype=float)
    return pd.to_numeric(rows[column], errors="coerce").astype(float).fillna(default)


def growth(rows: pd.DataFrame, law: str) -> pd.Series:
    """What the round-off of a law grows by: with the map where that was measured, else with the motion."""
    if law in OF_THE_STATE:
        return pd.Series(1.0, rows.index)
    motion = numbers(rows, "condition_number", 1.0)
    return np.maximum(1.0, numbers(rows, "map_growth").fillna(motion))


def bound(rows: pd.DataFrame, law: str) -> pd.Series:
    """Up to what a deviation from a law is round-off, row by row."""
    return np.maximum(STRUCTURE, round_off_bound(growth(rows, law), numbers(rows, "evaluations", 0.0)))


MEASURED = [
    "scene", "method", "family", "setting", "solution_error", "value", "bound", "growth", "frozen", "unsure",
    "clamped",
]  # fmt: skip


def measured(frames: Frames, law: str) -> pd.DataFrame:
    """All rows of all tables that have a value of the law: columns value, bound, frozen, unsure beside theirs."""
    parts = []
    for name in ("laws", "stability"):
        frame = frames.get(name, pd.DataFrame())
        if not len(frame) or law not in frame:
            continue
        part = frame[(frame["status"] == "ok") & frame[law].notna() & (frame["family"] != LIMIT)]
        uncertainty, values = numbers(part, f"{law}_uncertainty", 0.0), numbers(part, law)
        parts.append(
            part.assign(
                value=values, bound=bound(part, law), growth=growth(part, law),
                frozen=numbers(part, law + FROZEN), unsure=(uncertainty > 0) & (values <= UNSURE * uncertainty),
                clamped=numbers(part, f"{law}_clamped", 0.0),
            )
        )  # fmt: skip
    if not parts:
        return pd.DataFrame(columns=[*MEASURED, "kept"])
    rows = pd.concat([part.reindex(columns=MEASURED) for part in parts], ignore_index=True)
    return rows.assign(kept=rows["value"] <= rows["bound"], unsure=rows["unsure"].astype(bool))


def keepers(rows: pd.DataFrame) -> list[str]:
    """The methods that keep the law in every row they have."""
    kept = rows.groupby("method", sort=False)["kept"].all()
    return [str(method) for method in kept.index[kept]]


def place(row: pd.Series) -> str:
    return f"{row['method']} on `{row['scene']}`, {row['setting']}"


# -- findings --------------------------------------------------------------------------------------
def law_finding(frames: Frames, law: str, column: Column) -> Finding | None:
    """Which methods keep a structural law, over all rows; the exceptions with their cause."""
    rows = measured(frames, law)
    if not len(rows):
        return None
    label = called(law)
    kept, contact = keepers(rows), rows["family"] == CONTACT
    ours = list(dict.fromkeys(rows[contact]["method"]))
    exceptions = list(contact_exceptions(frames, law, rows[contact & ~rows["kept"]]))
    magnified = rows[contact & rows["kept"] & (rows["value"] > STRUCTURE)]
    if len(magnified):
        where = [
            f"`{scene}` {scientific(part['value'].max())}"
            + (f" (growth {scientific(part['growth'].max())})" if part["growth"].max() > GREW else "")
            for scene, part in magnified.groupby("scene", sort=False)
        ]
        exceptions.append(
            f"above {scientific(STRUCTURE, 0)}, but within what round-off may account for (ε times the "
            f"evaluations of the run, for η times the growth of its map), up to: {names(where)}"
        )
    if ours and set(ours) <= set(kept):
        missing = set(ours) < {m for m, family in families(frames).items() if family == CONTACT}
        who = "Every contact method it was measured for" if missing else "Every contact method"
        sentence = f"{who} keeps it to round-off at every setting on every scene."
    elif ours:
        good, runs = int((contact & rows["kept"]).sum()), int(contact.sum())
        sentence = (
            f"The contact methods keep it to round-off in {good} of {runs} runs; the exceptions are below."
        )
    else:
        sentence = "No contact method was measured."
    others = [method for method in kept if method not in ours]
    if others:
        sentence += f" Of the other methods {names(others)} keep it in all of theirs."
    rest = rows[~contact & ~rows["method"].isin(others)]
    if len(rest):
        sentence += f" No {'further' if others else 'other'} method keeps it at every setting"
        sure = rest[~rest["unsure"]]
        if len(sure):
            least = sure.loc[sure["value"].idxmin()]
            sentence += (
                f"; at its best setting the least of theirs is {scientific(least['value'])} ({place(least)})"
            )
        sentence += "."
    title = upper(label)
    return Finding(f"law_{law}", title, sentence, covers(rows, frames, law), tuple(exceptions))


def covers(rows: pd.DataFrame, frames: Frames, law: str) -> str:
    """Rows, scenes and methods behind a finding, and which methods have no value at all."""
    said = (
        f"{many(len(rows), 'run')} of {many(rows['method'].nunique(), 'method')} on "
        f"{many(rows['scene'].nunique(), 'scene')}"
    )
    ran = [frames[n] for n in ("laws", "stability") if n in frames and law in frames[n]]
    scenes = set(rows["scene"])
    tried = dict.fromkeys(
        m for f in ran for m in f[(f["status"] == "ok") & f["scene"].isin(scenes)]["method"]
    )
    if without := [m for m in tried if m not in set(rows["method"])]:
        said += f"; not measured: {names(without)}"
    if unresolved := int((rows["unsure"] & ~rows["kept"]).sum()):
        said += f"; {many(unresolved, 'run')} known as an upper bound only"
    return said


def contact_exceptions(frames: Frames, law: str, broken: pd.DataFrame) -> Iterator[str]:
    """Each exception among the contact methods with the cause the tables show.

    broken : the rows that do not keep the law.
    """
    frozen = broken["frozen"] <= broken["bound"]
    for method, rows in broken[frozen].groupby("method", sort=False):
        worst = rows.loc[rows["value"].idxmax()]
        yield (
            f"{method}: up to {scientific(worst['value'])} on {names(scenes_of(rows), 4)}; its steps "
            "follow the motion, "
            f"and only with the steps held fixed it is kept ({scientific(rows['frozen'].max())})"
        )
    rest = broken[~frozen]
    everyone = measured(frames, law)
    near = rest["value"] <= NEAR * rest["bound"]
    for scene, rows in rest.groupby("scene", sort=False):
        here = everyone[(everyone["scene"] == scene) & (everyone["family"] == CONTACT)]
        methods = list(dict.fromkeys(rows["method"]))
        worst = rows.loc[rows["value"].idxmax()]
        if near[rows.index].all():
            continue
        nobody = set(methods) >= set(here["method"])
        who = "no contact method keeps it at every setting" if nobody else names(methods, 3)
        instead = kept_instead(frames, law, str(scene), set(methods)) if nobody else []
        cause = f", {worst['value'] / worst['bound']:.2g} times the bound of round-off"
        if worst["solution_error"] > WILD:
            cause += f", in a run whose solution is off by {scientific(worst['solution_error'])}"
        if worst["growth"] > GREW:
            cause += f", whose map grows by {scientific(worst['growth'])}"
        if instead:
            cause += f" (what is kept there: {names(instead)})"
        yield f"on `{scene}` {who}: up to {scientific(worst['value'])} ({worst['method']}, {worst['setting']}){cause}"
    slight = rest[near & ~rest["scene"].isin(set(rest[~near]["scene"]))]
    if len(slight):
        worst = slight.loc[(slight["value"] / slight["bound"]).idxmax()]
        yield (
            f"no more than {np.ceil(10 * (worst['value'] / worst['bound'])) / 10:g} times above the "
            f"bound of round-off in {many(len(slight), 'run')} on {names(scenes_of(slight))} "
            f"(worst {scientific(worst['value'])}, {place(worst)})"
        )


def scenes_of(rows: pd.DataFrame) -> list[str]:
    return [f"`{scene}`" for scene in dict.fromkeys(rows["scene"])]


def kept_instead(frames: Frames, law: str, scene: str, methods: set[str]) -> list[str]:
    """Labels of the other structural laws which all these methods keep on a scene, the steps held fixed or not."""
    found = []
    for name in structural():
        rows = measured(frames, name)
        rows = rows[(rows["scene"] == scene) & rows["method"].isin(methods)]
        fixed = rows["kept"] | (rows["frozen"] <= rows["bound"])
        if name != law and len(rows) and fixed.all():
            found.append(called(name))
    return found


def energy_finding(frames: Frames) -> Finding | None:
    """Whether any method keeps the decay of H or H0, and how far the contact methods are off."""
    said, rows_of = [], []
    for law in ENERGIES:
        rows = measured(frames, law)
        rows = rows[~rows["scene"].isin(hard_only(frames))]
        if not len(rows):
            continue
        rows_of.append(rows)
        label = called(law)
        kept, ours = keepers(rows), rows[rows["family"] == CONTACT]
        who = (
            f"{names(kept)} keep{'s' if len(kept) == 1 else ''} it"
            if kept
            else "no method keeps it to round-off"
        )
        if len(ours):
            worst = ours.loc[ours["value"].idxmax()]
            rest = "the other contact methods" if set(kept) & set(ours["method"]) else "the contact methods"
            who += f"; {rest} are up to {scientific(worst['value'])} off ({place(worst)})"
        said.append(f"{label}: {who}.")
    if not said:
        return None
    rows = pd.concat(rows_of)
    return Finding(
        "energies", "H0 and H", " ".join(said),
        f"{len(rows)} values, {rows['method'].nunique()} methods on {rows['scene'].nunique()} scenes",
    )  # fmt: skip


def hard_only(frames: Frames) -> set[str]:
    """Scenes of the table of hard scenes alone: there a coarse setting may be off by anything."""
    hard = frames.get("stability", pd.DataFrame())
    easy = set(frames["laws"]["scene"]) if "laws" in frames and len(frames["laws"]) else set()
    return set(hard["scene"]) - easy if len(hard) else set()


def findings(frames: Frames) -> list[Finding]:
    found = [law_finding(frames, law, column) for law, column in structural().items()]
    return [finding for finding in [*found, energy_finding(frames)] if finding is not None]


# -- views -----------------------------------------------------------------------------------------
def bounded(frame: pd.DataFrame) -> pd.DataFrame:
    """The frame with a column `LAW_bound` for each structural law it has: up to what it is round-off."""
    return frame.assign(**{f"{law}_bound": bound(frame, law) for law in structural() if law in frame})


def drift_cell(row: pd.Series, law: str) -> Cell:
    """One deviation: with its error bar where that is a tenth of it or more, and a dagger where clamped.

    row : of a frame that is `bounded`.
    """
    value = row.get(law)
    if value is None or pd.isna(value):
        return Cell(DASH, hint=str(row.get("derivative", "")) if law.endswith("drift") else "")
    value = float(value)
    error, limit = (scalar(row, f"{law}_{name}") for name in ("uncertainty", "bound"))
    clamped = scalar(row, f"{law}_clamped") > 0
    kept = law in structural() and value <= limit
    vague = error > 0 and value <= UNSURE * error
    bar = f" ± {scientific(error, 0)}" if not vague and error >= value / 10 and error > 0 else ""
    return Cell(
        f"{'≤ ' if vague else ''}{scientific(value)}{bar}{DAGGER if clamped else ''}", value,
        marks(Mark.kept if kept else None, Mark.clamped if clamped else None, Mark.bound if vague else None),
    )  # fmt: skip


def scalar(row: pd.Series, name: str) -> float:
    """A number of a row, 0 where it is blank."""
    value = row.get(name)
    return 0.0 if value is None or pd.isna(value) else float(value)


def order_cell(frames: Frames, method: str, scene: str, control: str) -> Cell:
    """The extrapolated order of a method on a scene; why not, where there is none."""
    if control != "step":
        return Cell(STEPS[control])
    orders = frames.get("convergence", pd.DataFrame())
    here = orders[(orders["method"] == method) & (orders["scene"] == scene)] if len(orders) else orders
    if not len(here):
        return Cell(DASH)
    first = here.iloc[0]
    if pd.isna(first["order"]):
        return Cell(str(first["status"]) if first["status"] != "ok" else "no range")
    return number(first["order"], "{:.2f}".format)


def chosen_cost(frame: pd.DataFrame) -> pd.DataFrame:
    """Of the costs every method was asked for, the rows of the one that most can meet; of equals the largest."""
    met = frame[frame["status"] == "ok"].groupby("cost").size()
    return frame[frame["cost"] == met[met == met.max()].index.max()] if len(met) else frame.iloc[:0]


def overview(frames: Frames, scenes: tuple[str, ...] = FIRST) -> View | None:
    """Order and decay laws of every method at equal cost: the table that stands first."""
    rows_of = chosen_cost(frames["decay_laws"])
    scenes = tuple(scene for scene in scenes if scene in set(rows_of["scene"]))
    if not scenes:
        return None
    part = rows_of[rows_of["scene"].isin(scenes)]
    shown = {
        scene: [
            law for law in at_equal_cost() if law in part and part[part["scene"] == scene][law].notna().any()
        ]
        for scene in scenes
    }
    heads = [Head("method", words=True)]
    for scene in scenes:
        heads.append(Head("order", "order of convergence, extrapolated", group=scene))
        heads += [Head(called(law), LAWS_TABLE.columns[law].meaning, group=scene) for law in shown[scene]]
    part = bounded(part)
    rows = []
    for method in dict.fromkeys(part["method"]):
        cells = [word(method)]
        for scene in scenes:
            here = part[(part["method"] == method) & (part["scene"] == scene)]
            cells.append(
                order_cell(frames, str(method), scene, here["control"].iloc[0]) if len(here) else Cell(DASH)
            )
            for law in shown[scene]:
                if not len(here) or here["status"].iloc[0] == "unsupported":
                    cells.append(Cell(DASH))
                elif here["status"].iloc[0] != "ok":
                    cells.append(Cell(str(here["status"].iloc[0]), marks=marks(Mark.none)))
                else:
                    cells.append(drift_cell(here.iloc[0], law))
        rows.append(tuple(cells))
    return View(
        "overview",
        "Order and decay laws at equal cost",
        equal_cost(part),
        tuple(heads),
        tuple(rows),
        "decay_laws.csv",
    )


def equal_cost(part: pd.DataFrame) -> str:
    """What equal cost was, scene by scene, and how to read the entries."""
    spent = []
    for scene, rows in part[part["status"] == "ok"].groupby("scene", sort=False):
        cost = numbers(rows, "rhs_equivalents").dropna()
        low, high = count(cost.min()), count(cost.max())
        spent.append(f"`{scene}` {low if low == high else f'{low} to {high}'}")
    return (
        "Largest deviation over the run, every method at the same number of evaluations, or as near to it as its steps "
        f"and tolerances allow ({', '.join(spent)}): "
        "where fewer are told, no tolerance of the method spends more. "
        f"Bold, J law and contact drift only: at most {scientific(STRUCTURE, 0)}. "
        f"H0 is compared with the true H0, the others with their decay e^{{−∫Γ'}} (J with the true J "
        "where a torque acts). "
        f"{MEANINGS['dagger']}."
    )


def equal_cost_view(part: pd.DataFrame, frames: Frames) -> View:
    """One scene at one cost, with the setting taken and what it came to."""
    scene, cost = str(part["scene"].iloc[0]), part["cost"].iloc[0]
    part = bounded(part)
    shown = [law for law in at_equal_cost() if law in part and part[law].notna().any()]
    rows = []
    for _, row in part.iterrows():
        lead = (word(row["method"]), word(row["engine"]), word(row["setting"]))
        if row["status"] != "ok":
            blanks = (
                Cell(str(row["status"]), marks=marks(Mark.none)),
                *(Cell("") for _ in range(len(shown) + 2)),
            )
            rows.append((*lead, *blanks))
            continue
        rows.append((
            *lead, number(row["rhs_equivalents"], count), order_cell(frames, str(row["method"]), scene, row["control"]),
            number(row["solution_error"], scientific), *(drift_cell(row, law) for law in shown),
        ))  # fmt: skip
    heads = (
        Head("method", words=True), Head("engine", words=True), Head("setting", words=True),
        Head("evaluations", DECAY_LAWS.columns["rhs_equivalents"].meaning), Head("order"),
        Head("solution error", DECAY_LAWS.columns["solution_error"].meaning),
        *(Head(called(law), LAWS_TABLE.columns[law].meaning) for law in shown),
    )  # fmt: skip
    title = f"{scene}, {cost:g} evaluations per unit of time"
    return View(f"equal_cost_{scene}_{cost:g}", title, equal_cost(part), heads, tuple(rows), "decay_laws.csv")


def law_view(frames: Frames, law: str, column: Column) -> View | None:
    """Methods × scenes of one law: the range over the settings, or that it is kept."""
    frame = frames["laws"]
    rows = measured({"laws": frame}, law)
    if not len(rows):
        return None
    structure = column.rule is Rule.structure
    scenes = [s for s in dict.fromkeys(frame["scene"]) if s in set(rows["scene"])]
    lines = []
    for method in dict.fromkeys(rows["method"]):
        cells = [word(method)]
        for scene in scenes:
            here = rows[(rows["method"] == method) & (rows["scene"] == scene)]
            if not len(here):
                cells.append(Cell(DASH))
                continue
            low, high = here["value"].min(), here["value"].max()
            kept = structure and bool(here["kept"].all())
            clamped, vague = bool((here["clamped"] > 0).any()), bool(here["unsure"].any())
            whole = column.type == "whole"
            show = readable if whole else scientific
            text = show(high) if kept or low == high else f"{show(low)} … {show(high)}"
            text = ("≤ " if vague and not kept else "") + text
            cells.append(
                Cell(text + (DAGGER if clamped else ""), high,
                     marks(Mark.kept if kept else None, Mark.clamped if clamped else None))
            )  # fmt: skip
        lines.append(tuple(cells))
    label = called(law)
    meaning = f"{column.meaning}. {upper(MEANINGS['range'])}."
    if structure:
        meaning += f" {upper(MEANINGS['kept'])}."
    if f"{law}_clamped" in frame:
        meaning += f" {MEANINGS['dagger']}."
    if f"{law}{FROZEN}" in frame:
        meaning += (
            " That of the map itself; of adaptive methods not with their steps held fixed. ≤: "
            "no more than an upper bound."
        )
    heads = (Head("method", words=True), *map(Head, scenes))
    return View(f"law_{law}", label, meaning, heads, tuple(lines), "laws.csv")


# -- figures ---------------------------------------------------------------------------------------
#: columns of the table along time
ALONG_TIME = {
    "energy_deviation": "H0",
    "hamiltonian_deviation": "contact Hamiltonian H",
    "momentum_deviation": "momentum map J",
    "contact_deviation": "contact form η",
}


def along_time(frame: pd.DataFrame, scene: str) -> Figure:
    """The deviations from the H0, H, J and contact laws along time."""
    rows = frame[(frame["scene"] == scene) & (frame["status"] == "ok")]
    panels = tuple(
        Panel(
            title, Axis("t"), number_axis(LAWS_TIME.columns[column].meaning),
            by_method(rows, "t", column, every=4), spans=(round_off("y"),),
        )
        for column, title in ALONG_TIME.items() if rows[column].notna().any()
    )  # fmt: skip
    caption = "Settings: " + ", ".join(dict.fromkeys(rows["setting"])) + ". Shaded: round-off."
    return Figure(
        f"laws_{scene}",
        f"{scene}: deviation from each law along time",
        panels,
        caption,
        len(panels),
        source="laws_time.csv",
    )


def structure_figure(frame: pd.DataFrame) -> Figure | None:
    """Structure against accuracy, same runs."""
    ok = frame[frame["status"] == "ok"]
    wanted = (("contact_drift", "central"), ("momentum_law", "rigid_body"))
    panels = []
    for law, scene in wanted:
        rows = ok[(ok["scene"] == scene) & ok[law].notna()]
        if len(rows):
            label = called(law)
            panels.append(
                Panel(scene, number_axis("solution error", inverted=True), number_axis(label),
                      by_method(rows, "solution_error", law), spans=(round_off("y"),))
            )  # fmt: skip
    if not panels:
        return None
    return Figure(
        "structure", "Structure against accuracy, same runs", tuple(panels),
        "A law that is kept by construction does not depend on the error. Shaded: round-off.", 2, source="laws.csv",
    )  # fmt: skip


def sections(frames: Frames) -> list[Part]:
    parts: list[Part] = [
        Text(items=tuple(f"`{name}` ({called(name)}): {c.meaning}" for name, c in laws(LAWS_TABLE).items()))
    ]
    equal = frames["decay_laws"]
    if len(equal):
        costs = equal.groupby(["scene", "cost"], sort=False)
        parts.append(Section("At equal cost", tuple(equal_cost_view(part, frames) for _, part in costs)))
    views = (law_view(frames, law, column) for law, column in laws(LAWS_TABLE).items())
    ranges: list[Part] = [view for view in views if view is not None]
    drawn = structure_figure(frames["laws"])
    parts.append(Section("Law by law, over all settings", (*ranges, *([drawn] if drawn else []))))
    time = frames["laws_time"]
    scenes = dict.fromkeys(time[time["status"] == "ok"]["scene"]) if len(time) else {}
    parts += [Section(f"Along time: {s}", (along_time(time, s),), choice="scene") for s in scenes]
    return [*parts, raw(LAWS_TABLE, frames["laws"])]


ROOMS.add(
    Room(
        "laws", "Decay laws and drifts", "which methods preserve the laws, law by law and at equal cost", 20,
        ("laws", "decay_laws", "laws_time", "convergence", "stability"), sections, findings,
    )
)  # fmt: skip
