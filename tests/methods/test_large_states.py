"""States of many numbers: stages in a loop over rows, points before in a ring of them."""

import math

import numpy as np
import pytest

import contactbench as cb
from chains import chain

FIXED = ("rk8", "rkn8", "rkn12", "quinlan-tremaine8", "quinlan-tremaine12")
PAIRS = ("rk8-7", "rkn8-6", "rkn12-10")
LARGE = chain(14).recorded()


def driven(t_end=1.0):
    """A chain whose damping changes in time."""
    held = LARGE.potential
    return cb.Driven(
        name="driven-chain",
        potential=lambda q, t, k: held(q, k=k) + cb.math.cos(t) * q[0],
        rate=lambda t, k: 0.1 + 0.05 * cb.math.sin(t),
        q=LARGE.q,
        p=LARGE.p,
        parameters={"k": 1.5},
        t_end=t_end,
    )


@pytest.mark.parametrize(
    "carry", [("s",), pytest.param((), marks=pytest.mark.slow)], ids=["action", "motion"]
)
@pytest.mark.parametrize("name", FIXED)
def test_stages_in_a_loop_take_the_steps_of_stages_written_out(name, carry):
    method, h, n = cb.METHODS[name], 0.02, 12
    end = method.advance(LARGE, LARGE.initial(carry), h, n, math)
    for engine in ("llvm", "python"):
        found = cb.solve(LARGE, name, step=h, save_at=[h * n], carry=carry, engine=engine)
        assert found.y[-1] == pytest.approx(LARGE.pack(end), rel=1e-12, abs=1e-13)


@pytest.mark.parametrize("scene", [LARGE, driven()], ids=["constant damping", "changing damping"])
@pytest.mark.parametrize("name", ["rkn12", *PAIRS])
@pytest.mark.quick(name="rkn12-10")
@pytest.mark.quick(name="rk8-7", scene="driven-chain")
def test_they_are_as_accurate_on_every_chain(name, scene):
    setting = {"rtol": 1e-10} if name in PAIRS else {"step": 0.1}
    true = cb.solve(scene, "contact-rkn8", step=0.005, save_at=[0.5, 1.0])
    found = cb.solve(scene, name, save_at=[0.5, 1.0], **setting)
    assert found.y == pytest.approx(true.y, abs=1e-9)


def test_a_tangent_goes_through_the_rows():
    run = cb.prepare(LARGE, "rkn8", step=0.1, save_at=[1.0], carry=())
    v = np.eye(28)[3]
    ends = [run.integrate(run.start + amount * v).y[-1] for amount in (1e-5, -1e-5)]
    assert run.sensitivity(run.start)[-1][:, 3] == pytest.approx((ends[0] - ends[1]) / 2e-5, abs=1e-8)
