"""The gate on a repository: its baseline is what git has at the base, whatever becomes of the tree it judges."""

import itertools
import json
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

import made_up
from contactbench.cli import main
from contactbench.errors import BadInput
from contactbench.gate import revisions, trees
from contactbench.gate.compare import compare_folders
from contactbench.tables.schema import TABLES
from contactbench.tables.store import merge
from made_up import ROWS, commit, folder, fresh, git, project, repository, same, without

#: the tables of most tests
FEW = {name: ROWS[name] for name in ("runs", "orders")}


@pytest.fixture(autouse=True)
def few_tables(only_tables, monkeypatch):
    only_tables(*FEW)
    monkeypatch.setattr(made_up, "ROWS", FEW)


@pytest.fixture(scope="session")
def committed(tmp_path_factory):
    """A checkout of a branch that has left the main one, which tests copy."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(made_up, "ROWS", FEW)
        made = repository(tmp_path_factory.mktemp("gate") / "project")
    git(made, "switch", "-q", "-c", "change")
    return made


@pytest.fixture
def root(committed, tmp_path, monkeypatch):
    """It is the folder we are in; we are the gate of its base."""
    made = shutil.copytree(committed, tmp_path / "project")
    monkeypatch.chdir(made)
    monkeypatch.setenv(revisions.JUDGED, "1")
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


without_rk4 = without(table="orders", method="rk4")


def broken(which, row):
    return {**row, "error": 0.5} if which == "orders" else row


def remake(change):
    """The tree's tables made anew, with a change of their rows."""

    def attack(root):
        for path in (root / "results").glob("*.csv"):
            path.unlink()
        folder(root / "results", change)

    return attack


def write(root, path, text=""):
    (root / path).parent.mkdir(parents=True, exist_ok=True)
    (root / path).write_text(text)


def append(**values):
    """A run more in the table of the tree."""
    return lambda root: merge(TABLES["runs"], [made_up.row("own", "step=0.123", **values)], root / "results")


RECORD, STUB = "results/environment.json", json.dumps({"runs": [{"profile": "smoke"}]})
#: one that no smoke run makes
LARGE = append(profile="full", error=1e-14)
#: what is done to the tree, and to the fresh run beside it; and what must give it away
ATTACKS = {
    "a table removed": (lambda root: (root / "results/orders.csv").unlink(), same, "base → tree: table"),
    "profiles raised": (edited("runs.csv", ",smoke,", ",full,"), same, "base → tree: profile"),
    "the same row dropped on both sides": (remake(without_rk4), without_rk4, "base → tree: row"),
    "both sides set to one broken value": (remake(broken), broken, "base → tree: error"),
    "the record of the runs a stub": (partial(write, path=RECORD, text=STUB), same, "record of the runs"),
    "a row invented": (append(error=1e-14, evaluations=10.0), same, "tree → fresh: row"),
    "a column lost": (
        edited("orders.csv", "order_nominal", "nominal_order"),
        same,
        "base → tree: order_nominal",
    ),
}


@pytest.mark.quick(how="committed")
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


def test_a_change_of_tables_is_red_unless_it_is_listed_and_then_a_reviewer_sees_it(root, judge, only_tables):
    """A method is removed, the others' numbers are other ones, and the tables say so."""
    only_tables(*FEW, "times")
    gone = without(method="cvode-adams")
    change = lambda which, row: gone(which, row) and broken(which, row)  # noqa: E731
    remake(change)(root)
    commit(root, "Without cvode-adams")
    assert {"base → tree: row", "base → tree: error"} <= red(judge(change))
    commit(root, "More\n\nTables-changed: runs, times,\n")
    commit(root, "And more\n\ntables-changed: orders")
    found = judge(change)
    assert found.status == 0
    listed = found.moved[["between", "table", "method", "measure", "result"]].to_numpy().tolist()
    assert sorted(listed) == [
        ["base → tree", "orders", "contact-o8", "error", "moved, listed"],
        ["base → tree", "orders", "rk4", "error", "moved, listed"],
        ["base → tree", "runs", "cvode-adams", "row", "missing, listed"],
    ]
    with pytest.raises(BadInput, match="tables changed: lawz: no such table"):
        judge(changed=["runs,lawz"])


def test_what_is_listed_must_be_what_the_code_makes(root, judge):
    remake(without_rk4)(root)
    commit(root, "Orders\n\nTables-changed: all")
    assert red(judge()) == {"rows"}  # the code still makes them
    assert not judge(without_rk4).red
    assert "tree → fresh: error" in red(judge(broken))


