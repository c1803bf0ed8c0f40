"""The truth of many sites: modes of a ring in closed form, and two solvers that agree as far as they say."""

import importlib
from time import perf_counter

import numpy as np
import pytest

import contactbench as cb
from cases import few_slow
from chains import bodies, chain, masses
from contactbench.truth import OutOfTime, many

RING = cb.SCENES["linear_ring"]
TIMES = [0.0, 0.7, 5.0]
#: springs: modes that swing, one at its critical damping (ω_k = 2 sin(πk/8) = γ/2 at k = 2), all overdamped, none
#: damped, other masses
CASES = [
    {},
    {"gamma": 2.0 * np.sqrt(2.0)},
    {"gamma": 9.0},
    {"gamma": 0.0},
    {"gamma": 1.0, "mass": 3.7},
    {"gamma": -0.3, "mass": 0.2},
    {"n": 7, "gamma": 1.1},
    {"n": 2},
]


def digits(found, true):
    return -np.log10(np.abs(found - true).max() / np.abs(true).max())


@pytest.mark.parametrize("change", few_slow(CASES, *CASES[2::2]), ids=str)
def test_the_modes_of_a_ring_are_its_motion(change):
    ring = RING.with_(**{"n": 8, "s": 0.4} | change)
    true = cb.reference(ring.with_(exact=None), TIMES)
    assert (true.source, true.digits >= 20) == ("live", True)
    found = cb.reference(ring, TIMES)
    assert found.source == "closed form"
    assert digits(found.y, true.y) > found.digits
    for carry in ((), ("s",)):
        expected = found.y[:, : 2 * ring.n + len(carry)]
        np.testing.assert_array_equal(cb.reference(ring, TIMES, carry).y, expected)


def test_the_closed_form_takes_any_number_of_sites():
    ring = RING.with_(n=10**5, t_end=1.0)
    run = cb.solve(ring, "contact-rkn8", step=0.05, save_at=[1.0])
    assert cb.LAWS["solution_error"](run) < 1e-12


LIVE = {
    "ring": chain(8, t_end=1.5),
    "free": chain(8, "free", mass=masses(8), t_end=1.5),
    "bodies": bodies(3, 3, t_end=1.5),
    "damped": chain(8, "fixed", gamma=6.0, t_end=1.5),
}


@pytest.mark.parametrize("name", few_slow(LIVE, "ring", "damped"))
def test_two_solvers_in_doubles_have_the_digits_that_they_say(name):
    """Against 30 digits by other engines, component by component."""
    scene, times = LIVE[name], np.array([0.3, 0.8, 1.5])
    found, known = many.doubles(scene, times, ("s",), perf_counter() + 60)
    true = cb.reference(scene, times)
    assert true.digits >= 20
    assert digits(found, true.y) >= known >= 10


def test_a_large_scene_has_a_reference_with_the_digits_that_it_says():
    scene = chain(200, t_end=2.0)
    found = cb.reference(scene, [2.0, 1.0])
    assert (found.source, found.t.tolist(), found.decimals) == ("two solvers", [2.0, 1.0], [])
    assert 10 <= found.digits <= 15
    finer = cb.solve(scene, "contact-rkn8", step=0.02, save_at=[1.0, 2.0])
    assert digits(finer.y[::-1], found.y) > 10


@pytest.mark.filterwarnings("error")
def test_what_leaves_has_no_reference():
    scene = chain(100, onsite=lambda q: -q * q * q * q, q=np.full(100, 2.0), t_end=20.0)
    with pytest.raises(cb.BadInput, match="cannot be followed to t = 20"):
        cb.reference(scene, [20.0])


def test_a_reference_out_of_time_says_so():
    with pytest.raises(cb.BadInput, match="allow it more"):
        cb.reference(chain(3000, t_end=1e4), [1e4], seconds=0.5)


def test_where_high_precision_is_late_two_solvers_take_all_sites_at_once(monkeypatch):
    module, solved = importlib.import_module("contactbench.truth.reference"), []

    def late(*_, **__):
        raise OutOfTime("late")

    def doubles(scene, *more):
        solved.append(scene)
        return many.doubles(scene, *more)

    monkeypatch.setattr(module, "live", late)
    monkeypatch.setattr(module, "doubles", doubles)
    assert cb.reference(chain(6), [0.9]).source == "two solvers"
    assert isinstance(solved[0], cb.Lattice)
