"""Every registered scene keeps every rule of the contract; and a scene that breaks one is told which."""

from __future__ import annotations

import math

import pytest

import contactbench as cb
from cases import TILTED, USER, by_name
from contactbench.scene import State
from contactbench.testing import SCENE_RULES, Violation, check_scene


@by_name([*cb.SCENES.values(), USER, TILTED])
def test_a_scene_keeps_its_contract(scene):
    check_scene(scene)


# -- a violation of each rule ----------------------------------------------------------------------
class Unlabelled(cb.Mechanical):
    def labels(self, carry):
        return super().labels(carry)[:-1]


class Unnamed(cb.Mechanical):
    def number_names(self):
        return super().number_names()[1:]


class Gains(cb.Mechanical):
    may_gain_energy = False


class Jumps(cb.Mechanical):
    def displaced(self, x, v, amount):
        return super().displaced(x, v, 2 * amount)


def pendulum(kind=cb.Mechanical, **changes):
    """V = q⁴/4, or what changes it."""
    functions = {
        "potential": lambda q: q[0] * q[0] * q[0] * q[0] / 4,
        "gradient": lambda q: (q[0] * q[0] * q[0],),
        "hessian": lambda q: ((3 * q[0] * q[0],),),
    }
    given = {"name": "planted", **functions, "gamma": 0.3, "q": (0.7,), "p": (0.4,), "s": 0.1, "t_end": 2.0}
    return kind(**{**given, **changes})


def still(scene, t, mp):
    return State(scene.q, scene.p, scene.s)


def elsewhere(scene, t, mp):
    return State((scene.q[0] + 1,), None, None)


BROKEN = [
    (1, pendulum(name="two words")),
    (2, pendulum(Unlabelled)),
    (3, pendulum(Unnamed)),
    (4, pendulum(gradient=lambda q: (math.sin(q[0]),), potential=lambda q: -math.cos(q[0]), hessian=None)),
    (5, pendulum(hessian=lambda q: ((2 * q[0] * q[0],),))),
    (6, pendulum(potential=lambda q: q[0] * q[0] / 2, hessian=None)),
    (7, pendulum(Gains, gamma=-0.3)),
    (7, cb.SCENES["particle"].with_(rotation_invariant=True)),
    (8, pendulum(Jumps)),
    (9, pendulum(exact=still)),
    (9, pendulum(exact=elsewhere)),
]


@pytest.mark.parametrize(("rule", "scene"), BROKEN, ids=[f"{rule}-{i}" for i, (rule, _) in enumerate(BROKEN)])
def test_a_broken_rule_is_named(rule, scene):
    with pytest.raises(Violation) as caught:
        check_scene(scene)
    assert caught.value.rule == rule, caught.value


def test_every_rule_has_a_scene_that_breaks_it():
    assert {rule for rule, _ in BROKEN} == set(SCENE_RULES)
