"""Equations without a Hamiltonian: what needs none solves them, everything else says what they lack."""

import math
import pickle

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import contactbench as cb
from contactbench.methods.prepared import Refused
from contactbench.scene.base import Elapsed
from contactbench.testing import check_scene

xm = cb.math
VAN_DER_POL = cb.Equations(
    name="van-der-pol",
    rhs=lambda t, y, mu: (y[1], mu * (1 - y[0] ** 2) * y[1] - y[0]),
    y0=(2.0, 0.0),
    t_end=10.0,
    parameters={"mu": 2.0},
)
#: in a trap with a magnetic field across: rotation of two frequencies
MAGNETIC = cb.Equations(
    name="magnetic",
    rhs=lambda t, y, B: (y[2], y[3], -y[0] + B * y[3], -y[1] - B * y[2]),
    y0=(1.0, 0.0, 0.0, 0.5),
    t_end=10.0,
    parameters={"B": 1.5},
)
NOSE_HOOVER = cb.Equations(
    name="nose-hoover",
    rhs=lambda t, y: (y[1], -y[0] - y[2] * y[1], y[1] ** 2 - 1),
    y0=(0.0, 1.5, 0.0),
    t_end=10.0,
)
PUSHED = cb.Equations(
    name="pushed",
    rhs=lambda t, y: [y[1], -xm.sin(y[0]) - 0.1 * y[1] + 0.5 * xm.cos(0.7 * t)],
    y0=(0.5, 0.0),
    t=1.0,
    t_end=10.0,
)
ALL = [VAN_DER_POL, MAGNETIC, NOSE_HOOVER, PUSHED]
named = pytest.mark.parametrize("scene", ALL, ids=lambda scene: scene.name)
#: those that need no Hamiltonian
RUN = {"rk4", "rk8", "rk8-7", *(name for name, method in cb.METHODS.items() if method.own_time)}


def setting(name, step=0.02, rtol=1e-8):
    method = cb.METHODS[name]
    return {} if method.exact else {"rtol": rtol} if method.adaptive else {"step": step}


