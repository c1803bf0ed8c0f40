"""A user's own methods, scenes, laws and questions: the README's example as it stands, files that fail, entry points.

Each is one file, and then everywhere by the registries.
"""

import json
import os
import re
import shutil
import sys
from functools import partial
from pathlib import Path

import pandas as pd
import pytest

import contactbench as cb
from cases import REPOSITORY, bench, finished, run
from contactbench import plugins
from contactbench.cli import main
from contactbench.questions import write
from contactbench.tables.declared import ORDERS, RUNS, TIMES
from contactbench.tables.provenance import runs
from contactbench.tables.store import read

MINE = ("my-method", "my-pendulum")
REGISTRIES = {"methods": cb.METHODS, "scenes": cb.SCENES}
EXTENSIONS = [Path(__file__).parent / "extensions" / f"{name}.py" for name in ("law", "question")]


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    """The file the README tells to write."""
    first, *blocks = re.findall(r"```python\n(.*?)```", (REPOSITORY / "README.md").read_text(), re.DOTALL)
    mine = (block for block in blocks if "SCENES.add" in block or "@cb.fixed_step" in block)
    text = "\n".join([*first.splitlines()[:-2], *mine])  # the last two lines solve it and race
    assert len(text.splitlines()) <= 25
    path = tmp_path_factory.mktemp("plugin") / "my.py"
    path.write_text(text)
    return path


module = partial(run, sys.executable, "-m", JAX_PLATFORMS="cpu")


def search(folder):
    return os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH")]))


@pytest.fixture(scope="module")
def given(example):
    """What names all of them to a command."""
    return [argument for file in (example, *EXTENSIONS) for argument in ("--plugin", str(file))]


@pytest.fixture(scope="module")
def results(given, tmp_path_factory):
    """The benchmark with all of them, for real, on a small part."""
    folder = tmp_path_factory.mktemp("results")
    own = "my-method and (my-pendulum or particle and not long) or my-pendulum and cvode-bdf"
    finished(bench(folder, f"{own} or particle and not long and cvode-adams", *given))
    run(sys.executable, EXTENSIONS[-1], folder).check_returncode()
    return folder


def to_the_end(results):
    runs = read(RUNS, results)
    return runs[runs["saved"] == 1]


def test_the_readmes_example_has_its_rows_in_the_tables(results):
    work, times = (
        frame.set_index(["scene", "method", "engine"]).sort_index()
        for frame in (to_the_end(results), read(TIMES, results))
    )
    for engine in ("llvm", "python"):
        for scene in ("particle", "my-pendulum"):
            assert (times.loc[(scene, "my-method", engine), "least_s"] > 0).all()
        assert work.loc[("my-pendulum", "my-method", engine), "error"].min() < 0.1
    # the truth of the user's scene was computed live: a tolerance is met against it
    assert work.loc[("my-pendulum", "cvode-bdf", "c+python"), "error"].min() < 1e-2
    assert set(work.index.get_level_values("scene")) == {"particle", "my-pendulum"}
    assert [set(run["plugins"]) for run in runs(results)] == [{"my.py", "law.py", "question.py"}]


def test_a_partial_run_fills_its_part_of_every_table(results):
    work, times = to_the_end(results), read(TIMES, results)
    assert set(work["method"]) == {"cvode-adams", "cvode-bdf", "my-method"}
    ok, curves = work[work["status"] == "ok"], read(RUNS, results).query("saved == 1000")
    assert {"cvode-adams", "my-method"} == set(curves["method"])
    assert ok[["error", "steps", "evaluations"]].notna().all().all()
    key = list(TIMES.key)
    assert set(map(tuple, times[key].values.tolist())) == set(map(tuple, ok[key].values.tolist()))
    assert times[["least_s", "halves", "compile_s", "first_s"]].notna().all().all()
    assert times["process"].notna().any()
    assert "my-method" in set(read(ORDERS, results)["method"])
    assert (results / "environment.json").exists()


