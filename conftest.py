"""``--plugin FILE``, for the benchmark and the tests alike: a user's own methods and scenes join in."""

from __future__ import annotations

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.getgroup("contactbench").addoption(
        "--plugin", action="append", default=[], metavar="FILE", help="Python file with methods or scenes"
    )


def pytest_configure(config: pytest.Config) -> None:
    # imported here: bench/conftest.py sets the number of threads before the libraries are loaded
    from contactbench.errors import BadInput
    from contactbench.plugins import load_file

    try:
        for path in config.getoption("--plugin"):
            load_file(path)
    except BadInput as error:
        raise pytest.UsageError(str(error)) from None
