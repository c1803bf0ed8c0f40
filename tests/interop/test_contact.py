"""`cb.diffrax.Contact` and `cb.scipy.Contact` inside the solvers of their libraries."""

from functools import cache

import diffrax
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import contactbench as cb
from cases import FIXED, PULSATING, by_name, few_slow, pairs
from contactbench.xla import jax, jnp

SCENES = {
    scene.name: scene
    for scene in (*map(cb.SCENES.get, ("particle", "forced_oscillator", "oscillator")), PULSATING)
}


@cache
def terms_of(scene):
    """The terms of a scene: equal ones for all its runs, which JAX compiles once."""
    return cb.diffrax.terms_of(SCENES[scene])


def solve(scene, method, t_end=2.0, dt0=0.1, **options):
    scene, terms = SCENES[scene], terms_of(scene)
    t0, start = getattr(scene, "t", 0.0), options.pop("y0", (jnp.array(scene.q), jnp.array(scene.p)))
    constant = {"stepsize_controller": diffrax.ConstantStepSize()} | options
    return diffrax.diffeqsolve(terms, cb.diffrax.Contact(method), t0, t0 + t_end, dt0, start, **constant)


def end(solution):
    return np.concatenate([part[-1] for part in solution.ys])


@pytest.mark.parametrize("scene", ["particle", "forced_oscillator", "pulsating"])
@pytest.mark.parametrize("method", ["contact-abc", "contact-strang", "contact-rkn6", "contact-rkn8"])
@pytest.mark.quick(scene="particle", method="contact-abc")
def test_a_run_is_that_of_solve(scene, method):
    """Where dt0 does not divide the time, diffrax takes 0.1, 0.095 and then steps of 0.0975: three runs.

    Measured: 3.3e-15 at most over runs twice as long.
    """
    for t_end, saved in ((2.0, [2.0]), (1.95, [0.1, 0.195, 1.95])):
        expected = cb.solve(SCENES[scene], method, step=0.1, save_at=saved, carry=(), dense=False).y[-1]
        found = end(solve(scene, method, t_end))
        np.testing.assert_allclose(found, expected[: len(found)], rtol=0, atol=1e-14)


@pytest.mark.parametrize("way", few_slow(["forward", "backward"], "backward"))
def test_gradients_are_those_of_the_numerical_map(way):
    derive, adjoint = {
        "forward": (jax.jacfwd, diffrax.ForwardMode()),
        "backward": (jax.grad, diffrax.RecursiveCheckpointAdjoint()),
    }[way]

    def last(gamma):
        options = {"args": {"gamma": gamma}, "max_steps": 8, "adjoint": adjoint}
        return solve("particle", "contact-strang", 0.5, **options).ys[0][-1, 0]

    def by_solve(gamma):
        scene = SCENES["particle"].with_(gamma=gamma)
        return cb.solve(scene, "contact-strang", step=0.1, save_at=[0.5], carry=()).q[-1, 0]

    h = 1e-5
    difference = (by_solve(0.1 + h) - by_solve(0.1 - h)) / (2 * h)
    assert float(derive(last)(0.1)) == pytest.approx(difference, rel=1e-8)


def test_terms_of_ones_own_with_a_tree_for_a_state_and_a_rate_for_each_momentum():
    """The oscillators x'' = −x − γ x' of two rates, against their closed form."""
    rates = {"a": 0.1, "b": jnp.array([0.4, 0.0])}
    q, p = {"a": 1.0, "b": jnp.array([0.5, -0.5])}, {"a": 0.0, "b": jnp.zeros(2)}
    term = diffrax.ODETerm
    force = term(lambda t, q, args: jax.tree.map(lambda x: -x, q))
    damping = term(lambda t, p, args: jax.tree.map(lambda p, rate: -rate * p, p, args))
    terms = term(lambda t, p, args: p), diffrax.MultiTerm(force, damping)
    controller = diffrax.ConstantStepSize()
    found = diffrax.diffeqsolve(
        terms, cb.diffrax.Contact("contact-rkn6"), 0, 3, 0.1, (q, p), rates, stepsize_controller=controller
    ).ys[0]
    for start, rate, last in ((1.0, 0.1, found["a"][-1]), (0.5, 0.4, found["b"][-1, 0])):
        omega = np.sqrt(1 - rate**2 / 4)
        wave = np.cos(3 * omega) + rate / (2 * omega) * np.sin(3 * omega)
        assert float(last) == pytest.approx(start * np.exp(-1.5 * rate) * wave, abs=1e-9)


