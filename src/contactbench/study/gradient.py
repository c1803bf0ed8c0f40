"""What does a derivative of a loss in the parameters cost?  One cell: a method, how it is differentiated, an error.

The loss is ½‖q(T) − q(0)‖², q(0) a datum; its derivative is in γ, a parameter of the potential, and the initial q and
p.  All methods run inside diffrax, so that what differs is the method and the adjoint.
"""

from __future__ import annotations

import math
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np

import contactbench as cb
from contactbench.measure.clock import Call
from contactbench.numbers.dual import Dual
from contactbench.results.tables import GRADIENTS
from contactbench.study.choice import key
from contactbench.study.experiment import Cell, Profile, Recorded, Row, Timing, experiment, timed_experiment
from contactbench.truth.engines import NEVER, Stopwatch, extrapolate

if TYPE_CHECKING:
    from jax import Array
    from jax.stages import Compiled

type Given = dict[str, Any]

PARTICLE, FORCED = "particle", "forced_oscillator"
#: scenes, all with the programs of the particle, and ends; errors of the derivative asked for
CASES, ERRORS = ((PARTICLE, 20.0), ("particle_long", 200.0)), (1e-6, 1e-9)
#: the parameter of the potential
PARAMETERS = {PARTICLE: "coupling", "particle_long": "coupling", FORCED: "force"}
ALONE, FORWARD, CHECKPOINTED, REVERSIBLE = "loss alone", "forward", "checkpointed", "reversible"
COMMON = (ALONE, FORWARD, CHECKPOINTED)
#: ways to differentiate, by the profile from which on they are run: each is some seconds of compilation
WAYS: dict[str, dict[str, tuple[str, ...]]] = {
    "standard": {"contact-rkn6": (*COMMON, REVERSIBLE), "diffrax-dopri8": (*COMMON, "backsolve")},
    "full": {
        "contact-rkn6": ("direct",),
        "diffrax-dopri8": ("direct",),
        "diffrax-tsit5": (*COMMON, "backsolve"),
    },
}
#: the coarsest step and tolerance, how many settings a factor of two and of ten have, and how many are tried
COARSEST, LOOSEST, FINER, MOST = 1.6, 1e-3, 8, 100
MOST_STEPS = 2**14


def ways(profile: Profile) -> list[tuple[str, str]]:
    reached = [each for name, each in WAYS.items() if profile.reaches(name)]
    return [(method, how) for each in reached for method, hows in each.items() for how in hows]


def ladder(profile: Profile) -> list[Cell]:
    """(scene, method, how, end, error)."""
    return [(scene, *way, end, error) for scene, end in CASES for way in ways(profile) for error in ERRORS]


@cache
def program(scene: str, method: str, how: str) -> Compiled:
    """Return the compiled ``(x, datum, end, setting) -> (derivative or loss, steps)``, x as in `arguments`."""
    import diffrax

    from contactbench.xla import jax, jnp

    terms, d, chosen = cb.diffrax.terms_of(scene), len(cb.SCENES[scene].q), cb.METHODS[method]
    velocity, (force, damping) = terms[0], terms[1].terms

    def field(t: Any, y: Array, args: Given) -> Array:
        q, p = y[:d], y[d:]
        return jnp.concatenate([velocity.vf(t, p, args), force.vf(t, q, args) + damping.vf(t, p, args)])

    def loss(x: Array, datum: Array, end: Array, setting: Array) -> tuple[Array, Array]:
        fit: Given = {"rtol": setting, "atol": setting}
        backward = diffrax.PIDController(**fit, norm=diffrax.adjoint_rms_seminorm)  # diffrax's advice
        adjoints: Given = {
            CHECKPOINTED: diffrax.RecursiveCheckpointAdjoint,
            REVERSIBLE: lambda: cb.diffrax.ReversibleAdjoint(math.inf),
            "direct": diffrax.DirectAdjoint,
            "backsolve": lambda: diffrax.BacksolveAdjoint(stepsize_controller=backward),
        }
        adjoint = adjoints.get(how, diffrax.ForwardMode)()
        given: Given = {
            "args": {"gamma": x[0], PARAMETERS[scene]: x[1]},
            "max_steps": MOST_STEPS,
            "throw": False,
        }
        if chosen.adaptive:
            given["stepsize_controller"] = diffrax.PIDController(**fit)
            what: Any = diffrax.ODETerm(field), getattr(diffrax, chosen.solver)(), 0.0, end, None, x[2:]
        else:
            what = terms, cb.diffrax.Contact(method), 0.0, end, setting, (x[2 : 2 + d], x[2 + d :])
        run = diffrax.diffeqsolve(*what, adjoint=adjoint, **given)
        q = jnp.ravel(jax.tree.leaves(run.ys)[0])[:d]
        return jnp.sum((q - datum) ** 2) / 2, run.stats["num_accepted_steps"]

    ways: Given = {ALONE: lambda f, has_aux: f, FORWARD: jax.jacfwd}
    shapes = [jax.ShapeDtypeStruct(shape, float) for shape in ((2 + 2 * d,), (d,), (), ())]
    return jax.jit(ways.get(how, jax.grad)(loss, has_aux=True)).lower(*shapes).compile()


