"""Methods and peers on scenes of many sites: every engine computes the same, and the laws hold at any size."""

import math
import subprocess
import sys
from threading import Timer

import numba
import numpy as np
import pytest

import cases
import contactbench as cb
from chains import BOUNDARIES, SMALL, bodies, chain, masses
from contactbench.methods import many
from contactbench.methods.fixed_step_run import FixedStepRun
from contactbench.methods.prepared import Prepared, stopwatch
from contactbench.numbers.protocol import CannotRecord
from contactbench.numbers.sites import total
from contactbench.peers.base import Peer
from contactbench.scene import many as many_scene
from contactbench.xla import jax, jnp

FIXED = [method.name for method in cases.FIXED]
PEERS = [m.name for m in cb.METHODS.values() if isinstance(m, Peer)]
#: merges, stages in a loop, processing, no merging: one of each way to be recorded
SHAPES = ("contact-strang", "contact-rkn6", "contact-abc", "herglotz2", "rk4")
#: ends of a vector and of a chunk of sites, and beyond
SIZES = (2, 7, 8, 9, 63, 2047, 2048, 2049, 5000)
#: relative; ten steps on another compiler leave 2·10⁻¹⁵
ROUND_OFF = 1e-14
#: laws over some hundred steps
KEPT = 1e-12


def runs_on(names, scene):
    return [name for name in names if cb.METHODS[name].refuses(scene) is None]


def states(scene, method, engine="numba", carry=("s",), save_at=(0.35, 1.0)):
    solution = cb.solve(scene, method, step=0.1, save_at=save_at, engine=engine, carry=carry)
    assert solution.ok, solution.message
    return solution.y


def gap(a, b):
    return np.abs(a - b).max() / np.abs(b).max()


# -- engines -----------------------------------------------------------------------------------------
@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("n", SIZES)
@pytest.mark.quick(n=9, boundary="ring")
def test_numba_agrees_with_arrays_whatever_the_length(n, boundary):
    """Held or not, masses of their own or not, with and without s, by every way to be recorded."""
    for held, mass in ((True, masses(n)), (False, 1.3)):
        scene = chain(n, boundary, held, mass)
        for method in runs_on(SHAPES, scene):
            for carry in ((), ("s",)):
                mine, plain = (states(scene, method, engine, carry) for engine in ("numba", "python"))
                assert gap(mine, plain) < ROUND_OFF, (method, held, carry)


@pytest.mark.parametrize(
    ("name", "method"), [(name, method) for name, scene in SMALL.items() for method in runs_on(FIXED, scene)]
)
@pytest.mark.quick(name="ring held", method=SHAPES)
@pytest.mark.quick(method=("contact-abc", "contact-rkn4"))
def test_numba_agrees_with_arrays_and_components_for_every_method(method, name):
    """Components: the same scene as a `Mechanical` of so many coordinates, by the engine of such scenes."""
    scene = SMALL[name]
    mine = states(scene, method)
    assert gap(states(scene, method, "python"), mine) < ROUND_OFF
    assert gap(states(scene.unrolled(), method), mine) < ROUND_OFF


JAX = [SMALL["ring masses"], chain(9, "fixed"), chain(2049, "free", mass=masses(2049)), SMALL["bodies 3D"]]


@pytest.mark.parametrize("scene", JAX, ids=["ring", "fixed", "free", "bodies"])
def test_jax_agrees(scene):
    for method in runs_on(("contact-strang", "contact-rkn4", "rk4"), scene):
        assert gap(states(scene, method, "jax"), states(scene, method)) < ROUND_OFF


@pytest.mark.parametrize("n", [2, 7, 8, 9, 65])
def test_bodies_agree_whatever_their_number(n):
    for dimensions in (1, 2, 3):
        scene = bodies(n, dimensions)
        for carry in ((), ("s",)):
            mine, plain = (states(scene, "contact-rkn4", engine, carry) for engine in ("numba", "python"))
            assert gap(mine, plain) < ROUND_OFF


@pytest.mark.parametrize("onsite", [None, lambda q: q / 3])
@pytest.mark.parametrize("boundary", BOUNDARIES)
def test_a_force_may_be_constant(boundary, onsite):
    scene = chain(8, boundary, onsite=onsite, bond=lambda r: r / 2, parameters={})
    for engine in ("python", "jax"):
        assert gap(states(scene, "contact-strang", engine), states(scene, "contact-strang")) < ROUND_OFF
    assert gap(states(scene.unrolled(), "contact-strang"), states(scene, "contact-strang")) < ROUND_OFF


