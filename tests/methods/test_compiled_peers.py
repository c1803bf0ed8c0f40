"""CVODE's C library and CyRK's C++ solvers, run without Python between them and the scene."""

import ctypes
import gc
import importlib.util
import sys
from pathlib import Path

import CyRK
import numpy as np
import pytest

import contactbench as cb
from cases import ALL_SCENES, by_name, c_functions, counts_memory, handed_out, mine, random_state
from contactbench.peers import abi, compiled
from contactbench.peers.base import derivative
from contactbench.solution import Status
from contactbench.testing.method import CASES

PARTICLE, BODY, ANISOTROPIC = CASES
CVODE = ("cvode-adams", "cvode-bdf")
CYRK = tuple(name for name in cb.METHODS if name.startswith("cyrk-"))
PEERS = [(name, "c") for name in CVODE] + [(name, "c++") for name in CYRK]

peers = pytest.mark.parametrize(("method", "engine"), PEERS, ids=[name for name, _ in PEERS])


# -- the scene as C functions ----------------------------------------------------------------------
@by_name([*ALL_SCENES, ANISOTROPIC])
@pytest.mark.parametrize("fields", ["all", "none"])
def test_c_functions_are_the_scene(scene, fields):
    """To a few units in the last place: a product and a sum may be one operation."""
    carry = scene.carry(None if fields == "all" else ())
    for seed in range(3):
        x = random_state(scene, seed, carry)
        slopes, jacobian, data = c_functions(scene, carry)
        t, y = getattr(x, "t", 0.0), scene.without_clock(scene.pack(x))
        expected = np.array(scene.without_clock(scene.pack(scene.rhs(x))))
        np.testing.assert_allclose(slopes(t, y), expected, rtol=1e-13, atol=1e-14 * np.abs(expected).max())
        rows = derivative(scene, x, carry)
        rows = np.array([scene.without_clock(row) for row in scene.without_clock(rows)])
        np.testing.assert_allclose(jacobian(t, y), rows, rtol=1e-13, atol=1e-14 * np.abs(rows).max())
        assert data[:2].tolist() == [1.0, 1.0]  # calls


# -- runs ------------------------------------------------------------------------------------------
@peers
@by_name([PARTICLE, BODY, ANISOTROPIC])
@pytest.mark.quick(scene="rigid_body", method=("cvode-adams", "cyrk-dop853", "cyrk-lsoda"))
def test_saved_states_are_as_accurate_as_the_last(method, engine, scene):
    """At times between steps: the interpolation must not show."""
    rtol = 1e-8
    run = cb.prepare(scene, method, rtol=rtol, save_at=np.linspace(0, 4, 21), engine=engine)
    solution = run()
    assert solution.ok
    assert cb.LAWS["solution_error"](solution) < 300 * rtol
    np.testing.assert_array_equal(solution.y[0], scene.pack(scene.initial(scene.optional)))


@pytest.mark.parametrize(("method", "engine"), [*PEERS, ("cvode-bdf", "c+python")])
def test_steps_do_not_depend_on_what_is_saved(method, engine):
    """And the last state is the solver's own, the same to the bit."""
    runs = [
        cb.solve(PARTICLE, method, rtol=1e-7, engine=engine, save_at=times)
        for times in ([4.0], [0.0, 4.0], [1e-3, 4.0], np.linspace(0, 4, 50))
    ]
    assert len({run.counts.steps for run in runs}) == 1
    for run in runs[1:]:
        np.testing.assert_array_equal(run.y[-1], runs[0].y[-1])


# -- counts ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("method", CVODE)
def test_cvode_counts_as_many_calls_as_the_c_functions(method):
    run = cb.prepare(PARTICLE, method, rtol=1e-9, engine="c", save_at=[4.0])
    counts = run().counts
    lib, number = sys.modules["contactbench.peers.abi.cvode"].library, ctypes.c_long()
    told = {"RhsEvals": counts.evaluations, "JacEvals": counts.jacobians, "Steps": counts.steps}
    for name, found in told.items():
        getattr(lib, f"CVodeGetNum{name}")(ctypes.c_void_p(run.call.memory.memory), ctypes.byref(number))
        assert number.value == found > 0


@pytest.mark.parametrize(
    ("name", "stages"),
    [("scipy-dop853", 12), *((n, cb.METHODS[n].stages) for n in CYRK if cb.METHODS[n].stages)],
)
@pytest.mark.parametrize("rtol", [1e-3, 1e-6, 1e-9])
def test_explicit_methods_spend_their_stages_on_every_attempt(name, stages, rtol):
    """Two evaluations before the first step, then so many an attempted step: a wrong number leaves a rest."""
    for scene in (PARTICLE, cb.SCENES["kepler_drag"].with_(t_end=10.0)):
        counts = cb.solve(scene, name, rtol=rtol, save_at=[scene.t_end]).counts
        assert counts.evaluations - 2 == stages * (counts.steps + counts.rejected)
        if name == "scipy-dop853":  # the evaluations of its interpolants are no rejected steps
            saved = cb.solve(scene, name, rtol=rtol, save_at=np.linspace(0, scene.t_end, 40)).counts
            assert (saved.steps, saved.rejected) == (counts.steps, counts.rejected)


