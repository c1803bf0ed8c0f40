"""The limits that the documentation quotes are those of the code."""

from pathlib import Path

import pytest

from contactbench.gate import compare, speed
from contactbench.measure import clock, law, statistics
from contactbench.runs import timetable
from contactbench.runs.problems import FAMILIES
from contactbench.study.compare import BUDGET
from contactbench.truth import survey

#: the shortest pulse that is seen, in parts of the span
PULSE = f"about {({2: 'two'})[round(1e6 / survey.SAMPLES)]} millionths of the"
DOCS = Path(__file__).parents[2] / "docs"
QUOTED = {
    "adding.md": [PULSE],
    "compare.md": [
        f"budget ({BUDGET:.0f} s by default)",
        f"{clock.VISITS} times or more",
        f"wider than {statistics.WIDEST - 1:.0%}",
    ],
    "gate.md": [
        f"by a factor of {compare.ERROR_FACTOR:.0f}",
        f"by {compare.VALUE_CHANGE:.0%}",
        f"above {speed.RATIO_LIMIT}",
        f"at most {1e3 * speed.LONGEST_CALL:.0f} ms",
    ],
    "reading.md": [
        PULSE,
        f"more than {law.WRECKED:.0%}",
        f"no larger error {clock.VISITS} times",
        f"{clock.ROUNDS} rounds of at least {1e3 * clock.ROUND_SECONDS} ms",
        f"more than {1e3 * clock.LONG:.0f} ms",
        *(f"more than {1e3 * seconds:.0f} ms" for seconds in timetable.SPARED),
        f"a factor of {timetable.NEAR:g} of the least",
        f"the others {timetable.OTHERS} times",
        f"{statistics.WIDEST - 1:.0%} at least",
        f"wider than {statistics.WIDEST - 1:.0%}",
    ],
}


@pytest.mark.parametrize("page", QUOTED)
def test_quoted_limits_are_those_of_the_code(page):
    text = (DOCS / page).read_text().replace(" %", "%")
    assert [quote for quote in QUOTED[page] if quote not in text] == []


def test_every_family_of_the_population_has_one_start():
    starts = (DOCS.parent / "CONTRIBUTING.md").read_text().split("| start | families |")[1].split("\n\n")[0]
    assert sorted(starts.split("`")[1::2]) == sorted(FAMILIES)
