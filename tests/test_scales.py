"""Values of any scale: the truth of a motion in other units is that of the motion itself, and so is its ending."""

import math

import numpy as np
import pytest

import contactbench as cb
from cases import mine
from contactbench.measure.laws import errors_of
from contactbench.methods.prepared import METHODS
from contactbench.numbers.control import XlaNumbers
from contactbench.runs.search import Question, Search
from contactbench.runs.settings import ENDS, times
from contactbench.scene.base import Elapsed
from contactbench.scene.general_damping import decayed
from contactbench.scene.scales import FAINT, errors, sizes_of
from contactbench.testing import check_scene
from contactbench.truth.two_solvers import doubles
from contactbench.xla import jax, jnp

T = 12.0
#: in units of size one: V(q), q, p
MOTIONS = {
    "oscillator": (lambda q: q[0] * q[0] / 2, (1.0,), (0.0,)),
    "quartic": (lambda q: q[0] * q[0] * (0.5 + q[0] * q[0] / 4), (0.0,), (0.8,)),
    "plane": (lambda q: q[0] * q[0] / 2 + q[1] * q[1] + q[0] * q[0] * q[1] / 8, (0.9, -0.3), (0.2, 0.5)),
    "well": (lambda q: (q[0] * q[0] - 1) * (q[0] * q[0] - 1) / 4, (1.5,), (-0.2,)),
}
#: how far, in parts of the motion, a method may be from the truth at its setting
FIXED = {"rk4": 1e-4, "contact-rkn6": 1e-6, "contact-rkn8": 1e-5, "contact-gauss4": 1e-4, "herglotz2": 0.1}
ADAPTIVE = ["scipy-dop853", "cvode-adams", "cvode-bdf", "cyrk-vern8", "cyrk-lsoda", "cyrk-radau"]
ADAPTIVE += ["heyoka-taylor", "diffrax-tsit5", "scipy-radau", "rk8-7", "rkn8-6", "rkn12-10"]


def in_units(name, length, time, mass, gamma):
    """A scene in units of a length, a time and a mass; a function of its own for each, as users write them."""
    V, q, p = MOTIONS[name]
    energy = mass * length**2 / time**2
    return cb.Mechanical(
        name=f"{name}-in-units",
        potential=lambda q, length, energy: energy * V(tuple(c / length for c in q)),
        parameters={"length": length, "energy": energy},
        mass=mass,
        gamma=gamma / time,
        q=tuple(length * c for c in q),
        p=tuple(mass * length / time * c for c in p),
        t_end=T * time,
    )


def error(scene, end, name, gamma, length, time, mass):
    true = cb.reference(in_units(name, 1.0, 1.0, 1.0, gamma), [T], carry=()).y[0]
    units = np.repeat([length, mass * length / time], len(scene.q))
    return float(np.linalg.norm(end / units - true) / np.linalg.norm(true))


def surprises(name, gamma, length, time, mass, methods):
    """What no method may do: be far off and `ok`, or diverge."""
    scene, found = in_units(name, length, time, mass, gamma), []
    for method in methods:
        setting = {"step": 0.05 * time} if method in FIXED else {"rtol": 1e-8}
        run = cb.solve(scene, method, save_at=[scene.t_end], carry=(), **setting)
        if not run.ok:
            found.append((method, str(run.status), run.message))
            continue
        off = error(scene, run.y[-1], name, gamma, length, time, mass)
        if not off < FIXED.get(method, 1e-3):
            found.append((method, "off", off))
    return found


def drawn(count, seed=40):
    rng = np.random.default_rng(seed)
    names = [*MOTIONS]
    for _ in range(count):
        length, time, mass = 10.0 ** rng.uniform(-12, 12, 3)
        gamma = [0.0, 0.1, 10 ** rng.uniform(-12, 1)][rng.integers(3)]
        yield names[rng.integers(len(names))], float(gamma), float(length), float(time), float(mass)


