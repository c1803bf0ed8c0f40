"""Steps: prescribed ones, those chosen for a tolerance, and one alone as a pure function."""

import dataclasses
from itertools import product

import numba
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import contactbench as cb
from cases import PLEIADES, chain, few_slow, mine, pairs, planets
from contactbench.methods import step_choice
from contactbench.methods.distance import distance
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.prescribed import steps_until
from contactbench.methods.step_choice import FIRST
from contactbench.numbers.protocol import CannotRecord
from contactbench.scene.scales import errors
from contactbench.xla import jax, jnp

FIXED = [m for m in cb.METHODS.values() if isinstance(m, FixedStep) and m.one_step]
SCENES = [cb.SCENES[name] for name in ("particle", "lane_emden_5", "rigid_body")]
#: merges, stages in a loop, processing, no merging
SHAPES = ("contact-strang", "contact-rkn6", "contact-rkn8", "herglotz2")
ENGINES = ("llvm", "python")
STAR = cb.SCENES["lane_emden_5"]
#: relative; some ten steps on another compiler, or merged at other places, leave 1e-14
ROUND_OFF = 1e-13


def grid_of(scene, plateau):
    return cb.geometric_steps(scene.t_end / 10, 12, scene.t_end / 40, plateau)


def gap(a, b):
    return np.abs(a - b).max() / np.abs(b).max()


# -- the map -----------------------------------------------------------------------------------------
@pairs(FIXED, SCENES)
@pytest.mark.quick(scene="lane_emden_5")
@pytest.mark.parametrize("plateau", [1, 3])
def test_a_run_is_its_steps_one_after_the_other(method, scene, plateau):
    """Two saved times, one of them amid a plateau."""
    grid, one = grid_of(scene, plateau), cb.step_map(scene, method.name)
    states = [one.start]
    for h in grid.tolist():
        states.append(one(states[-1], h))
    solution = cb.solve(scene, method.name, step=grid, save_at=scene.begins + np.cumsum(grid)[[4, 11]])
    assert solution.ok
    assert solution.counts.steps == 12
    assert gap(solution.y, np.array(states)[[5, 12]]) < ROUND_OFF


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("save_at", [None, [20.0], [0.0, 3.0, 3.1, 20.0]])
def test_a_constant_grid_is_a_step_bit_for_bit(engine, save_at):
    for name in SHAPES:
        options = {"save_at": save_at, "engine": engine}
        scalar, grid = (cb.solve("particle", name, step=h, **options) for h in (0.1, np.full(200, 0.1)))
        assert np.array_equal(grid.t, scalar.t)
        assert np.array_equal(grid.y, scalar.y)
        assert (grid.counts, grid.step) == (scalar.counts, scalar.step)


MOVED = [(scene, name) for scene, name in product(SCENES, SHAPES) if cb.METHODS[name].refuses(scene) is None]
MOVED += [(chain(13, "ring"), "contact-rkn6")]


@pytest.mark.parametrize(("scene", "name"), MOVED, ids=lambda x: getattr(x, "name", x))
def test_engines_agree(scene, name):
    grid = grid_of(scene, plateau=3)
    times = scene.begins + np.array([0.0, *np.cumsum(grid)[[3, 11]]])
    one, other = (cb.solve(scene, name, step=grid, save_at=times, engine=engine) for engine in ENGINES)
    assert gap(other.y, one.y) < ROUND_OFF
    assert gap(other.sensitivity, one.sensitivity) < ROUND_OFF


def test_no_two_saved_times_are_one_end_of_a_step():
    """Nor a time between two ends; times as near as round-off are ends."""
    steps = np.array([0.1, 0.4, 0.5])
    for given in ([0.1, 0.1 + 1e-12], [0.5, 1.0 - 1e-11, 1.0], [0.3], [0.1, 0.75]):
        with pytest.raises(cb.BadInput, match="none of which ends at t"):
            steps_until(steps, np.array(given))
    assert steps_until(steps, np.array([0.1, 0.5 + 1e-12, 1.0])).tolist() == [1, 2, 3]


