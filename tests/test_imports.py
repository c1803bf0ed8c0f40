"""What `import contactbench` loads, and what it leaves as it is."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("jax", "scipy", "numba", "matplotlib", "mpmath", "pandas", "diffrax", "heyoka")


@pytest.mark.parametrize("statement", ["import contactbench", "from contactbench.methods import METHODS"])
def test_nothing_heavy_is_loaded_and_jax_is_left_alone(statement):
    program = (
        f"import os, sys; before = dict(os.environ); {statement}; print(*set(sys.modules) & set({HEAVY!r})); "
    )
    program += "print(before == dict(os.environ))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.stdout == "\nTrue\n", done.stdout + done.stderr
