"""How many trajectories a second?  One cell: a method at one setting, on a number of trajectories and cores.

Four questions: the same arithmetic as C loops (1024 trajectories over 200 000 gradients and more, so that the
call does not count); the cost of a trajectory at equal error; and how throughput depends on trajectories and on cores.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

import contactbench as cb
from contactbench.ensembles import ENGINES, Ensemble
from contactbench.measure.clock import Call, Part
from contactbench.measure.isolation import usable_cores
from contactbench.measure.laws import motion_size
from contactbench.methods.prepared import Refused
from contactbench.results.tables import ENSEMBLE_TABLE
from contactbench.scene import Mechanical, Scene, State
from contactbench.solution import keywords
from contactbench.study.c_loops import SHAPES, ensemble_kernel
from contactbench.study.choice import key
from contactbench.study.experiment import Cell, Profile, Recorded, Row, Timing, experiment, timed_experiment
from contactbench.study.timetable import last_cores

if TYPE_CHECKING:
    from jax import Array

#: a run, and what tells its steps, evaluations and their kind when it has been made; or why there is none
type Made = tuple[Callable[[], ArrayLike], Callable[[], tuple[int, int, str]]]

SAMPLE = 4
#: the share of trajectories of a second call, which tells what a call costs from what every trajectory does
FEWER = 1 / 4
STEPS: dict[str, tuple[float, ...]] = {
    "contact-strang": (0.1, 0.02, 0.004, 0.001),
    "contact-bm4": (0.8, 0.4, 0.16, 0.05),
}
STEPS |= {"contact-rkn6": (1.25, 0.8, 0.4, 0.16, 0.08), "contact-rkn8": (1.25, 0.8, 0.4, 0.2, 0.16)}
STEPS |= {"rk4": (0.2, 0.08, 0.04, 0.01)}
PEERS = [(f"diffrax-{name}", "jax", shape) for name in ("tsit5", "dopri8") for shape in ("vmap", "shared")]
PEERS += [("heyoka-taylor", "llvm", "batch"), ("cyrk-dop853", "c++", "loop"), ("cyrk-vern8", "c++", "loop")]
PEERS += [("cvode-adams", "c", "loop")]
#: trajectories of a peer that takes one after the other: more of them take no less each
LOOPED = 256
#: steps with which both methods evaluate so often that a call's own millisecond is lost
ARITHMETIC = {"contact-strang": 0.01, "contact-rkn6": 0.1}
RTOLS = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)
#: of a method of low order the finest are left to the full profile
COARSE = {"diffrax-tsit5": 1e-8}
OURS = "contact-rkn6"
#: (method, variant, value) of the smoke profile
SMOKE = {(OURS, "", 0.1), (OURS, "", 0.4), ("heyoka-taylor", "batch", 1e-6)}
SMOKE |= {("limit-c", f"{OURS} plain", 0.1)}


def ladder(profile: Profile) -> list[Cell]:
    """(question, scene, method, engine, variant, control, value, trajectories, cores)."""
    rows: list[Cell] = []
    for method, step in ARITHMETIC.items():
        runs = [(method, engine, "") for engine in ENGINES]
        runs += [("limit-c", "c", f"{method} {shape}") for shape in SHAPES]
        rows += [("arithmetic", "particle_long", *run, "step", step, 512, 1) for run in runs]
    for method, steps in STEPS.items():
        rows += [("error", "particle", method, ENGINES[0], "", "step", h, 4096, 1) for h in steps]
    for method, engine, variant in PEERS:
        n = LOOPED if variant == "loop" else 4096
        finest = 0.0 if profile.reaches("full") else COARSE.get(method, 0.0)
        rtols = [rtol for rtol in RTOLS if rtol >= finest]
        rows += [("error", "particle", method, engine, variant, "rtol", rtol, n, 1) for rtol in rtols]
    if (
        profile.brief
    ):  # one kernel, one setting of two methods; how many cores there are is the machine's affair
        return [row for row in rows if (row[2], row[4], row[6]) in SMOKE]
    sizes = [10**k for k in range(3, 8 if profile.reaches("full") else 6)]
    rows += [("size", "particle", OURS, ENGINES[0], "", "step", 0.4, n, 1) for n in sizes]
    most = len(usable_cores())
    cores = [*(2**k for k in range(most.bit_length()) if 2**k < most), most]
    rows += [("cores", "particle", OURS, ENGINES[0], "", "step", 0.1, 200_000, k) for k in cores]
    return rows


def initial(scene: Scene, n: int) -> np.ndarray:
    """Return states spread by 5 % about the scene's own, (d, n); the first few do not depend on n."""
    own = np.array(scene.pack(scene.initial(())))
    return own[:, None] + 0.05 * np.random.default_rng(7).normal(size=(n, len(own))).T


