"""Steps that other libraries take: SUNDIALS' SPRKStep, REBOUND's WHFast and IAS15."""

import gc
import importlib.util
import math
import weakref

import numpy as np
import pytest

import contactbench as cb
from cases import few_slow
from contactbench.measure.order import fit_order
from contactbench.peers.rebound import attraction
from contactbench.peers.sprk import LONGEST
from contactbench.solution import Status
from contactbench.testing import check_method

PARTICLE = cb.SCENES["particle"].with_(gamma=0.35, q=(0.7, -0.6), p=(0.4, 0.5), s=0.3, mass=1.7, t_end=4.0)
FORCED = cb.SCENES["forced_oscillator"].with_(t=0.7, t_end=4.0)
KEPLER = cb.SCENES["kepler_drag"].with_(
    gamma=0.05, strength=2.0, mass=1.7, q=(1.0, 0.1), p=(0.0, 2.0), s=0.3, t_end=4.0
)
PLANETS = cb.SCENES["planets"].with_(gamma=2e-5, t_end=2000.0)
SPRK = {"sprk-5": 0.4, "sprk-10": 1.3}


def error(scene, method, **options):
    return cb.LAWS["solution_error"](cb.solve(scene, method, save_at=[scene.t_end], **options))


def order(scene, method, counts):
    steps = [scene.t_end / n for n in counts]
    return fit_order(steps, [error(scene, method, step=h) for h in steps], 1e-13).order


# -- SPRKStep ------------------------------------------------------------------------------------------
@pytest.mark.parametrize("scene", [PARTICLE, FORCED], ids=lambda s: s.name)
def test_sprk_has_its_order_where_forces_depend_on_time_too(scene):
    assert order(scene, "sprk-5", (8, 11, 16, 23, 32, 45)) == pytest.approx(5, abs=0.1)
    assert error(scene, "sprk-10", step=scene.t_end / 16) < 1e-12


@pytest.mark.parametrize("method", SPRK)
@pytest.mark.parametrize("scene", [PARTICLE, FORCED], ids=lambda s: s.name)
def test_sprk_on_stretched_coordinates_is_a_contact_map(method, scene):
    """At any step; and the derivative that shows it is that of the steps, as differences of them have it."""
    solution = cb.solve(scene, method, step=SPRK[method], save_at=[1.3, scene.t_end])
    assert cb.LAWS["solution_error"](solution) > 1e-13
    assert cb.LAWS["contact_drift"](solution) < 1e-13
    run, v, small = solution.run, np.array(solution.run.tangents(solution.y0)), 1e-6
    ahead, back = (run.integrate(solution.y0 + sign * small * v[1]).y for sign in (1, -1))
    np.testing.assert_allclose(run.sensitivity(solution.y0)[..., 1], (ahead - back) / (2 * small), atol=1e-8)


def test_sprk_keeps_the_momentum_map():
    scene = cb.SCENES["central"].with_(gamma=0.3)
    solution = cb.solve(scene, "sprk-5", step=0.2, carry=())
    assert cb.LAWS["momentum_law"](solution) < 1e-13 < cb.LAWS["solution_error"](solution)


@pytest.mark.parametrize("method", SPRK)
def test_sprk_called_back_takes_the_same_steps(method):
    c, python = (cb.solve(FORCED, method, step=0.1, save_at=[1.0, 4.0], engine=e) for e in ("c", "c+python"))
    np.testing.assert_allclose(c.y, python.y, rtol=1e-12)
    assert c.counts == python.counts


@pytest.mark.slow
def test_sprk_takes_chains_and_says_what_it_cannot():
    ring, planets = cb.SCENES["fput"].with_(n=16), cb.SCENES["planets"]
    assert error(planets, "sprk-5", step=50.0, carry=(), engine="c") < 1e-8
    assert error(ring, "sprk-5", step=0.05, carry=(), engine="c") < 1e-7
    for scene in (
        cb.SCENES["quadratic_damping"],
        cb.SCENES["rigid_body"],
        cb.SCENES["fput"].with_(n=1024),
        PARTICLE.with_(t_end=2 * LONGEST / PARTICLE.gamma),
    ):
        found = cb.solve(scene, "sprk-5", step=0.1)
        assert found.status is Status.unsupported
        assert scene.name in found.message


# -- WHFast --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("scene", few_slow([KEPLER, PLANETS], PLANETS), ids=lambda s: s.name)
def test_whfast_keeps_the_contract_where_it_runs(scene):
    measured = {found.rule: found.measured for found in check_method(cb.METHODS["whfast"], scenes=[scene])}
    assert measured[6]["order"] == pytest.approx(2, abs=0.02)


@pytest.mark.slow
def test_whfast_drags_the_centre_of_mass_too():
    """Total momentum falls as e^{−γt} to round-off; and no order is lost for a pair that flies off."""
    scene = PLANETS.with_(p=PLANETS.p + np.tile((3e-3, -1e-3, 2e-3), 6) * np.repeat(PLANETS.masses, 3))
    solution = cb.solve(scene, "whfast", step=50.0, save_at=[scene.t_end], carry=())
    total = solution.p.reshape(-1, 6, 3).sum(axis=1)[-1]
    start = scene.p.reshape(6, 3).sum(axis=0)
    np.testing.assert_allclose(total, start * math.exp(-scene.gamma * scene.t_end), rtol=1e-11)
    assert order(scene, "whfast", (20, 28, 40, 56, 80)) == pytest.approx(2, abs=0.1)


