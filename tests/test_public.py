"""What a user meets first: what an import loads, public names, what a run returns, and the plain install."""

import ast
import doctest
import importlib
import math
import re
import sys
import textwrap
import tomllib
from math import cos, sin
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib import pyplot

import contactbench as cb
from cases import refusal, run, scene_of
from contactbench.blame import FUNCTIONS, SEVERAL
from contactbench.checks import INSTALLED_AS
from contactbench.cli import main
from contactbench.measure.laws import LAWS, laws_of
from contactbench.numbers import functions
from contactbench.plugins import OWN

SOURCE = Path(cb.__file__).parent
WITH_EXAMPLES = [
    ".".join(path.relative_to(SOURCE).with_suffix("").parts).removesuffix(".__init__")
    for path in sorted(SOURCE.rglob("*.py"))
    if re.search(r"^ *>>> ", path.read_text(encoding="utf-8"), re.MULTILINE)
]


# -- what is loaded --------------------------------------------------------------------------------
SOLVERS = {"jax", "numba", "mpmath", "diffrax", "heyoka", "sksundae", "CyRK", "scipy.integrate"}
#: other libraries, and parts of the package, that take long to load
HEAVY = SOLVERS | {"matplotlib", "pandas", "scipy.linalg", "scipy.optimize"}
HEAVY |= {f"contactbench.{part}" for part in ("gate", "report", "tables.store", "testing")}
#: what only some programs need, and the list of claims: short commands do without
SELDOM = {"scipy", "numpy.polynomial", "difflib", "logging", "concurrent.futures", "contactbench.paper"}


@pytest.mark.parametrize(
    ("statement", "without"),
    [
        ("import contactbench", HEAVY | SELDOM),
        ("from contactbench.cli import main; main(['list'])", HEAVY),
        ("import contactbench.questions.write", {"jax", "diffrax", "heyoka", "sksundae"}),
    ],
)
def test_nothing_more_is_loaded_and_the_environment_is_left_alone(statement, without):
    program = (
        "import contextlib, io, os, sys; before = dict(os.environ)\n"
        f"with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit): {statement}\n"
        "assert before == dict(os.environ); print(*sys.modules)"
    )
    done = run(sys.executable, "-c", program)
    assert not done.stderr
    assert "contactbench" in (found := set(done.stdout.split()))
    assert not found & without


def test_dir_shows_the_public_names_and_they_exist():
    assert dir(cb) == sorted([*cb.__all__, "diffrax", "scipy", "__version__"])
    assert all(getattr(cb, name) is not None for name in dir(cb))
    assert set(functions.__all__) == {*FUNCTIONS, *SEVERAL, "pi"}
    assert all(hasattr(cb.math, name) for name in functions.__all__)


@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_the_examples_of_docstrings_run(module, registries):
    found = doctest.testmod(importlib.import_module(f"contactbench.{module}"))
    assert found.attempted
    assert not found.failed


# -- functions of plain numbers in a force ---------------------------------------------------------
ONE = {"name": "one", "q": (0.5,), "p": (0.0,), "t_end": 1.0, "gamma": 0.1}
MATH = cb.Mechanical(potential=lambda q: -math.cos(q[0]), gradient=lambda q: (math.sin(q[0]),), **ONE)
BARE = cb.Mechanical(potential=lambda q: -cos(q[0]), gradient=lambda q: (sin(q[0]),), **ONE)


@pytest.mark.parametrize(("scene", "name"), [(MATH, "math.sin"), (BARE, "sin")], ids=["math", "bare"])
@pytest.mark.parametrize("method", ["llvm", "diffrax-tsit5", "heyoka-taylor", "reference"])
def test_a_function_of_plain_numbers_is_named_with_its_line(scene, name, method):
    try:
        if method == "reference":
            cb.reference(scene, [1.0])
        if method == "llvm":
            message = cb.solve(scene, "rk4", step=0.1, engine=method).message
        else:
            message = cb.solve(scene, method, rtol=1e-6).message
    except cb.BadInput as error:
        message = str(error)
    assert f"{name} takes plain numbers only" in message
    assert "test_public.py, line" in message


def test_our_own_functions_are_not_named_where_their_argument_is_wrong():
    math = cb.math
    message = refusal(lambda: cb.Mechanical(potential=lambda q: math.cos({}), **ONE))
    assert "dict" in message
    assert "takes plain numbers only" not in message


def test_laws_of_such_a_force_say_why_they_have_no_number():
    assert cb.solve(BARE, "contact-rkn8", step=0.1).laws()["note"].str.contains("use cb.math.").any()


# -- steps -----------------------------------------------------------------------------------------
def test_a_solution_says_the_steps_it_took():
    even, uneven = (cb.solve("particle", "rk4", step=h, save_at=[20.0]) for h in (0.1, 0.3))
    assert (even.step_chosen, even.step) == (0.1, 0.1)
    assert uneven.step == 20.0 / uneven.counts.steps < 0.3 == uneven.step_chosen
    assert "step=0.3, 0.298507 taken" in repr(uneven)
    assert math.isnan(cb.solve("particle", "cvode-adams", rtol=1e-6).step)


