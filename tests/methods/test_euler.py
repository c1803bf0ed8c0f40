"""Symplectic Euler with the damping treatments of game engines."""

import math

import numpy as np
import pytest

import contactbench as cb
from contactbench.methods.euler import TREATMENTS
from contactbench.runs import limits

#: −log(d)/h
RATES = {
    "euler-explicit-damping": lambda g, h: -math.log1p(-g * h) / h,
    "euler-implicit-damping": lambda g, h: math.log1p(g * h) / h,
    "euler-contact": lambda g, h: g,
}


def test_the_explicit_one_is_the_first_contact_variational_integrator():
    runs = [cb.solve("particle", name, step=0.1).y for name in ("euler-explicit-damping", "herglotz1")]
    np.testing.assert_allclose(*runs, rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", TREATMENTS)
def test_rates_measured_on_a_falling_body(name):
    factor = cb.METHODS[name].conformal_factor(cb.SCENES["particle"], 0.1)
    assert -math.log(factor) / 0.1 == pytest.approx(RATES[name](cb.SCENES["particle"].gamma, 0.1), rel=1e-13)
    rows = [row for _, row in limits.ticks.rows((name,), None)]
    assert len(rows) == len(limits.TICKS) * len(limits.DRAGS)
    for row in rows:
        g, h = row["gamma"], 1 / row["setting"]
        explicit = name == "euler-explicit-damping"
        true = math.inf if explicit and g * h >= 1 else RATES[name](g, h)
        assert row["measured"] == pytest.approx(true, rel=1e-11)
