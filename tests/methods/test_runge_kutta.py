"""Runge–Kutta and Runge–Kutta–Nyström methods: coefficients, orders, and pairs by tolerance."""

import math
from fractions import Fraction
from functools import cache
from itertools import combinations_with_replacement, pairwise, product

import numpy as np
import pytest

import contactbench as cb
from cases import chain, few_slow, mine, scene_of
from contactbench.measure.order import order_at
from contactbench.methods.runge_kutta import read_tableau
from contactbench.solution import Status

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


def test_rk4_is_the_classical_one():
    """Other methods of four stages and order four are as accurate."""
    tableau = TABLEAUX["rk4"]
    assert [[c for c in map(float, row) if c] for row in tableau.matrix] == [[], [0.5], [0.5], [1.0]]
    assert [[*map(float, row)] for row in (tableau.nodes, *tableau.weights)] == [
        [0, 0.5, 0.5, 1],
        pytest.approx([1 / 6, 1 / 3, 1 / 3, 1 / 6]),
    ]


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


# -- trees -------------------------------------------------------------------------------------------
LEAF = "y'"


@cache
def trees(power, gap):
    """All trees of a power; gap : 1 of first-order equations, 2 of second-order ones."""
    if power == 0:
        return ((),)
    found = []
    for sizes in partitions(power, gap):
        kinds = [[(size, k) for k in range(len(branches(size, gap)))] for size in sorted(set(sizes))]
        counts = [sizes.count(own[0][0]) for own in kinds]
        choices = [combinations_with_replacement(own, n) for own, n in zip(kinds, counts, strict=True)]
        for chosen in product(*choices):
            found.append(tuple(branches(size, gap)[k] for part in chosen for size, k in part))
    return tuple(found)


@cache
def branches(size, gap):
    """Branches that contribute so much to the power of a tree."""
    leaf = (LEAF,) if gap == 2 and size == 1 else ()
    return leaf + (trees(size - gap, gap) if size >= gap else ())


def partitions(power, gap, least=1):
    if power == 0:
        yield ()
    for size in range(least, power + 1):
        if branches(size, gap):
            for rest in partitions(power - size, gap, size):
                yield (size, *rest)


def power_of(tree, gap):
    return sum(1 if branch == LEAF else power_of(branch, gap) + gap for branch in tree)


def exact(tree, gap):
    """The coefficient of τ^e."""
    value = Fraction(1)
    for branch in tree:
        if branch != LEAF:
            e = power_of(branch, gap)
            value *= exact(branch, gap) / ((e + 1) if gap == 1 else (e + 1) * (e + 2))
    return value


def defects(matrix, nodes, weights, order):
    """What is left of every order condition up to an order, for numbers of any kind."""
    gap, stages = len(weights), range(len(nodes))
    values = {}

    def at_stages(tree):
        if tree not in values:
            value = [1] * len(nodes)
            for branch in tree:
                if branch == LEAF:
                    value = [a * c for a, c in zip(value, nodes, strict=True)]
                else:
                    inner = at_stages(branch)
                    sums = (sum(a * inner[j] for j, a in enumerate(matrix[i]) if a) for i in stages)
                    value = [a * b for a, b in zip(value, sums, strict=True)]
            values[tree] = value
        return values[tree]

    for power in range(order):
        for tree in trees(power, gap):
            whole = exact(tree, gap)
            for row, more in zip(
                weights[::-1], range(1, gap + 1), strict=True
            ):  # y' of a Nyström method first
                if power + more <= order:
                    scale = power + 1 if more == 1 else (power + 1) * (power + 2)
                    target = whole / scale
                    yield sum(w * v for w, v in zip(row, at_stages(tree), strict=True) if w) - target


# -- states of many numbers: stages in a loop over rows, points before in a ring of them -------------
WITH_ROWS = ("rk8", "rkn8", "rkn12", "quinlan-tremaine8", "quinlan-tremaine12")
LARGE = chain(14).recorded()


def driven(t_end=1.0):
    """A chain whose damping changes in time."""
    held = LARGE.potential
    return cb.Driven(
        name="driven-chain",
        potential=lambda q, t, k: held(q, k=k) + cb.math.cos(t) * q[0],
        rate=lambda t, k: 0.1 + 0.05 * cb.math.sin(t),
        q=LARGE.q,
        p=LARGE.p,
        parameters={"k": 1.5},
        t_end=t_end,
    )


@pytest.mark.parametrize(
    "carry", [("s",), pytest.param((), marks=pytest.mark.slow)], ids=["action", "motion"]
)
@pytest.mark.parametrize("name", WITH_ROWS)
def test_stages_in_a_loop_take_the_steps_of_stages_written_out(name, carry):
    method, h, n = cb.METHODS[name], 0.02, 12
    end = method.advance(LARGE, LARGE.initial(carry), h, n, math)
    for engine in ("llvm", "python"):
        found = cb.solve(LARGE, name, step=h, save_at=[h * n], carry=carry, engine=engine)
        assert found.y[-1] == pytest.approx(LARGE.pack(end), rel=1e-12, abs=1e-13)


@pytest.mark.parametrize("scene", [LARGE, driven()], ids=["constant damping", "changing damping"])
@pytest.mark.parametrize("name", ["rkn12", *PAIRS])
@pytest.mark.quick(name="rkn12-10")
@pytest.mark.quick(name="rk8-7", scene="driven-chain")
def test_they_are_as_accurate_on_every_chain(name, scene):
    setting = {"rtol": 1e-10} if name in PAIRS else {"step": 0.1}
    true = cb.solve(scene, "contact-rkn8", step=0.005, save_at=[0.5, 1.0])
    found = cb.solve(scene, name, save_at=[0.5, 1.0], **setting)
    assert found.y == pytest.approx(true.y, abs=1e-9)


def test_a_tangent_goes_through_the_rows():
    run = cb.prepare(LARGE, "rkn8", step=0.1, save_at=[1.0], carry=())
    v = np.eye(28)[3]
    ends = [run.integrate(run.start + amount * v).y[-1] for amount in (1e-5, -1e-5)]
    assert run.sensitivity(run.start)[-1][:, 3] == pytest.approx((ends[0] - ends[1]) / 2e-5, abs=1e-8)
