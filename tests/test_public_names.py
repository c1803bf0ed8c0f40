"""What a user meets first: the public names, short reprs, names in place of scenes, types."""

import math
from importlib import resources

import numpy as np
import pytest

import contactbench as cb
from contactbench.errors import FUNCTIONS
from contactbench.numbers import functions


def test_dir_shows_the_public_names_and_they_exist():
    assert dir(cb) == sorted([*cb.__all__, "diffrax", "scipy", "__version__"])
    assert all(getattr(cb, name) is not None for name in dir(cb))
    assert set(functions.__all__) == {*FUNCTIONS, "atan2", "pi"}
    assert all(hasattr(cb.math, name) for name in functions.__all__)


def test_the_types_are_shipped():
    assert resources.files("contactbench").joinpath("py.typed").is_file()


def test_a_reference_takes_the_name_of_a_scene():
    named = cb.reference("particle", [1.0, 2.0])
    assert named.decimals == cb.reference(cb.SCENES["particle"], [1.0, 2.0]).decimals


# -- functions of plain numbers in a force ---------------------------------------------------------
ONE = {"q": (0.5,), "p": (0.0,), "t_end": 1.0}


def pendulum(sin, cos):
    force = {"potential": lambda q: -cos(q[0]), "gradient": lambda q: (sin(q[0]),)}
    return cb.Mechanical(name="pendulum", gamma=0.1, **force, **ONE)


BY_MATH = {"potential": lambda q: -math.cos(q[0]), "gradient": lambda q: (math.sin(q[0]),)}
MATH = cb.Mechanical(name="by-math", gamma=0.1, **BY_MATH, **ONE)
BARE = pendulum(math.sin, math.cos)


def message_of(call):
    """The message of the error that a call raises, or of the run that it ends with."""
    try:
        return call().message
    except Exception as error:
        return str(error)


@pytest.mark.parametrize(("scene", "name"), [(MATH, "math.sin"), (BARE, "sin")], ids=["math", "bare"])
@pytest.mark.parametrize("method", ["rk4", "diffrax-tsit5", "heyoka-taylor", "reference"])
def test_a_function_of_plain_numbers_is_named_with_its_line(scene, name, method):
    calls = {
        "rk4": lambda: cb.solve(scene, "rk4", step=0.1, engine="jax"),
        "reference": lambda: cb.reference(scene, [1.0]),
    }
    message = message_of(calls.get(method) or (lambda: cb.solve(scene, method, rtol=1e-6)))
    assert f"{name} takes plain numbers only: use cb.math.sin" in message
    assert "test_public_names.py, line" in message
    assert "\n" not in message


def test_numpys_functions_are_recorded_and_run_on_every_engine():
    scene = pendulum(np.sin, np.cos)
    expected = cb.reference(pendulum(cb.math.sin, cb.math.cos), [1.0])
    assert cb.reference(scene, [1.0]).decimals == expected.decimals
    runs = {name: {"rtol": 1e-9} for name in ("diffrax-tsit5", "heyoka-taylor")}
    for method, options in ({"rk4": {"step": 0.01, "engine": "jax"}} | runs).items():
        solution = cb.solve(scene, method, **options)
        np.testing.assert_allclose(solution.y[-1], expected.y[0], rtol=0, atol=1e-8)


def test_compiling_says_it_too_and_laws_do_not_break():
    message = message_of(lambda: cb.solve(BARE, "rk4", step=0.1, engine="numba"))
    assert "use cb.math.sin" in message
    laws = cb.solve(BARE, "contact-rkn8", step=0.1).laws()
    assert laws["note"].str.contains("use cb.math.").any()


def test_our_own_functions_are_not_blamed():
    def gradient(q):
        return (cb.math.sin(q[0] if type(q[0]) is float else "x"),)

    wrong = cb.Mechanical(name="wrong", potential=lambda q: -cb.math.cos(q[0]), gradient=gradient, **ONE)
    message = message_of(lambda: cb.solve(wrong, "heyoka-taylor", rtol=1e-6))
    assert "line" in message
    assert "takes plain numbers only" not in message


# -- steps -----------------------------------------------------------------------------------------
def test_a_solution_says_the_steps_it_took():
    even, uneven = (cb.solve("particle", "rk4", step=h, save_at=[20.0]) for h in (0.1, 0.3))
    assert (even.step_chosen, even.step) == (0.1, 0.1)
    assert "taken" not in repr(even)
    assert uneven.step == 20.0 / uneven.counts.steps < 0.3 == uneven.step_chosen
    assert "step=0.3, 0.298507 taken to meet the saved times" in repr(uneven)
    assert math.isnan(cb.solve("particle", "cvode-adams", rtol=1e-6).step)


@pytest.mark.parametrize("engine", ["numba", "jax", "python"])
def test_the_step_chosen_from_a_tolerance_is_told_and_gives_the_same_run(engine):
    chosen = cb.solve("particle", "contact-rkn6", rtol=1e-6, save_at=[20.0], engine=engine)
    assert 0 < chosen.step <= chosen.step_chosen
    assert f"rtol=1e-06: step={chosen.step_chosen:.6g}" in repr(chosen)
    again = cb.solve("particle", "contact-rkn6", step=chosen.step_chosen, save_at=[20.0], engine=engine)
    assert np.array_equal(again.y, chosen.y)
    capped = cb.solve("particle", "contact-strang", rtol=1e-2, save_at=np.linspace(0, 20, 401), engine=engine)
    assert capped.step == pytest.approx(0.05)
    assert capped.step_chosen > 0.06
    assert "0.05 taken to meet the saved times" in repr(capped)
