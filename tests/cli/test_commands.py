"""The command line: ``compare``, ``check``, outputs that cannot be written, and a process of its own."""

import json
import os
import signal
import subprocess
import sys
from functools import partial
from importlib import metadata
from pathlib import Path

import pandas as pd
import pytest

import contactbench as cb
import made_up
from cases import few_slow, run
from contactbench import testing
from contactbench.cli import main, parsing
from contactbench.files import replacing
from contactbench.methods.fixed_step import FixedStep
from contactbench.paper import CLAIMS
from contactbench.questions import write
from contactbench.testing import METHOD_RULES, SCENE_RULES

RUN = "solve particle rk4 --step 0.1 --t-end 1"
RACE = ["compare", "particle", "rk4", "contact-strang", "--error", "1e-2,1e-3", "--budget", "60s"]


@pytest.fixture(autouse=True)
def cores(monkeypatch, unconfirmed):
    """The tests keep their cores."""
    monkeypatch.setattr("contactbench.cli.runs.one_core", lambda: None)


@pytest.fixture
def one_line(capsys):
    """What runs a command and returns the one line it writes on standard error."""

    def one_line(*line, status=2):
        assert main([*map(str, line)]) == status
        says = capsys.readouterr().err
        assert says.count("\n") == 1
        return says

    return one_line


def test_an_error_that_nobody_foresaw_is_one_line_with_its_place(monkeypatch, one_line):
    monkeypatch.setattr("contactbench.plugins.load_file", lambda path: 1 / 0)
    says = one_line("list", "--plugin", "any.py")
    assert says.startswith("contactbench: ZeroDivisionError: division by zero (test_commands.py, line ")


