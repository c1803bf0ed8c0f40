"""Random problems: they are what the document says, their costs are measured right, advice follows from tables."""

import json
import math
import re

import numpy as np
import pandas as pd
import pytest

import contactbench as cb
from contactbench.cli import main
from contactbench.measure.statistics import NORMAL, quantile_interval, wilson
from contactbench.peers import heyoka
from contactbench.report import population as report
from contactbench.report.advice import text
from contactbench.results import advice as tables
from contactbench.results.tables import POPULATION, POPULATION_HARD, POPULATION_PROBLEMS
from contactbench.study import advice, population, trial
from contactbench.study.experiment import PROFILES
from contactbench.study.features import features, force_cost
from contactbench.study.problems import DAMPING, DEAREST, FAMILIES, HARD, HARD_COUNT, REPLICATE, SEED, draw
from contactbench.study.search import Question
from contactbench.study.settings import carry_of

#: those that start at the bottom of a well whose smallest frequency is ω
WELLS = ["well-4", "well-6", "pendulum", "cosine-lattice", "morse", "henon-heiles", "toda-5", "fput-3"]


# -- drawing ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("family", FAMILIES)
def test_a_family_is_one_structure_and_a_seed_always_draws_the_same(family):
    one, other, again = draw(SEED, family, 0), draw(REPLICATE, family, 3), draw(SEED, family, 0)
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


def test_what_an_error_costs_is_what_a_scan_of_steps_says():
    problem = draw(SEED, "pendulum", 1)
    truth, _ = population.truth_of(problem)
    question = Question(problem.scene, truth, population.ERRORS, math.inf)
    trial = population.Trial(question, cb.METHODS["rk4"], features(problem.scene))
    trial.search([1e-4], {})
    (row,) = trial.rows([1e-4], {})
    scan = population.Trial(question, cb.METHODS["rk4"], trial.known)
    for n in range(20, 400, 4):
        if scan.attempt(problem.scene.t_end / n).error <= 1e-4:
            break
    assert row["evaluations"] == pytest.approx(scan.tried[-1].evaluations, rel=0.15)
    assert row["value"] == pytest.approx(scan.tried[-1].value, rel=0.2)
    assert trial.best(1e-4).error <= 1e-4 == row["error"]


def test_truth_says_how_far_two_solvers_agree():
    problem = draw(SEED, "morse", 1)
    truth, source = population.truth_of(problem)
    exact = cb.reference(problem.scene, truth.t, ()).y
    gap = np.abs(truth.y - exact).max() / np.abs(exact).max()
    assert gap < 10.0 ** (1 - truth.digits)
    assert "heyoka" in source


def test_cells_are_the_problems_of_the_seeds_or_of_one_given(monkeypatch):
    smoke, standard = (population.cells(PROFILES[name]) for name in ("smoke", "standard"))
    assert set(smoke) < set(standard)
    drawn = [(f, seed, k) for f, seed, low, high in standard for k in range(low, high)]
    assert len(drawn) == len(set(drawn)) == len(FAMILIES) * (population.COUNT + population.REPLICATED) >= 200
    monkeypatch.setattr(population, "OWN_SEED", [11])
    assert {cell[1] for cell in population.cells(PROFILES["standard"])} == {11}
    assert {cell[1] for cell in population.hard_cells(PROFILES["standard"])} == {11}


@pytest.mark.slow
def test_rows_of_a_problem_fit_the_tables_and_keep_what_they_say():
    rows = list(population.cost_rows(draw(SEED, "cosine-lattice", 0)))
    assert rows[0][0] is POPULATION_PROBLEMS
    costs = [row for table, row in rows if table is POPULATION]
    done = [row for row in costs if row["status"] == "ok"]
    assert {row["method"] for row in done} > {"contact-rkn8", "rk4", "heyoka-taylor", "cvode-adams"}
    assert all(row["error_reached"] <= row["error"] and row["time_s"] > 0 for row in done)
    hard = list(population.hard_rows(draw(SEED, "pendulum", 0, "separatrix")))
    assert all(
        row["right"] is None or row["status"] == "ok" for table, row in hard if table is POPULATION_HARD
    )
    assert HARD_COUNT * len(HARD) >= 40


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


@pytest.mark.parametrize("method", ["gauss4", "gauss6"])
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


