"""Find the base revision in git, check out its files and set the environment that runs its code."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from contactbench.errors import BadInput
from contactbench.plugins import VARIABLE
from contactbench.tables.provenance import SOURCES

#: names of the main branch; the first that exists is taken
MAIN = ("origin/HEAD", "origin/main", "main", "master")
#: file that names the revision whose speed every later one is compared with
PIN = ".gate-base"
#: variable set for the gate of the base revision while it judges another tree
JUDGED = "CONTACTBENCH_JUDGED_PYTHON"


def output(root: Path, *arguments: str, **variables: str) -> bytes:
    """Return the output of git; raise `BadInput` with its last line of error output if it fails."""
    command = ["git", "--no-replace-objects", "-C", str(root), *arguments]
    given = {**os.environ, "GIT_GRAFT_FILE": os.devnull, **variables}
    done = subprocess.run(command, capture_output=True, env=given)
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
    return Path(os.fsdecode(output(folder, "rev-parse", "--show-toplevel")).removesuffix("\n"))


def project(folder: Path) -> Path:
    """Return the root of contactbench's own repository if `folder` is inside it, else `folder`."""
    folder, top = folder.resolve(), repository(folder).resolve()
    around = [each for each in (folder, *folder.parents) if each.is_relative_to(top)]
    return next(filter(ours, around), folder)


def ours(root: Path) -> bool:
    """Return whether a tree holds contactbench itself and not a project that uses it."""
    return (root / "src" / "contactbench").is_dir()


def inside(tree: Path, root: Path, path: Path) -> Path:
    """Return the path in `tree` that corresponds to `path` in `root`, another checkout of the same project."""
    return Path(os.path.normpath(tree / os.path.relpath(path, root)))


def dirty(root: Path) -> bool:
    return bool(git(root, "status", "--porcelain", "--", *(SOURCES if ours(root) else ("*.py",))))


def base(root: Path, revision: str | None) -> str:
    """Return the commit to compare with: where HEAD left the main branch; on the main branch HEAD's parent."""
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
        way = "fetch more history (git fetch --unshallow), or name a revision with --base"
        raise BadInput(f"inconclusive: {wanted} is not in this clone; {way}")
    return found


def pinned(root: Path, base: str) -> str:
    """Return the revision pinned for speed by the base, else by the tree; "" if neither has the file."""
    own = root / PIN
    text = find(root, "show", f"{base}:./{PIN}") or (own.read_text(encoding="utf-8") if own.exists() else "")
    return text.partition("#")[0].strip()


@contextmanager
def checkout(root: Path, commit: str) -> Iterator[Path]:
    """Check out a commit with all its files into a temporary folder and give the path of the project there."""
    with tempfile.TemporaryDirectory(prefix="contactbench-base-") as scratch:
        top, tree = repository(root).resolve(), Path(scratch).resolve() / "base"
        index = {"GIT_INDEX_FILE": str(tree.with_name("index"))}
        output(top, "read-tree", commit, **index)
        output(top, "checkout-index", "--all", f"--prefix={tree}/", **index)
        found = tree / root.relative_to(top)
        if ours(root) and not ours(found):
            raise BadInput(f"--base {commit[:12]}: that revision has no src/contactbench")
        yield found


def environment(tree: Path, root: Path | None = None) -> dict[str, str]:
    """Return the environment of a process that runs the code of `tree`, its copies of plug-ins included."""
    own = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    first = [str(tree / "src" if (tree / "src").is_dir() else tree)]
    path = first if ours(tree) else [*first, *filter(None, [os.environ.get("PYTHONPATH")])]
    if root is not None:
        files = map(Path, filter(None, os.environ.get(VARIABLE, "").split(os.pathsep)))
        moved = ((file, inside(tree, root, file)) for file in files)
        found = (new if new.exists() or file.is_relative_to(root) else file for file, new in moved)
        own[VARIABLE] = os.pathsep.join(map(str, found))
    return {"JAX_PLATFORMS": "cpu", **own, **threads, "PYTHONPATH": os.pathsep.join(path)}
