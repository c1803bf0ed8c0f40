"""A run ends with its answers, and with what moved against the committed tables."""

import shutil
import subprocess
from pathlib import Path

import pandas as pd
import pytest

from contactbench.study.ending import ending

RESULTS = Path(__file__).parents[2] / "results"


@pytest.fixture
def committed(tmp_path):
    """Some of the committed runs in a repository of their own."""
    folder = tmp_path / "results"
    folder.mkdir()
    shutil.copy(RESULTS / "environment.json", folder)
    rows = pd.read_csv(RESULTS / "runs.csv", dtype=str, keep_default_na=False)
    rows[rows["scene"].isin(["particle", "central"])].to_csv(folder / "runs.csv", index=False)
    author = ["-c", "user.name=x", "-c", "user.email=x@example.org"]
    for command in (["init", "-q"], ["add", "."], [*author, "commit", "-qm", "tables"]):
        subprocess.run(["git", "-C", str(tmp_path), *command], check=True)
    return folder


def test_a_run_ends_with_the_answers_of_its_tables(committed):
    text = ending(committed)
    assert text.startswith("Of ")
    assert "\nDoes a method keep the momentum J wherever it claims to?\n    always" in text
    assert "clocks aside: nothing moved." in text


def test_what_moved_is_named(committed):
    rows = pd.read_csv(committed / "runs.csv", dtype=str, keep_default_na=False)
    chosen = rows.index[(rows["method"] == "rk4") & (rows["scene"] == "particle")][0]
    rows.loc[chosen, "error"] = str(10 * float(rows.loc[chosen, "error"]))
    rows.to_csv(committed / "runs.csv", index=False)
    assert "runs particle rk4" in (text := ending(committed))
    assert "1 measure moved" in text


def test_tables_outside_a_repository_have_nothing_to_be_compared_with(committed):
    shutil.rmtree(committed.parent / ".git")
    assert "Not compared with the tables before it" in ending(committed)
