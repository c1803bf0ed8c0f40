"""The kick with a force gradient, and the forward composition of order 4 made with it."""

import math

import pytest
from mpmath import mp

import contactbench as cb
from cases import in_mp, mine
from contactbench.measure.order import local_order
from contactbench.scene import Flow
from contactbench.splitting.tables import BM4, CHIN4

METHOD = cb.METHODS["contact-chin4"]
HEAVY = cb.SCENES["particle"].with_(gamma=0.4, mass=(1.3, 2.2), q=(0.7, -0.4), p=(0.5, 0.2), s=0.3)
KICK: Flow = HEAVY.flows["force_gradient"]


def test_all_coefficients_are_positive():
    assert all(c > 0 for _, c in CHIN4.stages)
    assert any(c < 0 for _, c in BM4.stages)


@pytest.mark.parametrize(
    "scene", [HEAVY, cb.SCENES["quadratic_damping"].with_(gamma=0.2)], ids=lambda s: s.name
)
def test_it_is_of_order_four_with_masses_and_damping_of_both_kinds(scene):
    assert local_order(METHOD, scene) == pytest.approx(4, abs=1e-5)


def test_the_kick_is_that_of_its_potential(mp50):
    """p and s move by the gradient, here by differences, and the value of V − (3/64) h² ‖∇V‖²/m."""
    scene, x = in_mp(HEAVY, HEAVY.initial(("s",)))
    h, step = mp.mpf("0.3"), mp.mpf("1e-20")

    def potential(q):
        force = scene.dV(q)
        square = sum(f * f * w for f, w in zip(force, scene.inverse_mass, strict=True))
        return scene.V(q) - 3 * h * h / 64 * square

    after = KICK.apply(scene, x, h, mp)
    assert after.q == x.q
    assert abs(after.s - (x.s - h * potential(x.q))) < mp.mpf("1e-45")
    for i in range(2):
        sides = [tuple(c + way * step * (i == j) for j, c in enumerate(x.q)) for way in (1, -1)]
        slope = (potential(sides[0]) - potential(sides[1])) / (2 * step)
        assert abs(after.p[i] - (x.p[i] - h * slope)) < mp.mpf("1e-25")


def test_time_in_the_force_does_not_enter_its_derivative():
    scene = cb.SCENES["duffing"]
    runs = [cb.solve(scene, METHOD, step=scene.t_end / n, save_at=[scene.t_end]) for n in (400, 800)]
    errors = [cb.LAWS["solution_error"](run) for run in runs]
    assert math.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.3)
    assert cb.LAWS["contact_drift"](runs[0]) < 1e-12  # by dual numbers of dual numbers


def test_bodies_and_forces_of_floats_are_refused():
    for scene in ("rigid_body", "heavy_top"):
        assert "‖∇V‖²/m" in METHOD.refuses(cb.SCENES[scene])
    spline = mine(lambda q: float(q[0]) ** 2 / 2, gradient=lambda q: (float(q[0]),))
    assert "of floats only" in METHOD.refuses(spline)
