"""Present a race: tables and notes for the terminal, the recommended method for each error, and a figure."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import pandas as pd

from contactbench.measure.law import OF_THE_STATE
from contactbench.measure.laws import LAWS
from contactbench.measure.statistics import WIDEST, Verdict
from contactbench.methods.base import METHODS
from contactbench.questions.contest import CONTACT, CUT
from contactbench.report.curves import by_method, cheapest, choose, contest_end, only
from contactbench.report.drawing import Axis, Figure, Panel
from contactbench.report.look import CONTESTANTS
from contactbench.report.numbers import DASH, count, duration, exact_power, names, scientific, times
from contactbench.tables.declared import shipped_folder

TITLES = {"compiled": "Compiled", "callbacks": "Calling back into Python"}
#: symbols of the laws in the tables, and the symbols that another one implies
SYMBOLS = {"momentum_law": "J", "contact_drift": "η", "distribution_drift": "ker η", "pairing_drift": "pairs"}
SYMBOLS |= {"attitude_drift": "RᵀR = 1", "sphere_drift": "|q| = R"}
IMPLIED = {"η": ("ker η", "pairs")}
LEGEND = "time at each error; kept at round-off: J, η, pairs of singular values"
#: number of solvers of other libraries that a recommendation names
PEERS = 2
#: rows of a short table, and columns of the terminal
ROWS, WIDTH = 10, 100


# -- the terminal ----------------------------------------------------------------------------------
def text(frame: pd.DataFrame, every: bool = False, scene: str = "") -> str:
    """Return the text of a race, the best `ROWS` methods or `every` one; scene : its words on the command line."""
    recommended, (reference, *more) = frame.attrs["recommendation"], notes(frame)
    order, named = ranked(frame), {word for line in recommended for word in re.findall(r"[\w-]+", line)}
    named |= {name for group in CONTESTANTS for name in [n for n in order if n in group][:1]}
    others = [name for name in order if name not in named]
    first = {*named, *others[: max(0, ROWS - len(named & {*order}))]}
    shown = order if every or len(order) <= ROWS else [name for name in order if name in first]
    own = frame[frame["method"].isin(shown)]
    tables = [times_table(own[own["kind"] == kind], kind, shown) for kind in TITLES if kind in {*own["kind"]}]
    if shown == order:
        tables.append(settings_table(own, shown))
    else:
        hidden = len(order) - len(shown)
        more = [
            f"{hidden} more methods, evaluations, settings, and why a method got no further: --csv, --all."
        ]
    late, folder = ", ".join(frame.attrs["unbegun"]), shipped_folder()
    missing = [f"Not begun, for want of time (--budget): {late}."] if late else []
    further = [f"Which method led on random problems of each kind: {folder / 'which.md'}"] if folder else []
    lines = (missing, tables, [reference, *more], [*recommended, how_to_run(frame, scene)], further)
    blocks = ["\n".join(map(wrap, block)) if block is not tables else "\n\n".join(tables) for block in lines]
    return "\n\n".join(filter(None, blocks))


def wrap(line: str) -> str:
    return textwrap.fill(line, WIDTH, subsequent_indent="  ", break_on_hyphens=False)


def aligned(title: str, rows: Sequence[Sequence[str]]) -> str:
    """Return a title and rows of words in columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)
    return "\n".join([title, *lines])


def times_table(own: pd.DataFrame, kind: str, order: Sequence[str]) -> str:
    rows = [["method", *(f"{error:g}" for error in own["error_asked"].unique()), "keeps"]]
    for method in order:
        if len(part := own[own["method"] == method]):
            rows.append([method, *part.apply(time_text, axis=1), kept_laws(part)])
    return aligned(f"{TITLES[kind]}: {LEGEND}", rows)


def time_text(row: pd.Series) -> str:
    beside = {"win": "cheapest", "loss": times(row["ratio"])}.get(row["verdict"], row["verdict"])
    timed = f"{duration(row['time_s'])} {beside}" if row["time_s"] == row["time_s"] else "not timed"
    return timed if row["status"] == "ok" else str(row["status"])


def settings_table(own: pd.DataFrame, order: Sequence[str]) -> str:
    """Return the settings behind the times, the errors reached and the evaluations."""
    rows, done = [["method", "error", "setting", "reached", "evaluations"]], own[own["status"] == "ok"]
    for method in order:
        for row in done[done["method"] == method].itertuples():
            reached = [scientific(row.error_reached), count(row.evaluations)]
            rows.append([method, f"{row.error_asked:g}", row.setting, *reached])
    return aligned("The setting for each error, the error reached, and evaluations", rows)


def how_to_run(frame: pd.DataFrame, scene: str) -> str:
    """Return the definition of an error and a command that repeats the fastest run at the smallest error."""
    carry, timed = ",".join(frame.attrs["carry"]), frame[frame["time_s"].notna()]
    what = f"the motion{f' and {carry}' if carry else ''} at the ends of five runs, the last to t_end"
    first = timed[timed["kind"] == timed["kind"].max()].sort_values(["error_asked", "time_s"], kind="stable")
    run = ""
    for row in first.head(1).itertuples():
        control, _, value = str(row.setting).partition("=")
        if value and control in ("step", "rtol"):
            name, _, options = (scene or str(row.scene)).partition(" ")
            given = f"{row.method} --{control} {value} --carry '{carry}' {options}".rstrip()
            run = f": contactbench solve {name} {given}"
    return f"Errors are those of {what}{run}"


