"""Ensembles: many trajectories of one scene at once, with a fixed-step method.

Every process integrates the trajectories it is given.  It cuts them into chunks, so that memory stays
bounded, and divides each chunk among its devices: the cores of a CPU, or its GPUs.  On a CPU the loop is the
one numba compiles, for so many trajectories at a time that the processor always has one to go on with; a
thread runs on every core.  GPUs, parameters that differ from one trajectory to the next and methods that
cannot be recorded go to JAX, tile by tile, one array per component.  Processes meet once, for the statistics.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from contactbench.errors import BadInput, finite, positive, unknown_name
from contactbench.measure.deviation import conformal_deviation
from contactbench.measure.laws import LAWS
from contactbench.methods.base import METHODS, Refused
from contactbench.methods.compiled import XlaNumbers
from contactbench.methods.entry import lookup, prepare
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.fixed_step_run import FixedStepRun
from contactbench.methods.jax_engine import rolled
from contactbench.methods.llvm import compiled
from contactbench.methods.numba_engine import Loop, loop_of
from contactbench.numbers.recording import CannotRecord
from contactbench.scene import BodyState, Scene, State, quaternion_of
from contactbench.solution import DIVERGENCE, Counts, Status

#: trajectories a core integrates at a time: half a kilobyte per component
TILE = 64
#: trajectories a device is handed at a time: enough for the call not to count
CHUNK = {"cpu": 2**14, "gpu": 2**20}
ENGINES = ("numba", "jax")
AXIS = "trajectories"
#: trajectories a compiled loop integrates side by side: with fewer each waits for its own last operation
LANES = 32

Measured = Callable[[Scene, Any], Any]
#: laws of the numerical solution alone, with the quantity that must decay as e^{−γt} and the size of its terms
DECAYING: dict[str, tuple[Measured, Measured]] = {
    "hamiltonian_law": (
        lambda scene, x: (scene.hamiltonian(x),),
        lambda scene, x: scene.hamiltonian_terms(x),
    ),
    "momentum_law": (lambda scene, x: scene.momentum(x), lambda scene, x: scene.momentum_terms(x)),
}
#: H0(y(T))/H0(y₀) − 1: no law, but how much of the energy is gone
ENERGY = "energy_change"


class Statistic(NamedTuple):
    """Over the trajectories that ended `ok`; nan if none did."""

    mean: float
    max: float


@dataclass(frozen=True)
class Ensemble:
    """What `ensemble` returns.

    statistics : mean and maximum of every measure.  endings : how many trajectories ended `ok` and how
    many `diverged`.  Both are over all processes.  counts : what one trajectory cost.
    The rest is of this process's trajectories, and None where it was not kept:
    final : the states at the end, of arrays (n,), NaN where a trajectory diverged.
    measures : an array (n,) for `energy_change`, H0(y(T))/H0(y₀) − 1, and for those of
    `hamiltonian_law` and `momentum_law` the scene has, maxima over the measured times as in `LAWS`.
    end_time : the last measured time a trajectory reached, (n,).
    """

    scene: Scene
    method: str
    t: np.ndarray
    counts: Counts
    statistics: dict[str, Statistic]
    endings: dict[Status, int]
    final: Any = None
    measures: dict[str, np.ndarray] | None = None
    end_time: np.ndarray | None = None

    @property
    def ok(self) -> np.ndarray | None:
        """Which of this process's trajectories did not diverge."""
        return None if self.end_time is None else self.end_time == self.t[-1]


