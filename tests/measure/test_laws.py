"""The laws measure what they say: zero on the truth, the planted size on a planted error, finite always."""

import dataclasses
import itertools
import math

import numpy as np
import pytest

import contactbench as cb
from cases import FIXED, TIMED, UNDERFLOW, by_name, pairs, saved
from contactbench.measure import laws
from contactbench.measure.law import JUDGEMENT
from contactbench.measure.laws import LAWS, laws_of, row
from contactbench.measure.pullback import growth, in_units
from contactbench.methods import prepared
from contactbench.runs.search import Question
from contactbench.runs.settings import times as save_times
from contactbench.scene.base import Elapsed
from contactbench.scene.scales import norms
from contactbench.scenes.driven import DRIVEN
from contactbench.solution import Solution, Status
from contactbench.truth import OutOfTime

TIMES = np.linspace(0.0, 20.0, 41)
STANDARD = [
    *(cb.SCENES[n] for n in ("oscillator", "particle", "central", "rigid_body", "rigid_body_anisotropic")),
    # no damping, states far from one
    cb.SCENES["oscillator"].with_(name="undamped", gamma=0.0),
    cb.SCENES["oscillator"].with_(name="tiny", q=(1e-8,), p=(0.0,), s=0.0),
    cb.SCENES["oscillator"].with_(name="huge", q=(1e8,), p=(0.0,), s=0.0),
]


def truth_as_solution(scene, times=TIMES):
    exact = cb.reference(scene, Elapsed(times))
    y0 = np.array(scene.pack(scene.initial(scene.optional)))
    return Solution(scene, "truth", "none", scene.optional, times, exact.y.copy(), y0=y0)


def of_the_states(scene):
    """The laws that need no run: neither the derivative of a map, nor the H̃ of which its steps are the flow."""
    names = [law.name for law in laws_of(scene) if "drift" not in law.name or law.name == "attitude_drift"]
    return [cb.LAWS[name] for name in names if name != "modified_hamiltonian"]


@by_name(STANDARD)
def test_every_law_vanishes_on_the_truth(scene):
    """Up to the rounding of the reference to float64, amplified by the decay."""
    solution = truth_as_solution(scene)
    for law in of_the_states(scene):
        assert law(solution) < 1e-13, law.name


@by_name([scene for scene in STANDARD if scene.name != "huge"])  # its error is all s, of 10¹⁶
def test_laws_see_a_planted_error(scene):
    """The last state off by 1e-3 relative (attitude excepted): all but the drift of an attitude must say so."""
    solution = truth_as_solution(scene)
    solution.y[-1, : len(scene.labels(()))] *= 1 + 1e-3
    blind = {"attitude_drift", "energy_increases"}
    seen = {law.name: law(solution) for law in of_the_states(scene) if law.name not in blind}
    assert min(seen.values()) > 1e-6, seen
    if "momentum_law" in seen:  # M, or q and p in J = q × p
        assert seen["momentum_law"] == pytest.approx(
            1e-3 if scene.name.startswith("rigid") else 2e-3, rel=2e-2
        )


def test_attitude_drift_sees_a_stretched_quaternion_and_the_error_not_its_sign():
    solution = truth_as_solution(cb.SCENES["rigid_body"])
    solution.y[:, 3:7] *= -1
    assert cb.LAWS["solution_error"](solution) < 1e-14
    solution.y[-1, 3:7] *= 1 + 1e-4  # R is of degree two, RᵀR of degree four, the identity has norm √3
    assert cb.LAWS["attitude_drift"](solution) == pytest.approx(4e-4 * math.sqrt(3), rel=1e-3)