def test_a_base_of_another_layout_is_neither_red_nor_compared(root, judge):
    """And what the tree has is still held to what its code makes."""
    table = root / "results" / "orders.csv"
    now = table.read_text()
    edit(table, "step,", "steps,")
    git(commit(root, "old"), "branch", "-f", "main")
    table.write_text(now)
    commit(root, "new")
    assert judge().moved.empty
    assert red(judge(broken)) == {"tree → fresh: error"}


def test_a_fresh_run_is_of_the_commit_that_is_judged(root, judge):
    """Files that decide no number, such as a note, make no other tree."""
    assert red(judge(commit="f" * 40)) == {"commit of the fresh run"}
    write(root, "note")
    assert red(judge(dirty=True)) == {"commit of the fresh run"}
    write(root, "src/contactbench/more.py")
    assert not judge(dirty=True).red  # as the tree is


def test_a_table_that_is_made_and_not_committed_is_red(root, tmp_path, only_tables):
    only_tables(*FEW, "ring")
    run = fresh(root, tmp_path / "fresh", tables={"ring": "whole", **dict.fromkeys(TABLES, "part")})
    merge(TABLES["ring"], [{"scene": "chain", "method": "rk4", "setting": 0.1, "energy_left": 0.9}], run)
    moved = trees.gate(root, fresh=run, parts=("accuracy",)).moved
    assert moved[["table", "measure", "result"]].values.tolist() == [
        ["ring", "rows", "made, but not committed"]
    ]


def test_a_table_of_another_layout_is_red_unless_listed(root, judge):
    edit(root / "results/orders.csv", "step,", "steps,")
    assert "layout" in red(judge())
    assert "layout" not in red(judge(changed=["orders"]))


def test_a_row_that_no_run_makes_is_named_even_where_it_is_listed(root, judge):
    LARGE(root)
    found = judge(changed=["runs"])
    assert found.status == 0
    assert found.moved[["between", "method", "result"]].to_numpy().tolist() == [
        ["base → tree", "own", "new, made by no fresh run, listed"]
    ]


@pytest.mark.parametrize(
    ("left", "messages", "expected"),
    [
        ({"test_a.py": "abc"}, "", []),
        ({"new/test_b.py": "cab"}, "", []),  # moved
        ({"test_a.py": "ab"}, "", [False]),  # a few are gone
        ({"test_a.py": "a"}, "", [True]),
        ({}, "", [True]),
        ({}, "Without\n\nTests-removed: tests", [False]),
        ({}, "Without\n\nTests-removed: tests/gate", [True]),
    ],
)
def test_deleted_tests_are_red_unless_listed(left, messages, expected, tmp_path):
    for tree, files in {"base": {"test_a.py": "abc"}, "tree": left}.items():
        for name, letters in files.items():
            write(tmp_path, f"{tree}/tests/{name}", "".join(f"def test_{each}(): ...\n" for each in letters))
    found = trees.check_tests(tmp_path / "base", tmp_path / "tree", messages)
    assert [row["red"] for row in found] == expected


def test_documents_that_are_not_as_the_tables_are_red(root, judge, monkeypatch):
    """What `report --check` prints; asked where the base or the tree has documents."""
    monkeypatch.setattr(trees, "check_report", lambda *_: [trees.row("report", "", "README.md differs", "")])
    assert not judge().red
    write(root, "results/README.md", "A document\n")
    assert red(judge()) == {"report"}


# -- the base --------------------------------------------------------------------------------------
WHERE = {
    "on main": [],
    "detached": [["checkout", "-q", "--detach"], ["branch", "-q", "-D", "main", "change"]],
    "its parent replaced": [["replace", "HEAD~1", "HEAD"]],
}


@pytest.mark.parametrize("where", WHERE)
def test_a_commit_on_the_main_branch_is_compared_with_its_parent(where, root, judge):
    """And a branch with where it left the main one, or what is asked for: what main became since is none of ours."""
    git(root, "switch", "-q", "main")
    remake(broken)(root)
    commit(root, "main goes on")
    if where == "on main":
        git(root, "switch", "-q", "change")
        assert not judge().red
        assert judge(base="main").red
        git(root, "switch", "-q", "main")
    for arguments in WHERE[where]:
        git(root, *arguments)
    assert "base → tree: error" in red(judge(broken))


def test_the_pinned_revision_is_that_of_the_base(root):
    assert revisions.pinned(root, "HEAD") == ""
    write(root, ".gate-base", "abc  # first\n")
    assert revisions.pinned(root, "HEAD") == "abc"  # no other yet
    commit(root, "pin")
    write(root, ".gate-base", "def\n")
    assert revisions.pinned(commit(root, "move it"), "HEAD~1") == "abc"


