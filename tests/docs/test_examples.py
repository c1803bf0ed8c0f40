"""The methods that the documents show pass through every command: checked, raced, measured and gated."""

import re
import subprocess
import sys

import pytest

import made_up
from cases import REPOSITORY, environment

BLOCK = re.compile(r"^```python[^\n]*\n(.*?)^```", re.DOTALL | re.MULTILINE)
#: the page and the heading from which all its blocks are taken, what an earlier block that is taken has, and the
#: methods that these make
PAGE, FROM, EARLIER = "adding.md", "## What a step is made of", "class BogackiShampine(Adaptive)"
METHODS = ["my-ralston", "my-splitting", "my-implicit", "my-ab2", "my-bs32"]


@pytest.fixture(scope="module")
def repository(tmp_path_factory):
    place = tmp_path_factory.mktemp("project")
    before, heading, after = shown(PAGE).partition(FROM)
    assert heading
    blocks = [*BLOCK.findall(after), *(block for block in BLOCK.findall(before) if EARLIER in block)]
    made_up.git(place, "init", "-q", "-b", "main")
    (place / ".gitignore").write_text("results/.cells\n__pycache__\n")
    (place / "my.py").write_text("import contactbench as cb\n" + "\n".join(blocks))
    made_up.commit(place, "my work")
    return place


def shown(page):
    return (REPOSITORY / "docs" / page).read_text(encoding="utf-8")


def called(repository, *line):
    given = {"cwd": repository, "env": environment(("PYTEST_",)), "capture_output": True, "text": True}
    ended = subprocess.run(
        [sys.executable, "-m", "contactbench", *line, "--plugin", "my.py"], timeout=550, **given
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_an_example_keeps_the_contract(repository, method):
    assert "kept" in called(repository, "check", method, "--engine", "python")


@pytest.mark.slow
def test_the_examples_are_raced(repository):
    out = called(repository, "compare", "oscillator", *METHODS, "rk4", "--error", "1e-2", "--budget", "120s")
    assert all(re.search(rf"^{name} .*µs|^{name} .*ms", out, re.MULTILINE) for name in METHODS)
    assert re.search(r"^Take ", out, re.MULTILINE)
    assert "problems.md" in out.splitlines()[-1]


@pytest.mark.slow
def test_the_examples_are_measured_and_gated(repository):
    which = f"({' or '.join(METHODS)}) and oscillator and not forced"
    called(repository, "bench", "--profile", "smoke", "--untimed", "-k", which)
    rows = (repository / "results" / "work_precision.csv").read_text().splitlines()
    assert {name for name in METHODS if any(f",{name}," in row for row in rows)} == {*METHODS}
    for message in ("my tables", "nothing more"):  # the gate compares with the commit before
        made_up.commit(repository, message)
    assert "green" in called(repository, "gate", "--only", "accuracy")
