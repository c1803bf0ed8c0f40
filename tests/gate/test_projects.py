"""A project of a user: its benchmark, its tables and its gate, in a repository that has no contactbench in it."""

import os
import re
import shutil
import subprocess
import sys

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
    assert {"orders.csv", "runs.csv", "times.csv", "environment.json"} <= set(
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
    stale = made_up.row("gone", scene="double-well", engine="llvm")
    merge(TABLES["runs"], [stale], tmp_path / "results")
    commit(tmp_path)
    made = call(tmp_path, "bench", "--profile", "smoke")
    assert made.returncode == 0, made.stdout + made.stderr
    assert "runs: dropped 1 rows that no profile makes any more: double-well gone" in made.stderr
    assert "1 measure moved" in made.stdout
    assert keys_of(tmp_path / "results") == keys_of(TEMPLATE / "results")
    shutil.copytree(TEMPLATE, tmp_path, dirs_exist_ok=True)
    commit(commit(tmp_path))
    gated = call(tmp_path, "gate", "--only", "accuracy")
    assert gated.returncode == 0, gated.stdout + gated.stderr


# -- a stranger's path, from a wheel in an empty environment ------------------------------------------
@pytest.fixture
def run(repository, tmp_path_factory):
    """Return what runs the program on the repository's plug-in, expects an exit status, and returns what it prints."""
    place = tmp_path_factory.mktemp("stranger")
    build = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", place, REPOSITORY]
    subprocess.run(build, check=True)
    subprocess.run([sys.executable, "-m", "venv", place / "environment"], check=True)
    install = [place / "environment" / "bin" / "pip", "install", "-q", "-q"]
    wheel = f"{next(place.glob('*.whl'))}[bench]"
    subprocess.run([*install, wheel, "-c", REPOSITORY / "constraints.txt"], check=True)
    program = place / "environment" / "bin" / "contactbench"

    def run(*arguments, status=0):
        ended = call(repository, *arguments, command=[program], without=["PYTHON", "PYTEST_"])
        assert ended.returncode == status, ended.stdout + ended.stderr
        return ended.stdout

    return run


@pytest.mark.slow
def test_a_stranger_verifies_an_integrator_races_a_problem_and_gates_a_repository(run, repository):
    """The same method is green; another coefficient and a slower one are red."""
    run("check", "my-method")
    assert "my-method" in run("compare", "double-well", "my-method", "contact-strang", "rk4")
    run("bench", "-k", "my-method and (oscillator or particle or central or double-well)")
    assert {*read(TABLES["runs"], repository / "results")["method"]} == {"my-method"}
    commit(commit(repository))
    run("gate")
    commit(repository, MY.replace(HALF, WRONG))
    assert "| orders | particle | my-method |" in run("gate", "--only", "accuracy", status=1)
    commit(repository, MY.replace(HALF, SLOW))
    assert "**slower**" in run("gate", "--only", "speed", status=1)
