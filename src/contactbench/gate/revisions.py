"""Revisions of the project in git: which one is the base, its files, and what a process of its code needs."""

from __future__ import annotations

import os
import subprocess
import tarfile
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

from contactbench.errors import BadInput
from contactbench.plugins import VARIABLE
from contactbench.tables.provenance import SOURCES

#: what the main branch may be called, the first there is
MAIN = ("origin/HEAD", "origin/main", "main", "master")
#: the file that names the revision whose speed is kept, until a commit moves it
PIN = ".gate-base"
#: set in the environment of the gate of a base revision, which judges another tree
JUDGED = "CONTACTBENCH_JUDGED_PYTHON"


def output(root: Path, *arguments: str) -> bytes:
    """Return the output of git; raise `BadInput` with its own last line."""
    command = ["git", "--no-replace-objects", "-C", str(root), *arguments]
    done = subprocess.run(command, capture_output=True, env={**os.environ, "GIT_GRAFT_FILE": os.devnull})
    if done.returncode:
        message = done.stderr.decode(errors="replace").strip() or f"exit {done.returncode}"
        raise BadInput(f"git {arguments[0]} in {root}: {message.splitlines()[-1]}")
    return done.stdout


def git(root: Path, *arguments: str) -> str:
    return output(root, *arguments).decode(errors="replace").strip()


def find(root: Path, *arguments: str) -> str:
    try:
        return git(root, *arguments)
    except BadInput:
        return ""


def commit(root: Path, revision: str) -> str:
    return find(root, "rev-parse", "--verify", "--quiet", "--end-of-options", f"{revision}^{{commit}}")


def repository(folder: Path) -> Path:
    return Path(git(folder, "rev-parse", "--show-toplevel"))


def ours(root: Path) -> bool:
    """Return whether a tree is one of contactbench itself, not of a project that uses it."""
    return (root / "src" / "contactbench").is_dir()


def dirty(root: Path) -> bool:
    return bool(git(root, "status", "--porcelain", "--", *(SOURCES if ours(root) else ("*.py",))))


def base(root: Path, revision: str | None) -> str:
    """Return the commit to compare with: by default where the main branch was left, on it HEAD's parent."""
    if revision is not None:
        if found := commit(root, revision):
            return found
        raise BadInput(f"--base {revision}: no such revision (in a shallow clone fetch more history)")
    wanted, found = "HEAD's parent", commit(root, "HEAD~1")
    main = next((branch for branch in MAIN if commit(root, branch)), None)
    if main is not None:
        left = find(root, "merge-base", "HEAD", main)
        if left != commit(root, "HEAD"):
            wanted, found = f"the commit at which HEAD left {main}", left
    if not found:
        shallow = git(root, "rev-parse", "--is-shallow-repository") == "true"
        if not shallow and commit(root, "HEAD") and wanted == "HEAD's parent":
            raise BadInput(
                "inconclusive: HEAD is the first commit, there is nothing before it to compare with"
            )
        way = "fetch it (git fetch --unshallow)" if shallow else "fetch it, or name a revision with --base"
        raise BadInput(f"inconclusive: {wanted} is not in this clone; {way}")
    return found


def pinned(root: Path, base: str) -> str:
    """Return the revision that the base pins for speed, or, where the base has no such file, the tree; "" for none."""
    own = root / PIN
    text = find(root, "show", f"{base}:{PIN}") or (own.read_text(encoding="utf-8") if own.exists() else "")
    return text.partition("#")[0].strip()


@contextmanager
def checkout(root: Path, commit: str, *paths: str) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="contactbench-base-") as scratch:
        tree = Path(scratch).resolve() / "base"
        with tarfile.open(fileobj=BytesIO(output(root, "archive", commit, *paths))) as files:
            files.extractall(tree, filter="data")
        if ours(root) and not paths and not ours(tree):
            raise BadInput(f"--base {commit[:12]}: that revision has no src/contactbench")
        yield tree


def environment(tree: Path, root: Path | None = None) -> dict[str, str]:
    """Return the variables of a process that runs the code of a tree, with its copies of the plug-ins in `root`."""
    own = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    first = [str(tree / "src" if (tree / "src").is_dir() else tree)]
    path = first if ours(tree) else [*first, *filter(None, [os.environ.get("PYTHONPATH")])]
    if root is not None:
        files = map(Path, filter(None, os.environ.get(VARIABLE, "").split(os.pathsep)))
        moved = (tree / file.relative_to(root) if file.is_relative_to(root) else file for file in files)
        own[VARIABLE] = os.pathsep.join(map(str, moved))
    return {"JAX_PLATFORMS": "cpu", **own, **threads, "PYTHONPATH": os.pathsep.join(path)}
