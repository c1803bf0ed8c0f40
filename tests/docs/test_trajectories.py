"""The code of docs/trajectories.md gives what runs of `cb.prepare` give: in one process, and divided among two."""

import os
import re
import socket
import subprocess
import sys

import numpy as np
import pytest

import contactbench as cb
from cases import REPOSITORY

PAGE = (REPOSITORY / "docs" / "trajectories.md").read_text(encoding="utf-8")
ONE, SAVED, DIVIDED = re.findall(r"^```python[^\n]*\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
STEPS = 100
#: a few roundings a step, of states of size 1
ROUND_OFF = 4 * np.finfo(float).eps * STEPS
#: seconds that two processes have, imports included
LIMIT = 300
#: what a process writes of the third block's variables
WRITE = """
import sys
np.savez(sys.argv[1], start=start, gamma=gamma, own=own, mean=mean, devices=mesh.size)
"""


def state_at(times, start, gamma):
    """Return the states (d, n) of every trajectory at the last time, or (n, times, d) at each of several."""
    made = []
    for q1, q2, p1, p2, rate in zip(*start, gamma, strict=True):
        scene = cb.SCENES["particle"].with_(q=(q1, q2), p=(p1, p2), gamma=rate)
        made.append(cb.prepare(scene, "contact-rkn4", step=0.1, carry=(), save_at=times)().y)
    return np.array(made) if len(times) > 1 else np.array(made)[:, 0].T


def variables(block):
    """Return the variables of a block that runs by itself."""
    made = {}
    exec(compile(block, "trajectories.md", "exec"), made)
    return made


def test_mapped_trajectories_are_those_of_single_runs():
    made = variables(ONE)
    expected = state_at([10.0], made["start"], made["gamma"])
    for found in (made["ends"], made["same"]):
        np.testing.assert_allclose(found, expected, rtol=0, atol=ROUND_OFF)
    shift = 1e-5
    ahead, behind = (state_at([10.0], made["start"], made["gamma"] + s)[0] for s in (shift, -shift))
    # differences are off by 10⁻¹⁰ of a third derivative, and by round-off over 10⁻⁵
    np.testing.assert_allclose(made["slopes"], (ahead - behind) / (2 * shift), rtol=0, atol=1e-7)


def test_saved_states_are_those_of_single_runs():
    made = variables(SAVED)
    times = [0.1 * k for k in range(10, STEPS + 1, 10)]
    expected = state_at(times, made["start"], [cb.SCENES["particle"].gamma] * made["n"])
    np.testing.assert_allclose(made["paths"], expected, rtol=0, atol=ROUND_OFF)


def processes(folder, count, devices):
    """Run the third block in so many processes on this host; return what each has written."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    given = {name: value for name, value in os.environ.items() if not name.lower().endswith("_proxy")}
    given |= {"COORDINATOR": f"127.0.0.1:{port}", "HOSTS": str(count), "JAX_PLATFORMS": "cpu"}
    given |= {"JAX_CPU_COLLECTIVES_IMPLEMENTATION": "gloo", "JAX_NUM_CPU_DEVICES": str(devices)}
    program, paths = folder / "trajectories.py", [folder / f"{host}.npz" for host in range(count)]
    program.write_text(DIVIDED + WRITE, encoding="utf-8")
    started = [
        subprocess.Popen([sys.executable, program, path], env=given | {"HOST": str(host)})
        for host, path in enumerate(paths)
    ]
    try:
        assert [process.wait(LIMIT) for process in started] == [0] * count
    finally:
        for process in started:  # one that fails leaves the other waiting for it
            process.kill()
            process.wait()
    return [np.load(path) for path in paths]


@pytest.mark.timeout(LIMIT + 30)
def test_trajectories_divided_among_two_processes_are_those_of_single_runs(tmp_path):
    shares = processes(tmp_path, 2, 2)
    assert [int(share["devices"]) for share in shares] == [4, 4]
    assert not np.array_equal(shares[0]["gamma"], shares[1]["gamma"])
    found = np.hstack([share["own"] for share in shares])
    for share in shares:
        expected = state_at([10.0], share["start"], share["gamma"])
        np.testing.assert_allclose(share["own"], expected, rtol=0, atol=ROUND_OFF)
        assert float(share["mean"]) == pytest.approx(found[0].mean(), abs=1e-14)
