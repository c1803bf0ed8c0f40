"""Ensembles: the single solutions, all of them, whatever the chunks, tiles, devices and processes."""

import numpy as np
import pytest

import contactbench as cb
from cases import FIXED, TILTED, USER, few_slow, refusal
from chains import SMALL
from contactbench.ensembles.chunks import TILE
from contactbench.scenes.driven import DRIVEN, DUFFING
from contactbench.solution import Status
from contactbench.xla import jax

PARTICLE = cb.SCENES["particle"].with_(t_end=1.0, gamma=0.35)
CENTRAL = cb.SCENES["central"].with_(t_end=1.0, gamma=0.35, s=0.2)
BODY = cb.SCENES["rigid_body"].with_(t_end=1.0, gamma=0.25)
#: sums and products of another order, over some hundred stages
ROUND_OFF = 1e-13


def spread(scene, n, seed=3):
    """n initial states near the scene's own, each component an array (n,)."""
    rng = np.random.default_rng(seed)

    def near(value, size=0.1):
        return value + size * rng.normal(size=n)

    data = {name: tuple(near(v) for v in getattr(scene, name)) for name in scene.initial_fields[:2]}
    if "R" in data:
        length = np.sqrt(sum(c * c for c in data["R"]))
        data["R"] = tuple(c / length for c in data["R"])
    return data | ({"s": near(scene.s)} if "s" in scene.carry() else {})


def member(data, i):
    return {k: tuple(c[i] for c in v) if isinstance(v, tuple) else v[i] for k, v in data.items()}


def packed(out):
    return np.array(out.scene.pack(out.final))


# -- the single solutions --------------------------------------------------------------------------
#: every method on a mechanical scene and on a body; the shapes of compositions on every kind of scene
CASES = [(scene, m) for scene in (CENTRAL, BODY) for m in FIXED if m.refuses(scene) is None]
CASES += [
    (scene.with_(t_end=1.0), cb.METHODS[name])
    for scene in (cb.SCENES["quadratic_damping"], TILTED, USER)
    for name in ("contact-abc", "contact-bm4", "contact-rkn6", "rk4")
    if cb.METHODS[name].refuses(scene) is None
]
#: compiled for seconds
LONG = [(scene, method) for scene, method in CASES if "body" in scene.kind and method.name == "contact-abc"]
#: chains and bodies, γ(t), steps that are prescribed or end at breaks
GRID = cb.geometric_steps(1.0, 12, 0.25, plateau=2)
PRESCRIBED = {"step": GRID, "measure_at": np.cumsum(GRID)[[5, 11]]}
BREAKS = DUFFING.with_(name="breaks", t_end=1.0, breaks=(0.33, 0.77))
OTHERS = [
    (SMALL[name], m, {}) for name in ("free masses", "bodies 2D") for m in ("contact-abc", "contact-rkn4")
]
OTHERS += [(scene.with_(t_end=1.0), "contact-rkn4", {}) for scene in (*DRIVEN, BREAKS)]
OTHERS += [(scene, "contact-strang", PRESCRIBED) for scene in (PARTICLE, SMALL["ring held"])]


def check_members(scene, method, engine="numba", **options):
    """An ensemble ends as its single solutions do, with their laws and counts."""
    options = {"step": 0.1, "measure_at": [0.4, 1.0], "carry": scene.carry()} | options
    data, times = spread(scene, 3), options["measure_at"]
    out = cb.ensemble(scene, method, data, engine=engine, **options)
    del options["measure_at"]
    run = cb.prepare(scene, method, save_at=times, engine="python", **options)
    for i in range(3):
        alone = run(**member(data, i))
        np.testing.assert_allclose(packed(out)[:, i], alone.y[-1], rtol=0, atol=ROUND_OFF)
        for name in set(out.measures) & set(cb.LAWS):
            assert abs(out.measures[name][i] - cb.LAWS[name](alone)) < 10 * ROUND_OFF
        energy = scene.energy(alone.states())[-1] / scene.energy(alone.start()) - 1
        assert out.measures["energy_change"][i] == pytest.approx(energy, rel=1e-12, abs=10 * ROUND_OFF)
    counts = alone.counts._replace(evaluations=None) if cb.METHODS[method].iterates else alone.counts
    assert out.counts == counts
    assert out.endings == {Status.ok: 3, Status.diverged: 0}
    return out


@pytest.mark.parametrize(
    ("scene", "method"), few_slow(CASES, *LONG), ids=[f"{s.name}-{m.name}" for s, m in CASES]
)
@pytest.mark.quick(scene="central", method=("contact-bm6", "contact-rkn8", "herglotz2", "gauss4"))
@pytest.mark.quick(scene=("rigid_body", "quadratic_damping", "user"), method="contact-bm4")
@pytest.mark.quick(scene="tilted", method="rk4")
def test_an_ensemble_is_its_single_solutions(scene, method):
    check_members(scene, method.name)


