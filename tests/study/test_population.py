"""Random problems: they are what the document says, their costs are measured right, answers follow from tables."""

import math
from itertools import islice

import numpy as np
import pytest

import contactbench as cb
from contactbench.measure.statistics import NORMAL, quantile_interval, wilson
from contactbench.peers import heyoka
from contactbench.runs import population, ring, trial
from contactbench.runs.experiment import PROFILES
from contactbench.runs.features import features, force_cost
from contactbench.runs.problems import DAMPING, DEAREST, FAMILIES, HARD, SEED, draw
from contactbench.runs.search import Question
from contactbench.scene.base import Elapsed
from contactbench.tables.declared import POPULATION, PROBLEMS, RING

#: those that start at the bottom of a well whose smallest frequency is ω
WELLS = ["well-4", "well-6", "pendulum", "cosine-lattice", "morse", "henon-heiles", "toda-5", "fput-3"]


# -- drawing ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("family", FAMILIES)
def test_a_family_is_one_structure_and_a_seed_always_draws_the_same(family):
    one, other, again = draw(SEED, family, 0), draw(SEED + 1, family, 3), draw(SEED, family, 0)
    assert one.scene.identity == other.scene.identity is not None
    assert one.scene.numbers() == again.scene.numbers() != other.scene.numbers()
    assert (one.scene.t_end, one.scene.name) == (again.scene.t_end, f"{family}-0")


@pytest.mark.parametrize("family", WELLS)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_well_is_thrown_from_its_bottom_and_has_the_frequency(family, seed):
    scene = FAMILIES[family].draw(np.random.default_rng(seed), 4.0, None)
    force = lambda q: np.array(scene.dV(tuple(q)), dtype=float)  # noqa: E731
    bottom = np.array(scene.q)
    assert np.abs(force(bottom)).max() < 1e-12
    shifts = 1e-5 * np.eye(len(bottom))
    hessian = np.array([(force(bottom + h) - force(bottom - h)) / 2e-5 for h in shifts])
    assert np.linalg.eigvalsh(hessian).min() == pytest.approx(4.0, rel=1e-6)


def test_an_extreme_energy_is_that_part_of_the_barrier():
    """At exactly the barrier a pendulum and a particle between two wells have just the energy at the top."""
    for family, top in (("pendulum", math.pi), ("well-4", 0.0)):
        scene = FAMILIES[family].draw(np.random.default_rng(5), 1.7, 1.0)
        energy = scene.p[0] ** 2 / 2 + scene.V(scene.q)
        assert energy == pytest.approx(scene.V((top,)), rel=1e-12)


def test_a_kepler_orbit_has_the_eccentricity_and_the_frequency():
    scene = FAMILIES["kepler"].draw(np.random.default_rng(5), 4.0, 0.6)
    energy = scene.p[1] ** 2 / 2 + scene.V(scene.q)
    mass = scene.parameters["w"]
    axis = -mass / (2 * energy)
    assert mass / axis**3 == pytest.approx(4.0)
    assert axis * 1.6 == pytest.approx(1.0)  # it starts farthest out


def test_spans_and_damping_keep_to_their_rules():
    for family in FAMILIES:
        for number in range(6):
            scene = draw(7, family, number).scene
            known = features(scene) if family in ("pendulum", "sines-24") else None
            if known is not None:
                assert known.span * known.cost < 3 * DEAREST  # the period of a small motion is another one
            gamma = getattr(scene, "gamma", None)
            if gamma is not None:
                assert 0 < gamma <= 10 * DAMPING[1]
    assert draw(7, "kepler", 1).scene.gamma * draw(7, "kepler", 1).scene.t_end <= 0.5 * (1 + 1e-12)


def test_hard_problems_are_of_their_kind():
    orbit = draw(SEED, "kepler", 0, "near-collision").scene
    nearest = 1 - 10**-4.0
    e = 1 - orbit.p[1] ** 2 / orbit.parameters["w"]  # v² = w (1 − e) farthest out
    assert 0.99 <= e <= nearest
    assert all(kind.families for kind in HARD.values())