def test_whfast_takes_bodies_in_any_order():
    turn = np.roll(np.arange(6), 2)
    moved = PLANETS.with_(
        masses=PLANETS.masses[turn], q=PLANETS.q.reshape(6, 3)[turn], p=PLANETS.p.reshape(6, 3)[turn]
    )
    one, other = (cb.solve(s, "whfast", step=50.0, save_at=[2000.0], carry=()).q[0] for s in (PLANETS, moved))
    np.testing.assert_allclose(other.reshape(6, 3), one.reshape(6, 3)[turn], rtol=1e-5)


def softened(r2, a, b, G):
    return -G * a * b / cb.math.sqrt(r2 + 0.01)


def test_whfast_sees_what_attracts():
    K, masses, *_ = attraction(KEPLER)
    assert pytest.approx(2.0) == K
    assert list(masses) == [1 / 1.7, 0.0]
    assert attraction(PLANETS)[0] == pytest.approx(PLANETS.parameters["G"])
    unfit = (PARTICLE, PLANETS.with_(pair=softened), KEPLER.with_(kappa=0.1), KEPLER.with_(strength=-1.0))
    pair = cb.Particles(
        name="pair",
        masses=(1.0, 2.0),
        pair=PLANETS.pair,
        parameters={"G": 1.0},
        q=[[0, 0, 0], [1, 0, 0]],
        p=[[0, 0, 0], [0, 1, 0]],
        t_end=1.0,
    )
    assert "nine tenths" in cb.METHODS["whfast"].refuses(pair)
    assert all("attract" in cb.METHODS["whfast"].refuses(scene) for scene in unfit)


# -- IAS15 ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "scene",
    [PARTICLE, cb.SCENES["quadratic_damping"].with_(t_end=4.0), KEPLER, PLANETS],
    ids=lambda s: s.name,
)
def test_ias15_reaches_round_off(scene):
    """Of any equations of second order: the action acts back, forces pull on thirds of particles, masses differ."""
    assert error(scene, "ias15", rtol=1e-14) < 2e-13


def test_ias15_passes_saved_times_and_stops_in_time():
    times = [0.4, 0.41, 3.9]
    solution = cb.solve(PARTICLE, "ias15", rtol=1e-12, save_at=times)
    assert cb.LAWS["solution_error"](solution) < 1e-13
    run = cb.prepare(KEPLER, "ias15", rtol=1e-12, save_at=[4.0])
    steps = run().counts.steps
    short = cb.solve(KEPLER, "ias15", rtol=1e-12, save_at=[4.0], max_steps=steps - 1)
    assert (short.status, short.counts.steps) == (Status.budget, steps - 1)
    assert np.isnan(short.y).all()


def test_ias15_knows_the_time():
    """Of the start, a scene's or a call's, and along the motion."""
    scene = cb.Driven(
        name="two",
        potential=lambda q, t: (q[0] * q[0] + 2 * q[1] * q[1]) / 2 - 0.3 * cb.math.cos(0.7 * t) * q[1],
        gamma=0.1,
        q=(1.0, 0.2),
        p=(0.0, 0.4),
        t=0.7,
        t_end=4.0,
    )
    assert error(scene, "ias15", rtol=1e-13) < 1e-13
    moved = cb.prepare(scene, "ias15", rtol=1e-10, save_at=[3.0])(t=2.0)
    own = cb.solve(scene.with_(t=2.0), "ias15", rtol=1e-10, save_at=[3.0])
    np.testing.assert_array_equal(moved.y, own.y)


def test_ias15_refuses_a_single_coordinate():
    assert "passes through 0" in cb.METHODS["ias15"].refuses(cb.SCENES["oscillator"])
    assert "q' = p/m" in cb.METHODS["ias15"].refuses(cb.SCENES["rigid_body"])


# -- what is not installed, and choices of two peers ------------------------------------------------------
@pytest.mark.parametrize(
    ("method", "package"), [("sprk-5", "sundials4py"), ("ias15", "rebound"), ("whfast", "rebound")]
)
def test_a_library_that_is_missing_is_one_line(method, package, monkeypatch):
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == package else found(name))
    setting = {"step": 0.1} if method != "ias15" else {"rtol": 1e-6}
    solution = cb.solve(KEPLER, method, **setting)
    assert solution.status is Status.unsupported
    assert solution.message == f"{package} is not installed: pip install {package}"


def test_heyoka_may_reorder_operations_of_motion_in_coordinates_only(monkeypatch):
    import heyoka

    from contactbench.peers import heyoka as peer

    made, original = [], heyoka.taylor_adaptive
    monkeypatch.setattr(peer, "_integrators", type(peer._integrators)(4))
    monkeypatch.setattr(
        heyoka, "taylor_adaptive", lambda *a, **k: made.append(k["fast_math"]) or original(*a, **k)
    )
    for scene in (PARTICLE, cb.SCENES["rigid_body"]):
        assert error(scene, "heyoka-taylor", rtol=1e-12) < 1e-12
    assert made == [True, False]


def test_fixed_point_iteration_asks_for_no_jacobian():
    scene = cb.SCENES["rigid_body_anisotropic"]
    newton, fixed = (cb.solve(scene, f"cvode-adams{own}", rtol=1e-8).counts for own in ("", "-fixed"))
    assert newton.jacobians > 0 == fixed.jacobians
    assert error(scene, "cvode-adams-fixed", rtol=1e-10) < 1e-7


@pytest.mark.parametrize(("scene", "method"), [(PARTICLE, "sprk-5"), (KEPLER, "whfast")])
def test_a_bare_call_outlives_its_run(scene, method):
    """What is timed is the call alone: the memory of the library goes with it, not with the run."""
    run = cb.prepare(scene, method, step=0.1, save_at=[scene.t_end], carry=())
    bare, start = run.bare, run.start.copy()
    memory = weakref.ref(run.loop)
    expected = bare(start)
    del run
    gc.collect()
    np.testing.assert_array_equal(bare(start), expected)
    if method == "whfast":
        assert memory() is not None