def ensemble(
    scene: Scene | str,
    method: str,
    initial_conditions: State | BodyState | Mapping[str, Any],
    *,
    step: float,
    measure_at: Sequence[float] | np.ndarray | None = None,
    parameters: Mapping[str, Any] | None = None,
    carry: Sequence[str] | None = None,
    keep: bool = True,
    chunk: int | None = None,
    progress: bool | None = None,
    engine: str | None = None,
) -> Ensemble:
    """Integrate many trajectories of a scene with a fixed-step method.

    initial_conditions : a State, BodyState or dict of fields, each component a number or an array (n,)
        with one entry per trajectory; fields left out are the scene's own.
    step : as in `prepare`.  measure_at : increasing times at which divergence is noticed and laws are
        measured, the last of them the end; by default the scene's end time alone.
    parameters : numbers of the scene that differ from one trajectory to the next, by name, arrays (n,).
    carry : which of s and R to integrate; by default all the scene has.
    keep : False returns the statistics alone, for ensembles larger than memory.
    chunk : trajectories per device at a time.  progress : show a bar; by default on a terminal.
    engine : "numba" (CPUs, one set of parameters for all) or "jax"; by default the first that can.
    After `jax.distributed.initialize` every process calls with its own share of the trajectories.
    Raises `BadInput` for anything it cannot work with.
    """
    from tqdm import tqdm

    scene, chosen = lookup(scene, method)
    if not isinstance(chosen, FixedStep):
        fixed = ", ".join(name for name, other in METHODS.items() if isinstance(other, FixedStep))
        raise BadInput(f"method = {method!r}: an ensemble takes a fixed-step method: {fixed}")
    run = prepare(
        scene, method, step=positive("step", step), carry=carry, engine=chosen.engines[-1],
        save_at=[scene.t_end] if measure_at is None else measure_at,
    )  # fmt: skip
    if isinstance(run, Refused):
        raise BadInput(run.why)
    assert isinstance(run, FixedStepRun)
    if engine not in (None, *ENGINES):
        raise BadInput(f"engine = {engine!r}: an ensemble runs on {' or '.join(ENGINES)}")
    request = run.request
    if run.n.sum() > request.max_steps:
        raise BadInput(f"step = {step!r}: {run.n.sum()} steps, of which {request.max_steps} are allowed")
    y0, own = members(scene, request.carry, initial_conditions, parameters or {})
    names = [ENERGY, *decaying(scene, request.carry)]
    end = request.save_at[-1]
    rows, kept = [], []
    hide = None if progress is None else not progress
    with tqdm(total=y0.shape[1], unit="trajectory", unit_scale=True, disable=hide) as bar:
        for y, measures, end_time in integrated(run, names, y0, own, _chunk(chunk), engine):
            rows.append(tally(measures, end_time == end))
            if keep:
                kept.append((y, measures, end_time))
            bar.update(len(end_time))
    statistics, endings = overall(names, rows)
    if not keep:
        return Ensemble(scene, method, request.save_at, run.totals, statistics, endings)
    y, measures, end_time = (np.concatenate(parts, axis=-1) for parts in zip(*kept, strict=True))
    return Ensemble(
        scene, method, request.save_at, run.totals, statistics, endings,
        scene.unpack(tuple(y), request.carry), dict(zip(names, measures, strict=True)), end_time,
    )  # fmt: skip


def _chunk(value: int | None) -> int | None:
    if value is not None and (isinstance(value, bool) or int(value) != value or value < 1):
        raise BadInput(f"chunk = {value!r}: must be a whole number ≥ 1")
    return value


# -- what goes in ----------------------------------------------------------------------------------
def members(
    scene: Scene, carry: tuple[str, ...], given: Any, parameters: Mapping[str, Any]
) -> tuple[np.ndarray, dict[int, np.ndarray]]:
    """Packed initial states (d, n), and by its place among the scene's numbers each parameter (n,)."""
    if isinstance(given, State | BodyState):
        given = {name: value for name, value in given._asdict().items() if value is not None}
    if not isinstance(given, Mapping):
        raise BadInput(f"initial_conditions = {type(given).__name__}: must be a State, BodyState or dict")
    for name in given:
        if name not in scene.initial_fields:
            raise unknown_name(f"initial value of scene {scene.name!r}", name, scene.initial_fields)
    columns: dict[str, np.ndarray] = {}
    carried = {name for name, part in scene.initial(carry)._asdict().items() if part is not None}
    for name in scene.initial_fields:
        if name not in carried:
            continue
        default = getattr(scene, name)
        value = given.get(name, default)
        if not isinstance(default, tuple):
            columns[name] = _column(name, value)
            continue
        try:
            parts = tuple(value)
        except TypeError:  # one number: the identity may be written as 1
            parts = quaternion_of(value) if name == "R" else (value,)
        if len(parts) != len(default):
            wanted = f"{len(default)} components, each a number or an array"
            raise BadInput(f"{name}: must be {wanted}; got {len(parts)}")
        columns |= {f"{name}[{i}]": _column(f"{name}[{i}]", part) for i, part in enumerate(parts)}
    states = list(columns)
    columns |= {name: _parameter(scene, name, value) for name, value in parameters.items()}
    sizes = {name: len(column) for name, column in columns.items() if column.ndim}
    if len(set(sizes.values())) != 1:
        told = ", ".join(f"{name} {size}" for name, size in sizes.items()) or "none is an array"
        raise BadInput(f"initial_conditions: arrays of one length, one entry per trajectory; got {told}")
    (n,) = set(sizes.values())
    if n == 0:
        raise BadInput("initial_conditions: no trajectories, arrays of length 0")
    y0 = np.array([np.broadcast_to(columns[name], n) for name in states])
    if "R" in carry:
        length = np.linalg.norm(y0[3:7], axis=0)
        if (worst := np.abs(length - 1).max()) > 1e-12:
            raise BadInput(f"R: must be unit quaternions (w, x, y, z); one is off by {worst:.3g}")
    places = scene.number_names()
    return y0, {places.index(name): np.broadcast_to(columns[name], n) for name in parameters}


