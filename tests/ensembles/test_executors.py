"""Chunks mapped by executors: the ensemble of one process, also where a worker dies midway."""

from __future__ import annotations

import multiprocessing
import os
import signal
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest

import contactbench as cb
from contactbench.ensembles.chunks import ATTEMPTS

MANY, CHUNK = 10_000, 500
SCENE = cb.SCENES["particle"]


def data():
    rng = np.random.default_rng(0)
    return {"q": tuple(c + 0.05 * rng.normal(size=MANY) for c in SCENE.q)}


def solved(**options):
    return cb.ensemble(SCENE, "contact-rkn6", data(), step=0.005, progress=False, **options)


@pytest.fixture(scope="module")
def alone():
    return solved()


def same(out, alone):
    """Every trajectory there, in its place, and counted once."""
    assert out.endings == alone.endings
    assert sum(out.endings.values()) == MANY
    for own, other in ((out.final.q, alone.final.q), (out.final.p, alone.final.p)):
        np.testing.assert_array_equal(np.array(own), np.array(other))
    for name, values in alone.measures.items():
        np.testing.assert_array_equal(out.measures[name], values)
        assert out.statistics[name].max == alone.statistics[name].max
        assert out.statistics[name].mean == pytest.approx(alone.statistics[name].mean, rel=1e-12)


class Watched(Executor):
    """An executor that calls `strike` once, as soon as the first chunk is done."""

    def __init__(self, inner, strike):
        self.inner, self.strike, self.given, self.left_then = inner, strike, [], None

    def submit(self, function, /, *arguments, **keywords):
        future = self.inner.submit(function, *arguments, **keywords)
        self.given.append(future)
        future.add_done_callback(self.struck)
        return future

    def struck(self, _):
        if self.left_then is None:
            self.left_then = sum(not future.done() for future in self.given)
            self.strike()


def test_a_thread_pool_gives_what_one_process_gives(alone):
    with ThreadPoolExecutor(2) as pool:
        same(solved(executor=pool, chunk=CHUNK), alone)


@pytest.mark.slow
def test_a_process_pool_that_lost_a_worker_is_refused():
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        executor = Watched(pool, lambda: os.kill(next(iter(pool._processes)), signal.SIGKILL))
        with pytest.raises(cb.BadInput, match="executor: Watched is broken"):
            solved(executor=executor, chunk=CHUNK)


def test_a_worker_of_a_dask_cluster_dies_midway(alone):
    from distributed import Client, LocalCluster

    with (
        LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        workers = set(client.run(os.getpid).values())
        executor = Watched(client.get_executor(), lambda: os.kill(min(workers), signal.SIGKILL))
        out = solved(executor=executor, chunk=CHUNK)
        client.wait_for_workers(2)
        assert min(workers) not in client.run(os.getpid).values()
    assert len(workers) == 2
    assert executor.left_then > 0
    same(out, alone)


class Losing(Executor):
    """An executor that loses what it is given, so many times."""

    def __init__(self, times):
        self.left = times

    def submit(self, function, /, *arguments, **keywords):
        future = Future()
        if self.left:
            self.left -= 1
            future.set_exception(ConnectionError("the worker is gone"))
        else:
            future.set_result(function(*arguments, **keywords))
        return future


def test_a_chunk_is_given_again_but_not_for_ever(alone):
    same(solved(executor=Losing(ATTEMPTS - 1)), alone)
    with pytest.raises(cb.BadInput, match=f"chunk 0 was lost {ATTEMPTS} times: .*the worker is gone"):
        solved(executor=Losing(10**6))


def test_an_error_of_the_chunk_itself_is_not_tried_again():
    executor = Losing(0)
    own = {"parameters": {"gamma": np.full(4, 0.1)}, "engine": "numba", "progress": False}
    with pytest.raises(cb.BadInput, match="engine = 'numba'"):
        cb.ensemble(SCENE, "rk4", {"q": (np.ones(4), 0.5)}, step=0.1, executor=executor, **own)
