"""The gate on a repository: its baseline is what git has at the base, whatever becomes of the tree it judges."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from contactbench.cli import main
from contactbench.errors import BadInput
from contactbench.gate import committed, judge, revisions
from contactbench.gate.fresh import environment
from contactbench.gate.judge import Question
from contactbench.results.store import merge
from contactbench.results.tables import LAWS_TABLE, ONE_STEP, WORK_PRECISION
from made_up import commit, folder, fresh, git, repository, setting

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture
def root(tmp_path, monkeypatch):
    """A checkout of a branch that has left the main one, and is the folder we are in."""
    made = repository(tmp_path / "project")
    git(made, "switch", "-q", "-c", "change")
    monkeypatch.chdir(made)
    return made


def judged(root, tmp_path, change=lambda which, row: row, changed=(), **more):
    run = fresh(root, tmp_path / "fresh", change, **more)
    return judge.gate(Question(root, fresh=run, parts=("accuracy",), changed=changed))


def red(verdict):
    return {line.measure for line in verdict.lines if line.red}


def edit(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def stub(root):
    (root / "results" / "environment.json").write_text(json.dumps({"runs": [{"profile": "smoke"}]}))


def dropped(which, row):
    return None if which is LAWS_TABLE and row["method"] == "rk4" else row


def broken(which, row):
    return {**row, "solution_error": 0.5} if which is LAWS_TABLE else row


def remade(change):
    """The tree's tables made anew, with a change of their rows."""

    def attack(root):
        for path in (root / "results").glob("*.csv"):
            path.unlink()
        folder(root / "results", change)

    return attack


#: what is done to the tree, and to the fresh run beside it; and what must give it away
ATTACKS = {
    "a table removed": (lambda root: LAWS_TABLE.path(root / "results").unlink(), None, "committed table laws"),
    "profiles raised": (
        lambda root: edit(LAWS_TABLE.path(root / "results"), ",smoke\n", ",full\n"), None, "committed profile",
    ),
    "profiles blanked": (
        lambda root: edit(LAWS_TABLE.path(root / "results"), ",smoke\n", ",\n"), None, "committed profile",
    ),
    "the same row dropped on both sides": (remade(dropped), dropped, "committed method in laws"),
    "both sides set to one broken value": (remade(broken), broken, "solution_error"),
    "the record of the runs reduced to a stub": (stub, None, "record of the runs"),
    "the record of the runs removed": (
        lambda root: (root / "results" / "environment.json").unlink(), None, "record of the runs",
    ),
    "a scene renamed": (
        lambda root: edit(LAWS_TABLE.path(root / "results"), "particle,", "particel,"), None, "committed table laws",
    ),
}  # fmt: skip


@pytest.mark.parametrize("how", ["in the tree", "committed"])
@pytest.mark.parametrize("attack", ATTACKS)
@pytest.mark.quick(attack=("profiles raised", "both sides set to one broken value"))
def test_the_baseline_cannot_be_moved_from_the_tree_that_is_judged(attack, how, root, tmp_path):
    harm, change, measure = ATTACKS[attack]
    harm(root)
    if how == "committed":
        commit(root, "harmless")
    assert measure in red(judged(root, tmp_path, change or (lambda which, row: row)))


def test_an_untouched_tree_is_green_and_says_what_it_was_compared_with(root, tmp_path):
    verdict = judged(root, tmp_path)
    assert not verdict.lines
    base = git(root, "rev-parse", "--short=12", "HEAD~1")
    assert f"compared with the tables of {base}" in verdict.as_markdown()
    assert "tables changed" not in verdict.as_markdown()


def test_a_change_of_tables_is_red_unless_it_is_listed_and_then_a_reviewer_sees_it(root, tmp_path):
    """A method is removed, the others' numbers are other ones, and the tables say so."""

    def change(which, row):
        row = broken(which, row)
        return None if row.get("method") == "cvode-adams" else row

    remade(change)(root)
    commit(root, "Without cvode-adams")
    assert {"committed method in laws", "committed solution_error"} <= red(
        judged(root, tmp_path / "a", change)
    )
    git(root, "commit", "-q", "--allow-empty", "-m", "More\n\nTables-changed: laws,\n")
    git(root, "commit", "-q", "--allow-empty", "-m", "And more\n\ntables-changed: work_precision")
    verdict = judged(root, tmp_path / "b", change)
    assert not verdict.red
    (note,) = (note for note in verdict.notes if note.startswith("tables changed in this change: "))
    assert "laws (1 rows gone; method cvode-adams gone; solution_error of particle rk4 1e-05 → 0.5)" in note
    assert "work_precision (1 rows gone; method cvode-adams gone)" in note


