"""`cb.diffrax.Contact` inside diffrax's own `diffeqsolve`."""

from functools import cache

import diffrax
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import contactbench as cb
from contactbench.xla import jax, jnp
from own_scenes import scene_of


@cache
def terms_of(scene):
    """The terms of a scene: equal ones for all its runs, which JAX compiles once."""
    return cb.diffrax.terms_of(scene)


def solve(scene, method, t_end=2.0, dt0=0.1, **options):
    scene, terms = scene_of(scene), terms_of(scene)
    t0, start = getattr(scene, "t", 0.0), options.pop("y0", (jnp.array(scene.q), jnp.array(scene.p)))
    constant = {"stepsize_controller": diffrax.ConstantStepSize()} | options
    return diffrax.diffeqsolve(terms, cb.diffrax.Contact(method), t0, t0 + t_end, dt0, start, **constant)


def end(solution):
    return np.concatenate([part[-1] for part in solution.ys])


@pytest.mark.parametrize("scene", ["particle", "forced_oscillator", "forced_pulsating"])
@pytest.mark.parametrize("method", ["contact-abc", "contact-strang", "contact-rkn6", "contact-rkn8"])
@pytest.mark.quick(scene="particle", method=("contact-abc", "contact-rkn8"))
@pytest.mark.quick(scene="forced_pulsating", method="contact-rkn6")
def test_a_run_is_that_of_solve(scene, method):
    """Where dt0 does not divide the time, diffrax takes 0.1, 0.095 and then steps of 0.0975: three runs.

    Measured: 3.3e-15 at most over runs twice as long.
    """
    for t_end, saved in ((2.0, [2.0]), (1.95, [0.1, 0.195, 1.95])):
        expected = cb.solve(scene_of(scene), method, step=0.1, save_at=saved, carry=()).y[-1]
        found = end(solve(scene, method, t_end))
        np.testing.assert_allclose(found, expected[: len(found)], rtol=0, atol=1e-14)


def test_steps_that_change_are_runs_of_their_own():
    times = np.array([0.1, 0.3, 0.4, 0.7])
    expected = cb.solve("particle", "contact-rkn8", step=1.0, save_at=times, carry=()).y[-1]
    controller = diffrax.StepTo(ts=np.append(0.0, times))
    found = end(solve("particle", "contact-rkn8", 0.7, None, stepsize_controller=controller))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)


def test_gradients_are_those_of_the_numerical_map():
    def last(gamma, adjoint=None):
        options = {"adjoint": adjoint} if adjoint else {"max_steps": 32}
        return solve("particle", "contact-rkn6", args={"gamma": gamma}, **options).ys[0][-1, 0]

    h = 1e-5
    expected = (last(0.1 + h) - last(0.1 - h)) / (2 * h)
    assert float(jax.grad(last)(0.1)) == pytest.approx(float(expected), rel=1e-8)
    forward = jax.jacfwd(lambda gamma: last(gamma, diffrax.ForwardMode()))(0.1)
    assert float(forward) == pytest.approx(float(jax.grad(last)(0.1)), rel=1e-12)


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
        terms, cb.diffrax.Contact("contact-rkn8"), 0, 3, 0.1, (q, p), rates, stepsize_controller=controller
    ).ys[0]
    for start, rate, last in ((1.0, 0.1, found["a"][-1]), (0.5, 0.4, found["b"][-1, 0])):
        omega = np.sqrt(1 - rate**2 / 4)
        wave = np.cos(3 * omega) + rate / (2 * omega) * np.sin(3 * omega)
        assert float(last) == pytest.approx(start * np.exp(-1.5 * rate) * wave, abs=1e-12)


@pytest.mark.parametrize("scene", ["particle", "forced_pulsating"])
def test_back_in_time_it_takes_its_steps_back(scene):
    """To the start, for the steps are palindromic; between them, its cubics are those of the way there."""
    times = jnp.array([1.75, 0.5])
    t0 = getattr(scene_of(scene), "t", 0.0)
    there = solve(scene, "contact-rkn6", saveat=diffrax.SaveAt(ts=t0 + times[::-1], t1=True)).ys
    constant = {
        "stepsize_controller": diffrax.ConstantStepSize(),
        "saveat": diffrax.SaveAt(ts=t0 + times, t1=True),
    }
    given = t0 + 2.0, t0, -0.1, tuple(part[-1] for part in there)
    back = diffrax.diffeqsolve(terms_of(scene), cb.diffrax.Contact("contact-rkn6"), *given, **constant).ys
    for found, on_the_way, start in zip(back, there, (scene_of(scene).q, scene_of(scene).p), strict=True):
        np.testing.assert_allclose(found[-1], start, rtol=0, atol=1e-13)
        np.testing.assert_allclose(found[:-1], on_the_way[1::-1], rtol=0, atol=1e-13)


def test_between_steps_it_interpolates_by_cubics():
    times = np.linspace(0, 2, 41)
    truth = cb.solve("particle", "contact-rkn8", step=0.05, save_at=times, carry=()).q
    errors = [
        np.abs(solve("particle", "contact-rkn8", dt0=h, saveat=diffrax.SaveAt(ts=times)).ys[0] - truth).max()
        for h in (0.2, 0.1)
    ]
    assert 3.5 < np.log2(errors[0] / errors[1]) < 4.5


# -- the derivative without the states -------------------------------------------------------------
def derivative(scene, method, adjoint, t_end=4.0, dt0=0.1, mode="grad", **args):
    """The derivative of the last q1 in the parameters given by name and in the initial state."""

    def last(args, y0):
        options = {"args": args, "adjoint": adjoint, "y0": y0}
        return solve(scene, method, t_end, dt0, **options).ys[0][-1, 0]

    y0 = jnp.array(scene_of(scene).q), jnp.array(scene_of(scene).p)
    given = {name: jnp.asarray(x) for name, x in args.items()}
    return jax.jit(getattr(jax, mode)(last, argnums=(0, 1))).lower(given, y0).compile(), (given, y0)