@pytest.mark.parametrize(
    ("count", "methods"),
    [
        (3, ("rk4", "contact-rkn6", "scipy-dop853", "cvode-adams", "cyrk-vern8", "heyoka-taylor")),
        pytest.param(200, (*FIXED, *ADAPTIVE), marks=pytest.mark.slow),
    ],
    ids=["few", "many"],
)
def test_no_scale_makes_a_wrong_ok_or_a_false_divergence(count, methods):
    assert {case: bad for case in drawn(count) if (bad := surprises(*case, methods))} == {}


@pytest.mark.parametrize(("time", "length"), [(1e-9, 1.0), (1e7, 1e-12)])
@pytest.mark.parametrize(
    "method",
    [name for name, own in METHODS.items() if not (own.exact or own.refuses(cb.SCENES["oscillator"]))],
)
@pytest.mark.quick(method="rk4")
@pytest.mark.quick(method="cyrk-dop853")
def test_a_fast_motion_has_not_diverged(method, time, length):
    scene, plain = (in_units("oscillator", *units, 1.0, 0.1) for units in ((length, time), (1.0, 1.0)))
    adaptive = METHODS[method].adaptive
    assert cb.solve(scene, method, **({"rtol": 1e-8} if adaptive else {"step": 0.05 * time})).ok
    assert cb.prepare(plain, method, **({"rtol": 1e-8} if adaptive else {"step": 0.05}))(q=(1e9,)).ok


@pytest.mark.parametrize("engine", ["llvm", "python"])
@pytest.mark.parametrize(("length", "time", "mass"), [(20.0, 3e6, 4e-11), (1e-6, 2e-2, 2e8)])
def test_a_first_step_is_that_of_the_motion_in_other_units(engine, length, time, mass):
    """Coordinates and momenta differ by ten to fifteen powers of ten."""
    one, other = (
        cb.solve(in_units("quartic", *units, 0.1), "rk8-7", rtol=1e-8, carry=(), engine=engine, dense=False)
        for units in ((1.0, 1.0, 1.0), (length, time, mass))
    )
    assert other.ok
    assert other.counts.steps == pytest.approx(one.counts.steps, rel=0.1)
    assert cb.solve("oscillator", "rk8-7", rtol=1e-6, atol=1e-300, engine=engine).ok


@pytest.mark.parametrize("time", [1e-9, 1e6])
@pytest.mark.parametrize("method", ["rk4", "contact-strang"])
def test_a_blow_up_is_seen_at_any_scale(method, time):
    scene = in_units("oscillator", 1e-9, time, 1.0, 0.0)
    run = cb.solve(scene, method, step=4 * time, save_at=[2000 * time])
    assert run.status == "diverged"


def test_a_start_next_to_an_equilibrium_leads_away_from_it():
    scene = mine(lambda q: q[0] ** 4 / 4 - q[0] ** 2 / 2, q=1e-9, t_end=40.0, gamma=0.1)
    true = cb.reference(scene, Elapsed([40.0])).y[-1]
    for method in ("rk4", "cvode-adams", "heyoka-taylor"):
        setting = {"rtol": 1e-9} if METHODS[method].adaptive else {"step": 0.05}
        assert np.abs(cb.solve(scene, method, **setting).y[-1] - true).max() < 1e-4


# -- tolerances ------------------------------------------------------------------------------------------
def test_the_default_atol_follows_the_motion_and_ones_own_does_not():
    small = in_units("oscillator", 1e-12, 1.0, 1.0, 0.1)
    request = cb.prepare(small, "cvode-adams", rtol=1e-8).request
    assert np.all(request.atol <= 1e-20)
    assert cb.prepare(small, "cvode-adams", rtol=1e-8, atol=1e-8).request.atol == 1e-8
    for scene in ("oscillator", "particle", "kepler_drag", "stiff_spring", "rigid_body", "heavy_top"):
        assert cb.prepare(scene, "scipy-dop853", rtol=1e-8).request.atol == 1e-8