# -- what it keeps, and what it costs ----------------------------------------------------------------
@pytest.mark.parametrize(("steps", "evaluations", "error"), [(6, 72, 6.0e-7), (24, 288, 1.416e-10)])
def test_growing_steps_on_a_motion_that_slows_down(steps, evaluations, error):
    """Of equal steps five times as many do not reach it."""
    end = {"save_at": [STAR.begins + STAR.t_end]}
    run = cb.solve(STAR, "contact-rkn6", step=cb.geometric_steps(STAR.t_end, steps, a=0.5), **end)
    assert run.counts.evaluations == evaluations
    assert cb.LAWS["solution_error"](run) == pytest.approx(error, rel=0.02)
    equal = cb.solve(STAR, "contact-rkn6", step=STAR.t_end / (5 * steps), **end)
    assert cb.LAWS["solution_error"](equal) > 2 * error


@pytest.mark.parametrize(("plateau", "evaluations"), [(1, 24 * 39), (4, 6 * 39 + 18 * 13)])
def test_a_processor_is_paid_where_the_step_changes(plateau, evaluations):
    grid = cb.geometric_steps(STAR.t_end, 24, 0.5, plateau)
    assert (
        cb.solve(STAR, "contact-rkn8", step=grid, save_at=[STAR.begins + 20.0]).counts.evaluations
        == evaluations
    )


# -- how it ends -------------------------------------------------------------------------------------
@pytest.mark.parametrize("plateau", [1, 40])
def test_a_divergence_is_found_to_the_step(plateau):
    escape = mine(lambda q: -(q[0] ** 4), 1.0, 1.0, 8.0, gamma=0.1)
    grid = cb.geometric_steps(8.0, 400, 2.0, plateau)
    every, last = (cb.solve(escape, "rk4", step=grid, save_at=times) for times in (np.cumsum(grid), [8.0]))
    assert every.status is last.status is cb.Status.diverged
    assert "factor 1e6 at t" in last.message
    assert 0 < last.end_time == pytest.approx(every.end_time, rel=1e-12)


def test_a_geometric_grid():
    grid = cb.geometric_steps(20.0, 24, a=0.5)
    assert grid.sum() == pytest.approx(20.0, rel=1e-15)
    np.testing.assert_allclose(grid[1:] / grid[:-1], 41 ** (1 / 24), rtol=1e-12)
    assert len(np.unique(cb.geometric_steps(20.0, 24, 0.5, plateau=8))) == 3


# -- a step for a tolerance ------------------------------------------------------------------------
#: by order, what is reached in a number of steps that a test can wait for
RTOLS = {1: (1e-3,), 2: (1e-3, 1e-5)}


@pairs(FIXED, [cb.SCENES[name] for name in ("oscillator", "particle", "central", "rigid_body")])
@pytest.mark.quick(scene="oscillator")
@pytest.mark.quick(scene="rigid_body", method="contact-rkn4")
def test_error_is_within_the_tolerance_at_a_few_times_the_cost_of_the_longest_step(method, scene):
    """Pilots are part of the cost: of the longest steps that would do, at least as many as the first pilot's."""
    for rtol in RTOLS.get(method.order, (1e-3, 1e-6, 1e-8)):
        options = {"save_at": [scene.t_end], "carry": ()}
        chosen = cb.solve(scene, method.name, rtol=rtol, **options)
        error = cb.LAWS["solution_error"]
        assert error(chosen) < rtol
        enough = FIRST
        while not error(run := cb.solve(scene, method.name, step=scene.t_end / enough, **options)) < rtol:
            enough = max(enough + 1, int(1.1 * enough))
        exact = error(run) < 1e-12  # no step is too long then, and the first pilots are the cost
        assert exact or chosen.counts.evaluations < 9 * run.counts.evaluations


def test_a_round_off_gap_of_pilots_does_not_make_their_step_the_one():
    """Pilots of order 12 fall as their order says beside round-off alone; 64 steps were taken for any tolerance."""
    options = {"save_at": [20.0], "carry": ()}
    runs = [cb.solve("particle", "rkn12", rtol=rtol, **options) for rtol in (1e-3, 1e-8, 1e-13)]
    assert [run.counts.steps for run in runs] == [12, 32, 39]


