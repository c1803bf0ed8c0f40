"""Scenes of many sites, and ensembles, on several devices and in several processes: what one core gives."""

import os
import socket
import subprocess
import sys

import numpy as np
import pytest

import contactbench as cb
from contactbench.ensembles.chunks import TILE

NAMES = ("fput", "sine_gordon")
#: relative to the largest component, after some twenty steps
ROUND_OFF = 1e-13
#: of an ensemble: a number no tile divides, in shares of different size
MEMBERS = 2 * TILE + 7
RUN = f"""
import sys
import jax
path, *where = sys.argv[1:]
if where:
    jax.distributed.initialize(f"127.0.0.1:{{where[0]}}", 2, int(where[1]))
import numpy as np
import contactbench as cb
def run(name, n):
    scene = cb.SCENES[name].with_(n=n, t_end=0.4)
    return cb.prepare(scene, "contact-rkn6", step=0.05, engine="jax", save_at=[0.2, 0.4])
runs = [run(name, 2**16) for name in {NAMES}]
assert all("collective-permute" in each.loop.xla.program.as_text() for each in runs)
uneven = run("fput", 2**16 + 1)
assert uneven.loop.mesh is None and str(uneven().status) == "ok"
mine = [slice({MEMBERS}), slice(50), slice(50, {MEMBERS})][1 + int(where[1]) if where else 0]
out = cb.ensemble("central", "contact-rkn6", {{"q": (np.linspace(0.5, 1.5, {MEMBERS})[mine], 0.1)}}, step=0.25)
ensemble = dict(final=out.scene.pack(out.final), statistics=[*out.statistics.values()], ok=out.endings["ok"])
devices = [each.loop.mesh.size for each in runs]
np.savez(path, processes=jax.process_count(), devices=devices, y=[each().y for each in runs], **ensemble)
"""


def start(path, *where: str, **flags: str) -> subprocess.Popen:
    flags |= {"JAX_PLATFORMS": "cpu", "NUMBA_NUM_THREADS": "2"}
    return subprocess.Popen([sys.executable, "-c", RUN, str(path), *where], env=os.environ | flags)


@pytest.fixture(scope="module")
def one():
    scenes = (cb.SCENES[name].with_(n=2**16, t_end=0.4) for name in NAMES)
    data = {"q": (np.linspace(0.5, 1.5, MEMBERS), 0.1)}
    runs = [cb.solve(scene, "contact-rkn6", step=0.05, save_at=[0.2, 0.4]).y for scene in scenes]
    return runs, cb.ensemble("central", "contact-rkn6", data, step=0.25)


def check(process: subprocess.Popen, path, one, processes: int, devices: int) -> np.ndarray:
    """The final states of the process's share of the ensemble, of which the statistics are over all shares."""
    assert process.wait(timeout=150) == 0
    found, (runs, whole) = np.load(path), one
    assert (found["processes"], *found["devices"]) == (processes, devices, devices)
    for y, expected in zip(found["y"], runs, strict=True):
        np.testing.assert_allclose(y, expected, rtol=0, atol=ROUND_OFF * np.abs(expected).max())
    np.testing.assert_allclose(found["statistics"], [*whole.statistics.values()], rtol=1e-9, atol=ROUND_OFF)
    assert found["ok"] == MEMBERS
    return found["final"]


def assert_whole(shares, one):
    whole = one[1]
    np.testing.assert_allclose(np.hstack(shares), whole.scene.pack(whole.final), rtol=0, atol=ROUND_OFF)


@pytest.mark.slow
def test_sites_on_four_devices_give_what_one_core_gives(one, tmp_path):
    path = tmp_path / "found.npz"
    final = check(start(path, XLA_FLAGS="--xla_force_host_platform_device_count=4"), path, one, 1, 4)
    assert_whole([final], one)


@pytest.mark.slow
def test_sites_in_two_processes_give_what_one_core_gives(one, tmp_path):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    paths = [tmp_path / f"{rank}.npz" for rank in range(2)]
    flags = {"JAX_CPU_COLLECTIVES_IMPLEMENTATION": "gloo", "JAX_NUM_CPU_DEVICES": "1"}
    hosts = [start(path, port, str(rank), **flags) for rank, path in enumerate(paths)]
    try:
        assert_whole([check(host, path, one, 2, 2) for host, path in zip(hosts, paths, strict=True)], one)
    finally:
        for host in hosts:
            host.kill()
