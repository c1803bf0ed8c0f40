"""Scenes that differ in one thing a program depends on, solved in one process: neither gets the other's program."""

import itertools

import numpy as np
import pytest

import contactbench as cb
from cases import TILTED


def quartic(q, a=1.0, b=0.5):
    return sum(a * c * c / 2 + b * c * c * c * c / 4 for c in q)


def force(q, a=1.0, b=0.5):
    return tuple(a * c + b * c * c * c for c in q)


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


SPUN = {"inertia": (1.0, 1.7, 2.1), "M": (0.8, 0.9, -0.5), "s": 0.2}
BODY = cb.SCENES["rigid_body"].with_(gamma=0.25, t_end=2.0, **SPUN)
AXES = (0.1, 0.2, 0.3)
STIFFER = {"potential": lambda q: sum(c * c for c in q), "gradient": lambda q: tuple(2 * c for c in q)}
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
    "potential": [(WELL, None), (WELL.with_(**STIFFER), None)],
    # functions of the package are not recorded: the rest of the key is to tell these apart
    "names of our parameters": [
        (SPRING.with_(parameters=p), None)
        for p in ({"omega": 3.0, "coupling": 0.4}, {"coupling": 0.4, "omega": 3.0})
    ],
    "our potential": [(cb.SCENES[name].with_(t_end=2.0), None) for name in ("particle", "central")],
    "rate": [(driven(rate), None) for rate in RATES],
    "damping": [(damped(*damping), None) for damping in DAMPINGS],
}
ENGINES = {"contact-strang": "llvm", "contact-exact": "llvm", "cvode-bdf": "c", "cyrk-dop853": "c++"}
ENGINES |= {"heyoka-taylor": "llvm", "diffrax-tsit5": "jax"}


def last_state(scene, carry, name, engine):
    method, options = cb.METHODS[name], {"engine": engine, "carry": carry, "save_at": [scene.t_end]}
    setting = {} if method.exact else {"rtol": 1e-9} if method.adaptive else {"step": 0.1}
    return cb.solve(scene, name, **options, **setting).y[-1]


@pytest.mark.parametrize("order", ["forwards", "backwards"])
@pytest.mark.parametrize("what", PAIRS)
@pytest.mark.quick(order="forwards")
def test_no_scene_gets_the_program_of_another(what, order, fresh):
    """Compiled, whichever of them is solved first, against Python, which knows of no other scene."""
    cases, ends = [], []
    for scene, carry in PAIRS[what][:: 1 if order == "forwards" else -1]:
        fresh()
        ends.append(last_state(scene, carry, "scipy-dop853", "python"))
        for name, engine in ENGINES.items():
            if cb.METHODS[name].refuses(scene) or (engine == "jax" and what != "fields"):  # XLA takes seconds
                continue
            own = "python" in cb.METHODS[name].engines
            alone = last_state(scene, carry, name, "python") if own else ends[-1]
            cases.append((scene, carry, name, engine, alone, 1e-12 if own else 1e-6))
    fresh()
    for *case, alone, off in cases:
        np.testing.assert_allclose(last_state(*case), alone, rtol=0, atol=off, err_msg=str(case[2:]))
    for a, b in itertools.combinations(ends, 2):  # names in two orders: one motion
        assert "names" in what or len(a) != len(b) or np.abs(a - b).max() > 1e-3, "one is seen for the other"
