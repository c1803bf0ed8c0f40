"""The command line as a process of its own: what its surroundings may be like."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from cases import REPOSITORY

MODULE = [sys.executable, "-m", "contactbench"]
SOLVE = ["solve", "particle", "rk4", "--step", "0.1", "--t-end", "1"]


def run(*command, **variables):
    own = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    return subprocess.run(
        list(map(str, command)), cwd=REPOSITORY, capture_output=True, timeout=120, env=own | variables
    )


@pytest.mark.parametrize("line", [["list"], ["claim", "C25"], [*SOLVE, "--laws"]])
def test_what_cannot_be_encoded_is_replaced(line):
    done = run(*MODULE, *line, PYTHONIOENCODING="ascii")
    assert done.returncode == 0, done.stderr
    assert b"?" in done.stdout
    assert done.stdout.isascii()


def test_json_needs_no_other_encoding():
    done = run(*MODULE, "claim", "C25", "--json", PYTHONIOENCODING="ascii")
    assert "§" in json.loads(done.stdout)["where"]


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_a_closed_stream_is_no_error(closed):
    done = run("sh", "-c", f'exec "$@" {closed}', "sh", *MODULE, "list", "laws")
    assert done.returncode == 0
    assert done.stderr == b""


@pytest.mark.parametrize("platform", ["rocm", "abacus"])
def test_a_platform_that_is_not_there_is_one_line(platform):
    done = run(*MODULE, *SOLVE, "--engine", "jax", JAX_PLATFORMS=platform)
    assert done.returncode == 2
    assert done.stderr.decode().startswith(f"contactbench: JAX_PLATFORMS = {platform}: must be")
    assert done.stderr.count(b"\n") == 1


INTERPRETED = """
import json
import contactbench as cb
cases = {
    "rk4": {"step": 0.1}, "contact-strang": {"step": 0.1}, "contact-adaptive": {"rtol": 1e-3},
    "cvode-adams": {"rtol": 1e-3}, "scipy-dop853": {"rtol": 1e-3}, "cyrk-dop853": {"rtol": 1e-3},
}
runs = {name: cb.solve("particle", name, **given) for name, given in cases.items()}
runs["contact-exact"] = cb.solve("rigid_body", "contact-exact", engine="numba")
runs["numba"] = cb.solve("particle", "rk4", step=0.1, engine="numba")
runs["c"] = cb.solve("particle", "cvode-adams", rtol=1e-3, engine="c")
print(json.dumps({name: (run.engine, run.status, "NUMBA_DISABLE_JIT" in run.message) for name, run in runs.items()}))
"""


def test_where_numba_does_not_compile_python_computes():
    done = run(sys.executable, "-c", INTERPRETED, NUMBA_DISABLE_JIT="1")
    assert done.returncode == 0, done.stderr
    runs = json.loads(done.stdout)
    by_python = dict.fromkeys(("rk4", "contact-strang", "contact-adaptive", "scipy-dop853"), "python")
    compiled = {"cyrk-dop853": "c++", "contact-exact": "numba", "numba": "numba", "c": "c"}
    solved = {
        name: [engine, "ok", False] for name, engine in {**by_python, "cvode-adams": "c+python"}.items()
    }
    assert runs == solved | {name: [engine, "unsupported", True] for name, engine in compiled.items()}