@named
@pytest.mark.quick(scene=("magnetic", "pushed"))
def test_the_reference_is_what_scipy_and_a_runge_kutta_method_find(scene):
    """Three codes that share nothing but the function."""
    found = cb.reference(scene, Elapsed([scene.t_end]))
    assert (found.source, found.digits > 30) == ("live", True)
    rhs = lambda t, y: scene.right_hand_side(t, y, **scene.parameters)  # noqa: E731
    span = scene.t, scene.t + scene.t_end
    own = solve_ivp(rhs, span, scene.y0, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(found.y[0, :-1], own, rtol=0, atol=1e-9)
    run = cb.solve(scene, "rk8", step=0.02, save_at=[span[1]])
    np.testing.assert_allclose(run.y[-1], found.y[0], rtol=0, atol=1e-11)
    assert found.y[0, -1] == span[1]


def test_a_magnetic_field_turns_as_its_closed_form_says():
    """z'' = −z − iBz' of z = x + iy: e^{iωt} with ω² + Bω − 1 = 0."""
    (x, y, vx, vy), B, t = MAGNETIC.y0, 1.5, MAGNETIC.t_end
    first, second = ((-B + sign * math.sqrt(B * B + 4)) / 2 for sign in (1, -1))
    z, v = complex(x, y), complex(vx, vy)
    a = (v - 1j * second * z) / (1j * (first - second))
    end = a * np.exp(1j * first * t) + (z - a) * np.exp(1j * second * t)
    found = cb.reference(MAGNETIC, [t]).y[0]
    assert complex(found[0], found[1]) == pytest.approx(end, rel=1e-13)


@named
def test_it_keeps_the_contract_of_a_scene_and_its_jacobian_is_derived(scene):
    found = {finding.rule: finding for finding in check_scene(scene)}
    assert found[6].not_here == "no contact system"
    assert scene.recorded().has_jacobian
    x, d = scene.initial(()), 1e-6
    rows = np.array(scene.recorded().jacobian(x), dtype=float)
    for j in range(len(scene.y0) + 1):
        y = np.array(scene.pack(x))
        ends = [scene.pack(scene.rhs(scene.unpack(y + way * d * np.eye(len(y))[j], ()))) for way in (1, -1)]
        np.testing.assert_allclose(rows[:, j], np.subtract(*ends) / (2 * d), rtol=0, atol=1e-8)


@pytest.mark.quick(name="rk8-7")
@pytest.mark.quick(name="cvode-bdf")
@pytest.mark.quick(name="contact-rkn8")
@pytest.mark.parametrize("name", cb.METHODS)
def test_what_needs_no_hamiltonian_solves_it_and_the_rest_says_what_it_lacks(name):
    if name in RUN:
        run = cb.solve(VAN_DER_POL, name, **setting(name), save_at=[5.0, 10.0])
        assert run.ok
        assert cb.LAWS["solution_error"](run) < 1e-5
        return
    why = cb.METHODS[name].refuses(VAN_DER_POL)
    assert why.endswith(("does not have", "no Hamiltonian, which cb.ContactSystem(hamiltonian=…) takes"))
    assert isinstance(cb.prepare(VAN_DER_POL, name, **setting(name)), Refused)


def test_the_only_law_is_the_error_and_there_are_no_energies():
    run = cb.solve(VAN_DER_POL, "rk4", step=0.1)
    assert run.laws().index.tolist() == ["solution_error"]
    assert run.energies() == []
    assert [len(axes.lines) for axes in run.plot().axes] == [2, 2, 0]
    assert run.labels == ["y1", "y2", "t"]


def test_copies_and_pickles_are_the_same_equations_and_changes_are_others():
    again = pickle.loads(pickle.dumps(VAN_DER_POL))
    end = lambda scene: tuple(cb.solve(scene, "rk4", step=0.1).y[-1])  # noqa: E731
    assert end(VAN_DER_POL) == end(again) == end(VAN_DER_POL.with_())
    stiffer, elsewhere = VAN_DER_POL.with_(mu=3.0), VAN_DER_POL.with_(y0=(1.0, 0.5), t=2.0)
    other = VAN_DER_POL.with_(rhs=lambda t, y, mu: (y[1], -mu * y[0]), mu=4.0)
    exact = 2 * math.cos(2 * other.t_end)
    assert cb.solve(other, "rk8", step=0.05).y[-1, 0] == pytest.approx(exact, abs=1e-9)
    assert len({*map(end, (VAN_DER_POL, stiffer, elsewhere))}) == 3
    run = cb.prepare(VAN_DER_POL, "rk4", step=0.1)
    np.testing.assert_array_equal(run(y0=(1.0, 0.5), t=2.0).y, cb.solve(elsewhere, "rk4", step=0.1).y)


def test_a_function_of_floats_runs_on_python_and_its_reference_is_of_two_solvers():
    scene = cb.Equations(rhs=lambda t, y: (float(y[1]), -float(y[0])), y0=(1.0, 0.0), t_end=3.0)
    run = cb.solve(scene, "rk8", step=0.1)
    assert run.engine == "python"
    assert run.y[-1, 0] == pytest.approx(math.cos(3.0), abs=1e-12)
    found = cb.reference(scene, Elapsed([3.0]))
    assert found.source == "two solvers"
    assert found.y[0, 0] == pytest.approx(math.cos(3.0), abs=1e-10)


def test_a_step_map_and_scipy_take_it():
    step = cb.step_map(VAN_DER_POL, "rk4")
    run = cb.solve(VAN_DER_POL, "rk4", step=0.1, save_at=[0.1])
    np.testing.assert_allclose(step(step.start, 0.1), run.y[-1], rtol=1e-14)
    contact = cb.scipy.Contact("rk4", VAN_DER_POL)
    found = solve_ivp(contact.rhs, (0, 10), contact.start, method=contact, max_step=0.1)
    np.testing.assert_allclose(found.y[:, -1], cb.solve(VAN_DER_POL, "rk4", step=0.1).y[-1, :2], rtol=1e-9)
