"""Prepared runs in several threads: all calls give what they give alone, whoever else is calling."""

import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import numpy as np
import pytest

import contactbench as cb
from contactbench.scene import Cache

THREADS = 4
#: the runs with a state of their own, which takes a lock; the last one divides its intervals anew at every call
STATEFUL = [("heyoka-taylor", "llvm"), ("cvode-bdf", "c"), ("contact-rkn6", "llvm")]
#: a problem of a few steps, so that there are many calls and many switches within them
SCENE = cb.SCENES["particle"].with_(t_end=0.5)
TIMES = {"end": [0.5], "grid": [0.0, 0.2, 0.35, 0.5]}
PAIRS = [(m, engine) for m in cb.METHODS.values() for engine in m.engines if m.refuses(SCENE) is None]


def prepared(method, engine, times):
    chosen = method.adaptive or (method.name, engine) in STATEFUL
    control = {} if method.exact else {"rtol": 1e-6} if chosen else {"step": 0.1}
    return cb.prepare(SCENE, method, engine=engine, save_at=TIMES[times], **control)


def starts(thread):
    return {"q": (1.0 + thread / 8, 0.5), "p": (0.1 * thread, 0.2)}


@pytest.mark.parametrize("times", TIMES)
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
