"""The regression gate on tables made up for it: what turns it red, what does not, and what it says."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
import sys
from contextlib import contextmanager
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import contactbench as cb
import gate_selfcheck
import planted_faults
import properties
from cases import bench, finished
from contactbench.cli import main
from contactbench.errors import BadInput
from contactbench.gate import speed
from contactbench.gate.accuracy import DECADES, accuracy
from contactbench.plugins import VARIABLE
from contactbench.report import gate_selfcheck as room
from contactbench.report import markdown
from contactbench.results.schema import PROFILES, TABLES, Rule
from contactbench.results.statistics import PairedRatio
from contactbench.results.store import merge, read
from contactbench.results.tables import (
    CLAIMS_TABLE,
    CONVERGENCE,
    GATE_SELFCHECK,
    LAWS_TABLE,
    STABILITY,
    STABILITY_LIMITS,
    WORK_PRECISION,
)
from contactbench.splitting.tables import COMPOSITIONS
from planted_faults import plugin

REPOSITORY = Path(__file__).parents[2]
RUN = {"profile": "smoke", "cpu": "a", "python": "3.13", "packages": {"jax": "1"}, "references": "r"}


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
        row(step=0.1, solution_error=1e-5, pairwise_order=4.01, in_fit=True, order_nominal=4),
        row(setting="step=0.8", step=0.8, solution_error=0.2, pairwise_order=2.0, in_fit=False, order_nominal=4),
        row(
            "contact-o8", "step=0.03125", engine="mpmath", step=0.03125, solution_error=1e-20,
            pairwise_order=8.0, in_fit=True, order_nominal=8,
        ),
    ]),
    (WORK_PRECISION, [
        row(carried="q p", solution_error=1e-6, time_median_s=1e-4),
        row("cvode-adams", "rtol=1e-06", carried="q p", solution_error=2e-5, time_median_s=1e-3),
        row(setting="step=0.01", profile="standard", carried="q p", solution_error=1e-10),
        row("cvode-bdf", "rtol=1e-12", status="budget", message="too many"),
    ]),
    (CLAIMS_TABLE, [{"id": "C01", "scene": "particle", "method": "any", "verdict": "holds", "status": "ok",
                    "measured": 1e-16, "profile": "smoke"}]),
)  # fmt: skip


def folder(path, change=lambda which, row: row, run=RUN, keep=lambda row: True):
    """A folder of tables, each row changed (None: left out)."""
    for which, rows in ROWS:
        changed = [change(which, dict(row)) for row in rows]
        merge(which, [row for row in changed if row is not None and keep(row)], path)
    path.mkdir(exist_ok=True)
    (path / "environment.json").write_text(json.dumps({"runs": [run]}))
    return path


@pytest.fixture
def baseline(tmp_path):
    return folder(tmp_path / "baseline")


def judged(baseline, change, tmp_path, **more):
    return accuracy(baseline, folder(tmp_path / "fresh", change, **more))


def setting(which, method, **values):
    """A change of one method's rows in one table."""
    return lambda t, row: {**row, **values} if t is which and row["method"] == method else row


@pytest.mark.parametrize(("spread", "red"), [(0.0, True), (0.04, True), (0.6, False)])
def test_counts_may_move_by_what_roundings_were_measured_to_do_to_them(spread, red, tmp_path):
    change = setting(WORK_PRECISION, "cvode-adams", evaluations_spread=spread)
    before = folder(tmp_path / "before", change)
    now = setting(WORK_PRECISION, "cvode-adams", evaluations_spread=spread, evaluations=1200)
    assert accuracy(before, folder(tmp_path / "now", now)).red is red


def test_identical_tables_are_green(baseline, tmp_path):
    verdict = judged(baseline, lambda which, row: row, tmp_path)
    assert not verdict.red
    assert verdict.lines == ()
    assert "Nothing moved" in verdict.as_markdown()
    assert "10 rows of a smoke run" not in verdict.as_markdown()  # the standard row was not asked for
    assert "9 rows of a smoke run" in verdict.as_markdown()


