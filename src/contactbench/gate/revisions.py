"""Revisions of the project in git: which one is the base, its working tree, its tables, its Python."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from contactbench.errors import BadInput

#: what the main branch may be called, the first there is
MAIN = ("origin/HEAD", "origin/main", "main", "master")


def git(root: Path, *arguments: str, text: bool = True) -> Any:
    """The output of git, stripped, or its bytes.  Raises `BadInput` with git's own last line."""
    if shutil.which("git") is None:
        raise BadInput("git: not installed; the gate compares with a revision, which takes git")
    done = subprocess.run(["git", "-C", str(root), *arguments], capture_output=True)
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


def commit_of(root: Path, revision: str) -> str:
    """The commit a revision names.  Raises `BadInput`."""
    try:
        return git(root, "rev-parse", "--verify", "--quiet", "--end-of-options", f"{revision}^{{commit}}")
    except BadInput:
        why = "no such revision (in a shallow clone fetch more history)"
        raise BadInput(f"--base {revision}: {why}") from None


def resolved(root: Path, revision: str | None) -> str:
    """The commit that speed is compared with: by default HEAD if the sources have local changes, else its parent."""
    return commit_of(root, revision or ("HEAD" if dirty(root) else "HEAD~1"))


def base_of_tables(root: Path, revision: str | None) -> str:
    """The commit that accuracy is compared with: by default where the main branch was left, on it HEAD itself."""
    if revision is not None:
        return commit_of(root, revision)
    for branch in MAIN:
        try:
            return git(root, "merge-base", "HEAD", branch)
        except BadInput:
            continue
    return commit_of(root, "HEAD")


def messages(root: Path, base: str) -> str:
    """What the commits since the base say."""
    return git(root, "log", "--format=%B", f"{base}..HEAD")


def export(root: Path, commit: str, folder: str, target: Path) -> Path:
    """The tables and the record of their runs as a commit has them, as files in `target`.

    Raises `BadInput` where the commit has none.
    """
    listed = git(root, "ls-tree", "--name-only", commit, "--", f"{folder}/").splitlines()
    names = [name for name in listed if name.endswith((".csv", "/environment.json"))]
    if not names:
        raise BadInput(f"--base {commit[:12]}: no tables in {folder}/ at that revision")
    target.mkdir(parents=True, exist_ok=True)
    for name in names:
        (target / Path(name).name).write_bytes(git(root, "show", f"{commit}:{name}", text=False))
    return target


# -- working trees ---------------------------------------------------------------------------------
CHECKOUT = "contactbench-base-"


@contextmanager
def checkout(root: Path, commit: str) -> Iterator[Path]:
    """A working tree of a commit, for as long as the block lasts."""
    drop_dead_checkouts(root)
    with tempfile.TemporaryDirectory(prefix=CHECKOUT) as scratch, FileLock(Path(scratch) / "alive"):
        tree = Path(scratch).resolve() / "base"
        git(root, "worktree", "add", "--detach", "--force", str(tree), commit)
        try:
            if not (tree / "src" / "contactbench").is_dir():
                raise BadInput(f"--base {commit[:12]}: that revision has no src/contactbench")
            yield tree
        finally:
            git(root, "worktree", "remove", "--force", str(tree))


def drop_dead_checkouts(root: Path) -> None:
    """Remove the working trees of processes that were killed: nobody holds their lock any more."""
    for line in git(root, "worktree", "list", "--porcelain").splitlines():
        tree = Path(line.removeprefix("worktree "))
        if not line.startswith("worktree ") or not tree.parent.name.startswith(CHECKOUT):
            continue
        if tree.parent.exists():
            try:
                FileLock(tree.parent / "alive").acquire(blocking=False).lock.release()
            except Timeout:
                continue  # it lives
            shutil.rmtree(tree.parent, ignore_errors=True)
        git(root, "worktree", "prune")


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
