"""Which methods preserve the laws, and how far the others are from it, as sentences over all rows."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from contactbench.measure.round_off import DECIDABLE, OF_THE_STATE, decided
from contactbench.report.contest import CONTACT, ESTABLISHED, families
from contactbench.report.kept import called, keepers, measured, structural
from contactbench.report.numbers import many, names, rounded, scientific, upper
from contactbench.report.rooms import Finding, Frames
from contactbench.results.round_off import STRUCTURE

#: a run with a larger error than this does not follow the motion, whose condition number then says little
WILD = 0.01
#: deviations up to so many times the bound of round-off are told together
NEAR = 10.0
#: growth of the map worth telling
GREW = 2.0
#: how the column `derivative` begins where it was by differences
BY_DIFFERENCES = "central differences"
ENERGIES = ("energy_law", "hamiltonian_law")
#: why an energy is kept where the other is not
WHY = {
    ("energy_law", scene): " (part A is the exact free body, which keeps ‖M‖ and H0, and C scales M, in any "
    "order: only the clock is off)"
    for scene in ("rigid_body", "tumbling", "needle")
}  # fmt: skip


def law_finding(frames: Frames, law: str) -> Finding | None:
    """Which methods keep a structural law, over all rows; the exceptions with their cause."""
    every = measured(frames, law)
    rows = every[every["judged"]]
    if not len(rows):
        return None
    contact = rows["family"] == CONTACT
    claimed = contact & rows["claimed"]
    vague = claimed & rows["undecided"]
    exceptions = [
        *contact_exceptions(frames, law, rows[claimed & rows["broken"]]),
        *magnified(rows[claimed & rows["kept"] & (rows["value"] > STRUCTURE)]),
        *undecided(rows[vague & (rows["bound"] > DECIDABLE)]),
        *faded(rows[vague & (rows["bound"] <= DECIDABLE) & (rows["clamped"] > 0)]),
    ]
    said = [of_contact_methods(frames, rows[claimed]), unpromised(rows[contact & ~claimed])]
    sentence = " ".join(filter(None, [*said, *of_others(rows[~contact])]))
    return Finding(f"law_{law}", upper(called(law)), sentence, covers(rows, frames, law), tuple(exceptions))


def of_contact_methods(frames: Frames, rows: pd.DataFrame) -> str:
    """In how many runs the contact methods keep a law, of those that decide."""
    if not len(rows):
        return "No contact method was measured."
    told, kept = int((~rows["undecided"]).sum()), int(rows["kept"].sum())
    open_, resting = len(rows) - told, int((rows["kept"] & (rows["clamped"] > 0)).sum())
    return _kept(frames, rows, told, kept, open_) + (
        f" {resting} of these runs rest on times at which it is relative to a thousandth of the terms that cancel."
        if resting else ""
    )  # fmt: skip


def unpromised(rows: pd.DataFrame) -> str:
    """In how many runs the contact methods keep a law that they do not promise."""
    told, kept = int((~rows["undecided"]).sum()), int(rows["kept"].sum())
    return f"Where it is not promised they keep it in {kept} of {many(told, 'run')}." if told else ""


def _kept(frames: Frames, rows: pd.DataFrame, told: int, kept: int, open_: int) -> str:
    """The sentence of `of_contact_methods` on all runs that are promised."""
    if rows["broken"].any():
        rest = f"; {open_} more are undecided" if open_ else ""
        return f"The contact methods keep it to round-off in {kept} of {told} runs{rest}."
    known = {m for m, family in families(frames).items() if family == CONTACT}
    who = "Every contact method" + (" it was measured for" if set(rows["method"]) < known else "")
    if open_:
        return f"{who} keeps it to round-off in all {many(told, 'run')} that can tell; {open_} more are undecided."
    return f"{who} keeps it to round-off in every judged run that promises it."


def of_others(rows: pd.DataFrame) -> Iterator[str]:
    """Those at round-off in more than half of their runs, and on more than one scene; then the rest together.

    Round-off on a single scene may be a property of the scene: weak damping hides what a method gets wrong.
    """
    yield from of_deciding(rows[~rows["undecided"]])
    if open_ := int(rows["undecided"].sum()):
        told = set(rows[~rows["undecided"]]["method"])
        blind = [method for method in dict.fromkeys(rows["method"]) if method not in told]
        among = f", among them all of {names(blind)}" if blind else ""
        yield (
            f"{many(open_, 'run')} of the others {'are' if open_ > 1 else 'is'} undecided or known by an upper bound "
            f"only{among}."
        )


def of_deciding(told: pd.DataFrame) -> Iterator[str]:
    """What `of_others` says of the runs that show something."""
    by_method = told.groupby("method", sort=False)["kept"]
    share = by_method.mean()
    spread = told[told["kept"]].groupby("method")["scene"].nunique().reindex(share.index, fill_value=0)
    often = [str(method) for method in share.index[(share > 0.5) & (spread > 1)]]
    if often:
        said = [standing(told[told["method"] == method]) for method in often]
        yield f"Of the other methods {names(said)}."
    rest = told[~told["method"].isin(often)]
    if not len(rest):
        return
    kept, methods = int(rest["kept"].sum()), rest["method"].nunique()
    who = f"{'Of the remaining' if often else 'Of the other'} {many(methods, 'method')} none keeps it at every setting"
    if lone := [str(method) for method in share.index[(share == 1) & (spread == 1)]]:
        there = names(scenes_of(rest[rest["method"].isin(lone)]))
        who += f" (but for {names(lone)}, on {there} alone)"
    if kept:
        yield f"{who}; {kept} of their {many(len(rest), 'run')} reach round-off."
    else:
        least = rest.loc[rest["value"].idxmin()]
        yield f"{who}; the smallest deviation is {scientific(least['value'])} ({place(least)})."


def standing(rows: pd.DataFrame) -> str:
    """How often one method keeps a law, and by how much it misses it elsewhere."""
    first, broken = rows.iloc[0], rows[rows["broken"]]
    kind = "" if first["family"] == ESTABLISHED else f" ({first['family']})"
    said = f"{first['method']}{kind} keeps it in {int(rows['kept'].sum())} of {many(len(rows), 'run')}"
    if not len(broken):
        return said
    worst, where = broken.loc[broken["value"].idxmax()], names(scenes_of(broken), 4)
    if (broken["value"] <= NEAR * broken["bound"]).all():
        return (
            f"{said} (elsewhere, on {where}, no more than {times_above(broken)} times the bound of round-off)"
        )
    return f"{said} (elsewhere, on {where}, up to {scientific(worst['value'])})"


def times_above(rows: pd.DataFrame) -> str:
    """The largest deviation in units of its bound, rounded up."""
    return f"{np.ceil(10 * (rows['value'] / rows['bound']).max()) / 10:g}"


def magnified(rows: pd.DataFrame) -> Iterator[str]:
    """Deviations of the contact methods above the flat threshold that round-off accounts for, scene by scene."""
    if len(rows):
        where = [
            f"`{scene}` {scientific(part['value'].max())}"
            + (f" (growth {rounded(part['growth'].max())})" if part["growth"].max() > GREW else "")
            for scene, part in rows.groupby("scene", sort=False)
        ]
        yield (
            f"above {scientific(STRUCTURE, 0)}, but within what round-off may amount to (ε times the evaluations of "
            f"the run, for η times the growth of its map), up to: {names(where)}"
        )


def faded(rows: pd.DataFrame) -> Iterator[str]:
    """Runs that save nothing early enough to decide."""
    if len(rows):
        yield (
            f"{many(len(rows), 'run')} on {names(scenes_of(rows))} undecided, because at every saved time less than a "
            "thousandth of the terms is left of what is kept"
        )


def undecided(rows: pd.DataFrame) -> Iterator[str]:
    """Runs of the contact methods in which round-off alone may amount to too much to tell."""
    if len(rows):
        where = [
            f"`{scene}` ({many(len(part), 'run')}, growth up to {rounded(part['growth'].max())}, deviation up to "
            f"{scientific(part['value'].max())})" for scene, part in rows.groupby("scene", sort=False)
        ]  # fmt: skip
        yield (
            f"undecided, because the problem is too ill-conditioned at these steps (round-off alone may amount to "
            f"more than {scientific(DECIDABLE, 0)}, and any method might pass): {names(where)}"
        )


def covers(rows: pd.DataFrame, frames: Frames, law: str) -> str:
    """Rows, scenes and methods behind a finding, how well differences resolve, and who has no value at all."""
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
    apart = rows["derivative"].str.startswith(BY_DIFFERENCES).fillna(False) & (law not in OF_THE_STATE)
    bars = rows["uncertainty"][apart & (rows["uncertainty"] > 0)]
    if apart.any():
        said += f"; {many(int(apart.sum()), 'run')} by differences of the solver"
    if len(bars):
        low, middle = scientific(bars.min(), 0), scientific(bars.median(), 0)
        said += f", which resolve nothing below their error bar: {low} at best, {middle} in the median"
    if unresolved := int((rows["unsure"] & ~rows["kept"]).sum()):
        said += f"; {unresolved} of them known as an upper bound only"
    return said


def contact_exceptions(frames: Frames, law: str, broken: pd.DataFrame) -> Iterator[str]:
    """Each exception among the contact methods with the cause the tables show.

    broken : the rows that do not keep the law.
    """
    frozen = broken["frozen"] <= broken["bound"]
    for method, rows in broken[frozen].groupby("method", sort=False):
        worst = rows.loc[rows["value"].idxmax()]
        yield (
            f"{method}: up to {scientific(worst['value'])} in {many(len(rows), 'run')} on "
            f"{names(scenes_of(rows), 4)}, because its steps follow the motion: with the steps held fixed it stays "
            f"within round-off (at most {scientific(rows['frozen'].max())})"
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
        instead = kept_instead(frames, law, str(scene), methods) if nobody else []
        cause = f", {rounded(worst['value'] / worst['bound'])} times the bound of round-off"
        if worst["solution_error"] > WILD:
            cause += f", in a run whose solution is off by {scientific(worst['solution_error'])}"
        if worst["growth"] > GREW:
            cause += f", whose map grows by {rounded(worst['growth'])}"
        if instead:
            cause += f"; kept there: {names(instead)}"
        yield (
            f"on `{scene}` {who}: {many(len(rows), 'run')}, the largest deviation {scientific(worst['value'])} "
            f"({worst['method']}, {worst['setting']}){cause}"
        )
    slight = rest[near & ~rest["scene"].isin(set(rest[~near]["scene"]))]
    if len(slight):
        worst = slight.loc[(slight["value"] / slight["bound"]).idxmax()]
        yield (
            f"no more than {times_above(slight)} times the bound of round-off in {many(len(slight), 'run')} on "
            f"{names(scenes_of(slight))} "
            f"(farthest beyond it: {scientific(worst['value'])}, {place(worst)})"
        )


def place(row: pd.Series) -> str:
    """Which run it was."""
    return f"{row['method']} on `{row['scene']}`, {row['setting']}"


def scenes_of(rows: pd.DataFrame) -> list[str]:
    """The scenes of some rows, as they are written."""
    return [f"`{scene}`" for scene in dict.fromkeys(rows["scene"])]


def kept_instead(frames: Frames, law: str, scene: str, methods: list[str]) -> list[str]:
    """Labels of the other structural laws which all these methods keep on a scene, the steps held fixed or not."""
    found = []
    for name in structural():
        rows = measured(frames, name)
        rows = rows[(rows["scene"] == scene) & rows["method"].isin(methods)]
        fixed = rows["kept"] | decided(rows["frozen"], rows["bound"])[0]
        if name == law or not len(rows) or not fixed.all():
            continue
        moving = list(dict.fromkeys(rows[~rows["kept"]]["method"]))
        blind = [method for method in dict.fromkeys(methods) if method not in set(rows["method"])]
        but = [f"{names(moving)} with the steps held fixed"] if moving else []
        but += [f"not measured for {names(blind)}"] if blind else []
        found.append(called(name) + (f" ({'; '.join(but)})" if but else ""))
    return found


def energy_finding(frames: Frames) -> Finding | None:
    """Who keeps the decay of H or H0, on all scenes, and how far the contact methods are off on the standard ones."""
    said, rows_of = [], []
    for law in ENERGIES:
        rows = measured(frames, law)
        if not len(rows):
            continue
        rows_of.append(rows)
        kept = keepers(rows)
        if kept:
            where = names(scenes_of(rows[rows["method"].isin(kept)]), 4)
            who = f"{names(kept)} keep{'s' if len(kept) == 1 else ''} it to round-off (on {where})"
        else:
            who = "no method keeps it to round-off at every setting"
        contact = rows[rows["family"] == CONTACT]
        ours = contact[~contact["method"].isin(kept)]
        easy = ours[~ours["scene"].isin(hard_only(frames))]
        if len(easy):
            worst = easy.loc[easy["value"].idxmax()]
            other = "other " if len(ours) < len(contact) else ""
            who += f"; the {other}contact methods are up to {scientific(worst['value'])} off ({place(worst)})"
        who += "".join(f"; {part}" for part in kept_alone(frames, law, ours))
        said.append(f"{called(law)}: {who}.")
    if not said:
        return None
    rows = pd.concat(rows_of)
    covers = f"{len(rows)} values, {rows['method'].nunique()} methods on {rows['scene'].nunique()} scenes"
    if hard_only(frames) & set(rows["scene"]):
        covers += (
            "; how far methods are off: on the standard scenes, because on a hard one a coarse step may be off by "
            "anything, see stability.md"
        )
    return Finding("energies", "H0 and H", " ".join(said), covers)


def kept_alone(frames: Frames, law: str, rows: pd.DataFrame) -> Iterator[str]:
    """Who keeps one of the energies at every setting of a scene on which the other is off.

    Of the hard scenes those with a reason: where all motion dies out at once, hardly anything can be off.
    rows : of the contact methods that do not keep it everywhere.
    """
    (other,) = (name for name in ENERGIES if name != law)
    beside = measured(frames, other)
    found: dict[tuple[tuple[str, ...], str], list[tuple[str, float]]] = {}
    for scene, here in rows.groupby("scene", sort=False):
        why = WHY.get((law, str(scene)), "")
        if scene in hard_only(frames) and not why:
            continue
        there = beside[(beside["scene"] == scene) & (beside["value"] > NEAR * beside["bound"])]
        kept = tuple(method for method in keepers(here) if method in set(there["method"]))
        if kept:
            worst = there[there["method"].isin(kept)]["value"].max()
            found.setdefault((kept, why), []).append((f"`{scene}`", worst))
    for (kept, why), scenes in found.items():
        yield (
            f"on {names([scene for scene, _ in scenes])} {names(list(kept))} keep{'s' if len(kept) == 1 else ''} it at "
            f"every setting{why}, while the {called(other)} is up to {scientific(max(w for _, w in scenes))} off"
        )


#: a law, and the one of which it is a correction
CORRECTED = ("modified_hamiltonian", "hamiltonian_law")
#: a method of order six has no correction up to h⁴: the two differ by less than this part
SAME = 1e-3


def modified_finding(frames: Frames) -> Finding | None:
    """How much nearer the modified Hamiltonian is to its decay than H itself, in the same runs."""
    tables = [frames.get(name, pd.DataFrame()) for name in ("laws", "stability")]
    tables = [table for table in tables if len(table) and set(CORRECTED) <= set(table)]
    if not tables:
        return None
    frame = pd.concat(tables, ignore_index=True)
    fixed, plain = (pd.to_numeric(frame[law], errors="coerce") for law in CORRECTED)
    rows = frame.assign(fixed=fixed, plain=plain, gain=plain / fixed)
    rows = rows[(rows["status"] == "ok") & (rows["plain"] > NEAR * STRUCTURE) & rows["fixed"].notna()]
    same = (rows["gain"] - 1).abs() <= SAME
    itself = [m for m in dict.fromkeys(rows["method"]) if same[rows["method"] == m].all()]
    rows = rows[~same]
    if not len(rows):
        return None
    said = [
        f"{method}'s decays as e^{{−γt}} {rounded(one['gain'].median())} times as exactly as H in the median of "
        f"{many(len(one), 'run')} ({rounded(one['gain'].min())} to {rounded(one['gain'].max())} times)"
        for method, one in rows.groupby("method", sort=False)
    ]
    worse = rows[rows["gain"] < 1]
    return Finding(
        "modified_hamiltonian", "The modified Hamiltonian", f"By nested brackets up to h⁴: {'; '.join(said)}."
        + (f" That of {names(itself)} is H itself up to there." if itself else ""),
        f"{many(len(rows), 'run')} in which H is off by more than {scientific(NEAR * STRUCTURE, 0)}, "
        f"{many(rows['method'].nunique(), 'method')} on {many(rows['scene'].nunique(), 'scene')}",
        tuple(f"H is nearer in {place(row)}" for _, row in worse.iterrows()),
    )  # fmt: skip


def hard_only(frames: Frames) -> set[str]:
    """Scenes of the table of hard scenes alone: there a coarse setting may be off by anything."""
    hard = frames.get("stability", pd.DataFrame())
    easy = set(frames["laws"]["scene"]) if "laws" in frames and len(frames["laws"]) else set()
    return set(hard["scene"]) - easy if len(hard) else set()


def findings(frames: Frames) -> list[Finding]:
    found = [law_finding(frames, law) for law in structural()]
    found += [energy_finding(frames), modified_finding(frames)]
    return [finding for finding in found if finding is not None]
