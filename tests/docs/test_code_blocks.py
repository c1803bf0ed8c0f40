"""Every Python block of README and documentation runs, page by page; the methods it makes keep their contract."""

import re
from functools import partial
from shutil import copy

import pytest

import contactbench as cb
from cases import REPOSITORY, few_slow
from contactbench.tables import declared
from contactbench.testing import check_method
from contactbench.testing.method import CASES
from made_up import folder

BLOCK = re.compile(r"^```python[^\n]*\n(.*?)^```", re.DOTALL | re.MULTILINE)
PAGES = [
    path
    for path in (REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md")))
    if BLOCK.search(path.read_text()) and path.name != "trajectories.md"  # test_trajectories.py
]
#: seconds of a race whose page does not say how long it may take
BUDGET = 2.0
#: take ten seconds
LONG = [page for page in PAGES if page.name in ("adding.md", "embed.md", "gallery.md", "tutorial.md")]


@pytest.mark.parametrize("page", few_slow(PAGES, *LONG), ids=lambda path: path.name)
def test_the_code_of_a_page_runs(page, registries, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    made = folder(tmp_path / "tables")  # a clone's may be those of any run
    for table in (REPOSITORY / "results").glob("population*.csv"):  # those that lead are found in it
        copy(table, made)
    monkeypatch.setattr(declared, "shipped_folder", lambda: made)
    monkeypatch.setattr(cb, "compare", partial(cb.compare, budget=BUDGET))
    text, scope, known = page.read_text(), {}, {*cb.METHODS}
    for block in BLOCK.finditer(text):
        # padded so that a traceback shows the page's own line
        before = "\n" * text.count("\n", 0, block.start(1))
        exec(compile(before + block[1], str(page), "exec"), scope)
    for name in {*cb.METHODS} - known:
        assert check_method(cb.METHODS[name], engines=cb.METHODS[name].engines[:1], scenes=CASES[:1])