def values(derivative):
    program, given = derivative
    return np.array(ravel_pytree(program(*given))[0])


@pytest.mark.parametrize(
    ("scene", "rate", "method"),
    [
        ("particle", "gamma", "contact-abc"),
        ("particle", "gamma", "contact-rkn6"),
        ("forced_pulsating", "friction", "contact-strang"),
        ("forced_pulsating", "friction", "contact-rkn8"),
    ],
)
@pytest.mark.quick(method=("contact-abc", "contact-strang"))
def test_a_run_taken_back_has_the_derivative_of_the_numerical_map(scene, rate, method):
    """Round-off of 40 steps and of what it grows to, e^{∫γ} < 2; measured: 4e-15 of the largest."""
    rate = {rate: 0.1}
    expected = values(derivative(scene, method, diffrax.ForwardMode(), mode="jacfwd", **rate))
    found = values(derivative(scene, method, cb.diffrax.ReversibleAdjoint(), **rate))
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-14 * np.abs(expected).max())


def test_its_memory_does_not_grow_with_the_steps():
    def memory(steps):
        program, _ = derivative(
            "particle", "contact-strang", cb.diffrax.ReversibleAdjoint(), 0.1 * steps, gamma=0.1
        )
        return program.memory_analysis().temp_size_in_bytes

    assert memory(400) == memory(100) < 400 * 4 * 8  # bytes of the states


@pytest.mark.parametrize(("t_end", "dt0"), [(12.0, 0.1), (2.0, 0.09)])
@pytest.mark.quick(t_end=2.0)
def test_what_cannot_be_taken_back_is_no_derivative(t_end, dt0):
    """Overdamped, γT = 48: the fast motion is lost in round-off; and a dt0 that does not divide the span."""
    run = derivative("oscillator", "contact-strang", cb.diffrax.ReversibleAdjoint(), t_end, dt0, gamma=4.0)
    with pytest.raises(Exception, match="does not end at its start"):
        values(run)


def test_a_derivative_in_parameters_alone_is_watched_too():
    def last(gamma):
        adjoint = cb.diffrax.ReversibleAdjoint()
        return solve("oscillator", "contact-strang", 12.0, args={"gamma": gamma}, adjoint=adjoint).ys[0][
            -1, 0
        ]

    with pytest.raises(Exception, match="does not end at its start"):
        jax.grad(last)(4.0)
    with pytest.raises(TypeError, match="forward-mode"):  # not taken without what the states depend on
        jax.jacfwd(jax.grad(last))(0.1)


FULL = np.array([[0.2, 0.15], [0.15, 0.2]])


@pytest.mark.parametrize(
    ("velocity", "damping", "state"),
    [
        (lambda p: p, lambda p: -FULL @ p, jnp.ones(2)),
        (lambda p: p, lambda p: -p * abs(p), jnp.ones(2)),
        (lambda p: p / (1 + p @ p), lambda p: -p, jnp.ones(2)),
        (lambda p: p, lambda p: {"a": -p["b"], "b": -p["a"]}, {"a": 1.0, "b": 2.0}),
    ],
    ids=[
        "a full matrix",
        "quadratic damping",
        "a velocity that is not linear",
        "leaves that damp each other",
    ],
)
def test_terms_that_it_does_not_solve_are_refused(velocity, damping, state):
    def term(function):
        return diffrax.ODETerm(lambda t, x, args: function(x))

    terms = term(velocity), diffrax.MultiTerm(term(lambda q: q), term(damping))
    with pytest.raises(Exception, match="damping must be"):
        diffrax.diffeqsolve(terms, cb.diffrax.Contact("contact-abc"), 0, 1, 0.1, (state, state))


def test_a_forced_run_from_rest_is_taken_back():
    def last(force, adjoint):
        rest = {"y0": (jnp.zeros(1), jnp.zeros(1)), "args": {"force": force}, "adjoint": adjoint}
        return solve("forced_oscillator", "contact-rkn6", 4.0, **rest).ys[0][-1, 0]

    found = jax.grad(last)(0.3, cb.diffrax.ReversibleAdjoint())
    expected = jax.jacfwd(last)(0.3, diffrax.ForwardMode())
    assert float(found) == pytest.approx(float(expected), rel=1e-11)


def test_what_is_no_contact_run_to_its_end_is_not_taken_back():
    adjoint, steps = cb.diffrax.ReversibleAdjoint(), diffrax.SaveAt(steps=True)
    changing = diffrax.StepTo(ts=np.linspace(0, 2, 5))
    for options in ({"saveat": steps}, {"dt0": None, "stepsize_controller": changing}):
        with pytest.raises(cb.BadInput, match="ReversibleAdjoint"):
            solve("particle", "contact-strang", adjoint=adjoint, **options)


def test_refusals():
    with pytest.raises(cb.BadInput, match="no composition of kicks"):
        cb.diffrax.Contact("rk4")
    for scene in ("rigid_body", "quadratic_damping", "fput"):
        with pytest.raises(cb.BadInput, match=r"has no terms on \(q, p\)"):
            cb.diffrax.terms_of(scene)
    for args, says in (
        ({"gama": 0.3}, "did you mean 'gamma'"),
        (0.3, "parameters by name"),
        ({"kappa": 1.0}, "kappa"),
    ):
        with pytest.raises(cb.BadInput, match=says):
            solve("oscillator", "contact-strang", args=args)
