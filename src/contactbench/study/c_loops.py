"""The C loops of c_loops.c, compiled when they are first asked for, with the coefficients of our compositions."""

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

from contactbench.scene import Mechanical
from contactbench.scene.many import Lattice
from contactbench.splitting.composition import number
from contactbench.splitting.tables import RKN6, STRANG

KERNELS = {"contact-strang": ("strang", STRANG), "contact-rkn6": ("rkn6", RKN6)}


@cache
def library() -> ctypes.CDLL | str:
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        return "no C compiler on this machine"
    source = Path(__file__).with_name("c_loops.c")
    with tempfile.TemporaryDirectory(prefix="contactbench-", ignore_cleanup_errors=True) as folder:
        target = Path(folder) / "c_loops.so"  # needed no longer than until it is loaded
        command = [compiler, "-O3", "-march=native", "-shared", "-fPIC", "-o", str(target), str(source)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
        if done.returncode != 0:
            return f"{compiler} failed: {done.stderr.strip()[:200]}"
        return ctypes.CDLL(str(target))


def constants(method: str, scene: Mechanical | Lattice, step: float) -> tuple[str, int, list[np.ndarray]]:
    """Return the loop's name, the steps to the end of the scene, and kicks, φ/m, keep and lose of every stage."""
    name, composition = KERNELS[method]
    n = round(scene.t_end / step)
    h = scene.t_end / n
    kicks = np.array([number(c, math) * h for f, c in composition.stages if f == "kick"])
    flow, shares = Mechanical.flows["drift_damp"], [c for f, c in composition.stages if f == "drift_damp"]
    drifts = [flow.constants(scene, number(c, math) * h, math) for c in shares]
    phi, _, keep, lose = (np.array(column) for column in zip(*drifts, strict=True))
    return name, n, [kicks, phi, keep, lose]


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)


def ring_kernel(method: str, scene: Lattice, step: float) -> tuple[Callable[[], np.ndarray], int] | str:
    """Return the run of a ring with the bonds of the β-chain to the final (q, p), and its evaluations."""
    loops = library()
    if isinstance(loops, str):
        return loops
    _, steps, numbers = constants(method, scene, step)
    n, stages, (q, p) = scene.n, len(numbers[1]), staggered(2, scene.n + 2)
    sizes, beta = map(ctypes.c_int64, (n, steps, stages)), ctypes.c_double(scene.parameters["beta"])
    arguments = (*sizes, beta, *map(pointer, (*numbers, q[1:], p[1:])))

    def run() -> np.ndarray:
        q[1:-1], p[1:-1] = scene.q, scene.p
        loops.ring(*arguments)
        return np.concatenate([q[1:-1], p[1:-1]])

    return run, steps * stages + 1


LINE, PAGE = 64 // 8, 4096 // 8  #: in doubles


def staggered(rows: int, m: int) -> np.ndarray:
    """Return an uninitialised (rows, m), each row beginning with a cache line, a share of a page after the last.

    Rows at the same place of a page make every load wait for a store to another row: up to 8 times slower.
    """
    stride = -(-m // PAGE) * PAGE + PAGE // rows
    buffer = np.empty(rows * stride + LINE)
    first = -buffer.ctypes.data // 8 % LINE
    return buffer[first : first + rows * stride].reshape(rows, stride)[:, :m]


#: shapes of the ensemble loops, see c_loops.c
SHAPES = ("passes", "plain", "tiled")


def ensemble_kernel(
    method: str, shape: str, scene: Mechanical, step: float, start: np.ndarray
) -> tuple[Callable[[], np.ndarray], int, int] | str:
    """Return the run of the particle from start (4, m), an array per component, its steps and its evaluations."""
    loops = library()
    if isinstance(loops, str):
        return loops
    name, n, numbers = constants(method, scene, step)
    loop, coupling = getattr(loops, f"{name}_{shape}"), ctypes.c_double(scene.parameters["coupling"])
    columns = staggered(*start.shape)
    counts = ctypes.c_int64(start.shape[1]), ctypes.c_int64(n)

    def run() -> np.ndarray:
        columns[:] = start
        loop(*counts, coupling, *map(pointer, numbers), *map(pointer, columns))
        return columns.copy()

    return run, n, n * len(numbers[1]) + 1