FAULTS = {
    "error": (setting(LAWS_TABLE, "rk4", solution_error=2.2e-5), "rk4", "solution_error"),
    "error gone down": (setting(LAWS_TABLE, "rk4", solution_error=4e-6), "rk4", "solution_error"),
    "error of an adaptive solver": (
        setting(WORK_PRECISION, "cvode-adams", solution_error=5e-5), "cvode-adams", "solution_error",
    ),
    "error at fifty digits": (setting(CONVERGENCE, "contact-o8", solution_error=1e-19), "contact-o8", "solution_error"),
    "error not a number": (setting(LAWS_TABLE, "rk4", solution_error=math.nan), "rk4", "solution_error"),
    "error infinite": (setting(LAWS_TABLE, "rk4", solution_error=math.inf), "rk4", "solution_error"),
    "round-off lost": (setting(LAWS_TABLE, "rk4", momentum_law=3e-12), "rk4", "momentum_law"),
    "slope": (
        lambda t, r: {**r, "pairwise_order": 3.8} if t is CONVERGENCE and r["in_fit"] and r["method"] == "rk4" else r,
        "rk4", "pairwise_order",
    ),
    "one gradient more": (setting(WORK_PRECISION, "rk4", evaluations=801), "rk4", "evaluations"),
    "a fifth more steps": (setting(WORK_PRECISION, "cvode-adams", steps=241), "cvode-adams", "steps"),
    "status": (setting(WORK_PRECISION, "rk4", status="diverged", solution_error=math.nan), "rk4", "status"),
    "a refusal that ends well": (setting(WORK_PRECISION, "cvode-bdf", status="ok"), "cvode-bdf", "status"),
    "order claimed": (setting(CONVERGENCE, "contact-o8", order_nominal=6), "contact-o8", "order_nominal"),
    "family": (setting(LAWS_TABLE, "rk4", family="contact"), "rk4", "family"),
    "verdict of a claim": (setting(CLAIMS_TABLE, "any", verdict="refuted"), "any", "verdict"),
    "dropped method": (
        lambda t, r: None if r["method"] == "contact-o8" else r, "contact-o8", "row of convergence",
    ),
    "dropped setting": (
        lambda t, r: None if t is CONVERGENCE and r["setting"] == "step=0.8" else r, "rk4", "row of convergence",
    ),
    "dropped table": (lambda t, r: None if t is LAWS_TABLE else r, "rk4", "row of laws"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_every_kind_of_regression_is_red_and_named(fault, baseline, tmp_path):
    change, method, measure = FAULTS[fault]
    verdict = judged(baseline, change, tmp_path)
    assert verdict.red
    red = [line for line in verdict.lines if line.red]
    assert (method, measure) in {(line.method, line.measure) for line in red}
    assert {line.scene for line in red} == {"particle"}
    text = next(line for line in verdict.as_markdown().splitlines() if measure in line and method in line)
    assert "particle" in text
    assert json.loads(verdict.as_json())["red"]


ALLOWED = {
    "error within a factor of two": setting(LAWS_TABLE, "rk4", solution_error=1.9e-5),
    "round-off that stays so": setting(LAWS_TABLE, "rk4", momentum_law=9e-13),
    "a tenth more steps": setting(WORK_PRECISION, "cvode-adams", steps=219),
    "slope outside the asymptotic range": lambda t, r: (
        {**r, "pairwise_order": 0.5} if t is CONVERGENCE and not r["in_fit"] else r
    ),
    "time": setting(WORK_PRECISION, "rk4", time_median_s=1.0),
    "message": setting(WORK_PRECISION, "cvode-bdf", message="other words"),
    "measured value of a claim": setting(CLAIMS_TABLE, "any", measured=3e-16),
}


@pytest.mark.parametrize("change", ALLOWED.values(), ids=ALLOWED)
def test_what_may_move_is_green(change, baseline, tmp_path):
    assert not judged(baseline, change, tmp_path).red


def test_errors_at_round_off_may_move(tmp_path):
    before = folder(tmp_path / "b", setting(LAWS_TABLE, "rk4", solution_error=2e-16))
    assert not judged(before, setting(LAWS_TABLE, "rk4", solution_error=2e-14), tmp_path).red
    assert judged(before, setting(LAWS_TABLE, "rk4", solution_error=1e-13), tmp_path / "again").red


def test_an_ill_conditioned_motion_has_a_higher_floor_and_a_limit_may_move_by_a_hundredth(tmp_path):
    limit = {"method": "rk4", "gamma": 1.0, "omega": 1.0, "profile": "smoke"}

    def made(name, error, largest):
        path = folder(tmp_path / name)
        merge(STABILITY, [row(end_error=error, condition_number=1e6)], path)
        merge(STABILITY_LIMITS, [{**limit, "limit": largest}], path)
        return path

    before = made("before", 1e-9, 2.0)
    assert not accuracy(before, made("close", 2e-8, 2.01)).red
    assert not accuracy(made("never", 1e-9, math.inf), made("still", 1e-9, math.inf)).red
    lines = accuracy(before, made("far", 1e-7, 2.03)).lines
    assert {(line.table, line.measure) for line in lines if line.red} == {
        ("stability", "end_error"),
        ("stability_limits", "limit"),
    }


def test_of_a_larger_run_the_larger_profiles_rows_are_expected(baseline, tmp_path):
    small = judged(baseline, lambda t, r: r, tmp_path, keep=lambda row: row["profile"] == "smoke")
    assert not small.red
    standard = {**RUN, "profile": "standard"}
    large = judged(
        baseline, lambda t, r: r, tmp_path / "again", keep=lambda row: row["profile"] == "smoke", run=standard
    )
    assert [(line.measure, line.setting) for line in large.lines] == [("row of work_precision", "step=0.01")]


def test_the_worst_row_stands_for_a_measure(baseline, tmp_path):
    verdict = judged(
        baseline,
        lambda t, r: {**r, "solution_error": r["solution_error"] * (30 if r["in_fit"] else 3)}
        if t is CONVERGENCE and r["method"] == "rk4" else r,
        tmp_path,
    )  # fmt: skip
    (line,) = (line for line in verdict.lines if line.measure == "solution_error")
    assert (line.setting, line.change, line.rows) == ("step=0.1", "×30", 2)


def test_new_rows_and_other_machines_are_noted_not_judged(baseline, tmp_path):
    fresh = folder(tmp_path / "fresh", run={**RUN, "cpu": "b"})
    merge(LAWS_TABLE, [row("mine", solution_error=1.0)], fresh)
    verdict = accuracy(baseline, fresh)
    assert not verdict.red
    assert set(verdict.notes) == {"1 rows have no baseline yet", "processor: baseline a, fresh b"}


def test_a_column_that_the_baseline_lacks_is_not_judged_and_one_that_is_lost_is(tmp_path):
    """A law that is new, in a table from before it."""
    new = setting(LAWS_TABLE, "rk4", momentum_balance=1e-3)
    assert not judged(folder(tmp_path / "before"), new, tmp_path).red
    had = folder(tmp_path / "had", new)
    lines = accuracy(had, folder(tmp_path / "lost")).lines
    assert {(line.method, line.measure) for line in lines if line.red} == {("rk4", "momentum_balance")}


def test_tables_of_another_version_are_named_and_what_to_do(baseline, tmp_path, capsys):
    fresh = folder(tmp_path / "fresh")
    path = LAWS_TABLE.path(baseline)
    path.write_text(path.read_text().replace(",3,smoke", ",2,smoke"))
    status, text = outcome(capsys, "--only", "accuracy", "--baseline", baseline, "--fresh", fresh)
    assert status == 2
    assert f"{path}: schema 2, this version reads 3; run the benchmark (tox -e bench)" in text
    assert text.count("\n") == 1


def test_every_table_says_what_is_compared():
    for item in TABLES.values():
        assert item.rules or item is GATE_SELFCHECK, item.name
        assert set(item.rules) <= set(item.columns), item.name
        assert not set(item.rules) & set(item.key), item.name
        assert not set(item.rules) & set(item.timed), item.name  # no absolute time is ever judged
        assert {name for name in item.columns if name.endswith("_s")} <= set(item.timed), item.name
    assert LAWS_TABLE.rules["momentum_law"] is Rule.structure
    assert LAWS_TABLE.rules["solution_error"] is Rule.error
    assert pytest.approx(2, abs=0.01) == 10**DECADES


# -- bad input -------------------------------------------------------------------------------------
def outcome(capsys, *arguments):
    status = main(["gate", *map(str, arguments)])
    captured = capsys.readouterr()
    return status, captured.out + captured.err


def test_exit_status_and_json(baseline, tmp_path, capsys):
    good, bad = folder(tmp_path / "good"), folder(tmp_path / "bad", FAULTS["error"][0])
    assert outcome(capsys, "--only", "accuracy", "--baseline", baseline, "--fresh", good)[0] == 0
    status, text = outcome(capsys, "--only", "accuracy", "--baseline", baseline, "--fresh", bad, "--json")
    assert status == 1
    (line,) = json.loads(text)["lines"]
    assert (line["scene"], line["method"], line["measure"]) == ("particle", "rk4", "solution_error")
    assert line["change"] == "×2.2"


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda b: (b / "environment.json").unlink(), "no finished benchmark run"),
        (lambda b: (b / "environment.json").write_text("[1]"), "not the record of a benchmark run"),
        (lambda b: LAWS_TABLE.path(b).write_text("a,b\n1,2\n"), "columns are not those of table 'laws'"),
        (lambda b: [path.unlink() for path in b.glob("*.csv")], "no row that a run of profile 'smoke' makes"),
    ],
    ids=["no environment", "odd environment", "foreign table", "no tables"],
)
def test_a_bad_baseline_is_one_line_and_exit_two(spoil, message, baseline, tmp_path, capsys):
    fresh = folder(tmp_path / "fresh")
    spoil(baseline)
    status, text = outcome(capsys, "--only", "accuracy", "--baseline", baseline, "--fresh", fresh)
    assert status == 2
    assert message in text
    assert text.count("\n") == 1


