"""For the benchmark and the tests alike: ``--plugin FILE``, by which a user's own methods and scenes join in,
one cache of the programs that JAX compiles, shared by all processes of a run and by the runs after it, and an
end without tidying up."""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest


def keep_compiled_programs() -> None:
    """Let JAX keep its programs beside numba's, every one of them; a choice already made stands.

    JAX itself does not tell processors apart, as numba does: the folder's name does.
    """
    if "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    from llvmlite.binding import get_host_cpu_features, get_host_cpu_name
    from platformdirs import user_cache_path

    processor = f"{get_host_cpu_name()} {get_host_cpu_features().flatten()}"
    chosen = os.environ.get("CONTACTBENCH_CACHE")
    folder = Path(chosen) if chosen else user_cache_path("contactbench")
    os.environ.update(
        JAX_COMPILATION_CACHE_DIR=str(folder / "xla" / hashlib.sha256(processor.encode()).hexdigest()[:16]),
        JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS="0",
        JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES="-1",
    )


keep_compiled_programs()  # JAX reads its settings when it is imported, here and in every process started from here


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("contactbench")
    group.addoption(
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


@pytest.hookimpl(wrapper=True, tryfirst=True)  # after pytest-xdist has told its controller that all is done
def pytest_sessionfinish(session: pytest.Session) -> Iterator[None]:
    """End a worker of pytest-xdist at once: it takes seconds to free thousands of compiled programs one by one,
    for which the controller waits."""
    yield
    if hasattr(session.config, "workerinput"):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0)
