"""Scenes of many sites: what they take, refuse and say, and that they are scenes like any other."""

import copy
import json
import math
import pickle

import numpy as np
import pytest

import contactbench as cb
from cases import refusal
from chains import SMALL, bodies, chain, masses
from contactbench.cli import main
from contactbench.methods import prescribed
from contactbench.testing import check_method, check_scene

FPUT = cb.SCENES["fput"]


def lattice(**changes):
    return lambda: chain(4, **changes)


def particles(**changes):
    return lambda: bodies(3, 2, **changes)


def ensemble(q):
    return lambda: cb.ensemble(chain(4), "rk4", {"q": q}, step=0.5)


#: a call, and a part of its refusal
CALLS = [
    # how many, and where
    (lambda: chain(4).with_(n=0), "n = 0: must be a whole number ≥ 2"),
    (lambda: chain(4).with_(n=8), "q has shape (4,): must be 8 numbers, or a function of the index"),
    (lambda: chain(4, mass=masses(4), q=np.sin, p=np.cos).with_(n=8), "mass has shape (4,): must be"),
    (lattice(boundary="periodic"), "boundary = 'periodic': must be one of ring, fixed, free"),
    (particles(masses=(1.0,)), "masses = (1.0,): must be 2 numbers or more"),
    (lambda: bodies(3, 2).with_(dimensions=4), "dimensions = 4: must be a whole number ≥ 1, at most 3"),
    (particles(q=[[1, 0], [1, 0], [0, 1]]), "q: two bodies are at one place"),
    # initial data
    (lattice(q=[1.0, 2.0]), "q has shape (2,): must be 4 numbers"),
    (lattice(q=[1.0, math.nan, 0.0, 0.0]), "q: must be finite; entry 1 is not"),
    (lattice(q="abc"), "q = 'abc': must be 4 numbers"),
    (lattice(q=lambda i: {}["a"]), "<lambda> (test_many.py, line "),
    (lambda: cb.prepare(bodies(3, 2), "rk4", step=0.1)(q=np.zeros(6)), "two bodies are at one place"),
    # masses, numbers
    (lattice(mass=0), "mass: must be > 0 and finite, and so 1/mass; the least is 0.0"),
    (lattice(mass=[1, 2]), "mass has shape (2,): must be one number > 0, or 4"),
    (lattice(parameters={"k": 1.0, "beta": 1.0}), "parameter 'beta': is taken by none of onsite, bond"),
    # potentials
    (lattice(held=False, bond=None), "needs an onsite potential, a bond, or both"),
    (lattice(bond=lambda r, k: k / r), "bond: must be finite at rest, r = 0, with its derivative"),
    (lattice(bond=lambda r, k: r if r > k else k), "its bond cannot be recorded: `if`"),
    (lattice(bond=lambda r, k: k * math.sin(r)), "math.sin takes plain numbers only: use cb.math.sin"),
    (lattice(bond=lambda r, k: {}["a"]), "KeyError: 'a'"),
    (lattice(bond=lambda r, k: k), "bond: must be one number that depends on its arguments"),
    (lattice(onsite=lambda q: cb.math.log(q - 9)), "potential of scene 'chain' is not finite at the start"),
    (particles(pair=lambda r2: r2), "takes 1 positional argument but 3 were given"),
    (particles(pair=None), "pair = None: must be a function"),
    # what is done with them
    (lambda: cb.solve(chain(4), "rk4", step=0.1, carry=("R",)), "can carry s"),
    (ensemble(np.ones((3, 2))), "q has shape (3, 2): must be (4,) or (4, n)"),
]


@pytest.mark.timeout(60)
@pytest.mark.parametrize(("call", "says"), CALLS, ids=[says for _, says in CALLS])
def test_a_call_is_refused_in_one_line(call, says):
    assert says in refusal(call)


# -- what is taken -------------------------------------------------------------------------------------
def test_data_are_arrays_or_functions_of_the_index():
    index = np.arange(6)
    given = [
        0.1 * index,
        (0.1 * index)[:, None],
        lambda i: 0.1 * i,
        lambda i, n: 0.6 * i / n,
        lambda i: 0.1 * float(i),
        lambda i, a=0.1: a * i,
    ]
    for q in given:
        np.testing.assert_allclose(chain(6, q=q, p=np.zeros(6)).q, 0.1 * index, rtol=1e-15)
    rows = bodies(3, 2, q=lambda i: (i, -i), p=np.zeros((3, 2)))
    assert rows.q.tolist() == [0, 0, 1, -1, 2, -2]


def test_a_function_gets_the_parameters_that_it_names_or_all():
    def total(r, **numbers):
        return numbers["k"] * numbers["b"] * r * r

    own = chain(
        4, onsite=lambda q, k: k * q * q, bond=lambda r, b, k: b * k * r * r, parameters={"k": 2.0, "b": 3.0}
    )
    every = own.with_(bond=total)
    assert [own.named(name).keys() for name in ("onsite", "bond")] == [{"k"}, {"k", "b"}]
    named, given = (cb.solve(scene, "rk4", step=0.1) for scene in (own, every))
    assert named.ok
    np.testing.assert_array_equal(given.y, named.y)