@pytest.mark.parametrize(("name", "steps"), [("lane_emden_5", 25), ("large_step", 400), ("oscillator", 40)])
def test_an_error_is_relative_to_the_largest_true_state_the_start_included(name, steps):
    scene = cb.SCENES[name]
    t = [scene.t_end / 2, scene.t_end]
    run = cb.solve(
        scene, "contact-strang", step=scene.t_end / steps, save_at=scene.begins + np.array(t), carry=()
    )
    true, n = cb.reference(scene, Elapsed([0.0, *t]), ()).y, len(scene.q)
    (q, own_q), (p, own_p) = (([y[:, part] for y in (true, run.y)]) for part in (slice(n), slice(n, 2 * n)))
    assert np.abs(q[0]).max() > np.abs(q[1:]).max()  # the start is the largest
    pairs = ((q, own_q), (p, own_p))
    error = max(norms(own - y[1:], [n]).max() / norms(y, [n]).max() for y, own in pairs)
    assert LAWS["solution_error"](run) == pytest.approx(error, rel=1e-12)
    question = Question(scene, cb.reference(scene, Elapsed(t), ()), (1e-3,), 1.0)
    ends = [dataclasses.replace(run, t=run.t[[k]], y=run.y[[k]]) for k in range(2)]
    assert question.error(ends) == pytest.approx(error, rel=1e-9)


@pytest.mark.parametrize("size", [1e-8, 1.0, 1e8])
@pytest.mark.parametrize("bottom", [-1.0, 0.0, 1.0])
def test_energy_that_stays_does_not_grow_whatever_its_sign_and_size(bottom, size):
    """H0 a constant of either sign but for round-off of 2 ε, and one saved time 10 ε away: one rise."""
    slope = {"potential": lambda q: q[0], "gradient": lambda q: (1.0,)}
    scene = cb.Mechanical(name="level", **slope, gamma=0.1, q=(bottom * size,), p=(0.0,), t_end=4.0)
    eps = np.finfo(float).eps
    level = bottom * size * (1 + eps * np.array([0, 2, 0, 10, 0, 2, 0]))
    y = np.stack([level, 0 * level], axis=1)
    solution = Solution(scene, "planted", "none", (), np.arange(7.0), y, y0=y[0])
    assert cb.LAWS["energy_increases"](solution) == (1 if bottom else 0)


def test_contact_drift_is_that_of_the_derivative():
    """Finite differences of the numerical map, an independent derivative, to their accuracy."""
    scene = cb.SCENES["particle"].with_(t_end=2.0)
    run = cb.prepare(scene, "rk4", step=0.5, save_at=[2.0])
    solution = run()

    def end(y):
        return run(q=tuple(y[:2]), p=tuple(y[2:4]), s=y[4]).y[-1]

    eps = 1e-6
    D = np.column_stack([end(solution.y0 + d) - end(solution.y0 - d) for d in eps * np.eye(5)]) / (2 * eps)
    p0, p1 = solution.y0[2:4], solution.y[-1, 2:4]
    pulled = D[4] - p1 @ D[:2]
    form = np.array([-p0[0], -p0[1], 0, 0, 1])
    expected = np.linalg.norm(pulled * math.exp(0.2) - form) / np.linalg.norm(form)
    assert cb.LAWS["contact_drift"](solution) == pytest.approx(expected, rel=1e-6)
    cosine = pulled @ form / np.linalg.norm(pulled) / np.linalg.norm(form)
    assert cb.LAWS["distribution_drift"](solution) == pytest.approx(math.sqrt(1 - cosine**2), rel=1e-6)


@pytest.mark.parametrize("method", ["contact-strang", "rk4"])
def test_laws_stay_finite_when_everything_underflows(method):
    """e^{−2γT} = e^{−2000}: M is subnormal or zero at the end, and no law may be nan or inf."""
    solution = cb.solve(UNDERFLOW, method, step=0.05, save_at=saved(UNDERFLOW))
    assert solution.ok
    assert np.abs(solution.M[-1]).max() < 1e-307
    found = {law.name: law(solution) for law in laws_of(UNDERFLOW)}
    assert all(map(math.isfinite, found.values()))
    assert found["momentum_law"] < 1e-12  # rk4 moves on the clock that the damping slows


def test_laws_say_what_they_need():
    with pytest.raises(cb.BadInput, match="not defined for scene 'oscillator'"):
        cb.LAWS["momentum_law"](cb.solve("oscillator", "rk4", step=0.1))
    with pytest.raises(cb.BadInput, match="needs carry=\\('R',\\)"):
        cb.LAWS["momentum_law"](cb.solve("rigid_body", "rk4", step=0.1, carry=("s",)))
    with pytest.raises(cb.BadInput, match="needs carry=\\('s',\\)"):
        cb.LAWS["hamiltonian_law"](cb.solve("particle", "rk4", step=0.1, carry=()))


