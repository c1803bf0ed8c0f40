"""Runge–Kutta and Runge–Kutta–Nyström methods: coefficients, orders, and pairs by tolerance."""

import math
from itertools import pairwise

import numpy as np
import pytest

import contactbench as cb
from cases import few_slow, mine
from contactbench.measure.order import order_at
from contactbench.methods.runge_kutta import read_tableau
from contactbench.solution import Status
from own_scenes import scene_of
from trees import defects

TABLEAUX = {name: read_tableau(name) for name in ("rk4", "rk8", "rk8-7", "rkn8-6", "rkn12-10")}
#: what the coefficients are known to
DIGITS = {"rk8": 27, "rkn12-10": 49}
#: those with the most conditions
DEAR = ("rk8-7", "rkn12-10")
#: a defect that is no rounding of doubles
NOTICED = 1e-10
PAIRS = ("rk8-7", "rkn8-6", "rkn12-10")
FIXED = ("rk4", "rk8", "rkn8", "rkn12")
PARTICLE = cb.SCENES["particle"]


def formulas():
    for name, tableau in TABLEAUX.items():
        marks = [pytest.mark.slow] if name in DEAR else []
        yield pytest.param(name, tableau.weights, tableau.order, id=name, marks=marks)
        if tableau.lower:
            yield pytest.param(name, tableau.lower, tableau.lower_order, id=f"{name}, embedded")


def largest(tableau, weights, order):
    return float(max(map(abs, defects(tableau.matrix, tableau.nodes, weights, order))))


# -- coefficients ----------------------------------------------------------------------------------
@pytest.mark.parametrize(("name", "weights", "order"), [*formulas()])
def test_coefficients_solve_the_order_conditions(name, weights, order):
    """In fractions, up to the digits that are printed; and not those of the next order."""
    tableau = TABLEAUX[name]
    assert largest(tableau, weights, order) <= 10.0 ** -DIGITS.get(name, math.inf)
    if order < 10:
        assert largest(tableau, weights, order + 1) > 1e-8


def changed(rows):
    """Rows with one coefficient a thousandth larger, for every coefficient that is not 0."""
    for i, row in enumerate(rows):
        for j, a in enumerate(row):
            if a:
                yield (*rows[:i], (*row[:j], a * 1.001, *row[j + 1 :]), *rows[i + 1 :])


@pytest.mark.parametrize("name", few_slow(TABLEAUX, *DEAR))
def test_a_changed_coefficient_is_noticed(name):
    """In doubles, by the conditions up to order nine and the sums of rows."""
    tableau = TABLEAUX[name]
    matrix, weights, lower = (
        [[*map(float, row)] for row in rows] for rows in (tableau.matrix, tableau.weights, tableau.lower)
    )
    nodes, gap = [*map(float, tableau.nodes)], len(weights)

    def seen(matrix, weights, order):
        sums = (sum(row) - c**gap / gap for row, c in zip(matrix, nodes, strict=True))
        return max(map(abs, (*sums, *defects(matrix, nodes, weights, min(order, 9)))))

    for mutant in changed(matrix):
        assert seen(mutant, weights, tableau.order) > NOTICED
    for rows, order in ((weights, tableau.order), (lower, tableau.lower_order)):
        for mutant in changed(rows):
            assert seen(matrix, mutant, order) > NOTICED


@pytest.mark.parametrize("name", FIXED)
def test_the_order_is_measured_under_a_damping_that_changes(name):
    """At 50 digits, with s; under a constant one it is rule 6 of the contract of methods."""
    method = cb.METHODS[name]
    assert order_at(method, scene_of("forced_pulsating"), 1.0, 10) == pytest.approx(method.order, abs=0.1)


