"""Every chapter from its own table alone; summaries count rows, and a row that contradicts one changes it."""

import re
from pathlib import Path

import pytest

from contactbench.report import markdown
from contactbench.report.chapters import chapters, discovered, every
from contactbench.report.drawing import Figure
from contactbench.report.views import View
from contactbench.tables.schema import TABLES
from contactbench.tables.store import read
from frames import frames, row


def document(name, tables):
    chapter = discovered()[name]
    return markdown.document(chapter.title, chapter.answers(tables), chapter.fill(tables))


RESULTS = Path(__file__).parents[2] / "results"


def judged(scene, method, value, claimed=True, drift=1e-15):
    """A run with J and the contact form judged."""
    columns = {"": drift, "_claimed": claimed, "_kept": drift <= 1e-12, "_undecided": False, "_bound": 1e-12}
    laws = {law + name: each for law in ("momentum_law", "contact_drift") for name, each in columns.items()}
    return row(scene, method, value, solution_error=1e-3, energy_law=1e-4, **laws)


def order(method, measured, claimed):
    return row("particle", method, 0.1, solution_error=1e-3, order=measured, order_nominal=claimed, step=0.1)


COST = {"time_median_s": 1e-3, "time_min_s": 1e-3, "rhs_equivalents": 100.0}
CREEP = {"experiment": "overdamped", "t_end": 100.0, "damping_per_step": 5.0, "ratio": 1.0}
LIMIT = {"method": "rk4", "family": "established", "gamma": 0.0, "omega": 1.0, "limit": 2.8, "windows": ""}
RING = {"gamma": 1e-5, "t_end": 1e4, "n": 16, "energy_error": 1e-3, "evaluations_per_time": 8.0}
RING |= {"time_min_s": 2e-6, "timed_evaluations": 100}
RUN = {"seed": 1, "error": 1e-6, "status": "ok"}
CLAIM = {"id": "C01", "where": "§2", "claim": "so", "verdict": "holds", "status": "ok", "measured": 1.0}
SOME = {
    "work_precision": [
        row("particle", m, e, solution_error=e, **COST) for m in ("contact-a", "rk4") for e in (1e-2, 1e-5)
    ],
    "laws": [judged("central", "contact-a", 0.1)],
    "decay_laws": [row("rigid_body", "rk4", 0.1, cost=30.0, rhs_equivalents=800.0, contact_drift=1e-9)],
    "convergence": [order("contact-a", 2.0, 2)],
    "stability": [row("large_step", "rk4", 0.1, solution_error=1e-3, rhs_equivalents=10.0)],
    "stability_limits": [LIMIT],
    "damping_rates": [row("overdamped", "rk4", 0.1, evaluations=10, rate_error=1e-3, **CREEP)],
    "structure_buys": [row("chaotic_ring", m, 0.1, **RING) for m in ("contact-a", "rk4")],
    "population": [RUN | {"scene": "a-0", "method": "rk4", "evaluations": 10.0}],
    "claims": [CLAIM],
}


@pytest.mark.parametrize("name", discovered())
def test_a_chapter_speaks_from_its_own_table_alone_and_is_silent_without(name):
    chapter = discovered()[name]
    assert chapter not in chapters(frames())
    first = chapter.tables[0]
    alone = frames(**{first: SOME.get(first, ())})
    if first not in SOME:  # of a new chapter, the committed rows
        alone[first] = read(TABLES[first], RESULTS)
    assert chapter in chapters(alone), f"no rows: run contactbench bench --all -k {first}"
    text = document(name, alone)
    assert text.startswith(f"# {chapter.title}\n")
    assert not re.search(r"\bnan\b", text)


def test_names_of_views_are_unique_and_a_figure_shown_twice_is_the_same():
    everything = frames(**SOME)
    found = [part for chapter in chapters(everything) for part in chapter.fill(everything)]
    views = [view.name for view in every(View, found)]
    assert len(views) == len(set(views)), sorted(v for v in views if views.count(v) > 1)
    drawn = {}
    for figure in every(Figure, found):
        assert repr(drawn.setdefault(figure.name, figure).panels) == repr(figure.panels)  # nan is nan