@pytest.mark.parametrize("engine", ["llvm", "python"])
def test_the_step_chosen_from_a_tolerance_gives_the_same_run(engine):
    def same(method, rtol, save_at):
        given = {"method": method, "save_at": save_at, "engine": engine, "dense": False}
        chosen = cb.solve("particle", rtol=rtol, **given)
        assert np.array_equal(cb.solve("particle", step=chosen.step_chosen, **given).y, chosen.y)
        return chosen

    chosen = same("contact-rkn6", 1e-6, [20.0])
    assert 0 < chosen.step <= chosen.step_chosen
    capped = same("contact-strang", 1e-2, np.linspace(0, 20, 401))
    assert capped.step == pytest.approx(0.05 / 2)
    assert capped.step_chosen > 0.0251


# -- frames, laws, figures -------------------------------------------------------------------------
def test_a_solution_is_a_frame():
    solution = cb.solve("particle", "contact-strang", step=0.1)
    frame = solution.to_frame()
    assert list(frame.columns) == ["t", "q1", "q2", "p1", "p2", "s"]
    for columns in ("t", "s", ["p1", "p2"]):
        np.testing.assert_array_equal(frame[columns], getattr(solution, columns[0][0]))
    body = cb.solve("rigid_body", "contact-strang", step=0.5, carry=("R",)).to_frame()
    assert list(body.columns) == ["t", "M1", "M2", "M3", "R_w", "R_x", "R_y", "R_z"]


@pytest.mark.parametrize(
    ("scene", "carry"), [("central", ("s",)), ("central", ()), ("rigid_body_anisotropic", ())]
)
def test_its_laws_are_all_that_apply(scene, carry):
    solution = cb.solve(scene, "contact-strang", step=0.5, save_at=[5.0, 10.0], carry=carry)
    laws, fields = solution.laws(), cb.SCENES[scene].optional
    own = [law for law in laws_of(cb.SCENES[scene]) if {n for n in law.needs if n in fields} <= set(carry)]
    assert list(laws.index) == [law.name for law in own]
    for law in own:
        np.testing.assert_equal(laws.loc[law.name, "deviation"], LAWS[law.name](solution))
    assert (laws["note"] == "").all()


def test_a_law_without_a_number_says_why():
    short = cb.solve("particle", "rk4", step=0.1, max_steps=10).laws()
    assert short["deviation"].isna().all()
    assert set(short["note"]) == {"budget"}
    rest = cb.SCENES["quadratic_damping"].with_(q=(0.0, 0.0), p=(0.0, 0.0), s=0.0)
    laws = cb.solve(rest, "rk4", step=0.1, save_at=[1.0]).laws()
    assert math.isnan(laws.loc["hamiltonian_law", "deviation"])
    assert "H(0) = 0" in laws.loc["hamiltonian_law", "note"]


