"""Averages over long runs of a chaotic scene: who has them right, for how many evaluations; and what the pairs do."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from contactbench.report.cells import DASH, Cell, Head, Mark, View, marks, number, word
from contactbench.report.figures import long_time as figures
from contactbench.report.figures.long_time import ALLOWED
from contactbench.report.numbers import many, names, scientific, times
from contactbench.report.raw import raw
from contactbench.report.rooms import ROOMS, Finding, Frames, Part, Room, Text
from contactbench.results.long_time import DIMENSION, ENERGY, EXPONENT, LONG_TIME, SUM
from contactbench.results.round_off import STRUCTURE

SOURCE = "long_time.csv"
AVERAGES = (ENERGY, EXPONENT, DIMENSION)
#: error bars on either side of an average in which the true one surely is
SURE = 2.0
#: settings stand up to so far apart: methods whose least cost differs by less are a tie
RUNG = 1.5


def known(frame: pd.DataFrame, quantity: str) -> pd.DataFrame:
    """The rows of a quantity with a number, cheap to dear.

    off, bar : the difference from the reference and its error bar, in parts of what is allowed.
    """
    part = figures.of(frame, quantity)
    reference = part[part["reference"]]
    if not len(reference) or quantity not in ALLOWED:
        return part.assign(off=np.nan, bar=np.nan)
    true = reference.iloc[0]
    allowed = ALLOWED[quantity] * abs(true["mean"])
    return part.assign(
        off=(part["mean"] - true["mean"]).abs() / allowed,
        bar=np.hypot(part["error"], true["error"]) / allowed,
    )


def right_from(rows: pd.DataFrame, right: pd.Series) -> float:
    """The evaluations of one method from which on every setting is right; nan if the dearest is not."""
    wrong = ~right.to_numpy(dtype=bool)
    first = int(np.flatnonzero(wrong)[-1]) + 1 if wrong.any() else 0
    return float(rows["evaluations_per_time"].iloc[first]) if first < len(rows) else np.nan


def least(frame: pd.DataFrame, quantity: str) -> pd.DataFrame:
    """Evaluations from which on each method has an average right; a row per method, the fewest first.

    surely : from where it is, its noise taken against it; perhaps : the noise taken for it.  bound : 1 where that is
    its cheapest setting.
    """
    rows = known(frame, quantity)
    rows = rows[~rows["reference"]]
    found = {
        name: {
            "surely": (surely := right_from(own, own["off"] + SURE * own["bar"] <= 1)),
            "perhaps": right_from(own, own["off"] - SURE * own["bar"] <= 1),
            "bound": surely == own["evaluations_per_time"].iloc[0],
        }
        for name, own in rows.groupby("method", sort=False)
    }
    costs = pd.DataFrame.from_dict(found, orient="index", columns=["surely", "perhaps", "bound"]).astype(
        float
    )
    return costs.dropna().sort_values(["surely", "perhaps"], kind="stable")


def tied(costs: pd.DataFrame) -> list[str]:
    """The cheapest, and those that neither a rung nor the noise tells from it."""
    return [str(name) for name in costs.index[costs["perhaps"] <= RUNG * costs["surely"].min()]]


def spoken(cost: pd.Series) -> str:
    """7.8; 7.8 to 15 where the noise does not tell; ≤ 7.8 where nothing cheaper was measured."""
    low, high = f"{cost['perhaps']:.2g}", f"{cost['surely']:.2g}"
    return f"≤ {low}" if cost["bound"] else low if low == high else f"{low} to {high}"


def allowed() -> str:
    """10 % (mean energy), …"""
    return names([f"{100 * part:g} % ({quantity})" for quantity, part in ALLOWED.items()])


# -- pairs -----------------------------------------------------------------------------------------
def hidden_from(frame: pd.DataFrame, method: str) -> str:
    """The evaluations from which on what the pairs are off hides in the error bar of the largest exponent.

    ≤: at the cheapest setting.
    """
    own = frame[frame["method"] == method]
    sums, bars = figures.of(own, SUM), figures.of(own, EXPONENT).set_index("setting")["error"]
    cost = right_from(sums, sums["mean"].abs() <= sums["setting"].map(bars))
    return (
        DASH if np.isnan(cost) else f"{'≤ ' if cost == sums['evaluations_per_time'].min() else ''}{cost:.2g}"
    )


# -- views -----------------------------------------------------------------------------------------
def costs_view(frame: pd.DataFrame) -> View:
    found = {quantity: least(frame, quantity) for quantity in AVERAGES}
    rows = []
    for method in dict.fromkeys(frame["method"]):
        cells: list[Cell] = [word(method)]
        for costs in found.values():
            best = tied(costs)
            mark = (Mark.tie if len(best) > 1 else Mark.best) if method in best else None
            has = method in costs.index
            cells.append(
                Cell(spoken(costs.loc[method]), float(costs.loc[method, "surely"]), marks(mark))
                if has
                else Cell(DASH)
            )
        rows.append(tuple(cells))
    meaning = (
        "Evaluations of a trajectory per unit of time from which on, at every dearer setting too, an average is within "
        f"{allowed()} of the reference; two numbers where {SURE:g} error bars decide whether it is; ≤: at its cheapest "
        f"setting. Settings are up to a factor {RUNG:g} apart, and methods within that "
        "are a tie. Exponents and dimension are of runs with tangents, which a solver with a tolerance controls too "
        f"and begins anew every period. {DASH}: not measured, or wrong at every setting."
    )
    return View(
        "long_time_costs", "The least that has the averages right", meaning,
        (Head("method", words=True), *map(Head, AVERAGES)), tuple(rows), SOURCE,
    )  # fmt: skip


def pairs_view(frame: pd.DataFrame) -> View:
    rows, sums = [], figures.of(frame, SUM)
    for method in dict.fromkeys(sums["method"].reindex(frame.index).dropna()):
        own = sums[sums["method"] == method]
        defects = own["pairing_defect"]
        kept = Mark.kept if (defects <= STRUCTURE).all() else None
        cells = (number(defects.iloc[k], scientific, kept) for k in (0, -1))
        rows.append((word(method), *cells, Cell(hidden_from(frame, method))))
    heads = (
        Head("method", words=True), Head("cheapest", group="pairing defect"), Head("dearest", group="pairing defect"),
        Head("hidden from", "evaluations per unit of time"),
    )  # fmt: skip
    meaning = (
        f"{LONG_TIME.columns['pairing_defect'].meaning.partition(';')[0].capitalize()}, at a method's cheapest and "
        "dearest settings; and from how many evaluations on what it adds up to, the sum of the exponents plus γ, is "
        "below the error bar of the largest exponent and no longer matters for these averages."
    )
    return View("long_time_pairs", "Pairs of exponents", meaning, heads, tuple(rows), SOURCE)


# -- findings --------------------------------------------------------------------------------------
def findings(frames: Frames) -> list[Finding]:
    frame = frames["long_time"]
    return [*averages_finding(frame), *pairs_finding(frame)]


def averages_finding(frame: pd.DataFrame) -> Iterator[Finding]:
    """Who has the averages right for the fewest evaluations."""
    reference = frame[frame["reference"]]
    if not len(reference):
        return
    said = []
    for quantity in AVERAGES:
        costs = least(frame, quantity)
        best = tied(costs)
        first, rest = ([f"{name} {spoken(costs.loc[name])}" for name in costs.index if (name in best) == led]
                       for led in (True, False))  # fmt: skip
        if first:
            led = f"{quantity} {f'tie ({times(RUNG)}): ' if len(first) > 1 else ''}{names(first)}"
            said.append(led + (f", then {names(rest)}" if rest else ""))
    true = reference.iloc[0]
    bars = reference.set_index("quantity")
    share = names(
        [f"{100 * bars['error'][q] / abs(bars['mean'][q]):.1g} % ({q})" for q in AVERAGES if q in bars.index]
    )
    sentence = (
        f"Evaluations per unit of time from which on averages over long chaotic runs are within {allowed()} of the "
        f"true ones, fewest first: {'; '.join(said)}."
    )
    others = names([typical(frame, q) for q in AVERAGES if q in bars.index])
    covers = (
        f"`{true['scene']}`, {many(frame['method'].nunique(), 'method')}, {true['periods']:.0f} periods, compared "
        f"with {true['method']} at {true['setting']}, whose error bars are {share}, those of the others about "
        f"{others}; two numbers where {SURE:g} bars decide; ≤: at its cheapest setting; methods within a factor "
        f"{RUNG:g}, the spacing of the settings, are a tie; exponents and dimension of solvers with a tolerance are of "
        "runs with the tangents in their error control"
    )
    yield Finding("long_time", "Long chaotic runs", sentence, covers, tuple(exceptions(frame)))


def typical(frame: pd.DataFrame, quantity: str) -> str:
    """The median error bar of an average, as a part of the reference."""
    rows = figures.of(frame, quantity)
    true = rows[rows["reference"]]["mean"].iloc[0]
    return f"{100 * rows[~rows['reference']]['error'].median() / abs(true):.2g} %"


def exceptions(frame: pd.DataFrame) -> Iterator[str]:
    """What a comparison of costs does not say: no chaos where there should be some, Jacobians, lost trajectories."""
    calm = figures.of(frame, EXPONENT)
    calm = calm[calm["mean"] <= SURE * calm["error"]]
    if len(calm):
        where = [
            f"{method} ({', '.join(f'{v:.2g}' for v in own['evaluations_per_time'])})"
            for method, own in calm.groupby("method", sort=False)
        ]
        yield (
            "on the whole not chaotic, because most or all trajectories of the coarse map end on a periodic orbit, at "
            f"these evaluations per unit of time: {names(where)}"
        )
    implicit = figures.of(frame, ENERGY)
    for method, own in implicit[implicit["jacobians_per_time"] > 0].groupby("method", sort=False):
        low, high = own["jacobians_per_time"].min(), own["jacobians_per_time"].max()
        yield f"{method} takes {low:.2g} to {high:.2g} Jacobians per unit of time beside that"
    lost = frame[(frame["status"] != "ok") & (frame["quantity"] == ENERGY)]
    if len(lost):
        yield f"trajectories diverged at {many(len(lost), 'setting')}: {names(list(dict.fromkeys(lost['method'])))}"


def pairs_finding(frame: pd.DataFrame) -> Iterator[Finding]:
    """Who keeps the pairs, and from where on that makes no difference any more."""
    rows = figures.of(frame, SUM)
    if not len(rows):
        return
    rows = rows.reindex([i for i in frame.index if i in rows.index])
    worst = rows.groupby("method", sort=False)["pairing_defect"].max()
    kept = [str(name) for name in worst.index[worst <= STRUCTURE]]
    rest = rows[~rows["method"].isin(kept)]
    said = []
    if kept:
        said.append(
            f"{names(kept)} keep σ₁σ₂ = e^{{−γt}} to round-off at every setting that did not diverge (at most "
            f"{scientific(worst[kept].max())} per unit of time)"
        )
    if len(rest):
        smallest = rest.loc[rest["pairing_defect"].idxmin()]
        who = names(list(dict.fromkeys(rest["method"])))
        said.append(
            f"{who} at none (at least {scientific(smallest['pairing_defect'])}: {smallest['method']}, "
            f"{smallest['setting']})" if (rest["pairing_defect"] > STRUCTURE).all() else f"{who} at some only"
        )  # fmt: skip
    hidden = [f"{m} {c}" for m in dict.fromkeys(rest["method"]) if (c := hidden_from(frame, m)) != DASH]
    sentence = f"{'; '.join(said)}."
    if hidden:
        sentence += (
            " It stops mattering for averages where the sum of the exponents is off by less than the error bar of the "
            f"largest, at these evaluations per unit of time: {names(hidden)}."
        )
    covers = (
        f"`{rows['scene'].iloc[0]}`, of one degree of freedom: the pair is the determinant; "
        f"{many(len(rows), 'setting')} of {many(rows['method'].nunique(), 'method')}; ≤: at its cheapest setting"
    )
    yield Finding("pairing", "Pairs of exponents", sentence, covers)


def sections(frames: Frames) -> list[Part]:
    frame = frames["long_time"]
    return [
        Text(
            "Runs of a chaotic scene cannot be compared point by point. Their averages can, as far as their error bars "
            "allow: H0 at phase 0 of the force, Lyapunov's exponents, the dimension of the attractor. Error bars are "
            "standard errors from independent trajectories."
        ),
        costs_view(frame),
        *figures.averages(frame),
        pairs_view(frame),
        *figures.pairs(frame),
        raw(LONG_TIME, frame),
    ]


ROOMS.add(
    Room(
        "long_time", "Long chaotic runs", "H0 once in a period, Lyapunov exponents and dimension from long runs, and "
        "what they cost", 58, ("long_time",), sections, findings,
    )
)  # fmt: skip
