"""Tables to read, numbers and their markdown; the glossary."""

import re

import pandas as pd

import contactbench as cb
from contactbench.questions.write import glossary
from contactbench.report import markdown
from contactbench.report.chapters import Fold
from contactbench.report.numbers import duration
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of
from contactbench.tables.schema import TABLES


def view(rows, labels, **more):
    return View("v", "Title", frame_of(rows, labels), "A legend.", **more)


def test_marks_are_seen_and_a_bar_does_not_break_a_table():
    cells = Cell("a|b", mark=Mark.best), Cell("c", mark=Mark.tie)
    text = markdown.parts([view([cells], ["1", "2"])])
    assert text.splitlines()[-1].split(" | ") == ["| **a\\|b**", "*c* |"]
    assert text.startswith("## Title\n\nA legend.\n\n| 1 ")
    assert "&lt;b>" in markdown.parts([view([("<b>", 1)], ["a", "b"])])


def test_numbers_are_written_by_their_column_and_words_stand_left():
    shown = view([("rk4", 1e-3, 2.0, None)], ["method", "error", "time", "reason"], show={"time": duration})
    assert [cell.text for cell in shown.rows[0]] == ["rk4", "1.0e-03", "2 s", "—"]
    assert [head.words for head in shown.columns] == [True, False, False, True]


def test_the_glossary_has_every_method_scene_and_column():
    text = markdown.parts(glossary({"methods": cb.METHODS, "scenes": cb.SCENES}))
    for name in (*cb.METHODS, *cb.SCENES):
        assert re.search(rf"^\| {re.escape(name)} ", text, re.M), name
    for name, steps in (("contact-exact", "exact"), ("cvode-adams", "adaptive"), ("rk4", "fixed")):
        (line,) = re.findall(rf"^\| {name} .*$", text, re.M)
        assert f"| {steps} " in line
    assert all(f"`{column}`" in text for each in TABLES.values() for column in each.columns)


def test_infinite_numbers_have_their_sign_and_missing_ones_are_dashes():
    assert (as_cell(float("inf")).text, as_cell(pd.NA).text) == ("∞", "—")


def test_code_stands_behind_a_line_that_opens_it():
    text = markdown.parts([Fold("How", "a = b < c")])
    assert text == "<details><summary>How</summary>\n\n```python\na = b < c\n```\n\n</details>"
