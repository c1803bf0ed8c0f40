"""JAX, imported and configured when something first uses it: ``from contactbench.xla import jax, jnp, lax``.

These settings hold for the whole process: results are waited for at once; a trajectory runs on one thread.
``XLA_FLAGS`` that are set already stand.  Double precision is the user's to choose, but for what runs in `doubles`.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any

from contactbench.checks import missing
from contactbench.errors import BadInput


@cache
def configure() -> None:
    """Import and configure JAX; raise `BadInput` if it is not installed."""
    if lacks := missing("jax"):
        raise BadInput(lacks)
    # read when JAX makes its first device
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
    import jax

    # a hand-over to a worker thread would only add its wake-up, 50 µs a call
    jax.config.update("jax_cpu_enable_async_dispatch", False)
    try:
        jax.devices()
    except Exception as error:  # an AssertionError too
        must = f"must be what JAX can run on here, as cpu ({error!r})"
        raise BadInput(f"JAX_PLATFORMS = {jax.config.jax_platforms}: {must}") from error


@contextmanager
def doubles() -> Iterator[None]:
    """Have this thread compute in double precision, and compile, inside."""
    configure()
    import jax

    with jax.enable_x64(True), jax.disable_jit(False):
        yield


@cache
def configure_doubles() -> None:
    """Have the whole process compute in double precision: for the paper's claims."""
    configure()
    importlib.import_module("jax").config.update("jax_enable_x64", True)


class Deferred:
    """A module that is imported, with JAX configured, at the first access to an attribute."""

    def __init__(self, name: str, configure: Callable[[], None] = configure) -> None:
        self._name, self._configure = name, configure

    def __getattr__(self, attribute: str) -> Any:
        self._configure()
        return getattr(importlib.import_module(self._name), attribute)


if TYPE_CHECKING:
    import jax
    from jax import lax
    from jax import numpy as jnp

    jax_doubles, jnp_doubles = jax, jnp
else:
    jax = Deferred("jax")
    jnp = Deferred("jax.numpy")
    lax = Deferred("jax.lax")
    jax_doubles, jnp_doubles = (Deferred(name, configure_doubles) for name in ("jax", "jax.numpy"))
