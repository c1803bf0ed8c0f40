"""The gate on a repository: its baseline is what git has at the base, whatever becomes of the tree it judges."""

import itertools
import json
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

import made_up
from contactbench.cli import main
from contactbench.errors import BadInput
from contactbench.gate import revisions, trees
from contactbench.study import ending
from contactbench.tables import provenance
from contactbench.tables.schema import TABLES
from contactbench.tables.store import merge
from made_up import ROWS, commit, folder, fresh, git, project, repository, same, without


@pytest.fixture(autouse=True)
def few_tables(only_tables):
    only_tables(*ROWS, "strong_damping")


@pytest.fixture
def root(tmp_path, monkeypatch):
    """A checkout of a branch that has left the main one, and is the folder we are in; we are the gate of its base."""
    made = repository(tmp_path / "project")
    git(made, "switch", "-q", "-c", "change")
    monkeypatch.chdir(made)
    monkeypatch.setenv(revisions.JUDGED, sys.executable)
    return made


@pytest.fixture
def judge(root, tmp_path):
    """Judge the tree by a fresh run of it whose rows are changed."""
    runs = itertools.count()

    def judge(change=same, changed=(), base=None, **more):
        run = fresh(root, tmp_path / f"fresh{next(runs)}", change, **more)
        return trees.gate(root, fresh=run, base=base, parts=("accuracy",), changed=changed)

    return judge


def red(found):
    """What is red: the measure, of which two."""
    moved = found.moved[found.moved["red"].astype(bool)]
    return set((moved["between"] + ": " + moved["measure"]).str.removeprefix(": "))


