"""The tables of contests: who is cheapest where, what every error costs, where the contact methods lose."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

from contactbench.measure.statistics import FLOOR, WIDEST, Verdict
from contactbench.report.cells import DASH, Cell, Head, Mark, View, marks, word
from contactbench.report.contest import CONTACT, COUNTED, DECADES, TARGETS, Field, Kind, Lead, within
from contactbench.report.numbers import percent, power, times

#: how ties are told from what is undecided
MARGINS = (
    "Every pair of times has a margin of its own, from what the halves of its visits and two processes differ by, at "
    f"least {percent(FLOOR)}: within it they tie; where it is wider than {percent(WIDEST)} they are undecided."
)


def said(kind: Kind) -> str:
    return MARGINS if kind.timed else f"Costs within {percent(COUNTED)} of each other are a tie."


DASHES = (
    f"{DASH}: no setting tried is as accurate; budget, timeout: a finer setting was cut off by our own limit. "
    "≤: every setting tried is more accurate than asked, and this is the cheapest. °: more than half of the time is "
    "spent however short the run."
)


#: what the marks of single methods mean
CHEAPEST = "Bold: the cheapest, alone; italic: those that tie for it, or are undecided."


def error_heads(words: bool = False) -> list[Head]:
    return [Head(f"error {power(target)}", words=words) for target in TARGETS]


def leading(contest: Lead, contact: bool) -> Mark | None:
    """The mark of a camp's best."""
    if contest.outcome in (Verdict.tie, Verdict.undecided):
        return Mark.tie
    return Mark.best if contest.outcome is (Verdict.win if contact else Verdict.loss) else None


def winners_view(
    field: Field, name: str, title: str, source: str, called: Callable[[str], str] = str
) -> View:
    """Per scene and error the cheapest, those that tie with it, and the next; marked where a contact method leads.

    called : what a scene is called.
    """
    rows = []
    for scene in field.contested:
        contests = [field.leads[scene, target] for target in TARGETS]
        if not any(c.decided for c in contests):
            continue
        cells = (Cell(c.text(field.kind.show), marks=marks(leading(c, contact=True))) for c in contests)
        rows.append((word(called(scene)), *cells))
    heads = (Head("scene", words=True), *error_heads(words=True))
    meaning = (
        f"{field.kind.about} The cheapest at each error, then the next beyond a tie. "
        f"{said(field.kind)} Bold: the cheapest, alone, or contact methods that tie among themselves; italic: a "
        f"contact method and another tie, or are undecided. {DASHES}"
    )
    return View(name, title, meaning, heads, tuple(rows), source)


def costs_view(field: Field, scene: str, source: str) -> View:
    """What each error costs each method on a scene; the cheapest in bold, ties marked."""
    contests = {target: field.leads[scene, target] for target in TARGETS}
    rows = []
    for method in field.methods:
        cells = []
        for contest in contests.values():
            own = contest.costs.get(method) or contest.missing.get(method)
            if own is None:
                break
            first = (Mark.best if len(contest.first) == 1 else Mark.tie) if method in contest.first else None
            value = own.value if own.reached else None
            cells.append(
                Cell(own.text(field.kind.show), value, marks(first, Mark.bound if own.bound else None))
            )
        else:
            rows.append((word(method), *cells))
    meaning = f"{field.kind.about} {said(field.kind)} {CHEAPEST} {DASHES}"
    title = f"{field.kind.title} on {scene}"
    heads = (Head("method", words=True), *error_heads())
    return View(f"{field.kind.name}_{scene}", title, meaning, heads, tuple(rows), source)


def duel_view(field: Field, scene: str, source: str, targets: Iterable[float] = DECADES) -> View:
    """Decade by decade the best contact method beside the best other."""
    rows = []
    for target in targets:
        contest = field.leads[scene, target]
        cells = []
        for contact in (True, False):
            best = contest.best(contact)
            if best is None:
                camp = (
                    c.reason for m, c in contest.missing.items() if (contest.family[m] == CONTACT) == contact
                )
                cells.append(word(", ".join(sorted(set(camp) - {DASH})) or DASH))
            else:
                text = f"{best} {contest.costs[best].text(field.kind.show)}"
                cells.append(Cell(text, marks=marks(leading(contest, contact))))
        finite = math.isfinite(contest.ratio) and contest.ratio > 0
        ratio = Cell(times(contest.ratio), contest.ratio) if finite else Cell(DASH)
        rows.append((word(power(target)), *cells, ratio, word(cheaper(contest))))
    heads = (
        Head("error", words=True), Head("best contact method", words=True), Head("best other method", words=True),
        Head("other / contact", "cost of the best other method in units of the best contact method"),
        Head("cheaper", words=True),
    )  # fmt: skip
    title = f"{field.kind.title} on {scene}: the best contact method and the best other"
    marked = "Bold: the cheaper of the two; italic: they tie or are undecided."
    meaning = f"{field.kind.about} {said(field.kind)} {marked} {DASHES}"
    return View(f"duel_{field.kind.name}_{scene}", title, meaning, heads, tuple(rows), source)


def cheaper(contest: Lead) -> str:
    """contact, other, or tie and undecided with their margin."""
    ours, theirs = contest.best(True), contest.best(False)
    if contest.outcome in (Verdict.tie, Verdict.undecided) and ours and theirs:
        return within(contest.outcome, contest.margin(ours, theirs))
    return DASH if contest.outcome is None else CONTACT if contest.outcome is Verdict.win else "other"


def losses_view(fields: Iterable[Field], name: str, source: str) -> View:
    """Every scene and error at which another method is cheaper than every contact method, kind by kind."""
    rows = []
    for field in fields:
        for scene in field.contested:
            cells = []
            for target in TARGETS:
                contest = field.leads[scene, target]
                if contest.outcome is not Verdict.loss:
                    cells.append(Cell(""))
                    continue
                other, alone = str(contest.best(contact=False)), contest.ratio == 0
                text = f"{other}, alone" if alone else f"{other} {times(1 / contest.ratio)}"
                cells.append(Cell(text, None if alone else 1 / contest.ratio))
            if any(cell.text for cell in cells):
                rows.append((word(field.kind.title), word(scene), *cells))
    heads = (Head("compared", words=True), Head("scene", words=True), *error_heads())
    meaning = (
        "What the best contact method costs in units of the cheapest other method. Blank: a contact method is "
        "cheapest, or it is a tie or undecided, or no method reaches the error. Alone: no contact method reaches it."
    )
    return View(name, "Where the contact methods lose", meaning, heads, tuple(rows), source)