# -- notes -----------------------------------------------------------------------------------------
def notes(frame: pd.DataFrame) -> Iterator[str]:
    """Yield the accuracy of the reference, how times are judged, and what was not measured and why."""
    reference = frame.attrs["reference"]
    second = reference["confirmed"]
    agreed, confirmed = "two precisions of one engine agree", f"{second} of them confirmed by a second engine"
    known = {"given": "not checked", "two solvers": "to which DOP853 and extrapolation agree"}
    checked = known.get(reference["source"], agreed if second is None else confirmed)
    yield (
        f"{'Undamped. ' * frame.attrs['undamped']}Reference: {reference['source']}, "
        f"{reference['digits']} digits, {checked}; errors below {reference['error']:.1e} are not claimed."
    )
    yield (
        f"Times are least rounds. All within {WIDEST - 1:.0%} of the least tie; where the clock differs by more from "
        "visit to visit, they are undecided."
    )
    if functions := frame.attrs["of_floats"]:
        yield (
            f"Of floats only: {', '.join(functions)}. Methods call back into Python; a cubic spline is C² only, and at "
            "its knots errors cease to fall with the order of a method."
        )
    missing = frame[(frame["reason"] != "") & ~frame["method"].isin(frame.attrs["unbegun"])]
    ended = missing["verdict"].where(missing["verdict"] == "undecided", missing["status"])
    for (status, reason), rows in missing.groupby([ended, "reason"], sort=False):
        yield f"{names(list(rows['method'].unique()))}: {'not timed' if status == 'ok' else status}: {reason}."
    if unrefined := frame.attrs["unrefined"]:
        yield f"No time was left to look for a cheaper setting of {', '.join(unrefined)}."
    ok = frame[frame["status"] == "ok"]
    unknown = [str(m) for m, rows in ok.groupby("method", sort=False) if kept_laws(rows) == "not measured"]
    if unknown:
        why = ", or a function takes no arrays" if functions else ""
        yield f"The laws of {', '.join(unknown)} are not measured: no time was left{why}."
    if frame.attrs["interrupted"]:
        yield "Interrupted: the table shows the results until then."


# -- ranking, and laws kept -------------------------------------------------------------------------
def ranked(frame: pd.DataFrame) -> list[str]:
    """Return the methods that can run the scene, best first: by number of errors reached, then by mean time ratio."""
    able = frame[frame["status"] != "unsupported"]
    ratios = np.log(able["ratio"]).groupby(able["method"], sort=False)
    table = pd.DataFrame({"missed": -ratios.count(), "mean": ratios.mean()})
    return [str(method) for method in table.sort_values(["missed", "mean"], kind="stable").index]


def laws_of(frame: pd.DataFrame) -> list[str]:
    return list(frame.columns[frame.columns.get_loc("reason") + 1 :])


def symbol(law: str) -> str:
    """Return the symbol of the quantity that a law preserves."""
    return SYMBOLS.get(law, str(LAWS[law].label).removesuffix(" drift"))


def symbols(laws: Iterable[str]) -> list[str]:
    """Return the symbols of laws, without the laws that follow from another."""
    found = [*map(symbol, laws)]
    implied = {each for symbol in found for each in IMPLIED.get(symbol, ())}
    return [symbol for symbol in found if symbol not in implied]


def kept_laws(rows: pd.DataFrame) -> str:
    """Return in words the laws that a method keeps at every measured setting, the undecided and the unmeasured ones."""
    laws, (kept, unknown) = laws_of(rows), kept_and_unknown(rows)
    hidden = {label for text in rows["laws_undecided"] for label in text.split(", ")}
    unclear = symbols(law for law in laws if symbol(law) in hidden)
    groups = {"": kept, " undecided": unclear, " not measured": unknown}
    said = "; ".join(f"{', '.join(some)}{why}" for why, some in groups.items() if some) or "none"
    if not laws or rows[laws].isna().all(axis=None):
        said = "not measured" if laws else DASH
    return said


def kept_and_unknown(rows: pd.DataFrame) -> tuple[list[str], list[str]]:
    """Return the symbols of the laws kept at every measured setting, and of the laws measured at none."""
    kept, unknown = [], []
    for law in laws_of(rows):
        known = rows.loc[rows[law].notna(), "laws_kept"]
        if len(known) and all(symbol(law) in text.split(", ") for text in known):
            kept.append(law)
        elif known.empty and LAWS[law].structural and law not in OF_THE_STATE:  # needs the derivative
            unknown.append(law)
    return symbols(kept), symbols(unknown)