@pytest.mark.parametrize("method", ["scipy-radau", "cvode-bdf", "cyrk-lsoda", "heyoka-taylor"])
def test_a_call_with_a_start_of_another_size_is_as_accurate(method):
    run = cb.prepare(in_units("oscillator", 1.0, 1.0, 1.0, 0.1), method, rtol=1e-8, save_at=[T], carry=())
    assert error(run.request.scene, run(q=(1e-12,)).y[-1], "oscillator", 0.1, 1e-12, 1.0, 1.0) < 1e-5


@pytest.mark.parametrize("method", ["scipy-dop853", "cyrk-vern8"])
def test_the_derivative_of_a_small_motion_is_that_of_a_large_one(method):
    scenes = (in_units("quartic", length, 1.0, 1.0, 0.1) for length in (1.0, 1e-9))
    runs = (cb.solve(scene, method, rtol=1e-9, save_at=[T], carry=()) for scene in scenes)
    assert np.abs(np.subtract(*(run.sensitivity for run in runs))).max() < 1e-5


# -- numbers that make another problem ----------------------------------------------------------------------
Y = (0.7, 0.4, -0.3)


def bent(kappa, gamma=0.1):
    return mine(MOTIONS["quartic"][0], 0.7, 0.4, 5.0, gamma=gamma, kappa=kappa, s=-0.3)


@pytest.mark.parametrize("method", ["contact-strang", "contact-rkn6", "rk4", "rk8"])
@pytest.mark.parametrize("own", [0.0, 0.3, -0.3])
@pytest.mark.quick(own=0.0, method=("contact-strang", "contact-rkn6"))
def test_a_step_map_takes_kappa_of_any_sign(method, own):
    step = cb.step_map(bent(own), method)
    compiled = jax.jit(lambda numbers: jnp.stack(step(Y, 0.2, numbers)))
    for kappa in (0.0, 0.3, -0.3, 1e-9):
        want = np.array(cb.step_map(bent(kappa), method)(Y, 0.2))
        arrays = step(tuple(np.full(2, c) for c in Y), 0.2, kappa=np.full(2, kappa))
        traced = compiled(jnp.array([0.1, kappa, 1.0]))
        for found in (step(Y, 0.2, kappa=kappa), np.array(arrays)[:, 1], traced):
            assert np.abs(np.array(found) - want).max() < 1e-14


@pytest.mark.parametrize("method", ["contact-rkn6", "rk4"])
@pytest.mark.quick(method="contact-rkn6")
@pytest.mark.parametrize(
    ("name", "at"), [("kappa", 0.0), ("kappa", -0.3), ("gamma", 0.0), ("gamma", -0.2), ("mass", 2.0)]
)
def test_derivatives_by_numbers_are_right_at_zero_too(method, name, at):
    step = cb.step_map(bent(0.0), method)

    def central(h):
        return (np.array(step(Y, 0.2, **{name: at + h})) - np.array(step(Y, 0.2, **{name: at - h}))) / (2 * h)

    derivative = jax.jacfwd(lambda x: jnp.stack(step(Y, 0.2, **{name: x})))(at)
    assert np.abs(derivative - (4 * central(5e-4) - central(1e-3)) / 3).max() < 1e-10


def test_a_step_map_refuses_numbers_it_has_no_step_for():
    import numba

    step, plain = cb.step_map(bent(0.0), "contact-rkn6"), cb.step_map(bent(0.0), "contact-rkn6", carry=())
    for call in (
        lambda: step(Y, 0.2, mass=-1.0),
        lambda: step(Y, 0.2, mass=0.0),
        lambda: plain(Y[:2], 0.2, kappa=0.3),
        lambda: step(tuple(np.full(2, c) for c in Y), 0.2, kappa=np.array([-0.1, 0.1])),
        lambda: cb.step_map(bent(0.0), "herglotz2")(Y, 0.2, kappa=0.3),
        lambda: numba.njit(lambda y, n: step(y, 0.2, n))(Y, (0.1, 0.3, 1.0)),
    ):
        with pytest.raises(cb.BadInput) as found:
            call()
        assert "\n" not in str(found.value)
    slopes = jax.grad(lambda numbers: plain(Y[:2], 0.2, numbers)[0])(jnp.array([0.0, 0.0, 1.0]))
    assert np.isnan(slopes[1]) and np.isfinite(slopes[np.array([0, 2])]).all()  # noqa: PT018


