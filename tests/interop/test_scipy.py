"""`cb.scipy.Contact` inside SciPy's own `solve_ivp`."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import contactbench as cb
from cases import FIXED, PULSATING, by_name, pairs

#: Herglotz's steps are merged in a run of `cb.solve`, and agree to round-off, as do those that iterate
MERGED = [m for m in FIXED if m.one_step and not m.iterates and m.family != "variational"]
#: those whose compiled loop sums the terms of s in another order than one step alone does; with forces in time, any
#: may: the compiler joins products and sums of the force into what is around it
OTHERWISE, ROUNDINGS = ("rkn8", "rkn12"), 4 * np.finfo(float).eps
SCENES = [*map(cb.SCENES.get, ("particle", "quadratic_damping", "rigid_body_anisotropic")), PULSATING]
SCENES += [cb.SCENES["spherical_pendulum"]]
START = {"q": (1.0,), "p": (0.0,), "gamma": 0.1, "t_end": 2.0}


def run(solver, t_end=2.0, max_step=0.13, t0=0.0, y0=None, **options):
    start = solver.start if y0 is None else y0
    return solve_ivp(solver.rhs, (t0, t0 + t_end), start, method=solver, max_step=max_step, **options)


def last(scene, method, **options):
    """The end of a run of `cb.solve`, the time left out."""
    y = cb.solve(scene, method, save_at=[2.0], **options).y[-1]
    return y if scene.clock is None else np.delete(y, scene.clock)


@pairs(MERGED, SCENES)
@pytest.mark.quick(scene="particle", method=("contact-abc", "contact-strang", "contact-rkn8", "rk4"))
@pytest.mark.quick(scene=("pulsating", "spherical_pendulum"), method="contact-rkn6")
def test_a_run_has_the_bits_of_solve(scene, method):
    """At an h that does not divide the time, too: 16 equal steps."""
    found = run(cb.scipy.Contact(method.name, scene), t0=getattr(scene, "t", 0.0))
    assert found.success
    assert len(found.t) == 17
    end = last(scene, method.name, step=0.13)
    otherwise = method.name in OTHERWISE or scene.clock is not None
    roundings = ROUNDINGS * np.abs(end).max() if otherwise else 0.0
    np.testing.assert_allclose(found.y[:, -1], end, rtol=0, atol=roundings)


def test_a_body_with_isotropic_damping_agrees_to_round_off():
    scene = cb.SCENES["rigid_body"]
    found = run(cb.scipy.Contact("contact-strang", scene))
    np.testing.assert_allclose(found.y[:, -1], last(scene, "contact-strang", step=0.13), rtol=0, atol=5e-14)


def test_carry_and_initial_data_are_the_users_own():
    solver = cb.scipy.Contact("contact-rkn6", "particle", carry=())
    found = run(solver, y0=[0.5, 0.2, 0.0, 0.1], max_step=0.1)
    scene = cb.SCENES["particle"].with_(q=(0.5, 0.2), p=(0.0, 0.1))
    np.testing.assert_array_equal(found.y[:, -1], last(scene, "contact-rkn6", step=0.1, carry=()))
    assert solver.labels == ["q1", "q2", "p1", "p2"]


@by_name([PULSATING])
def test_time_runs_backwards(scene):
    solver, t0 = cb.scipy.Contact("contact-rkn8", scene), getattr(scene, "t", 0.0)
    there = run(solver, t0=t0).y[:, -1]
    back = solve_ivp(solver.rhs, (t0 + 2.0, t0), there, method=solver, max_step=0.13)
    np.testing.assert_allclose(back.y[:, -1], solver.start, rtol=0, atol=1e-14)


@by_name([PULSATING])
def test_dense_output_is_of_sixth_order_and_meets_the_steps(scene):
    """Measured: 2^5.97 and 2^5.99 from one step to its half."""
    times = np.linspace(0.0, 2.0, 101)
    solver, t0 = cb.scipy.Contact("contact-o8", scene), getattr(scene, "t", 0.0)
    truth, errors = run(solver, max_step=0.005, t_eval=t0 + times, t0=t0).y, []
    for h in (0.2, 0.1):
        found = run(solver, max_step=h, dense_output=True, t0=t0)
        np.testing.assert_allclose(found.sol(found.t), found.y, rtol=0, atol=1e-14)
        errors.append(np.abs(found.sol(t0 + times) - truth).max())
    assert 5.7 < np.log2(errors[0] / errors[1]) < 6.5
    assert errors[1] < 2e-9


def test_events_are_found():
    exact = cb.SCENES["oscillator"]

    def crossing(t, y):
        return y[0]

    crossing.terminal = True
    found = run(cb.scipy.Contact("contact-rkn8", exact), max_step=0.05, t_end=20.0, events=crossing)
    assert found.status == 1
    near = cb.reference(exact, [found.t_events[0][0]])
    assert abs(near.y[0][0]) < 1e-10


def test_a_spline_as_a_force_runs_on_floats_with_a_cubic_interpolant():
    x = np.linspace(-3, 3, 4001)
    energy = CubicSpline(x, x**2 / 2)
    force = energy.derivative()
    scene = cb.Mechanical(
        name="table", potential=lambda q: energy(q[0])[()], gradient=lambda q: (force(q[0])[()],), **START
    )
    found = run(cb.scipy.Contact("contact-rkn6", scene), max_step=0.1, dense_output=True)
    own = cb.Mechanical(name="own", potential=lambda q: q[0] ** 2 / 2, **START)
    np.testing.assert_allclose(found.y[:, -1], last(own, "contact-rkn6", step=0.1), atol=1e-9)
    assert len(found.sol.interpolants[0].polynomial.c) == 4


def test_a_run_that_leaves_the_scale_fails():
    scene = cb.SCENES["overdamped"]
    found = run(cb.scipy.Contact("rk4", scene), t_end=10.0, max_step=0.1)
    assert not found.success
    assert "left the scene's scale" in found.message


def test_refusals():
    solver = cb.scipy.Contact("contact-rkn6", "particle")
    with pytest.raises(cb.BadInput, match="max_step is missing"):
        solve_ivp(solver.rhs, (0, 1), solver.start, method=solver)
    with pytest.raises(cb.BadInput, match="the steps solve scene 'particle'"):
        solve_ivp(lambda t, y: -y, (0, 1), solver.start, method=solver, max_step=0.1)
    with pytest.raises(cb.BadInput, match="y0 has 2 components: must be 5, q1"):
        run(solver, y0=[1.0, 2.0])
    with pytest.raises(cb.BadInput, match="chooses its own steps"):
        cb.scipy.Contact("cvode-bdf", "particle")
    with pytest.raises(cb.BadInput, match="a step needs those before it"):
        cb.scipy.Contact("quinlan-tremaine12", "particle")
    with pytest.raises(cb.BadInput, match=r"args = .*: parameters are the scene's own"):
        run(solver, args=(0.3,))
    with pytest.raises(cb.BadInput, match="one state at a time"):
        run(solver, vectorized=True)
    with pytest.warns(UserWarning, match="`rtol`"):
        run(solver, rtol=1e-6)
