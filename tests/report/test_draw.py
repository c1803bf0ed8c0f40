"""Figures: which curves are in colour, where axes end, where names stand, and what a file holds."""

from __future__ import annotations

import math
import re
from itertools import combinations, pairwise

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.text import Text

from contactbench.report import draw
from contactbench.report.drawing import Axis, Curve, Figure, Panel
from contactbench.report.figures import convergence, laws, stability, structure, work_precision
from contactbench.report.figures.best import MOST, best_of_each, cheapest, contest_ends, family_and_order
from contactbench.report.look import FAMILIES, METHODS, MUTED, SHADES
from frames import row, table

ERRORS = tuple(10.0**-k for k in range(1, 12))


def curve(method, cost, power=-0.2):
    return Curve(ERRORS, tuple(cost * e**power for e in ERRORS), method, method)


def colours(curves):
    return {c.label for c in curves if not c.muted}


# -- what is in colour -----------------------------------------------------------------------------
def test_the_cheapest_of_each_family_is_in_colour_and_the_others_are_drawn_below():
    guide = Curve((1.0,), (1.0,), "theory", role="guide")
    methods = {"contact-rkn6": 1.0, "contact-rkn8": 2.0, "rk4": 9.0, "cvode-bdf": 5.0, "cvode-adams": 4.0}
    found = best_of_each([guide, *(curve(*item) for item in methods.items())], cheapest)
    assert colours(found) == {"theory", "contact-rkn6", "rk4", "cvode-adams"}
    assert [c.muted for c in found] == sorted((c.muted for c in found), reverse=True)


def test_one_error_more_at_least_cost_decides():
    early = curve("contact-rkn4", 1.0, -0.4)  # cheaper only at large errors
    late = curve("contact-rkn8", 2.0, -0.1)
    assert colours(best_of_each([early, late], cheapest)) == {"contact-rkn8"}


@pytest.mark.parametrize("group", [lambda c: c.method, family_and_order])
def test_no_more_than_eight_curves_are_in_colour(group):
    everyone = [curve(name, 1.0 + k) for k, name in enumerate(METHODS)]
    assert len(colours(best_of_each(everyone, cheapest, group))) == MOST


def test_a_curve_that_reaches_nothing_is_not_the_best():
    assert not colours(best_of_each([curve("rk4", math.nan)], cheapest))


def test_laws_show_the_printed_scheme_a_second_order_one_and_the_best_contact_method():
    deviations = {
        "contact-printed": 1e-2, "contact-abc": 1e-3, "contact-strang": 1e-4, "contact-o8": 1e-12,
        "contact-exact": 1e-15, "rk4": 1e-6, "scipy-dop853": 1e-8, "cyrk-dop853": 1e-8, "cyrk-vern8": 1e-9,
    }  # fmt: skip
    rows = [
        row("rigid_body", m, 0.1, t=t, energy_deviation=deviation, momentum_deviation=1e-15)
        for m, deviation in deviations.items()
        for t in (1.0, 2.0)
    ]
    for panel in laws.along_time(table("laws_time", rows), "rigid_body", table("laws")).panels:
        assert colours(panel.curves) == {
            "contact-printed",
            "contact-strang",
            "contact-exact",
            "rk4",
            "cyrk-vern8",
        }


# -- axes ------------------------------------------------------------------------------------------
def test_the_axis_of_cost_ends_where_the_contest_ends():
    fast = [curve(name, 1.0) for name in ("contact-rkn8", "heyoka-taylor", "cyrk-vern8")]
    axis = contest_ends(Axis("time", "log"), [*fast, curve("diffrax-kvaerno5", 1e5)])
    assert axis.within == (None, pytest.approx(30 * 1e-11**-0.2))


@pytest.mark.parametrize(
    ("value", "words"), [(0.5, "0.5"), (20.0, "20"), (1e-6, "10⁻⁶"), (2e5, "2·10⁵"), (1.0, "1")]
)
def test_ticks_of_a_logarithmic_axis(value, words):
    assert draw.power(value) == words


def test_points_beyond_one_axis_do_not_stretch_the_other():
    far = Curve((1e-3, 10.0), (1.0, 1e9), "far")
    panel = Panel("", Axis("error", "log", within=(1e-16, 2.0)), Axis("time", "log"), (far,))
    assert (draw.seen(panel, "x"), draw.seen(panel, "y")) == ([1e-3], [1.0])


@pytest.mark.parametrize("heights", [(0.5, 0.5, 0.5), (1.0, 0.99, 0.2), (0.0, 0.01, 0.9)])
def test_names_keep_their_order_and_their_distance(heights):
    placed = draw.spread(heights, 0.05)
    assert np.argsort(placed, kind="stable").tolist() == np.argsort(heights, kind="stable").tolist()
    assert min(b - a for a, b in pairwise(sorted(placed))) >= 0.05 - 1e-12
    assert max(placed) <= 1


def test_a_cost_that_is_not_positive_is_no_point():
    """A marginal time is a difference of two times, and may come out at zero or below."""
    rows = [
        row("particle", "rk4", h, solution_error=h**4, marginal_s=m)
        for h, m in ((0.4, -2e-9), (0.2, 0.0), (0.1, 3e-8), (0.05, 6e-8))
    ]
    frame = table("work_precision", rows)
    (found,) = work_precision.panel(frame, "", "marginal_s").curves
    assert found.y == pytest.approx([3e-5, 6e-5])  # ms