PAIR = {"q": (1.0, 0.0), "p": (-0.0647722295317518, -0.02106457787689715), "t_end": 13375.220471761308}
STIFF_START = {
    "a well that coarse steps fly out of": cb.Mechanical(
        name="pair",
        potential=lambda q: (
            0.31183773 / 72 * ((q[0] ** 2 + q[1] ** 2) ** -6 - 2 * (q[0] ** 2 + q[1] ** 2) ** -3)
        ),
        gamma=8.066902826115688e-06,
        **PAIR,
    ),
    "a damping that coarse steps add": mine(
        lambda q: 1 - cb.math.cos(q[0]), 0.0, 2.963, t_end=97.5, gamma=0.19
    ),
}


@pytest.mark.parametrize("scene", STIFF_START.values(), ids=STIFF_START)
@pytest.mark.parametrize("method", ["rk4", "rk8", "rkn8", "contact-rkn8"])
def test_pilots_that_agree_on_another_motion_are_not_believed(scene, method):
    """Steps of many periods all end alike, far off or at rest: errors were up to 700 times the motion, and `ok`."""
    options = {"save_at": [scene.t_end / 2, scene.t_end], "carry": ()}
    solution = cb.solve(scene, method, rtol=1e-4, **options)
    true = cb.solve(scene, "rk8-7", rtol=1e-13, **options)
    assert np.linalg.norm(solution.y - true.y, axis=1).max() < 1e-4 * np.linalg.norm([*scene.q, *scene.p])


def test_the_pilots_are_counted_and_other_initial_data_get_a_step_of_their_own():
    run = cb.prepare("particle", "contact-rkn6", rtol=1e-8, save_at=[20.0])
    solution, steps = run(), []
    alone = cb.solve("particle", "contact-rkn6", step=20.0 / solution.counts.steps, save_at=[20.0])
    np.testing.assert_allclose(alone.y, solution.y, rtol=1e-12)
    assert alone.counts.evaluations < solution.counts.evaluations < 2.5 * alone.counts.evaluations
    assert solution.setting == "rtol=1e-08"
    for q, p in (((0.01, 0.0), (0.0, 0.0)), ((2.5, 1.0), (1.0, 2.0))):
        found, true = run(q=q, p=p), cb.prepare("particle", "rk8-7", rtol=1e-13, save_at=[20.0])(q=q, p=p)
        steps.append(found.counts.steps)
        assert gap(found.y[:, :4], true.y[:, :4]) < 2e-8
    assert steps[0] != steps[1]


@pytest.mark.parametrize(("method", "rtol"), [("contact-o8", 1e-6), ("contact-rkn6", 1e-7), ("rk4", 1e-8)])
def test_steps_that_saved_times_shorten_are_not_taken_for_halved_ones(method, rtol):
    """On 200 saved times the pilots do not halve: by nominal steps the error was 12, 6 and 2 times the tolerance."""
    scene = cb.SCENES["particle"].with_(t_end=200.0) if method != "rk4" else cb.SCENES["oscillator"]
    solution = cb.solve(scene, method, rtol=rtol)
    true = cb.solve(scene, "heyoka-taylor", rtol=1e-15, save_at=solution.t)
    y, z = (np.hstack([s.q, s.p]) for s in (solution, true))
    assert np.linalg.norm(y - z, axis=1).max() <= rtol * np.linalg.norm(z, axis=1).max()


# -- one step as a function of its own -------------------------------------------------------------
STEP = 0.1


def test_it_is_pure():
    step = cb.step_map("particle", "contact-rkn4")
    once = step(step.start, STEP)
    step(once, STEP, gamma=3.0)
    assert step(step.start, STEP) == once
    assert step.scene.gamma == cb.SCENES["particle"].gamma


def test_parameters_by_name_and_as_a_tuple():
    step = cb.step_map("particle", "contact-strang")
    other = cb.step_map(cb.SCENES["particle"].with_(gamma=0.4, coupling=0.2), "contact-strang")
    numbers = list(step.scene.numbers())
    numbers[step.names.index("gamma")], numbers[step.names.index("coupling")] = 0.4, 0.2
    assert step(step.start, STEP, gamma=0.4, coupling=0.2) == other(step.start, STEP)
    assert step(step.start, STEP, tuple(numbers)) == other(step.start, STEP)


