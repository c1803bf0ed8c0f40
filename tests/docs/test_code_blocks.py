"""Every Python block of README and documentation runs, page by page; limits that pages quote are those of the code."""

import re
from functools import partial
from pathlib import Path
from shutil import copy

import pytest

import contactbench as cb
from cases import REPOSITORY, few_slow
from contactbench.gate import compare, speed
from contactbench.measure import clock, law, statistics
from contactbench.runs import timetable
from contactbench.runs.problems import FAMILIES
from contactbench.study.compare import BUDGET
from contactbench.tables import declared
from contactbench.testing import check_method
from contactbench.testing.method import CASES
from contactbench.truth import survey
from made_up import folder

BLOCK = re.compile(r"^```python[^\n]*\n(.*?)^```", re.DOTALL | re.MULTILINE)
PAGES = [
    path
    for path in (REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md")))
    if BLOCK.search(path.read_text()) and path.name != "trajectories.md"  # test_trajectories.py
]
#: seconds of a race whose page does not say how long it may take
SECONDS = 2.0
#: take ten seconds
LONG = [page for page in PAGES if page.name in ("adding.md", "embed.md", "gallery.md", "tutorial.md")]


@pytest.mark.parametrize("page", few_slow(PAGES, *LONG), ids=lambda path: path.name)
def test_the_code_of_a_page_runs(page, registries, unconfirmed, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    made = folder(tmp_path / "tables")  # a clone's may be those of any run
    for table in (REPOSITORY / "results").glob("population*.csv"):  # those that lead are found in it
        copy(table, made)
    monkeypatch.setattr(declared, "shipped_folder", lambda: made)
    monkeypatch.setattr(cb, "compare", partial(cb.compare, budget=SECONDS))
    text, scope, known = page.read_text(), {}, {*cb.METHODS}
    for block in BLOCK.finditer(text):
        # padded so that a traceback shows the page's own line
        before = "\n" * text.count("\n", 0, block.start(1))
        exec(compile(before + block[1], str(page), "exec"), scope)
    for name in {*cb.METHODS} - known:
        assert check_method(cb.METHODS[name], engines=cb.METHODS[name].engines[:1], scenes=CASES[:1])


# -- limits that the documentation quotes ------------------------------------------------------------
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