def test_without_benchmark_git_or_revision_it_could_not_run(baseline, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    status, text = outcome(capsys, "--only", "accuracy", "--baseline", baseline)
    assert (status, text.count("\n")) == (2, 1)
    assert "no benchmark there" in text
    status, text = outcome(capsys, "--only", "speed", "--baseline", baseline)
    assert (status, text.count("\n")) == (2, 1)
    assert "not a git repository" in text
    monkeypatch.chdir(REPOSITORY)
    status, text = outcome(capsys, "--only", "speed", "--baseline", baseline, "--base", "no-such")
    assert (status, text.count("\n")) == (2, 1)
    assert "--base no-such: no such revision" in text
    monkeypatch.setenv("PATH", str(tmp_path))
    status, text = outcome(capsys, "--only", "speed", "--baseline", baseline)
    assert (status, text.count("\n")) == (2, 1)
    assert "git: not installed" in text


# -- runs --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "experiment", sorted(path.stem for path in (REPOSITORY / "bench").glob("bench_*.py"))
)
def test_every_cell_of_a_profile_is_one_of_the_next(experiment):
    """What `profile` in a row promises: a larger run has the rows of a smaller one."""
    spec = spec_from_file_location("bench_conftest", REPOSITORY / "bench" / "conftest.py")
    conftest = module_from_spec(spec)
    sys.modules[spec.name] = conftest
    spec.loader.exec_module(conftest)
    assert tuple(conftest.PROFILES) == PROFILES
    tests = [f for f in vars(import_module(experiment)).values() if hasattr(f, "cells")]
    assert tests
    for test in tests:
        cells = [set(test.cells(profile)) for profile in conftest.PROFILES.values()]
        assert cells[1]
        assert cells[0] <= cells[1] <= cells[2]