# -- advice ----------------------------------------------------------------------------------------
def planted():
    """Where damping is weak "rk4" is three times cheaper than "contact-rkn8", where it is strong the other way."""
    problems, rows = [], []
    for seed in (1, 2):
        for k in range(40):
            weak = k % 2 == 0
            name = {"seed": seed, "scene": f"a-{k}"}
            known = {
                "omega": 1.0,
                "damping": 1e-5 if weak else 1.0,
                "span": 10.0 + k / 10,
                "spread": 1.1,
                "cost": 20.0,
            }
            problems.append(
                name
                | known
                | {"size": 1, "kind": "mechanical", "structure": f"f{k % 4}", "hard": "", "short": False}
            )
            for method, family in (
                ("rk4", "established"),
                ("contact-rkn8", "contact"),
                ("contact-exact", "contact"),
            ):
                best = (method == "rk4") == weak
                row = name | {
                    "method": method,
                    "family": family,
                    "error": 1e-6,
                    "control": "step",
                    "value": 0.1,
                }
                row |= {"status": "unreached" if method == "contact-exact" else "ok"}
                rows.append(row | {"evaluations": 100.0 if best else 300.0, "time_s": 1e-6 if best else 3e-6})
    return pd.DataFrame(rows), pd.DataFrame(problems)


@pytest.mark.parametrize(("gamma", "best"), [(1e-5, "rk4"), (1.0, "contact-rkn8")])
def test_advice_names_what_was_best_on_problems_like_it(monkeypatch, gamma, best):
    rows, problems = planted()
    own = problems.set_index(["seed", "scene"])
    monkeypatch.setattr(advice, "known", lambda: (rows, own, tables.threshold(problems)))
    monkeypatch.setattr(trial, "SHORT", 0.0)  # nothing is tried
    scene = cb.SCENES["oscillator"].with_(gamma=gamma, t_end=2 * math.pi * 12)
    found = cb.advise(scene, error=2e-6)
    first = found.iloc[0]
    assert first["method"] == best
    assert (pytest.approx(1.0), 1.0, "step") == (first["best"], first["regret"], first["setting"])
    assert first["value"] == pytest.approx(0.1, rel=1e-3)
    assert first["evaluations"] == pytest.approx(100, rel=0.1)
    assert found.attrs["error"] == 1e-6
    assert found["regret"].iloc[1] == pytest.approx(3.0)
    assert "contact-exact" not in set(found["method"])  # it cannot run this scene
    assert best in text(found)
    assert cb.advise(scene.with_(t_end=6e6), error=1e-6).attrs["far"]


@pytest.mark.parametrize("name", ["particle", "rigid_body", "spherical_pendulum", "quadratic_damping"])
def test_what_advice_has_tried_reaches_the_error_at_the_cost_it_says(name):
    scene, error = cb.SCENES[name], 3e-7
    found = cb.advise(scene, error=error, cost="evaluations", methods=5)
    own = found[found["tried"] & (found["setting"] != "exact")]
    assert len(own) >= 2
    assert own["expected"].is_monotonic_increasing
    assert (found["expected"].iloc[0], found.attrs["far"]) == (1.0, False)
    ends = [scene.t_end / 2, scene.t_end]
    for row in own.itertuples():
        truth, given = cb.reference(scene, ends, ()).y, {row.setting: row.value}
        runs = [cb.solve(scene, row.method, save_at=[end], carry=carry_of(scene), **given) for end in ends]
        size = max(np.linalg.norm(truth, axis=1).max(), np.linalg.norm(scene.pack(scene.initial(()))))
        off = [np.linalg.norm(run.y[-1, : len(y)] - y) for run, y in zip(runs, truth, strict=True)]
        assert max(off) < 1.5 * error * size
        assert runs[-1].counts.rhs_equivalents == pytest.approx(row.evaluations, rel=0.1)


def test_what_a_method_takes_on_the_problem_itself_outweighs_what_it_took_on_others():
    score, each = np.array([0.0, 0.5, 1.0, math.inf, 2.0]), np.log([1.0, 1.0, 2.0, 3.0, 1.0])
    spent = np.array([100.0, 40.0, math.nan, 10.0, math.inf])
    found = tables.with_tried(score, spent, each)
    assert np.exp(found[[0, 1, 3]]) == pytest.approx([100, 40, 30])
    assert found[4] == math.inf  # it did not reach the error
    shift = np.median([math.log(100), math.log(40) - 0.5])
    assert found[2] == pytest.approx(1.0 + shift + tables.UNTRIED)
    assert tables.with_tried(score, np.full(5, math.nan), each) is score


