"""How an ensemble is shared out: among cores, by executors, also where a worker dies midway; and its memory."""

import multiprocessing
import os
import signal
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest

import contactbench as cb
from cases import mine
from contactbench.ensembles import chunks
from contactbench.ensembles.chunks import AHEAD, ATTEMPTS, equal_share, on_cores
from contactbench.ensembles.members import ENERGY
from contactbench.methods.loops import FEW_LANES, LANES, loop_of

MANY, CHUNK = 10_000, 500
SCENE = cb.SCENES["particle"]


def solved(**options):
    rng = np.random.default_rng(0)
    data = {"q": tuple(c + 0.05 * rng.normal(size=MANY) for c in SCENE.q)}
    return cb.ensemble(SCENE, "contact-rkn6", data, step=0.005, progress=False, **options)


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


@pytest.mark.posix
@pytest.mark.slow
def test_a_process_pool_that_lost_a_worker_is_refused():
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        executor = Watched(pool, lambda: os.kill(next(iter(pool._processes)), signal.SIGKILL))
        with pytest.raises(cb.BadInput, match="executor: Watched is broken"):
            solved(executor=executor, chunk=CHUNK)


@pytest.mark.posix
@pytest.mark.slow
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
    with pytest.raises(cb.BadInput, match="engine = 'numba'"):
        solved(executor=Losing(0), parameters={"gamma": np.full(MANY, 0.1)}, engine="numba")


# -- cores -----------------------------------------------------------------------------------------
def states(n):
    return np.array([*SCENE.q, *SCENE.p])[:, None] + 0.05 * np.random.default_rng(1).normal(size=(4, n))


@pytest.mark.parametrize("n", [1, 31, 1000, 4096, 200_000, 999_999])
@pytest.mark.parametrize("workers", [1, 2, 3, 16])
@pytest.mark.parametrize("chunk", [LANES, 1000, 2**16])
def test_no_core_has_more_than_a_tile_a_chunk_above_its_share(n, workers, chunk):
    share = equal_share(n, workers, chunk)
    parts = [min(share, n - first) for first in range(0, n, share)]
    assert max(parts) <= chunk
    assert sum(parts) == n
    loads = [sum(-(-part // LANES) for part in parts[k::workers]) for k in range(workers)]
    even = -(-n // LANES) / workers
    assert max(loads) <= even + -(-len(parts) // workers)


def prepared():
    run = cb.prepare(SCENE, "contact-rkn6", step=1.0, save_at=[SCENE.t_end], carry=(), engine="numba")
    return run, run.loop.loop


def test_a_few_chunks_are_begun_ahead_and_no_more(monkeypatch):
    """Memory stays bounded where only the statistics are kept, however slowly they are asked for."""
    begun, integrate = [], chunks.side_by_side
    monkeypatch.setattr(chunks, "side_by_side", lambda *args: begun.append(1) or integrate(*args))
    results = on_cores(*prepared(), [ENERGY], states(100 * LANES), 2, LANES, {})
    for done in range(3):
        next(results)
        assert done < len(begun) <= done + 1 + 2 * AHEAD
    assert len(list(results)) == 97
    assert len(begun) == 100


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_the_number_of_cores_changes_nothing(workers):
    y0 = states(1001)
    run, loop = prepared()
    parts = list(on_cores(run, loop, [ENERGY], y0, workers, 300, {}))
    y, measures, end = (np.concatenate(arrays, axis=-1) for arrays in zip(*parts, strict=True))
    (alone,) = on_cores(run, loop, [ENERGY], y0, 1, 2000, {})
    for ours, theirs in zip((y, measures, end), alone, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_a_long_loop_has_few_lanes():
    """LLVM takes seconds to compile 32 of them, more than an ensemble runs; the results are the same."""
    damping = {"damping": lambda s: 0.1 * s + s**3, "damping_slope": lambda s: 0.1 + 3 * s * s}
    cubic = mine(lambda q: q[0] ** 2 / 2, kind=cb.GeneralDamping, **damping)
    method, starts = "contact-strang", np.linspace(0.5, 1.0, 5)
    loops = [
        loop_of(cb.METHODS[method], scene.recorded(), ("s",)) for scene in (cubic, cb.SCENES["particle"])
    ]
    assert [loop.lanes for loop in loops] == [FEW_LANES, LANES]
    run = cb.prepare(cubic, method, step=0.1)
    found = cb.ensemble(cubic, method, {"q": (starts,)}, step=0.1)
    np.testing.assert_allclose(found.final.q[0], [run(q=(q,)).q[-1, 0] for q in starts], rtol=1e-13)
