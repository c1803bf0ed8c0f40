"""JAX, imported and configured when something first uses it: ``from contactbench.xla import jax, jnp, lax``.

The settings hold for the whole process: double precision; results are waited for at once; a trajectory runs
on one thread.  ``XLA_FLAGS`` that are set already stand.
"""

from __future__ import annotations

import importlib
import os
from functools import cache
from typing import TYPE_CHECKING, Any

from contactbench.checks import missing
from contactbench.errors import BadInput


@cache
def configure() -> None:
    """Import JAX and make its settings; raises `BadInput` where it is not installed."""
    if lacks := missing("jax"):
        raise BadInput(lacks)
    # read when JAX makes its first device
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
    import jax

    jax.config.update("jax_enable_x64", True)
    # a hand-over to a worker thread would only add its wake-up, 50 µs a call
    jax.config.update("jax_cpu_enable_async_dispatch", False)
    try:
        jax.devices()
    except Exception as error:  # an AssertionError too
        must = f"must be what JAX can run on here, as cpu ({error!r})"
        raise BadInput(f"JAX_PLATFORMS = {jax.config.jax_platforms}: {must}") from error


class Deferred:
    """A module that is imported when one of its attributes is first asked for."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        configure()
        return getattr(importlib.import_module(self._name), attribute)


if TYPE_CHECKING:
    import jax
    from jax import lax
    from jax import numpy as jnp
else:
    jax = Deferred("jax")
    jnp = Deferred("jax.numpy")
    lax = Deferred("jax.lax")
