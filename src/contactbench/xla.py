"""Import and configure JAX at its first use: ``from contactbench.xla import jax, jnp, lax``.

The settings hold for the whole process: no asynchronous dispatch, one thread per trajectory.  A user's ``XLA_FLAGS``
take precedence.  Double precision is the user's choice, except inside `doubles`.
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

    # waking a worker thread would add 50 µs per call
    jax.config.update("jax_cpu_enable_async_dispatch", False)
    try:
        jax.devices()
    except Exception as error:  # an AssertionError too
        must = f"must be what JAX can run on here, as cpu ({error!r})"
        raise BadInput(f"JAX_PLATFORMS = {jax.config.jax_platforms}: {must}") from error


@contextmanager
def doubles() -> Iterator[None]:
    """Enable double precision and compilation for this thread inside the block."""
    configure()
    import jax

    with jax.enable_x64(True), jax.disable_jit(False):
        yield


@cache
def configure_doubles() -> None:
    """Enable double precision for the whole process, as the paper's claims need."""
    configure()
    importlib.import_module("jax").config.update("jax_enable_x64", True)


class Deferred:
    """Stand for a module that is imported, with JAX configured, at the first access to an attribute."""

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