# -- fixed steps -----------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["rkn8", "rkn12", "rkn8-6", "rkn12-10"])
@pytest.mark.parametrize("scene", few_slow(["forced_oscillator", "forced_pulsating"], "forced_oscillator"))
def test_undamped_coordinates_solve_the_equations(name, scene):
    scene = scene_of(scene)
    chosen = {"rtol": 1e-12} if "-" in name else {"step": scene.t_end / 400}
    solution = cb.solve(scene, name, save_at=[scene.t_end], **chosen)
    reference = cb.reference(scene, [scene.t_end])
    assert np.abs(solution.y - reference.y).max() < 1e-8 * np.abs(reference.y).max(), "q, p and s"


# -- by tolerance ----------------------------------------------------------------------------------
@pytest.mark.parametrize("name", PAIRS)
@pytest.mark.parametrize("scene", ["particle", "duffing"])
def test_the_error_follows_the_tolerance(name, scene):
    end = min(cb.SCENES[scene].t_end, 20.0)
    errors = []
    for rtol in (1e-4, 1e-6, 1e-8, 1e-10):
        errors.append(cb.LAWS["solution_error"](cb.solve(scene, name, rtol=rtol, save_at=[end], carry=())))
        assert errors[-1] < 100 * rtol
    assert all(5 * fine < coarse for coarse, fine in pairwise(errors))
    assert errors[0] < 3e8 * errors[-1]


@pytest.mark.parametrize("name", PAIRS)
def test_saved_times_are_stepped_onto(name):
    times = np.array([0.0, 0.37, 2.0, 2.0 + 1e-9, 11.0])
    solution = cb.solve("particle", name, rtol=1e-10, save_at=times)
    truth = cb.reference(PARTICLE, times[1:]).y
    assert np.abs(solution.y[1:] - truth).max() < 1e-9
    assert np.array_equal(solution.y[0], PARTICLE.pack(PARTICLE.initial(("s",))))


@pytest.mark.parametrize("name", ["rkn8", "rkn12", "rkn8-6", "rkn12-10"])
def test_a_damping_that_jumps_is_seen_once(name):
    jump, setting = 3.3, {"rtol": 1e-11} if "-" in name else {"step": 0.1}
    rate = lambda t: cb.math.where(t < jump, 0.2, 0.6)  # noqa: E731
    scene = mine(lambda q, t: q[0] ** 2 / 2, t_end=8.0, kind=cb.Driven, rate=rate, breaks=(jump,))
    last = 1.0, 0.0
    for gamma, end in ((0.2, jump), (0.6, 8.0 - jump)):
        piece = mine(lambda q: q[0] ** 2 / 2, *map(float, last), t_end=8.0, gamma=gamma)
        last = cb.solve(piece, "contact-rkn8", step=0.02, save_at=[end], carry=()).y[-1]
    found = cb.solve(scene, name, save_at=[8.0], carry=(), **setting).y[-1]
    assert np.abs(found[:2] - last).max() < 1e-9


@pytest.mark.parametrize("name", PAIRS)
def test_a_spent_budget_and_a_singularity_are_told_apart(name):
    spent = cb.solve("particle", name, rtol=1e-8, max_steps=7)
    assert spent.status is Status.budget
    assert spent.counts.steps + spent.counts.rejected == 7
    escaped = cb.solve("escape", name, rtol=1e-8)
    assert escaped.status is Status.diverged
    assert np.isnan(escaped.y[-1]).all()


@pytest.mark.parametrize("name", PAIRS)
def test_rejected_steps_leave_no_trace(name):
    """A force that grows a hundredfold within one step."""
    scene = mine(lambda q: cb.math.exp(30 * (q[0] - 1)) / 30, 0.0, 0.4, 9.0, gamma=0.1)
    solution = cb.solve(scene, name, rtol=1e-10, save_at=[9.0], carry=())
    assert solution.counts.rejected > 0
    fine = cb.solve(scene, "contact-rkn8", step=9.0 / 20_000, save_at=[9.0], carry=())
    assert np.abs(solution.y - fine.y).max() < 1e-6