def test_the_command_line_writes_run_and_plot_and_prints_laws(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    line = ["solve", "central", "contact-strang", "--step", "0.1", "--t-end", "2", "--laws"]
    assert main([*line, "--plot", "run.svg", "--out", "run.csv"]) == 0
    assert {"momentum_law", "contact_drift"} <= set(capsys.readouterr().out.split())
    run = pd.read_csv("run.csv")
    assert (run["t"].iloc[-1], len(run)) == (2.0, 21)
    assert (tmp_path / "run.svg").read_text().count("<path") > 10
    assert main([*line, "--json"]) == 0
    assert '"momentum_law":' in capsys.readouterr().out


@pytest.mark.parametrize("scene", ["particle", "rigid_body"])
def test_a_solution_is_drawn(scene):
    solution = cb.solve(scene_of(scene), "contact-strang", step=0.1)
    figure = solution.plot()
    motion, portrait, energies = figure.axes
    first = solution.M if solution.q is None else solution.q
    np.testing.assert_array_equal(motion.lines[0].get_ydata(), first[:, 0])
    np.testing.assert_array_equal(portrait.lines[0].get_xdata(), first[:, 0])
    assert energies.lines[0].get_label() == "H0"
    pyplot.close(figure)


def test_the_law_of_h_is_where_h_is():
    """H decays as e^{−γt}; measured 1.5e-3 away at h = 0.1 and 3.7e-4 at 0.05, as order two says."""
    gaps = []
    for h in (0.1, 0.05):
        lines = {name: y for name, y, _ in cb.solve("particle", "contact-strang", step=h).energies()}
        gaps.append(np.abs(lines["H"] - lines["law of H"]).max())
    assert 3 < gaps[0] / gaps[1] < 5
    assert gaps[1] < 4e-4


def test_notebooks_show_short_tables():
    for shown in (cb.solve("particle", "rk4", step=0.1), cb.SCENES["particle"], cb.SCENES, cb.METHODS):
        html = shown._repr_html_()
        assert (html[:7], html[-8:]) == ("<table>", "</table>")
        assert html.count("<tr>") < 60
        assert "<lambda>" not in html


# -- names in the package ----------------------------------------------------------------------------
ROOMS = ("runs", "questions", "report", "gate", "measure")
#: names of documents that are about a method or a scene, and of the formulas that are known of one
MOST = 30


def literals(path):
    """The names of methods and scenes that a module writes as text of its own."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and node.value in OWN]


def test_few_names_of_methods_and_scenes_stand_in_what_runs_and_tells():
    found = {
        f"{room}/{path.name}": names
        for room in ROOMS
        for path in sorted((SOURCE / room).rglob("*.py"))
        if (names := literals(path))
    }
    count = sum(map(len, found.values()))
    assert count <= MOST, f"{count}: {found}"


# -- the plain install, without the packages of its extras -------------------------------------------
PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]
#: the names by which they are imported
EXTRAS = ("jax", "jaxlib", "numba", "diffrax", "optimistix", "equinox", "sksundae", "heyoka", "CyRK", "gmpy2")


def without_extras(code):
    """What a program prints where none of the extras' packages can be imported."""
    hidden = f"import sys, time\nsys.modules.update(dict.fromkeys({EXTRAS!r}))\n"
    hidden += (
        "time.perf_counter = time.process_time\nimport contactbench as cb\n"  # of a race, not of the machine
    )
    done = run(sys.executable, "-c", hidden + textwrap.dedent(code))
    assert not done.returncode, done.stderr
    return done.stdout


def test_the_plain_install_solves_measures_and_races():
    printed = without_extras("""
        solution = cb.solve("oscillator", "contact-rkn6", step=0.1)
        print(solution.status, len(solution.laws()) > 5)
        well = cb.Mechanical(name="w", potential=lambda q: q[0] ** 4 / 4, q=(1.0,), p=(0.0,), gamma=0.2, t_end=1.0)
        frame = cb.compare(well, ["contact-rkn6", "rk4", "scipy-dop853", "cvode-adams"], errors=[1e-3], budget=60)
        print(*frame["status"])
    """)
    assert printed.splitlines()[0] == "ok True"
    assert printed.splitlines()[1].split() == ["ok", "ok", "ok", "unsupported"]


def test_what_is_missing_is_one_line_with_the_command():
    printed = without_extras("""
        for name, method in cb.METHODS.items():
            setting = {"rtol": 1e-6} if method.adaptive else {} if method.control == "exact" else {"step": 0.1}
            if getattr(method, "package", ""):
                print(name, "|", cb.solve("kepler", name, **setting).message)
        try:
            cb.diffrax
        except ImportError as error:
            print("cb.diffrax |", error)
    """)
    said = dict(line.split(" | ") for line in printed.splitlines())
    for name in ("cvode-adams", "heyoka-taylor", "cyrk-dop853", "diffrax-tsit5", "cb.diffrax"):
        assert re.fullmatch(r"[\w-]+ is not installed: pip install [\w -]+", said[name]), (name, said[name])


def test_a_method_is_checked_and_timed_on_the_engines_that_are_there():
    printed = without_extras("""
        from contactbench import cli
        from contactbench.runs.grid import engines
        from contactbench.testing import check_method
        found = check_method(cb.METHODS["rk4"], scenes=[cb.SCENES["oscillator"]])
        print("checked", sorted({each.engine for each in found}))
        cli.main(["list", "methods"])
        print("timed", engines(cb.SCENES["particle"], cb.METHODS["cvode-adams"]))
        try:
            check_method(cb.METHODS["diffrax-tsit5"], engines=["jax"])
        except cb.BadInput as error:
            print(error)
    """)
    assert "checked ['llvm', 'python']" in printed
    assert "heyoka is not installed: pip install heyoka" in " ".join(printed.split())
    assert "timed ['c']" in printed
    assert printed.endswith("engine jax: diffrax is not installed: pip install diffrax optimistix\n")


def names(requirements):
    return {re.match(r"[\w-]+", each)[0] for each in requirements}


@pytest.mark.parametrize("name", [*INSTALLED_AS.values(), "jax", "heyoka", "CyRK"])
def test_the_command_names_packages_of_the_extras(name):
    required = names(each for group in PROJECT["optional-dependencies"].values() for each in group)
    assert {*name.split()} <= required


def test_nothing_of_an_extra_is_required():
    extras = {"jax", "diffrax", "optimistix", "scikit-sundae", "heyoka", "CyRK"}
    assert not names(PROJECT["dependencies"]) & extras
    assert {getattr(method, "package", "") for method in cb.METHODS.values()} <= {*EXTRAS, "scipy", ""}