def test_a_step_map_takes_moments_of_inertia_in_any_order():
    body, step = cb.SCENES["rigid_body"], cb.step_map("rigid_body", "contact-strang")
    inertia = (body.inertia[2], *body.inertia[:2])
    want = cb.step_map(body.with_(inertia=inertia), "contact-strang")(step.start, 0.1)
    assert step(step.start, 0.1, (*inertia, body.gamma)) == want


def test_the_tangent_of_a_damping_of_ones_own_is_right_where_it_vanishes():
    """At s = 0 the factor on p has a derivative by s of its own."""
    damping = {"damping": lambda s: 0.3 * s + 0.4 * s * s, "damping_slope": lambda s: 0.3 + 0.8 * s}
    scene = mine(MOTIONS["quartic"][0], 0.5, 0.8, kind=cb.GeneralDamping, **damping)
    xp, h = XlaNumbers(), 0.5
    _, slope = jax.jvp(lambda s: xp.exp(decayed(scene, s, h, xp)[1]), (0.0,), (1.0,))
    assert math.isclose(slope, math.exp(-0.3 * h) * 0.8 * math.expm1(-0.3 * h) / 0.3, rel_tol=1e-12)


# -- functions beside others ----------------------------------------------------------------------------------
def driven(rate=0.1, phi=0.1, begin=0.0):
    span = lambda t, h, xp: (rate * h + begin, -xp.expm1(-phi * h) / phi)  # noqa: E731
    own = {"rate": lambda t: 0.1 + 0 * t, "span": span}
    return mine(lambda q, t: q[0] * q[0] / 2, t_end=10.0, kind=cb.Driven, **own)


def damped(rate=0.1, begin=0.0):
    own = {"damping": lambda s: 0.1 * s, "damping_slope": lambda s: 0.1 + 0 * s}
    own["damping_flow"] = lambda s, h, xp: s * xp.exp(-rate * h) + begin
    return mine(MOTIONS["oscillator"][0], t_end=10.0, kind=cb.GeneralDamping, s=0.5, **own)


EXACT = {"gradient": lambda q: (q[0],), "hessian": lambda q: ((1.0,),)}


class OwnJacobian(cb.Mechanical):
    def jacobian(self, x):
        rows = super().jacobian(x)
        rows[1][0] *= 1.01
        return rows


@pytest.mark.parametrize(
    ("scene", "says"),
    [
        (driven(rate=0.101), r"span .* G is 0.101 at t = 0, h = 0.01, its rate there 0.1$"),
        (driven(phi=0.101), r"span .* φ is .* e\^{−G} there 0.999$"),
        (driven(begin=1e-3), "span's G is 0.001 at t = 0, h = 0: must be 0$"),
        (damped(rate=0.101), "damping_flow is not the damping's: its slope is"),
        (damped(begin=1e-3), "damping_flow is .* h = 0: must be"),
        (mine(MOTIONS["oscillator"][0], 1.0, 0.3, 5.0, OwnJacobian, **EXACT), r"jacobian .* \(2, 1\) is"),
    ],
)
def test_a_function_that_is_not_what_it_is_beside_is_refused(scene, says):
    for call in (lambda: cb.solve(scene, "rk4", step=0.1), lambda: cb.reference(scene, [1.0])):
        with pytest.raises(cb.BadInput, match=says):
            call()
    with pytest.raises(AssertionError):
        check_scene(scene)


