"""What `import contactbench` and the shortest commands load, and what they leave as it is."""

from __future__ import annotations

import subprocess
import sys

import pytest

#: libraries, and parts of the package, that take long to load
HEAVY = {"jax", "numba", "matplotlib", "mpmath", "pandas", "diffrax", "heyoka", "sksundae", "CyRK"}
SOLVERS = {"scipy.integrate", "scipy.linalg", "scipy.optimize"}
PARTS = {
    f"contactbench.{part}" for part in ("ensembles", "gate", "race", "report", "results.store", "testing")
}
#: what only some programs need, and the list of claims: short commands do without
SELDOM = {"scipy", "numpy.polynomial", "difflib", "logging", "concurrent.futures", "contactbench.claims"}


def loaded(statement: str) -> str:
    """The modules that are there after a statement, one a line, whatever it prints itself."""
    program = (
        "import contextlib, io, os, sys; before = dict(os.environ)\n"
        f"with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit): {statement}\n"
        "assert before == dict(os.environ); print(*sys.modules, sep='\\n')"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert not done.stderr
    return done.stdout


@pytest.mark.parametrize(
    ("statement", "more"),
    [
        ("import contactbench", SELDOM),
        ("from contactbench.methods import METHODS", SELDOM),
        ("from contactbench.cli import main; main(['--help'])", SELDOM),
        ("from contactbench.cli import main; main(['list'])", set()),
    ],
)
def test_nothing_heavy_is_loaded_and_the_environment_is_left_alone(statement, more):
    found = set(loaded(statement).split())
    assert "contactbench" in found
    assert not found & (HEAVY | SOLVERS | PARTS | more)
