"""``contactbench check``: which rules ran, what was measured, and what is broken."""

from __future__ import annotations

import pytest

import contactbench as cb
from contactbench.cli import main
from contactbench.methods.fixed_step import FixedStep
from contactbench.testing import METHOD_RULES, SCENE_RULES

RK4 = cb.METHODS["rk4"].step


@pytest.fixture
def mine(monkeypatch):
    """A method that keeps its contract, one that claims a higher order, and a scene of each kind."""
    for name, order in (("kept", 4), ("broken", 5)):
        monkeypatch.setitem(cb.METHODS, name, FixedStep(name, order, RK4, evaluations=4, about="planted"))
    wrong = cb.SCENES["particle"].with_(name="torn", rotation_invariant=True)
    monkeypatch.setitem(cb.SCENES, "torn", wrong)


def rows(out):
    return [line.split() for line in out.splitlines()[1:]]


@pytest.mark.usefixtures("mine")
def test_a_method_on_one_engine_has_every_rule_on_every_scene(capsys):
    assert main(["check", "kept", "--engine", "python"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert [int(row[0]) for row in rows(out)] == 3 * list(METHOD_RULES)
    order = next(row for row in rows(out) if row[0] == "6")
    assert float(order[order.index("order") + 1].rstrip(",")) == pytest.approx(4, abs=0.02)


def test_a_scene_has_every_rule(capsys):
    assert main(["check", "central"]) == 0
    assert [int(row[0]) for row in rows(capsys.readouterr().out)] == list(SCENE_RULES)


@pytest.mark.usefixtures("mine")
@pytest.mark.parametrize(("line", "rule"), [(["broken", "--engine", "python"], 6), (["torn"], 7)])
def test_a_broken_rule_ends_it(line, rule, capsys):
    assert main(["check", *line]) == 1
    out, err = capsys.readouterr()
    assert [int(row[0]) for row in rows(out)] == list(range(1, rule))
    assert err.startswith(f"contactbench: rule {rule}: {line[0]}")
    assert err.count("\n") == 1