def test_functions_that_fit_are_taken():
    for scene in (driven(), damped()):
        assert cb.solve(scene, "contact-strang", step=0.1).ok
        check_scene(scene)


# -- parts of each component's own size --------------------------------------------------------------
UNITS = (1.0, 1e3)
#: methods whose steps follow roundings in no way; by how much others' errors and counts change
EXACTLY, ALIKE = ("rk4", "rk8-7", "scipy-dop853"), 0.05
#: a turn of seven: an iteration counts what is at rest in parts of the whole state
A_TURN = 1 / 6


def two_masses(unit=1.0, **given):
    """A light mass on a heavy one, its coordinate in a unit of its own."""
    return cb.Mechanical(
        name="two_masses",
        potential=lambda q, unit: 1e5 * q[0] * q[0] + 50 * (q[1] / unit - q[0]) * (q[1] / unit - q[0]),
        parameters={"unit": unit},
        q=(0.01, 0.0),
        p=(0.0, 0.0),
        mass=(1000.0, 0.05 / unit**2),
        gamma=0.1,
        t_end=2.0,
        **given,
    )


def on_metric(unit=1.0):
    """An angle and a length: the mass is a function of q."""
    return cb.Mechanical(
        name="bead",
        mass=lambda q, unit: ((q[1] * q[1] / unit**2, 0.0), (0.0, 1 / unit**2)),
        potential=lambda q, unit: 5 * (q[1] / unit - 1) * (q[1] / unit - 1) - cb.math.cos(q[0]) * q[1] / unit,
        parameters={"unit": unit},
        q=(0.3, 1.1 * unit),
        p=(0.0, 0.2 / unit),
        gamma=0.1,
        t_end=2.0,
    )


def equations(unit=1.0):
    """Two species and a third that is not there yet, in a unit of its own."""
    return cb.Equations(
        rhs=lambda t, y, unit: (y[1] - y[0] / 10, -y[0], unit * (y[0] * y[0] - y[2] / unit)),
        y0=(1.0, 0.0, 0.0),
        parameters={"unit": unit},
        t_end=2.0,
    )


@pytest.mark.parametrize("scene", [two_masses, on_metric, equations])
@pytest.mark.parametrize(
    "method", ["rk4", "rk8-7", "contact-gauss4", "scipy-dop853", "cvode-adams", "heyoka-taylor"]
)
def test_the_unit_of_one_component_changes_neither_errors_nor_steps(scene, method):
    if METHODS[method].refuses(scene()):
        pytest.skip("a method for other scenes")
    adaptive = METHODS[method].adaptive
    for setting in [{"rtol": 1e-6}] if adaptive else [{"step": 0.004}, {"rtol": 1e-4}]:
        runs = [cb.solve(scene(unit), method, **setting, save_at=[1.0, 2.0], carry=()) for unit in UNITS]
        assert all(run.ok for run in runs)
        one, other = (cb.LAWS["solution_error"](run) for run in runs)
        assert other == pytest.approx(one, rel=ALIKE, abs=1e-12)
        counts = [run.counts.evaluations for run in runs]
        alike = A_TURN if METHODS[method].iterates else 0.0 if method in EXACTLY else ALIKE
        assert counts == pytest.approx([counts[0]] * 2, rel=alike)


def test_the_unit_of_one_component_changes_no_setting_of_a_race():
    found = []
    for unit in UNITS:
        scene = two_masses(unit)
        search = Search(
            Question(scene, cb.reference(scene, Elapsed(times(scene, ENDS)), ()), (1e-6,), 60.0), "rk8-7"
        )
        for _ in search.turns():
            pass
        best = search.best(1e-6)
        found.append((best.setting, best.evaluations))
    assert len({*found}) == 1


def test_an_error_of_a_light_mass_is_in_parts_of_its_own_swing():
    run = cb.solve(two_masses(), "rk8-7", rtol=1e-3, save_at=np.linspace(0.1, 2.0, 20), carry=())
    true = cb.reference(run.scene, run.t, ()).y
    own = np.abs(run.y - true).max(axis=0) / np.abs(np.vstack([run.y0, true])).max(axis=0)
    assert cb.LAWS["solution_error"](run) == pytest.approx(own.max())


