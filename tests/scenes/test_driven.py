"""Scenes with time, and hard ones: closed forms, orders, the contact form under γ(t), chaos; every method on them."""

import math

import numpy as np
import pytest

import contactbench as cb
from cases import (
    DETEST_E3,
    FORCED_PULSATING,
    HARD,
    LANE_EMDEN_1,
    after_pulse,
    by_name,
    few_slow,
    mine,
    pairs,
    pulse,
    refusal,
    saved,
)
from contactbench.measure.laws import laws_of, row
from contactbench.measure.order import order_at
from contactbench.methods.fixed_step import FixedStep
from contactbench.numbers import quadrature
from contactbench.scene.base import Elapsed
from contactbench.scenes.driven import DRIVEN, FORCED_OSCILLATOR, LANE_EMDEN_5
from contactbench.truth import blow_up_time, condition_number, decimal_context

STEPPED = [method for method in cb.METHODS.values() if isinstance(method, FixedStep)]
CONTACT = [method for method in STEPPED if method.contact]


def test_closed_forms_are_those_of_the_textbook():
    """sin t/t, and 2(1 + 16 t²/3)^{−1/2}, a homologous image of (1 + t²/3)^{−1/2}."""
    thetas = lambda t: np.sin(t) / t, lambda t: 2 * (1 + 16 * t * t / 3) ** -0.5
    for scene, theta in zip((LANE_EMDEN_1, LANE_EMDEN_5), thetas, strict=True):
        found = cb.reference(scene, Elapsed(saved(scene)))
        assert (found.source, found.digits >= 40) == ("closed form", True)
        np.testing.assert_allclose(found.y[:, 0], theta(scene.t + saved(scene)), rtol=0, atol=1e-15)


@by_name([FORCED_OSCILLATOR, LANE_EMDEN_1])
def test_a_closed_form_is_that_of_any_start(scene):
    """The reference takes none that does not begin where the scene does and solve its equations."""
    moved = scene.with_(q=(0.7 * scene.q[0] + 0.2,), p=(scene.p[0] - 0.3,), s=0.4, t=scene.t + 0.25)
    assert cb.reference(moved, Elapsed(saved(moved))).source == "closed form"
    if scene is FORCED_OSCILLATOR:
        assert cb.reference(moved.with_(mass=1.7), Elapsed(saved(moved))).source == "closed form"


# -- what other authors print ------------------------------------------------------------------------
def test_the_published_solution_of_detest():
    """Enright, Pryce, ACM Trans. Math. Softw. 13, 28 (1987), Algorithm 648: the end of E3, 16 digits printed."""
    published = (-1.004178858647128e-1, 2.411400132095954e-1)
    found = cb.reference(DETEST_E3, Elapsed([DETEST_E3.t_end]), ()).y[0, :2]
    np.testing.assert_allclose(found, published, rtol=0, atol=2e-14)
    end = cb.solve(DETEST_E3, "contact-rkn6", step=0.05, save_at=[DETEST_E3.t_end], carry=()).y[0, :2]
    np.testing.assert_allclose(end, published, rtol=0, atol=1e-12)


# -- γ(t) without a closed form of its integral --------------------------------------------------------
@pytest.mark.parametrize(("size", "turn"), [(0.1, 1.0), (1.0, 2.0), (0.5, 4.0)])
def test_integrals_of_the_damping_over_a_step_are_right_to_round_off(size, turn):
    """γh ≤ 1 and νh ≤ 1, steps back among them; of twice the length to 10⁻¹¹; against quadrature at 30 digits."""
    xp, scene = decimal_context(30), FORCED_PULSATING.with_(friction=size, depth=0.9, pulse=turn, t=0.0)
    longest = min(1 / (1.9 * size), 1 / turn)
    for t in (0.0, 1.25):  # binary fractions, so that t + h is what it says
        for h, off in ((longest, 4e-15), (-longest / 2, 4e-15), (2 * longest, 1e-11)):
            h = round(h * 64) / 64

            def total(u, t=t):
                return size * (u - t) - size * xp.mpf("0.9") / turn * (xp.cos(turn * u) - xp.cos(turn * t))

            phi = xp.quad(lambda u, total=total: xp.exp(-total(u)), xp.linspace(t, t + h, 5))
            found = scene.spent(t, h, math)
            assert abs(found[0] - total(t + h)) < off * abs(h) * size
            assert abs(found[1] / phi - 1) < off


