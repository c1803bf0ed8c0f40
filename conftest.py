"""For the benchmark and the tests alike: ``--plugin FILE``, by which a user's own methods and scenes join in, one
thread for every engine, and one cache of the programs that JAX compiles, for all processes of this run and the next."""

from __future__ import annotations

import os

import pytest

#: one thread for every engine; read when the libraries are first imported
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
from contactbench.errors import BadInput
from contactbench.measure.isolation import settle
from contactbench.plugins import load_file

settle()  # JAX reads its settings when it is imported, here and in every process started from here


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("contactbench")
    group.addoption(
        "--plugin", action="append", default=[], metavar="FILE", help="Python file with methods or scenes"
    )


def pytest_configure(config: pytest.Config) -> None:
    try:
        for path in config.getoption("--plugin"):
            load_file(path)
    except BadInput as error:
        raise pytest.UsageError(str(error)) from None
