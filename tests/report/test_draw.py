"""Figures: what is in colour, where axes end, where words stand, and what is drawn again."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_hex

from contactbench.report import draw, labels, scales
from contactbench.report.drawing import Axis, Curve, Figure, Panel, Span
from contactbench.report.figures import convergence, laws, stability, work_precision
from contactbench.report.figures.best import MOST, best_of_each, cheapest, contest_ends, family_and_order
from contactbench.report.look import FAMILIES, METHODS, MUTED
from frames import row, table

ERRORS = tuple(10.0**-k for k in range(1, 12))


def curve(method, cost, power=-0.2, errors=ERRORS, **options):
    return Curve(errors, tuple(cost * e**power for e in errors), method, method, **options)


def race(*curves):
    y, beyond = contest_ends(Axis("time", "log"), curves)
    x = Axis("error", "log", inverted=True, within=(1e-16, 2.0))
    return Figure("race", "a race", (Panel("time", x, y, best_of_each(curves, cheapest), remark=beyond),))


# -- what is in colour -----------------------------------------------------------------------------
def test_the_cheapest_of_each_family_is_in_colour_and_the_others_are_drawn_below():
    found = best_of_each(
        [curve("contact-rkn6", 1.0), curve("contact-rkn8", 2.0), curve("rk4", 9.0), curve("cvode-bdf", 5.0),
         curve("cvode-adams", 4.0), Curve((1.0,), (1.0,), "theory", role="guide")], cheapest,
    )  # fmt: skip
    assert [c.label for c in found if c.muted] == ["contact-rkn8", "cvode-bdf"]
    assert [c.muted for c in found] == sorted((c.muted for c in found), reverse=True)


def test_one_error_more_at_least_cost_decides():
    early = curve("contact-rkn4", 1.0, -0.4)  # cheaper only at large errors
    late = curve("contact-rkn8", 2.0, -0.1)
    assert [c.label for c in best_of_each([early, late], cheapest) if not c.muted] == ["contact-rkn8"]


def test_no_more_than_eight_curves_are_in_colour():
    everyone = [curve(name, 1.0 + k) for k, name in enumerate(METHODS)]
    for group in (lambda c: c.method, family_and_order):
        assert sum(not c.muted for c in best_of_each(everyone, cheapest, group)) == MOST
    assert (
        sum(not c.muted for c in best_of_each(everyone, cheapest)) == len(FAMILIES) - 1
    )  # nobody is "other"


def test_a_curve_that_reaches_nothing_is_not_the_best():
    nothing = curve("rk4", math.nan)
    assert all(c.muted for c in best_of_each([nothing], cheapest))


# -- axes ------------------------------------------------------------------------------------------
def test_the_axis_ends_where_the_contest_ends_and_says_who_is_beyond():
    fast = [curve(name, 1.0) for name in ("contact-rkn8", "heyoka-taylor", "cyrk-vern8")]
    slow = curve("diffrax-kvaerno5", 1e5)
    panel = race(*fast, slow).panels[0]
    assert panel.remark == "beyond the panel: diffrax-kvaerno5"
    low, high = scales.spanned(panel.y, [v for c in panel.curves for v in c.y])
    assert high == pytest.approx(30 * 1e-11**-0.2)
    assert race(*fast).panels[0].remark == ""
    assert scales.spanned(panel.y, slow.y)[1] > max(slow.y)  # where nothing else is left the axis goes on
    assert low < 1.6


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [(1e-3, 1e3, ["10⁻³", "10⁻²", "10⁻¹", "1", "10", "10²", "10³"]), (1.0, 10.0, ["1", "2", "5", "10"])],
)
def test_ticks_of_a_logarithmic_axis(low, high, words):
    ticks = scales.decades(low, high, 10)
    assert [text for _, text in ticks] == words
    assert all(low <= v * (1 + 1e-9) and v <= high * (1 + 1e-9) for v, _ in ticks)
    assert len(scales.decades(1e-16, 1.0, 5)) <= 6


def test_points_beyond_one_axis_do_not_stretch_the_other():
    far = Curve((1e-3, 10.0), (1.0, 1e9), "far")
    axis = Axis("error", "log", within=(1e-16, 2.0))
    assert scales.points([far], "y", axis, "x") == [1.0]
    assert scales.points([far], "x", Axis("time", "log"), "y") == [1e-3, 10.0]


# -- words -----------------------------------------------------------------------------------------
def test_a_name_avoids_curves_and_names_or_is_left_out():
    frame = labels.Box(0, 0, 200, 100)
    line = np.array([[10.0, 20.0], [190.0, 20.0]])
    above = line + np.array([0.0, 60.0])
    found = labels.places(frame, [line, above], [(60, 10), (60, 10)])
    one, other = (box for box in found if box is not None)
    assert not one.meets(other)
    assert one.holds(labels.sampled(above)) == other.holds(labels.sampled(line)) == 0
    assert labels.places(frame, [line], [(500, 10)]) == [None]
    dense = [line + np.array([0.0, k]) for k in range(-20, 80, 4)]
    assert labels.places(frame, [line, *dense], [(60, 10), *[None] * len(dense)])[0] is None


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
            yield row("particle", name, step, solution_error=min(1.0, 0.1 * step ** (own.order or 9)), engine="numba",
                      rhs_equivalents=spent, steps=round(1 / step), time_median_s=1e-7 * spent, time_min_s=9e-8 * spent,
                      time_iqr_s=2e-8 * spent, family=kind(name))  # fmt: skip


def kind(name):
    return "contact" if name.startswith("contact") else "established"


def converged():
    for name, order in ORDERS.items():
        for step in STEPS:
            yield row("particle", name, step, family=kind(name), step=step, order=order, order_nominal=order,
                      solution_error=max(1e-17, (0.3 + 0.01 * len(name)) * step**order))  # fmt: skip


def followed():
    for k, name in enumerate(METHODS):
        for t in range(1, 21):
            wave = 10.0 ** (-k / 2) * (1.5 + math.sin(t + k))
            yield row("central", name, 0.1, family=kind(name), t=float(t), energy_deviation=wave,
                      hamiltonian_deviation=wave, momentum_deviation=wave / 9, contact_deviation=wave / 99)  # fmt: skip


def limited():
    for name, order in ORDERS.items():
        for gamma in (0.01, 0.1, 1.0, 10.0):
            yield {"method": name, "family": kind(name), "gamma": gamma, "omega": 1.0,
                   "limit": order / (1 + gamma), "per_evaluation": 1 / (1 + gamma)}  # fmt: skip


FIGURES = {
    "work_precision": lambda: work_precision.figure(table("work_precision", worked()), "particle"),
    "laws": lambda: laws.along_time(table("laws_time", followed()), "central"),
    "convergence": lambda: convergence.figure(table("convergence", converged())),
    "limits": lambda: stability.limits(table("stability_limits", limited())),
}


@pytest.fixture(scope="module", params=FIGURES)
def real(request):
    """A figure of planted tables, and as matplotlib draws it."""
    figure = FIGURES[request.param]()
    made = draw.drawn(figure)
    made.canvas.draw()
    yield figure, made
    plt.close(made)


def test_words_stay_on_the_canvas_and_names_apart(real):
    _, made = real
    renderer = made.canvas.get_renderer()
    for axes in made.axes:
        names = [t.get_window_extent(renderer) for t in axes.texts if t.get_gid() == "name"]
        assert names
        assert not [1 for a, b in combinations(names, 2) if a.overlaps(b)]
        inside = axes.get_window_extent(renderer).padded(1)
        assert all(inside.contains(*box.min) and inside.contains(*box.max) for box in names)
        for text in (axes.xaxis.label, axes.yaxis.label, axes.title):
            box = text.get_window_extent(renderer)
            assert made.bbox.padded(1).contains(*box.min), text.get_text()
            assert made.bbox.padded(1).contains(*box.max), text.get_text()
        words = [t.get_text() for t in (axes.xaxis.label, axes.yaxis.label, axes.title, *axes.texts)]
        assert not [w for w in words if "^{" in "".join(w.split("$")[::2])]


def test_every_curve_is_there_and_at_most_eight_in_colour(real):
    figure, made = real
    colors = {own.light for own in FAMILIES.values()}
    for panel, axes in zip(figure.panels, made.axes, strict=True):
        drawn = [to_hex(line.get_color()) for line in axes.lines]
        assert len(drawn) >= len(panel.curves)
        assert sum(color in colors for color in drawn) <= MOST
        assert drawn.count(MUTED) == sum(c.muted for c in panel.curves)


def test_the_convergence_plot_has_a_guide_of_every_order_in_colour():
    figure = FIGURES["convergence"]()
    for panel in figure.panels:
        guides = [c for c in panel.curves if c.role == "guide"]
        orders = {ORDERS[c.method] for c in panel.curves if c.method and not c.muted}
        assert {c.note for c in guides} == {f"slope {p}" for p in orders}
        for guide in guides:
            slope = np.diff(np.log(guide.y)) / np.diff(np.log(guide.x))
            assert slope == pytest.approx(int(guide.note.split()[1]))


# -- files -----------------------------------------------------------------------------------------
def test_what_shows_the_same_is_not_drawn_again(tmp_path, monkeypatch):
    figure = race(curve("rk4", 1.0))
    with draw.in_background(tmp_path) as have_saved:
        have_saved(figure)
    assert draw.current(figure, tmp_path)
    vector, picture = draw.files(figure, tmp_path)
    before = vector.read_bytes(), picture.read_bytes()
    with monkeypatch.context() as patched:
        patched.setattr(draw, "save", lambda *given: pytest.fail("drawn again"))
        with draw.in_background(tmp_path) as have_saved:
            have_saved(figure)
    changed = replace(figure, panels=(replace(figure.panels[0], title="other"),))
    assert not draw.current(changed, tmp_path)
    draw.save(figure, tmp_path)
    assert (vector.read_bytes(), picture.read_bytes()) == before  # no dates, no chance
    vector.write_text(vector.read_text().replace("0", "1"))
    assert not draw.current(figure, tmp_path)
    draw.save(figure, tmp_path)
    picture.unlink()
    assert not draw.current(figure, tmp_path)


@pytest.mark.parametrize(("low", "inside"), [(1e-15, True), (3e-13, False), (1e-10, None)])
def test_the_label_of_a_span_is_not_cut(low, inside):
    """Inside the span, above it where there is no room, and left out where the span is not seen."""
    axis = Axis("deviation", "log", limits=(low, 1e-2))
    span = Span("y", 1e-17, 1e-12, "round-off")
    made = draw.drawn(Figure("f", "t", (Panel("p", Axis("t", limits=(0, 1)), axis, (), spans=(span,)),)))
    made.canvas.draw()
    (axes,) = made.axes
    words = [text for text in axes.texts if text.get_text() == "round-off"]
    if inside is None:
        assert not words
    else:
        (box,) = (text.get_window_extent() for text in words)
        assert axes.bbox.y0 <= box.y0 < box.y1 <= axes.bbox.y1
        edge = axes.transData.transform((0.5, 1e-12))[1]
        assert box.y1 <= edge + 1 if inside else box.y0 >= edge - 1
    plt.close(made)


def test_laws_show_the_printed_scheme_a_second_order_one_and_the_best_contact_method():
    rows = [
        row("rigid_body", m, 0.1, t=t, energy_deviation=deviation, momentum_deviation=1e-15)
        for m, deviation in (
            ("contact-printed", 1e-2), ("contact-abc", 1e-3), ("contact-strang", 1e-4), ("contact-o8", 1e-12),
            ("contact-exact", 1e-15), ("rk4", 1e-6), ("scipy-dop853", 1e-8), ("cyrk-dop853", 1e-8),
            ("cyrk-vern8", 1e-9),
        ) for t in (1.0, 2.0)
    ]  # fmt: skip
    for panel in laws.along_time(table("laws_time", rows), "rigid_body").panels:
        assert {c.method for c in panel.curves if not c.muted} == {
            "contact-printed", "contact-strang", "contact-exact", "rk4", "cyrk-vern8",
        }  # fmt: skip


def test_a_cost_that_is_not_positive_is_no_point():
    """A marginal time is a difference of two times, and may come out at zero or below."""
    rows = [
        row("particle", "rk4", h, solution_error=h**4, engine="numba", rhs_equivalents=4 / h, time_median_s=1e-5 / h,
            time_min_s=1e-5 / h, time_iqr_s=1e-7, marginal_s=m, marginal_halves_ratio=1.01 if m > 0 else None)
        for h, m in ((0.4, -2e-9), (0.2, 0.0), (0.1, 3e-8), (0.05, 6e-8))
    ]  # fmt: skip
    *_, panel = work_precision.figure(table("work_precision", rows), "particle").panels
    assert panel.title == "Marginal time, compiled"
    (found,) = panel.curves
    assert found.y == pytest.approx([3e-5, 6e-5])  # ms


def test_a_jump_under_strong_damping_is_told_with_the_radius_that_explains_it():
    def line(step, error, radius, method="rk4"):
        return {"method": method, "family": "established", "gamma": 10.0, "damping_per_evaluation": 2.5 * step,
                "step": step, "error": error, "radius": radius}  # fmt: skip

    def caption(*lines):
        return stability.strong(table("strong_damping", lines), [10.0]).caption

    jump = line(0.2, 1e-9, 0.97), line(0.3, 4e3, 1.25)
    said = "`rk4` at γ = 10 from 1.0e-09 (h = 0.2, spectral radius 0.970) to 4.0e+03 (h = 0.3, 1.250)"
    assert said in caption(*jump)
    assert "jumps" not in caption(jump[0], line(0.3, 4e3, 0.99))  # not for that reason
    assert "jumps" not in caption(line(0.2, 0.1, 0.97), jump[1])  # no jump: it was inaccurate before