def test_a_wrong_coefficient_is_found_in_real_runs(tmp_path):
    """The drift of Strang's method, and that of no other method, a part in a thousand too long."""
    few = "convergence and particle and not long and (contact-strang or contact-abc)"
    fault = plugin(tmp_path / "fault.py", "wrong_coefficients({'contact-strang': 1})")
    finished(bench(tmp_path / "before", few))
    finished(bench(tmp_path / "after", few, "--plugin", str(fault)))
    verdict = accuracy(tmp_path / "before", tmp_path / "after")
    assert {(line.scene, line.method, line.measure) for line in verdict.lines if line.red} == {
        ("particle", "contact-strang", measure)
        for measure in ("solution_error", "pairwise_order", "order", "last_slope")
    }


# -- speed -----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("first", "again", "expected"),
    [
        ((1.0, 0.9, 1.2), None, "pass"),
        ((1.3, 1.2, 1.4), None, "inconclusive"),
        ((1.5, 1.4, 1.6), (1.5, 1.3, 1.7), "slower"),
        ((1.5, 1.4, 1.6), (1.2, 1.1, 1.3), "inconclusive"),
        ((1.5, 1.4, 1.6), None, "inconclusive"),
        ((0.5, 0.4, 0.6), None, "pass"),
    ],
)
def test_slower_takes_two_intervals_above_the_limit(first, again, expected):
    def ratio(values):
        return None if values is None else PairedRatio(*values, 15)

    assert speed.verdict(ratio(first), ratio(again)) == expected


