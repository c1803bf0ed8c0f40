"""Runs of the benchmark by another process: from a checkout, or as it comes with an installed package."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from contactbench.errors import BadInput

#: what the benchmark imports, of ``contactbench[bench]``
NEEDED = ("pytest", "xdist", "pytest_benchmark")
#: first everything that is measured without a clock, on all cores; then what is timed, alone
UNTIMED = ("-m", "not timed", "-n", "auto", "--dist", "worksteal", "-p", "no:benchmark")
TIMED = ("-m", "timed", "--resume", "--benchmark-quiet")


def folder() -> Path:
    """Return where ``bench/`` is, in a checkout or in the installed package; raise `BadInput` where there is none."""
    package = Path(__file__).parents[1]
    for root in (package.parents[1], package / "_bench"):
        if (root / "bench" / "conftest.py").exists():
            return root
    raise BadInput("this installation has no benchmark; install the wheel, or work in a clone")


def start(
    root: Path, results: Path, options: Sequence[str], variables: Mapping[str, str] = os.environ, **own: Any
) -> int:
    """Run pytest on the benchmark of a root; return its exit status.  Raises `BadInput` where it cannot run."""
    if not (root / "bench" / "conftest.py").exists():
        raise BadInput(f"{root}: no benchmark there; run the gate where bench/ is, or give --fresh DIR")
    missing = [name for name in NEEDED if find_spec(name) is None]
    if missing:
        raise BadInput(f'no {missing[0]} here: pip install "contactbench[bench]"')
    command = [sys.executable, "-m", "pytest", str(root / "bench"), "-c", str(root / "pyproject.toml"), "-q"]
    command += ["-p", "no:cacheprovider", "--results", str(results.resolve()), *options]
    status = subprocess.run(command, env=dict(variables), **own).returncode
    if status > 1:
        raise BadInput(f"the benchmark did not run (pytest exit {status})")
    return status