def arguments(name: str, *more: float, **changed: float) -> list[np.ndarray]:
    """Return where the derivative is taken, x: γ, the parameter, q and p; the datum; and more."""
    scene = cb.SCENES[name].with_(**changed)
    x = scene.gamma, scene.parameters[PARAMETERS[name]], *scene.q, *scene.p
    return [np.array(each) for each in (x, scene.q, *more)]


@cache
def truth(name: str, end: float) -> np.ndarray:
    """Return the derivative by the variational equations: no flow and no step of a method under test."""
    scene, (x, datum) = cb.SCENES[name], arguments(name)
    one = np.eye(len(x), dtype=np.longdouble)
    duals: list[Any] = [Dual(np.longdouble(a), row) for a, row in zip(x, one, strict=True)]
    given = {"gamma": duals[0], PARAMETERS[name]: duals[1]}
    pairs = zip(scene.number_names(), scene.numbers(), strict=True)
    twin = scene.with_numbers([given.get(*pair) for pair in pairs])

    def rates(t: object, y: np.ndarray) -> np.ndarray:
        state = twin.unpack([Dual(row[0], row[1:]) for row in y.reshape(len(x) - 2, -1)], ())
        return np.concatenate([[each.a, *(each.b + 0 * one[0])] for each in twin.pack(twin.rhs(state))])

    start, watch = np.concatenate([[each.a, *each.b] for each in duals[2:]]), Stopwatch(scene, end, NEVER)
    (y,) = extrapolate(rates, start, [np.longdouble(end)], 14, np.longdouble(1e-17), watch)
    q = y.reshape(len(x) - 2, -1)[: len(datum)]
    return np.array((q[:, 0] - datum) @ q[:, 1:], dtype=float)


def distance(found: np.ndarray, true: np.ndarray) -> float:
    return float(np.linalg.norm(found - true) / np.linalg.norm(true))


@cache
def rungs(name: str, method: str, how: str, end: float) -> list[tuple[float, float, int]]:
    """Return settings from coarse to fine, each with its error and steps, until the smallest error is reached."""
    found: list[tuple[float, float, int]] = []
    for k in range(MOST):
        step, rtol = end / math.ceil(end / COARSEST * 2 ** (k / FINER)), LOOSEST * 10 ** (-k / FINER)
        setting = float(f"{rtol:.2e}") if cb.METHODS[method].adaptive else step
        derivative, steps = program(PARTICLE, method, how)(*arguments(name, end, setting))
        found.append((setting, distance(np.array(derivative), truth(name, end)), int(steps)))
        if found[-1][1] <= min(ERRORS):
            break
    return found


def errors(cell: Cell) -> Row:
    """Return the row of a cell but for what is timed."""
    name, method, how, end, asked = cell
    each = rungs(name, method, FORWARD if how == ALONE else how, end)
    setting, error, steps = next((rung for rung in each if rung[1] <= asked), each[-1])
    row = key(name, method, "jax", cb.METHODS[method].control, setting) | {"mode": how, "t_end": end}
    row |= {"error_asked": asked, "gradient_error": error, "steps": steps, "status": "ok", "message": ""}
    memory: Any = program(PARTICLE, method, how).memory_analysis()
    return row | {"memory_kB": memory.temp_size_in_bytes / 1e3}


def call(cell: Cell, setting: float) -> tuple[Row, Call]:
    from contactbench.xla import jax

    name, method, how, end, _ = cell
    return {}, Call(partial(program(PARTICLE, method, how), *jax.device_put(arguments(name, end, setting))))


@experiment(ladder)
def gradients_errors(cell: Cell, profile: Profile) -> Recorded:
    yield GRADIENTS, errors(cell)


@timed_experiment(ladder, gradients_errors)
def gradients(cell: Cell, profile: Profile, row: Row) -> Timing:
    return Timing(GRADIENTS, call, (cell, row["value"]))