def test_a_run_that_did_not_end_ok_has_no_law():
    solution = cb.solve("particle", "rk4", step=0.1)
    broken = dataclasses.replace(solution, status=Status.budget)
    assert math.isnan(cb.LAWS["solution_error"](broken))


def test_without_a_derivative_the_laws_that_need_one_are_left_out():
    solution = cb.solve("particle", "rk4", step=0.5)
    missing = {*row(solution)} - {*row(solution, without="not wanted")}
    assert missing >= {"contact_drift", "distribution_drift", "pairing_drift"}
    assert not [name for name in missing & {*cb.LAWS} if "drift" not in name]


def test_entries_taken_against_their_terms_are_counted():
    """e^{−50·100} of terms of size 10⁻² at both saved times; e^{−2} of them on the central scene."""
    strong = cb.solve("overdamped", "contact-strang", step=0.5, save_at=[50.0, 100.0])
    assert [LAWS[name].measured(strong).clamped for name in ("contact_drift", "hamiltonian_law")] == [2, 2]
    mild = cb.solve("central", "contact-strang", step=0.1, save_at=[10.0, 20.0])
    laws = ("contact_drift", "pairing_drift", "hamiltonian_law", "momentum_law")
    assert {LAWS[name].measured(mild).clamped for name in laws} == {0}


# -- judgements ------------------------------------------------------------------------------------
STATE, MAP = {"momentum_law", "attitude_drift"}, {"contact_drift", "pairing_drift"}
OWN = {"distribution_drift"}


def judged(scene, method, **setting):
    solution = cb.solve(scene, method, save_at=save_times(cb.SCENES[scene]), **setting)
    columns = row(solution) | {"evaluations": solution.counts.evaluations}
    columns["growth"] = growth(in_units(solution)) if solution.differential.taken else 1.0
    laws = [name for name, law in LAWS.items() if law.structural and f"{name}_claimed" in columns]
    assert laws
    return columns, {name: {what: columns[f"{name}_{what}"] for what in JUDGEMENT} for name in laws}


#: a method on a scene, and the laws it promises there
PROMISES = [
    ("central", "contact-rkn4", {"step": 0.2}, {"momentum_law"} | MAP | OWN),
    ("rigid_body", "contact-strang", {"step": 0.2}, STATE | OWN | {"contact_drift"}),
    ("lane_emden_5", "contact-rkn4", {"step": 0.2}, MAP | OWN),
    ("duffing", "contact-rkn4", {"step": 0.05}, MAP | OWN),  # chaotic: the map grows
    ("quadratic_damping", "contact-rkn4", {"step": 0.2}, OWN),
    ("central", "herglotz2", {"step": 0.05}, OWN),
    ("central", "rk4", {"step": 0.05}, set()),
    ("central", "cyrk-vern8", {"rtol": 1e-8}, set()),
]


@pytest.mark.parametrize(("scene", "method", "setting", "claimed"), PROMISES)
def test_a_law_that_is_claimed_is_kept(scene, method, setting, claimed):
    """And no other is claimed; the truth's factor where Γ' follows s is nobody's to promise."""
    columns, by_law = judged(scene, method, **setting)
    assert {name for name, found in by_law.items() if found["claimed"]} == claimed
    for name in claimed:
        assert by_law[name]["kept"], name
        round_off = 2.0**-52 * columns["evaluations"] * max(1, columns["growth"])
        assert name in STATE or columns["bound"] == pytest.approx(max(1e-12, round_off))
    assert claimed or not by_law["contact_drift"]["kept"]


#: bodies under a torque, of extreme moments, next to a separatrix, all but stopped; rates that change with time; chaos
HARD = [cb.SCENES[name] for name in ("heavy_top", "needle", "tumbling")] + [UNDERFLOW]
HARD += [scene.with_(t_end=min(scene.t_end, 20.0)) for scene in (*DRIVEN, *TIMED)]


