"""JAX's programs are kept: what one process of a run has compiled, the others and the next run load."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

CODE = """
import contactbench as cb
run = cb.prepare("oscillator", "diffrax-tsit5", rtol=1e-6, save_at=[1.0], carry=())
print(run().y[-1].tolist())
"""


@pytest.mark.slow
def test_a_second_process_compiles_nothing_and_finds_the_same(tmp_path):
    def once():
        done = subprocess.run(
            [sys.executable, "-c", CODE], capture_output=True, text=True, check=True,
            env={**os.environ, "JAX_COMPILATION_CACHE_DIR": str(tmp_path)},
        )  # fmt: skip
        return done.stdout, sorted(path.name for path in tmp_path.glob("*-cache"))

    assert os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] == "0"  # the shortest are kept as well
    first, kept = once()
    assert kept
    assert once() == (first, kept)
