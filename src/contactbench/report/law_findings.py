"""Which methods preserve the laws, and how far the others are from it, as sentences over all rows."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from contactbench.report.contest import (
    CONTACT,
    families,
)
from contactbench.report.kept import (
    ENERGIES,
    called,
    keepers,
    measured,
    structural,
)
from contactbench.report.numbers import (
    many,
    names,
    scientific,
    upper,
)
from contactbench.report.rooms import Finding, Frames
from contactbench.results.round_off import STRUCTURE
from contactbench.results.schema import Column

#: a run with a larger error than this does not follow the motion, whose condition number then says little
WILD = 0.01
#: deviations up to so many times the bound of round-off are told together
NEAR = 10.0
#: the suffix of a law measured with the steps of an adaptive method held fixed
#: growth of the map worth telling
GREW = 2.0


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


def place(row: pd.Series) -> str:
    return f"{row['method']} on `{row['scene']}`, {row['setting']}"


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
