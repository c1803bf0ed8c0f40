"""Revisions of the project in git: which one is the base, its files, its Python."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

from contactbench.errors import BadInput

#: what the main branch may be called, the first there is
MAIN = ("origin/HEAD", "origin/main", "main", "master")
#: in the environment of the gate of a base revision, the Python of the tree that it judges
JUDGED = "CONTACTBENCH_JUDGED_PYTHON"


def git(root: Path, *arguments: str, text: bool = True) -> Any:
    """The output of git, stripped, or its bytes.  Raises `BadInput` with git's own last line.

    History is what the commits say: neither `git replace` nor a file of grafts stands in for one.
    """
    if shutil.which("git") is None:
        raise BadInput("git: not installed; the gate compares with a revision, which takes git")
    command = ["git", "--no-replace-objects", "-C", str(root), *arguments]
    done = subprocess.run(command, capture_output=True, env={**os.environ, "GIT_GRAFT_FILE": os.devnull})
    if done.returncode:
        said = done.stderr.decode(errors="replace").strip() or f"exit {done.returncode}"
        raise BadInput(f"git {arguments[0]} in {root}: {said.splitlines()[-1]}")
    return done.stdout.decode(errors="replace").strip() if text else done.stdout


def repository(folder: Path) -> Path:
    """The top of the working tree a folder is in.  Raises `BadInput` if it is not this project's."""
    root = Path(git(folder, "rev-parse", "--show-toplevel"))
    if not (root / "src" / "contactbench").is_dir():
        raise BadInput(f"{root}: no src/contactbench there; run the gate in a checkout of the project")
    return root


def dirty(root: Path, *paths: str) -> bool:
    """Whether the sources, or the paths named, differ from the commit that is checked out."""
    return bool(git(root, "status", "--porcelain", "--", *(paths or ("src",))))


def named(root: Path, revision: str) -> str:
    """The commit a revision names, or ""."""
    try:
        return git(root, "rev-parse", "--verify", "--quiet", "--end-of-options", f"{revision}^{{commit}}")
    except BadInput:
        return ""


def commit_of(root: Path, revision: str) -> str:
    """The commit a revision names.  Raises `BadInput`."""
    found = named(root, revision)
    if not found:
        raise BadInput(f"--base {revision}: no such revision (in a shallow clone fetch more history)")
    return found


def base(root: Path, revision: str | None) -> str:
    """The commit that a tree is compared with: by default where the main branch was left, on it HEAD's parent.

    Raises `BadInput` where this clone does not have it.
    """
    if revision is not None:
        return commit_of(root, revision)
    main = next((branch for branch in MAIN if named(root, branch)), None)
    wanted, found = "HEAD's parent", named(root, "HEAD~1")
    if main is not None:
        left = common(root, main)
        if left != commit_of(root, "HEAD"):
            wanted, found = f"the commit at which HEAD left {main}", left
    if not found:
        shallow = git(root, "rev-parse", "--is-shallow-repository") == "true"
        raise BadInput(
            f"inconclusive: {wanted} is not in this clone; "
            + ("fetch it (git fetch --unshallow)" if shallow else "fetch it, or name a revision with --base")
        )
    return found


def common(root: Path, branch: str) -> str:
    """The last commit that HEAD has in common with a branch, or ""."""
    try:
        return git(root, "merge-base", "HEAD", branch)
    except BadInput:
        return ""


def messages(root: Path, base: str) -> str:
    """What the commits since the base say."""
    return git(root, "log", "--format=%B", f"{base}..HEAD")


@contextmanager
def checkout(root: Path, commit: str) -> Iterator[Path]:
    """The files of a commit in a folder of their own, for as long as the block lasts."""
    with tempfile.TemporaryDirectory(prefix="contactbench-base-") as scratch:
        tree = Path(scratch).resolve() / "base"
        with tarfile.open(fileobj=BytesIO(git(root, "archive", commit, text=False))) as files:
            files.extractall(tree, filter="data")
        if not (tree / "src" / "contactbench").is_dir():
            raise BadInput(f"--base {commit[:12]}: that revision has no src/contactbench")
        yield tree


def interpreter(tree: Path, root: Path) -> str:
    """The Python that runs a tree: ours, unless its pins differ from those of `root`; then one of its own."""
    if pins(tree) == pins(root):
        return sys.executable
    python = tree / ".venv" / "bin" / "python"
    install = [str(python), "-m", "pip", "install", "--quiet", "-c", "constraints.txt", "-e", ".[bench]"]
    for command in ([sys.executable, "-m", "venv", str(tree / ".venv")], install):
        done = subprocess.run(command, cwd=tree, capture_output=True, text=True)
        if done.returncode:
            last = (done.stderr.strip() or "no message").splitlines()[-1]
            raise BadInput(f"the base revision pins other versions, which could not be installed: {last}")
    return str(python)


def pins(tree: Path) -> tuple[Any, ...]:
    """What fixes the versions of everything but our own code."""
    project = tomllib.loads((tree / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    constraints = tree / "constraints.txt"
    return project["dependencies"], constraints.read_text(encoding="utf-8") if constraints.exists() else ""


def judges(tree: Path) -> bool:
    """Whether the gate of a tree can judge another one."""
    file = tree / "src" / "contactbench" / "gate" / "revisions.py"
    return file.exists() and JUDGED in file.read_text(encoding="utf-8")
