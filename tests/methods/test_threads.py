"""Prepared runs in several threads: all calls give what they give alone, whoever else is calling."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier

import numpy as np
import pytest

import contactbench as cb

THREADS = 4
#: calls of each solver in the part that runs always; of all pairs of a method and an engine in the slow one
QUICK, ALL = 2000, 10**4
#: a problem of a few steps, so that there are many calls and many switches within them
SCENE = cb.SCENES["particle"].with_(t_end=0.5)
TIMES = {"end": [0.5], "grid": [0.0, 0.2, 0.35, 0.5]}
PAIRS = [
    (method, engine)
    for method in cb.METHODS.values()
    for engine in method.engines
    if method.refuses(SCENE) is None
]


def prepared(method, engine, times, chosen=False):
    """chosen : a fixed step is chosen from a tolerance."""
    control = {} if method.exact else {"rtol": 1e-6} if method.adaptive or chosen else {"step": 0.1}
    return cb.prepare(SCENE, method, engine=engine, save_at=TIMES[times], **control)


def starts(thread):
    return {"q": (1.0 + thread / 8, 0.5), "p": (0.1 * thread, 0.2)}


def wrong(method, engine, times, calls, shared, chosen=False):
    """How many calls of four threads gave another result than alone; one run for all, or one for each."""
    run = prepared(method, engine, times, chosen)
    alone = [run(**starts(thread)).y.copy() for thread in range(THREADS)]
    runs = [run if shared else prepared(method, engine, times, chosen) for _ in range(THREADS)]
    barrier = Barrier(THREADS)

    def calling(thread):
        barrier.wait()
        found = (runs[thread](**starts(thread)).y for _ in range(calls // THREADS))
        return sum(not np.array_equal(y, alone[thread], equal_nan=True) for y in found)

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(THREADS) as pool:
            return sum(pool.map(calling, range(THREADS)))
    finally:
        sys.setswitchinterval(interval)


def stress(method, engine, times, calls):
    each = THREADS * -(-calls // (THREADS * len(PAIRS) * len(TIMES) * 2))  # in all no fewer
    for shared in (True, False):
        assert wrong(method, engine, times, each, shared) == 0


BY_PAIR = pytest.mark.parametrize(("method", "engine"), PAIRS, ids=[f"{m.name}-{e}" for m, e in PAIRS])
BY_TIMES = pytest.mark.parametrize("times", TIMES)
#: the runs with a state of their own, which takes a lock; the last one divides its intervals anew at every call
STATEFUL = [("heyoka-taylor", "llvm"), ("cvode-bdf", "c"), ("contact-rkn6", "numba")]


@BY_TIMES
@pytest.mark.parametrize(("method", "engine"), STATEFUL)
@pytest.mark.quick(times="end")
def test_threads_do_not_disturb_each_other(method, engine, times):
    for shared in (True, False):
        assert wrong(cb.METHODS[method], engine, times, QUICK, shared, chosen=True) == 0


@pytest.mark.slow
@BY_TIMES
@BY_PAIR
def test_ten_thousand_calls_of_all_solvers_in_four_threads(method, engine, times):
    stress(method, engine, times, ALL)
