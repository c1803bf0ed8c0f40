"""Ctrl-C ends long runs of compiled solvers, and the pieces they are cut into change no result."""

import signal
import threading
import time

import numpy as np
import pytest

import contactbench as cb
from cases import few_slow
from contactbench.peers import cyrk, heyoka, sundials

PEERS = {"cvode-adams": sundials, "cvode-bdf": sundials, "heyoka-taylor": heyoka, "cyrk-dop853": cyrk}
TIMES = {"end": np.array([100.0]), "grid": np.linspace(1.0, 100.0, 37)}


@pytest.mark.parametrize("save_at", TIMES.values(), ids=TIMES)
@pytest.mark.parametrize("method", PEERS)
def test_pieces_change_nothing(method, save_at, monkeypatch):
    for most in (10**8, 100):
        scene = cb.SCENES["particle"].with_(t_end=100.0)
        run = cb.prepare(scene, method, rtol=1e-9, save_at=save_at, max_steps=most)
        whole = run()
        for piece in (7, 64):
            monkeypatch.setattr(PEERS[method], "PIECE", piece)
            parts = run()
            np.testing.assert_array_equal(parts.y, whole.y)
            assert parts.counts[:3] == whole.counts[:3]
            for name in ("status", "message", "end_time"):
                assert getattr(parts, name) == getattr(whole, name)
            monkeypatch.undo()


@pytest.mark.parametrize("save_at", few_slow(["end", "grid"], "grid"))
@pytest.mark.parametrize("method", PEERS)
def test_an_interrupt_ends_a_long_run(method, save_at):
    scene = cb.SCENES["particle"].with_(gamma=0.0, t_end=1e9)
    options = {"save_at": 1e7 * TIMES[save_at], "max_steps": 5 * 10**7}  # for some ten seconds
    run = cb.prepare(scene, method, rtol=1e-9, **options)
    begun, timer = time.monotonic(), threading.Timer(0.3, signal.raise_signal, [signal.SIGINT])
    timer.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            run()
    finally:
        timer.cancel()
    assert time.monotonic() - begun < 6