@cache
def truth(scene_name: str) -> np.ndarray:
    scene = cb.SCENES[scene_name]
    starts = (scene.unpack(tuple(y), ())._asdict() for y in initial(scene, SAMPLE).T.tolist())
    return np.array([cb.reference(scene.with_(q=x["q"], p=x["p"]), [scene.t_end], ()).y[0] for x in starts]).T


def error(scene: Scene, y: np.ndarray, exact: np.ndarray) -> float:
    size = motion_size(scene, initial(scene, SAMPLE).T, exact.T, ())
    return float(np.linalg.norm(y[:, :SAMPLE] - exact, axis=0).max() / size)


# -- ensembles by each engine ----------------------------------------------------------------------
# A run takes nothing and returns the final states (d, n) on the host, one array or one per component.
# Each peer is in its best shape of those tried: diffrax in tiles of trajectories that fit the first cache, both with
# steps of their own (vmap) and with steps they share (one system per tile, about twice as fast, its error control
# over the tile); heyoka in batches of the machine's vector width.
#: trajectories integrated together: the fastest of 64, 256 and all, for vmap and for shared steps
TILE = 64
#: trajectories for which its program is compiled
ROOM = 4096
SOLVERS = {"diffrax-tsit5": ("Tsit5", 6), "diffrax-dopri8": ("Dopri8", 13)}


def contact(scene: Scene, method: str, engine: str, value: float, y0: np.ndarray) -> Made:
    def solve(start: State) -> Ensemble:
        return cb.ensemble(scene, method, start, step=value, carry=(), progress=False, engine=engine)

    start = scene.unpack(tuple(np.ascontiguousarray(y0)), ())
    counts = solve(scene.unpack(tuple(y0[:, :1]), ())).counts
    costs = counts.steps or 0, counts.evaluations or 0, counts.kind
    return lambda: scene.pack(solve(start).final), lambda: costs