def test_an_evaluation_costs_what_it_cost_on_problems_alike_or_as_much_more_than_others_as_elsewhere():
    rates = np.log([[1.0, 4.0, math.nan], [1.0, 2.0, math.nan], [3.0, 3.0, 24.0]])
    found = tables.an_evaluation(rates, np.array([0]), np.array([1.0]))
    assert np.exp(found) == pytest.approx(
        [1.0, 4.0, 2 * 24 / 6]
    )  # 24 over the mean of its problem, from the mean 2
    assert tables.an_evaluation(np.zeros((2, 2)), np.array([1]), np.array([1.0])) == pytest.approx([0, 0])


def test_the_best_are_tried_first_and_then_what_fewest_of_the_problems_can_run(monkeypatch):
    monkeypatch.setattr(tables, "FIRST", 2)
    score = np.array([1.0, 0.5, math.inf, 0.2, math.inf, 3.0])
    runs = np.array([True, True, True, True, False, True])
    known = np.array(
        [[1.0, 2.0, math.nan, 1.0, 1.0, 1.0], [1.0, 2.0, 1.0, 1.0, 1.0, math.nan], [1.0] * 2 + [math.nan] * 4]
    )
    methods = pd.Index(["rk4", "rk8", "contact-log8", "cvode-adams", "rkn8", "rk8-7"])
    found = methods[tables.to_try(score, methods, runs, known)].tolist()
    assert found == ["rk8", "rk4", "rk8-7", "contact-log8"]


def of_floats(q):
    return float(q[0]) ** 2 / 2


def in_a_domain(q):
    return -cb.math.sqrt(4 - q[0] * q[0])


@pytest.mark.parametrize(
    ("given", "tried"),
    [
        ({"potential": of_floats, "gradient": lambda q: (float(q[0]),)}, True),
        ({"potential": in_a_domain, "q": (1.5,)}, True),  # steps that are too long leave it
        ({"potential": lambda q: 0 * q[0]}, True),
        ({"potential": lambda q: q[0] ** 60 / 60, "q": (0.5,), "p": (1.0,)}, True),  # a step overflows
        ({"potential": lambda q: q[0] * q[0] / 2, "q": (0.0,)}, False),  # at rest: nothing has an error
    ],
)
def test_advice_copes_with_unkind_functions(given, tried):
    scene = cb.Mechanical(name="unkind", **{"q": (1.0,), "p": (0.0,), "gamma": 0.1, "t_end": 20.0} | given)
    found = cb.advise(scene)
    assert (len(found), any(found["tried"])) == (3, tried)


def test_no_method_is_tried_on_a_long_motion():
    scene = cb.SCENES["particle"]
    assert cb.advise(scene)["tried"].all()
    assert not cb.advise(scene.with_(t_end=1e5))["tried"].any()


def test_advice_is_judged_without_the_family_that_it_is_asked_for():
    rows, problems = planted()
    problems["structure"] = np.where(problems["damping"] < 0.1, "weak", "strong")
    own = tables.judged(rows, problems, 1e-6, "evaluations", 1, 1)
    assert len(own) == 40
    assert (own["regret"] > 2.9).all()  # it has only seen the other kind
    assert (own["of_three"] == 1.0).all()
    other = tables.judged(rows, problems, 1e-6, "evaluations", 1, 2)
    assert (other["regret"] == 1.0).all()
    tried = tables.judged(rows, problems.assign(short=True), 1e-6, "time_s", 1, 1)
    assert (tried["regret"] == 1.0).all()  # tried, it is known for what it is


@pytest.mark.parametrize(
    ("scene", "time"),
    [
        (cb.Equations(name="own", rhs=lambda t, y: (1 + y[0] ** 2,), y0=(0.0,), t_end=3.0), math.pi / 2),
        (
            cb.Mechanical(name="own", potential=lambda q: -(q[0] ** 4), q=(0.5,), p=(0.5**1.5,), t_end=9.0),
            2**0.5,
        ),
        (
            cb.Mechanical(
                name="own", potential=lambda q: -(q[0] ** 4) / 4, gamma=0.0, q=(1.0,), p=(0.0,), t_end=20.0
            ),
            1.8541,  # √2 Γ(1/4)² / (4 √(2π)) = √2 · 1.31103
        ),
    ],
)
def test_advice_says_where_a_motion_ends(scene, time):
    with pytest.raises(cb.BadInput, match="its motion left its scale by a factor 1e6") as refused:
        cb.advise(scene, error=1e-6)
    assert float(re.search(r"t = ([\d.]+)", str(refused.value))[1]) == pytest.approx(time, rel=5e-3)
    assert len(cb.advise(scene.with_(t_end=0.9 * time), error=1e-6)) > 0