@pytest.mark.parametrize("carry", [(), ("s",)])
@pytest.mark.parametrize("step", [0.1, 1.5, 1.9, 2.05, 3.0])
def test_a_run_that_its_loop_vouches_for_ends_as_one_that_is_looked_at(step, carry):
    scene = chain(64, t_end=60.0)
    run = cb.prepare(scene, "contact-strang", step=step, carry=carry, save_at=[30.0, 60.0])
    mine, y0 = run(), run.start
    theirs = Prepared.audit(run, y0, FixedStepRun.integrate(run, y0))
    assert (mine.status, mine.message, mine.end_time) == (theirs.status, theirs.message, theirs.end_time)
    np.testing.assert_array_equal(mine.y, theirs.y)


def test_a_good_run_is_not_looked_at_again(monkeypatch):
    """For that took as long as the run."""
    run = cb.prepare(chain(64), "contact-strang", step=0.1)
    for name in ("energy", "energy_terms"):
        monkeypatch.setattr(type(run.request.scene), name, lambda *_: pytest.fail("computed"))
    monkeypatch.setattr(run, "first_divergence", lambda *_: pytest.fail("searched"))
    assert run().ok


# -- threads -------------------------------------------------------------------------------------------
def end_by(run, count):
    """The end of a run by so many threads, and whether one of them was late."""
    scene, y = run.request.scene, run.start[None]
    out = np.full(y.size + run.loop.loop.seen, np.nan)
    late = run.loop.loop.call(
        scene, run.loop.loop.arrays(scene, np.array(scene.numbers()), run.h, run.n), y, out, count
    )
    return out[: y.size], late


@pytest.mark.parametrize("boundary", BOUNDARIES)
@pytest.mark.parametrize("carry", [(), ("s",)])
def test_any_number_of_threads_gives_the_same_bits(boundary, carry):
    scene = chain(many.SHARED + 3, boundary, mass=masses(many.SHARED + 3))
    for method in ("contact-strang", "contact-rkn6", "rk4"):
        run = cb.prepare(scene, method, step=0.1, carry=carry, save_at=[scene.t_end])
        alone = run.bare(run.start)
        for count in (2, 3):
            np.testing.assert_array_equal(end_by(run, count)[0], alone)


class Late:
    """In the place of a pool of threads: they begin after some time, or never."""

    def __init__(self, seconds):
        self.seconds, self.began = seconds, []

    def submit(self, *call):
        if self.seconds is not None:
            self.began.append(Timer(self.seconds, call[0], call[1:]))
            self.began[-1].start()


@pytest.mark.parametrize("seconds", [None, 0.0, 1e-3, 1e-2, 0.1])
def test_a_thread_that_is_late_is_left_out(seconds, monkeypatch):
    scene = chain(many.SHARED + 3, t_end=10.0)
    run, pool = cb.prepare(scene, "contact-strang", step=0.1, carry=("s",), save_at=[10.0]), Late(seconds)
    alone = run.bare(run.start)
    monkeypatch.setattr(many, "others", lambda count: pool)
    out, late = end_by(run, 3)
    assert late or seconds is not None
    for each in pool.began:
        each.join(10)
        assert not each.is_alive()
    np.testing.assert_array_equal(out, alone)


def test_threads_are_used_where_they_were_faster_and_none_was_late(monkeypatch):
    scene, rest, used = chain(many.SHARED, t_end=1.0), many.Rest(), []
    run = cb.prepare(scene, "contact-strang", step=0.1, save_at=[0.5, 1.0])
    monkeypatch.setattr(many, "REST", rest)
    monkeypatch.setattr(many, "threads_for", lambda sites: 2)
    monkeypatch.setattr(run.loop.loop, "call", lambda *given: used.append(given[4]) or late)
    late = True
    run.bare(run.start)  # not even measured
    assert (used[-2:], run.loop.loop.shares) == ([1, 1], {})
    assert rest.until > 0
    rest.until, late = 0.0, False
    for faster, count in ((True, 2), (False, 1)):
        run.loop.loop.shares[scene.sites, 2] = faster
        run.bare(run.start)
        assert used[-2:] == [count] * 2
    run.loop.loop.shares[scene.sites, 2], late = True, True
    run.bare(run.start)
    run.bare(run.start)
    assert used[-4:] == [2, 1, 1, 1]


