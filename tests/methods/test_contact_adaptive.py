"""Adaptive contact steps: the laws of every step sequence, symmetry, and the derivative behind the density."""

import numpy as np
import pytest

import contactbench as cb
from cases import STANDARD, USER, in_mp, random_state
from contactbench.methods.contact_adaptive import frequency, next_density, squared_curvature
from contactbench.scenes import scenes_of
from contactbench.splitting.composition import advance
from contactbench.splitting.tables import RKN6

NAME = "contact-adaptive"
KEPLER = cb.SCENES["kepler_drag"]
MECHANICAL = [
    s
    for s in (*STANDARD, *scenes_of("stability"), USER)
    if isinstance(s, cb.Mechanical) and s.name not in ("escape", "weak_damping", "weak_damping_particle")
]


@pytest.mark.parametrize("rtol", [1e-2, 1e-6, 1e-10])
def test_momentum_law_is_exact_and_the_error_meets_the_tolerance(rtol):
    solution = cb.solve(KEPLER, NAME, rtol=rtol, save_at=np.arange(1, 26) * 4.0)
    assert solution.ok
    assert solution.end_time == 100.0
    assert cb.LAWS["momentum_law"](solution) < 1e-12
    assert cb.LAWS["solution_error"](solution) < 3 * rtol


@pytest.mark.parametrize("scene", MECHANICAL, ids=lambda s: s.name)
def test_every_mechanical_scene_is_solved_to_its_tolerance(scene):
    short = scene.with_(t_end=min(scene.t_end, 5.0))
    solution = cb.solve(short, NAME, rtol=1e-8, save_at=[short.t_end], engine="python")
    assert solution.ok
    assert cb.LAWS["solution_error"](solution) < 1e-7


@pytest.mark.parametrize("engine", cb.METHODS[NAME].engines)
@pytest.mark.parametrize("scene", [KEPLER.with_(t_end=10.0), USER], ids=lambda s: s.name)
@pytest.mark.quick(scene="user")
def test_every_engine_runs_the_loop_as_it_is_written(scene, engine):
    options = {"rtol": 1e-5, "save_at": np.linspace(0, scene.t_end, 4)}
    written = cb.prepare(scene, NAME, engine="python", **options)
    recorded, *written.loops = written.loops
    assert recorded != written.as_written
    theirs, ours = written.integrate(written.start), cb.solve(scene, NAME, engine=engine, **options)
    np.testing.assert_allclose(ours.y, theirs.y, rtol=1e-11, atol=1e-11)  # round-off, times the condition
    assert (ours.status, ours.counts) == (theirs.status, theirs.counts)


def test_saving_does_not_disturb_the_steps():
    alone, often = (
        cb.solve(KEPLER, NAME, rtol=1e-4, save_at=t, engine="python") for t in ([100.0], range(101))
    )
    np.testing.assert_array_equal(alone.y[-1], often.y[-1])
    np.testing.assert_array_equal(often.y[0], often.y0)


def test_a_step_with_its_density_undoes_itself(mp50):
    """Φ and the density, reversed in time, retrace their way: the whole control is time-symmetric."""
    scene, x = in_mp(KEPLER, KEPLER.initial(()))
    epsilon, span = mp50.mpf("0.3"), mp50.mpf(100)
    density = frequency(scene, x, span)[0]
    start = (x, density)
    for _ in range(12):
        x = advance(RKN6, scene, x, epsilon / density, 1, mp50)
        density = next_density(scene, x, density, epsilon, span, mp50)
    for _ in range(12):
        density = next_density(scene, x, density, -epsilon, span, mp50)
        x = advance(RKN6, scene, x, -epsilon / density, 1, mp50)
    gap = max(abs(a - b) for a, b in zip(scene.pack(x), scene.pack(start[0]), strict=True))
    assert gap < mp50.mpf(10) ** -40
    assert abs(density - start[1]) < mp50.mpf(10) ** -40


@pytest.mark.parametrize("scene", [KEPLER, cb.SCENES["particle"], cb.SCENES["central"]], ids=lambda s: s.name)
def test_curvature_with_and_without_a_hessian_and_by_differences(scene):
    x = random_state(scene, 5, ())
    with_hessian = squared_curvature(scene, x.q, x.p)
    without = squared_curvature(scene._replaced(hessian=None), x.q, x.p)
    assert without.a == pytest.approx(with_hessian.a, rel=1e-12)
    assert without.b == pytest.approx(with_hessian.b, rel=1e-11)
    d = 1e-6
    ahead, behind = (
        squared_curvature(scene, tuple(q + e * p for q, p in zip(x.q, x.p, strict=True)), x.p).a
        for e in (d, -d)
    )
    assert with_hessian.b == pytest.approx((ahead - behind) / (2 * d), rel=1e-5)


def test_free_motion_needs_few_steps():
    flat = {"potential": lambda q: 0 * q[0], "gradient": lambda q: (0 * q[0],)}
    free = cb.Mechanical(name="free", **flat, gamma=0.0, q=(0.0,), p=(1.0,), t_end=10.0)
    solution = cb.solve(free, NAME, rtol=1e-10, save_at=[10.0], engine="python")
    assert solution.y[-1, 0] == pytest.approx(10.0, rel=1e-14)
    assert solution.counts.steps < 100
