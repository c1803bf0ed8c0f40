"""Which methods race by default: those that lead in the tables on problems like it, what everybody knows, one's own."""

import json

import pandas as pd
import pytest

import contactbench as cb
from contactbench.cli import main
from contactbench.errors import BadInput
from contactbench.study import compare, field
from contactbench.study.schedule import Schedule

OSCILLATOR = cb.SCENES["oscillator"]


def table(costs, damping=lambda k: 0.1, kind="mechanical", count=50):
    """Return planted tables: cost of each method on each problem, by its number."""
    problems, rows = [], []
    for k in range(count):
        name = {"seed": 1, "scene": f"a-{k}"}
        problems.append(name | {"kind": kind, "hard": "", "damping": damping(k)})
        for method, cost in costs.items():
            row = name | {"method": method, "error": 1e-6, "status": "ok"}
            rows.append(row | {"evaluations": cost(k), "time_s": 1e-8 * cost(k)})
    return {"population": pd.DataFrame(rows), "population_problems": pd.DataFrame(problems)}


@pytest.fixture
def planted(monkeypatch):
    def plant(costs, **more):
        known = table(costs, **more)
        monkeypatch.setattr(field, "results", lambda name: known[name] if name in known else results(name))

    results = field.results
    return plant


def beside(found):
    return [name for name in found if name not in field.KNOWN]


@pytest.mark.parametrize(
    ("cost", "leads"),
    [
        (lambda k: 1.2, True),
        (lambda k: 1.3, False),
        (lambda k: 1.0 if k % 5 == 0 else 9.0, True),  # on a fifth
        (lambda k: 1.0 if k % 6 == 0 else 9.0, False),
    ],
)
def test_a_method_leads_that_is_near_the_least_on_a_part_of_the_problems(planted, cost, leads):
    planted({"rkn12": lambda k: 1.0, "contact-rkn8": lambda k: 1.0, "rk8": cost})
    found = beside(field.field(OSCILLATOR, [1e-6]))
    assert found == ["contact-rkn8", *["rk8"] * leads, "rkn12"]


@pytest.mark.parametrize(("gamma", "first"), [(1e-4, "contact-rkn8"), (1.0, "contact-rkn4")])
def test_problems_of_the_nearest_damping_are_asked(planted, gamma, first):
    halves = {"contact-rkn8": True, "contact-rkn4": False}
    weak = {name: lambda k, own=own: 1.0 if (k < 50) == own else 9.0 for name, own in halves.items()}
    planted(weak, damping=lambda k: 1e-4 if k < 50 else 1.0, count=100)
    assert beside(field.field(OSCILLATOR.with_(gamma=gamma), [1e-6])) == [first]


def test_what_cannot_run_a_scene_neither_races_nor_keeps_others_from_leading(planted):
    planted({"contact-exact": lambda k: 1.0, "contact-rkn8": lambda k: 3.0, "rk8": lambda k: 9.0})
    assert beside(field.field(OSCILLATOR, [1e-6])) == ["contact-rkn8"]


def test_the_best_contact_methods_race_where_others_lead(planted):
    planted({"rkn12": lambda k: 1.0, "contact-rkn8": lambda k: 5.0, "contact-strang": lambda k: 9.0})
    assert beside(field.field(OSCILLATOR, [1e-6])) == ["contact-rkn8", "rkn12"]


def test_implicit_methods_race_where_damping_is_stronger_than_of_any_random_problem():
    implicit = {"cyrk-radau", "cvode-bdf"}
    assert implicit < {*field.field(cb.SCENES["overdamped"].with_(gamma=30.0), [1e-6])}
    assert not implicit & {*field.field(OSCILLATOR, [1e-6])}


def test_a_method_of_ones_own_always_races(planted, registries):
    @cb.fixed_step("my-own", order=2)
    def my_own(scene, x, h, xp):
        return x

    planted({"contact-rkn8": lambda k: 1.0})
    assert {"my-own", *field.KNOWN} < {*field.field(OSCILLATOR, [1e-6])}


@pytest.mark.parametrize(
    "scene",
    [
        "heavy_top",
        "double_pendulum",
        "rigid_body",
        cb.Equations(name="own", rhs=lambda t, y: (y[1], -y[0]), y0=(1.0, 0.0), t_end=5.0),
        cb.Mechanical(
            name="floats",
            q=(1.0,),
            p=(0.0,),
            gamma=0.1,
            t_end=20.0,
            potential=lambda q: float(q[0]) ** 2 / 2,
            gradient=lambda q: (float(q[0]),),
        ),
        cb.Mechanical(name="rest", q=(0.0,), p=(0.0,), gamma=0.0, t_end=5.0, potential=lambda q: q[0] ** 2),
    ],
    ids=lambda scene: getattr(scene, "name", scene),
)
def test_about_ten_methods_race_on_every_kind_of_scene_a_contact_method_among_them(scene):
    scene = cb.SCENES[scene] if isinstance(scene, str) else scene
    found = [cb.METHODS[name] for name in field.field(scene, compare.ERRORS)]
    assert 7 <= len(found) <= field.MOST + len(field.KNOWN)
    assert {*field.KNOWN} <= {method.name for method in found}
    assert all(method.refuses(scene) is None for method in found)
    contact = any(method.family == "contact" for method in found)
    assert contact != isinstance(scene, cb.Equations)


def test_without_tables_all_race(monkeypatch):
    def missing(name):
        raise BadInput("no result tables in this installation")

    raced = []
    monkeypatch.setattr(field, "results", missing)
    assert field.field(OSCILLATOR, [1e-6]) == []
    monkeypatch.setattr(
        Schedule, "__init__", lambda self, scene, methods, *more: raced.append((methods, more))
    )
    monkeypatch.setattr(Schedule, "run", lambda self: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        cb.compare("oscillator")
    assert raced[0][0] == [*cb.METHODS]


@pytest.mark.parametrize(
    ("methods", "raced", "leading", "budget"),
    [
        (None, ["rk4"], ["rk4"], compare.BUDGET),
        ("all", [*cb.METHODS], ["rk4"], compare.LONG_BUDGET),
        (["rk8", "rk4"], ["rk8", "rk4"], [], compare.LONG_BUDGET),
    ],
)
def test_who_races_and_for_how_long(monkeypatch, methods, raced, leading, budget):
    taken = []
    monkeypatch.setattr(compare, "field", lambda scene, errors: ["rk4"])
    monkeypatch.setattr(Schedule, "__init__", lambda self, scene, *given: taken.append(given))
    monkeypatch.setattr(Schedule, "run", lambda self: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        cb.compare("oscillator", methods)
    ((methods, _, seconds, _, _, first, _),) = taken
    assert (methods, first, seconds) == (raced, leading, budget)


@pytest.mark.parametrize(
    ("line", "given"), [("", None), ("--all", "all"), ("rk4 --all", ["rk4"]), ("rk4", ["rk4"])]
)
def test_the_command_races_all_where_it_is_told(monkeypatch, capsys, line, given):
    taken = []
    monkeypatch.setattr(
        cb, "compare", lambda scene, methods, *more, **options: taken.append(methods) or 1 / 0
    )
    assert main(["compare", "particle", *line.split()]) == 2
    assert taken == [given]


@pytest.mark.slow
def test_a_default_race_ends_in_its_budget_with_what_everybody_knows(capsys):
    assert main(["compare", "particle", "--json", "--quiet"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["seconds"] <= 1.1 * compare.BUDGET
    assert {*field.KNOWN} <= {row["method"] for row in found["rows"]}
    assert len(found["recommendation"]) == 3