BUSY = "while True: pass"


@pytest.mark.slow
@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="one core")
@pytest.mark.parametrize("n", [10**5, 10**6])
@pytest.mark.parametrize("busy", [0, 2])
def test_two_threads_are_hardly_ever_slower_than_one(n, busy, threads):
    run = cb.prepare(chain(n, t_end=2.0), "contact-strang", step=0.1, save_at=[2.0])
    spent = {1: 0.0, 2: 0.0}
    loops = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(busy)]
    try:
        for _ in range(10**7 // n):
            for count in spent:
                threads(count)
                elapsed = stopwatch()
                run.bare(run.start)
                spent[count] += elapsed()
    finally:
        for each in loops:
            each.kill()
    assert spent[2] < 1.5 * spent[1]  # where threads wait for one another it is 4


# -- peers ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "method"),
    [(n, m) for n in ("ring held", "free masses", "bodies 2D") for m in runs_on(PEERS, SMALL[n])],
)
@pytest.mark.quick(name="ring held")
@pytest.mark.quick(
    method=tuple(m for m in PEERS if m not in ("diffrax-kvaerno5", "diffrax-dopri8"))
)  # XLA compiles long
def test_peers_agree_with_components_to_their_tolerance(method, name):
    scene = SMALL[name]
    one, other = (cb.solve(each, method, rtol=1e-8, save_at=[0.5, 1.0]) for each in (scene, scene.unrolled()))
    assert [one.status, other.status] == [cb.Status.ok] * 2, (one.message, other.message)
    assert gap(one.y, other.y) < 1e-6
    assert gap(one.y, cb.reference(scene, [0.5, 1.0]).y) < 1e-6


# -- laws ----------------------------------------------------------------------------------------------
LARGE = 10**5


@pytest.mark.parametrize("boundary", ["ring", "free"])
@pytest.mark.parametrize("method", ["contact-strang", "contact-rkn6"])
def test_total_momentum_decays_to_round_off_however_many_sites(method, boundary):
    solution = cb.solve(chain(LARGE, boundary, held=False, gamma=0.5), method, step=0.1, save_at=[0.5, 1.0])
    # some ten terms of ΣP, of 10⁵ numbers that cancel to a part of it
    assert cb.LAWS["momentum_law"](solution) < 1e-13


def test_sums_over_a_million_sites_are_taken_in_pairs():
    """4·10⁻¹⁶ and 2·10⁻¹⁶ in pairs, 2·10⁻¹⁴ and 7·10⁻¹⁵ one after the other."""
    scene = cb.SCENES["fput"].with_(n=10**6, t_end=1.0)
    solution = cb.solve(scene, "contact-strang", step=0.1, save_at=[0.5, 1.0], carry=())
    assert cb.LAWS["momentum_law"](solution) < 3e-15
    summed = total(np.stack([scene.p, scene.q], axis=1))[0]
    assert summed == pytest.approx(math.fsum(scene.p), rel=1e-15, abs=0)


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_momentum_of_bodies_decays_to_round_off(dimensions):
    """Angular, on a line the total one."""
    solution = cb.solve(bodies(5, dimensions), "contact-rkn6", step=0.1)
    assert cb.LAWS["momentum_law"](solution) < 1e-13
    turned = cb.solve("planets", "contact-rkn6", step=100.0)
    assert cb.LAWS["momentum_law"](turned) < 1e-13


@pytest.mark.parametrize("method", ["contact-strang", "contact-rkn6"])
def test_random_tangents_show_a_contact_map_however_many_sites(method):
    for scene in (chain(LARGE, mass=masses(LARGE)), chain(LARGE, "free")):
        solution = cb.solve(scene, method, step=0.1, save_at=[1.0])
        assert cb.LAWS["contact_drift"](solution) < KEPT


@pytest.mark.parametrize("name", [*SMALL])
@pytest.mark.quick(name=("ring held", "free masses", "bodies 2D"))
def test_random_tangents_measure_what_all_of_them_do(name, monkeypatch):
    """4 tangents: a ratio of two chi-distributed lengths, within 6 of the whole but once in 100; the seed is fixed."""
    drifts = {}
    for most in (many_scene.ALL_TANGENTS, 0):
        monkeypatch.setattr(many_scene, "ALL_TANGENTS", most)
        for method in ("contact-strang", "rk4"):
            solution = cb.solve(SMALL[name], method, step=0.25, save_at=[1.0])
            drifts[method, most] = cb.LAWS["contact_drift"](solution)
    assert max(drifts["contact-strang", most] for most in (0, 65)) < KEPT
    assert 1 / 6 < drifts["rk4", 0] / drifts["rk4", 65] < 6
    assert drifts["rk4", 65] > 1e-7


