"""Two solvers in double precision agree as far as they say, where high precision takes too long."""

import importlib

import numpy as np
import pytest

import contactbench as cb
from cases import few_slow, mine
from chains import bodies, chain, masses
from contactbench.truth import OutOfTime, two_solvers


def digits(found, true):
    return -np.log10(np.abs(found - true).max() / np.abs(true).max())


LIVE = {
    "ring": chain(8, t_end=1.5),
    "free": chain(8, "free", mass=masses(8), t_end=1.5),
    "bodies": bodies(3, 3, t_end=1.5),
    "damped": chain(8, "fixed", gamma=6.0, t_end=1.5),
}


@pytest.mark.parametrize("name", few_slow(LIVE, "ring", "damped", "free"))
def test_two_solvers_in_doubles_have_the_digits_that_they_say(name):
    """Against 30 digits by other engines, component by component."""
    scene, times = LIVE[name], np.array([0.2, 0.4])
    found, known = two_solvers.doubles(scene, times, ("s",), np.inf)
    true = cb.reference(scene, times)
    assert true.digits >= 20
    assert digits(found, true.y) >= known >= 10


@pytest.mark.filterwarnings("error")
def test_what_leaves_has_no_reference():
    scene = mine(lambda q: -(q[0] ** 4), 2.0, t_end=20.0, gamma=0.1)
    with pytest.raises(cb.BadInput, match="cannot be followed to t = 20"):
        two_solvers.doubles(scene, np.array([20.0]), (), np.inf)


def test_a_reference_out_of_time_says_so():
    with pytest.raises(cb.BadInput, match="allow it more"):
        cb.reference(chain(64, t_end=1e5), [1e5], seconds=0.5)


def test_where_high_precision_is_late_two_solvers_take_over(monkeypatch):
    module = importlib.import_module("contactbench.truth.reference")

    def late(*_, **__):
        raise OutOfTime("late")

    monkeypatch.setattr(module, "live", late)
    found = cb.reference(chain(6), [0.9])
    assert (found.source, found.decimals) == ("two solvers", [])
    assert found.digits >= 10