@pairs([method for method in FIXED if method.contact], HARD)
@pytest.mark.quick(scene="tumbling")
@pytest.mark.quick(
    method="contact-rkn4", scene=("heavy_top", "needle", "underflow", "lane_emden_5", "duffing")
)
@pytest.mark.quick(method="contact-gauss4", scene="duffing")
def test_contact_methods_keep_what_they_claim_at_a_coarse_step(method, scene):
    """To round-off times the growth of the map, which is 10⁷ tumbling."""
    steps = 200 if method.iterates and method.order == 2 else 100  # its iteration needs more
    solution = cb.solve(scene, method.name, step=scene.t_end / steps, save_at=scene.begins + saved(scene))
    columns = row(solution)
    claimed = {name for name, law in LAWS.items() if law.structural and columns.get(f"{name}_claimed")}
    assert claimed >= OWN
    for name in claimed:
        grown = max(1.0, growth(in_units(solution))) if name in MAP | OWN else 1.0
        assert columns[name] < 3e-13 * grown, name


@pytest.mark.parametrize("step", [1.0, 0.1])
def test_a_run_that_does_not_follow_the_motion_is_not_judged(step):
    columns, by_law = judged("central", "contact-strang", step=step)
    follows = columns["solution_error"] <= 0.1
    assert follows == (step < 1)
    assert math.isfinite(columns["bound"]) == follows
    for found in by_law.values():
        assert (found["claimed"], found["kept"]) == (True, True if follows else None)


def test_an_error_of_the_motion_does_not_depend_on_a_constant_in_the_potential():
    own = {"gamma": 0.01, "q": (1.0,), "p": (0.0,), "t_end": 20.0}
    well = cb.Mechanical(name="well", potential=lambda q: q[0] ** 4 / 4 - 1000.0, **own)
    with_action, without = (cb.solve(well, "rk4", step=0.5, save_at=[2.0], carry=c) for c in (("s",), ()))
    error = cb.LAWS["solution_error"](without)
    assert error > 1e-3
    assert cb.LAWS["solution_error"](with_action) == pytest.approx(error, rel=1e-6)


# -- how long it may take ------------------------------------------------------------------------------
def short_run():
    return cb.solve(cb.SCENES["particle"].with_(t_end=1.0), "scipy-radau", rtol=1e-5, save_at=[1.0])


def test_laws_measure_the_map_of_a_solver_that_calls_back(monkeypatch):
    """By a limit of time, not one of right-hand sides, which is that of tables."""
    monkeypatch.setattr(prepared, "CALLBACK_BUDGET", 1)
    assert "60 runs would cost" in short_run().differential.source
    run = short_run()
    assert 1e-9 < run.laws(seconds=math.inf).loc["contact_drift", "deviation"] < 1e-2
    assert run.differential.taken


def test_laws_end_in_time_and_say_what_there_was_no_time_for(monkeypatch):
    """On a clock that a look at moves by a second."""
    now, run = itertools.count(), short_run()
    with monkeypatch.context() as patch:
        for module in (prepared, laws):
            patch.setattr(module, "perf_counter", lambda: float(next(now)))
        notes = run.laws(seconds=20.0)["note"]
    assert "60 runs take about 120 s, 17 s were left" in notes["contact_drift"]
    assert next(now) < 40
    assert run.laws(seconds=math.inf).loc["contact_drift", "deviation"] > 0  # is taken where there is more


def test_a_reference_that_takes_too_long_is_sought_again(monkeypatch):
    given = list[float]()

    def late(*_, seconds):
        given.append(seconds)
        raise OutOfTime("no reference in time", 1.0)

    run = short_run()
    with monkeypatch.context() as patch:
        patch.setattr(laws, "reference", late)
        assert run.laws(seconds=7.0).loc["solution_error", "note"] == "no reference in time"
    assert 0 < given[0] <= 7
    assert run.laws().loc["solution_error", "deviation"] > 0


@pytest.mark.parametrize("seconds", [0, -1.0, math.nan, "ten", None])
def test_a_limit_that_is_none_is_refused(seconds):
    with pytest.raises(cb.BadInput, match="seconds = "):
        short_run().laws(seconds=seconds)
