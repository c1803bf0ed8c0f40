"""Made-up folders of tables, and repositories that have them committed."""

import json
import shutil
import subprocess
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from cases import REPOSITORY
from contactbench.tables.schema import TABLES
from contactbench.tables.store import merge

#: the record of a run, as complete as the benchmark writes it
RUN = {"run": "one", "profile": "smoke", "cpu": "a", "isa": "x", "python": "3.13", "packages": {"jax": "1"}}
RUN |= {"references": "r", "commit": "c", "dirty": False, "utc": "2026-01-01T00:00:00+00:00"}
RUN |= {"tables": dict.fromkeys(("runs", "times", "orders", "claims"), "whole")}
#: what every run has
COMMON = {"scene": "particle", "engine": "jax", "status": "ok", "family": "established", "truth": "ok"}
COMMON |= {"steps": 200, "evaluations": 800.0}


def row(method="rk4", setting="step=0.1", saved=1, profile="smoke", **more):
    """A run, its control and setting as one word."""
    control, _, value = setting.partition("=")
    own = {"control": control, "setting": float(value), "saved": saved, "profile": profile}
    return {**COMMON, "method": method, **own, **more}


def time(method="rk4", setting="step=0.1", seconds=1e-4, **more):
    """The time of a run."""
    own = row(method, setting, **more)
    return {name: own[name] for name in TABLES["times"].key} | {"least_s": seconds}


def point(method="rk4", step=0.1, **more):
    """A point of a method's errors against the step."""
    own = {"scene": "particle", "method": method, "engine": "llvm", "step": step, "status": "ok"}
    return own | {"in_fit": True, "order": 4.0, "order_nominal": 4, **more}


#: what the folder of a run holds: a few methods on one scene, and a row of a larger profile
ROWS = {
    "runs": [
        row(saved=25, error=1e-5, energy_law=3e-6, momentum_law=2e-15, momentum_law_claimed=True),
        row("cvode-adams", "rtol=1e-06", saved=25, error=1e-4, momentum_law=1e-7),
        row(error=1e-6),
        row("cvode-adams", "rtol=1e-06", error=2e-5),
        row(setting="step=0.01", profile="standard", error=1e-10),
        row("cvode-bdf", "rtol=1e-12", status="budget", message="too many"),
    ],
    "times": [time(), time("cvode-adams", "rtol=1e-06", 1e-3)],
    "orders": [
        point(error=1e-5),
        point(step=0.8, error=0.2, in_fit=False),
        point("contact-o8", 0.03125, engine="mpmath", error=1e-20, order=8.0, order_nominal=8),
    ],
    "claims": [
        {"id": "C01", "verdict": "holds", "status": "ok", "relation": "≤", "bound": 1e-12, "measured": 1e-16}
    ],
}


@cache
def files(name):
    """The files of one of the tables as they are, by name: what most of the folders hold of it."""
    with TemporaryDirectory() as made:
        merge(TABLES[name], ROWS[name], Path(made))
        return {path.name: path.read_bytes() for path in Path(made).iterdir()}


def same(which, row):
    return row


def without(**values):
    """A change that leaves rows out."""
    return lambda which, row: None if values.items() <= {"table": which, **row}.items() else row


def folder(path, change=same, run=RUN, keep=lambda row: True):
    """A folder of tables, each row changed (None: left out)."""
    path.mkdir(parents=True, exist_ok=True)
    for which, rows in ROWS.items():
        changed = (change(which, dict(row)) for row in rows)
        kept = [row for row in changed if row is not None and keep(row)]
        if kept == rows and not TABLES[which].path(path).exists():
            for name, text in files(which).items():
                (path / name).write_bytes(text)
        else:
            merge(TABLES[which], kept, path)
    (path / "environment.json").write_text(json.dumps({"runs": [run]}))
    return path


def git(root, *arguments):
    who = ["-c", "user.name=t", "-c", "user.email=t@example.org", "-c", "commit.gpgsign=false"]
    command = ["git", "-C", str(root), *who, *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def repository(root, **more):
    """A repository with a folder of tables committed on its main branch; see `folder`."""
    (root / "src" / "contactbench").mkdir(parents=True)
    (root / "src" / "contactbench" / "__init__.py").write_text("")
    git(root, "init", "-q", "-b", "main")
    folder(root / "results", **more)
    commit(root, "tables")
    return commit(root, "nothing more")


def commit(root, message):
    git(root, "add", "-A")
    git(root, "commit", "-q", "--allow-empty", "-m", message)
    return root


def fresh(root, path, change=same, **more):
    """The tables of a run made by what is checked out."""
    return folder(path, change, run={**RUN, "commit": git(root, "rev-parse", "HEAD"), **more})


def project(root):
    """A repository with the sources as they are now, and made-up tables."""
    folder(root / "results")
    for name in ("src", "bench", "references"):
        shutil.copytree(REPOSITORY / name, root / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "constraints.txt"):
        shutil.copy(REPOSITORY / name, root)
    git(root, "init", "-q", "-b", "main")
    return commit(root, "all")
