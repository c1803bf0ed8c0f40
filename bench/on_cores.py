"""Run one ensemble cell on several cores and print its row: ``python on_cores.py '[[cores], [cell]]'``."""

from __future__ import annotations

import json
import os
import sys

CORES, CELL = json.loads(sys.argv[1])
os.sched_setaffinity(0, CORES)  # before contactbench is imported: it takes a device for every core

import gc
from time import perf_counter

import numpy as np

from bench_ensemble import row_of

ROUNDS = 9


def timing(run):
    """The time columns, as pytest-benchmark has them for one core."""
    gc.disable()
    seconds = []
    for _ in range(ROUNDS + 1):  # the first warms up
        start = perf_counter()
        run()
        seconds.append(perf_counter() - start)
    low, median, high = np.percentile(seconds[1:], (25, 50, 75)).tolist()
    return {
        "time_min_s": min(seconds[1:]), "time_median_s": median, "time_iqr_s": high - low,
        "rounds": ROUNDS, "iterations": 1,
    }  # fmt: skip


print(json.dumps(row_of(CELL, timing), default=float))
