"""How an ensemble is shared out among the cores of a machine, and how much of it is in memory at a time."""

from __future__ import annotations

import numpy as np
import pytest

import contactbench as cb
from contactbench.ensembles import chunks
from contactbench.ensembles.chunks import AHEAD, LANES, equal_share, on_cores
from contactbench.ensembles.members import ENERGY

SCENE = cb.SCENES["particle"]


def states(n):
    """Packed initial states (4, n)."""
    return np.array([*SCENE.q, *SCENE.p])[:, None] + 0.05 * np.random.default_rng(1).normal(size=(4, n))


def parts_of(n, share):
    return [min(share, n - first) for first in range(0, n, share)]


@pytest.mark.parametrize("n", [1, 31, 1000, 4096, 200_000, 999_999])
@pytest.mark.parametrize("workers", [1, 2, 3, 16])
@pytest.mark.parametrize("chunk", [LANES, 1000, 2**16])
def test_no_core_has_more_than_a_tile_a_chunk_above_its_share(n, workers, chunk):
    parts = parts_of(n, equal_share(n, workers, chunk))
    assert max(parts) <= chunk
    assert sum(parts) == n
    loads = [sum(-(-part // LANES) for part in parts[k::workers]) for k in range(workers)]
    even = -(-n // LANES) / workers
    assert max(loads) <= even + -(-len(parts) // workers)


def prepared():
    run = cb.prepare(SCENE, "contact-rkn6", step=1.0, save_at=[SCENE.t_end], carry=(), engine="numba")
    return run, run.loop


def test_a_few_chunks_are_begun_ahead_and_no_more(monkeypatch):
    """Memory stays bounded where only the statistics are kept, however slowly they are asked for."""
    begun, integrate = [], chunks.side_by_side
    monkeypatch.setattr(chunks, "side_by_side", lambda *args: begun.append(1) or integrate(*args))
    results = on_cores(*prepared(), [ENERGY], states(100 * LANES), 2, LANES)
    for done in range(3):
        next(results)
        assert done < len(begun) <= done + 1 + 2 * AHEAD
    assert len(list(results)) == 97
    assert len(begun) == 100


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_the_number_of_cores_changes_nothing(workers):
    y0 = states(1001)
    run, loop = prepared()
    parts = list(on_cores(run, loop, [ENERGY], y0, workers, 300))
    y, measures, end = (np.concatenate(arrays, axis=-1) for arrays in zip(*parts, strict=True))
    (alone,) = on_cores(run, loop, [ENERGY], y0, 1, 2000)
    for ours, theirs in zip((y, measures, end), alone, strict=True):
        np.testing.assert_array_equal(ours, theirs)
