"""A composition from one's own coefficients: let in only if it is what it says."""

from __future__ import annotations

import numpy as np
import pytest

import contactbench as cb
from contactbench.measure.laws import LAWS
from contactbench.splitting.tables import COMPOSITIONS

pytestmark = pytest.mark.usefixtures("registries")
#: those whose stages are kicks and drifts in turn, without a processor
PLAIN = [c for c in COMPOSITIONS if c.two_part and not c.processor]


def lists(known):
    """Its coefficients as a user has them: floats."""
    return {
        "kick": [float(c) for name, c in known.stages if name == "kick"],
        "drift": [float(c) for name, c in known.stages if name == "drift_damp"],
    }


@pytest.mark.parametrize("known", PLAIN, ids=lambda c: c.name)
def test_printed_coefficients_give_the_same_method(known):
    mine = cb.composition("mine", known.order, **lists(known), nystrom=known.nystrom)
    assert cb.METHODS["mine"] is mine
    assert (mine.family, mine.contact, mine.symmetric) == ("contact", True, True)
    ours, theirs = (cb.solve("central", name, step=0.5, save_at=[10.0]) for name in ("mine", known.name))
    np.testing.assert_allclose(ours.y, theirs.y, rtol=1e-12, atol=1e-12)
    assert LAWS["contact_drift"](ours) < 1e-12
    assert sum(c for name, c in mine.composition.stages if name == "kick") == 1  # whatever was rounded


@pytest.mark.parametrize("known", [c for c in PLAIN if c.order > 2], ids=lambda c: c.name)
def test_a_wrong_coefficient_is_not_let_in(known):
    wrong = lists(known)
    wrong["kick"][1] += 1e-3
    wrong["kick"][-2] -= 1e-3
    with pytest.raises(cb.BadInput, match=rf"order = {known.order}: measured [0-9.]+ on particle"):
        cb.composition("mine", known.order, **wrong, nystrom=known.nystrom)
    assert "mine" not in cb.METHODS


def test_an_order_is_neither_too_high_nor_too_low():
    for order in (1, 3, 4):
        with pytest.raises(cb.BadInput, match=rf"order = {order}: measured (1\.9|2\.0)"):
            cb.composition("mine", order, kick=[0.5, 0.5], drift=[1])


def test_a_nystrom_composition_must_say_so():
    known = next(c for c in PLAIN if c.nystrom)
    with pytest.raises(cb.BadInput, match="on rigid_body; nystrom=True"):
        cb.composition("mine", known.order, **lists(known))


@pytest.mark.parametrize(
    ("kick", "drift", "first"),
    [(["1/2", "1/2"], [1], "kick"), ([1], [0.5, 0.5], "drift_damp"), ([1], [1], "kick")],
)
def test_the_longer_list_begins(kick, drift, first):
    order = 1 if len(kick) == len(drift) else 2
    mine = cb.composition("mine", order, kick, drift)
    assert mine.composition.stages[0][0] == first
    assert mine.symmetric == (order == 2)
    for scene in ("particle", "rigid_body", "rigid_body_anisotropic"):
        assert cb.solve(scene, "mine", step=0.1, save_at=[1.0]).ok


BAD = {
    "sum": ({"kick": [0.5, 0.6]}, "kick: coefficients add up to 1.1, must be 1"),
    "sum by little": ({"kick": [0.5, "0.5000000001"]}, "kick: coefficients add up to 1.0000000001"),
    "lengths": ({"kick": [0.5, 0.25, 0.25]}, "kick has 3 coefficients and drift 1"),
    "number": ({"kick": [0.5, "x"]}, "kick[1] = 'x': must be a number"),
    "inf": ({"drift": [float("inf")]}, "drift[0] = inf: must be a number"),
    "empty": ({"kick": []}, "kick = []: must have at least one coefficient"),
    "order": ({"order": 2.5}, "order = 2.5: must be a whole number"),
    "taken": ({"name": "rk4"}, "method 'rk4' is already registered"),
}


@pytest.mark.parametrize(("changes", "says"), BAD.values(), ids=BAD)
def test_bad_input_is_named(changes, says):
    strang = {"name": "mine", "order": 2, "kick": [0.5, 0.5], "drift": [1]}
    with pytest.raises(cb.BadInput) as caught:
        cb.composition(**strang | changes)
    assert says in str(caught.value)