# -- measuring -------------------------------------------------------------------------------------
def test_one_program_of_heyoka_runs_a_family():
    spent = set()
    for number in (0, 1):
        scene = draw(SEED, "morse", number).scene.with_(t_end=5.0)
        given = {"rtol": 1e-9, "save_at": [5.0], "carry": ()}
        shared = cb.prepare(scene, heyoka.SHARED, **given)
        own = cb.solve(scene, "heyoka-taylor", **given)
        assert np.abs(shared().y - own.y).max() < 1e-14
        assert shared().counts == own.counts
        spent.add(shared.compile_s)
    assert len(spent) == 1  # that of the first, whose program it is


# -- what an error costs -----------------------------------------------------------------------------
PENDULUM = draw(SEED, "pendulum", 1)


def trials(method):
    """Trials of a method on one problem, one after the other."""
    truth = population.truth_of(PENDULUM)
    question = Question(PENDULUM.scene, truth, population.ERRORS, math.inf)
    while True:
        yield population.Trial(question, method, features(PENDULUM.scene))


def test_what_an_error_costs_is_what_a_scan_of_steps_says():
    one, scan = islice(trials(cb.METHODS["rk4"]), 2)
    one.search([1e-4], {})
    (row,) = one.rows([1e-4], {})
    for n in range(20, 400, 4):
        if scan.attempt(PENDULUM.scene.t_end / n).error <= 1e-4:
            break
    assert row["evaluations"] == pytest.approx(scan.tried[-1].evaluations, rel=0.15)
    assert row["reached"] == one.best(1e-4).error <= 1e-4 == row["error"]


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("contact-rkn6", PENDULUM.scene.t_end / np.arange(2, 600, 2)),
        ("rk8-7", np.geomspace(1e-2, 1e-12, 121)),
    ],
)
def test_errors_are_searched_for_one_after_the_other(name, settings):
    """Every error, from loose to tight, costs what a fine scan says, within what two settings may be apart."""
    targets = [1e-2, 1e-4, 1e-7]
    search, scan = islice(trials(cb.METHODS[name]), 2)
    search.search(targets, {})
    for value in settings:
        if scan.attempt(scan.allowed(value)).error <= targets[-1]:
            break
    for row in search.rows(targets, {}):
        first = next(one for one in scan.tried if one.error <= row["error"])
        assert 1 / trial.APART < row["evaluations"] / first.evaluations < trial.APART, row


def test_what_only_coarse_compiled_settings_offer_is_searched_among_them():
    search = next(trials(heyoka.SHARED))
    search.search([1e-4, 1e-8], {})
    assert {one.value for one in search.tried} <= set(trial.RUNGS[heyoka.SHARED.name])
    assert search.best(1e-8).error <= 1e-8


def test_an_error_that_no_setting_reaches_is_a_row_that_says_so():
    search = next(trials(cb.METHODS["rk4"]))
    search.search([1e-30], {})
    (row,) = search.rows([1e-30], {})
    assert row["status"] in {"unreached", "budget"}
    assert row["note"]
    assert "evaluations" not in row


def test_truth_says_how_far_two_solvers_agree():
    problem = draw(SEED, "morse", 1)
    truth = population.truth_of(problem)
    exact = cb.reference(problem.scene, Elapsed(truth.t), ()).y
    gap = np.abs(truth.y - exact).max() / np.abs(exact).max()
    assert gap < 10.0 ** (1 - truth.digits)


def test_cells_are_the_problems_of_the_seeds_or_of_one_given(monkeypatch):
    smoke, standard = (population.cells(PROFILES[name]) for name in ("smoke", "standard"))
    assert set(smoke) < set(standard)
    assert {cell[0] for cell in standard if not cell[2]} == {*FAMILIES}
    assert {cell[2] for cell in standard} == {"", *HARD}
    assert 160 <= len(FAMILIES) * population.COUNT + sum(kind.count for kind in HARD.values()) <= 240
    monkeypatch.setattr(population, "OWN_SEED", [11])
    assert {cell[1] for cell in population.cells(PROFILES["standard"])} == {11}


