"""A project of a user: its benchmark, its tables and its gate, in a repository that has no contactbench in it."""

import os
import re
import shutil
import subprocess
import sys
from time import perf_counter

import pytest

import made_up
from cases import REPOSITORY, environment
from contactbench.cli import main
from contactbench.gate import revisions
from contactbench.plugins import VARIABLE
from contactbench.tables.schema import TABLES
from contactbench.tables.store import keys, merge, read

TEMPLATE = REPOSITORY / "docs" / "template"
MY = (TEMPLATE / "my.py").read_text()
HALF = "    half = cb.shifted(x, h / 2, scene.rhs(x))\n"
#: seconds of each of a stranger's paths
WITHIN = 300.0
#: a change of the method's one line, and what the gate finds
WRONG = HALF.replace("/ 2", "/ 2.001")
SLOW = HALF + "    for _ in range(40):\n        half = cb.shifted(half, 0 * h, half)\n"


def commit(repository, text=MY):
    (repository / "my.py").write_text(text)
    return made_up.commit(repository, "my work")


@pytest.fixture
def repository(tmp_path):
    made_up.git(tmp_path, "init", "-q", "-b", "main")
    shutil.copy(TEMPLATE / ".gitignore", tmp_path)
    commit(tmp_path)
    return tmp_path


def call(repository, *arguments, command=(sys.executable, "-m", "contactbench"), without=("PYTEST_",)):
    line = [*command, *map(str, arguments), "--plugin", "my.py"]
    given = {"cwd": repository, "env": environment(without), "timeout": 550}
    return subprocess.run(line, capture_output=True, text=True, **given)


def test_what_is_in_no_plug_in_has_no_gate(repository, monkeypatch, capsys):
    monkeypatch.chdir(repository)
    assert main(["gate", "--base", "HEAD"]) == 2
    assert "no method or scene of your own; name their file with --plugin FILE" in capsys.readouterr().err


def test_a_base_has_its_own_copy_of_a_plug_in(tmp_path, monkeypatch):
    root, tree, elsewhere = tmp_path / "root", tmp_path / "tree", tmp_path / "other.py"
    monkeypatch.setenv(VARIABLE, f"{root / 'a' / 'my.py'}{os.pathsep}{elsewhere}")
    (tree / "src").mkdir(parents=True)
    monkeypatch.setenv("PYTHONPATH", "/before")
    variables = revisions.environment(tree, root)
    assert variables[VARIABLE] == f"{tree / 'a' / 'my.py'}{os.pathsep}{elsewhere}"
    assert variables["PYTHONPATH"] == f"{tree / 'src'}{os.pathsep}/before"


def test_the_template_has_what_the_document_shows():
    shown = (REPOSITORY / "docs" / "gate.md").read_text()
    workflow = (TEMPLATE / ".github" / "workflows" / "gate.yml").read_text()
    assert f"```yaml\n{workflow}```" in shown
    commands = re.findall(r"^contactbench (\w+)", (TEMPLATE / "README.md").read_text(), re.M)
    assert commands == ["check", "compare", "bench", "gate"]
    assert {"convergence.csv", "laws.csv", "work_precision.csv", "environment.json"} <= set(
        os.listdir(TEMPLATE / "results")
    )


def keys_of(results):
    frames = {name: read(table, results) for name, table in TABLES.items()}
    return {name: {*keys(TABLES[name], frame.to_dict("records"))} for name, frame in frames.items()}


@pytest.mark.slow
def test_the_template_is_what_its_commands_make_and_green(tmp_path):
    """To make it anew: its bench command, in docs/template."""
    made_up.git(tmp_path, "init", "-q", "-b", "main")
    shutil.copytree(TEMPLATE, tmp_path, dirs_exist_ok=True)
    stale = {
        "scene": "double-well",
        "method": "gone",
        "engine": "llvm",
        "setting": "step=0.1",
        "profile": "smoke",
    }
    merge(TABLES["laws"], [stale], tmp_path / "results")
    commit(tmp_path)
    made = call(tmp_path, "bench", "--profile", "smoke")
    assert made.returncode == 0, made.stdout + made.stderr
    assert "laws: dropped 1 rows that no profile makes any more: double-well gone" in made.stderr
    assert "1 measure moved" in made.stdout
    assert keys_of(tmp_path / "results") == keys_of(TEMPLATE / "results")
    shutil.copytree(TEMPLATE, tmp_path, dirs_exist_ok=True)
    commit(commit(tmp_path))
    gated = call(tmp_path, "gate", "--only", "accuracy")
    assert gated.returncode == 0, gated.stdout + gated.stderr


@pytest.mark.slow
def test_it_is_measured_and_gated(repository):
    """Another coefficient is red; the same, by the test below, green."""
    made = call(repository, "bench", "--profile", "smoke", "--untimed", "-k", "my-method and particle")
    assert made.returncode == 0, made.stdout + made.stderr
    tables = {path.stem for path in (repository / "results").glob("*.csv")}
    assert {"convergence", "laws", "work_precision"} <= tables
    rows = (repository / "results" / "work_precision.csv").read_text().splitlines()
    assert len(rows) > 1
    assert all("my-method" in line for line in rows[1:])
    commit(repository)
    commit(repository, MY.replace(HALF, WRONG))
    red = call(repository, "gate", "--only", "accuracy")
    assert red.returncode == 1, red.stdout + red.stderr
    assert "| convergence | particle | my-method |" in red.stdout


# -- a stranger's three paths, from a wheel in an empty environment, each within five minutes ---------
@pytest.fixture(scope="module")
def program(tmp_path_factory):
    place = tmp_path_factory.mktemp("stranger")
    build = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", place, REPOSITORY]
    subprocess.run(build, check=True)
    subprocess.run([sys.executable, "-m", "venv", place / "environment"], check=True)
    install = [place / "environment" / "bin" / "pip", "install", "-q", "-q"]
    wheel = f"{next(place.glob('*.whl'))}[bench]"
    subprocess.run([*install, wheel, "-c", REPOSITORY / "constraints.txt"], check=True)
    return place / "environment" / "bin" / "contactbench"


@pytest.fixture
def run(repository, program):
    """Return what runs the program on the repository's plug-in, expects an exit status, and returns what it prints."""
    begun = perf_counter()

    def run(*arguments, status=0):
        ended = call(repository, *arguments, command=[program], without=["PYTHON", "PYTEST_"])
        assert ended.returncode == status, ended.stdout + ended.stderr
        return ended.stdout

    yield run
    assert perf_counter() - begun < WITHIN


@pytest.mark.slow
@pytest.mark.parametrize("methods", ["contact-rkn8 rk4 cvode-adams", "my-method contact-strang rk4"])
def test_a_stranger_verifies_an_integrator_and_races_a_problem(methods, run):
    first, *_ = methods = methods.split()
    run("check", "my-method")
    assert first in run("compare", "double-well", *methods)


@pytest.mark.slow
def test_a_stranger_gates_a_repository(run, repository):
    run("bench", "-k", "my-method and (oscillator or particle or central or double-well)")
    commit(repository)
    commit(repository)
    run("gate")
    commit(repository, MY.replace(HALF, SLOW))
    assert "**slower**" in run("gate", "--only", "speed", status=1)
