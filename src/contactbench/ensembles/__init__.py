"""Ensembles: many trajectories of one scene at once, with a fixed-step method, in chunks of bounded memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from contactbench.checks import positive, switch, whole
from contactbench.ensembles.chunks import ENGINES, Task, results
from contactbench.ensembles.members import ENERGY, Statistic, decaying, members, overall, tally
from contactbench.errors import BadInput, excerpt
from contactbench.methods.base import METHODS, lookup, make_request
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.fixed_step_run import FixedStepRun
from contactbench.methods.loops import is_fixed
from contactbench.methods.prepared import Refused
from contactbench.scene import BodyState, DrivenState, Scene, State
from contactbench.scene.base import OwnState
from contactbench.solution import Counts, Status


@dataclass(frozen=True)
class Ensemble:
    """Hold the result of `ensemble`.

    Attributes
    ----------
    scene, method
        What was integrated, and the name of the method.
    t
        The measured times, (k,).
    statistics, endings
        Mean and maximum of every measure, and how many trajectories ended `ok` and `diverged`, over all processes.
    counts
        The cost of one trajectory.
    final
        The states at the end of this process's trajectories, of arrays (n,), NaN where one diverged.  This and the
        following are None where nothing was kept.
    measures
        An array (n,) for `energy_change`, H0(y(T))/H0(y₀) − 1, and for those of `hamiltonian_law` and
        `momentum_law` the scene has, maxima over the measured times as in `LAWS`.
    end_time
        The last measured time a trajectory reached, (n,).
    """

    scene: Scene
    method: str
    t: np.ndarray
    counts: Counts
    statistics: dict[str, Statistic]
    endings: dict[Status, int]
    final: OwnState = None
    measures: dict[str, np.ndarray] | None = None
    end_time: np.ndarray | None = None

    def __repr__(self) -> str:
        ends = ", ".join(f"{count} {status}" for status, count in self.endings.items() if count)
        return f"<Ensemble of {self.scene.name} by {self.method}: {ends}, to t = {self.t[-1]:.6g}>"

    @property
    def ok(self) -> np.ndarray | None:
        """Return which of this process's trajectories did not diverge."""
        return None if self.end_time is None else self.end_time == self.t[-1]


def ensemble(
    scene: Scene | str,
    method: str,
    initial_conditions: State | BodyState | DrivenState | Mapping[str, object],
    *,
    step: float | Sequence[float] | np.ndarray,
    measure_at: Sequence[float] | np.ndarray | None = None,
    parameters: Mapping[str, object] | None = None,
    carry: Sequence[str] | None = None,
    keep: bool = True,
    chunk: int | None = None,
    progress: bool | None = None,
    engine: str | None = None,
    executor: Executor | None = None,
) -> Ensemble:
    """Integrate many trajectories of a scene with a fixed-step method.

    After `jax.distributed.initialize` every process calls with its own share of the trajectories.

    Parameters
    ----------
    scene
        Itself, or the name of a registered one.
    method
        The name of a fixed-step one.
    initial_conditions
        A State, BodyState or dict of fields, each component a number or an array (n,) with one entry per
        trajectory, of many sites q and p of shape (numbers, n); fields left out are the scene's own.
    step
        As in `prepare`.
    measure_at
        Increasing times at which divergence is noticed and laws are measured, the last of them the end; by default
        the scene's end time alone.
    parameters
        Numbers of the scene that differ from one trajectory to the next, by name, arrays (n,).
    carry
        Which of s and R to integrate; by default all the scene has.
    keep
        False returns the statistics alone, for ensembles larger than memory.
    chunk
        Trajectories per device, or per task of an executor, at a time.
    progress
        Whether to show a bar; by default on a terminal.
    engine
        "numba" (CPUs, one set of parameters for all) or "jax"; by default the first that can.
    executor
        Maps the chunks, each on one core of a worker: any executor of `concurrent.futures`, such as a process pool,
        Dask's ``Client.get_executor()`` or an MPI pool.  A chunk whose worker dies is run again.

    Returns
    -------
    Ensemble
        The final states and measures of this process, the statistics and endings of all.

    Raises
    ------
    BadInput
        For an unknown name, a method whose steps are not fixed, a value of the wrong shape or out of range, and an
        engine that cannot run the scene.

    Examples
    --------
    >>> import contactbench as cb
    >>> found = cb.ensemble("oscillator", "contact-strang", {"q": ([0.5, 1.0],)}, step=0.1, engine="numba")
    >>> found.endings[cb.Status.ok]
    2
    """
    from tqdm import tqdm

    scene, chosen = lookup(scene, method)
    if not isinstance(chosen, FixedStep):
        fixed = ", ".join(name for name, other in METHODS.items() if isinstance(other, FixedStep))
        raise BadInput(f"method = {excerpt(method)}: an ensemble takes a fixed-step method: {fixed}")
    times = [scene.t_end] if measure_at is None else measure_at
    request = make_request(scene, chosen, step, save_at=times, carry=carry)
    if isinstance(request, Refused):
        raise BadInput(request.why)
    if not is_fixed(chosen):
        chosen.try_step(scene, request.carry, request.step)
    run = FixedStepRun(method, request, chosen)
    if engine is not None and not (isinstance(engine, str) and engine in ENGINES):
        raise BadInput(f"engine = {excerpt(engine)}: an ensemble runs on {' or '.join(ENGINES)}")
    if run.needed > request.max_steps:
        why = f"step = {excerpt(step)}: {run.needed} steps, of which {request.max_steps} are allowed"
        raise BadInput(why)
    switch("keep", keep)
    if progress is not None:
        switch("progress", progress)
    if executor is not None and not isinstance(executor, Executor):
        raise BadInput(f"executor = {excerpt(executor)}: must be an executor, as in concurrent.futures")
    chunk = None if chunk is None else whole("chunk", chunk, 10**12)
    y0, own = members(scene, request.carry, initial_conditions, {} if parameters is None else parameters)
    run.require_clock(y0)
    names = [ENERGY, *decaying(scene, request.carry)]
    end, n = request.save_at[-1], y0.shape[1]
    rows: dict[int, np.ndarray] = {}
    kept = [np.empty((len(y0), n)), np.empty((len(names), n)), np.empty(n)] if keep else []
    task = Task(request, method, tuple(names), engine)
    hide = None if progress is None else not progress
    with tqdm(total=n, unit="trajectory", unit_scale=True, disable=hide) as bar:
        for first, result in results(task, run, y0, own, chunk, executor):
            _, measures, end_time = result
            rows[first] = tally(measures, end_time == end)
            for everything, part in zip(kept, result if keep else (), strict=True):
                everything[..., first : first + len(end_time)] = part
            bar.update(len(end_time))
    statistics, endings = overall(names, [rows[first] for first in sorted(rows)])
    found = Ensemble(scene, method, request.save_at, run.totals, statistics, endings)
    if not keep:
        return found
    y, measures, end_time = kept
    final, by_name = scene.unpack(scene.components(y), request.carry), dict(zip(names, measures, strict=True))
    return replace(found, final=final, measures=by_name, end_time=end_time)