def test_what_hardly_moves_is_measured_against_what_the_energy_would_let_it():
    """Two springs that know nothing of one another: one swings, E = ½, the other rests."""
    scene = cb.Mechanical(
        name="uncoupled",
        potential=lambda q: q[0] * q[0] / 2 + 50 * q[1] * q[1],
        q=(0.0, 0.0),
        p=(1.0, 0.0),
        mass=(1.0, 4.0),
        t_end=5.0,
    )
    rows = np.array([[0.0, 0.0, 1.0, 0.0], [1.0, 0.0, 0.0, 0.0]])
    assert sizes_of(scene.recorded(), rows, ()) == pytest.approx([1.0, FAINT / 10, 1.0, FAINT * 2])


def test_coordinates_of_one_mass_share_a_scale_and_momenta_another():
    scene = cb.SCENES["particle"].with_(mass=100.0)
    start = np.array([1.0, 0.5, 0.0, 0.3])
    assert sizes_of(scene, start[None], ()) == pytest.approx([np.hypot(1.0, 0.5), 0.3])
    moved = start + np.array([3e-3, 4e-3, 0.0, 0.0])
    assert errors(scene, moved[None], start[None], start, ()) == pytest.approx(5e-3 / np.hypot(1.0, 0.5))


def test_a_users_scale_rules():
    scene = two_masses(scale=(1.0, 2.0, 5.0, 10.0))
    run = cb.solve(scene, "rk8-7", rtol=1e-6, save_at=[2.0], carry=())
    assert run.run.request.atol == pytest.approx(1e-6 * np.array(scene.scale))
    gap = run.y - cb.reference(scene, [2.0], ()).y
    assert errors_of([run]) == pytest.approx((np.abs(gap) / scene.scale).max())
    for wrong in ((1.0, 2.0), (1.0, 2.0, 0.0, 1.0), 3.0):
        with pytest.raises(cb.BadInput, match="scale"):
            two_masses(scale=wrong)


@pytest.mark.parametrize("method", ["rk4", "scipy-dop853"])
@pytest.mark.parametrize("kind", ["mechanical", "body", "sphere", "free sphere", "equations"])
def test_a_motion_at_rest_has_no_error_and_warns_of_nothing(kind, method):
    scene = {
        "mechanical": cb.SCENES["oscillator"].with_(q=(0.0,), p=(0.0,)),
        "body": cb.SCENES["rigid_body"].with_(M=(0.0, 0.0, 0.0)),
        "sphere": cb.SCENES["spherical_pendulum"].with_(q=(0.0, 0.0, -1.0), p=(0.0, 0.0, 0.0)),
        "free sphere": cb.Spheres(
            potential=lambda q: 0.0 * q[0], name="free", q=(0, 0, -1), p=(0, 0, 0), t_end=1.0
        ),
        "equations": cb.Equations(rhs=lambda t, y: (-y[0],), y0=(0.0,), t_end=1.0),
    }[kind]
    with np.errstate(all="raise"):
        setting = {"rtol": 1e-6} if METHODS[method].adaptive else {"step": 0.1}
        found = cb.solve(scene.with_(t_end=1.0), method, **setting, save_at=[1.0]).laws()
    assert found.loc["solution_error", "deviation"] == 0


def test_two_solvers_agree_on_as_many_digits_in_any_unit():
    """Of a light mass, too: its digits are those of its own swing."""
    found = (doubles(two_masses(unit).recorded(), np.array([1.0, 2.0]), (), np.inf) for unit in UNITS)
    (one, digits), (other, known) = found
    assert abs(known - digits) <= 1
    assert other / [1, UNITS[1], 1, 1 / UNITS[1]] == pytest.approx(one, rel=1e-8)
