"""`step_map`: one pure function for Python, NumPy, JAX and numba."""

from __future__ import annotations

import numpy as np
import pytest

import contactbench as cb
from contactbench.methods.fixed_step import FixedStep

STEP = 0.1
STEPS = [name for name, method in cb.METHODS.items() if isinstance(method, FixedStep)]

#: numba takes its time over the long ones
SHORT = ("contact-strang", "herglotz2")


def supported(names, scenes):
    return [(s, n) for s in scenes for n in names if cb.METHODS[n].refuses(cb.SCENES[s]) is None]


@pytest.mark.parametrize(("scene", "method"), supported(STEPS, ["particle", "rigid_body"]))
@pytest.mark.quick(method=("contact-abc", "contact-bm6", "rk4"))
@pytest.mark.quick(method="herglotz2")
def test_steps_one_after_another_are_a_run(scene, method):
    """Processed methods apart, which begin and end every run with stages of their own."""
    step = cb.step_map(scene, method)
    y = step.start
    for _ in range(5):
        y = step(y, STEP)
    saved = [STEP * k for k in range(1, 6)]  # so that every step is a run, processor and all
    run = cb.solve(scene, method, step=STEP, save_at=saved)
    np.testing.assert_allclose(y, run.y[-1], rtol=1e-12, atol=1e-13)
    assert isinstance(y, tuple)
    assert step.labels == run.labels


def test_it_is_pure():
    step = cb.step_map("particle", "contact-bm4")
    once = step(step.start, STEP)
    step(once, STEP, gamma=3.0)
    assert step(step.start, STEP) == once
    assert step.scene.gamma == cb.SCENES["particle"].gamma


def test_parameters_by_name_and_as_a_tuple():
    step = cb.step_map("particle", "contact-strang")
    other = cb.step_map(cb.SCENES["particle"].with_(gamma=0.4, coupling=0.2), "contact-strang")
    numbers = list(step.scene.numbers())
    numbers[step.names.index("gamma")], numbers[step.names.index("coupling")] = 0.4, 0.2
    assert step(step.start, STEP, gamma=0.4, coupling=0.2) == other(step.start, STEP)
    assert step(step.start, STEP, tuple(numbers)) == other(step.start, STEP)


@pytest.mark.parametrize(("scene", "method"), supported(SHORT, ["particle", "rigid_body"]))
@pytest.mark.quick(scene="rigid_body")
def test_numba_calls_it_in_a_compiled_loop(scene, method):
    import numba

    step = cb.step_map(scene, method)

    @numba.njit
    def run(y, h, n):
        for _ in range(n):
            y = step(y, h)
        return y

    y = step.start
    for _ in range(50):
        y = step(y, STEP)
    np.testing.assert_allclose(run(step.start, STEP, 50), y, rtol=1e-13, atol=1e-14)


def test_jax_compiles_and_vectorises_it():
    from contactbench.xla import jax, jnp

    step = cb.step_map("particle", "contact-rkn6")
    np.testing.assert_allclose(jax.jit(step)(step.start, STEP), step(step.start, STEP), rtol=1e-14)
    rates = jnp.array([0.0, 0.1, 0.5])
    many = jax.vmap(lambda gamma: jnp.stack(step(step.start, STEP, gamma=gamma)))(rates)
    for gamma, row in zip(rates.tolist(), many, strict=True):
        np.testing.assert_allclose(row, step(step.start, STEP, gamma=gamma), rtol=1e-13)


def test_jax_differentiates_it_along_a_parameter():
    from contactbench.xla import jax

    step = cb.step_map("particle", "contact-strang", carry=())

    def end(gamma):
        return step(step(step.start, 1.0, gamma=gamma), 1.0, gamma=gamma)[0]

    difference = (end(0.1 + 1e-5) - end(0.1 - 1e-5)) / 2e-5
    assert float(jax.grad(end)(0.1)) == pytest.approx(difference, rel=1e-7)