# -- figures of planted tables ---------------------------------------------------------------------
STEPS = (0.4, 0.2, 0.1, 0.05, 0.025)
ORDERS = {
    name: own.order
    for name, own in METHODS.items()
    if own.order and name.startswith(("contact", "rk4", "herg"))
}


def worked():
    """Every method at five settings, evaluations and times."""
    for k, (name, own) in enumerate(METHODS.items()):
        for step in STEPS:
            spent = round((10 + k) / step)
            cost = {"rhs_equivalents": spent, "time_median_s": 1e-7 * spent, "time_min_s": 9e-8 * spent}
            error = min(1.0, 0.1 * step ** (own.order or 9))
            yield row("particle", name, step, solution_error=error, engine="numba", **cost)


def converged():
    for name, order in ORDERS.items():
        for step in STEPS:
            error = max(1e-17, (0.3 + 0.01 * len(name)) * step**order)
            yield row(
                "particle", name, step, step=step, order=order, order_nominal=order, solution_error=error
            )


def followed():
    for k, name in enumerate(METHODS):
        for t in range(1, 21):
            wave = 10.0 ** (-k / 2) * (1.5 + math.sin(t + k))
            names = ("energy_deviation", "momentum_deviation", "contact_deviation")
            yield row("central", name, 0.1, t=float(t), **dict.fromkeys(names, wave))


def limited():
    for name, order in ORDERS.items():
        for gamma in (0.01, 0.1, 1.0, 10.0):
            known = {"gamma": gamma, "omega": 1.0, "limit": order / (1 + gamma)}
            yield {"method": name, "family": "established", "per_evaluation": order / (1 + gamma), **known}


def deviated():
    for name, own in METHODS.items():
        for step in STEPS:
            drift = 1e-15 if own.family == "contact" else step**4
            claims = {
                "contact_drift_claimed": own.family == "contact",
                "contact_drift_kept": own.family == "contact",
            }
            yield row("central", name, step, solution_error=step**4, contact_drift=drift, **claims)


FIGURES = {
    "work_precision": lambda: work_precision.figure(table("work_precision", worked()), "particle"),
    "laws": lambda: laws.along_time(table("laws_time", followed()), "central", table("laws")),
    "convergence": lambda: convergence.figure(table("convergence", converged())),
    "limits": lambda: stability.limits(table("stability_limits", limited())),
    "structure": lambda: structure.structure(table("laws", deviated())),
}


@pytest.fixture(scope="module", params=FIGURES)
def real(request):
    """A figure of planted tables, and as matplotlib draws it."""
    figure = FIGURES[request.param]()
    made = draw.render(figure)
    made.canvas.draw()
    yield figure, made
    plt.close(made)


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
            assert made.bbox.padded(1).contains(*box.min), text.get_text()
            assert made.bbox.padded(1).contains(*box.max), text.get_text()


def test_every_curve_is_there_and_every_name_once(real):
    figure, made = real
    colors = {*FAMILIES.values(), *SHADES.values()}
    for panel, axes in zip(figure.panels, made.axes, strict=True):
        drawn = [to_hex(line.get_color()) for line in axes.lines]
        assert len(drawn) == len(panel.curves)
        assert sum(color in colors for color in drawn) <= MOST + 1
        assert drawn.count(MUTED) == sum(c.muted for c in panel.curves)
    written = [t.get_text() for axes in made.axes for t in axes.texts if t.get_gid() == "name"]
    written += [t.get_text() for legend in made.legends for t in legend.get_texts()]
    wanted = {c.label for panel in figure.panels for c in panel.curves if c.label and not c.muted}
    assert sorted(name for name in written if name != draw.OTHERS) == sorted(wanted)


def test_the_convergence_plot_has_a_guide_of_every_order_in_colour():
    (panel,) = FIGURES["convergence"]().panels
    guides = [c for c in panel.curves if c.role == "guide"]
    slopes = [np.diff(np.log(guide.y)) / np.diff(np.log(guide.x)) for guide in guides]
    orders = sorted({ORDERS[c.method] for c in panel.curves if c.method and not c.muted})
    assert [slope.mean() for slope in slopes] == pytest.approx(orders)


@pytest.mark.parametrize("ratio", [0.2, 5.0])
def test_a_title_names_first_who_is_cheaper_and_both_are_in_colour(ratio):
    rows = [
        row("particle", method, h, solution_error=h**4, engine="numba", time_min_s=scale / h)
        for method, scale in (("contact-rkn4", ratio), ("rk4", 1.0))
        for h in (0.2, 0.02, 0.002)
    ]
    _, named = work_precision.message(table("work_precision", rows), "particle")
    assert named == sorted(["contact-rkn4", "rk4"], reverse=ratio > 1)


# -- files -----------------------------------------------------------------------------------------
def test_a_file_has_no_dates_no_chance_and_no_idle_digits(tmp_path):
    panel = Panel("p", Axis("error"), Axis("time"), (curve("rk4", 1.0),))
    figure = Figure("f", "off by 0.00024", (panel,))
    (path,) = draw.save(figure, tmp_path)
    text = path.read_text()
    assert text == draw.svg(figure)
    assert "0.00024" in text  # words are as they were
    assert not re.search(r"<[^>]*\d\.\d{3}", text)
    assert [p.suffix for p in draw.save(figure, tmp_path, png=True)] == [".svg", ".png"]
