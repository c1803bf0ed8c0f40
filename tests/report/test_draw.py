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
from contactbench.questions import convergence, laws, paper, work_precision
from contactbench.report import draw
from contactbench.report.chapters import Tables
from contactbench.report.curves import MOST, cheapest, choose, only
from contactbench.report.drawing import Axis, Curve, Figure, Panel
from contactbench.report.look import CONTESTANTS, LOOKS, look
from frames import frames, row, table

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


def test_the_subjects_of_a_figure_are_shown_and_free_places_go_to_other_families():
    curves = [
        curve(*item) for item in CONTESTED.items() if not item[0].startswith(("cvode", "scipy", "cyrk"))
    ]
    chosen = choose(curves, cheapest, subjects=["herglotz2", "contact-rkn8"])
    assert chosen[:4] == ["herglotz2", "contact-rkn8", "contact-strang", "rk4"]
    assert set(chosen[4:]) == {"diffrax-dopri8", "rkn12", "contact-rkn6", "heyoka-taylor"}


@pytest.mark.parametrize("contestants", CONTESTANTS, ids=lambda names: names[0])
def test_every_contestant_is_named_on_a_planted_scene(contestants):
    for panel in FIGURES["work_precision"]().panels:
        assert {c.label for c in panel.curves} & set(contestants)


# -- figures of planted tables ---------------------------------------------------------------------
STEPS = (0.4, 0.2, 0.1, 0.05, 0.025)
OURS = ("contact", "rk4", "herg")
ALL = {name: own.order for name, own in LOOKS.items()}
ORDERS = {name: order for name, order in ALL.items() if order and name.startswith(OURS)}


def worked(name, k, order, step):
    spent = round((10 + k) / step)
    cost = {"rhs_equivalents": spent, "time_median_s": 1e-7 * spent, "time_min_s": 9e-8 * spent}
    return row(
        "particle", name, step, solution_error=min(1.0, 0.1 * step ** (order or 9)), engine="llvm", **cost
    )


def converged(name, k, order, step):
    error = max(1e-17, (0.3 + 0.01 * len(name)) * step**order)
    return row("particle", name, step, step=step, solution_error=error, order=order, order_nominal=order)


def deviated(name, k, order, step):
    keeps = LOOKS[name].family == "contact"
    claims = dict.fromkeys(("contact_drift_claimed", "contact_drift_kept"), keeps)
    drift = 1e-15 if keeps else step**4
    return row("central", name, step, solution_error=step**4, contact_drift=drift, **claims)


def planted(name, made, orders):
    """A table of a row for each method and step."""
    return table(
        name, [made(one, k, orders[one], step) for (k, one), step in product(enumerate(orders), STEPS)]
    )


FIGURES = {
    "work_precision": lambda: work_precision.figure(
        Tables(frames(), work_precision=planted("work_precision", worked, ALL)), "particle"
    ),
    "convergence": lambda: convergence.figure(planted("convergence", converged, ORDERS)),
    "structure": lambda: laws.structure(planted("laws", deviated, ALL)),
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


def test_the_convergence_plot_has_a_guide_of_every_order():
    (panel,) = FIGURES["convergence"]().panels
    guides = [c for c in panel.curves if c.role == "guide"]
    slopes = [np.diff(np.log(guide.y)) / np.diff(np.log(guide.x)) for guide in guides]
    orders = sorted({ORDERS[c.method] for c in panel.curves if c.method})
    assert [slope.mean() for slope in slopes] == pytest.approx(orders)


@pytest.mark.parametrize("ratio", [0.2, 5.0])
def test_a_title_names_first_who_is_cheaper_and_both_are_named(ratio):
    rows = [
        row("particle", method, h, solution_error=h**4, engine="llvm", time_min_s=scale / h)
        for method, scale in (("contact-rkn4", ratio), ("rk4", 1.0))
        for h in (0.2, 0.02, 0.002)
    ]
    _, named = work_precision.message(frames(work_precision=rows), "particle")
    assert named == sorted(["contact-rkn4", "rk4"], reverse=ratio > 1)


def test_a_title_has_the_verdict_of_the_tables_whose_margin_is_of_all_scenes():
    """One noisy cell of a scene alone would make its methods a tie."""
    rows = [
        row(scene, method, h, solution_error=h**4, engine="llvm", time_min_s=scale / h, time_process_ratio=p)
        for scene, cells in (("particle", [1.6]), ("oscillator", [1.0] * 30))
        for method, scale in (("contact-rkn4", 1.0), ("rk4", 1.3))
        for h, p in zip(np.geomspace(0.2, 0.002, max(3, len(cells))), [*cells, np.nan, np.nan], strict=False)
    ]
    title, named = work_precision.message(frames(work_precision=rows), "particle")
    assert (named, "needs 77% of the time" in title) == (["contact-rkn4", "rk4"], True), title


# -- files -----------------------------------------------------------------------------------------
def test_a_file_has_no_dates_no_chance_and_no_idle_digits(tmp_path):
    panel = Panel("p", Axis("error"), Axis("time"), (curve("rk4", 1.0),))
    figure = Figure("f", "off by 0.00024", (panel,))
    text = draw.svg(figure)
    assert text == draw.svg(figure)
    assert "0.00024" in text  # words are as they were
    assert not re.search(r"<[^>]*\d\.\d{3}", text)
    assert draw.save_png(figure, tmp_path).exists()


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
