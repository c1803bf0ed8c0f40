"""Every registered method: its order, its claims, its ends, its counts, and the traps of its solver."""

import math
import sys

import numpy as np
import pytest

import contactbench as cb
from cases import DETEST_E3, PLEIADES, few_slow, mine, run
from contactbench.methods.base import tolerance
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.prescribed import steps_in
from contactbench.peers import diffrax
from contactbench.plugins import OWN
from contactbench.solution import Status
from contactbench.testing.method import CASES
from contactbench.xla import jax

PARTICLE = CASES[0]
FIXED = [m for m in cb.METHODS.values() if isinstance(m, FixedStep)]
#: contact-exact solves bodies only, and has tests of its own
ON_PARTICLE = [m for m in cb.METHODS.values() if m.refuses(PARTICLE) is None]
ADAPTIVE = [m for m in ON_PARTICLE if m.adaptive]

#: take XLA seconds to compile
LONG = [cb.METHODS[name] for name in ("diffrax-kvaerno5", "diffrax-dopri8")]
#: a method of every kind of loop; the others have the same
LOOPS = (
    "contact-strang",
    "contact-rkn6",
    "contact-rkn8",
    "contact-gauss2",
    "contact-linear2",
    "contact-log8",
)
LOOPS += ("herglotz2", "rk4", "rk8", "rkn12", "quinlan-tremaine8")
ALIKE = [method for method in FIXED if method.name in OWN - {*LOOPS}]
fixed = pytest.mark.parametrize("method", FIXED, ids=lambda m: m.name)
adaptive = pytest.mark.parametrize("method", ADAPTIVE, ids=lambda m: m.name)


@fixed
@pytest.mark.parametrize("gamma", [0.0, 0.25])
def test_a_linear_scene_scales_to_the_last_bit(method, gamma):
    """q and p by a power of two, s by its square: no step has a size of its own, and none divides by γ = 0."""
    scene = cb.SCENES["oscillator"].with_(gamma=gamma, q=(0.75,), p=(-0.5,), s=0.25, t_end=2.0)
    run = cb.prepare(scene, method.name, step=0.125)
    one = run()
    assert cb.LAWS["solution_error"](one) < 0.1
    for scale in (2.0**-27, 2.0**27):
        other = run(q=(0.75 * scale,), p=(-0.5 * scale,), s=0.25 * scale**2)
        assert other.ok
        np.testing.assert_array_equal(other.y, one.y * [scale, scale, scale**2])


FORCED = DETEST_E3.with_(q=(1e-9,), t_end=6.0)
ON_FORCED = [m for m in cb.METHODS.values() if m.refuses(FORCED) is None]


@pytest.mark.parametrize("method", few_slow(ON_FORCED, *LONG, *ALIKE), ids=lambda m: m.name)
def test_a_start_next_to_rest_is_no_scale_of_the_motion(method):
    """The force takes it a billion times as far, which is no divergence; nor is it one of increments so small."""
    setting = {"step": 0.02} if method.control == "step" else {"rtol": 1e-6}
    solution = cb.solve(FORCED, method.name, **setting)
    assert solution.ok, solution.message
    assert cb.LAWS["solution_error"](solution) < 0.05


@adaptive
def test_both_ends_of_the_range_of_a_tolerance_are_in_it(method):
    low, high = method.rtol_range
    for rtol in (low, high):
        assert tolerance(method, rtol) == rtol
    for rtol in (low * 0.99, high * 1.01):
        with pytest.raises(cb.BadInput, match="rtol"):
            tolerance(method, rtol)


# -- prepared solvers ------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "method", few_slow([m for m in ON_PARTICLE if "jax" in m.engines], *LONG), ids=lambda m: m.name
)
def test_other_parameters_steps_and_tolerances_do_not_recompile(method):
    coarse, fine = ({"rtol": 1e-7}, {"rtol": 1e-11}) if method.adaptive else ({"step": 0.05}, {"step": 0.002})
    cb.solve(PARTICLE, method.name, save_at=[1.0], **coarse)
    before = len(diffrax._programs.items)
    other = PARTICLE.with_(gamma=0.5, coupling=0.3, q=(0.1, 0.2), t_end=9.0)
    cb.solve(other, method.name, save_at=[2.0], **fine)
    assert len(diffrax._programs.items) == before


# -- saved times -----------------------------------------------------------------------------------
@pytest.mark.parametrize("step", [1e-5, 1e-3, 0.1, 1 / 3, 0.7, 12.5], ids="{:.3g}".format)
def test_only_an_interval_that_is_longer_than_its_steps_is_divided(step):
    """By a part in 10⁸, where times that late resolve it; at multiples of a step, as users write them."""
    n = 20_000
    k = np.arange(1, n)
    grids = {"multiples": k * step, "arange": np.arange(step, n * step, step)}
    grids |= {"linspace": np.linspace(0, n * step, n + 1)[1:], "sums": np.cumsum(np.full(n, step))}
    grids |= {"late": 1e6 * step + k * step, "very late": 1e9 * step + k * step, "every third": 3 * k * step}
    for name, times in grids.items():
        whole = 3 if name == "every third" else 1
        intervals = np.diff(times), times[1:]
        assert (steps_in(*intervals, step) == whole).all(), name
        if name != "very late":  # 4 ulp(t)/h is 10⁻⁹ at t = 10⁶ h
            assert (steps_in(*intervals, step * (1 - 1e-8)) == whole + 1).all(), name


