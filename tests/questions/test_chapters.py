"""Every chapter from its own tables alone; answers count rows by the lines that they print, and a row changes them."""

import re
from functools import cache
from pathlib import Path

import pandas as pd
import pytest

import contactbench as cb
from contactbench.questions.answers import evaluate, fold
from contactbench.report import markdown
from contactbench.report.chapters import Fold, chapters, discovered, every
from contactbench.report.drawing import Figure
from contactbench.report.views import View
from contactbench.tables.schema import TABLES
from contactbench.tables.store import read
from frames import frames, row, timed

RESULTS = Path(__file__).parents[2] / "results"


def document(name, tables):
    return written(name, [*discovered()[name].answers(tables)], discovered()[name].fill(tables))


def written(name, answers, parts):
    return markdown.document(discovered()[name].title, answers, parts)


def judged(scene, method, setting, claimed=True, drift=1e-15, **more):
    """A run with J and the contact form judged."""
    laws = {}
    for law in ("momentum_law", "contact_drift"):
        laws |= {law: drift, f"{law}_claimed": claimed, f"{law}_kept": drift <= 1e-12}
    known = {"error": 1e-3, "energy_law": 1e-4, "bound": 1e-12, "evaluations": 50 / setting}
    return row(scene, method, setting, **known | laws | more)


def order(method, measured, claimed):
    known = {"scene": "particle", "method": method, "step": 0.1, "status": "ok"}
    return known | {"error": 1e-3, "order": measured, "order_nominal": claimed}


END = [
    row("particle", m, e, error=e, saved=1, evaluations=-100 * e + 200)
    for m in ("contact-a", "rk4")
    for e in (1e-2, 1e-5)
]
LIMIT = {"question": "stability", "scene": "oscillator", "method": "rk4", "gamma": 1.0, "status": "ok"}
LIMIT |= {"measured": 2.8, "evaluations": 4.0}
RING = {"scene": "chaotic_ring", "control": "step", "gamma": 1e-5, "status": "ok", "floor": 1e-5}
DRAWN = {"structure": "kepler", "hard": "", "damping": 0.01, "seed": 1}
HARD = {"seed": 1, "scene": "b-0", "hard": "wall"}
RUN = {"seed": 1, "error": 1e-6, "status": "ok"}
SOME = {
    "runs": [
        *END,
        *(judged(s, m, h) for s in ("central", "particle") for m in ("contact-a", "rk4") for h in (0.1, 0.2)),
        row("large_step", "rk4", 0.1, error=1e-3, evaluations=10.0),
        row("large_step", "contact-a", 0.1, error=1e-3, evaluations=20.0),
    ],
    "times": timed(END, (2e-6, 9e-6, 1e-6, 5e-6)),
    "orders": [order("contact-a", 2.0, 2)],
    "limits": [LIMIT, {**LIMIT, "question": "creep", "setting": 0.1, "error": 1e-3, "t_end": 100.0}],
    "ring": [
        RING | {"method": m, "setting": s, "t_end": 1e4, "energy_error": s, "evaluations": 1 / s}
        for m in ("contact-a", "rk4")
        for s in (0.1, 0.001)
    ],
    "problems": [DRAWN | {"scene": "a-0"}, HARD],
    "population": [
        RUN | {"scene": "a-0", "method": m, "evaluations": n, "time_s": 1e-6 * n}
        for m, n in (("rk4", 10.0), ("contact-a", 11.0))
    ]
    + [RUN | {"scene": "b-0", "method": "rk4", "reached": 1e-4, "evaluations": 9.0}],
    "claims": [{"id": "C01", "verdict": "holds", "status": "ok", "measured": 1.0}],
}


@cache
def some():
    return frames(**SOME)


@cache
def answered(name):
    """What a chapter answers where all tables have rows."""
    return [*discovered()[name].answers(some())]


@cache
def filled(name):
    """What it shows there."""
    return [*discovered()[name].fill(some())]


@pytest.mark.parametrize("name", discovered())
def test_a_chapter_speaks_from_its_own_tables_alone_and_is_silent_without(name):
    chapter = discovered()[name]
    assert chapter not in chapters(frames())
    alone = frames(**{table: SOME.get(table, ()) for table in chapter.tables})
    first = chapter.tables[0]
    if first not in SOME:  # of a new chapter, the committed rows
        alone[first] = read(TABLES[first], RESULTS)
    assert chapter in chapters(alone), f"no rows: run contactbench bench --all -k {first}"
    text = document(name, alone)
    assert text.startswith(f"# {chapter.title}\n")
    assert not re.search(r"\bnan\b", text)


@pytest.mark.parametrize("name", discovered())
def test_a_chapter_speaks_where_all_tables_have_rows(name):
    text = written(name, answered(name), filled(name))
    assert re.search(r"^\|", text, re.M)
    assert not re.search(r"\bnan\b", text)


def test_names_of_views_are_unique_and_a_figure_shown_twice_is_the_same():
    found = [
        part for name, chapter in discovered().items() if chapter in chapters(some()) for part in filled(name)
    ]
    views = [view.name for view in every(View, found)]
    assert len(views) == len(set(views)), sorted(v for v in views if views.count(v) > 1)
    drawn = {}
    for figure in every(Figure, found):
        assert repr(drawn.setdefault(figure.name, figure).panels) == repr(figure.panels)  # nan is nan


def test_every_table_is_read_by_a_chapter():
    assert {name for chapter in discovered().values() for name in chapter.tables} == {*TABLES}