@pytest.mark.parametrize("family", FAMILIES)
def test_who_is_raced_has_contact_methods_and_the_strongest_of_the_others(family):
    scene = draw(SEED, family, 0).scene
    names = [method.name for method in population.raced(scene)]
    assert len(names) == len(set(names))
    assert {"contact-strang", "rk4", "cvode-adams", "cyrk-dop853", "heyoka-taylor", "rk8-7"} <= {*names}
    assert not any(cb.METHODS[name].stiff or cb.METHODS[name].refuses(scene) for name in names)
    ours = [
        cb.METHODS[name].order for name in names if cb.METHODS[name].contact and not cb.METHODS[name].exact
    ]
    assert len(ours) == len(set(ours))  # one of each order


@pytest.mark.slow
def test_rows_of_a_problem_fit_the_tables_and_keep_what_they_say():
    rows = list(population.cost_rows(draw(SEED, "cosine-lattice", 0)))
    assert rows[0][0] is PROBLEMS
    costs = [row for table, row in rows if table is POPULATION]
    assert all(set(row) <= {*table.columns} for table, row in rows)
    done = [row for row in costs if row["status"] == "ok"]
    assert {row["method"] for row in done} > {"contact-rkn8", "rk4", "heyoka-taylor", "cvode-adams"}
    assert all(row["reached"] <= row["error"] and row["time_s"] > 0 for row in done)
    (problem, known), *hard = population.hard_rows(draw(SEED, "pendulum", 0, "separatrix"))
    assert problem is PROBLEMS
    assert known["hard"] == "separatrix"
    assert all(table is POPULATION for table, _ in hard)
    assert {row["error"] for _, row in hard} == {population.TOLERANCE}


# -- what random problems have found -------------------------------------------------------------
@pytest.mark.parametrize("method", ["rkn8", "rkn12", "rk8", "contact-rkn8"])
def test_pilots_do_not_agree_on_a_motion_that_is_lost(method):
    """At γ = 300 the factor e^{−γh} of four long steps leaves nothing of it, exactly, and of eight neither."""
    scene = cb.Mechanical(
        name="creep", q=(1.0,), p=(0.0,), gamma=300.0, t_end=5.0, potential=lambda q: q[0] ** 2 / 2
    )
    solution = cb.solve(scene, method, rtol=1e-6, save_at=[5.0])
    slow = scene.gamma / 2 - math.sqrt(scene.gamma**2 / 4 - 1)
    assert solution.ok
    assert solution.q[-1, 0] == pytest.approx(math.exp(-5 * slow), rel=2e-5)


@pytest.mark.parametrize("method", [name for name, method in cb.METHODS.items() if method.iterates])
def test_an_implicit_step_at_rest_has_converged(method):
    """q and p have decayed, s has come to rest: its slope is rounding, which no iteration makes any smaller."""
    scene = draw(SEED, "quadratic-damping", 7).scene
    solution = cb.solve(scene, method, step=0.05, save_at=[scene.t_end])
    assert solution.status == "ok"
    rest = math.sqrt(2 * scene.parameters["depth"] / scene.kappa)
    assert solution.s[-1] == pytest.approx(rest, rel=1e-3)


# -- a pilot ---------------------------------------------------------------------------------------
def test_a_pilot_finds_frequency_damping_and_span():
    scene = cb.SCENES["oscillator"].with_(gamma=0.3, t_end=100.0)
    known = features(scene)
    assert known.omega == pytest.approx(1.0, rel=1e-6)
    assert known.damping == pytest.approx(0.3, rel=1e-6)
    assert known.span == pytest.approx(100 / (2 * math.pi), rel=1e-6)
    assert known.spread == pytest.approx(1.0, rel=1e-6)


def test_the_cost_of_a_force_counts_its_functions():
    plain, dear = (
        cb.Mechanical(name="own", q=(0.3,), p=(0.0,), gamma=0.1, t_end=1.0, potential=potential)
        for potential in (lambda q: q[0] ** 2, lambda q: q[0] ** 2 + cb.math.cos(q[0]))
    )
    assert 12 <= force_cost(dear) - force_cost(plain) <= 15
    of_floats = cb.Mechanical(
        name="own", q=(0.3,), p=(0.0,), gamma=0.1, t_end=1.0,
        potential=lambda q: float(q[0]) ** 2, gradient=lambda q: (2 * float(q[0]),),
    )  # fmt: skip
    assert force_cost(of_floats) == 1000.0
    assert features(of_floats).omega == pytest.approx(math.sqrt(2), rel=1e-6)


