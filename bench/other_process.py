"""A process that prepares and times cells for another one: ``python other_process.py '[[cores], [timed on]]'``.

Lines of JSON come in: ["prepare", module, function, arguments…], which is answered by nothing; and with the number of
what was prepared ["row", n], ["warm", n] and ["visit", n, rounds], which are answered by a line of JSON each.
"""

from __future__ import annotations

import json
import os
import sys

CORES, TIMED_ON = json.loads(sys.argv[1])
if CORES:
    os.sched_setaffinity(0, CORES)  # before contactbench is imported: it takes a device for every core

from importlib import import_module


def pin(cores):
    """Every thread of this process on these cores."""
    for thread in os.listdir("/proc/self/task"):
        os.sched_setaffinity(int(thread), cores)


def main():
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a plug-in prints is no answer
    calls, rows = [], []
    for line in sys.stdin:
        match json.loads(line):
            case ["prepare", module, function, *arguments]:
                row, call = getattr(import_module(module), function)(*arguments)
                calls.append(call)
                rows.append(row)
                continue
            case ["row", n]:
                answer = rows[n]
            case ["warm", n]:
                if TIMED_ON != CORES:
                    pin(TIMED_ON)
                answer = calls[n].warm_up()
            case ["visit", n, rounds]:
                visit = calls[n].visit(rounds)
                answer = [visit.whole, visit.part, visit.iterations]
        print(json.dumps(answer, default=float), file=answers, flush=True)


if __name__ == "__main__":
    main()