@pytest.mark.parametrize(
    "scene",
    [
        cb.Equations(name="own", rhs=lambda t, y: (cb.math.sin(t) - y[0],), y0=(0.0,), t_end=20.0),
        cb.Driven(
            name="own", potential=lambda q, t: q[0] ** 2 / 2 - 1e-20 * q[0] * cb.math.sin(t),
            q=(0.0,), p=(0.0,), gamma=0.1, t_end=20.0,
        ),
        cb.Mechanical(
            name="own", potential=lambda q: q[0] ** 4 / 4 - q[0] ** 2 / 2,
            q=(1e-7,), p=(0.0,), gamma=0.1, t_end=40.0,
        ),
        cb.Mechanical(
            name="own", potential=lambda q: 0 * q[0], q=(1.0,), p=(1.0,), gamma=0.0, t_end=1e7
        ),
    ],
)  # fmt: skip
def test_a_motion_that_only_grows_from_little_is_no_diverging_one(scene):
    """As for every run: from rest, next to an equilibrium, and where a free particle goes far by itself."""
    assert cb.solve(scene, "rk8-7", rtol=1e-8).ok
    assert cb.advise(scene, error=1e-6)["tried"].any()


@pytest.mark.parametrize(
    ("given", "says"), [({"error": 0.0}, "error = 0.0"), ({"cost": "money"}, "cost = 'money'")]
)
def test_advice_refuses_what_it_does_not_take(given, says):
    with pytest.raises(cb.BadInput, match=says):
        cb.advise("particle", **given)


# -- the report ------------------------------------------------------------------------------------
def test_a_problem_lost_changes_the_count_of_the_answers():
    rows, problems = planted()
    frames = report_frames(rows, problems)
    (evaluations, _, advice) = report.answers(frames)
    assert evaluations.count == "20 of 40, 0 tied"
    assert evaluations.answer == "10⁻⁶: 50 % [35, 65]"
    assert (advice.answer, advice.count) == ("10⁻⁶: ×1.00", "median of 40 problems; 90 %: ×1.00")
    lost = (rows["scene"] == "a-1") & (rows["method"] == "rk4")
    changed = rows.assign(evaluations=rows["evaluations"].where(~lost, 10.0))
    (evaluations, *_) = report.answers(report_frames(changed, problems))
    assert evaluations.count == "19 of 40, 0 tied"
    titles = [part.title for part in report.parts(frames) if part is not None]
    assert len(titles) == 5 - 1  # no hard ones


def report_frames(rows, problems):
    from contactbench.report.chapters import Tables

    return Tables(population=rows, population_problems=problems, population_hard=pd.DataFrame())


# -- the command -----------------------------------------------------------------------------------
def test_the_command_takes_a_file_and_a_name_and_prints_text_or_json(
    tmp_path, monkeypatch, capsys, registries
):
    rows, problems = planted()
    own = problems.set_index(["seed", "scene"])
    monkeypatch.setattr(advice, "known", lambda: (rows, own, tables.threshold(problems)))
    file = tmp_path / "own.py"
    file.write_text(
        "import contactbench as cb\n"
        "cb.SCENES.add(cb.SCENES['oscillator'].with_(name='advised-one', gamma=1e-5, t_end=75.0))\n"
    )
    try:
        assert main(["advise", f"{file}:advised-one"]) == 0
        said = capsys.readouterr().out
        assert main(["advise", "advised-one", "--json", "--cost", "evaluations"]) == 0
        found = json.loads(capsys.readouterr().out)
    finally:
        cb.SCENES.pop("advised-one", None)
    assert "advised-one: angular frequency about 1, damping 1e-05 of it" in said
    assert "Tried on this very motion, in Python: " in said
    assert found["rows"][0]["method"] == "contact-rkn8"  # whatever the planted rows say
    assert found["features"]["size"] == 1


@pytest.mark.parametrize(
    "name",
    ["double_pendulum", "thermostat", "heavy_top", "spherical_pendulum", "forced_oscillator"],
)
def test_there_is_advice_for_every_kind_of_scene(name):
    advice = cb.advise(name)
    assert len(advice) == 3
    assert all(cb.METHODS[each].refuses(cb.SCENES[name]) is None for each in advice["method"])