# -- ways to end -----------------------------------------------------------------------------------
@peers
def test_a_run_that_failed_leaves_the_next_one_as_it_was(method, engine):
    scene = cb.SCENES["escape"]
    run = cb.prepare(scene, method, rtol=1e-6, save_at=[scene.t_end], engine=engine)
    assert run().status is Status.diverged
    calm = {"q": (1.0, 0.5), "p": (0.0, 0.3)}
    fresh = cb.prepare(scene, method, rtol=1e-6, save_at=[scene.t_end], engine=engine)(**calm)
    assert fresh.ok
    np.testing.assert_array_equal(run(**calm).y, fresh.y)
    assert run().status is Status.diverged


#: what compiles, with an engine that does not where there is one
COMPILERS = [(*peer, "c+python" if peer[0] in CVODE else None) for peer in PEERS]
COMPILERS += [("heyoka-taylor", "llvm", None), ("contact-strang", "llvm", "python")]


@pytest.mark.parametrize(("method", "engine", "other"), COMPILERS)
def test_a_force_that_branches_is_unsupported_where_it_is_compiled(method, engine, other):
    gradient = lambda q: (q[0] if q[0] > 0 else 2 * q[0],)  # noqa: E731
    scene = mine(lambda q: q[0] ** 2 / 2 if q[0] > 0 else q[0] ** 2, t_end=2.0, gradient=gradient)
    setting = {"rtol": 1e-6} if cb.METHODS[method].adaptive else {"step": 0.1}
    solution = cb.solve(scene, method, engine=engine, **setting)
    assert solution.status is Status.unsupported
    assert solution.message
    assert np.isnan(solution.y).all()
    if other:
        assert cb.solve(scene, method, **setting).engine == other  # what can run it is the default


@pytest.fixture
def load_anew(monkeypatch):
    for name in ("cvode", "cyrk"):
        monkeypatch.delitem(sys.modules, f"contactbench.peers.abi.{name}", raising=False)
        monkeypatch.delattr(abi, name, raising=False)


@pytest.mark.usefixtures("load_anew")
@pytest.mark.parametrize(
    ("method", "place", "name", "value", "reason"),
    [
        ("cvode-bdf", compiled, "MAJOR", 99, "its C interface is known for version 99 only"),
        (
            "cvode-bdf",
            importlib.util,
            "find_spec",
            lambda name: None,
            "is not installed: pip install scikit-sundae",
        ),
        ("cvode-bdf", Path, "glob", lambda self, pattern: [], "CVODE library is not in"),
        ("cyrk-dop853", CyRK, "__version__", "0.21.0", "CyRK 0.21.0 may have another C interface"),
    ],
    ids=["another version", "not installed", "no library", "another CyRK"],
)
def test_without_its_library_a_peer_is_unsupported(monkeypatch, method, place, name, value, reason):
    engine = cb.METHODS[method].engines[0]
    monkeypatch.setattr(place, name, value)
    solution = cb.solve(PARTICLE, method, rtol=1e-6, engine=engine)
    assert solution.status is Status.unsupported
    assert reason in solution.message
    monkeypatch.undo()
    assert cb.solve(PARTICLE, method, rtol=1e-6, engine=cb.METHODS[method].engines[-1]).ok


# -- memory and threads ----------------------------------------------------------------------------
def left_behind(run) -> int:
    """Bytes by which 300 calls of `run` add to what the C library has handed out and not got back.

    The least of two goes: what is allocated once, or by another thread, plays no part.  The memory of the process
    would not do: it has holes, in which a leak of megabytes goes unseen.
    """
    grown = []
    gc.collect()
    gc.freeze()  # what other tests have left need not be looked through again
    try:
        for _ in range(2):
            before = handed_out()
            for _ in range(300):
                run()
            gc.collect()
            grown.append(handed_out() - before)
    finally:
        gc.unfreeze()
    return min(grown)


@counts_memory
@peers
@pytest.mark.quick(method=("cvode-bdf", "cyrk-dop853"))
def test_neither_calls_nor_prepared_runs_keep_memory(method, engine):
    """A vector of CVODE's, the smallest thing it makes, would be 200 bytes every time; measured: none."""

    def prepared(times):
        return cb.prepare(PARTICLE, method, rtol=1e-4, save_at=times, engine=engine)

    runs = [prepared(times) for times in ([0.1], [0.0, 0.05, 0.1])]
    start = runs[0].start
    assert left_behind(lambda: [run.integrate(start) for run in runs]) < 300 * 16
    assert left_behind(lambda: prepared([0.1])()) < 300 * 16