@pytest.mark.parametrize("scene", few_slow(["particle", "pulsating"], "particle"))
def test_back_in_time_it_takes_its_steps_back(scene):
    """To the start, for the steps are palindromic; between them, its cubics are those of the way there."""
    times = jnp.array([1.75, 0.5])
    t0 = getattr(SCENES[scene], "t", 0.0)
    there = solve(scene, "contact-strang", saveat=diffrax.SaveAt(ts=t0 + times[::-1], t1=True)).ys
    constant = {
        "stepsize_controller": diffrax.ConstantStepSize(),
        "saveat": diffrax.SaveAt(ts=t0 + times, t1=True),
    }
    given = t0 + 2.0, t0, -0.1, tuple(part[-1] for part in there)
    back = diffrax.diffeqsolve(terms_of(scene), cb.diffrax.Contact("contact-strang"), *given, **constant).ys
    for found, on_the_way, start in zip(back, there, (SCENES[scene].q, SCENES[scene].p), strict=True):
        np.testing.assert_allclose(found[-1], start, rtol=0, atol=1e-13)
        np.testing.assert_allclose(found[:-1], on_the_way[1::-1], rtol=0, atol=1e-13)


def test_between_steps_it_interpolates_by_cubics():
    times = np.linspace(0, 2, 41)
    truth = cb.solve("particle", "contact-rkn8", step=0.05, save_at=times, carry=()).q
    errors = [
        np.abs(solve("particle", "contact-rkn6", dt0=h, saveat=diffrax.SaveAt(ts=times)).ys[0] - truth).max()
        for h in (0.2, 0.1)
    ]
    assert 3.5 < np.log2(errors[0] / errors[1]) < 4.5


FULL = np.array([[0.2, 0.15], [0.15, 0.2]])


@pytest.mark.parametrize(
    ("velocity", "damping", "state"),
    [
        (lambda p: p, lambda p: -FULL @ p, jnp.ones(2)),
        (lambda p: p / (1 + p @ p), lambda p: -p, jnp.ones(2)),
        (lambda p: p, lambda p: {"a": -p["b"], "b": -p["a"]}, {"a": 1.0, "b": 2.0}),
    ],
    ids=["a full matrix", "a velocity that is not linear", "of leaves by each other"],
)
def test_terms_that_it_does_not_solve_are_refused(velocity, damping, state):
    def term(function):
        return diffrax.ODETerm(lambda t, x, args: function(x))

    terms = term(velocity), diffrax.MultiTerm(term(lambda q: q), term(damping))
    with pytest.raises(Exception, match="damping must be"):
        diffrax.diffeqsolve(terms, cb.diffrax.Contact("contact-abc"), 0, 1, 0.1, (state, state))


def test_refusals():
    with pytest.raises(cb.BadInput, match="no composition of kicks"):
        cb.diffrax.Contact("rk4")
    for scene in ("rigid_body", "quadratic_damping"):
        with pytest.raises(cb.BadInput, match=r"has no terms on \(q, p\)"):
            cb.diffrax.terms_of(scene)
    for args, says in (
        ({"gama": 0.3}, "did you mean 'gamma'"),
        (0.3, "parameters by name"),
        ({"kappa": 1.0}, "kappa"),
    ):
        with pytest.raises(cb.BadInput, match=says):
            solve("oscillator", "contact-strang", args=args)


# -- `cb.scipy.Contact` inside SciPy's own `solve_ivp` -----------------------------------------------
#: Herglotz's steps are merged in a run of `cb.solve`, and agree to round-off, as do those that iterate
MERGED = [m for m in FIXED if m.one_step and not m.iterates and m.family != "variational"]
#: those whose compiled loop sums the terms of s in another order than one step alone does; with forces in time, any
#: may: the compiler joins products and sums of the force into what is around it
OTHERWISE, ROUNDINGS = ("rkn8", "rkn12"), 4 * np.finfo(float).eps
STEPPED = [*map(cb.SCENES.get, ("particle", "quadratic_damping", "rigid_body_anisotropic")), PULSATING]
STEPPED += [cb.SCENES["spherical_pendulum"]]
START = {"q": (1.0,), "p": (0.0,), "gamma": 0.1, "t_end": 2.0}


def run(solver, t_end=2.0, max_step=0.13, t0=0.0, y0=None, **options):
    start = solver.start if y0 is None else y0
    return solve_ivp(solver.rhs, (t0, t0 + t_end), start, method=solver, max_step=max_step, **options)


def last(scene, method, **options):
    """The end of a run of `cb.solve`, the time left out."""
    y = cb.solve(scene, method, save_at=[2.0], **options).y[-1]
    return y if scene.clock is None else np.delete(y, scene.clock)


@pairs(MERGED, STEPPED)
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


def test_refusals_of_solve_ivp():
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
