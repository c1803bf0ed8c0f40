"""The result tables: their columns, how rows are merged into CSV, and provenance.

A row is keyed by the table's key columns.  New rows replace rows of the same key and leave the rest,
so a partial run updates its own part.  Files are replaced atomically.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import Enum
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from contactbench.errors import BadInput
from contactbench.plugins import LOADED

SCHEMA_VERSION = 2
KEY = ("scene", "method", "engine", "setting")
#: how much is run, from little to much; each makes the rows of those before it, and more
PROFILES = ("smoke", "standard", "full")
PROVENANCE = {
    "schema": "version of this table's columns",
    "run_id": "run that made the row (environment.json)",
    "profile": "smallest profile that makes the row: a run of it, or of a larger one, must have it",
}


class Rule(Enum):
    """How a column may differ between two runs; the regression gate (gate.py) has the numbers."""

    same = "must not change"
    count = "exact for fixed steps, within a tenth where a solver chooses them"
    error = "may move by a factor of two above round-off"
    structure = "an error; if it is round-off it must stay round-off"
    slope = "the slope of an error, compared in its asymptotic range (column in_fit)"
    value = "a quantity that is no error: within a hundredth"


_COMMON = {
    "scene": "name of the scene",
    "method": "name of the method",
    "engine": "what runs it: jax, python, c+python (compiled solver, Python callbacks), llvm, c, mpmath",
    "setting": "step size or tolerance",
    "status": "ok, diverged, budget, failed, timeout, unsupported",
    "message": "why, when the status is not ok",
}
_COUNTS = {
    "steps": "accepted steps",
    "evaluations": "evaluations of evaluation_kind in one run",
    "evaluation_kind": "gradient, rhs, taylor (orders of Taylor coefficients) or rotation",
    "rhs_equivalents": "evaluations on the scale of one right-hand side (two rotations count as one)",
    "jacobians": "Jacobian evaluations",
}
_RULES = {
    "status": Rule.same,
    "evaluation_kind": Rule.same,
    **dict.fromkeys(("steps", "evaluations", "rhs_equivalents", "jacobians"), Rule.count),
}


@dataclass(frozen=True)
class Table:
    """A CSV table: `columns` maps each column, in order, to its meaning.

    rules : how a column may differ between two runs of the same settings; those without a rule
    (times, messages) are not compared.
    """

    name: str
    about: str
    columns: Mapping[str, str]
    rules: Mapping[str, Rule] = field(default_factory=dict)
    key: tuple[str, ...] = KEY
    #: leading key columns of what is always made as a whole: a new run replaces all its rows
    whole: tuple[str, ...] = ()

    def path(self, results: Path) -> Path:
        return results / f"{self.name}.csv"


def _law_columns() -> dict[str, str]:
    from contactbench.measure.laws import DRIFT_COLUMNS, LAWS

    return {name: item.definition for name, item in LAWS.items()} | DRIFT_COLUMNS


def _law_rules() -> dict[str, Rule]:
    from contactbench.measure.laws import LAWS

    clamped = dict.fromkeys(
        ("contact_drift_clamped", "hamiltonian_law_clamped", "momentum_law_clamped"), Rule.count
    )
    return {name: Rule[item.gate.value] for name, item in LAWS.items()} | clamped | {"derivative": Rule.same}


def laws_shown(table: str) -> dict[str, str]:
    """The laws that the document of a table lists, in order, with their labels."""
    from contactbench.measure.laws import LAWS

    return {name: item.label for name, item in LAWS.items() if table in item.shown}


CONVERGENCE = Table(
    "convergence",
    "error against step size, and the order fitted to it",
    {
        **_COMMON,
        "step": "step size h",
        "solution_error": "max ‖y − y*‖ / max ‖y*‖",
        "pairwise_order": "slope between this step and the next larger one",
        "in_fit": "whether the point lies in the asymptotic range the order is fitted on",
        "order": "fitted order of the method on this scene (the same in every row of the method)",
        "order_low": "lower end of its 95 % interval",
        "order_high": "upper end of its 95 % interval",
        "order_nominal": "order the method claims",
        **_COUNTS,
    },
    {**_RULES, "solution_error": Rule.error, "pairwise_order": Rule.slope, "order_nominal": Rule.same},
)

LAWS_TABLE = Table(
    "laws",
    "decay laws and drifts over the whole run, maxima over the saved times",
    {**_COMMON, "saved_times": "number of saved times", **_law_columns(), **_COUNTS},
    {**_RULES, "saved_times": Rule.same, **_law_rules()},
)  # fmt: skip

LAWS_TIME = Table(
    "laws_time",
    "energy and the deviation from each law along time",
    {
        **_COMMON,
        "t": "time",
        "energy": "H0",
        "energy_deviation": "|H0(y) / H0(y*) − 1|",
        "hamiltonian_deviation": "|H e^{∫Γ'} − H(y₀)| / |H(y₀)|",
        "momentum_deviation": "‖J e^{∫Γ'} − J(y₀)‖ / ‖J(y₀)‖",
        "contact_deviation": "‖Φ*η − e^{−∫Γ'} η‖ / ‖e^{−∫Γ'} η‖",
    },
    {
        "status": Rule.same,
        **dict.fromkeys(("energy_deviation", "hamiltonian_deviation"), Rule.error),
        **dict.fromkeys(("momentum_deviation", "contact_deviation"), Rule.structure),
    },
    key=(*KEY, "t"),
)

WORK_PRECISION = Table(
    "work_precision",
    "time and evaluations against error",
    {
        **_COMMON,
        "track": "step: fixed, adaptive, or chosen (fixed, from pilots for a tolerance); limit: a plain C loop",
        "carried": "fields integrated",
        "solution_error": "max ‖y − y*‖ / max ‖y*‖ over five end times, each the end of its own run",
        **_COUNTS,
        "compile_s": "trace and compile, once per scene structure (once per tolerance for heyoka)",
        "first_call_s": "first call after compilation",
        "time_min_s": "fastest round, seconds per call",
        "time_median_s": "median over rounds, seconds per call",
        "time_iqr_s": "interquartile range over rounds",
        "rounds": "timed rounds",
        "iterations": "calls per round",
    },
    {**_RULES, "track": Rule.same, "carried": Rule.same, "solution_error": Rule.error},
)

ENSEMBLE_TABLE = Table(
    "ensemble",
    "throughput of ensembles: against C loops, at equal error, with their number and with the cores",
    {
        **_COMMON,
        "track": "what the row is for: arithmetic (same steps as C loops), error, size or cores",
        "trajectories": "number of trajectories",
        "cores": "cores used",
        "solution_error": "max ‖y(T) − y*(T)‖ / max ‖y*(T)‖ over the first four trajectories",
        "steps": "accepted steps of one trajectory, the most taken by any where they differ",
        "evaluations": "evaluations of evaluation_kind for one trajectory, where the solver says",
        "evaluation_kind": "gradient, rhs or taylor",
        "first_call_s": "first call, compilation included",
        "time_min_s": "fastest round, seconds for all trajectories, final states on the host",
        "time_median_s": "median over rounds",
        "time_iqr_s": "interquartile range over rounds",
        "rounds": "timed rounds",
        "iterations": "calls per round",
    },
    {"status": Rule.same, "steps": Rule.count, "evaluations": Rule.count, "solution_error": Rule.error},
    key=(*KEY, "track", "trajectories", "cores"),
)

STABILITY = Table(
    "stability",
    "the hard scenes: how every method ends, its errors and laws, at a fixed ladder of costs",
    {
        **_COMMON,
        "end_time": "how far the run got",
        "blow_up_time": "when the true motion reaches infinity, if it does",
        "condition_number": "max ‖∂x(t)/∂x(0)‖₂ of the true motion, where stored: what errors grow to",
        "end_error": "‖(q, p) − (q, p)*‖ / ‖(q, p)*‖ at the end (a body: M), relative to what is left then",
        **_law_columns(),
        **_COUNTS,
        "time_s": "fastest of a few calls, 25 saved times; other work may run beside it",
    },
    {**_RULES, "end_error": Rule.error, **_law_rules()},
)

STABILITY_LIMITS = Table(
    "stability_limits",
    "largest step with a bounded orbit of the oscillator q'' + γq' + ω²q = 0, by bisection",
    {
        "method": "name of the method",
        "gamma": "damping γ",
        "omega": "frequency ω",
        "limit": "largest step with a bounded orbit: no eigenvalue of the one-step map beyond the unit circle",
        "theory": "what theory gives, where it does",
        "per_evaluation": "the limit over the evaluations of a step",
    },
    {"limit": Rule.value},
    key=("method", "gamma", "omega"),
)

ONE_STEP = Table(
    "one_step",
    "spectral radius of the one-step map of the oscillator, ω = 1, beside that of the exact flow",
    {
        "method": "name of the method",
        "gamma": "damping γ",
        "step": "step size h",
        "radius": "largest |eigenvalue| of the one-step map",
        "true_radius": "of the exact flow: e^{−γh/2}, e^{−λh} with the slow rate λ where overdamped",
    },
    {"radius": Rule.value},
    key=("method", "gamma", "step"),
)

DAMPING_RATES = Table(
    "damping_rates",
    "measured damping rates: the slow rate of the overdamped oscillator, the rate of weak damping",
    {
        "experiment": "overdamped or weak",
        **_COMMON,
        "t_end": "span of the run",
        "damping_per_step": "γh, fixed steps",
        "evaluations": "evaluations in one run",
        "rate": "measured rate",
        "true_rate": "the same measured on the truth",
        "ratio": "measured over true",
        "rate_error": "|measured/true − 1|",
    },
    {"status": Rule.same, "evaluations": Rule.count, "rate_error": Rule.error},
    key=("experiment", "scene", "method", "setting", "t_end"),
)

STRONG_DAMPING = Table(
    "strong_damping",
    "error of fixed-step methods at equal cost as damping gets strong, oscillator, ω = 1",
    {
        "method": "name of the method",
        "gamma": "damping γ",
        "damping_per_evaluation": "γh over the evaluations of a step: the damping between two evaluations",
        "step": "step size h",
        "error": "‖Mⁿ − Φ_T‖₂/‖Φ_T‖₂ over the time T in which the motion falls by e",
        "radius": "largest |eigenvalue| of the one-step map",
    },
    {"error": Rule.error},
    key=("method", "gamma", "damping_per_evaluation"),
)

SEPARATOR = " // "  #: between the measurements listed in one cell

CLAIMS_TABLE = Table(
    "claims",
    "every claim of the paper with a measured number and the verdict that follows from it",
    {
        "id": "number of the claim",
        "where": "equation label, section or figure of the paper",
        "claim": "what is claimed, in our words",
        "scene": "what it is measured on",
        "method": "integrator, or how the equations themselves are tested",
        "quantity": "what was measured; of several measurements the first that fails, else the first",
        "measured": "its value",
        "relation": "how it must compare with the bound for the claim to hold",
        "bound": "the bound",
        "bound_reason": "why the bound is what it is",
        "verdict": "holds; holds, corrected; refuted: computed from the measurements",
        "correction_kind": "repairs (substance survives), replaces (contradicts), sharpens, extends",
        "correction": "the corrected statement",
        "corrected_quantity": "what was measured of it",
        "corrected_measured": "its value",
        "corrected_relation": "how it must compare with its bound",
        "corrected_bound": "its bound",
        "corrected_bound_reason": "why that bound",
        "evidence": "all measurements of the claim, separated by //",
        "corrected_evidence": "all measurements of the corrected statement, separated by //",
        "figures": "the paper's figures drawn for it",
        "command": "the command that measures it again",
        "status": "ok, or failed: not measured, no verdict",
        "message": "why, when the status is not ok",
    },
    {"status": Rule.same, "verdict": Rule.same},
    key=("id",),
)

PAPER_FIGURES = Table(
    "paper_figures",
    "the data of the paper's figures, corrected where the claim behind them fell",
    {
        "figure": "paper_N, or the name of a figure of ours",
        "panel": "panel of the figure",
        "curve": "curve in the panel",
        "point": "number of the point along its curve",
        "kind": "what it is: truth, law, method, conservative, dissipative, flow, criterion; or its stability",
        "x": "abscissa",
        "y": "ordinate",
        "z": "third coordinate, fitted order or growth rate where the figure has one",
    },
    {"kind": Rule.same},
    key=("figure", "panel", "curve", "point"),
    whole=("figure",),
)

GATE_SELFCHECK = Table(
    "gate_selfcheck",
    "false alarms of the regression gate on identical code, and planted faults it finds",
    {
        "part": "accuracy or speed",
        "planted": "what was changed in the code the gate judges",
        "condition": "what else the machine did: idle, or a busy loop on all cores but one",
        "wanted": "how many of the runs should be red",
        "runs": "judgements: runs of the gate, or faults or loops, each judged once",
        "red": "how many were red, by a line that names the method and measure of what was planted",
        "seconds": "one run of the gate, median",
        "example": "what the first red one said",
    },
    key=("part", "planted", "condition"),
)

TABLES = {
    table.name: table
    for table in (
        CONVERGENCE,
        LAWS_TABLE,
        LAWS_TIME,
        WORK_PRECISION,
        ENSEMBLE_TABLE,
        CLAIMS_TABLE,
        PAPER_FIGURES,
        STABILITY,
        STABILITY_LIMITS,
        ONE_STEP,
        DAMPING_RATES,
        STRONG_DAMPING,
        GATE_SELFCHECK,
    )
}

_TEXT = ("setting", "message", "run_id", "profile")
_WHOLE = (
    "steps",
    "evaluations",
    "jacobians",
    "rounds",
    "iterations",
    "saved_times",
    "schema",
    "point",
    "runs",
    "red",
    "trajectories",
    "cores",
)


# -- reading and writing ---------------------------------------------------------------------------
def read(table: Table, results: Path) -> pd.DataFrame:
    """The table's rows, empty if there is no file.

    Raises `BadInput` for a file that is not this table (foreign, corrupted, another schema).
    """
    path = table.path(results)
    columns = [*table.columns, *PROVENANCE]
    if not path.exists():
        return pd.DataFrame(columns=columns)
    try:
        frame = pd.read_csv(path, dtype=dict.fromkeys(_TEXT, str), keep_default_na=True)
    except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: not a readable CSV ({error}); move it away or restore it") from None
    if list(frame.columns) != columns:
        raise BadInput(f"{path}: columns are not those of table {table.name!r}; move it away or restore it")
    if len(frame) and set(frame["schema"]) != {SCHEMA_VERSION}:
        raise BadInput(f"{path}: schema {set(frame['schema'])}, this version reads {SCHEMA_VERSION}")
    if frame.duplicated(list(table.key)).any():
        raise BadInput(f"{path}: rows with the same key {table.key}; move it away or restore it")
    return _typed(frame)


def merge(table: Table, rows: Iterable[Mapping[str, Any]], results: Path) -> pd.DataFrame:
    """Fold rows into the table's CSV, newest last; returns the merged table."""
    old, new = read(table, results), pd.DataFrame(list(rows))
    if new.empty:
        return old
    unknown = set(new.columns) - set(table.columns) - set(PROVENANCE)
    if unknown:
        raise BadInput(f"table {table.name!r} has no columns {sorted(unknown)}")
    new["schema"] = SCHEMA_VERSION
    new = new.reindex(columns=[*table.columns, *PROVENANCE]).drop_duplicates(list(table.key), keep="last")
    replaced = table.whole or table.key
    frame = new if old.empty else pd.concat([_kept(old, new, replaced), new], ignore_index=True)
    frame = _sorted(_typed(frame), table)
    write(frame, table.path(results))
    return frame