# -- intervals -------------------------------------------------------------------------------------
@pytest.mark.parametrize(("part", "whole"), [(0, 10), (3, 10), (50, 120), (10, 10)])
def test_the_ends_of_wilsons_interval_are_shares_that_the_sample_just_does_not_reject(part, whole):
    for end in wilson(part, whole):
        if 1e-9 < end < 1 - 1e-9:
            assert abs(part / whole - end) == pytest.approx(NORMAL * math.sqrt(end * (1 - end) / whole))
    assert wilson(0, 0) == (0.0, 1.0)


def test_an_interval_of_a_median_has_it_in_nineteen_of_twenty_samples():
    rng = np.random.default_rng(3)
    inside = 0
    for _ in range(100):
        _, low, high = quantile_interval(rng.standard_normal(60), 0.5)
        inside += low <= 0 <= high
    assert 88 <= inside <= 100


# -- the chaotic ring: the energy that is left, the measured damping rate, ladders -------------------
GAMMA, SPAN = 1e-3, 200.0


@pytest.fixture(autouse=True)
def few(monkeypatch):
    monkeypatch.setattr(ring, "STARTS", 2)


def row(method, value, gamma=GAMMA, span=SPAN):
    made = ring.row_of(method, gamma, span, value)
    assert set(made) <= {*RING.columns}
    return made


def test_the_energy_left_is_that_of_the_scene_without_its_centre_of_mass():
    scene = ring.ring(GAMMA, SPAN)
    energy = scene.energy(scene.initial(()))
    assert ring.energy_left(*ring.starts()[0]) == pytest.approx(energy - ring.N * 0.3**2 / 2)


def test_errors_fall_with_the_step_and_so_does_that_of_the_damping_rate():
    coarse, fine = row("contact-strang", 0.2), row("contact-strang", 0.1)
    assert 2e-3 < coarse["energy_error"] < 1e-2
    assert fine["energy_error"] < coarse["energy_error"] / 2
    assert coarse["low"] <= coarse["energy_error"] <= coarse["high"]
    assert fine["floor"] < 1e-6
    assert coarse["evaluations"] == pytest.approx(5.1)  # a kick more at each of 20 saved times
    assert 0 < fine["rate_error"] < 0.05


def test_weaker_damping_costs_a_method_without_structure_its_rate_and_no_contact_method():
    rk4 = [row("rk4", 0.1, gamma, 2000.0)["rate_error"] for gamma in (1e-4, 1e-5)]
    assert rk4[1] > 5 * rk4[0] > 0.1
    assert row("contact-rkn4", 0.4, 1e-5, 2000.0)["rate_error"] < 0.02 * rk4[1]


def test_a_step_that_loses_the_motion_has_a_row_without_numbers():
    lost = row("contact-strang", 0.8)
    assert (lost["status"], "energy_error" in lost) == ("diverged", False)
    assert ring.is_lost(lost)


@pytest.mark.parametrize("name", ["contact-strang", "rk4", "cyrk-dop853"])
def test_a_ladder_begins_where_the_motion_is_not_lost_and_ends_at_the_error(name):
    method = cb.METHODS[name]
    *coarse, last = ring.rungs(method, GAMMA, SPAN, 3e-3)
    assert all(3e-3 < each["energy_error"] < ring.LOST for each in coarse)
    assert last["energy_error"] <= 3e-3


def test_long_runs_are_made_at_the_settings_around_the_error_allowed(monkeypatch):
    monkeypatch.setattr(ring, "SPAN", SPAN)
    rows = sorted(
        ring.long_rungs(cb.METHODS["contact-strang"], GAMMA, 5 * SPAN), key=lambda row: -row["setting"]
    )
    assert [each["energy_error"] <= ring.ALLOWED for each in rows] == [False] * (len(rows) - 1) + [True]


def test_who_runs_has_forces_alone_or_is_a_compiled_solver_for_what_is_not_stiff():
    names = {method.name for method in ring.methods()}
    assert names > {
        "contact-strang",
        "herglotz2",
        "rkn12",
        "rk4",
        "cyrk-dop853",
        "cvode-adams",
        "heyoka-taylor",
    }
    assert not names & {
        "rk8",
        "scipy-dop853",
        "cvode-bdf",
        "diffrax-tsit5",
        "contact-exact",
        "contact-gauss4",
    }