# -- ways to end -----------------------------------------------------------------------------------
@pytest.mark.parametrize("method", few_slow([m for m in FIXED if m.one_step], *ALIKE), ids=lambda m: m.name)
def test_the_step_that_diverges_is_the_last_one_counted(method):
    """Against steps taken one by one until a component is 10⁶ times the size of the initial (q, p)."""
    scene, step = cb.SCENES["escape"], cb.step_map("escape", method.name)
    y, motion, n = step.start, len(step.start) - 1, 0
    bound = 1e6 * np.linalg.norm(y[:motion])
    while max(map(abs, y[:motion])) <= bound:
        y, n = step(y, 0.01), n + 1
    for engine in method.engines:
        save = [0.0, 1.0, 2.0, 10.0]
        solution = cb.solve(scene, method.name, step=0.01, save_at=save, engine=engine)
        assert solution.status is Status.diverged
        assert solution.counts.steps == n
        assert solution.end_time == pytest.approx(0.01 * n, rel=1e-9)
        begun = 1 + sum(0 < t < 0.01 * n for t in save)  # intervals, each with a first step
        expected = begun * method.counts(scene, 1) + (n - begun) * method.per_step(scene)
        assert solution.counts.evaluations == (None if method.iterates else expected)


# -- counts and traps ------------------------------------------------------------------------------
@pytest.mark.parametrize("method", ["scipy-radau", "cvode-bdf"])
def test_the_calls_that_difference_a_jacobian_count(method):
    """SciPy and CVODE leave them out of their nfev."""
    calls = [0]

    def counting(q, **parameters):
        calls[0] += 1
        assert q[0] < math.inf  # asks for the value: it cannot be recorded and is called every time
        return PARTICLE.gradient(q, **parameters)

    scene = PARTICLE._replaced(gradient=counting, hessian=None)
    engine = cb.METHODS[method].engines[-1]
    run = cb.prepare(scene, method, engine=engine, rtol=1e-7, save_at=[4.0], carry=())
    calls[0] = 0
    assert run().counts.evaluations == calls[0]


@pytest.mark.parametrize("name", ["diffrax-tsit5", "diffrax-dopri8"])
@pytest.mark.quick(name="diffrax-tsit5")
def test_diffrax_counts_what_it_evaluates(name, monkeypatch):
    calls, slopes = [], cb.Mechanical.slopes

    def counting(*arguments):
        jax.debug.callback(lambda: calls.append(1))
        return slopes(*arguments)

    run = cb.prepare(PARTICLE, name, rtol=1e-8, save_at=[4.0])
    monkeypatch.setattr(cb.Mechanical, "slopes", counting)
    jax.block_until_ready(jax.jit(run.call._solve)(run.start, run.call.fixed))
    jax.effects_barrier()
    assert run().counts.evaluations == len(calls) > run.method_.stages


def test_diffrax_spends_a_budget_of_attempts_and_the_last_one_may_reach_the_end():
    run = {"rtol": 1e-6, "save_at": [5.0, 20.0]}
    counts = cb.solve("particle", "diffrax-tsit5", **run).counts
    assert counts.rejected
    attempts = counts.steps + counts.rejected
    assert cb.solve("particle", "diffrax-tsit5", max_steps=attempts, **run).counts == counts
    short = cb.solve("particle", "diffrax-tsit5", max_steps=attempts - 1, **run)
    assert short.status is Status.budget
    assert short.counts.steps + short.counts.rejected == attempts - 1
    assert 5 < short.end_time < 20
    assert np.isfinite(short.y[0]).all()
    assert np.isnan(short.y[1]).all()


@pytest.mark.parametrize("method", few_slow(ADAPTIVE, *LONG), ids=lambda m: m.name)
def test_singular_right_hand_side_is_a_row_and_not_a_crash(method):
    V, dV = lambda q: -((q[0] * q[0]) ** -0.5), lambda q: (q[0] * (q[0] * q[0]) ** -1.5,)
    scene = mine(V, t_end=3.0, gradient=dV)
    solution = cb.solve(scene, method.name, rtol=1e-6, save_at=[3.0], max_steps=20_000)
    # straight into the singularity at t = π/√8 ≈ 1.11: nothing true can be said beyond it
    refused = {Status.unsupported} if method.refuses(scene) else set()
    assert solution.status in {Status.failed, Status.diverged, Status.budget} | refused
    assert np.isnan(solution.y).all()


JAX = """
import jax
import jax.numpy as jnp
import contactbench as cb

run = cb.prepare("oscillator", "diffrax-tsit5", rtol=1e-9)
print(run().ok, run(q=(0.5,)).ok, cb.LAWS["solution_error"](run()) < 1e-6, end=" ")
print(jnp.ones(1).dtype, jax.config.jax_enable_x64)
"""


@pytest.mark.parametrize("disabled", few_slow([0, 1], 1))
def test_diffrax_computes_in_doubles_and_leaves_jax_as_it_is(disabled):
    """Compiled, whatever is set for the user's own functions."""
    done = run(sys.executable, "-c", JAX, JAX_ENABLE_X64=0, JAX_DISABLE_JIT=disabled)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.split() == [*["True"] * 3, "float32", "False"]


# -- problems whose digits are published, or known by two solvers ------------------------------------
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
SHAKEN = mine(
    lambda q, t, a, w: (1 - a * w * w * cos(w * t)) * -cos(q[0]),
    q=np.pi - 0.1,
    t_end=10.0,
    kind=cb.Driven,
    parameters={"a": 0.1, "w": 50.0},
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