@pytest.mark.parametrize("engine", ["numba", "jax"])
@pytest.mark.parametrize(
    ("scene", "method", "options"), OTHERS, ids=lambda value: getattr(value, "name", None)
)
@pytest.mark.quick(engine="numba")
@pytest.mark.quick(scene="duffing")
def test_so_is_one_of_other_kinds_of_scenes_and_steps_and_it_goes_on_from_where_it_ended(
    scene, method, options, engine
):
    out = check_members(scene, method, engine, **options)
    again = cb.ensemble(
        scene.with_(breaks=()) if scene.name == "breaks" else scene, method, out.final, step=0.1
    )
    if scene.clock is not None:
        np.testing.assert_allclose(again.final.t, scene.t + 2.0, rtol=1e-12)
    assert again.ok.all()


@pytest.mark.parametrize("engine", ["numba", "jax"])
def test_members_that_iterate_stop_one_by_one(engine):
    scene = CENTRAL.with_(t_end=2.0)
    starts = np.linspace(0.2, 1.4, 11), np.linspace(0.6, -0.5, 11)
    found = cb.ensemble(scene, "discrete-gradient", {"q": starts}, step=0.1, engine=engine)
    run = cb.prepare(scene, "discrete-gradient", step=0.1, save_at=[2.0])
    alone = [run(q=q).q[-1] for q in zip(*starts, strict=True)]
    np.testing.assert_allclose(np.transpose(found.final.q), alone, rtol=0, atol=ROUND_OFF)


@pytest.mark.parametrize(
    ("scene", "carry", "laws"),
    [
        (CENTRAL, ("s",), {"hamiltonian_law", "momentum_law"}),
        (PARTICLE, ("s",), {"hamiltonian_law"}),
        (PARTICLE, (), set()),
        (cb.SCENES["quadratic_damping"], ("s",), set()),  # its rate is known to the truth alone
    ],
)
def test_the_laws_a_scene_has_are_measured_and_no_others(scene, carry, laws):
    out = cb.ensemble(scene, "contact-strang", spread(scene, 2), step=0.5, carry=carry)
    assert set(out.measures) == {"energy_change"} | laws


# -- chunks, tiles, devices, parameters ------------------------------------------------------------
MANY = 2 * TILE + 7


def solved(**options):
    """An ensemble of a number no tile divides."""
    return cb.ensemble(CENTRAL, "contact-rkn6", spread(CENTRAL, MANY), step=0.25, **options)


@pytest.fixture(scope="module")
def whole():
    return solved()


def assert_same(one, other):
    np.testing.assert_allclose(packed(one), packed(other), rtol=0, atol=ROUND_OFF)
    assert one.endings == other.endings
    for name, values in other.statistics.items():
        assert one.statistics[name] == pytest.approx(values, rel=1e-9, abs=ROUND_OFF)


@pytest.mark.parametrize("chunk", [20, TILE + 1, 10 * MANY])
def test_chunks_that_do_not_divide_the_number_change_nothing(whole, chunk):
    assert packed(whole).shape == (5, MANY)
    assert_same(solved(chunk=chunk), whole)


@pytest.mark.usefixtures("fresh")
def test_on_jax_no_size_gets_the_program_of_another():
    for n in (MANY, TILE, 7, 1, TILE + 1):
        data = spread(CENTRAL, n)
        ends = [
            packed(cb.ensemble(CENTRAL, "contact-strang", data, step=0.5, engine=e)) for e in ("jax", "numba")
        ]
        np.testing.assert_allclose(*ends, rtol=0, atol=ROUND_OFF)


def test_one_device_does_what_all_do(whole, monkeypatch):
    first = jax.local_devices()[:1]
    monkeypatch.setattr(jax, "local_devices", lambda: first)
    assert_same(solved(), whole)


def test_statistics_are_those_of_the_members_which_need_not_be_kept(whole):
    for name, values in whole.measures.items():
        assert whole.statistics[name].mean == pytest.approx(values.mean(), rel=1e-12)
        assert whole.statistics[name].max == values.max()
    lean = solved(keep=False)
    assert lean.statistics == whole.statistics
    assert (lean.final, lean.measures, lean.end_time, lean.ok) == (None, None, None, None)


@pytest.mark.parametrize("name", ["contact-rkn6", "contact-abc", "rk4", "herglotz2", "contact-bm4"])
@pytest.mark.quick(name=("contact-rkn6", "contact-bm4"))
def test_parameters_of_its_own_for_every_trajectory(name):
    scene = BODY if name == "contact-bm4" else PARTICLE
    values = {"gamma": np.array([0.0, 0.3, 40.0])} | ({} if scene is BODY else {"coupling": [0.2, 0.0, 0.1]})
    out = cb.ensemble(scene, name, {}, step=0.05, parameters=values)
    for i in range(3):
        alone = scene.with_(**{k: v[i] for k, v in values.items()})
        solution = cb.solve(alone, name, step=0.05, save_at=[1.0], engine="python")
        np.testing.assert_allclose(packed(out)[:, i], solution.y[-1], rtol=0, atol=ROUND_OFF)
        law = cb.LAWS["hamiltonian_law"](solution)
        assert out.measures["hamiltonian_law"][i] == pytest.approx(law, rel=1e-6, abs=ROUND_OFF)


