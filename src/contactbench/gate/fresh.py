"""A fresh smoke run of the benchmark, to be compared."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

from contactbench.errors import BadInput
from contactbench.gate.revisions import JUDGED
from contactbench.gate.verdict import Line


def environment(tree: Path) -> dict[str, str]:
    """Environment variables with which a process runs the code of a tree."""
    own = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    return {"JAX_PLATFORMS": "cpu", **own, **threads, "PYTHONPATH": str(tree / "src")}


def fresh_run(root: Path, results: Path) -> list[Line]:
    """Run the smoke profile of the benchmark in `root`, untimed and on all cores; a line if a cell failed.

    Raises `BadInput` when the benchmark cannot run at all.
    """
    if not (root / "bench" / "conftest.py").exists():
        raise BadInput(f"{root}: no benchmark there; run the gate where bench/ is, or give --fresh DIR")
    command = [
        os.environ.get(JUDGED, sys.executable), "-m", "pytest", "bench", "--profile", "smoke",
        "--results", str(results), "-v", "-n", "auto", "--untimed", "-p", "no:cacheprovider",
    ]  # fmt: skip
    lines, status = followed(command, root)
    last = next(filter(None, (line.strip() for line in reversed(lines))), "no output")
    if status > 1:
        raise BadInput(f"the benchmark did not run (pytest exit {status}): {last}")
    if status == 0:
        return []
    failed = "; ".join(line[7:160] for line in lines if line.startswith("FAILED "))
    return [Line("benchmark run", "passed", "failed", failed or last, "failed", red=True)]


def followed(command: list[str], root: Path) -> tuple[list[str], int]:
    """What pytest printed and its exit status; a terminal is shown how far it is."""
    from tqdm import tqdm

    lines = []
    with (
        subprocess.Popen(
            command, cwd=root, env=environment(root), text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        ) as run,
        tqdm(total=100, desc="smoke run", unit="%", disable=None) as bar,
    ):  # fmt: skip
        assert run.stdout is not None
        for line in run.stdout:
            lines.append(line)
            done = re.match(r"\[gw\d+\] \[ *(\d+)%\]", line)
            bar.update(int(done[1]) - bar.n if done else 0)
    return lines, run.returncode