def test_functions_of_the_index_follow_the_number_of_sites():
    scene = FPUT.with_(n=16)
    np.testing.assert_allclose(scene.q, np.sin(2 * np.pi * np.arange(16) / 16), atol=1e-15)
    assert FPUT.with_(gamma=0.3, q=np.ones(64)).q[5] == 1.0
    assert (FPUT.with_(gamma=0.3).q == FPUT.q).all()
    one = chain(4, mass=masses(4)).with_(mass=2.0)
    assert (one.mass, one.inverse_mass, one.constants) == (2.0, 0.5, {})


def test_what_is_given_cannot_be_changed_afterwards():
    q = np.ones(4)
    scene = chain(4, q=q)
    q[:] = 7.0
    assert scene.q.tolist() == [1.0] * 4
    with pytest.raises(ValueError, match="read-only"):
        scene.q[0] = 2.0


# -- as an object --------------------------------------------------------------------------------------
def test_it_equals_what_has_the_same_values():
    scene = chain(4, mass=masses(4))
    assert scene == chain(4, mass=masses(4))
    assert copy.deepcopy(scene) is scene
    for change in {
        "gamma": 0.3,
        "q": np.ones(4),
        "mass": 1.0,
        "k": 2.0,
        "boundary": "free",
        "s": 0.0,
    }.items():
        assert scene != scene.with_(**dict([change]))
    assert scene != cb.SCENES["particle"]


@pytest.mark.parametrize(
    "scene", [FPUT, chain(4, bond=lambda r, k: k * r * r, q=lambda i: 0.1 * i), bodies(3, 2)]
)
def test_it_is_pickled_with_its_functions(scene):
    twin = pickle.loads(pickle.dumps(scene))
    assert twin.q.tolist() == scene.q.tolist()
    run = cb.prepare(scene, "contact-strang", step=scene.t_end / 10)
    np.testing.assert_array_equal(cb.solve(twin, "contact-strang", step=scene.t_end / 10).y, run().y)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(run))().y, run().y)


def test_a_function_of_the_index_is_pickled_where_it_can_be():
    assert pickle.loads(pickle.dumps(FPUT)).with_(n=8).sites == 8
    with pytest.raises(cb.BadInput, match="must be 8 numbers"):
        pickle.loads(pickle.dumps(chain(4, q=lambda i: 0.1 * i, p=np.cos))).with_(n=8)


@pytest.mark.parametrize("setting", [{"step": 1e-3}, {"rtol": 1e-6}])
def test_saved_times_take_no_gigabytes(setting, monkeypatch):
    monkeypatch.setattr(prescribed, "MOST_SAVED", 16 * 50)
    method = "rk4" if "step" in setting else "scipy-dop853"
    run = cb.prepare(chain(8), method, **setting)
    assert 25 <= len(run.request.save_at) <= 51
    assert len(cb.prepare(chain(512), method, **setting).request.save_at) == 2


# -- the contract --------------------------------------------------------------------------------------
@pytest.mark.parametrize("scene", [SMALL["free masses"], SMALL["bodies 2D"]])
@pytest.mark.parametrize("method", ["contact-strang", "scipy-dop853"])
@pytest.mark.slow
def test_methods_keep_their_rules_on_it(method, scene):
    check_method(cb.METHODS[method], engines=cb.METHODS[method].engines[:1], scenes=[scene.with_(t_end=4.0)])


def test_a_component_that_does_not_solve_the_equations_is_noticed():
    ring = cb.SCENES["linear_ring"]
    check_scene(ring.with_(n=8))
    with pytest.raises(AssertionError, match="rule 9"):
        check_scene(ring.with_(n=8, bond=lambda r: 0.4999 * r * r))


# -- the command line ----------------------------------------------------------------------------------


def test_command_line_prints_json_and_a_few_numbers_of_many(capsys):
    assert main(["solve", "fput", "contact-rkn6", "--step", "0.1", "--json"]) == 0
    out = json.loads(capsys.readouterr().out)
    assert len(out["state"]) == 129
    assert out["J"][0] == pytest.approx(64 * 0.3 * math.exp(-1e-3 * 20), rel=1e-12)
    assert main(["solve", "fput", "rk4", "--step", "0.1"]) == 0
    (state,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith("state"))
    assert ("'q4': " in state, "q5" in state) == (True, False)


def test_functions_of_the_package_stand_for_a_users_own():
    """They capture themselves: asking where they were written went on without end."""
    own = {"name": "ring", "n": 4, "q": (1.0, 0.0, 0.0, 0.2), "p": (0.0,) * 4, "gamma": 0.1, "t_end": 1.0}
    bare, wrapped = (cb.Lattice(onsite=cos, **own) for cos in (cb.math.cos, lambda q: cb.math.cos(q)))
    for method in ("contact-rkn6", "rk4"):
        y, z = (cb.solve(scene, method, step=0.1).y for scene in (bare, wrapped))
        np.testing.assert_array_equal(y, z)