@pytest.mark.parametrize(
    ("depth", "what"), [(1, "HEAD's parent"), (2, "the commit at which HEAD left origin/HEAD")]
)
def test_a_clone_without_the_base_is_inconclusive(depth, what, root, tmp_path):
    clone = tmp_path / "clone"
    if depth == 2:
        commit(commit(root, "one"), "two")
    else:
        git(root, "switch", "-q", "main")
    git(root, "clone", "-q", "--depth", str(depth), "--no-single-branch", root.as_uri(), str(clone))
    git(clone, "remote", "set-head", "origin", "main")
    with pytest.raises(BadInput, match=f"inconclusive: {what} is not in this clone; .* --unshallow"):
        revisions.base(clone, None)
    git(clone, "fetch", "-q", "--unshallow")
    assert revisions.base(clone, None) == revisions.base(root, None)


def test_rules_made_laxer_in_the_tree_that_is_judged_turn_nothing_green(tmp_path):
    """The base's gate judges: by its rules, floors and code."""
    root, run = project(tmp_path.resolve() / "project"), tmp_path / "fresh"
    gate = root / "src" / "contactbench" / "gate"
    edit(gate / "compare.py", "ERROR_FACTOR = 2.0", "ERROR_FACTOR = 1e9")
    edit(gate / "trees.py", "def row(", "def gate(*_, **__):\n    return Findings()\n\n\ndef row(")
    remake(broken)(root)
    commit(root, "harmless")
    line = ["contactbench", "gate", "--only", "accuracy", "--json", "--fresh"]
    command = [sys.executable, "-P", "-m", *line, fresh(root, run, broken)]
    given = {"cwd": root, "env": revisions.environment(root), "capture_output": True, "text": True}
    done = subprocess.run(command, **given)
    assert (done.returncode, bool(done.stdout)) == (1, True), done.stderr
    assert {"base → tree"} == {line["between"] for line in json.loads(done.stdout)["lines"] if line["red"]}


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
    inner, results, attributes = PLACES[place]
    top = tmp_path / "repository"
    write(top, f"{inner}/.gitattributes", attributes)
    folder(top / inner / results)
    git(top, "init", "-q", "-b", "main")
    commit(commit(top, "tables"), "nothing more")
    if worktree:
        git(top, "worktree", "add", "-q", "--detach", str(tmp_path / "wörk tree"))
        top = tmp_path / "wörk tree"
    monkeypatch.setattr(trees, "brought", lambda: {"a method"})
    monkeypatch.chdir(top / inner)

    def judged(change):
        run = fresh(top, tmp_path / change.__name__, change)
        return red(trees.gate(Path.cwd(), Path(results), fresh=run, parts=("accuracy",)))

    assert judged(same) == set()
    assert judged(broken) == {"tree → fresh: error"}
    where, top = (top / inner / results).resolve(), top.resolve()
    with revisions.checkout(top, "HEAD") as tree:
        assert compare_folders(revisions.inside(tree, top, where), where).moved.empty


def test_contactbench_itself_may_lie_in_a_subfolder(root):
    write(root, "mono/src/contactbench/__init__.py")
    assert revisions.project(root / "mono" / "src") == root / "mono"
    assert revisions.project(root / "results") == root


# -- the command line ------------------------------------------------------------------------------
def outcome(capsys, *arguments):
    status = main([*map(str, arguments)])
    captured = capsys.readouterr()
    return status, captured.out + captured.err


#: what is done to a file of a folder, and where the message says that it is damaged
DAMAGE = {
    "odd record": ("environment.json", lambda text: "[1]", "no list of runs"),
    "foreign table": ("orders.csv", lambda text: "a,b\n1,2\n", "columns are not those of table 'orders'"),
    "cut short": ("orders.csv", lambda text: text.rsplit(",", 5)[0], "line 4: cut short"),
}


@pytest.mark.parametrize(("name", "spoil", "message"), DAMAGE.values(), ids=DAMAGE)
def test_damage_is_one_line_with_file_line_and_column(name, spoil, message, root, tmp_path, capsys):
    run = fresh(root, tmp_path / "fresh")
    (run / name).write_text(spoil((run / name).read_text()))
    status, text = outcome(capsys, "gate", "--only", "accuracy", "--fresh", run)
    assert (status, text.count("\n"), name in text, message in text) == (2, 1, True, True), text


def test_without_tables_git_or_revision_it_could_not_run(root, capsys, monkeypatch):
    calls = {
        "--base no-such: no such revision": ("--only", "speed", "--base", "no-such"),
        "no tables in elsewhere/": ("--only", "accuracy", "--results", "elsewhere"),
        "must be in the repository": ("--results", root.parent / "other"),
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
    assert (status, {line["measure"] for line in json.loads(text)["lines"]}) == (1, {"error"})