def test_the_rule_integrates_polynomials_with_all_digits_of_its_numbers():
    """Weights up to degree 15, the matrix up to degree 7."""
    for xp, bound in ((math, 4e-16), (decimal_context(60), 1e-58)):
        nodes, weights, matrix = quadrature.rule(xp)[:3]
        for k in range(16):
            assert abs(quadrature.weigh(weights, [c**k for c in nodes]) * (k + 1) - 1) < 4 * bound
        for c, row_of in zip(nodes, matrix, strict=True):
            for k in range(8):
                assert abs(quadrature.weigh(row_of, [c**k for c in nodes]) * (k + 1) - c ** (k + 1)) < bound


# -- order -----------------------------------------------------------------------------------------
#: steps in t = 2: few where the damping is integrated by a rule, dear at fifty digits
STEPS = {FORCED_OSCILLATOR.name: 64, LANE_EMDEN_5.name: 64, FORCED_PULSATING.name: 8}


@pairs(CONTACT, [FORCED_OSCILLATOR, LANE_EMDEN_5, FORCED_PULSATING])
@pytest.mark.quick(scene="forced_pulsating", method=("contact-rkn4", "contact-gauss4"))
@pytest.mark.quick(scene="forced_oscillator", method=("contact-strang", "contact-rkn6"))
def test_order_at_fifty_digits(method, scene):
    assert order_at(method, scene, 2.0, STEPS[scene.name]) == pytest.approx(method.order, abs=0.1)


def solution_error(scene, name, **setting):
    return cb.LAWS["solution_error"](cb.solve(scene, name, save_at=scene.begins + saved(scene), **setting))


@pytest.mark.parametrize("name", ["rk4", "herglotz1", "herglotz2"])
def test_order_of_the_others(name):
    coarse, fine = (solution_error(FORCED_OSCILLATOR, name, step=h) for h in (0.1, 0.05))
    assert math.log2(coarse / fine) == pytest.approx(cb.METHODS[name].order, abs=0.25)


# -- contact form ----------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["herglotz1", "herglotz2"])
def test_herglotz_maps_keep_the_distribution_with_a_factor_of_their_own(name):
    """(1 − ½γ_k h)/(1 + ½γ_{k+1} h) and 1 − γ_k h with the γ of the time; off from e^{−∫γ} by their order."""
    times = 1.0 + saved(LANE_EMDEN_1)
    columns = row(cb.solve(LANE_EMDEN_1, name, step=0.1, save_at=times))
    assert columns["distribution_drift"] < 1e-13
    assert columns["contact_drift"] > 1e-4
    # 1 − γh = −0.6 in the first step, γ being 2 there
    assert row(cb.solve(LANE_EMDEN_1, name, step=0.8, save_at=times))["distribution_drift"] < 1e-13


def test_laws_of_h_are_not_claimed_where_time_is_in_it():
    names = {law.name for scene in DRIVEN for law in laws_of(scene)}
    assert not names & {"hamiltonian_law", "modified_hamiltonian", "momentum_law", "energy_increases"}
    assert {"contact_drift", "pairing_drift", "solution_error"} <= names


# -- wherever a scene may go ---------------------------------------------------------------------------
#: no damping, critical damping, resonance, a constant force, without a spring
VANISHING = [{"gamma": 0.0}, {"gamma": 2.0}, {"gamma": 0.0, "drive": 1.0}, {"omega": 0.0, "drive": 0.0}]
VANISHING += [{"gamma": 0.0, "omega": 0.0, "drive": 0.0}, {"gamma": 0.0, "omega": 0.0}]


@pytest.mark.parametrize("changes", VANISHING, ids=str)
def test_the_forced_oscillator_has_its_closed_form_where_denominators_vanish(changes):
    assert solution_error(FORCED_OSCILLATOR.with_(**changes), "scipy-dop853", rtol=1e-12) < 1e-10