def test_what_is_listed_must_be_what_the_code_makes(root, tmp_path):
    remade(dropped)(root)
    commit(root, "Laws\n\nTables-changed: all")
    assert red(judged(root, tmp_path / "a")) == {"rows of laws"}  # the code still makes them
    assert not judged(root, tmp_path / "b", dropped).red
    assert "solution_error" in red(judged(root, tmp_path / "c", broken))


def test_a_table_on_the_command_line_is_listed_too_and_must_be_one(root, tmp_path):
    remade(broken)(root)
    assert judged(root, tmp_path / "a", broken).red
    assert not judged(root, tmp_path / "b", broken, changed=["laws"]).red
    assert committed.listed("", ["laws,claims", "one_step"]) == {"laws", "claims", "one_step"}
    with pytest.raises(BadInput, match="tables changed: lawz: no such table"):
        judged(root, tmp_path / "c", changed=["lawz"])


def test_a_fresh_run_is_of_the_commit_that_is_judged(root, tmp_path):
    assert red(judged(root, tmp_path / "a", commit="f" * 40)) == {"commit of the fresh run"}
    assert red(judged(root, tmp_path / "b", dirty=True)) == {"commit of the fresh run"}
    (root / "src" / "contactbench" / "more.py").write_text("")
    assert not judged(root, tmp_path / "c", dirty=True).red  # as the tree is


def test_a_record_that_lacks_what_makes_runs_comparable_is_red_in_the_fresh_run_too(root, tmp_path):
    assert red(judged(root, tmp_path, packages={})) == {"record of the runs"}


def test_a_table_that_is_made_and_not_committed_is_red(root, tmp_path):
    run = fresh(root, tmp_path / "fresh")
    merge(ONE_STEP, [{"method": "rk4", "gamma": 1.0, "step": 0.1, "radius": 0.9, "profile": "smoke"}], run)
    path = run / "environment.json"
    path.write_text(path.read_text().replace('"laws":', '"one_step": "whole", "laws":'))
    verdict = judge.gate(Question(root, fresh=run, parts=("accuracy",)))
    assert red(verdict) == {"table one_step"}


def test_tables_of_another_version_are_red_unless_listed(root, tmp_path):
    path = LAWS_TABLE.path(root / "results")
    edit(path, ",3,smoke", ",2,smoke")
    commit(root, "old")
    git(root, "branch", "-f", "main")
    remade(lambda which, row: row)(root)
    commit(root, "new")
    assert red(judged(root, tmp_path / "a")) == {"version of laws"}
    assert not judged(root, tmp_path / "b", changed=["laws"]).red


def test_the_base_is_where_the_main_branch_was_left_or_what_is_asked_for(root, tmp_path):
    """A change on the main branch since is none of ours."""
    git(root, "switch", "-q", "main")
    remade(broken)(root)
    commit(root, "main goes on")
    git(root, "switch", "-q", "change")
    assert not judged(root, tmp_path / "a").red
    run = fresh(root, tmp_path / "b")
    assert judge.gate(Question(root, fresh=run, base="main", parts=("accuracy",))).red


def thousandfold(which, row):
    return {**row, "solution_error": 1e3 * row["solution_error"]} if "solution_error" in row else row


WHERE = {
    "on main": [],
    "detached": [["checkout", "-q", "--detach"], ["branch", "-q", "-D", "main"]],
    "its parent replaced": [["replace", "HEAD~1", "HEAD"]],
}


@pytest.mark.parametrize("where", WHERE)
def test_what_is_committed_on_the_main_branch_is_compared_with_its_parent(where, tmp_path):
    root = repository(tmp_path / "project")
    remade(thousandfold)(root)
    commit(root, "harmless")
    for arguments in WHERE[where]:
        git(root, *arguments)
    assert "committed solution_error" in red(judged(root, tmp_path, thousandfold))


@pytest.mark.parametrize("part", ["accuracy", "speed"])
def test_a_clone_without_the_base_is_inconclusive_and_says_what_to_fetch(part, tmp_path, monkeypatch, capsys):
    origin = repository(tmp_path / "project")
    clone = tmp_path / "clone"
    git(origin, "clone", "-q", "--depth", "1", origin.as_uri(), str(clone))
    run = fresh(clone, tmp_path / "fresh")
    monkeypatch.chdir(clone)
    arguments = ("--only", part, *(("--fresh", run) if part == "accuracy" else ()))
    status, text = outcome(capsys, *arguments)
    assert (status, text.count("\n")) == (2, 1)
    assert "inconclusive: HEAD's parent is not in this clone; fetch it (git fetch --unshallow)" in text
    git(clone, "fetch", "-q", "--unshallow")
    assert "not in this clone" not in outcome(capsys, *arguments)[1]