# -- every count is a line of pandas over the tables ------------------------------------------------
@pytest.mark.parametrize("name", discovered())
def test_the_lines_that_a_document_prints_give_its_counts(name, monkeypatch):
    answers = answered(name)
    if not answers:
        pytest.skip("asks nothing that is counted")
    monkeypatch.setattr(cb, "results", some().__getitem__)
    first, *blocks = fold(answers).code.split("\n\n")
    known = {}
    exec(first, known)
    for answer, block in zip(answers, blocks, strict=True):
        title, *lines = block.splitlines()
        assert title == f"# {answer.question} {answer.count}".replace("`", "")
        for line in lines:
            found = eval(line, known)
            assert isinstance(found, pd.Series)
            if found.dtype in (bool, "boolean"):
                assert re.search(rf"\b{int(found.sum())}\b", answer.count), line
                assert line not in lines[:1] or f"{int(found.sum())} of {len(found)}" in answer.count
            else:
                assert len(found) or not lines


@pytest.mark.parametrize("name", discovered())
def test_the_lines_under_a_table_run(name, monkeypatch):
    monkeypatch.setattr(cb, "results", some().__getitem__)
    for lines in every(Fold, filled(name)):
        exec(lines.code, {})


def test_the_line_under_saved_times_finds_the_methods_of_its_table():
    methods, errors = ("contact-a", "rk4"), (1e-2, 1e-7)
    runs = [row("particle", m, e, error=e, saved=1, evaluations=9) for m in methods for e in errors]
    tables = frames(**SOME | {"runs": runs, "times": timed(runs, (2e-6, 9e-6, 1e-6, 5e-6))})
    view, lines, *_ = discovered()["which"].fill(tables)
    found = [
        evaluate(line, tables)["particle"] for line in lines.code.splitlines() if line.startswith("rank")
    ]
    assert found[0] == ["rk4"]
    ((scene, *cells),) = view.rows
    assert (scene.text, *(cell.text.split()[0] for cell in cells)) == ("particle", *(one[0] for one in found))


# -- a contradicting row changes the answer --------------------------------------------------------
RIGHT = row("large_step", "contact-a", 0.1, error=1e-3)
ESCAPED = row("escape", "rk4", 0.1, status="diverged", truth="diverged")
STAYED = ESCAPED | {"method": "contact-a", "status": "ok", "error": 1.0}
BROKEN = judged("needle", "contact-b", 0.4, drift=2e-4)
CLAIM = SOME["claims"][0]
#: chapter → its table and rows, a row that contradicts them, and how the counts without and with it begin
CONTRADICTIONS = {
    "laws": ("runs", [judged("central", "contact-a", h) for h in (0.1, 0.2)], BROKEN, ("2 of 2", "2 of 3")),
    "orders": ("orders", [order("contact-a", 2.0, 2)], order("rk4", 3.5, 4), ("1 of 1", "1 of 2")),
    "hard": ("runs", [RIGHT, ESCAPED], STAYED, ("2 of 2", "2 of 3")),
    "claims": ("claims", [CLAIM], CLAIM | {"id": "C02", "verdict": "refuted"}, ("1 hold", "1 hold")),
}


@pytest.mark.parametrize("name", CONTRADICTIONS)
def test_a_contradicting_row_changes_answer_and_count(name):
    table, rows, contradiction, counts = CONTRADICTIONS[name]
    tables = (frames(**{table: each}) for each in (rows, [*rows, contradiction]))
    before, after = (next(iter(discovered()[name].answers(each))) for each in tables)
    assert before.answer == "always" != after.answer
    assert before.count != after.count
    assert (before.count.startswith(counts[0]), after.count.startswith(counts[1])) == (True, True)


def part(name, tables, chapter="laws"):
    return next(each for each in every(View, discovered()[chapter].fill(tables)) if each.name == name)


def test_runs_that_do_not_claim_a_law_or_are_not_judged_are_counted_apart():
    lost = judged("central", "contact-b", 0.9, momentum_law_kept=None, error=0.5)
    rows = [judged("central", "contact-a", 0.1), lost, judged("drag", "contact-a", 0.1, False, 1e-3)]
    found = {
        line[0].text: [cell.text for cell in line[1:]] for line in part("law_claims", frames(runs=rows)).rows
    }
    assert found["J law"] == ["1 of 1 (1 not judged)", "0 of 1"]


def test_a_broken_law_is_a_row_with_what_breaks_it():
    broken = part("law_exceptions", frames(runs=[judged("central", "contact-a", 0.1), BROKEN]))
    assert [cell.text for cell in broken.rows[0][:4]] == ["J law", "`needle`", "contact-b", "1"]
    assert broken.rows[0][-1].text == "contact-b, step=0.4"


@pytest.mark.parametrize(
    ("costs", "named"), [((1, 1, 4), "rk4 ×1.00, ×1.80"), ((4, 4, 4), "rk8 ×1.00, ×1.00")]
)
def test_a_kind_of_problem_names_the_method_of_least_mean_regret(costs, named):
    problems = [DRAWN | {"scene": f"kepler-{i}"} for i in range(3)]
    rows = [
        RUN | {"scene": f"kepler-{i}", "method": name, "evaluations": float(cost)}
        for name, each in (("rk4", costs), ("rk8", (2, 2, 2)))
        for i, cost in enumerate(each)
    ]
    text = document("which", frames(population=rows, problems=problems))
    line = next(line for line in text.splitlines() if "1/r², 10⁻⁶" in line)
    assert [cell.strip() for cell in line.split("|")[2:5]] == ["3", named, "—"]
