"""Figures: which methods they show, where axes end, where names stand, and what a file holds."""

import re
from itertools import combinations, product

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
from matplotlib.text import Text

import contactbench as cb
from contactbench import METHODS
from contactbench.questions import cost, laws, orders, paper
from contactbench.questions.write import glossary
from contactbench.report import draw, markdown
from contactbench.report.chapters import Fold
from contactbench.report.curves import MOST, cheapest, choose, only
from contactbench.report.drawing import Axis, Curve, Figure, Panel
from contactbench.report.look import CONTESTANTS, LOOKS, look
from contactbench.report.numbers import duration
from contactbench.report.views import Cell, Mark, View, as_cell, frame_of
from contactbench.tables.schema import TABLES
from frames import frames, row, table, timed

ERRORS = tuple(10.0**-k for k in range(1, 12))


def curve(method, cost, power=-0.2):
    return Curve(ERRORS, tuple(cost * e**power for e in ERRORS), method, method)


# -- what is shown ---------------------------------------------------------------------------------
CONTESTED = {
    "rkn12": 1.0,
    "contact-rkn6": 2.0,
    "contact-rkn8": 3.0,
    "contact-strang": 70.0,
    "rk4": 60.0,
    "scipy-dop853": 9.0,
    "cyrk-dop853": 8.0,
    "scipy-radau": 40.0,
    "cvode-bdf": 50.0,
    "cvode-adams": 30.0,
    "diffrax-dopri8": 20.0,
    "heyoka-taylor": 4.0,
    "herglotz2": 90.0,
}


def test_the_best_and_the_contestants_of_the_mission_are_shown_and_nothing_else():
    curves = [curve(*item) for item in CONTESTED.items()]
    first = ["rkn12", "contact-rkn6", "contact-strang", "rk4", "cyrk-dop853", "scipy-radau", "cvode-adams"]
    chosen = choose(curves, cheapest)
    assert chosen == [*first, "diffrax-dopri8"]
    assert [c.method for c in only(curves, chosen)] == chosen


def test_the_subjects_of_a_figure_are_shown_and_free_places_go_to_other_families_if_it_has_few_contestants():
    curves = [
        curve(*item) for item in CONTESTED.items() if not item[0].startswith(("cvode", "scipy", "cyrk"))
    ]
    chosen = choose(curves, cheapest, ["herglotz2", "contact-rkn8"], by_order=True)
    assert chosen[:4] == ["herglotz2", "contact-rkn8", "contact-strang", "rk4"]
    assert set(chosen[4:]) == {"diffrax-dopri8", "rkn12", "contact-rkn6", "heyoka-taylor"}


@pytest.mark.parametrize("contestants", CONTESTANTS, ids=lambda names: names[0])
def test_every_contestant_is_named_on_a_planted_scene(contestants):
    for panel in FIGURES["cost"]().panels:
        assert {c.label for c in panel.curves} & set(contestants)


# -- figures of planted tables ---------------------------------------------------------------------
STEPS = (0.4, 0.2, 0.1, 0.05, 0.025)
OURS = ("contact", "rk4", "herg")
ALL = {name: own.order for name, own in LOOKS.items()}
ORDERS = {name: order for name, order in ALL.items() if order and name.startswith(OURS)}


def worked(name, k, order, step):
    error = min(1.0, 0.1 * step ** (order or 9))
    return row("particle", name, step, error=error, evaluations=round((10 + k) / step), saved=1)


def converged(name, k, order, step):
    error = max(1e-17, (0.3 + 0.01 * len(name)) * step**order)
    fit = {"step": step, "error": error, "order": order, "order_nominal": order, "status": "ok"}
    return {"scene": "particle", "method": name} | fit


def deviated(name, k, order, step):
    keeps = LOOKS[name].family == "contact"
    claims = dict.fromkeys(("contact_drift_claimed", "contact_drift_kept"), keeps)
    drift = 1e-15 if keeps else step**4
    return row("central", name, step, error=step**4, contact_drift=drift, **claims)


def planted(made, methods):
    """A row for each method and step."""
    return [made(one, k, methods[one], step) for (k, one), step in product(enumerate(methods), STEPS)]


def costed():
    runs = planted(worked, ALL)
    return frames(runs=runs, times=timed(runs, (9e-8 * run["evaluations"] for run in runs)))


FIGURES = {
    "cost": lambda: cost.figure(costed(), "particle"),
    "orders": lambda: orders.figure(table("orders", planted(converged, ORDERS))),
    "structure": lambda: laws.structure(table("runs", planted(deviated, ALL))),
}


