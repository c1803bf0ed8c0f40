"""Which methods race by default: those that lead in the tables on problems like it, the contestants, one's own."""

import pandas as pd
import pytest

import contactbench as cb
from cases import mine
from contactbench.cli import main
from contactbench.errors import BadInput
from contactbench.study import compare, field

OSCILLATOR = cb.SCENES["oscillator"]


@pytest.fixture
def planted(monkeypatch):
    """Plant the cost of each method on each of some random problems, by its number."""

    def plant(costs, damping=lambda k: 0.1, count=50):
        problems = [
            {"seed": 1, "scene": f"a-{k}", "kind": "mechanical", "hard": "", "damping": damping(k)}
            for k in range(count)
        ]
        problems.append(problems[0] | {"scene": "b-0", "hard": "stiff"})  # where another one leads
        rows = [
            {"seed": 1, "scene": f"a-{k}", "method": method, "error": 1e-6, "status": "ok"}
            | {"evaluations": cost(k), "time_s": 1e-8 * cost(k)}
            for k in range(count)
            for method, cost in costs.items()
        ]
        rows.append(rows[0] | {"scene": "b-0", "method": "cvode-bdf"})
        tables = {"population": pd.DataFrame(rows), "problems": pd.DataFrame(problems)}
        monkeypatch.setattr(field, "results", tables.__getitem__)

    return plant


def beside(scene=OSCILLATOR):
    return [name for name in field.field(scene, [1e-6]) if name not in field.contestants()]


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
    assert {*beside()} == {"rkn12", "contact-rkn8", *["rk8"] * leads}


@pytest.mark.parametrize(("gamma", "first"), [(1e-4, "contact-rkn8"), (1.0, "contact-rkn4")])
def test_problems_of_the_nearest_damping_are_asked(planted, gamma, first):
    halves = {"contact-rkn8": True, "contact-rkn4": False}
    weak = {name: lambda k, own=own: 1.0 if (k < 50) == own else 9.0 for name, own in halves.items()}
    planted(weak, damping=lambda k: 1e-4 if k < 50 else 1.0, count=100)
    assert beside(OSCILLATOR.with_(gamma=gamma)) == [first]


def test_what_cannot_run_a_scene_neither_races_nor_keeps_others_from_leading(planted):
    planted({"contact-exact": lambda k: 1.0, "contact-rkn8": lambda k: 3.0, "rk8": lambda k: 9.0})
    assert beside() == ["contact-rkn8"]


def test_the_best_contact_methods_race_where_others_lead(planted):
    planted({"rkn12": lambda k: 1.0, "contact-rkn8": lambda k: 5.0, "contact-bm6": lambda k: 9.0})
    assert {*beside()} == {"rkn12", "contact-rkn8"}


def test_the_contestants_and_a_method_of_ones_own_always_race(planted, registries):
    @cb.fixed_step("my-own", order=2)
    def my_own(scene, x, h, xp):
        return x

    planted({"contact-rkn8": lambda k: 1.0})
    assert field.field(OSCILLATOR, [1e-6]) == ["contact-rkn8", *field.contestants(), "my-own"]
    engines = {cb.METHODS[name].engines[0] for name in field.contestants()}
    assert {"llvm", "python", "c", "jax"} <= engines


KINDS = [*map(cb.SCENES.get, ("heavy_top", "double_pendulum", "rigid_body"))]
KINDS.append(cb.Equations(name="own", rhs=lambda t, y: (y[1], -y[0]), y0=(1.0, 0.0), t_end=5.0))
KINDS.append(mine(lambda q: float(q[0]) ** 2 / 2, name="floats", gradient=lambda q: (float(q[0]),)))
KINDS.append(mine(lambda q: q[0] ** 2, name="rest", q=0.0))


@pytest.mark.parametrize("scene", KINDS, ids=lambda scene: scene.name)
def test_some_methods_race_on_every_kind_of_scene_a_contact_method_among_them(scene):
    found = [cb.METHODS[name] for name in field.field(scene, compare.ERRORS)]
    assert 7 <= len(found) <= field.MOST_LEADERS + len(field.contestants())
    assert all(method.refuses(scene) is None for method in found)
    contact = any(method.family == "contact" for method in found)
    assert contact != isinstance(scene, cb.Equations)


def test_without_tables_there_is_no_field(monkeypatch):
    def missing(name):
        raise BadInput("no result tables in this installation")

    monkeypatch.setattr(field, "results", missing)
    assert field.field(OSCILLATOR, [1e-6]) == []


@pytest.mark.parametrize(
    ("methods", "known", "raced", "leading", "budget"),
    [
        (None, ["rk4"], ["rk4"], ["rk4"], compare.BUDGET),
        (None, [], [*cb.METHODS], [*cb.METHODS], compare.BUDGET),
        (
            "all",
            ["rk4"],
            ["rk4", *(name for name in cb.METHODS if name != "rk4")],
            ["rk4"],
            compare.LONG_BUDGET,
        ),
        (["rk8", "rk4", "rk8"], ["rkn8"], ["rk8", "rk4"], ["rk8", "rk4"], compare.LONG_BUDGET),
    ],
)
def test_who_races_and_for_how_long(monkeypatch, methods, known, raced, leading, budget):
    taken = []
    monkeypatch.setattr("contactbench.study.schedule.confirmed", lambda *_: None)
    monkeypatch.setattr(compare, "field", lambda scene, errors: known)
    monkeypatch.setattr(compare, "search", lambda question, *given: taken.append(given) or 1 / 0)
    with pytest.raises(ZeroDivisionError):
        cb.compare("oscillator", methods)
    ((found, first, time),) = taken
    assert (found, first, time.seconds) == (raced, leading, budget)


@pytest.mark.parametrize(
    ("line", "given"), [("", None), ("--all", "all"), ("rk4 --all", ["rk4"]), ("rk4", ["rk4"])]
)
def test_the_command_races_all_where_it_is_told(monkeypatch, capsys, line, given):
    taken = []
    monkeypatch.setattr(cb, "compare", lambda scene, methods, *_, **__: taken.append(methods) or 1 / 0)
    assert main(["compare", "particle", *line.split()]) == 2
    assert taken == [given]