def test_numba_calls_it_in_a_compiled_loop():
    step = cb.step_map("rigid_body", "contact-strang")

    @numba.njit
    def run(y, h, n):
        for _ in range(n):
            y = step(y, h)
        return y

    y = step.start
    for _ in range(50):
        y = step(y, STEP)
    np.testing.assert_allclose(run(step.start, STEP, 50), y, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("name", [method.name for method in FIXED if method.iterates])
def test_numba_refuses_one_that_iterates_and_jax_takes_it(name):
    step = cb.step_map("particle", name)
    for compiled in (lambda: step.compiled, lambda: numba.njit(lambda y: step(y, STEP))(step.start)):
        with pytest.raises(CannotRecord, match=rf"'{name}' iterates.*jax\.jit, or use cb\.prepare"):
            compiled()
    if name == "contact-gauss2":  # XLA takes many seconds for the others
        np.testing.assert_allclose(jax.jit(step)(step.start, STEP), step(step.start, STEP), rtol=1e-14)


def test_jax_compiles_vectorises_and_differentiates_it():
    step = cb.step_map("particle", "contact-strang")
    np.testing.assert_allclose(jax.jit(step)(step.start, STEP), step(step.start, STEP), rtol=1e-14)
    rates = jnp.array([0.0, 0.1, 0.5])
    many = jax.vmap(lambda gamma: jnp.stack(step(step.start, STEP, gamma=gamma)))(rates)
    for gamma, row in zip(rates.tolist(), many, strict=True):
        np.testing.assert_allclose(row, step(step.start, STEP, gamma=gamma), rtol=1e-13)
    step = cb.step_map("particle", "contact-strang", carry=())

    def end(gamma):
        return step(step(step.start, 1.0, gamma=gamma), 1.0, gamma=gamma)[0]

    difference = (end(0.1 + 1e-5) - end(0.1 - 1e-5)) / 2e-5
    assert float(jax.grad(end)(0.1)) == pytest.approx(difference, rel=1e-7)


def test_a_motion_that_leaves_any_scale_ends_then_and_is_right_before():
    """The times are DOP853's, which ends where its steps vanish."""
    scene = mine(lambda q: q[0] ** 4 / 4, 1.0, 1.0, 20.0, name="fed", gamma=0.1, kappa=-0.5, s=1.0).recorded()
    slope = lambda t, y: [*scene.pack(scene.rhs(scene.unpack(y, ("s",))))]  # noqa: E731
    late = solve_ivp(slope, (0, 20.0), [1.0, 1.0, scene.s or 0.0], method="DOP853", rtol=1e-10)
    times = [0.3, 0.9 * late.t[-1], 20.0]
    run = cb.solve(scene, "contact-rkn6", rtol=1e-8, save_at=times, max_steps=10**5)
    assert run.status is cb.Status.diverged
    assert run.end_time == pytest.approx(late.t[-1], rel=1e-3)
    true = cb.solve(scene, "rk8-7", rtol=1e-12, save_at=times[:2])
    np.testing.assert_allclose(run.y[:2], true.y, rtol=1e-6)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size", [np.inf, np.nan])
def test_pilots_beyond_any_scale_are_infinitely_far_apart(size):
    request = cb.prepare("particle", "rk4", rtol=1e-6, carry=()).request
    start, coarse, fine = np.arange(1.0, 5.0), np.full((1, 4), 0.5), np.full((1, 4), 0.5)
    coarse[0, 0], fine[0, 1] = size, size
    for engine in ("llvm", "python"):
        assert distance(dataclasses.replace(request, engine=engine), start, coarse, fine)() == np.inf


@pytest.mark.parametrize("name", ["particle", "forced_oscillator", "rigid_body", "double_pendulum"])
@pytest.mark.parametrize("engine", ["llvm", "python"])
def test_the_distance_of_pilots(name, engine):
    """It is the error of the coarse one against the fine one, of what the arrays hold when it is called."""
    run = cb.prepare(name, "rk4", rtol=1e-6)
    request, start = dataclasses.replace(run.request, engine=engine), run.start
    rng = np.random.default_rng(0)
    coarse, fine = start + rng.normal(size=(4, len(start))), start + rng.normal(size=(4, len(start)))
    call = distance(request, start, coarse, fine)
    coarse[2, 1] += 3.0
    true = errors(request.scene, coarse, fine, start, request.carry).max()
    assert call() == pytest.approx(true, rel=1e-14)


# -- rtol= of fixed-step methods: the error of the run, or an end that says why ----------------------
CHOOSING = [m for m in cb.METHODS.values() if m.control == "step" and (m.one_step or m.follows)]
exp, sqrt = cb.math.exp, cb.math.sqrt


def error(solution):
    """Of the motion, in the units of the choice, the start included."""
    run = solution.run
    true = cb.solve(solution.scene, "rk8-7", rtol=1e-13, save_at=solution.t, carry=solution.carry)
    return distance(run.request, solution.y0, solution.y, true.y)()


# -- the error of the run ----------------------------------------------------------------------------
WALL = mine(
    lambda q: exp(80 * (q[0] - 1)) + exp(-80 * (q[0] + 1)), -0.3641258, 1.3090031, t_end=20.0, gamma=0.0
)
FALL = planets(
    (1.58975914, 1.65739093),
    (1.77912598, -1.50342803, 0.59925624, -0.59198945),
    (0.0, 0.0, 0.0, 0.0),
    0.05,
    t_end=5.0,
)


@pytest.mark.parametrize("rtol", [1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("method", ["contact-log8", "contact-rkn8", "rkn12"])
@pytest.mark.quick(method="contact-rkn8", rtol=1e-3)
@pytest.mark.quick(method=("contact-log8", "rkn12"), rtol=1e-6)
def test_pilots_on_another_way_are_not_compared(method, rtol):
    """Of the Pleiades, long steps that follow the motion take 581, 120 and 38 steps: fewer, the shorter they are."""
    run = cb.solve(PLEIADES, method, rtol=rtol, save_at=[3.0])
    assert run.ok
    assert error(run) < rtol


@pytest.mark.parametrize(
    ("method", "rtol"), [("contact-gauss2", 1e-3), ("contact-gauss4", 1e-6), ("contact-gauss8", 1e-8)]
)
@pytest.mark.parametrize("scene", [WALL, FALL], ids=["wall", "fall"])
def test_where_steps_of_pilots_have_no_solution_finer_ones_follow(method, rtol, scene):
    """Two that end at the same wall, or pericentre, prove nothing."""
    end = {"save_at": [scene.t_end]}
    assert not cb.solve(scene, method, step=scene.t_end / 40, **end).ok
    run = cb.solve(scene, method, rtol=rtol, **end)
    assert run.ok
    assert error(run) < rtol


def test_a_method_without_a_step_says_so_in_terms_of_the_tolerance(monkeypatch):
    """Pilots that fail are counted, and so is the solver that says whether the motion goes on."""
    monkeypatch.setattr(step_choice, "LAST", 100)
    run = cb.solve(WALL, "contact-gauss4", rtol=1e-6, save_at=[20.0])
    assert run.status is cb.Status.failed
    assert "rtol = 1e-06" in run.message
    assert "smaller" not in run.message
    witness = cb.solve(WALL, step_choice.WITNESS, rtol=step_choice.WITNESS_RTOL, save_at=[20.0])
    assert run.counts.evaluations > witness.counts.evaluations + 100


SLOW = (2, 4, 5, 6, 7)


@pytest.mark.parametrize("seed", few_slow(range(8), *SLOW))
def test_random_motions(seed):
    """A twentieth of what was run once, by every method: 950 runs, two beyond 2 rtol, of chaotic motions."""
    rng = np.random.default_rng(seed)
    kind, gamma, end = seed % 4, float(rng.choice([0.0, 0.1, 2.0])), float(rng.choice([5.0, 10.0]))
    if kind < 2:
        masses = rng.uniform(0.3, 3.0, kind + 2)
        q, p = rng.normal(size=2 * len(masses)), rng.normal(size=2 * len(masses)) * (0.4 * kind)
        scene = planets(masses, tuple(q), tuple(p), 0.3, t_end=end, gamma=gamma)
    elif kind == 2:
        # two atoms in a row, bound to the origin and to each other
        scene = cb.Mechanical(
            name="chain",
            potential=lambda q: sum(r**-12 - 2 * r**-6 for r in (q[0], q[1] - q[0])),
            q=tuple(np.cumsum(rng.uniform(0.95, 1.1, 2))),
            p=tuple(rng.normal(size=2) * 0.3),
            t_end=end,
            gamma=gamma,
        )
    else:
        k = float(rng.choice([10.0, 1e3]))
        scene = cb.Mechanical(
            name="spring",
            potential=lambda q: k / 2 * (sqrt(q[0] ** 2 + q[1] ** 2) - 1) ** 2 + q[1],
            q=tuple(rng.uniform(0.7, 1.1, 2)),
            p=tuple(rng.uniform(-1, 1, 2)),
            t_end=end,
            gamma=gamma,
        )
    times = ([end], None, [0.37 * end, 0.8 * end, end])[seed % 3]
    drawn = rng.choice([m.name for m in CHOOSING if m.refuses(scene) is None], 6, replace=False)
    for method in drawn[: 6 if seed in SLOW else 3]:
        rtol = max(10.0 ** -rng.uniform(2, 9), {1: 1e-3, 2: 1e-5, 4: 1e-7}.get(cb.METHODS[method].order, 0))
        run = cb.solve(scene, str(method), rtol=rtol, carry=(), max_steps=10**6, save_at=times)
        assert not run.ok or error(run) < 2 * rtol, (method, rtol)
        assert run.ok or f"rtol = {rtol:g}" in run.message, (method, run.message)


def test_what_rounding_leaves_ends_the_search():
    """Three bodies that pass each other closely: no step has errors below 10⁻⁸."""
    rng = np.random.default_rng(28)
    masses = rng.uniform(0.3, 3.0, 3)
    scene = planets(masses, tuple(rng.normal(size=6)), tuple(rng.normal(size=6) * 0.4), 0.02, t_end=12.0)
    run = cb.solve(scene, "contact-bm6", rtol=1e-13, save_at=[12.0], max_steps=10**6)
    assert run.status in (cb.Status.failed, cb.Status.budget)
    assert "rtol = 1e-13" in run.message
    assert np.isnan(run.y).all()


# -- pilots that all see the same wrong motion ------------------------------------------------------------
@pytest.mark.parametrize("method", ["contact-strang", "contact-abc", "rk4", "contact-rkn6"])
@pytest.mark.parametrize("save_at", [None, [512.0]], ids=["many times", "the end"])
def test_a_force_of_whole_periods_in_every_step_is_seen(method, save_at):
    """An oscillator shaken with a period of 1; steps of 2, 1, 8 meet the force in one phase."""
    force = lambda t: cb.math.cos(2 * cb.math.pi * t)  # noqa: E731
    scene = mine(lambda q, t: 1e-4 * q[0] ** 2 - 1e-3 * q[0] * force(t), t_end=512.0, kind=cb.Driven)
    assert error(cb.solve(scene, method, rtol=1e-3, save_at=save_at)) < 2e-3


WALLS = [
    ("contact-bm6", 5.950694310167864, 48.90261219719055, -0.42809543922860993, 1.074946774720699),
    ("contact-rkn6", 9.796033342725552, 168.37522386824253, -0.25369054438418803, 1.88975459363306),
]


@pytest.mark.parametrize(("method", "end", "stiffness", "q", "p"), WALLS, ids=lambda value: str(value)[:12])
def test_pilots_that_agree_by_chance_are_not_believed(method, end, stiffness, q, p):
    """Between walls whose force has kinks no order holds; one gap was small, or as the order says, by luck."""

    def potential(q):
        beyond = cb.math.where(q[0] > 1, q[0] - 1, cb.math.where(q[0] < -1, q[0] + 1, 0.0))
        return stiffness * beyond**2 / 2

    scene = cb.Mechanical(name="walls", potential=potential, gamma=0.1, q=(q,), p=(p,), t_end=end)
    true = cb.solve(scene, "rk4", step=end / 200_000, save_at=[end]).y[0]
    run = cb.solve(scene, method, rtol=1e-3, save_at=[end])
    assert np.abs(run.y[0] - true)[:2].max() < 2e-3