@pytest.fixture(scope="module", params=FIGURES)
def real(request):
    """A figure of planted tables, and as matplotlib draws it."""
    figure = FIGURES[request.param]()
    made = draw.render(figure)
    made.canvas.draw()
    yield figure, made
    plt.close(made)


def test_curves_of_the_paper_are_in_the_order_of_the_table():
    points = [("b", 1), ("b", 0), ("a", 0), ("a", 1)]
    rows = [{"panel": "p", "kind": "law", "curve": c, "point": n, "x": float(n), "y": 1.0} for c, n in points]
    made = [(curve.label, list(curve.x)) for curve in paper.curves(pd.DataFrame(rows), "p")]
    assert made == [("b", [0.0, 1.0]), ("a", [0.0, 1.0])]


def test_words_stay_on_the_canvas_and_names_off_the_curves(real):
    _, made = real
    renderer = made.canvas.get_renderer()
    for axes in made.axes:
        names = [t for t in axes.texts if t.get_gid() == "name"]
        for one, other in combinations([Text.get_window_extent(t, renderer) for t in names], 2):
            assert not one.overlaps(other)
        right = axes.get_window_extent(renderer).x1
        assert all(axes.transAxes.transform(name.xyann)[0] > right for name in names)
        for text in (axes.xaxis.label, axes.yaxis.label, axes._left_title, *names):
            box = Text.get_window_extent(text, renderer)  # without the line to the curve
            inside = [made.bbox.padded(1).contains(*corner) for corner in (box.min, box.max)]
            assert all(inside), text.get_text()


def test_every_curve_is_there_and_every_name_once(real):
    figure, made = real
    for panel, axes in zip(figure.panels, made.axes, strict=True):
        assert len(axes.lines) == len(panel.curves)
    written = [t.get_text() for axes in made.axes for t in axes.texts if t.get_gid() == "name"]
    written += [t.get_text() for legend in made.legends for t in legend.get_texts()]
    wanted = {c.label for panel in figure.panels for c in panel.curves if c.label}
    assert sorted(written) == sorted(wanted)
    assert len({c.method for panel in figure.panels for c in panel.curves if c.line}) <= MOST + 1  # guides


def test_the_figure_of_orders_has_a_guide_of_every_order():
    (panel,) = FIGURES["orders"]().panels
    guides = [c for c in panel.curves if c.role == "guide"]
    slopes = [np.diff(np.log(guide.y)) / np.diff(np.log(guide.x)) for guide in guides]
    orders = sorted({ORDERS[c.method] for c in panel.curves if c.method})
    assert [slope.mean() for slope in slopes] == pytest.approx(orders)


@pytest.mark.parametrize("ratio", [0.2, 1.2, 5.0])
def test_a_title_names_first_who_is_cheaper_and_both_are_named(ratio):
    scales = {"contact-rkn4": ratio, "rk4": 1.0}
    runs = [row("particle", name, h, error=h**4, saved=1) for name in scales for h in (0.2, 0.02, 0.002)]
    times = timed(runs, (scales[run["method"]] / run["setting"] for run in runs))
    title, named = cost.message(frames(runs=runs, times=times), "particle")
    assert named == sorted(scales, reverse=ratio == 5.0)
    assert ("needs 20 % of the time" if ratio != 1.2 else "the same time within 25 %") in title


# -- files -----------------------------------------------------------------------------------------
def test_a_file_has_no_dates_no_chance_and_no_idle_digits():
    panel = Panel("p", Axis("error"), Axis("time"), (curve("rk4", 1.0),))
    figure = Figure("f", "off by 0.00024", (panel,))
    text = draw.svg(figure)
    assert text == draw.svg(figure)
    assert "0.00024" in text  # words are as they were
    assert not re.search(r"<[^>]*\d\.\d{3}", text)


def test_nobody_shares_a_look():
    own = [(item.family, item.marker) for item in LOOKS.values()]
    assert len(set(own)) == len(own)
    assert all(own.order == METHODS[method].order for method, own in LOOKS.items())


@pytest.mark.usefixtures("registries")
@pytest.mark.parametrize(("family", "shown"), [("contact", "contact"), ("", "other"), ("mine", "other")])
def test_a_method_of_ones_own_has_the_dash_of_its_order_and_a_marker_free_in_its_family(family, shown):
    taken = {own.marker for own in LOOKS.values() if own.family == shown}
    for k in range(20):
        cb.fixed_step(f"own{k}", 4, family="contact")(lambda scene, x, h, xp: x)
        own = look(f"own{k}", family)
        assert (own.family, own.order) == (shown, 4)
        assert own.marker not in taken
    assert look("nowhere").order is None


# -- tables to read, numbers and their markdown; the glossary ----------------------------------------
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