def _column(name: str, value: Any) -> np.ndarray:
    """A number or a one-dimensional array of finite numbers, or `BadInput`."""
    try:
        column = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise BadInput(f"{name} = {value!r}: must be a number or an array of numbers") from None
    if column.ndim > 1:
        raise BadInput(f"{name}: must be a number or an array (n,), got shape {column.shape}")
    if not np.isfinite(column).all():
        where = int(np.argmin(np.isfinite(column)))
        raise BadInput(f"{name}: must be finite numbers, entry {where} is {column.flat[where]}")
    return column


def _parameter(scene: Scene, name: str, value: Any) -> np.ndarray:
    """Values of a parameter, each of which the scene accepts without becoming another problem."""
    allowed = [known for known in scene.number_names() if known]
    if name not in allowed:
        raise unknown_name(f"parameter of an ensemble of scene {scene.name!r}", name, allowed)
    column = _column(name, value)
    for extreme in (column.min(initial=np.inf), column.max(initial=-np.inf)) if column.size else ():
        if scene.with_(**{name: finite(name, extreme)}).structure != scene.structure:
            raise BadInput(f"{name}: {extreme} makes scene {scene.name!r} another problem; change the scene")
    return column


# -- the program -----------------------------------------------------------------------------------
def decaying(scene: Scene, carry: tuple[str, ...]) -> list[str]:
    """The decay laws that are defined on a scene and read only what is carried."""
    if scene.conformal_rate is None:  # the rate follows s: what is true is not known
        return []
    return [
        name for name in DECAYING if LAWS[name].applies(scene) and {*LAWS[name].needs_on(scene)} <= {*carry}
    ]


_programs: dict[Any, Callable[..., Any]] = {}