def test_report_writes_documents_and_figures_from_the_tables(results):
    """Those of a user's method and scene too, without being loaded."""
    assert not set(MINE) & {*cb.METHODS, *cb.SCENES}
    written = {path.name for path in write.report(results, REGISTRIES)}
    assert {"README.md", "laws.md", "cost.md", "glossary.md", "cost_my-pendulum.svg"} <= written
    for name in ("laws.md", "figures/cost_my-pendulum.svg"):
        assert "my-method" in (results / name).read_text()
    for path in results.glob("*.md"):
        assert not re.search(r"\bnan\b", path.read_text()), path


def tenfold(tables, column, path):
    """A copy of a folder of tables, one of its columns ten times as large."""
    name, _, column = column.partition(".")
    frame = pd.read_csv(tables / f"{name}.csv")
    frame[column] *= 10
    frame.to_csv(shutil.copytree(tables, path / name) / f"{name}.csv", index=False)
    return path / name


@pytest.mark.slow
def test_a_law_and_a_question_have_their_documents_and_are_gated(results, given, tmp_path):
    def contactbench(*arguments, code=0):
        done = module("contactbench", *arguments, *given)
        assert done.returncode == code, done.stdout + done.stderr
        return done.stdout

    contactbench("report", "--results", results)
    assert "mean_position" in contactbench("list")
    laws = pd.read_csv(results / "runs.csv")
    assert (laws.loc[(laws["method"] == "cvode-adams") & (laws["saved"] > 1), "mean_position"] > 0).all()
    names = ("laws.md", "half_life.md", "README.md")
    document, answer, front = ((results / name).read_text() for name in names)
    assert "mean q" in document
    assert "When is half of the energy gone?" in answer
    assert "half_life.md" in front
    assert (results / "figures" / "half_life.svg").is_file()
    gate = ("gate", "--only", "accuracy", "--baseline", results, "--fresh")
    contactbench(*gate, results)
    for column in ("runs.mean_position", "half_life.half_life"):
        fresh = tenfold(results, column, tmp_path)
        assert column.partition(".")[2] in contactbench(*gate, fresh, code=1)


@pytest.mark.slow
def test_the_tests_take_it_in(example):
    tests = ("tests/methods/test_contract.py", "tests/scene/test_scene.py::test_a_scene_keeps_its_contract")
    chosen = "(my-method and python) or my-pendulum"
    done = module("pytest", *tests, "--plugin", example, "-q", "-p", "no:cacheprovider", "-k", chosen)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "4 passed" in done.stdout  # on a scene of every kind, none of them put off as slow


def test_the_command_line_takes_it_anywhere_on_the_line(example, registries, capsys):
    solve = ["solve", "my-pendulum", "my-method", "--step", "0.01", "--json"]
    plugin = ["--plugin", str(example)]
    for command in ([*plugin, *solve], [*solve, *plugin]):
        assert main(command) == 0
        out = json.loads(capsys.readouterr().out)
        assert (out["scene"], out["method"], out["counts"]["evaluations"]) == (*MINE[::-1], 8000)


# -- files that fail -------------------------------------------------------------------------------
IMPORT = "import contactbench as cb\n"
STEP = f"{IMPORT}@cb.fixed_step('bad', 1)\ndef step(scene, x, h, xp):\n    "
FAILURES = {
    "exception": (f"{IMPORT}\ncb.SCENES['partcle']", "bad.py, line 3): UnknownName"),
    "nothing": ("x = 1", "registers nothing"),
    "taken": (f"{IMPORT}cb.SCENES.add(cb.SCENES['central'])", "'central' is already registered"),
    "exit at import": ("import sys\nsys.exit(0)", "bad.py, line 2): SystemExit: 0"),
    "a step that fails": (f"{STEP}return {{}}['a']", "method 'bad', step (bad.py, line 4): KeyError: 'a'"),
}


@pytest.mark.parametrize(("text", "says"), FAILURES.values(), ids=FAILURES)
def test_a_file_that_fails_or_leaves_is_one_line(text, says, registries, tmp_path, monkeypatch, capsys):
    """And the traceback where it is asked for."""
    path = tmp_path / "bad.py"
    path.write_text(text)
    line = ["solve", "particle", "bad", "--step", "0.1", "--plugin", str(path)]
    assert main(line) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n"), says in err) == ("", 1, True), err
    if "UnknownName" in says:
        assert main([*line, "--traceback"]) == 2
        assert "cb.SCENES['partcle']" in capsys.readouterr().err


