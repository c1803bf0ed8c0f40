"""The C loops of limit.c, compiled when the benchmark runs, with the coefficients of our compositions."""

from __future__ import annotations

import ctypes
import math
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

from contactbench.composition import RKN6, STRANG, number
from contactbench.flows import MECHANICAL

KERNELS = {"contact-strang": ("strang", STRANG), "contact-rkn6": ("rkn6", RKN6)}
FLAGS = ("-O3", "-march=native", "-shared", "-fPIC")


@cache
def library() -> ctypes.CDLL | str:
    """The compiled loops, or why there are none."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        return "no C compiler on this machine"
    target = Path(tempfile.mkdtemp(prefix="contactbench-")) / "limit.so"
    source = Path(__file__).with_name("limit.c")
    done = subprocess.run(
        [compiler, *FLAGS, "-o", target, source], capture_output=True, text=True, timeout=120
    )
    return (
        ctypes.CDLL(str(target))
        if done.returncode == 0
        else f"{compiler} failed: {done.stderr.strip()[:200]}"
    )


def kernel(method: str, scene, step: float) -> tuple[Callable[[], np.ndarray], int] | str:
    """A function that runs the scene (the particle) and returns the final (q, p), and its evaluations."""
    loops = library()
    if isinstance(loops, str):
        return loops
    name, composition = KERNELS[method]
    n = round(scene.t_end / step)
    h = scene.t_end / n
    kicks = np.array([number(c, math) * h for f, c in composition.stages if f == "kick"])
    drifts = [
        MECHANICAL["drift_damp"].constants(scene, number(c, math) * h, math)
        for f, c in composition.stages
        if f == "drift_damp"
    ]
    phi, _, keep, lose = (np.array(column) for column in zip(*drifts, strict=True))
    start = np.array([*scene.q, *scene.p])
    pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in (kicks, phi, keep, lose)]
    loop, coupling = getattr(loops, name), ctypes.c_double(scene.parameters["coupling"])

    def run() -> np.ndarray:
        y = start.copy()
        loop(ctypes.c_int64(n), coupling, *pointers, y.ctypes.data_as(ctypes.c_void_p))
        return y

    run.keeps_alive = (kicks, phi, keep, lose)
    return run, n * len(drifts) + 1