def _kept(old: pd.DataFrame, new: pd.DataFrame, key: tuple[str, ...]) -> pd.DataFrame:
    replaced = pd.MultiIndex.from_frame(new[list(key)])
    return old[~pd.MultiIndex.from_frame(old[list(key)]).isin(replaced)]


def _typed(frame: pd.DataFrame) -> pd.DataFrame:
    for name in _WHOLE:
        if name in frame:
            frame[name] = pd.to_numeric(frame[name]).astype("Int64")
    return frame


def _sorted(frame: pd.DataFrame, table: Table) -> pd.DataFrame:
    """Registry order for scenes and methods, coarse to fine for settings."""
    from contactbench.methods import METHODS
    from contactbench.scenes import SCENES

    ranks = {"scene": list(SCENES), "method": list(METHODS)}

    def rank(column: pd.Series) -> pd.Series:
        if column.name in ranks:  # names of no registry, a plug-in's, after the others
            names = dict.fromkeys([*ranks[str(column.name)], *column])
            return column.map({name: i for i, name in enumerate(names)})
        if column.name == "setting":
            return column.map(lambda setting: -float(str(setting).rpartition("=")[2]))
        return column

    return frame.sort_values(list(table.key), key=rank, kind="stable", ignore_index=True)


def write(frame: pd.DataFrame, path: Path) -> None:
    """Write a CSV atomically; floats in scientific notation with all their digits."""

    def cell(value: Any) -> Any:
        if isinstance(value, float | np.floating):
            return "" if np.isnan(value) else np.format_float_scientific(value, trim="0")
        return value

    with replacing(path) as file:
        frame.map(cell).to_csv(file, index=False, lineterminator="\n")


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Any]:
    """A text file that takes the place of `path` when the block ends without an exception."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(temporary)
        raise


# -- provenance ------------------------------------------------------------------------------------
PACKAGES = (
    "contactbench", "numpy", "scipy", "jax", "jaxlib", "diffrax", "scikit-sundae", "heyoka", "pandas",
    "matplotlib", "mpmath", "pytest-benchmark",
)  # fmt: skip
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "XLA_FLAGS", "JAX_PLATFORMS")


def environment(profile: str, seed: int) -> dict[str, Any]:
    """Where and with what a run was made."""
    from contactbench.xla import jax

    versions = {}
    for name in PACKAGES:
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    root = Path(__file__).parents[3]
    manifest = root / "references" / "MANIFEST.json"
    return {
        "utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "profile": profile,
        "shuffle_seed": seed,
        "python": sys.version.split()[0],
        "packages": versions,
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "cores_used": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "jax_devices": [device.platform for device in jax.devices()],
        "threads": {name: os.environ.get(name, "") for name in THREADS},
        "commit": _git(root, "rev-parse", "HEAD"),
        "dirty": bool(_git(root, "status", "--porcelain", "--untracked-files=no", "--", ".", ":!results")),
        "plugins": dict(LOADED),
        "references": hashlib.sha256(manifest.read_bytes()).hexdigest() if manifest.exists() else "",
    }


def _cpu() -> str:
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or "unknown"


def _git(root: Path, *arguments: str) -> str:
    try:
        done = subprocess.run(
            ["git", "-C", str(root), *arguments], capture_output=True, text=True, check=True, timeout=20
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()


def save_environment(run_id: str, record: Mapping[str, Any], results: Path) -> None:
    """Add a run to environment.json and forget runs no row refers to any more."""
    path = results / "environment.json"
    runs = json.loads(path.read_text()) if path.exists() else {}
    runs[run_id] = record
    used = {run_id}
    for table in TABLES.values():
        used |= set(read(table, results)["run_id"].dropna())
    kept = {name: run for name, run in runs.items() if name in used}
    with replacing(path) as file:
        json.dump(kept, file, indent=1, sort_keys=True)
        file.write("\n")


def new_run_id() -> str:
    """UTC time to the second and the process, unique among runs on one machine."""
    return f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}-{os.getpid()}"