def edit(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def edited(name, old, new):
    return lambda root: edit(root / "results" / name, old, new)


without_rk4 = without(table="laws", method="rk4")


def broken(which, row):
    return {**row, "solution_error": 0.5} if which == "laws" else row


def times(factor):
    """A change of every error by a factor."""

    def change(which, row):
        return {**row, "solution_error": factor * row["solution_error"]} if "solution_error" in row else row

    return change


thousandfold = times(1e3)


def remake(change):
    """The tree's tables made anew, with a change of their rows."""

    def attack(root):
        for path in (root / "results").glob("*.csv"):
            path.unlink()
        folder(root / "results", change)

    return attack


def write(root, path, text=""):
    (root / path).parent.mkdir(exist_ok=True)
    (root / path).write_text(text)


def append(name, **values):
    """A row more in a table of the tree."""
    row = {**ROWS[name][0], "value": 0.123, "setting": "step=0.123", **values}
    return lambda root: merge(TABLES[name], [row], root / "results")


RECORD, STUB = "results/environment.json", json.dumps({"runs": [{"profile": "smoke"}]})
ROW = append("work_precision", solution_error=1e-14, evaluations=10)
#: one that no run makes
LARGE = append("work_precision", profile="full", solution_error=1e-14)
#: what is done to the tree, and to the fresh run beside it; and what must give it away
ATTACKS = {
    "a table removed": (lambda root: (root / "results/laws.csv").unlink(), same, "base → tree: table"),
    "profiles raised": (edited("laws.csv", ",smoke\n", ",full\n"), same, "base → tree: profile"),
    "profiles blanked": (edited("laws.csv", ",smoke\n", ",\n"), same, "base → tree: profile"),
    "the same row dropped on both sides": (remake(without_rk4), without_rk4, "base → tree: row"),
    "both sides set to one broken value": (remake(broken), broken, "base → fresh: solution_error"),
    "the record of the runs a stub": (partial(write, path=RECORD, text=STUB), same, "record of the runs"),
    "the record of the runs removed": (lambda root: (root / RECORD).unlink(), same, "record of the runs"),
    "a row invented": (ROW, same, "tree → fresh: row"),
    "one that no run makes": (LARGE, same, "base → tree: row"),
    "a scene renamed": (edited("laws.csv", "particle,", "particel,"), same, "base → tree: row"),
}


@pytest.mark.parametrize("how", ["in the tree", "committed"])
@pytest.mark.parametrize("attack", ATTACKS)
def test_the_baseline_cannot_be_moved_from_the_tree_that_is_judged(attack, how, root, judge):
    harm, change, measure = ATTACKS[attack]
    harm(root)
    if how == "committed":
        commit(root, "harmless")
    assert measure in red(judge(change))


def test_an_untouched_tree_is_green(judge):
    assert judge().moved.empty


def test_a_change_of_tables_is_red_unless_it_is_listed_and_then_a_reviewer_sees_it(root, judge):
    """A method is removed, the others' numbers are other ones, and the tables say so."""

    gone = without(method="cvode-adams")
    change = lambda which, row: gone(which, row) and broken(which, row)  # noqa: E731
    remake(change)(root)
    commit(root, "Without cvode-adams")
    assert {"base → tree: row", "base → tree: solution_error"} <= red(judge(change))
    commit(root, "More\n\nTables-changed: laws,\n")
    commit(root, "And more\n\ntables-changed: work_precision")
    found = judge(change)
    assert found.status == 0
    listed = found.moved[["between", "table", "method", "measure", "result"]].to_numpy().tolist()
    assert sorted(listed) == [
        ["base → tree", "laws", "cvode-adams", "row", "missing, listed"],
        ["base → tree", "laws", "rk4", "solution_error", "moved, listed"],
        ["base → tree", "work_precision", "cvode-adams", "row", "missing, listed"],
    ]


def test_what_is_listed_must_be_what_the_code_makes(root, judge):
    remake(without_rk4)(root)
    commit(root, "Laws\n\nTables-changed: all")
    assert red(judge()) == {"rows"}  # the code still makes them
    assert not judge(without_rk4).red
    assert "base → fresh: solution_error" in red(judge(broken))


#: what is named as removed, and the tables after it went
REMOVED = """
tables = ["claims"]
methods = ["cvode-adams"]
columns = ["laws.saved_*"]
engines = {jax = "llvm"}
engine_of = {mpmath = "rk*"}
"""


def after_removal(which, row):
    if which == "claims" or row["method"] == "cvode-adams" or row["engine"] == "mpmath":
        return None
    return {name: value for name, value in row.items() if name != "saved_times"} | {"engine": "llvm"}


def changed_too(change):
    return lambda which, row: (row := after_removal(which, row)) and change(which, row)


def both(*measures):
    """What is red beside the base: in the tree and in the fresh run."""
    return {f"base → {side}: {measure}" for side in ("tree", "fresh") for measure in measures}


@pytest.mark.parametrize(
    ("named", "change", "expected"),
    [
        (REMOVED, same, set()),
        ("", same, both("table", "row")),
        (REMOVED.replace("jax", "none"), same, both("row")),
        (REMOVED.replace("saved", "else"), same, both("saved_times")),
        (REMOVED, without_rk4, both("table")),  # a row that is of nothing named
        (REMOVED, broken, both("solution_error")),
        (REMOVED.replace("cvode", 'contact-o8", "cvode'), same, set()),  # what the base does not have
        (REMOVED.replace("laws.saved_*", "laws.s*"), same, {"removed.toml"}),  # still there
    ],
)
def test_what_went_on_purpose_is_named_once_and_all_else_is_compared(named, change, expected, root, judge):
    remake(changed_too(change))(root)
    write(root, "results/removed.toml", named)
    assert red(judge(changed_too(change))) == expected


def test_a_table_on_the_command_line_is_listed_too_and_must_be_one(root, judge):
    remake(broken)(root)
    assert judge(broken).red
    assert not judge(broken, changed=["laws,claims"]).red
    with pytest.raises(BadInput, match="tables changed: lawz: no such table"):
        judge(changed=["lawz"])


def test_a_fresh_run_is_of_the_commit_that_is_judged(root, judge):
    """Files that decide no number, such as a note, make no other tree."""
    assert red(judge(commit="f" * 40)) == {"commit of the fresh run"}
    write(root, "note")
    assert red(judge(dirty=True)) == {"commit of the fresh run"}
    write(root, "src/contactbench/more.py")
    assert not judge(dirty=True).red  # as the tree is


def test_a_table_that_is_made_and_not_committed_is_red(root, tmp_path):
    run = fresh(root, tmp_path / "fresh", tables={"strong_damping": "whole", **dict.fromkeys(TABLES, "part")})
    damped = {"method": "rk4", "gamma": 1.0, "damping_per_evaluation": 0.1, "error": 0.9, "profile": "smoke"}
    merge(TABLES["strong_damping"], [damped], run)
    moved = trees.gate(root, fresh=run, parts=("accuracy",)).moved
    assert moved[["table", "measure", "result"]].values.tolist() == [
        ["strong_damping", "table", "not committed"]
    ]


def test_tables_of_another_version_are_red_unless_listed(root, judge):
    edit(root / "results/laws.csv", ",3,smoke", ",2,smoke")
    commit(root, "old")
    git(root, "branch", "-f", "main")
    remake(same)(root)
    commit(root, "new")
    assert red(judge()) == {"version of laws"}
    assert not judge(changed=["laws"]).red


def test_a_row_that_no_run_makes_is_named_even_where_it_is_listed(root, judge):
    LARGE(root)
    found = judge(changed=["work_precision"])
    assert found.status == 0
    assert found.moved[["between", "setting", "result"]].to_numpy().tolist() == [
        ["base → tree", "step=0.123", "new, made by no fresh run, listed"]
    ]


def test_times_are_held_to_a_fresh_run_by_their_ratios(root, tmp_path):
    """Made three times as fast by another machine; one method's times by hand ten times as fast."""

    def timed(path, **factors):
        rows = [
            made_up.row(name, f"step={2.0**-k}", time_min_s=factors.get(name, 1) * 2.0**k / 1e6)
            for name in ("rk4", "contact-rkn6", "contact-rkn4")
            for k in range(3)
        ]
        merge(TABLES["work_precision"], rows, path)

    git(root, "switch", "-q", "main")
    timed(root / "results")
    commit(root, "times")
    git(root, "switch", "-q", "-C", "change")
    run = fresh(root, tmp_path / "fresh")
    timed(run, **dict.fromkeys(("rk4", "contact-rkn6", "contact-rkn4"), 1 / 3))

    def judged(*changed):
        commit(root, "harmless")
        record = {**made_up.RUN, "commit": git(root, "rev-parse", "HEAD")}
        write(run, "environment.json", json.dumps({"runs": [record]}))
        return trees.gate(root, fresh=run, parts=("accuracy",), changed=changed)

    assert not judged().moved["measure"].isin(["time_min_s"]).any()
    timed(root / "results", rk4=0.1)
    assert {"base → tree: time_min_s", "tree → fresh: time_min_s"} <= red(judged())
    found = judged("work_precision")
    assert "tree → fresh: time_min_s" in red(found)
    assert {*found.moved["method"][found.moved["measure"] == "time_min_s"]} == {"rk4"}
    elsewhere = provenance.runs(root / "results")[0] | {"isa": "another"}
    write(root, RECORD, json.dumps({"runs": [elsewhere]}))
    assert "tree → fresh: time_min_s" not in red(judged("work_precision"))  # times of two machines


def test_errors_are_held_to_older_revisions_of_the_tables(root, judge):
    """Twice a factor that is allowed once, by two commits; not where the first of them was listed."""
    for power, message, expected in ((1, "harmless", set()), (2, "harmless too", {"tree", "fresh"})):
        remake(times(1.95**power))(root)
        commit(root, message)
        found = red(judge(times(1.95**power), base="HEAD~1"))
        assert {one.partition(" → ")[2] for one in found} == {f"{side}: solution_error" for side in expected}
    git(root, "reset", "-q", "--soft", "HEAD~2")
    commit(root, "More\n\nTables-changed: laws, convergence, work_precision")
    remake(times(1.95**3))(root)
    commit(root, "harmless")
    assert not judge(times(1.95**3), base="HEAD~1").red


@pytest.mark.parametrize(
    ("left", "messages", "expected"),
    [
        ({"test_a.py": "abc"}, "", []),
        ({"new/test_b.py": "cab"}, "", []),  # moved
        ({"test_a.py": "ab"}, "", [False]),  # a few are gone
        ({"test_a.py": "a"}, "", [True]),
        ({}, "", [True]),
        ({}, "Without\n\nTests-removed: tests/test_a.py", [False]),
        ({}, "Without\n\nTests-removed: tests", [False]),
        ({}, "Without\n\nTests-removed: tests/gate", [True]),
    ],
)
def test_deleted_tests_are_red_unless_listed(left, messages, expected, tmp_path):
    def write_tests(tree, files):
        for name, letters in files.items():
            path = tree / "tests" / name
            path.parent.mkdir(parents=True)
            path.write_text("".join(f"def test_{each}(): ...\n" for each in letters))
        return tree

    base, tree = write_tests(tmp_path / "base", {"test_a.py": "abc"}), write_tests(tmp_path / "tree", left)
    assert [row["red"] for row in trees.check_tests(base, tree, messages)] == expected


# -- the base --------------------------------------------------------------------------------------
def test_the_base_is_where_the_main_branch_was_left_or_what_is_asked_for(root, judge):
    """A change on the main branch since is none of ours."""
    git(root, "switch", "-q", "main")
    remake(broken)(root)
    commit(root, "main goes on")
    git(root, "switch", "-q", "change")
    assert not judge().red
    assert judge(base="main").red


def test_the_pinned_revision_is_that_of_the_base(root):
    assert revisions.pinned(root, "HEAD") == ""
    (root / ".gate-base").write_text("abc  # first\n")
    assert revisions.pinned(root, "HEAD") == "abc"  # no other yet
    commit(root, "pin")
    (root / ".gate-base").write_text("def\n")
    assert revisions.pinned(commit(root, "move it"), "HEAD~1") == "abc"


WHERE = {
    "on main": [],
    "detached": [["checkout", "-q", "--detach"], ["branch", "-q", "-D", "main", "change"]],
    "its parent replaced": [["replace", "HEAD~1", "HEAD"]],
}


@pytest.mark.parametrize("where", WHERE)
def test_a_commit_on_the_main_branch_is_compared_with_its_parent(where, root, judge):
    git(root, "switch", "-q", "main")
    remake(thousandfold)(root)
    commit(root, "harmless")
    for arguments in WHERE[where]:
        git(root, *arguments)
    assert "base → tree: solution_error" in red(judge(thousandfold))


def test_a_clone_without_the_base_is_inconclusive(tmp_path):
    origin = repository(tmp_path / "project")
    clone, deeper = tmp_path / "clone", tmp_path / "deeper"
    git(origin, "clone", "-q", "--depth", "1", origin.as_uri(), str(clone))
    with pytest.raises(BadInput, match=r"inconclusive: HEAD's parent is not in this clone; .* --unshallow"):
        revisions.base(clone, None)
    git(clone, "fetch", "-q", "--unshallow")
    assert revisions.base(clone, None) == git(origin, "rev-parse", "HEAD~1")
    git(origin, "switch", "-q", "-c", "change")
    commit(commit(origin, "one"), "two")
    git(origin, "clone", "-q", "--depth", "2", "--no-single-branch", origin.as_uri(), str(deeper))
    git(deeper, "remote", "set-head", "origin", "main")
    with pytest.raises(BadInput, match="inconclusive: the commit at which HEAD left origin/HEAD"):
        revisions.base(deeper, None)


#: a rule, a floor and the judge itself made laxer in the tree that is judged
LAXER = {
    "tables/schema.py": ("eps * np.max", "eps * 1e9 * np.max"),
    "gate/compare.py": ("FACTOR = 2.0", "FACTOR = 1e9"),
    "gate/trees.py": ("def row(", "def gate(*_, **__):\n    return Findings()\n\n\ndef row("),
}


def test_rules_made_laxer_in_the_tree_that_is_judged_turn_nothing_green(tmp_path):
    root, run = project(tmp_path.resolve() / "project"), tmp_path / "fresh"
    for file, change in LAXER.items():
        edit(root / "src" / "contactbench" / file, *change)
    remake(thousandfold)(root)
    commit(root, "harmless")
    line = ["contactbench", "gate", "--only", "accuracy", "--json", "--fresh"]
    command = [sys.executable, "-P", "-m", *line, fresh(root, run, thousandfold)]
    given = {"cwd": root, "env": revisions.environment(root), "capture_output": True, "text": True}
    done = subprocess.run(command, **given)
    assert (done.returncode, bool(done.stdout)) == (1, True), done.stderr
    lines = [line for line in json.loads(done.stdout)["lines"] if line["red"]]
    found = {line["between"] for line in lines if line["measure"] == "solution_error"}
    assert {"base → tree", "base → fresh"} <= found


# -- where a project lies ---------------------------------------------------------------------------
#: the folder of a project in its repository, where its tables are from there, and .gitattributes
PLACES = {
    "a subfolder": ("deep/er", "results", ""),
    "tables that are not exported": ("", "results", "results export-ignore\n"),
    "a subfolder that is not exported": ("deep", "results", "* export-ignore\n"),
    "any letters": ('a b/Größe *[x]\\"é\n', ":(top) rés*", ""),
    "tables beside it": ("deep", "../tables", ""),
    "tables at the top": ("deep", "..", ""),
}


@pytest.mark.quick(worktree=False, place=("a subfolder", "tables that are not exported"))
@pytest.mark.quick(worktree=True, place="any letters")
@pytest.mark.parametrize("worktree", [False, True], ids=["clone", "worktree"])
@pytest.mark.parametrize("place", PLACES)
def test_a_project_lies_anywhere_in_its_repository(place, worktree, tmp_path, monkeypatch):
    folder, results, attributes = PLACES[place]
    top = tmp_path / "repository"
    tables = top / folder / results
    (top / folder).mkdir(parents=True)
    git(top, "init", "-q", "-b", "main")
    (top / folder / ".gitattributes").write_text(attributes)
    made_up.folder(tables)
    commit(commit(top, "tables"), "nothing more")
    if worktree:
        git(top, "worktree", "add", "-q", "--detach", str(tmp_path / "wörk tree"))
        top = tmp_path / "wörk tree"
        tables = top / folder / results
    monkeypatch.setattr(trees, "brought", lambda: {"a method"})
    monkeypatch.chdir(top / folder)

    def judged(change):
        run = made_up.fresh(top, tmp_path / change.__name__, change)
        return red(trees.gate(Path.cwd(), Path(results), fresh=run, parts=("accuracy",)))

    assert judged(same) == set()
    assert "base → fresh: solution_error" in judged(broken)
    assert "clocks aside: nothing moved." in "\n".join(ending.moved(tables))


def test_tables_of_another_repository_are_refused(root, tmp_path):
    with pytest.raises(BadInput, match="must be in the repository"):
        trees.gate(root, tmp_path / "elsewhere", parts=("accuracy",))


def test_contactbench_itself_may_lie_in_a_subfolder(tmp_path, monkeypatch):
    inner = tmp_path / "mono" / "inner"
    (inner / "src" / "contactbench").mkdir(parents=True)
    (inner / "results").mkdir()
    git(tmp_path / "mono", "init", "-q")
    assert revisions.project(inner / "results") == inner
    assert revisions.project(tmp_path / "mono") == tmp_path / "mono"


# -- the command line ------------------------------------------------------------------------------
def outcome(capsys, *arguments):
    status = main([*map(str, arguments)])
    captured = capsys.readouterr()
    return status, captured.out + captured.err


#: what is done to a file of a folder, and where the message says that it is damaged
DAMAGE = {
    "odd record": ("environment.json", lambda text: "[1]", "no list of runs"),
    "foreign table": ("laws.csv", lambda text: "a,b\n1,2\n", "columns are not those of table 'laws'"),
    "cut short": ("laws.csv", lambda text: text.rsplit(",", 5)[0], "line 3: cut short"),
}


@pytest.mark.parametrize(("name", "spoil", "message"), DAMAGE.values(), ids=DAMAGE)
def test_damage_is_one_line_with_file_line_and_column(name, spoil, message, root, tmp_path, capsys):
    run = fresh(root, tmp_path / "fresh")
    assert outcome(capsys, "gate", "--only", "accuracy", "--fresh", run)[0] == 0
    (run / name).write_text(spoil((run / name).read_text()))
    status, text = outcome(capsys, "gate", "--only", "accuracy", "--fresh", run)
    assert (status, text.count("\n"), name in text, message in text) == (2, 1, True, True), text


def test_without_tables_git_or_revision_it_could_not_run(root, capsys, monkeypatch):
    calls = {
        "--base no-such: no such revision": ("--only", "speed", "--base", "no-such"),
        "no tables in elsewhere/": ("--only", "accuracy", "--results", "elsewhere"),
        "give --fresh DIR too": ("--baseline", root / "results"),
    }
    for message, arguments in calls.items():
        status, text = outcome(capsys, "gate", *arguments)
        assert (status, message in text) == (2, True), text
    monkeypatch.delenv(revisions.JUDGED)
    status, text = outcome(capsys, "gate", "--only", "accuracy")
    assert (status, "has no gate that could judge" in text) == (2, True)


def test_two_folders_are_compared_outside_a_repository(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    before, after = folder(tmp_path / "a"), folder(tmp_path / "b", broken)
    assert outcome(capsys, "gate", "--baseline", before, "--fresh", before)[0] == 0
    status, text = outcome(capsys, "gate", "--baseline", before, "--fresh", after, "--json")
    assert status == 1
    found = {(line["scene"], line["method"], line["measure"]) for line in json.loads(text)["lines"]}
    assert ("particle", "rk4", "solution_error") in found
