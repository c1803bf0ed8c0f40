"""contactbench: contact splitting integrators against the established ones, measured."""

import contextlib
import os

# Single trajectories are timed on one thread; XLA reads its flags when JAX is first imported.
os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")

import jax

jax.config.update("jax_enable_x64", True)
# Results are waited for at once: a hand-over to a worker thread would only add its wake-up, 50 µs a call.
jax.config.update("jax_cpu_enable_async_dispatch", False)
# A device per core this process may use, for ensembles to be sharded over; a choice already made stands.
if jax.config.jax_num_cpu_devices < 0 and "device_count" not in os.environ["XLA_FLAGS"]:
    with contextlib.suppress(RuntimeError):  # jax is running already, with the devices it has
        affinity = getattr(os, "sched_getaffinity", None)
        jax.config.update("jax_num_cpu_devices", len(affinity(0)) if affinity else os.cpu_count() or 1)

from contactbench.ensembles import Ensemble, ensemble  # noqa: E402
from contactbench.errors import BadInput, UnknownName  # noqa: E402
from contactbench.measure.laws import LAWS  # noqa: E402
from contactbench.methods import METHODS, fixed_step, prepare, solve  # noqa: E402
from contactbench.plugins import load_installed  # noqa: E402
from contactbench.scene import Mechanical, RigidBody, shifted  # noqa: E402
from contactbench.scenes import SCENES  # noqa: E402
from contactbench.solution import Counts, Solution, Status  # noqa: E402
from contactbench.truth.reference import reference  # noqa: E402

__all__ = [
    "LAWS",
    "METHODS",
    "SCENES",
    "BadInput",
    "Counts",
    "Ensemble",
    "Mechanical",
    "RigidBody",
    "Solution",
    "Status",
    "UnknownName",
    "ensemble",
    "fixed_step",
    "prepare",
    "reference",
    "shifted",
    "solve",
]
__version__ = "0.1.0"

load_installed()
