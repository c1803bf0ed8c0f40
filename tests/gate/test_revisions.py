"""Which revision the gate compares with, and the programs it runs for that."""

from __future__ import annotations

import sys

import pytest

import contactbench as cb
from contactbench.gate import revisions
from contactbench.gate.fresh import followed
from contactbench.gate.revisions import git


@pytest.fixture
def project(tmp_path):
    """A repository of two commits."""
    (tmp_path / "src" / "contactbench").mkdir(parents=True)
    (tmp_path / "src" / "contactbench" / "a.py").write_text("one\n")
    git(tmp_path, "init", "-q")
    own = ("-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false")
    for text in ("first", "second"):
        git(tmp_path, "add", ".")
        git(tmp_path, *own, "commit", "-q", "--allow-empty", "-m", text)
    return tmp_path


def test_sources_with_changes_are_dirty_and_other_files_only_where_they_are_named(project):
    assert revisions.repository(project / "src") == project
    assert revisions.base(project, "HEAD~1") == git(project, "rev-parse", "HEAD~1")
    (project / "note").write_text("no source")
    assert not revisions.dirty(project)
    assert revisions.dirty(project, "note")
    (project / "src" / "contactbench" / "a.py").write_text("two\n")
    assert revisions.dirty(project)


def test_a_revision_that_is_not_there_is_named(project):
    with pytest.raises(cb.BadInput, match="--base nowhere: no such revision"):
        revisions.base(project, "nowhere")
    with pytest.raises(cb.BadInput, match=r"git log in .*: 'git <command>"):  # the last of three lines
        git(project, "log", "nowhere")


def test_trees_of_the_same_pins_share_our_python(project):
    for name in ("one", "other"):
        (project / name).mkdir()
        (project / name / "pyproject.toml").write_text("[project]\ndependencies = ['numpy']\n")
    assert revisions.interpreter(project / "one", project / "other") == sys.executable


def test_what_a_run_printed_is_kept_with_its_exit_status(project):
    program = "print('[gw0] [ 40%] PASSED a'); print('FAILED b'); raise SystemExit(3)"
    assert followed([sys.executable, "-c", program], project) == (
        ["[gw0] [ 40%] PASSED a\n", "FAILED b\n"],
        3,
    )
