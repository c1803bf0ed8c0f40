"""Views, numbers and their markdown."""

from __future__ import annotations

import re

import pandas as pd
import pytest

import contactbench as cb
from contactbench.report import glossary, markdown
from contactbench.report.numbers import count, duration, names, power, times
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of, matrix
from contactbench.results.schema import TABLES


def view(rows, labels, **more):
    return View("v", "Title", frame_of(rows, labels), "A legend.", **more)


def test_marks_are_seen_and_a_bar_does_not_break_a_table():
    cells = Cell("a|b", mark=Mark.best), Cell("c", mark=Mark.tie), Cell("f", link="x.md")
    text = markdown.parts([view([cells], ["1", "2", "3"])])
    assert text.splitlines()[-1].split(" | ") == ["| **a\\|b**", "*c*", "[f](x.md) |"]
    assert text.startswith("## Title\n\nA legend.\n\n| 1 ")
    assert "&lt;b>" in markdown.parts([view([("<b>", 1)], ["a", "b"])])


def test_numbers_are_written_by_their_column_and_words_stand_left():
    shown = view([("rk4", 1e-3, 2.0, None)], ["method", "error", "time", "reason"], show={"time": duration})
    assert [cell.text for cell in shown.rows[0]] == ["rk4", "1.0e-03", "2 s", "—"]
    assert [head.words for head in shown.columns] == [True, False, False, True]


def test_a_matrix_has_a_line_for_each_value_and_a_dash_where_there_is_nothing():
    rows = pd.DataFrame({"m": ["a", "a", "b"], "s": ["x", "y", "y"], "v": [1.0, 2.0, 3.0]})
    frame = matrix(rows, "m", "s", lambda part: part["v"].sum(), "at {}".format)
    assert frame.to_dict("list") == {"m": ["a", "b"], "at x": [1.0, "—"], "at y": [2.0, 3.0]}


def test_the_glossary_has_every_method_scene_and_column():
    text = markdown.parts(glossary.glossary({"methods": cb.METHODS, "scenes": cb.SCENES}))
    for name in (*cb.METHODS, *cb.SCENES):
        assert re.search(rf"^\| {re.escape(name)} ", text, re.M), name
    for name, steps in (("contact-exact", "exact"), ("contact-adaptive", "adaptive"), ("rk4", "fixed")):
        (line,) = re.findall(rf"^\| {name} .*$", text, re.M)
        assert f"| {steps} " in line
    for table in TABLES.values():
        assert all(f"`{column}`" in text for column in table.columns)


@pytest.mark.parametrize(
    ("write", "value", "text"),
    [
        (duration, 2.0, "2 s"),
        (duration, 9.9999e-7, "1 µs"),
        (duration, float("nan"), "—"),
        (times, 1.254, "×1.25"),
        (times, 3123.0, "×3100"),
        (count, 26104.4, "26\u202f104"),
        (power, 1e-12, "10⁻¹²"),
        (names, ["a", "b", "c"], "a, b and c"),
    ],
)
def test_numbers_and_lists_are_readable(write, value, text):
    assert write(value) == text


def test_infinite_numbers_sort_beyond_all_others_and_missing_ones_are_dashes():
    assert as_cell(float("inf")).text == "∞"
    assert as_cell(float("inf")).value > as_cell(1e300).value
    assert as_cell(pd.NA).text == "—"