def test_every_table_but_that_of_definitions_is_read_by_a_chapter():
    shown = {name for chapter in discovered().values() for name in chapter.tables}
    assert shown == {*TABLES} - {"definitions"}


# -- a contradicting row changes the answer --------------------------------------------------------
RIGHT = row("large_step", "contact-a", 0.1, solution_error=1e-3)
ESCAPED = row("escape", "rk4", 0.1, status="diverged", blow_up_time=1.5)
STAYED = ESCAPED | {"method": "contact-a", "status": "ok", "solution_error": 1.0}
BROKEN = judged("needle", "contact-b", 0.4, drift=2e-4)
#: chapter → its table's rows, a row that contradicts them, and how the counts without and with it begin
CONTRADICTIONS = {
    "laws": ([judged("central", "contact-a", h) for h in (0.1, 0.2)], BROKEN, ("2 of 2", "2 of 3")),
    "convergence": ([order("contact-a", 2.0, 2)], order("rk4", 3.5, 4), ("1 of 1", "1 of 2")),
    "stability": ([RIGHT, ESCAPED], STAYED, ("2 of 2", "2 of 3")),
    "claims": ([CLAIM], CLAIM | {"id": "C02", "verdict": "refuted"}, ("1 hold", "1 hold")),
}


@pytest.mark.parametrize("name", CONTRADICTIONS)
def test_a_contradicting_row_changes_answer_and_count(name):
    rows, contradiction, counts = CONTRADICTIONS[name]
    tables = (frames(**{name: each}) for each in (rows, [*rows, contradiction]))
    before, after = (next(iter(discovered()[name].answers(each))) for each in tables)
    assert before.answer == "always" != after.answer
    assert before.count != after.count
    assert (before.count.startswith(counts[0]), after.count.startswith(counts[1])) == (True, True)


def test_runs_that_do_not_claim_a_law_or_are_not_judged_are_counted_apart():
    lost = judged("central", "contact-b", 0.9) | dict.fromkeys(["momentum_law_bound", "momentum_law_kept"])
    rows = [judged("central", "contact-a", 0.1), lost]
    rows.append(judged("drag", "contact-a", 0.1, claimed=False, drift=1e-3))
    table = discovered()["laws"].parts(frames(laws=rows))[0]
    assert [cell.text for cell in table.rows[0]] == ["J law", "1 of 1 runs (1 not judged)", "0 of 1 runs"]


def test_a_broken_law_is_a_row_with_what_breaks_it():
    rows = [judged("central", "contact-a", 0.1), BROKEN]
    broken = next(p for p in discovered()["laws"].parts(frames(laws=rows)) if p.name == "law_exceptions")
    assert [cell.text for cell in broken.rows[0][:4]] == ["J law", "`needle`", "contact-b", "1"]
    assert broken.rows[0][-1].text == "contact-b, step=0.4"


@pytest.mark.parametrize(
    ("costs", "named"), [((1, 1, 4), "rk4 ×1.00, ×1.80"), ((4, 4, 4), "rk8 ×1.00, ×1.00")]
)
def test_a_kind_of_problem_names_the_method_of_least_mean_regret(costs, named):
    known = {"structure": "kepler", "hard": "", "damping": 0.01, "seed": 1}
    problems = [{"scene": f"kepler-{i}", **known} for i in range(3)]
    rows = [
        RUN | {"scene": f"kepler-{i}", "method": name, "family": "established", "evaluations": float(cost)}
        for name, each in (("rk4", costs), ("rk8", (2, 2, 2)))
        for i, cost in enumerate(each)
    ]
    text = document("which", frames(population=rows, population_problems=problems))
    line = next(line for line in text.splitlines() if "1/r², 10⁻⁶" in line)
    assert [cell.strip() for cell in line.split("|")[2:5]] == ["3", named, "—"]