# -- breaks ------------------------------------------------------------------------------------------
JUMP = 7.3
#: a spring whose stiffness jumps, either side's at the jump itself
SIDES = {"left": lambda t: 1.0 if t <= JUMP else 3.0, "right": lambda t: 1.0 if t < JUMP else 3.0}
#: substeps lead out of their steps
SECOND_ORDER = ("contact-rkn8", "contact-printed")


def jumping(side="left", **changes):
    stiffness = SIDES[side]
    own = {"kind": cb.Driven, "gradient": lambda q, t: (stiffness(t) * q[0],), "breaks": (JUMP,)}
    return mine(lambda q, t: stiffness(t) * q[0] * q[0] / 2, **own | {"gamma": 0.1, "t_end": 12.0} | changes)


def damped(q, p, gamma, stiffness, t):
    """Return (q, p) of q'' = −γ q' − k q after a time."""
    omega = math.sqrt(stiffness - gamma * gamma / 4)
    a, b = q, (p + gamma * q / 2) / omega
    c, s, decay = math.cos(omega * t), math.sin(omega * t), math.exp(-gamma * t / 2)
    x = decay * (a * c + b * s)
    return x, decay * omega * (b * c - a * s) - gamma * x / 2


AFTER_JUMP = damped(*damped(1.0, 0.0, 0.1, 1.0, JUMP), 0.1, 3.0, 12.0 - JUMP)


AFTER_PULSE = after_pulse()


def end(run):
    assert run.ok, run.message
    return run.y[-1, :2]


@pytest.mark.parametrize("side", few_slow(SIDES, "right"))
def test_the_truth_of_a_jump_is_that_of_the_textbook(side):
    found = cb.reference(jumping(side), [JUMP, 12.0], ())
    assert found.y[-1, :2] == pytest.approx(AFTER_JUMP, abs=1e-12)
    assert 10 <= found.digits <= 14


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("method", [m for m in STEPPED if m.refuses(jumping()) is None], ids=lambda m: m.name)
@pytest.mark.quick(side="left")
@pytest.mark.quick(side="right", method=("contact-strang", "contact-gauss2"))
def test_a_jump_costs_no_order(method, side):
    """But for substeps outside their steps; h = 0.1 and 0.05, the order less a half, or round-off."""
    errors = []
    for h in (0.1, 0.05):
        run = cb.solve(
            jumping(side), method, step=h, save_at=[JUMP, 12.0], carry=(), engine=method.engines[-1]
        )
        errors.append(np.abs(end(run) - AFTER_JUMP).max())
    if method.name not in SECOND_ORDER:
        assert errors[1] < max(errors[0] / 2 ** (method.order - 0.5), 1e-12)
    assert errors[1] < 0.05


@pytest.mark.parametrize("name", ["scipy-dop853", "scipy-radau", "cvode-adams", "cvode-bdf"])
def test_peers_with_callbacks_take_jumps(name):
    """Once behind the jump, none evaluates anything before it, as a step over it would that is rejected."""
    times, jump = [], jumping()

    def gradient(q, t):
        times.append(t)
        return (jump.dV(q, t)[0],)

    engine = "c+python" if name.startswith("cvode") else "python"
    options = {"rtol": 1e-10, "save_at": [1.0, JUMP, 12.0], "carry": (), "engine": engine}
    run = cb.prepare(jump.with_(gradient=gradient), name, **options)
    times.clear()
    assert np.abs(end(run()) - AFTER_JUMP).max() < 1e-6
    behind = np.array(times) > JUMP
    assert 0 < behind.sum() < len(behind)
    assert np.all(np.diff(behind.astype(int)) >= 0)


PEERS = [m for m in cb.METHODS.values() if m.own_time and m.refuses(pulse()) is None]
#: XLA compiles for seconds
LONG = [m for m in PEERS if "jax" in m.engines or m.name == "scipy-radau"]


