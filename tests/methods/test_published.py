"""Problems whose digits are published, or known by two solvers, by methods of every kind."""

import numpy as np
import pytest

import contactbench as cb
from chains import PLEIADES

cos = cb.math.cos

#: Mazzia, Magherini, Test Set for Initial Value Problem Solvers, release 2.4: x₁ … x₇, y₁ … y₇ at t = 3
PLEIADES_AT_3 = (
    *(0.3706139143970502, 3.237284092057233, -3.222559032418324, 0.6597091455775310),
    *(0.3425581707156584, 1.562172101400631, -0.7003092922212495),
    *(-3.943437585517392, -3.271380973972550, 5.225081843456543, -2.590612434977470),
    *(1.198213693392275, -0.2429682344935824, 1.091449240428980),
)


@pytest.mark.parametrize(
    ("method", "setting"),
    [
        ("contact-rkn8", {"step": 2.5e-4}),
        ("contact-log8", {"step": 1e-3}),
        ("contact-log8", {"rtol": 1e-10}),
        ("rkn12", {"step": 4e-4}),
        ("rkn12", {"rtol": 1e-10}),
        ("rkn12-10", {"rtol": 1e-13}),
        ("rk8-7", {"rtol": 1e-13}),
        ("cyrk-dop853", {"rtol": 1e-13}),
        ("heyoka-taylor", {"rtol": 1e-15}),
    ],
)
def test_the_pleiades(method, setting):
    """Close encounters multiply a rounding by 10⁴."""
    run = cb.solve(PLEIADES, method, save_at=[3.0], carry=(), **setting)
    true = np.reshape(PLEIADES_AT_3, (2, 7)).T.ravel()
    np.testing.assert_allclose(run.q[-1], true, rtol=0, atol=max(5e-11, 10 * setting.get("rtol", 0)))


def reactions(t, y):
    a, b, c, d, e, f, g, h = y
    return (
        -1.71 * a + 0.43 * b + 8.32 * c + 0.0007,
        1.71 * a - 8.75 * b,
        -10.03 * c + 0.43 * d + 0.035 * e,
        8.32 * b + 1.71 * c - 1.12 * d,
        -1.745 * e + 0.43 * f + 0.43 * g,
        -280 * f * h + 0.69 * d + 1.71 * e - 0.43 * f + 0.69 * g,
        280 * f * h - 1.81 * g,
        -280 * f * h + 1.81 * g,
    )


HIRES = cb.Equations(name="hires", rhs=reactions, y0=(1.0, *[0.0] * 6, 0.0057), t_end=321.8122)
#: Mazzia, Magherini, as above
HIRES_AT_THE_END = (
    *(7.371312573325668e-4, 1.442485726316185e-4, 5.888729740967575e-5, 1.175651343283149e-3),
    *(2.386356198831331e-3, 6.238968252742796e-3, 2.849998395185769e-3, 2.850001604814231e-3),
)


@pytest.mark.parametrize(
    ("method", "setting", "tolerance"),
    [
        ("rk8", {"step": 0.02}, 1e-12),
        ("rk8-7", {"rtol": 1e-13}, 1e-11),
        ("heyoka-taylor", {"rtol": 1e-15}, 1e-12),
    ],
)
def test_hires(method, setting, tolerance):
    run = cb.solve(HIRES, method, save_at=[HIRES.t_end], **setting)
    np.testing.assert_allclose(run.y[-1, :8], HIRES_AT_THE_END, rtol=tolerance)


#: a pendulum that stands on its head, its support shaken up and down ω times as fast as it swings
SHAKEN = cb.Driven(
    name="kapitza",
    potential=lambda q, t, a, w: (1 - a * w * w * cos(w * t)) * -cos(q[0]),
    parameters={"a": 0.1, "w": 50.0},
    q=(np.pi - 0.1,),
    p=(0.0,),
    gamma=0.0,
    t_end=10.0,
)


def test_kapitza_s_pendulum():
    """It swings about the upper end, slowly, by Ω² = (aω)²/2 − 1 up to terms of order a and the amplitude squared."""
    times = np.linspace(0.05, 10.0, 200)
    true = cb.solve(SHAKEN, "scipy-dop853", rtol=1e-13, atol=1e-13, save_at=times)
    slow = np.sqrt((0.1 * 50.0) ** 2 / 2 - 1)
    assert np.abs(true.q[:, 0] - np.pi).max() < 0.13
    np.testing.assert_allclose(true.q[:, 0] - np.pi, -0.1 * np.cos(slow * times), atol=0.05)
    for method, setting in [
        ("contact-rkn8", {"rtol": 1e-8}),
        ("contact-rkn6", {"step": 0.002}),
        ("contact-gauss4", {"rtol": 1e-8}),
        ("rkn12", {"rtol": 1e-8}),
        ("rk8-7", {"rtol": 1e-12}),
    ]:
        run = cb.solve(SHAKEN, method, save_at=times, **setting)
        assert run.ok, method
        np.testing.assert_allclose(run.q, true.q, rtol=0, atol=1e-8)
    still = cb.solve(SHAKEN.with_(parameters={"a": 0.0, "w": 50.0}), "rk8-7", rtol=1e-10, save_at=times)
    assert np.abs(still.q[:, 0] - np.pi).max() > 3