TALKS = """
import contactbench as cb
print("imported")
def potential(q):
    print("called")
    return q[0] ** 2 / 2
cb.SCENES.add(cb.Mechanical(name="talks", potential=potential, gamma=0.1, q=(1.0,), p=(0.0,), t_end=1.0))
"""


@pytest.mark.parametrize(
    "line", ["solve talks rk4 --step 0.1", "compare talks rk4 --error 1e-2", "solve talks x"]
)
def test_stdout_is_json_alone_whatever_a_file_prints(
    line, registries, unconfirmed, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr("contactbench.cli.runs.one_core", lambda: None)
    path = tmp_path / "talks.py"
    path.write_text(TALKS)
    status = main([*line.split(), "--json", "--plugin", str(path)])
    out, err = capsys.readouterr()
    assert out == "" if status == 2 else json.loads(out)
    assert "imported\ncalled\n" in err
    print("here")
    assert capsys.readouterr().out == "here\n"


def test_a_file_given_twice_is_loaded_once(tmp_path, registries):
    (tmp_path / "neighbour.py").write_text("GAMMA = 0.125\n")
    path = tmp_path / "mine.py"
    added = "cb.SCENES.add(cb.SCENES['central'].with_(name='twice', gamma=GAMMA))"
    path.write_text(f"{IMPORT}from neighbour import GAMMA\n{added}\n")
    plugins.load_file(path)
    plugins.load_file(str(path))
    assert cb.SCENES["twice"].gamma == 0.125
    assert plugins.LOADED["mine.py"].startswith("sha256 ")
    assert os.environ[plugins.VARIABLE] == str(path)


SPAWNED = """
import multiprocessing, sys
import contactbench as cb
from contactbench.plugins import load_file

def known():
    return [name for name in ("my-method", "my-pendulum") if name in cb.METHODS or name in cb.SCENES]

if __name__ == "__main__":
    load_file(sys.argv[1])
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        print(*pool.apply(known))
"""


def test_worker_processes_have_it_too(example, tmp_path):
    (tmp_path / "spawned.py").write_text(SPAWNED)
    done = module("spawned", example, PYTHONPATH=search(tmp_path))
    assert done.stdout.split() == list(MINE), done.stderr


# -- entry points ----------------------------------------------------------------------------------
PACKAGE = """
import contactbench as cb
from contactbench.methods.fixed_step import FixedStep

@cb.fixed_step("decorated", order=1)
def euler(scene, x, h, xp):
    return cb.shifted(x, h, scene.rhs(x))

made = FixedStep("made", 1, euler)

def several():
    return [cb.SCENES["central"].with_(name=name) for name in ("first", "second")]

scene = cb.SCENES["oscillator"].with_(name="object")
"""
POINTS = """
[contactbench.methods]
a = my_package:euler
b = my_package:made
c = my_package:absent
[contactbench.scenes]
d = my_package:several
e = my_package:scene
f = no_such_package:scene
"""


def test_entry_points_are_loaded_and_a_broken_one_is_a_warning(tmp_path):
    (tmp_path / "my_package.py").write_text(PACKAGE)
    info = tmp_path / "my_package-1.5.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-package\nVersion: 1.5\n")
    (info / "entry_points.txt").write_text(POINTS)
    gone = tmp_path / "gone.py"
    done = module("contactbench", "list", PYTHONPATH=search(tmp_path), **{plugins.VARIABLE: str(gone)})
    assert done.returncode == 0, done.stderr
    assert {"decorated", "made", "first", "second", "object"} <= set(done.stdout.split())
    warned = [line for line in done.stderr.splitlines() if "is left out" in line]
    assert [any(name in line for line in warned) for name in ("'c'", "'f'", str(gone))] == [True] * 3
    assert len(warned) == 3