def test_it_prints_tables_and_writes_only_what_it_is_told(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main([*RACE, "--csv", "out.csv", "--plot", "out.svg"]) == 0
    out, err = capsys.readouterr()
    assert out.startswith("Compiled")
    assert "at round-off" in out
    assert err == ""  # no terminal, no progress
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.csv", "out.svg"]
    rows = pd.read_csv("out.csv")
    assert list(rows["method"]) == ["rk4", "rk4", "contact-strang", "contact-strang"]
    assert (rows["status"] == "ok").all()


def test_json_is_one_object_with_the_rows(capsys):
    """Methods may follow an option."""
    line = "compare oscillator --error 1e-2 rk4 --budget 60s contact-strang --json --set gamma=0.3"
    assert main(line.split()) == 0
    found = json.loads(capsys.readouterr().out)
    assert {"reference", "rows"} <= found.keys()
    assert [row["error_asked"] for row in found["rows"]] == [1e-2] * 2
    assert all(row["time_s"] > 0 for row in found["rows"])


def test_a_race_that_measures_nothing_is_no_success(capsys):
    assert main(["compare", "particle", "contact-exact", "--error", "1e-2", "--json"]) == 1
    assert [row["status"] for row in json.loads(capsys.readouterr().out)["rows"]] == ["unsupported"]


def test_an_interrupted_race_prints_what_it_has(capsys, monkeypatch):
    def stopped(self, *_):
        raise KeyboardInterrupt

    monkeypatch.setattr("contactbench.measure.clock.Race.go", stopped)
    assert main(RACE) == 130
    out = capsys.readouterr().out
    assert "not timed" in out
    assert "Interrupted" in out


def test_version_and_help_without_a_command(capsys):
    assert main(["--version"]) == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first == f"contactbench {cb.__version__}"
    assert f"heyoka {metadata.version('heyoka')}, cyrk {metadata.version('cyrk')}" in second
    assert main([]) == 0
    assert "compare" in capsys.readouterr().out


# -- ``contactbench check`` ------------------------------------------------------------------------
def midpoint(scene, x, h, xp):
    return cb.shifted(x, h, scene.rhs(cb.shifted(x, h / 2, scene.rhs(x))))


@pytest.fixture
def mine(monkeypatch):
    """A method that keeps its contract, one that claims a higher order, and a scene of each kind."""
    for name, order in (("kept", 2), ("broken", 3)):
        method = FixedStep(name, order, midpoint, evaluations=2, about="planted")
        monkeypatch.setitem(cb.METHODS, name, method)
    wrong = cb.SCENES["particle"].with_(name="torn", rotation_invariant=True)
    monkeypatch.setitem(cb.SCENES, "torn", wrong)


def rules(out):
    """The rules that a check lists."""
    return [int(line.split()[0]) for line in out.splitlines()[1:]]


@pytest.mark.usefixtures("mine")
def test_a_method_on_one_engine_and_a_scene_have_every_rule(capsys, monkeypatch):
    one = partial(testing.method_findings, scenes=testing.method.CASES[:1])
    monkeypatch.setattr(testing, "method_findings", one)
    assert main(["check", "kept", "--engine", "python"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert rules(out) == list(METHOD_RULES)
    assert all(line.endswith("kept") for line in out.splitlines() if line[:4].strip().isdigit())
    assert main(["check", "oscillator"]) == 0
    assert rules(capsys.readouterr().out) == list(SCENE_RULES)


@pytest.mark.usefixtures("mine")
@pytest.mark.parametrize(("line", "rule"), [(["broken", "--engine", "python"], 6), (["torn"], 7)])
def test_a_broken_rule_ends_it(line, rule, capsys):
    assert main(["check", *line]) == 1
    out, err = capsys.readouterr()
    assert rules(out) == list(range(1, rule))
    assert (err.startswith(f"contactbench: rule {rule}: {line[0]}"), err.count("\n")) == (True, 1)
    remedies = METHOD_RULES if len(line) > 1 else SCENE_RULES
    assert err.endswith(f". {remedies[rule].__doc__}\n")


def test_every_rule_says_what_to_do():
    for each in (*METHOD_RULES.values(), *SCENE_RULES.values()):
        assert each.__doc__
        assert each.__doc__.count("\n") == 0


# -- The width of the terminal ---------------------------------------------------------------------
@pytest.mark.parametrize("line", ["list", "list claims", "claim C13", f"{RUN} --laws"])
def test_lines_are_wrapped_at_the_width_of_the_terminal(line, capsys, monkeypatch):
    """Without a terminal it is 80."""
    found = {}
    for width in (None, 72, 100, 1000):
        if width:
            monkeypatch.setenv("COLUMNS", str(width))
        else:
            monkeypatch.delenv("COLUMNS", raising=False)
        assert main(line.split()) == 0
        found[width or 80] = capsys.readouterr().out
    whole = found.pop(1000)
    for width, wrapped in found.items():
        assert wrapped.split() == whole.split()  # no word is cut
        assert max(map(len, whole.splitlines())) > width >= max(map(len, wrapped.splitlines()))


@pytest.mark.parametrize("kind", ["methods", "scenes", "laws", "claims"])
def test_a_list_has_a_line_for_each_and_all_about_one(kind, capsys):
    items = {"methods": cb.METHODS, "scenes": cb.SCENES, "laws": cb.LAWS, "claims": CLAIMS}[kind]
    assert main(["list", kind]) == 0
    listed = [line.split()[0] for line in capsys.readouterr().out.splitlines() if not line.startswith(" ")]
    assert listed == [*items]
    name = listed[-1]
    assert main(["list", kind, name]) == 0
    assert capsys.readouterr().out.split()[:2] == ["name", name]


def test_a_method_of_ones_own_is_described_by_what_it_declares(registries, capsys):
    cb.fixed_step("my-midpoint", order=2, evaluations=2, about="my source")(midpoint)
    assert main(["list", "methods", "my-midpoint"]) == 0
    said = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.splitlines())
    assert said["good"] == "for   order 2: for large errors"
    assert said["cost"] == "about 2 evaluations per step on oscillator"
    assert said["source"] == "my source"


# -- What cannot be written is refused before anything is computed ---------------------------------
SOLVE = "solve particle rk4 --step 0.1"
OPTIONS = [(SOLVE, "--out", ".csv"), (SOLVE, "--plot", ".svg")]
OPTIONS += [("compare particle rk4", "--csv", ".csv"), ("compare particle rk4", "--plot", ".png")]


def work(*_, **__):
    raise AssertionError("the work has begun")


def full(*_, **__):
    raise OSError(30, "Read-only file system")


@pytest.mark.parametrize("place", ["none/x", "file/x", "folder"])
@pytest.mark.parametrize(("line", "option", "suffix"), OPTIONS)
def test_an_output_that_cannot_be_written_is_refused_first(
    line, option, suffix, place, tmp_path, one_line, monkeypatch
):
    """In no folder, in a file, in place of a folder."""
    monkeypatch.setattr(cb, "solve", work)
    monkeypatch.setattr(cb, "compare", work)
    path = (tmp_path / place).with_suffix(suffix)
    (tmp_path / "file").write_text("kept")
    (tmp_path / "folder").with_suffix(suffix).mkdir()
    assert one_line(*line.split(), option, path).startswith(f"contactbench: {option} {path}: ")


@pytest.mark.posix
@pytest.mark.parametrize("option", ["--out", "--plot"])
@pytest.mark.parametrize("before", [None, "kept"])
def test_a_disk_that_is_full_leaves_the_file_as_it_was(option, before, tmp_path, one_line):
    import resource

    path = tmp_path / ("x.svg" if option == "--plot" else "x.csv")
    if before:
        path.write_text(before)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        says = one_line(*SOLVE.split(), option, path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert ("File too large" in says, str(path) in says) == (True, True)
    assert [each.read_text() for each in tmp_path.iterdir()] == ([before] if before else [])


@pytest.mark.posix
def test_what_is_no_file_is_written_to_as_it_is(tmp_path):
    os.mkfifo(path := tmp_path / "pipe")
    reader = subprocess.Popen(["cat", path], stdout=subprocess.PIPE, text=True)
    with replacing(path) as file:
        file.write("all")
    assert reader.communicate()[0] == "all"
    assert path.is_fifo()


def test_trying_a_file_changes_nothing_and_one_that_the_system_refuses_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "there.csv"
    path.write_text("kept")
    parsing.writable("--csv", path)
    assert path.read_text() == "kept"
    parsing.writable("--csv", tmp_path / "new.csv")
    assert list(tmp_path.iterdir()) == [path]
    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(cb.BadInput, match="Read-only file system"):
        parsing.writable("--csv", tmp_path / "new.csv")


def test_a_report_that_cannot_be_written_is_refused_first(tmp_path, monkeypatch, one_line):
    monkeypatch.setattr(write, "report", work)
    made_up.folder(tmp_path)
    readme = tmp_path / "README.md"
    readme.write_text("nothing to fill in")
    for path in (readme, tmp_path / "none"):
        one_line("report", "--results", tmp_path, "--readme", path)


# -- The command line as a process of its own ------------------------------------------------------
MODULE = [sys.executable, "-m", "contactbench"]


def test_what_cannot_be_encoded_is_replaced():
    done = run(*MODULE, "claim", "C13", PYTHONIOENCODING="ascii")
    assert done.returncode == 0, done.stderr
    assert "?" in done.stdout
    assert done.stdout.isascii()


@pytest.mark.slow
def test_an_encoding_of_the_system_is_enough_and_json_needs_no_other():
    line = [*MODULE, "claim", "C13"]
    done = run(*line, LC_ALL="C", PYTHONUTF8="0", PYTHONCOERCECLOCALE="0")
    assert (done.returncode, done.stderr) == (0, "")
    done = run(*line, "--json", PYTHONIOENCODING="ascii")
    assert "§" in json.loads(done.stdout)["where"]


@pytest.mark.parametrize("closed", few_slow([">&-", "2>&-", ">&- 2>&-"], ">&-", "2>&-"))
def test_a_closed_stream_is_no_error(closed):
    done = run("sh", "-c", f'exec "$@" {closed}', "sh", *MODULE, "list", "laws")
    assert done.returncode == 0
    assert done.stderr == ""


@pytest.mark.parametrize("platform", few_slow(["rocm", "abacus"], "rocm"))
def test_a_platform_that_is_not_there_is_one_line(platform):
    done = run(*MODULE, "solve", "oscillator", "diffrax-tsit5", "--rtol", "1e-3", JAX_PLATFORMS=platform)
    assert done.returncode == 2
    assert done.stderr.startswith(f"contactbench: JAX_PLATFORMS = {platform}: must be")
    assert done.stderr.count("\n") == 1


INTERPRETED = """
import json
import contactbench as cb
cases = {
    "rk4": {"step": 0.1}, "contact-strang": {"step": 0.1},
    "cvode-adams": {"rtol": 1e-3}, "scipy-dop853": {"rtol": 1e-3}, "cyrk-dop853": {"rtol": 1e-3},
}
runs = {name: cb.solve("particle", name, **given) for name, given in cases.items()}
runs["contact-exact"] = cb.solve("rigid_body", "contact-exact", engine="llvm")
runs["llvm"] = cb.solve("particle", "rk4", step=0.1, engine="llvm")
runs["c"] = cb.solve("particle", "cvode-adams", rtol=1e-3, engine="c")
print(json.dumps({name: (run.engine, run.status, "NUMBA_DISABLE_JIT" in run.message) for name, run in runs.items()}))
"""


def test_where_numba_does_not_compile_python_computes():
    done = run(sys.executable, "-c", INTERPRETED, NUMBA_DISABLE_JIT="1")
    assert done.returncode == 0, done.stderr
    runs = json.loads(done.stdout)
    by_python = dict.fromkeys(("rk4", "contact-strang", "scipy-dop853"), "python")
    compiled = {"cyrk-dop853": "c++", "contact-exact": "llvm", "llvm": "llvm", "c": "c"}
    by_python |= {"cvode-adams": "c+python"}
    assert {name: engine for name, (engine, status, _) in runs.items() if status == "ok"} == by_python
    assert {name: engine for name, (engine, _, why) in runs.items() if why} == compiled


# -- how a process ends ------------------------------------------------------------------------------
def test_what_reads_a_pipe_may_leave():
    line = [*MODULE, *["solve", "particle", "rk4", "--step", "1e-3", "--out", "/dev/stdout"]]
    with subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "t,q1,q2,p1,p2,s\n"
        process.stdout.close()
        assert (process.stderr.read(), process.wait()) == ("", 141)


def test_a_thread_of_a_plug_in_does_not_keep_the_process(tmp_path):
    step = "import contactbench as cb\ncb.SCENES.add(cb.SCENES['particle'].with_(name='mine'))\n"
    thread = "import threading\nthreading.Thread(target=threading.Event().wait).start()\n"
    (tmp_path / "my.py").write_text(step + thread)
    done = run(*MODULE, *["solve", "mine", "rk4", "--step", "0.1", "--plugin"], tmp_path / "my.py")
    assert (done.returncode, done.stderr) == (0, "")
    assert "status   ok" in done.stdout


def test_a_gate_leaves_the_handlers_of_signals(tmp_path, capsys):
    before = signal.getsignal(signal.SIGTERM)
    assert main(["gate", "--baseline", str(tmp_path)]) == 2
    assert signal.getsignal(signal.SIGTERM) is before
