"""Record the machine, packages and commit of every run behind the tables, in environment.json.

A run stays in the list while a table holds rows of it.  A run that makes a whole table replaces all earlier runs of
that table.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import subprocess
import sys
from collections.abc import Iterable
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from contactbench.errors import BadInput
from contactbench.files import replacing
from contactbench.measure.clock import SEED
from contactbench.plugins import LOADED
from contactbench.tables.schema import TABLES, Row

PACKAGES = """contactbench numpy scipy pandas matplotlib mpmath
llvmlite numba jax jaxlib diffrax scikit-sundae heyoka cyrk"""
#: files and folders that decide the numbers in the tables
SOURCES = ("src", "bench", "references", "pyproject.toml", "constraints.txt", "tox.ini")
CHANGES = ("status", "--porcelain", "--untracked-files=no", "--", *SOURCES)
THREADS = [f"{name}_NUM_THREADS" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")]
THREADS += ["XLA_FLAGS", "JAX_PLATFORMS"]


def environment(profile: str) -> Row:
    versions = {}
    for name in PACKAGES.split():
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    package = Path(__file__).parents[3]
    root = package if Path.cwd().is_relative_to(package) else Path.cwd()  # a project that uses this one
    manifest = package / "references" / "MANIFEST.json"
    return {
        "utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "profile": profile,
        "shuffle_seed": SEED,
        "python": sys.version.split()[0],
        "packages": versions,
        "cpu": _cpu(),
        "isa": _instructions(),
        "cores": os.cpu_count(),
        "cores_used": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "threads": {name: os.environ.get(name, "") for name in THREADS},
        "commit": _git(root, "rev-parse", "HEAD"),
        "dirty": bool(_git(root, *CHANGES, *([] if root == package else ["*.py"]))),
        "plugins": dict(LOADED),
        "references": hashlib.sha256(manifest.read_bytes()).hexdigest() if manifest.exists() else "",
    }


def _cpu() -> str:
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or "unknown"


def _instructions() -> str:
    """Return the compiler's name of the processor and a digest of its instructions, which decide on rounding."""
    from llvmlite import binding

    features = ",".join(sorted(name for name, there in binding.get_host_cpu_features().items() if there))
    return f"{binding.get_host_cpu_name()} {hashlib.sha256(features.encode()).hexdigest()[:12]}"


def _git(root: Path, *arguments: str) -> str:
    command = ["git", "-C", str(root), *arguments]
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=20).stdout.strip()
    return ""


def new_run_id() -> str:
    return f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{os.getpid()}"


def runs(results: Path) -> list[dict[str, Any]]:
    """Return the recorded runs of a folder, oldest first; raise `BadInput` if the record is damaged."""
    path = results / "environment.json"
    if not path.exists():
        return []
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        listed = found.get("runs") if isinstance(found, dict) else None
        if not listed or not all(isinstance(run, dict) and "profile" in run for run in listed):
            raise ValueError("no list of runs, each with its profile")
    except (OSError, ValueError, TypeError, RecursionError) as error:
        why = " ".join(str(error).split())[:100]
        raise BadInput(f"{path}: {why}: not the record of a benchmark run; restore it") from None
    return [{"run": f"run {k}", "tables": {}, **run} for k, run in enumerate(listed, start=1)]


def save_run(name: str, record: Row, made: Iterable[str], whole: Iterable[str], results: Path) -> None:
    """Record a run and forget runs without rows; made : tables with rows of it; whole : tables it made completely."""
    others = {run["run"]: run for run in runs(results)}
    own = {**others.pop(name, {"tables": {}})["tables"], **dict.fromkeys(made, "part")}
    alone = own.keys() & set(whole)  # tables with rows of this run only
    if not own:
        return
    mine = {"run": name, **record, "tables": own | dict.fromkeys(alone, "whole")}
    before, clock = [], {"run": "", "utc": ""}
    for run in others.values():
        # of two runs that differ only in their time, the later one is kept
        if {**run, **clock} != {**mine, **clock}:
            kept = {table: part for table, part in run["tables"].items() if table in TABLES.keys() - alone}
            before += [{**run, "tables": kept}] if kept else []
    with replacing(results / "environment.json") as file:
        json.dump({"runs": [*before, mine]}, file, indent=1, sort_keys=True)
        file.write("\n")