@cache
def diffrax_program(name: str, shape: str, scene_name: str) -> Callable[..., tuple[Array, Array]]:
    import diffrax

    from contactbench.xla import jax, jnp

    scene = cb.SCENES[scene_name]
    solver = getattr(diffrax, SOLVERS[name][0])()

    def solve(y: Array, tolerance: Array, end: Array) -> tuple[Array, Array]:
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, x, args: scene.rhs(x)),
            solver,
            0.0,
            end,
            None,
            scene.unpack(list(y), ()),
            saveat=diffrax.SaveAt(t1=True),
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
            max_steps=10**6,
            adjoint=diffrax.ForwardMode(),
            throw=False,
        )
        return jnp.stack([c[0] for c in scene.pack(solution.ys)]), solution.stats["num_steps"]

    if shape == "vmap":
        solve = jax.vmap(solve, in_axes=(1, None, None), out_axes=(1, 0))

    def tiled(y: Array, tiles: Array, tolerance: Array, end: Array) -> tuple[Array, Array]:
        def one(k: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
            y, most = state
            mine, steps = solve(jax.lax.dynamic_slice_in_dim(y, k * TILE, TILE, axis=1), tolerance, end)
            y = jax.lax.dynamic_update_slice_in_dim(y, mine, k * TILE, axis=1)
            return y, jnp.maximum(most, steps.max())

        done: tuple[Array, Array] = jax.lax.fori_loop(0, tiles, one, (y, jnp.array(0)))
        return done

    return jax.jit(tiled)


def diffrax(scene: Scene, method: str, shape: str, value: float, y0: np.ndarray) -> Made:
    """Run the program for `ROOM`, which serves fewer too; the last trajectory fills the last tile."""
    program, steps, n = diffrax_program(method, shape, scene.name), [0], y0.shape[1]
    tiles = -(-n // TILE)
    room = np.pad(y0, ((0, 0), (0, max(ROOM, tiles * TILE) - n)), mode="edge")

    def run() -> np.ndarray:
        y, most = program(room, tiles, value, scene.t_end)
        steps[0] = int(most)
        return np.asarray(y)[:, :n]

    return run, lambda: (steps[0], steps[0] * SOLVERS[method][1] + 1, "rhs")


def heyoka(scene: Scene, method: str, shape: str, value: float, y0: np.ndarray) -> Made:
    import heyoka

    from contactbench.peers.heyoka import taylor_system

    width = heyoka.recommended_simd_size()
    ta = heyoka.taylor_adaptive_batch(taylor_system(scene, (), heyoka), np.zeros((len(y0), width)), tol=value)
    filled = np.pad(y0, ((0, 0), (0, -y0.shape[1] % width)), mode="edge")
    most = [0]

    def run() -> np.ndarray:
        y = np.empty_like(filled)
        most[0] = 0
        for k in range(0, y.shape[1], width):
            ta.set_time(0.0)
            ta.state[:] = filled[:, k : k + width]
            ta.propagate_until(scene.t_end)
            most[0] = max(most[0], *(steps for *_, steps in ta.propagate_res))
            y[:, k : k + width] = ta.state
        return y[:, : y0.shape[1]]

    return run, lambda: (most[0], most[0] * (ta.order + 1), "taylor")


def compiled_loop(scene: Scene, method: str, shape: str, value: float, y0: np.ndarray) -> Made | str:
    """CyRK or CVODE's C library, one trajectory after the other, without leaving compiled code."""
    run: Any = cb.prepare(scene, method, rtol=value, carry=(), save_at=[scene.t_end])
    if isinstance(run, Refused):
        return run.why
    starts, most = np.ascontiguousarray(y0.T), [0, 0]

    def loop() -> np.ndarray:
        told: np.ndarray = run.call.many(starts)
        most[:] = told[:, 3:5].max(axis=0).astype(int)
        return told[:, -len(y0) :].T

    return loop, lambda: (most[0], most[1], "rhs")


def limit_c(scene: Mechanical, method: str, shape: str, value: float, y0: np.ndarray) -> Made | str:
    composition, kernel = shape.split(" ")
    made = ensemble_kernel(composition, kernel, scene, value, y0)
    return made if isinstance(made, str) else (made[0], lambda: (made[1], made[2], "gradient"))


def prepared(
    scene: Mechanical, method: str, engine: str, shape: str, value: float, y0: np.ndarray
) -> Made | str:
    if method in cb.METHODS and not cb.METHODS[method].adaptive:
        return contact(scene, method, engine, value, y0)
    if shape == "loop":
        return compiled_loop(scene, method, shape, value, y0)
    make = {"c": limit_c, "llvm": heyoka, "jax": diffrax}[engine]
    return make(scene, method, shape, value, y0)


# -- rows ------------------------------------------------------------------------------------------
#: evaluations that the runs of all members, each by itself, may take together
SINGLE_WORK = 4e6
#: what members are run with where the method chooses its steps, maybe for several members at once
BY_ITSELF = ("heyoka-taylor", 2.3e-16)


def member_deviation(
    scene: Scene, method: str, control: str, value: float, start: np.ndarray, y: np.ndarray
) -> float:
    """Return max ‖y − y₁‖ / max ‖y₁‖ over all members, y₁ the run of each by itself with the same fixed steps.

    Of a method that chooses its steps y₁ is the most accurate run of another one.
    """
    if control != "step":
        (method, value), control = BY_ITSELF, "rtol"
    run = cb.prepare(scene, method, save_at=[scene.t_end], carry=(), **keywords(control, value))
    alone = np.array([run.integrate(np.array(one)).y[-1] for one in start.T.tolist()]).T
    return float(np.linalg.norm(y - alone, axis=0).max() / np.linalg.norm(alone, axis=0).max())


def run_of(cell: Cell, share: float = 1.0) -> Made | str:
    """Return the run of a share of a cell's trajectories."""
    _, name, method, engine, variant, _, value, n, _ = cell
    scene = cb.SCENES[name]
    return prepared(scene, method, engine, variant, value, initial(scene, round(n * share)))


def errors(cell: Cell) -> Row:
    """Return the row of a cell but for what is timed."""
    question, name, method, engine, variant, control, value, n, cores = cell
    scene = cb.SCENES[name]
    row = key(name, method, engine, control, value, variant)
    row |= {"question": question, "trajectories": n, "cores": cores}
    made = run_of(cell)
    if isinstance(made, str):
        return row | {"status": "unsupported", "message": made}
    run, costs = made
    start = perf_counter()
    y = run()
    row |= {"status": "ok", "message": "", "first_call_s": perf_counter() - start}
    y, (steps, evaluations, kind) = np.asarray(y), costs()
    if question != "arithmetic":
        row["solution_error"] = error(scene, y, truth(name))
        short = 0 < (evaluations or steps or 0) * n < SINGLE_WORK
        if question == "error" and method in cb.METHODS and short:
            row["member_deviation"] = member_deviation(scene, method, control, value, initial(scene, n), y)
    return row | {"steps": steps, "evaluations": evaluations, "evaluation_kind": kind}


def call(cell: Cell) -> tuple[Row, Call]:
    """Return what is timed of a cell that can be run, beside fewer trajectories where they are told apart."""
    shares = (1.0, FEWER) if cell[0] in ("error", "size") else (1.0,)
    made = [run_of(cell, share) for share in shares]
    run, *fewer = [each[0] for each in made if not isinstance(each, str)]
    return {}, Call(run, Part(fewer[0], FEWER, cell[-2]) if fewer else None)


@experiment(ladder)
def ensemble_errors(cell: Cell, profile: Profile) -> Recorded:
    yield ENSEMBLE_TABLE, errors(cell)


@timed_experiment(ladder, ensemble_errors)
def ensemble(cell: Cell, profile: Profile, row: Row) -> Timing:
    return Timing(ENSEMBLE_TABLE, call, (cell,), last_cores(cell[-1]))