def integrated(
    run: FixedStepRun,
    names: list[str],
    y0: np.ndarray,
    own: dict[int, np.ndarray],
    chunk: int | None,
    engine: str | None,
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Final states (d, m), measures (·, m) and end times (m,) of one chunk after the other."""
    from contactbench.xla import jax

    devices = jax.local_devices()
    why = "" if devices[0].platform == "cpu" else f"it runs on a CPU, not on {devices[0].platform}"
    why = why or ("parameters differ from one trajectory to the next" if own else "")
    if engine != "jax" and not why:
        try:
            loop = loop_of(run.method_, run.request.scene, run.request.carry)
        except CannotRecord as error:
            why = str(error)
        else:
            yield from on_cores(run, loop, names, y0, len(devices), chunk or CHUNK["cpu"])
            return
    if engine == "numba":
        raise BadInput(f"engine = 'numba': {why}; leave the choice open, or take 'jax'")
    from jax.sharding import Mesh, NamedSharding, PartitionSpec

    mesh = Mesh(np.array(devices), (AXIS,))
    platform = mesh.devices.flat[0].platform
    at_once = mesh.size * (chunk or CHUNK.get(platform, CHUNK["gpu"]))
    n = y0.shape[1]
    count = -(-n // -(-n // at_once))  # in chunks of one size, that of a single program
    share = -(-count // mesh.size)
    tile = min(TILE, share) if platform == "cpu" else share
    size = mesh.size * tile * -(-share // tile)
    r, places = run.request, tuple(own)
    key = (r.scene.structure, r.carry, run.method_, tuple(names), places, tile, mesh)
    if key not in _programs:
        cut, whole = PartitionSpec(None, AXIS), PartitionSpec()
        _programs[key] = jax.jit(
            jax.shard_map(
                share_of(run, names, places, tile), mesh=mesh, in_specs=(cut, cut, whole, whole),
                out_specs=(cut, cut, PartitionSpec(AXIS)), check_vma=False,
            )
        )  # fmt: skip
    sharding = NamedSharding(mesh, PartitionSpec(None, AXIS))
    individual = np.array([*own.values()]).reshape(len(own), n)
    numbers = np.array(r.scene.numbers())
    ends = r.save_at[1:] if run.saves_start else r.save_at

    def begun(part: slice) -> Any:
        filled = ((0, 0), (0, size - (part.stop - part.start)))  # the last trajectory again and again
        arrays = (np.pad(a[:, part], filled, mode="edge") for a in (y0, individual))
        return _programs[key](*jax.device_put(tuple(arrays), sharding), numbers, (run.h, run.n, ends))

    parts = [slice(first, min(first + count, n)) for first in range(0, n, count)]
    ahead = begun(parts[0])
    for part, following in zip(parts, [*parts[1:], None], strict=True):
        out = ahead
        if following is not None:  # begun before this one is waited for: no device idles at its end
            ahead = begun(following)
        yield tuple(np.asarray(a)[..., : part.stop - part.start] for a in out)  # type: ignore[misc]


def on_cores(
    run: FixedStepRun, loop: Loop, names: list[str], y0: np.ndarray, cores: int, chunk: int
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """The same by the loop numba compiles, a thread on every core."""
    many = compiled(loop.program.many, LANES).many
    n = y0.shape[1]
    share = min(chunk, -(-n // cores))
    parts = [y0[:, first : first + share] for first in range(0, n, share)]
    with ThreadPoolExecutor(cores) as threads:
        for first in range(0, len(parts), cores):
            mine = parts[first : first + cores]
            done = threads.map(lambda part: side_by_side(run, loop, many, names, part), mine)
            yield tuple(np.concatenate(arrays, axis=-1) for arrays in zip(*done, strict=True))  # type: ignore[misc]


def side_by_side(
    run: FixedStepRun, loop: Loop, many: Callable[..., Any], names: list[str], y0: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Final states (d, m), measures (·, m) and end times (m,) of some trajectories, on one core."""
    r, m = run.request, y0.shape[1]
    scene = r.scene
    rows, shape = loop.rows(np.array(scene.numbers()), run.h, run.n)
    y = np.pad(y0, ((0, 0), (0, -m % LANES)), mode="edge")  # the last trajectory again and again
    part, place = np.array([0, y.shape[1] // LANES]), len(loop.program.shape)
    times = r.save_at[1:] if run.saves_start else r.save_at

    def quantity(name: str, x: Any) -> Any:
        return np.stack(np.broadcast_arrays(*DECAYING[name][0](scene, x)), axis=-1)

    start = scene.unpack(tuple(y0), r.carry)
    size = np.linalg.norm(y0[: run._motion], axis=0)
    bound = DIVERGENCE * np.where(size > 0, size, 1.0)
    alive, end = np.ones(m, dtype=bool), np.zeros(m)
    with np.errstate(all="ignore"):
        origin = {name: quantity(name, start) for name in names[1:]}
        worst = {name: np.zeros(m) for name in origin}
        for which, t in zip(shape[place:], times, strict=True):
            after = np.empty((1, *y.shape))
            many(y, rows, np.append(shape[:place], which), after, part)
            y = after[0]
            x = scene.unpack(tuple(y[:, :m]), r.carry)
            alive &= np.isfinite(y[:, :m]).all(axis=0) & (np.abs(y[: run._motion, :m]).max(axis=0) <= bound)
            end = np.where(alive, t, end)
            for name, first in origin.items():
                terms = DECAYING[name][1](scene, x)
                law = conformal_deviation(quantity(name, x), first, t, scene.conformal_rate, terms)
                worst[name] = np.maximum(worst[name], law)
        energy = scene.energy(x) / scene.energy(start) - 1
    measures = np.array([energy, *worst.values()])
    return np.where(alive, y[:, :m], np.nan), np.where(alive, measures, np.nan), end


def share_of(run: FixedStepRun, names: list[str], places: tuple[int, ...], tile: int) -> Callable[..., Any]:
    """What one device does: its part of a chunk, tile by tile."""
    from contactbench.xla import jnp, lax

    base, carry, motion, xp = run.request.scene, run.request.carry, run._motion, XlaNumbers()

    def one_tile(y0: Any, own: Any, numbers: Any, spans: Any) -> Any:
        values = list(numbers)
        for place, value in zip(places, own, strict=True):
            values[place] = value
        scene = base.with_numbers(values)

        def quantity(name: str, x: Any) -> Any:
            return jnp.stack(DECAYING[name][0](scene, x), axis=-1)

        start = scene.unpack(tuple(y0), carry)
        bound = DIVERGENCE * scale(y0[:motion])
        origin = {name: quantity(name, start) for name in names[1:]}

        def span(carried: Any, interval: Any) -> Any:
            (x, worst, alive, end), (h, n, t) = carried, interval
            # parameters of its own give every trajectory stage constants of its own
            h = jnp.broadcast_to(h, tile) if places else h
            x = run.method_.advance(scene, x, h, n, xp, rolled)
            y = jnp.stack(scene.pack(x))
            alive = alive & jnp.isfinite(y).all(axis=0) & (jnp.abs(y[:motion]).max(axis=0) <= bound)
            for name in origin:
                terms, rate = DECAYING[name][1](scene, x), scene.conformal_rate
                law = conformal_deviation(quantity(name, x), origin[name], t, rate, terms, jnp)
                worst = {**worst, name: jnp.maximum(worst[name], law)}
            return (x, worst, alive, jnp.where(alive, t, end)), None

        nothing = jnp.zeros(tile)
        begun = (start, dict.fromkeys(origin, nothing), jnp.ones(tile, bool), nothing)
        (x, worst, alive, end), _ = lax.scan(span, begun, spans)
        energy = scene.energy(x) / scene.energy(start) - 1
        measures = jnp.stack([energy, *worst.values()])
        return *(jnp.where(alive, a, jnp.nan) for a in (jnp.stack(scene.pack(x)), measures)), end

    def share(y0: Any, own: Any, numbers: Any, spans: Any) -> Any:
        tiles = [a.reshape(len(a), a.shape[1] // tile, tile).swapaxes(0, 1) for a in (y0, own)]
        y, measures, end = lax.map(lambda part: one_tile(part[0], part[1], numbers, spans), tiles)
        return *(a.swapaxes(0, 1).reshape(a.shape[1], -1) for a in (y, measures)), end.reshape(-1)

    def scale(motion: Any) -> Any:
        size = jnp.sqrt((motion * motion).sum(axis=0))
        return jnp.where(size > 0, size, 1.0)

    return share


# -- statistics ------------------------------------------------------------------------------------
def tally(measures: np.ndarray, ok: np.ndarray) -> np.ndarray:
    """One row: how many are ok, how many not, and the sums and maxima of the measures of those that are."""
    good = measures[:, ok]
    return np.array([ok.sum(), (~ok).sum(), *good.sum(axis=1), *good.max(axis=1, initial=-np.inf)])


def overall(names: list[str], rows: list[np.ndarray]) -> tuple[dict[str, Statistic], dict[Status, int]]:
    """Statistics and endings from the rows of all chunks of all processes."""
    from jax.experimental import multihost_utils

    from contactbench.xla import jax

    def joined(rows: Any) -> np.ndarray:
        rows, split = np.asarray(rows), 2 + len(names)
        return np.concatenate([rows[:, :split].sum(axis=0), rows[:, split:].max(axis=0)])

    row = joined(rows)
    if jax.process_count() > 1:
        row = joined(multihost_utils.process_allgather(row))
    ok, diverged, rest = int(row[0]), int(row[1]), row[2:].reshape(2, len(names))
    total, largest = rest if ok else np.full_like(rest, np.nan)
    statistics = {
        name: Statistic(float(s) / max(ok, 1), float(m))
        for name, s, m in zip(names, total, largest, strict=True)
    }
    return statistics, {Status.ok: ok, Status.diverged: diverged}
