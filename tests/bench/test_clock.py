"""How often a timed cell calls its run: five rounds at least, however long a round is."""

from __future__ import annotations

import time
from types import SimpleNamespace

import pytest

from clock import VISITS, Clock, Part
from contactbench.measure.clock import WARM

SHARE = 0.2


class Fixture:
    """What the clock uses of the fixture of pytest-benchmark."""

    disabled, group = False, ""

    def pedantic(self, run, rounds, iterations, teardown):
        self.stats = SimpleNamespace(stats=SimpleNamespace(data=[]))
        for _ in range(rounds):
            for _ in range(iterations):
                run()
            self.stats.stats.data.append(1.0)
            teardown()


def visited(part_s, visits=VISITS):
    """Calls of a run whose part takes so long, of the part, and the columns after all visits."""
    calls, cells = {"run": 0, "part": 0}, {}

    def called(name):
        calls[name] += 1

    for _ in range(visits):
        clock = Clock(cells, "cell", SimpleNamespace(seconds=0.02), Fixture())
        clock.prepared(lambda: "made")
        part = Part(lambda: (called("part"), time.sleep(part_s)), SHARE, 10.0)
        columns = clock.columns(lambda: called("run"), "group", part)
    return calls, columns


@pytest.mark.parametrize(("part_s", "warm"), [(0.2, 1), (1.1 * SHARE * WARM, 2)])
def test_a_long_run_is_warm_by_its_part_and_has_five_rounds(part_s, warm):
    calls, columns = visited(part_s)
    assert calls == {"run": 5, "part": warm + 5}
    assert columns["rounds"] == 5
    assert columns["time_repeat_ratio"] == 1


def test_a_short_run_is_warmed_up_and_has_more_rounds():
    calls, columns = visited(0.0)
    assert columns["rounds"] > 5
    assert calls["run"] > columns["rounds"] * columns["iterations"]