@pytest.mark.parametrize("method", few_slow(PEERS, *LONG), ids=lambda m: m.name)
def test_every_peer_ends_steps_at_breaks_and_sees_the_pulse(method):
    """At rest before it, nearly all step over it otherwise; equal saved states however many are saved."""
    scene = pulse(breaks=(13.0, 13.3, 13.6))
    run = cb.prepare(scene, method, rtol=1e-8, save_at=[20.0], carry=())
    found = run()
    assert np.abs(end(found) - AFTER_PULSE).max() < 2e-6
    assert np.array_equal(run.bare(run.start), found.y[-1])
    more = cb.solve(scene, method, rtol=1e-8, save_at=[0.0, 5.0, 13.3, 15.0, 20.0], carry=())
    assert np.abs(end(more) - AFTER_PULSE).max() < 2e-6
    assert np.abs(more.y[1, :2]).max() < 1e-13
    assert found.counts.steps > 4
    assert run(q=(0.5,)).sensitivity.shape == (1, 3, 2)
    short = cb.solve(scene, method, rtol=1e-8, max_steps=5, carry=())
    assert short.status is cb.Status.budget
    assert np.isnan(short.y[-1]).all()


def test_what_steps_over_a_pulse_is_seen_in_its_laws():
    run = cb.solve(pulse(), "cvode-adams", rtol=1e-8, save_at=[20.0])
    assert run.ok
    assert run.laws().loc["solution_error", "deviation"] > 0.1


@pytest.mark.parametrize(
    ("engine", "setting"), [("llvm", {"step": 0.01}), ("python", {"step": 0.01}), ("llvm", {"rtol": 1e-7})]
)
def test_steps_end_at_breaks_on_every_engine(engine, setting):
    scene = pulse(breaks=(13.0, 13.6))
    times = [0.0, 13.0, 15.0, 20.0]
    run = cb.solve(scene, "contact-rkn6", engine=engine, save_at=times, **setting)
    assert np.abs(end(run) - AFTER_PULSE).max() < 1e-6
    assert run.t.tolist() == times
    assert cb.LAWS["contact_drift"](run) < 1e-13
    alone = cb.solve(scene, "contact-rkn6", engine=engine, save_at=[20.0], **setting)
    assert np.abs(end(alone) - end(run)).max() < 1e-7


def test_prescribed_steps_are_to_end_at_breaks():
    scene = jumping(t_end=12.0)
    run = cb.solve(scene, "contact-strang", step=[0.073] * 100 + [0.047] * 100, engine="python")
    other = cb.solve(jumping("right"), "contact-strang", step=[0.073] * 100 + [0.047] * 100, engine="python")
    assert np.abs(end(run) - AFTER_JUMP).max() < 4e-3
    assert np.abs(run.y - other.y).max() < 1e-12
    assert "none of which ends at t = 7.3" in refusal(
        lambda: cb.prepare(scene, "contact-strang", step=[0.2] * 60, engine="python", save_at=[12.0])
    )


@pytest.mark.parametrize("begin", few_slow([JUMP, 9.0], 9.0))
def test_a_run_may_begin_at_a_break_or_behind_it(begin):
    scene = jumping(t=begin, t_end=3.0)
    early = damped(1.0, 0.0, 0.1, 1.0, max(JUMP - begin, 0.0))
    true = damped(*early, 0.1, 3.0, 3.0 - max(JUMP - begin, 0.0))
    assert cb.reference(scene, [begin + 3.0], ()).y[0, :2] == pytest.approx(true, abs=1e-11)
    for name, setting in (("contact-rkn6", {"step": 0.02}), ("scipy-dop853", {"rtol": 1e-12})):
        run = cb.solve(scene, name, engine="python", save_at=[begin + 1.0, begin + 3.0], **setting)
        assert end(run) == pytest.approx(true, abs=1e-10)


@pytest.mark.parametrize(
    ("ask", "says"),
    [
        (lambda: pulse(breaks=(2.0, 1.0)), "breaks = (2.0, 1.0): must be increasing"),
        (lambda: pulse(breaks=(1.0, math.nan)), "must be increasing finite times"),
        (lambda: pulse(breaks="soon"), "increasing finite times"),
        (lambda: cb.prepare(jumping(), "rk4", step=0.1, engine="python")(t=1.0), "scene.with_(t=1)"),
        (lambda: cb.scipy.Contact("contact-strang", pulse(breaks=(1.0,))), "none of its breaks"),
    ],
)
def test_breaks_are_refused_where_they_are_none_or_cannot_be_kept(ask, says):
    assert says in refusal(ask)