def test_a_clone_too_shallow_for_where_main_was_left_is_inconclusive(tmp_path):
    origin = repository(tmp_path / "project")
    git(origin, "switch", "-q", "-c", "change")
    commit(origin, "one")
    commit(origin, "two")
    clone = tmp_path / "clone"
    git(origin, "clone", "-q", "--depth", "2", "--no-single-branch", origin.as_uri(), str(clone))
    git(clone, "remote", "set-head", "origin", "main")
    with pytest.raises(BadInput, match="inconclusive: the commit at which HEAD left origin/HEAD"):
        revisions.base(clone, None)


# -- the rules -------------------------------------------------------------------------------------
#: what is made laxer in the tree that is judged, and the line that says so
LAXER = {
    "gate/rules.py": ("DECADES = 0.3", "DECADES = 9.0", "rule gate.rules.DECADES"),
    "results/columns.py": (
        '/ max ‖y*‖", Rule.error)',
        '/ max ‖y*‖", ungated="")',
        "rule convergence.solution_error",
    ),
    "results/round_off.py": ("eps * np.max", "eps * 1e9 * np.max", "code of results.round_off"),
    "gate/verdict.py": ("return 1 if self.red else 2", "return 0 if self.red else 2", ""),
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A repository with the sources of this one, and made-up tables."""
    made = tmp_path_factory.mktemp("whole").resolve()
    shutil.copytree(REPOSITORY / "src", made / "src", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "constraints.txt"):
        shutil.copy(REPOSITORY / name, made)
    git(made, "init", "-q", "-b", "main")
    folder(made / "results")
    return commit(made, "tables")


@pytest.mark.parametrize("file", LAXER)
@pytest.mark.quick(file="results/round_off.py")
def test_a_rule_made_laxer_in_the_tree_that_is_judged_turns_nothing_green(file, whole, tmp_path):
    root = tmp_path / "project"
    git(whole, "clone", "-q", str(whole), str(root))
    old, new, line = LAXER[file]
    edit(root / "src" / "contactbench" / file, old, new)
    remade(thousandfold)(root)
    commit(root, "harmless")
    command = [sys.executable, "-P", "-m", "contactbench.cli", "gate", "--only", "accuracy", "--json"]
    run = fresh(root, tmp_path / "fresh", thousandfold)
    done = subprocess.run(
        [*command, "--fresh", run], cwd=root, env=environment(root), capture_output=True, text=True
    )
    assert done.returncode == 1, done.stderr
    found = json.loads(done.stdout)["lines"]
    assert {"committed solution_error", "solution_error"} <= {
        each["measure"] for each in found if each["red"]
    }
    assert [each["verdict"] for each in found if each["measure"] == line] == [
        "rule changed, the base's judges"
    ] * bool(line)


def test_a_base_too_old_to_judge_leaves_a_changed_rule_open(whole, tmp_path, monkeypatch):
    root = tmp_path / "project"
    git(whole, "clone", "-q", str(whole), str(root))
    file = root / "src" / "contactbench" / "gate" / "revisions.py"
    edit(file, revisions.JUDGED, "NOT_YET")
    commit(root, "old")
    monkeypatch.chdir(root)
    run = fresh(root, tmp_path / "fresh")
    arguments = ["gate", "--only", "accuracy", "--base", "HEAD", "--fresh", str(run)]
    assert main(arguments) == 0
    edit(root / "src" / "contactbench" / "gate" / "rules.py", "DECADES = 0.3", "DECADES = 9.0")
    assert main(arguments) == 2


# -- the command line ------------------------------------------------------------------------------
def outcome(capsys, *arguments):
    status = main(["gate", *map(str, arguments)])
    captured = capsys.readouterr()
    return status, captured.out + captured.err


def test_exit_status_and_json(root, tmp_path, capsys):
    good = fresh(root, tmp_path / "good")
    bad = fresh(root, tmp_path / "bad", setting(LAWS_TABLE, "rk4", solution_error=2.2e-5))
    assert outcome(capsys, "--only", "accuracy", "--fresh", good)[0] == 0
    status, text = outcome(capsys, "--only", "accuracy", "--fresh", bad, "--json")
    assert status == 1
    (line,) = json.loads(text)["lines"]
    assert (line["scene"], line["method"], line["measure"]) == ("particle", "rk4", "solution_error")
    assert line["change"] == "×2.2"


def damaged(name, old, new):
    def spoil(results):
        edit(results / name, old, new)

    return spoil


#: what is done to a folder, and the one line that comes of it
DAMAGE = {
    "no environment": (lambda r: (r / "environment.json").unlink(), "environment.json: missing; the folder holds no"),
    "odd environment": (lambda r: (r / "environment.json").write_text("[1]"), "no list of runs"),
    "broken environment": (
        lambda r: (r / "environment.json").write_text('{"runs": [\n{"profile": smoke}]}'),
        "Expecting value: line 2 column 13",
    ),
    "a record with other types": (
        damaged("environment.json", '"packages": {"jax": "1"}', '"packages": "jax"'), "run 1: 'packages'",
    ),
    "foreign table": (lambda r: LAWS_TABLE.path(r).write_text("a,b\n1,2\n"), "columns are not those of table 'laws'"),
    "a word among numbers": (
        damaged("laws.csv", "1e-05", "small"), "laws.csv, line 2, column 'solution_error': 'small' is no finite number",
    ),
    "infinity": (
        damaged("laws.csv", "1e-05", "inf"), "laws.csv, line 2, column 'solution_error': 'inf' is no finite number",
    ),
    "half a step": (
        damaged("work_precision.csv", ",200,", ",25.5,"), "line 2, column 'steps': '25.5' is no whole number",
    ),
    "neither true nor false": (
        damaged("convergence.csv", "True", "perhaps"), "line 2, column 'in_fit': 'perhaps' is no True or False",
    ),
    "the same row twice": (
        lambda r: LAWS_TABLE.path(r).write_text(
            LAWS_TABLE.path(r).read_text() + LAWS_TABLE.path(r).read_text().splitlines()[1] + "\n"
        ),
        "laws.csv, line 4: the key",
    ),
    "a line cut short": (
        lambda r: LAWS_TABLE.path(r).write_text(LAWS_TABLE.path(r).read_text().rsplit(",", 5)[0]),
        "laws.csv, line 3: cut short",
    ),
}  # fmt: skip


#: every reader with every damage; of tables without a record only a fresh run is refused, those of the tree are red
READ = [
    (command, damage)
    for command in ("gate the fresh run", "gate the tree", "report")
    for damage in DAMAGE
    if command == "gate the fresh run" or damage != "no environment"
]


@pytest.mark.parametrize(("command", "damage"), READ)
@pytest.mark.quick(command="gate the fresh run")
def test_damage_is_told_with_file_line_and_column_in_one_line(command, damage, root, tmp_path, capsys):
    spoil, message = DAMAGE[damage]
    run = fresh(root, tmp_path / "fresh")
    spoil(run if command == "gate the fresh run" else root / "results")
    arguments = ["gate", "--only", "accuracy", "--fresh", run] if "gate" in command else ["report"]
    status = main([*map(str, arguments)])
    captured = capsys.readouterr()
    text = captured.out + captured.err
    assert (status, text.count("\n")) == (2, 1), text
    assert message in text
    assert len(text) < 400


def test_without_benchmark_git_or_revision_it_could_not_run(root, tmp_path, capsys, monkeypatch):
    def refused(*arguments):
        status, text = outcome(capsys, *arguments)
        assert (status, text.count("\n")) == (2, 1)
        return text

    assert "no benchmark there" in refused("--only", "accuracy")
    assert "--base no-such: no such revision" in refused("--only", "speed", "--base", "no-such")
    assert "no tables in elsewhere/" in refused("--only", "accuracy", "--results", "elsewhere")
    monkeypatch.chdir(tmp_path)
    assert "not a git repository" in refused("--only", "speed")
    monkeypatch.chdir(root)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "git: not installed" in refused("--only", "speed")


def test_words_in_a_verdict_stay_in_their_cell(root, tmp_path):
    odd = "a|b\n<script>x</script>"
    run = fresh(root, tmp_path / "fresh", setting(WORK_PRECISION, "rk4", carried=odd))
    text = judge.gate(Question(root, fresh=run, parts=("accuracy",))).as_markdown()
    (line,) = (line for line in text.splitlines() if "carried" in line)
    assert "a\\|b &lt;script>" in line
    assert len(re.findall(r"(?<!\\)\|", line)) == 10


def test_two_folders_are_compared_outside_a_repository(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    before, after = folder(tmp_path / "a"), folder(tmp_path / "b", broken)
    assert outcome(capsys, "--baseline", before, "--fresh", before)[0] == 0
    assert outcome(capsys, "--baseline", before, "--fresh", after)[0] == 1
    status, text = outcome(capsys, "--baseline", before)
    assert (status, text.count("\n")) == (2, 1)
    assert "give --fresh DIR too" in text