# -- recommendation ---------------------------------------------------------------------------------
def recommendation(frame: pd.DataFrame) -> Iterator[str]:
    """Yield a sentence for each error: the method to take, or the reason why there is none."""
    for error, rows in frame.groupby("error_asked", sort=False):
        timed, goal = rows[rows["time_s"].notna()], exact_power(float(str(error)))
        compiled = timed[timed["kind"] == "compiled"]
        ranked = (timed if compiled.empty else compiled).sort_values("time_s", kind="stable")
        reached = rows[rows["status"] == "ok"].sort_values("evaluations", kind="stable")
        if len(ranked):
            yield f"{best(ranked, goal, frame)}."
        elif len(reached):
            first = reached.iloc[0]
            counted = first["evaluations"] > 0
            cost = f"{count(first['evaluations'])} evaluations" if counted else "evaluations not counted"
            yield f"Take {named(first)}: {cost} for {goal}, the fewest; no time was left to time it (--budget)."
        else:
            yield f"Nothing to take for {goal}: {lack(rows)}."


def named(row: pd.Series) -> str:
    return f"{row['method']}, {str(row['setting']).replace('=', ' ', 1)}"


def best(ranked: pd.DataFrame, goal: str, frame: pd.DataFrame) -> str:
    """Return the fastest and all that are about as fast, and beside them a contact method and other libraries."""

    def keeps(row: pd.Series) -> str:
        kept, unknown = kept_and_unknown(frame[frame["method"] == row["method"]])
        unclear = f" ({names(unknown)} not measured)" if unknown and row["family"] == CONTACT else ""
        return f" (keeps {names(kept)})" if kept else unclear

    def beside(rows: pd.DataFrame) -> list[str]:
        return [f"{row['method']} {times(row['ratio'])}{keeps(row)}" for _, row in rows.iterrows()]

    first, near = ranked.iloc[0], (ranked["verdict"] != Verdict.loss) & (ranked["ratio"] <= WIDEST)
    alike, slower = ranked[near].iloc[1:], ranked[~near]
    python = "" if first["kind"] == "compiled" else ", calling back into Python"
    parts = [f"Take {named(first)}: {duration(first['time_s'])} for {goal}{keeps(first)}{python}"]
    if len(alike):
        parts.append(f"within {WIDEST - 1:.0%} of it {names(beside(alike))}")
    packages = slower["method"].map(lambda name: METHODS[name].package)
    foreign = slower[(packages != "") & ~packages.duplicated()].iloc[:PEERS]
    contact = slower[(slower["family"] == CONTACT) & (CONTACT not in {*ranked[near]["family"]})].iloc[:1]
    parts += beside(pd.concat([contact, foreign]))
    if first["verdict"] == Verdict.undecided:
        parts.append(f"who is fastest is undecided: {first['reason']}")
    return "; ".join(parts)


def lack(rows: pd.DataFrame) -> str:
    """Return the reason why no method reaches an error."""
    unresolved, cut = rows[rows["status"] == "unresolved"], rows[rows["status"].isin(CUT)]
    reached = rows[rows["error_reached"].notna()].sort_values("error_reached", kind="stable")
    if len(unresolved):
        why = str(unresolved["reason"].iloc[0])
    elif reached.empty:
        why = "no time was left (--budget)" if len(cut) else "no method ran to the end"
    else:
        last, number = reached.iloc[0], len(cut)
        more = f"; {number} method{'s' * (number > 1)} cut off for want of time (--budget)" if number else ""
        why = f"the most accurate is {named(last)}, with {last['error_reached']:.1e}{more}"
    return why


# -- figure ----------------------------------------------------------------------------------------
def figure(frame: pd.DataFrame) -> Figure | None:
    """Return the figure: time against error for each kind of engine, and evaluations; None without any run."""
    timed = frame[frame["time_s"].notna()]
    timed = timed.assign(error=timed["error_reached"], cost=1e3 * timed["time_s"])
    tried = pd.DataFrame(frame.attrs["runs"], columns=["method", "setting", "status", "error", "evaluations"])
    ok = tried[(tried["status"] == "ok") & tried["evaluations"].notna()]
    ok = ok.assign(error=np.maximum(ok["error"], frame.attrs["reference"]["error"]), cost=ok["evaluations"])
    found = [(title, timed[timed["kind"] == kind], "time per solve, ms") for kind, title in TITLES.items()]
    panels = tuple(panel(*one) for one in (*found, ("Evaluations", ok, "evaluations")) if len(one[1]))
    scene = frame["scene"].iloc[0]
    return Figure(f"compare_{scene}", f"{scene}: cost against error", panels) if panels else None


def panel(title: str, rows: pd.DataFrame, name: str) -> Panel:
    curves = by_method(front(rows), "error", "cost")
    cost = contest_end(Axis(name, "log"), curves)
    return Panel(title, Axis("error", "log", True), cost, only(curves, choose(curves, cheapest)))


def front(tried: pd.DataFrame) -> pd.DataFrame:
    """Return the runs of each method that are more accurate than all its cheaper runs."""
    ordered = tried.sort_values(["cost", "error"], kind="stable")
    errors = ordered.groupby("method")["error"]
    return ordered[ordered["error"] < errors.transform(lambda own: own.cummin().shift(fill_value=np.inf))]
