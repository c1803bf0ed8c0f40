"""Made-up folders of tables, repositories that have them committed, and the tables of this one as committed."""

from __future__ import annotations

import json
import shutil
import subprocess
import tarfile
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

from cases import REPOSITORY
from contactbench.results.store import merge
from contactbench.results.tables import CLAIMS_TABLE, CONVERGENCE, LAWS_TABLE, WORK_PRECISION

#: the record of a run, as complete as the benchmark writes it
RUN = {
    "run": "one", "profile": "smoke", "cpu": "a", "isa": "x", "python": "3.13", "packages": {"jax": "1"},
    "references": "r", "commit": "c", "dirty": False, "utc": "2026-01-01T00:00:00+00:00",
    "tables": dict.fromkeys(("laws", "convergence", "work_precision", "claims"), "whole"),
}  # fmt: skip


def row(method="rk4", setting="step=0.1", profile="smoke", **more):
    control, _, value = setting.partition("=")
    return {
        "scene": "particle", "method": method, "engine": "jax", "setting": setting, "control": control,
        "value": float(value), "status": "ok", "family": "established",
        "message": "", "profile": profile, "steps": 200, "evaluations": 800,
        "evaluation_kind": "rhs", "rhs_equivalents": 800.0, "jacobians": 0, **more,
    }  # fmt: skip


#: what the folder of a run holds: two methods on one scene, and a row of a larger profile
ROWS = (
    (LAWS_TABLE, [
        row(solution_error=1e-5, energy_law=3e-6, momentum_law=2e-15, energy_increases=0.0, saved_times=25),
        row("cvode-adams", "rtol=1e-06", solution_error=1e-4, momentum_law=1e-7, saved_times=25),
    ]),
    (CONVERGENCE, [
        row(step=0.1, solution_error=1e-5, pairwise_order=4.01, in_fit=True, order=4.0, order_nominal=4),
        row(
            setting="step=0.8", step=0.8, solution_error=0.2, pairwise_order=2.0, in_fit=False, order=4.0,
            order_nominal=4,
        ),
        row(
            "contact-o8", "step=0.03125", engine="mpmath", step=0.03125, solution_error=1e-20,
            pairwise_order=8.0, in_fit=True, order=8.0, order_nominal=8,
        ),
    ]),
    (WORK_PRECISION, [
        row(carried="q p", solution_error=1e-6, time_median_s=1e-4),
        row("cvode-adams", "rtol=1e-06", carried="q p", solution_error=2e-5, time_median_s=1e-3),
        row(setting="step=0.01", profile="standard", carried="q p", solution_error=1e-10),
        row("cvode-bdf", "rtol=1e-12", status="budget", message="too many"),
    ]),
    (CLAIMS_TABLE, [{"id": "C01", "scene": "particle", "method": "any", "verdict": "holds", "status": "ok",
                    "relation": "≤", "bound": 1e-12, "measured": 1e-16, "profile": "smoke"}]),
)  # fmt: skip


@cache
def files(name):
    """The files of one of the tables as they are, by name: what most of the folders hold of it."""
    ((which, rows),) = ((which, rows) for which, rows in ROWS if which.name == name)
    with TemporaryDirectory() as made:
        merge(which, rows, Path(made))
        return {path.name: path.read_bytes() for path in Path(made).iterdir()}


def folder(path, change=lambda which, row: row, run=RUN, keep=lambda row: True):
    """A folder of tables, each row changed (None: left out)."""
    path.mkdir(parents=True, exist_ok=True)
    for which, rows in ROWS:
        changed = [change(which, dict(row)) for row in rows]
        kept = [row for row in changed if row is not None and keep(row)]
        if kept == rows and not which.path(path).exists():
            for name, text in files(which.name).items():
                (path / name).write_bytes(text)
        else:
            merge(which, kept, path)
    (path / "environment.json").write_text(json.dumps({"runs": [run]}))
    return path


def setting(which, method, **values):
    """A change of one method's rows in one table."""
    return lambda t, row: {**row, **values} if t is which and row["method"] == method else row


def git(root, *arguments):
    who = ["-c", "user.name=t", "-c", "user.email=t@example.org"]
    done = subprocess.run(
        ["git", "-C", str(root), *who, *arguments], check=True, capture_output=True, text=True
    )
    return done.stdout.strip()


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


def fresh(root, path, change=lambda which, row: row, **more):
    """The tables of a run made by what is checked out."""
    return folder(path, change, run={**RUN, "commit": git(root, "rev-parse", "HEAD"), **more})


def committed(path):
    """The tables as committed, whatever a run has made of them since; those of a source archive as they are."""
    path.mkdir(exist_ok=True)
    if (REPOSITORY / ".git").exists():
        archive = subprocess.run(
            ["git", "-C", str(REPOSITORY), "archive", "HEAD:results"], capture_output=True, check=True
        )
        with tarfile.open(fileobj=BytesIO(archive.stdout)) as tables:
            tables.extractall(path, filter="data")
    else:
        shutil.copytree(REPOSITORY / "results", path, dirs_exist_ok=True)
    return path
