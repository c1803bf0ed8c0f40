"""What the plain install does without the packages of its extras, and what it says of them."""

import re
import sys
import textwrap
import tomllib
from pathlib import Path

import pytest

import contactbench as cb
from cases import run
from contactbench.checks import INSTALLED_AS

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
        frame = cb.compare(well, ["contact-rkn6", "rk4", "scipy-dop853", "cvode-adams"], errors=[1e-3], budget=6)
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