def test_no_ensemble_on_jax_gets_the_program_of_another():
    """Another parameter that varies, and the same scene without one of its laws."""
    values, step = [0.2, 0.9], {"step": 0.25, "engine": "jax"}
    for name in ("gamma", "stiffness"):
        out = cb.ensemble(CENTRAL, "contact-strang", {}, parameters={name: values}, **step)
        ends = [cb.solve(CENTRAL.with_(**{name: v}), "contact-strang", step=0.25).y[-1] for v in values]
        np.testing.assert_allclose(packed(out).T, ends, rtol=0, atol=ROUND_OFF)
    fewer = CENTRAL.with_(rotation_invariant=False)
    out = cb.ensemble(fewer, "contact-strang", {}, parameters={"stiffness": values}, **step)
    assert [*out.measures] == ["energy_change", "hamiltonian_law"]


# -- ways to end -----------------------------------------------------------------------------------
def test_a_diverged_member_is_counted_and_leaves_the_others_alone():
    """Beyond the saddle of the particle and heading out: to infinity in finite time."""
    scene, times = PARTICLE.with_(gamma=0.001, t_end=4.0), [0.5, 2.0, 4.0]
    data = {"q": tuple(np.array([[1.0, 8.0], [0.5, -8.0]])), "p": tuple(np.array([[0.0, 6.0], [0.3, -6.0]]))}
    out, calm, lost = (
        cb.ensemble(scene, "contact-strang", member(data, k), step=0.01, measure_at=times)
        for k in (slice(None), slice(1), slice(1, None))
    )
    assert out.endings == {Status.ok: 1, Status.diverged: 1}
    assert out.ok.tolist() == [True, False]
    assert np.isnan([*packed(out)[:, 1], *(values[1] for values in out.measures.values())]).all()
    alone = cb.solve(scene.with_(**member(data, 1)), "contact-strang", step=0.01, save_at=times)
    assert alone.status is Status.diverged
    assert out.end_time.tolist() == [4.0, 2.0]
    assert 2.0 <= alone.end_time < 4.0  # a single solution locates it to the step
    np.testing.assert_allclose(packed(out)[:, 0], packed(calm)[:, 0], rtol=0, atol=ROUND_OFF)
    for name, values in calm.statistics.items():
        assert out.statistics[name] == pytest.approx(values, rel=1e-9, abs=ROUND_OFF)
    assert np.isnan([*lost.statistics.values()]).all()


NAN, TWO, THREE = np.array([0.1, np.nan]), np.zeros(2), np.zeros(3)
BAD = [
    ({"method": "scipy-dop853"}, "an ensemble takes a fixed-step method: contact-printed, "),
    ({"method": "contact-rkn6", "scene": BODY}, "needs kicks and a merged drift"),
    ({"step": 1e-9}, "of which 100000000 are allowed"),
    ({"given": 3}, "initial_conditions = int: must be a state of the scene"),
    ({"given": {"M": TWO}}, "unknown initial value of scene 'particle' 'M'"),
    ({"given": {"q": (TWO, THREE)}}, "arrays of one length, one entry per trajectory; got q[0] 2, q[1] 3"),
    ({"given": {"q": TWO[:1]}}, "q: must be 2 components, each a number or an array; got 1"),
    ({"given": {"q": (np.zeros((2, 2)), 0.0)}}, "q[0]: must be a number or an array (n,), got shape (2, 2)"),
    ({"given": {"q": (NAN, 0.0)}}, "q[0]: must be finite numbers, entry 1 is nan"),
    ({"given": {"s": np.zeros(0)}}, "no trajectories"),
    ({"scene": BODY, "given": {"R": (TWO, 0.0, 0.0, 0.0)}}, "R: must be unit quaternions"),
    ({"parameters": {"gama": TWO}}, "did you mean 'gamma'?"),
    ({"parameters": {"mass": TWO}}, "mass = 0.0: must be > 0"),
    ({"parameters": {"kappa": THREE + 1}, "given": {}}, "kappa: 1.0 makes scene 'particle' another problem"),
]


@pytest.mark.parametrize(("call", "says"), BAD, ids=[says for _, says in BAD])
def test_bad_input_is_one_line_that_names_the_value(call, says):
    options = {"scene": PARTICLE, "method": "contact-strang", "given": {"q": (TWO, 0.5)}, "step": 0.1} | call
    given = [options.pop(name) for name in ("scene", "method", "given")]
    assert says in refusal(lambda: cb.ensemble(*given, **options))
