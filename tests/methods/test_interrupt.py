"""Ctrl-C ends long runs of compiled solvers, whose pieces change no result; threads do not disturb each other."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import numpy as np
import pytest

import contactbench as cb
from cases import environment, few_slow
from contactbench.methods import by_tolerance, loops
from contactbench.peers import cyrk, heyoka, sundials
from contactbench.scene import Cache

PEERS = {"cvode-adams": sundials, "cvode-bdf": sundials, "heyoka-taylor": heyoka, "cyrk-dop853": cyrk}
TIMES = {"end": np.array([100.0]), "grid": np.linspace(1.0, 100.0, 37)}


@pytest.mark.parametrize("save_at", TIMES.values(), ids=TIMES)
@pytest.mark.parametrize("method", PEERS)
def test_pieces_change_nothing(method, save_at, monkeypatch):
    for most in (10**8, 100):
        scene = cb.SCENES["particle"].with_(t_end=100.0)
        run = cb.prepare(scene, method, rtol=1e-7, save_at=save_at, max_steps=most)
        whole = run()
        for piece in (7, 64):
            monkeypatch.setattr(PEERS[method], "PIECE", piece)
            parts = run()
            np.testing.assert_array_equal(parts.y, whole.y)
            assert parts.counts[:3] == whole.counts[:3]
            for name in ("status", "message", "end_time"):
                assert getattr(parts, name) == getattr(whole, name)
            monkeypatch.undo()


#: runs that would take an hour, each interrupted after it has begun
HOUR = """
import signal, sys, threading
import contactbench as cb

scene = cb.SCENES["kepler"].with_(gamma=0.0, t_end=1e9)
times, *methods = sys.argv[1:]
for way, _, name in (method.partition(" ") for method in methods):
    setting = {"step": 0.05} if name == "contact-log8" else {"rtol": 1e-9}
    run = cb.prepare(scene, name, save_at=eval(times), max_steps=10**14, **setting)
    try:
        threading.Timer(0.1, signal.raise_signal, [signal.SIGINT]).start()
        run.bare(run.start) if way == "bare" else run()
    except KeyboardInterrupt:
        print(way, name)
"""
OWN = ("rk8-7", "rkn8-6", "rkn12-10", "contact-log8")


@pytest.mark.parametrize("times", few_slow(["[1e9]", "[5e8, 1e9]"], "[5e8, 1e9]"))
def test_an_interrupt_ends_a_long_run(times):
    methods = [f"whole {name}" for name in ("rk8-7", *PEERS)] + [f"bare {name}" for name in OWN[2:]]
    line = [sys.executable, "-c", HOUR, times, *methods]
    run = subprocess.run(line, capture_output=True, text=True, env=environment(), timeout=500)
    assert run.stdout.splitlines() == methods, run.stderr


@pytest.mark.parametrize("method", OWN)
def test_a_run_of_many_steps_is_the_one_of_few(method, monkeypatch):
    """Attempts beyond those of a short run are made in a thread, and nothing else changes."""
    scene = cb.SCENES["kepler"]
    setting = {"step": 0.05} if method == "contact-log8" else {"rtol": 1e-9}
    options = {"save_at": np.linspace(1.0, scene.t_end, 5), **setting}
    once = cb.prepare(scene, method, **options)()
    monkeypatch.setattr(loops, "LONG", 1e4)
    monkeypatch.setattr(by_tolerance, "_loops", Cache(8))
    run = cb.prepare(scene, method, **options)
    again = run()
    np.testing.assert_array_equal(again.y, once.y)
    assert again.counts == once.counts
    np.testing.assert_array_equal(run.bare(run.start), once.y[-1])


# -- several threads ---------------------------------------------------------------------------------
THREADS = 4
#: the runs with a state of their own, which takes a lock; the last one divides its intervals anew at every call
STATEFUL = [("heyoka-taylor", "llvm"), ("cvode-bdf", "c"), ("contact-rkn6", "llvm")]
#: a problem of a few steps, so that there are many calls and many switches within them
SCENE = cb.SCENES["particle"].with_(t_end=0.5)
SAVED = {"end": [0.5], "grid": [0.0, 0.2, 0.35, 0.5]}
PAIRS = [(m, engine) for m in cb.METHODS.values() for engine in m.engines if m.refuses(SCENE) is None]


def prepared(method, engine, times):
    chosen = method.adaptive or (method.name, engine) in STATEFUL
    control = {} if method.exact else {"rtol": 1e-6} if chosen else {"step": 0.1}
    return cb.prepare(SCENE, method, engine=engine, save_at=SAVED[times], **control)


def starts(thread):
    return {"q": (1.0 + thread / 8, 0.5), "p": (0.1 * thread, 0.2)}


@pytest.mark.parametrize("times", SAVED)
@pytest.mark.parametrize("shared", [True, False], ids=["one run", "a run each"])
@pytest.mark.parametrize(("method", "engine"), PAIRS, ids=[f"{m.name}-{e}" for m, e in PAIRS])
@pytest.mark.quick(method=("heyoka-taylor", "cvode-bdf"), engine=("llvm", "c"), shared=True, times="end")
@pytest.mark.quick(method="contact-rkn6", engine="llvm", shared=True, times="end")
def test_threads_do_not_disturb_each_other(method, engine, shared, times):
    calls = 600 if (method.name, engine) in STATEFUL else 60  # 10⁴ of all pairs
    run = prepared(method, engine, times)
    alone = [run(**starts(thread)).y.copy() for thread in range(THREADS)]
    runs = [run if shared else prepared(method, engine, times) for _ in range(THREADS)]
    barrier = Barrier(THREADS)

    def calling(thread):
        barrier.wait()
        found = (runs[thread](**starts(thread)).y for _ in range(calls // THREADS))
        return sum(not np.array_equal(y, alone[thread], equal_nan=True) for y in found)

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(THREADS) as pool:
            assert sum(pool.map(calling, range(THREADS))) == 0
    finally:
        sys.setswitchinterval(interval)


def test_a_cache_gives_all_threads_what_was_made_first():
    both, cache = Barrier(2), Cache(2)

    def make():
        both.wait()
        return object()

    with ThreadPoolExecutor(2) as pool:
        first, second = pool.map(lambda _: cache.get("key", make), range(2))
    assert first is second is cache.get("key", make)