def test_the_workload_is_the_finest_setting_that_is_short(baseline):
    merge(
        WORK_PRECISION,
        [
            row(setting=f"step={h}", carried="M R", time_median_s=time, scene="rigid_body")
            for h, time in ((0.2, 1e-5), (0.1, 2e-3), (0.05, 5e-3))
        ]
        + [row("scipy-radau", "rtol=0.001", carried="q p", time_median_s=5e-3)]
        + [row("limit-c", family="limit", variant="contact-strang", carried="q p", time_median_s=1e-5)]
        + [row("contact-rkn6", "rtol=0.001", variant="chosen", carried="q p", time_median_s=1e-5)],
        baseline,
    )
    cells = speed.workload(read(WORK_PRECISION, baseline))
    assert [(c.scene, c.method, c.setting, c.carry) for c in cells] == [
        ("particle", "rk4", "step=0.1", ()),
        ("particle", "cvode-adams", "rtol=1e-06", ()),
        ("rigid_body", "rk4", "step=0.1", ("R",)),
    ]  # neither the run out of budget nor the long one, no C loop and no chosen step


CELLS = [speed.Cell("particle", "contact-strang", "python", "step", 0.1, ())]


@contextmanager
def patched(file, old, new):
    """A source file with one passage replaced, for as long as the block lasts."""
    original = file.read_text()
    assert original.count(old) == 1
    file.write_text(original.replace(old, new))
    try:
        yield
    finally:
        file.write_text(original)


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """A clone of the project with its sources as they are now, committed."""
    path = tmp_path_factory.mktemp("copy").resolve()
    shutil.copytree(REPOSITORY / "src", path / "src", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("bench", "references"):
        shutil.copytree(REPOSITORY / name, path / name)
    for name in ("pyproject.toml", "constraints.txt"):
        shutil.copy(REPOSITORY / name, path)
    for arguments in (
        ["init", "-q"], ["add", "."],
        ["-c", "user.name=t", "-c", "user.email=t@example.org", "commit", "-q", "-m", "all"],
    ):  # fmt: skip
        subprocess.run(["git", "-C", str(path), *arguments], check=True)
    return path


def test_the_same_code_is_not_slower_and_twice_the_work_is(copy):
    same = speed.compare_revisions(copy, "HEAD", CELLS)
    assert [verdict for *_, verdict in same.judged] in (["pass"], ["inconclusive"])
    assert same.refused == ()
    once = "        x = method.advance(scene, x, h, n, xp)\n"
    with patched(
        copy / "src" / "contactbench" / "methods" / "fixed_step.py", once, once.replace("x =", "_ =") + once
    ):
        slower = speed.compare_revisions(copy, None, CELLS)  # local changes: compared with HEAD
    assert slower.head.endswith("with local changes")
    ((_, ratio, verdict),) = slower.judged
    assert verdict == "slower"
    assert ratio.ratio == pytest.approx(2, rel=0.15)
    assert not subprocess.run(
        ["git", "-C", str(copy), "worktree", "list", "--porcelain"], capture_output=True, text=True
    ).stdout.count("contactbench-base")  # nothing is left behind


HOLDER = """
import sys, time
from pathlib import Path
from contactbench.gate import speed

with speed.checkout(Path(sys.argv[1]), speed.resolved(Path(sys.argv[1]), "HEAD")) as tree:
    print(tree, flush=True)
    time.sleep(60)
"""


def test_the_working_tree_of_a_killed_gate_is_removed_by_the_next_and_a_living_one_is_not(copy):
    command = [sys.executable, "-c", HOLDER, str(copy)]
    holders = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    killed, living = (Path(holder.stdout.readline().strip()) for holder in holders)
    holders[0].kill()
    holders[0].wait()
    assert killed.exists()
    with speed.checkout(copy, speed.resolved(copy, "HEAD")) as tree:
        assert tree.exists()
        assert not killed.parent.exists()
        assert living.exists()
        assert str(killed) not in speed.git(copy, "worktree", "list")
    holders[1].terminate()
    holders[1].wait()
    with speed.checkout(copy, speed.resolved(copy, "HEAD")):
        assert not living.parent.exists()


def test_a_cell_one_side_cannot_run_is_reported_and_a_broken_tree_is_not_compared(copy, tmp_path):
    cells = [*CELLS, speed.Cell("particle", "no-such-method", "jax", "step", 0.1, ())]
    ratios, refused = speed.paired_times([sys.executable] * 2, [copy] * 2, cells, rounds=2, seed=0)
    assert set(ratios) == {0}
    assert "base: UnknownName" in refused[1]
    (tmp_path / "src" / "contactbench").mkdir(parents=True)
    (tmp_path / "src" / "contactbench" / "__init__.py").write_text("raise RuntimeError('broken')")
    with pytest.raises(BadInput, match="timing process ended: RuntimeError: broken"):
        speed.paired_times([sys.executable] * 2, [copy, tmp_path], CELLS, rounds=2, seed=0)


@pytest.fixture
def clocked(monkeypatch, tmp_path):
    """Times two trees by ``clock(tree's name, cell, readings so far)``; also gives who was asked, in order."""

    def compare(clock, cells):
        asked = []

        class Side:
            def __init__(self, _python, tree, _cells, _core, _later):
                self.name = tree.name

            def __enter__(self):
                return self

            def __exit__(self, *_):
                pass

            def refused(self):
                return {}

            def time(self, cell):
                asked.append((self.name, cell))
                return clock(self.name, cell, len(asked))

        monkeypatch.setattr(speed, "Side", Side)
        trees = [tmp_path / "base", tmp_path / "head"]
        return speed.paired_times(["p", "p"], trees, cells, speed.ROUNDS, seed=0)[0], asked

    return compare


def test_turns_are_shuffled_and_paired(clocked):
    """Timed in turns by a clock that drifts: the ratio does not see the drift."""
    factor = {"base": 1.0, "head": 1.5}
    ratios, asked = clocked(
        lambda name, cell, k: factor[name] * 1e-3 * (1 + cell) * np.exp(k / 50), CELLS * 4
    )
    for ratio in ratios.values():
        assert ratio.ratio == pytest.approx(1.5, rel=0.03)
        assert ratio.rounds == speed.ROUNDS
    first = [asked[i][0] for i in range(0, len(asked), 2)]
    assert 20 < first.count("base") < 40  # of 60 pairs either goes first
    assert [cell for _, cell in asked[:8:2]] != [cell for _, cell in asked[8:16:2]]


def test_what_is_undecided_gets_more_rounds(clocked):
    """Of three cells with a noisy clock only the one near the limit."""
    noise = np.random.default_rng(1).normal(size=10_000)
    factor = [1.0, 1.02 * speed.LIMIT, 2.0]
    ratios, _ = clocked(
        lambda name, cell, k: (factor[cell] if name == "head" else 1.0) * np.exp(0.1 * noise[k]), CELLS * 3
    )
    assert [ratios[i].rounds for i in range(3)] == [speed.ROUNDS, speed.MOST_ROUNDS, speed.ROUNDS]


# -- the self-check --------------------------------------------------------------------------------
@pytest.mark.parametrize("composition", COMPOSITIONS, ids=lambda c: c.name)
def test_every_coefficient_of_a_composition_has_a_fault_of_its_own(composition):
    wrong = planted_faults.faulty(composition)
    printed = len(composition.stages) // 2 - 1 if len(composition.stages) > 5 else len(composition.stages)
    assert len(wrong) == printed + max(0, len(composition.processor) - 2)
    assert len({(each.stages, each.processor) for each in [composition, *wrong]}) == len(wrong) + 1
    for each in wrong:  # what is implied follows, and the sums do not give a long composition away
        assert properties.consistent(each) == (len(composition.stages) > 5)


@pytest.fixture
def methods():
    """The registry, whole again after the test."""
    kept = dict(cb.METHODS)
    yield cb.METHODS
    cb.METHODS.clear()
    cb.METHODS.update(kept)


def planted(call, methods):
    """A solution of contact-strang before a fault is planted, and one after it."""

    def solution():
        return cb.solve("particle", "contact-strang", step=0.1, save_at=[20.0])

    before = solution()
    exec(f"planted_faults.{call}", {"planted_faults": planted_faults})
    return before, solution()


def test_faults_planted_by_plug_ins_are_what_they_are_called(methods):
    calls = {fault.what: fault.planted for fault in gate_selfcheck.FAULTS if isinstance(fault.planted, str)}
    assert len(calls) == len(gate_selfcheck.FAULTS) - 1
    whole = dict(methods)
    seen = {}
    for what, call in calls.items():
        seen[what] = (*planted(call, methods), "contact-bm4" in methods)
        methods.update(whole)
    error, drift = cb.LAWS["solution_error"], cb.LAWS["contact_drift"]
    before, after, _ = seen["order 2 replaced by order 1"]
    assert error(after) > 5 * error(before)  # of order h against h²: 6.9 times, measured
    before, after, _ = seen["an extra gradient evaluation per step"]
    assert (before.counts.evaluations, after.counts.evaluations) == (201, 400)
    np.testing.assert_allclose(after.y, before.y, rtol=0, atol=1e-13)
    assert seen["a status change: a scene refused"][1].status is cb.Status.unsupported
    before, after, _ = seen["a drift that is no longer round-off: damping stronger by 1e-9"]
    assert drift(before) < 1e-13
    assert drift(after) == pytest.approx(1e-9 * cb.SCENES["particle"].gamma * 20, rel=1e-3)
    assert [what for what, (*_, there) in seen.items() if not there] == ["dropped rows: a method is gone"]


def test_what_the_self_check_patches_is_still_there_to_be_changed():
    patches = [f.planted for f in gate_selfcheck.FAULTS if isinstance(f.planted, gate_selfcheck.Patch)]
    assert len(patches) == 1
    for patch in patches:
        assert (REPOSITORY / patch.file).read_text().count(patch.old) == 1, patch
        assert patch.new != patch.old


def test_a_slowdown_is_planted_in_one_of_two_trees(copy, tmp_path, monkeypatch):
    call = f"slower(['contact-strang'], 1.5, {str(copy)!r})"
    monkeypatch.setenv(VARIABLE, str(plugin(tmp_path / "slower.py", call)))
    # calls so short that several fill a repeat: on a busy machine a long one is the likelier to be interrupted
    cells = [speed.Cell("particle", "contact-strang", "python", "step", 0.4, ())]
    ((_, ratio, verdict),) = speed.compare_revisions(copy, "HEAD", cells).judged
    assert verdict == "slower"
    assert ratio.ratio == pytest.approx(1.5, rel=0.15)


def test_its_document_counts_alarms_and_faults():
    rows = [
        gate_selfcheck.outcome(
            "accuracy", "nothing", "idle", "none", [(False, ""), (True, "cried wolf")], 1.0
        ),
        gate_selfcheck.outcome("accuracy", "a fault", "idle", "all", [(True, "a|b"), (True, "c")], 2.0),
    ]
    tables = {"gate_selfcheck": pd.DataFrame(rows)}
    text = markdown.parts(room.sections(tables))
    (finding,) = room.findings(tables)
    assert "1 false alarms in 2 judgements of identical code; 2 of 2 planted faults found" in finding.sentence
    assert "1 false alarms in 2 judgements; 2 of 2 planted faults found" in text
    assert "cried wolf" in text
    assert "a\\|b" in text
