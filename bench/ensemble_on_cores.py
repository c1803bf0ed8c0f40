"""An ensemble cell on several cores, its row and times: ``python ensemble_on_cores.py '[[cores], [cell], truth]'``."""

from __future__ import annotations

import json
import os
import sys

CORES, CELL, EXACT = json.loads(sys.argv[1])
os.sched_setaffinity(0, CORES)  # before contactbench is imported: it takes a device for every core

import gc
from time import perf_counter

import numpy as np

from bench_ensemble import prepared_row

#: of one visit
ROUNDS = 5


def seconds(run):
    """Seconds per call, one number a round; the first call has warmed up."""
    gc.disable()
    samples = []
    for _ in range(ROUNDS):
        start = perf_counter()
        run()
        samples.append(perf_counter() - start)
    return samples


row, (run, _) = prepared_row(CELL, np.array(EXACT))
print(json.dumps([row, seconds(run)], default=float))