# -- ensembles, step maps, exponents -------------------------------------------------------------------
def spread(scene, n):
    rng = np.random.default_rng(3)
    return {f: getattr(scene, f)[:, None] + 0.1 * rng.normal(size=(len(scene.q), n)) for f in "qp"}


def test_an_ensemble_notices_what_diverges_and_takes_one_start_for_all():
    scene = chain(6, onsite=lambda q: -q * q * q * q, t_end=4.0)
    out = cb.ensemble(scene, "contact-strang", {"q": spread(scene, 3)["q"] * [0.0, 0.1, 4.0]}, step=0.05)
    assert out.ok.tolist()[2] is False
    assert out.endings[cb.Status.diverged] >= 1
    out = cb.ensemble(SMALL["ring held"], "rk4", {"s": np.zeros(3)}, step=0.1, keep=False)
    assert out.endings[cb.Status.ok] == 3


@pytest.mark.parametrize("name", ["free masses", "bodies 3D"])
def test_a_step_map_takes_and_gives_an_array(name):
    scene = SMALL[name]
    step = cb.step_map(scene, "contact-rkn4")
    run = cb.solve(scene, "contact-rkn4", step=0.1, save_at=[0.1]).y[0]
    np.testing.assert_allclose(step(step.start, 0.1), run, rtol=1e-14, atol=1e-14)
    compiled = jax.jit(lambda y, gamma: step(y, 0.1, gamma=gamma))
    np.testing.assert_allclose(compiled(jnp.array(step.start), scene.gamma), run, rtol=1e-14, atol=1e-14)
    slope = jax.jacfwd(step)(jnp.array(step.start), 0.1)
    ours = cb.prepare(scene, "contact-rkn4", step=0.1, save_at=[0.1])
    assert gap(np.asarray(slope), ours.sensitivity(ours.start)[0]) < ROUND_OFF
    with pytest.raises(cb.BadInput, match="y has 3 entries"):
        step(step.start[:3], 0.1)
    with pytest.raises(CannotRecord):
        numba.njit(lambda y: step(y, 0.1))(step.start)


def test_exponents_are_those_of_the_components():
    scene, options = SMALL["ring held"], {"step": 0.1, "every": 0.5, "intervals": 16}
    mine, other = (cb.lyapunov(each, "contact-strang", **options) for each in (scene, scene.unrolled()))
    np.testing.assert_allclose(mine.exponents.value, other.exponents.value, rtol=0, atol=1e-11)
    assert mine.total.value == pytest.approx(-8 * scene.gamma, rel=1e-9)
    largest = cb.lyapunov(chain(64), "contact-strang", **options)
    assert len(largest.exponents.value) == many_scene.SOME_TANGENTS
    assert np.isnan([largest.total.value, largest.dimension.value]).all()


# -- ways to end ---------------------------------------------------------------------------------------
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "method", ["contact-strang", "rk4", "scipy-dop853", "scipy-radau", "cvode-adams", "cvode-bdf"]
)
def test_a_blow_up_ends_as_diverged_without_warnings(method):
    scene = chain(6, onsite=lambda q: -cb.math.exp(q), parameters={"k": 1e-3}, t_end=20.0)
    fixed = method in FIXED
    for engine in cb.METHODS[method].engines:
        run = cb.solve(scene, method, engine=engine, **({"step": 0.1} if fixed else {"rtol": 1e-6}))
        assert run.status is not cb.Status.ok, engine
        assert np.isnan(run.y[-1]).all()


@pytest.mark.parametrize("method", ["rk4", "cvode-adams"])
def test_a_mechanical_scene_of_too_many_components_is_refused(method):
    data = {"q": (1.0,) * 300, "p": (0.0,) * 300, "t_end": 1.0}
    scene = cb.Mechanical(name="large", potential=lambda q: q[0] * q[-1], **data)
    run = cb.solve(scene, method, **({"step": 0.1} if method in FIXED else {"rtol": 1e-6}))
    assert (run.status, "300" in run.message) == (cb.Status.unsupported, True)
