"""`rtol=` of fixed-step methods: the error of the run, or an end that says why."""

import numpy as np
import pytest

import contactbench as cb
from cases import few_slow, mine
from chains import PLEIADES, planets
from contactbench.methods import step_choice
from contactbench.methods.distance import distance

FIXED = [m for m in cb.METHODS.values() if m.control == "step" and (m.one_step or m.follows)]
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
    drawn = rng.choice([m.name for m in FIXED if m.refuses(scene) is None], 6, replace=False)
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
    scene = cb.Driven(
        name="shaken",
        potential=lambda q, t: 1e-4 * q[0] ** 2 - 1e-3 * q[0] * cb.math.cos(2 * cb.math.pi * t),
        q=(1.0,),
        p=(0.0,),
        t_end=512.0,
    )
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