# -- hard scenes -------------------------------------------------------------------------------------
@pytest.mark.parametrize("scene", HARD, ids=lambda scene: scene.name)
def test_every_hard_scene_has_a_truth(scene):
    times = saved(scene, 25)
    if scene.name == "escape":
        time, digits = blow_up_time(scene)
        assert digits >= 30
        run = cb.solve(scene, "scipy-dop853", rtol=1e-12, save_at=[scene.t_end])
        assert run.end_time == pytest.approx(float(time), abs=1e-9)  # another solver
        times = times[times < float(time)]
    truth = cb.reference(scene, Elapsed(times))
    assert truth.source in ("closed form", "frozen"), f"run python references/generate.py {scene.name}"
    assert truth.digits >= 30


# -- what is known about them ----------------------------------------------------------------------
#: dampings by what is in their kernel: the middle axis, that of least inertia, two axes
SINGULAR = {"middle": (0.5, 0.0, 0.5), "least": (0.0, 0.5, 0.5), "two": (0.0, 0.0, 0.5)}


@pytest.mark.parametrize("kernel", few_slow(SINGULAR, "least", "two"))
def test_singular_damping_ends_in_a_steady_rotation_and_contact_methods_find_it(kernel):
    scene = cb.SCENES["singular_damping_2"].with_(damping=SINGULAR[kernel])
    end = cb.reference(scene, Elapsed([scene.t_end]), ()).y[0]
    slope = np.array(scene.rhs(cb.scene.BodyState(tuple(end))).M)
    assert np.abs(end).max() > 0.1
    assert np.abs(slope).max() < 1e-3 * np.abs(end).max()
    found = cb.solve(scene, "contact-rkn4", step=0.05, save_at=[scene.t_end], carry=(), engine="python")
    np.testing.assert_allclose(found.y[0], end, rtol=0, atol=1e-6)


@pytest.mark.parametrize("name", ["saddle_edge", "tumbling"])
def test_condition_numbers_are_the_growth_of_errors(name):
    """Against the derivative of a run, by dual numbers through its steps: an independent engine and derivative."""
    scene = cb.SCENES[name]
    solution = cb.solve(scene, "rk8", step=scene.t_end / 4000, save_at=scene.begins + saved(scene, 25))
    growth = np.linalg.norm(solution.sensitivity, ord=2, axis=(1, 2)).max()
    # other times, and unit tangents instead of coordinates
    assert 0.2 * condition_number(scene) < growth < 3 * condition_number(scene)
    assert condition_number(scene.with_(gamma=0.7)) is None


@pytest.mark.slow
def test_blow_up_time_against_an_integral():
    """q'' = 3q²/2, q = 1/(t* − t)² · 4: from q(0) = 4, p(0) = 8 the end is at t = 1 exactly."""
    scene = mine(lambda q: -(q[0] ** 3) / 2, 4.0, 8.0, 3.0)
    time, digits = blow_up_time(scene)
    assert digits >= 30
    assert float(time) == 1.0
    assert blow_up_time(cb.SCENES["particle"].with_(gamma=0.3)) is None


# -- laws where numbers run out --------------------------------------------------------------------
@pytest.mark.parametrize("method", ["contact-abc", "contact-strang", "contact-rkn6", "rk4"])
def test_contact_drift_of_the_overdamped_oscillator_means_something(method):
    """e^{−γT} = e^{−5000} of terms of size 10⁻²: round-off is told from a real drift all the same."""
    solution = cb.solve("overdamped", method, step=0.05, save_at=[50.0, 100.0])
    assert solution.ok
    drift = cb.LAWS["contact_drift"](solution)
    assert drift < 1e-12 if method != "rk4" else 1e-9 < drift < 1e6


def test_a_solver_that_calls_python_steps_back_from_a_wall_as_its_compiled_twin_does():
    """In Python e^x raises where it is inf elsewhere, and the step is refused that led there."""
    wall = cb.SCENES["steep_wall"].with_(p=(0.5,))
    one, other = (cb.solve(wall, f"{library}-dop853", rtol=1e-7) for library in ("scipy", "cyrk"))
    assert one.ok
    assert one.counts.rejected
    assert one.y[-1] == pytest.approx(other.y[-1], rel=1e-9)
