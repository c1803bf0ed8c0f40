"""A disk that is full while a benchmark runs: one line, and nothing lost."""

from __future__ import annotations

import pytest

from cases import bench, few_slow, finished
from contactbench.results.store import read
from contactbench.results.tables import DEFINITIONS

#: from its second cell on, or when the tables are written, there is no room
FULL = """
import errno
from contactbench.methods import METHODS
from contactbench.results import cells

METHODS["rk4"] = METHODS["rk4"].__class__(**vars(METHODS["rk4"]))  # a plug-in registers something

def full(once):
    calls = []
    def write(*arguments):
        calls.append(1)
        if len(calls) > {after}:
            raise OSError(errno.ENOSPC, "No space left on device", "a-file")
        return once(*arguments)
    return write

cells.{name} = full(cells.{name})
"""


@pytest.mark.parametrize(("name", "after"), few_slow([("Cells.save", 1), ("merge", 0)], ("merge", 0)))
def test_a_full_disk_is_one_line_and_what_was_finished_is_kept(name, after, tmp_path):
    fault, results = tmp_path / "full.py", tmp_path / "results"
    fault.write_text(FULL.format(name=name, after=after))
    process = bench(results, "definition and contact", "--plugin", str(fault))
    output, _ = process.communicate(timeout=120)
    assert process.returncode == 2, output
    (line,) = (line for line in output.splitlines() if "No space left" in line)
    assert "--resume" in line
    assert "Traceback" not in output
    finished(bench(results, "definition and contact", "--resume"))
    assert len(read(DEFINITIONS, results)) == 11
