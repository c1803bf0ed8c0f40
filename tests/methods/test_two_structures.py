"""Scenes that differ in one thing a program depends on, solved in one process: neither gets the other's program.

Run as a script it solves all of them, forwards or backwards, and prints the last states.
"""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

import contactbench as cb
from cases import TILTED


def quartic(q, a=1.0, b=0.5):
    return sum(a * c * c / 2 + b * c * c * c * c / 4 for c in q)


def force(q, a=1.0, b=0.5):
    return tuple(a * c + b * c * c * c for c in q)


def stiffer(q):
    return sum(c * c for c in q)


def stiffer_force(q):
    return tuple(2 * c for c in q)


START = {"q": (0.8,), "p": (0.3,), "s": 0.4, "t_end": 2.0}
FORCE = {"potential": quartic, "gradient": force}
SHAKEN = {
    "potential": lambda q, t: quartic(q) - 0.3 * q[0] * cb.math.cos(t),
    "gradient": lambda q, t: (force(q)[0] - 0.3 * cb.math.cos(t),),
}


RATES = (lambda t: 0.2 + 0.1 * cb.math.sin(t)), (lambda t: 0.3 - 0.1 * cb.math.cos(t))
DAMPINGS = [(lambda s: 0.2 * s, lambda s: 0.2), (lambda s: 0.2 * s + s * s * s, lambda s: 0.2 + 3 * s * s)]


def driven(rate):
    return cb.Driven(name="driven", **SHAKEN, rate=rate, **START)


def damped(damping, slope):
    return cb.GeneralDamping(name="damped", **FORCE, damping=damping, damping_slope=slope, **START)


BODY = cb.SCENES["rigid_body"].with_(
    inertia=(1.0, 1.7, 2.1), gamma=0.25, M=(0.8, 0.9, -0.5), s=0.2, t_end=2.0
)
AXES = (0.1, 0.2, 0.3)
WELL = cb.Mechanical(name="well", **FORCE, gamma=0.2, **START)
SPRING = cb.SCENES["stiff_spring"].with_(t_end=2.0)
#: what differs: two scenes or more, and the fields each is to carry
PAIRS = {
    "order of the inertias": [
        (BODY.with_(inertia=i), None) for i in ((1.0, 1.7, 2.1), (2.1, 1.0, 1.7), (1.7, 2.1, 1.0))
    ],
    "kind of damping": [(BODY, None), *((BODY.with_(damping=d), None) for d in (AXES, TILTED.damping))],
    "fields of a body": [(BODY, ()), (BODY, ("s",)), (BODY, ("R",)), (BODY, ("R", "s"))],
    "sign of kappa": [(WELL.with_(kappa=k), None) for k in (0.0, 0.3, -0.2)],
    "fields": [(WELL, ()), (WELL, ("s",))],
    "numbers": [(WELL, None), (WELL.with_(gamma=0.5), None)],
    "names of parameters": [
        (WELL.with_(parameters=p), None) for p in ({}, {"a": 1.5, "b": 0.2}, {"b": 0.2, "a": 1.5}, {"b": 0.2})
    ],
    "components": [(WELL.with_(q=q, p=q[::-1]), None) for q in ((0.8,), (0.8, 0.5), (0.8, 0.5, 0.3))],
    "potential": [(WELL, None), (WELL.with_(potential=stiffer, gradient=stiffer_force), None)],
    # functions of the package are not recorded: the rest of the key is to tell these apart
    "names of our parameters": [
        (SPRING.with_(parameters=p), None)
        for p in ({"omega": 3.0, "coupling": 0.4}, {"coupling": 0.4, "omega": 3.0})
    ],
    "our potential": [(cb.SCENES[name].with_(t_end=2.0), None) for name in ("particle", "central")],
    "rate": [(driven(rate), None) for rate in RATES],
    "damping": [(damped(*damping), None) for damping in DAMPINGS],
}
#: compiled by XLA for seconds; see `test_no_ensemble_on_jax_gets_the_program_of_another`
ON_JAX = [(what, "contact-strang") for what in ("order of the inertias", "sign of kappa")]
ON_JAX += [("fields", "diffrax-tsit5")]
ENGINES = [(name, "numba") for name in ("contact-strang", "contact-adaptive", "contact-exact")]
ENGINES += [("cvode-bdf", "c"), ("cyrk-tsit5", "c++"), ("heyoka-taylor", "llvm")]
ENGINES += [("contact-strang", "jax"), ("diffrax-tsit5", "jax")]
SOLVES = [
    (what, k, name, engine)
    for what, scenes in PAIRS.items()
    for k in range(len(scenes))
    for name, engine in ENGINES
    if cb.METHODS[name].refuses(scenes[k][0]) is None and (engine != "jax" or (what, name) in ON_JAX)
]


def setting(name):
    method = cb.METHODS[name]
    return {} if method.exact else {"rtol": 1e-9} if method.adaptive else {"step": 0.1}


def last_state(what, k, name, engine):
    scene, carry = PAIRS[what][k]
    return cb.solve(scene, name, engine=engine, carry=carry, save_at=[scene.t_end], **setting(name)).y[-1]


def both_ways():
    """What each solve ends in, in two processes: one after the other forwards, and backwards."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    started = [
        subprocess.Popen(
            [sys.executable, __file__, order], stdout=subprocess.PIPE, text=True, env=environment
        )
        for order in ("forwards", "backwards")
    ]
    outputs = [process.communicate(timeout=500)[0] for process in started]
    assert [process.returncode for process in started] == [0, 0]
    return [{tuple(solve): np.array(y) for solve, y in json.loads(output)} for output in outputs]


def test_no_scene_gets_the_program_of_another():
    forwards, backwards = both_ways()
    assert forwards.keys() == backwards.keys()
    for solve, y in forwards.items():
        what, k, name, _ = solve
        np.testing.assert_array_equal(y, backwards[solve], err_msg=str(solve))
        alone = "python" in cb.METHODS[name].engines
        expected = last_state(what, k, *((name, "python") if alone else ("scipy-dop853", "python")))
        np.testing.assert_allclose(y, expected, rtol=0, atol=1e-12 if alone else 1e-6, err_msg=str(solve))


@pytest.mark.parametrize("what", [what for what in PAIRS if "names" not in what])  # in two orders: one motion
def test_the_scenes_of_a_pair_move_differently(what):
    """Or the other test would not see one for the other."""
    ends = [last_state(what, k, "scipy-dop853", "python") for k in range(len(PAIRS[what]))]
    for i, a in enumerate(ends):
        for b in ends[:i]:
            assert len(a) != len(b) or np.abs(a - b).max() > 1e-3


if __name__ == "__main__":
    chosen = SOLVES if sys.argv[1] == "forwards" else SOLVES[::-1]
    print(json.dumps([[solve, last_state(*solve).tolist()] for solve in chosen]))
