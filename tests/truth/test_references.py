"""The truth layer: frozen files are what they claim, and the right source answers."""

import ast
import importlib.util
import json
import math
import shutil
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import contactbench as cb
from cases import Ticks, few_slow, mine, refusal
from contactbench import truth
from contactbench.errors import BadInput
from contactbench.scene import Mechanical, State
from contactbench.scene.base import Elapsed
from contactbench.scenes import SCENES
from contactbench.truth import digest, engines, reference
from contactbench.truth.engines import heyoka_reads_rhs
from contactbench.truth.reference import closed_form, confirmed

references = importlib.import_module("contactbench.truth.reference")  # `truth.reference` is its function
FOLDER = Path(__file__).parents[2] / "references"
ENTRIES = json.loads((FOLDER / "MANIFEST.json").read_text(encoding="utf-8"))["scenes"]


@pytest.fixture(scope="module")
def generate():
    spec = importlib.util.spec_from_file_location("generate", FOLDER / "generate.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def stored(name):
    """Times and rows of a frozen file as 60-digit numbers, and the context they live in."""
    entry = ENTRIES[name]
    context = truth.decimal_context(60)
    _, rows = truth.table(FOLDER / entry["file"], entry["sha256"])
    return context, [row[0] for row in rows], [[context.mpf(x) for x in row[1:]] for row in rows]


def shared_digits(*both):
    """Return to how many digits, of 40, two tables of decimals agree."""
    context = truth.decimal_context(60)
    return truth.agreeing_digits(*([[context.mpf(x) for x in row] for row in rows] for rows in both), 40)


# -- the frozen files ------------------------------------------------------------------------------
#: take two seconds and more
LONG = ("particle_long", "kepler_drag", "kepler", "stiff_spring", "double_pendulum", "needle")
LONG += ("heavy_top", "thermostat", "polar")


@pytest.mark.parametrize("name", few_slow(ENTRIES, *LONG))
def test_every_stored_number_is_computed_again(name):
    """A changed number whose digest is put right, anywhere in a file; by one precision of one engine.

    This ties the files to the formulas, which mpmath reads as heyoka does: a changed force keeps its name, and with it
    the digest.
    """
    scene = SCENES[name]
    _, times, rows = stored(name)
    assert heyoka_reads_rhs(scene, rows, scene.carry())
    gaps = truth.disagreement(truth.taylor(scene, times, scene.carry(), 160), rows)
    worst = max(gap / scale for gap, scale in zip(gaps, truth.scales(rows), strict=True))
    assert truth.matching_digits(worst, 60) >= 30


def test_every_scene_to_be_frozen_is(generate):
    assert not [f"{scene.name}: {why}" for scene in generate.FROZEN if (why := generate.missing(scene))]


@pytest.mark.parametrize(("changes", "why"), [({"name": "mine"}, "nothing"), ({"gamma": 0.3}, "definition")])
def test_a_scene_without_its_reference_is_told_the_command(generate, changes, why):
    scene = SCENES["particle"].with_(**changes)
    (told,) = generate.check(scene)
    assert why in told
    assert told.endswith(f"run python references/generate.py {scene.name}")


@pytest.mark.parametrize("name", ENTRIES)
def test_frozen_files_match_manifest_and_scene_and_give_the_rounded_decimals(name):
    """Their SHA-256 is compared wherever they are read."""
    scene, entry = SCENES[name], ENTRIES[name]
    assert (entry["scene_digest"], entry["grid"]["t_end"]) == (digest(scene), scene.t_end)
    assert min(entry["digits"], *(entry[e]["agreeing_digits"] for e in ("engine", "second_engine"))) >= 30
    _, times, rows = stored(name)
    decimals, digits, source = truth.frozen(scene, np.array([*map(float, times)]), scene.carry())
    assert (source, digits) == ("frozen", entry["digits"])
    assert [float(x) for x in decimals[0]] == scene.pack(scene.initial(scene.carry()))
    assert [[float(x) for x in row] for row in decimals] == [[float(x) for x in row] for row in rows]


def test_planted_wrong_digit_is_noticed(generate, tmp_path, monkeypatch):
    """Beside what is computed again, here the true file."""
    scene = SCENES["oscillator"]
    again = (FOLDER / "oscillator.csv").read_text(), ENTRIES["oscillator"]
    monkeypatch.setattr(generate, "compute", lambda scene: again)
    for file in ("oscillator.csv", "MANIFEST.json"):
        shutil.copy(FOLDER / file, tmp_path / file)
    path = tmp_path / "oscillator.csv"
    lines = path.read_text().splitlines()
    cells = lines[77].split(",")
    place = 32  # of the characters of q1: far beyond double precision
    cells[1] = cells[1][:place] + str((int(cells[1][place]) + 5) % 10) + cells[1][place + 1 :]
    lines[77] = ",".join(cells)
    path.write_text("\n".join(lines) + "\n")
    by_sum, by_digit = generate.check(scene, tmp_path)  # and nothing else is wrong
    assert "SHA-256" in by_sum
    assert by_digit.startswith(f"q1 at t = {cells[0]}")


def test_damaged_file_is_never_used(monkeypatch, tmp_path):
    for path in (FOLDER / "particle.csv", FOLDER / "MANIFEST.json"):
        shutil.copy(path, tmp_path / path.name)
    with open(tmp_path / "particle.csv", "a") as file:
        file.write("\n")
    monkeypatch.setitem(truth.frozen.__globals__, "frozen_folder", lambda: tmp_path)
    with pytest.raises(BadInput, match="SHA-256"):
        truth.frozen(SCENES["particle"], np.array([0.1]), ())


# -- which source answers --------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "carry", "changes", "times", "source"),
    [
        ("oscillator", None, {}, [0.0, 3.3], "closed form"),
        ("oscillator", None, {"gamma": 50.0}, [0.0, 3.3], "closed form"),
        ("oscillator", None, {"kappa": 0.5}, [0.0, 3.3], "live"),  # the closed form has no κ
        ("rigid_body", ("s",), {}, [0.0, 3.3], "closed form"),
        ("rigid_body", None, {}, [0.0, 3.3], "frozen"),
        ("rigid_body", ("s",), {"damping": (0.1, 0.1, 0.1)}, [0.0, 3.3], "live"),
        ("particle", None, {}, [0.1 * k for k in range(201)], "frozen"),
        ("particle", (), {"t_end": 5.0, "name": "mine"}, [1.5, 0.2, 1.5], "frozen"),
        ("particle", (), {}, [1.55], "live"),
        ("particle_long", ("s",), {}, [2000.0], "frozen"),
    ],
)
def test_source(name, carry, changes, times, source):
    scene = SCENES[name].with_(**changes)
    if "damping" in changes:
        carry = ()
    found = reference(scene, Elapsed(times), carry)
    assert found.source == source
    assert found.y.shape == (len(times), len(scene.labels(found.carry)))
    assert found.digits >= 28
    first = found.y[np.flatnonzero(found.t == 0)]
    start = scene.pack(scene.initial(found.carry))
    assert all(np.array_equal(row, start) for row in first)


def test_other_parameters_never_get_frozen_values():
    t = [4.0]
    for change in ({"q": (1.0, 0.4)}, {"coupling": 0.2}, {"mass": 1.5}, {"gamma": 0.3}):
        scene = SCENES["particle"].with_(**change)
        assert truth.frozen(scene, np.array(t), ("s",)) is None
    found = reference(scene, Elapsed(t))
    assert found.source == "live"
    slope = lambda t, y: scene.pack(scene.rhs(scene.unpack(y, ("s",))))  # noqa: E731
    run = solve_ivp(slope, (0, 4), scene.pack(scene.initial(("s",))), "DOP853", t, rtol=1e-12, atol=1e-13)
    # DOP853's global error at rtol 1e-12 is a few 1e-12 here
    np.testing.assert_allclose(found.y, run.y.T, rtol=0, atol=1e-10)


def test_without_heyoka_extrapolation_answers(monkeypatch):
    scene, t = SCENES["central"].with_(gamma=0.2), np.array([0.0, 0.05])
    with_heyoka, _, _ = truth.live(scene, t, ("s",))
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    without, digits, _ = truth.live(scene, t, ("s",))
    assert digits >= 25
    assert [[float(x) for x in row] for row in without] == [[float(x) for x in row] for row in with_heyoka]


def test_division_by_three_is_not_trusted_to_heyoka():
    """heyoka rounds ``x / 3`` to x · 0.333…33 in double precision; the answer must not show it."""
    pendulum = mine(lambda q: q[0] * q[0] / 6, gradient=lambda q: (q[0] / 3,))
    context = truth.decimal_context(40)
    exact = context.cos(2 / context.sqrt(3))
    found = reference(pendulum, [2.0], ())
    assert truth.agreeing_digits([[context.mpf(found.decimals[0][0])]], [[exact]], 40) >= 25


@pytest.mark.slow
def test_decay_out_of_sight_keeps_relative_digits():
    """Body momentum e^{−6·40} of its start: digits come from the closed form, relative to itself."""
    scene = SCENES["rigid_body"].with_(gamma=6.0)
    found = reference(scene, Elapsed([0.0, 40.0]))
    assert found.source == "live"
    assert found.digits >= 30
    assert found.decimals[-1][0].endswith("E-105")
    assert np.linalg.norm(found.states().R, axis=0) == pytest.approx(1, abs=1e-15)


def test_a_reference_is_confirmed_by_another_engine_than_its_own(monkeypatch):
    frozen, live = SCENES["oscillator"], SCENES["oscillator"].with_(kappa=0.5)
    found = [reference(scene, [0.1]) for scene in (frozen, live)]
    assert min(confirmed(each) for each in found) >= 19
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert confirmed(found[0]) >= 19
    assert confirmed(found[1]) is None


def turned(phase, rate):
    """Return a closed form of q'' = −q, so many radians ahead at the start, at so many times its speed."""

    def exact(scene, t, xp):
        angle = rate * t + phase
        return State((xp.cos(angle),), (-rate * xp.sin(angle),), None)

    return exact


@pytest.mark.parametrize(
    ("phase", "rate", "source"), [(0.0, 1, "closed form"), (0.5, 1, "live"), (0.0, 2, "live")]
)
def test_a_closed_form_of_another_motion_or_of_other_equations_is_not_the_truth(phase, rate, source):
    scene = mine(lambda q: q[0] * q[0] / 2, gradient=lambda q: (q[0],), exact=turned(phase, rate))
    found = reference(scene, [2.5], ())
    assert found.source == source
    assert found.y[0, 0] == pytest.approx(math.cos(2.5), rel=1e-15)


def test_digits_are_those_of_the_component_that_knows_fewest():
    """A pendulum let go next to its top loses what a spring beside it keeps."""
    top = mine(lambda q: cb.math.cos(q[0]), q=1e-3, t_end=20.0)
    V = lambda q: q[0] ** 2 / 2 + cb.math.cos(q[1])  # noqa: E731
    both = Mechanical(name="both", potential=V, q=(1e-3, 1e-3), p=(0.0, 0.0), t_end=20.0)
    lost, found = (reference(scene, [20.0], ()).digits for scene in (top, both))
    assert found < 36
    assert abs(found - lost) <= 2


@pytest.mark.parametrize("ulps", [4, 5])
@pytest.mark.parametrize("times", [[1.5], [1.5, 0.2], [0.2, 1.5]], ids=str)
def test_a_frozen_time_is_one_within_four_units_in_the_last_place(times, ulps):
    t = np.array(times)
    t[0] += ulps * np.spacing(t[0])
    stored = truth.frozen(SCENES["particle"], t, ())
    assert (stored is None) == (ulps > 4)


# -- errors ----------------------------------------------------------------------------------------
ESCAPING = SCENES["particle"].with_(q=(8.0, -6.0), p=(3.0, -1.0))
PLAIN = mine(lambda q: math.sin(q[0]), gradient=lambda q: (math.cos(q[0]),))


@pytest.mark.parametrize(
    ("ask", "says"),
    [
        (lambda: reference(ESCAPING, [20.0]), "blows up at t = 3.409"),
        (lambda: truth.extrapolation(ESCAPING, ["20.0"], (), 8), "blows up at t = 3.409"),
        (lambda: reference(PLAIN, [1.0]), "fail in high precision"),
    ],
)
def test_a_motion_without_a_truth_is_refused_in_one_line(ask, says):
    assert says in refusal(ask)


@pytest.mark.parametrize("gamma", [0.0, 0.125])
@pytest.mark.parametrize("size", [1e-8, 1e8])
def test_digits_are_relative_to_the_state(size, gamma):
    """Both live engines against the closed form of a state far below and far above one."""
    scene = SCENES["oscillator"].with_(q=(size,), p=(0.0,), gamma=gamma)
    t = np.array([0.75])
    exact, _, _ = closed_form(scene, t, ())
    by_taylor, digits, _ = truth.live(scene, t, ())
    for rows, claimed in ((truth.extrapolation(scene, ["0.75"], (), 18), 16), (by_taylor, digits)):
        assert shared_digits(rows, exact) >= claimed >= 16


def test_a_short_span_of_a_fast_motion_is_no_blow_up():
    fast = SCENES["oscillator"].with_(omega=1e8, q=(1.0,), p=(0.0,), gamma=0.0)
    ((q, _),) = truth.taylor(fast, ["2e-6"], (), 140)
    assert float(q) == pytest.approx(np.cos(200.0), abs=1e-12)


def test_the_generator_imports_no_method_under_test():
    """Of the package itself import-linter knows."""
    nodes = ast.walk(ast.parse((FOLDER / "generate.py").read_text(encoding="utf-8")))
    imported = [getattr(n, "module", "") or "" for n in nodes if isinstance(n, ast.ImportFrom)]
    assert imported
    assert not [name for name in imported if name.startswith(("contactbench.methods", "contactbench.peers"))]


def test_a_power_at_zero_is_a_product_to_heyoka():
    """heyoka's own series of x**3 divides by x: a double well begun on its top would have no run and no reference.

    Derived forces of the two round differently in the digits that are not promised.
    """
    own = {"q": 0.0, "p": 0.5, "gamma": 0.2, "t_end": 2.0}
    power = mine(lambda q: q[0] ** 4 / 4 - q[0] ** 2 / 2, **own)
    product = mine(lambda q: q[0] * q[0] * q[0] * q[0] / 4 - q[0] * q[0] / 2, **own)
    found, exact = (cb.reference(scene, [2.0]) for scene in (power, product))
    assert shared_digits(found.decimals, exact.decimals) >= min(found.digits, exact.digits) >= 39
    run = cb.solve(power, "heyoka-taylor", rtol=1e-14, save_at=[2.0])
    assert run.ok
    assert np.abs(run.y[-1] - exact.y[-1]).max() < 1e-14
    assert run.sensitivity.shape == (1, 3, 3)


def test_a_trial_step_onto_a_singularity_is_halved():
    """q' = p from q = 4 with p = −8: the first midpoint, half of t = 8 on, is the pole of V = 1/q."""
    scene = mine(lambda q: 1 / q[0], q=4.0, p=-8.0, t_end=8.0).recorded()
    (row,) = truth.extrapolation(scene, ["8.0"], (), 20)
    assert row[1] ** 2 / 2 + 1 / row[0] == pytest.approx(32.25, rel=1e-18)


# -- time ------------------------------------------------------------------------------------------
def test_functions_end_where_an_argument_is_beyond_any_scale():
    """The digits of e^x for x = 2^(10^12) have no room in any memory: mpmath would end the process."""
    context = truth.decimal_context(30)
    for name in ("exp", "expm1", "sinh", "cosh", "tanh", "sin", "cos", "tan"):
        with pytest.raises(OverflowError):
            getattr(cb.math, name)(-(context.mpf(2) ** 10**12))
    assert cb.math.exp(context.mpf(-(10**40))) > 0


def test_extrapolation_looks_at_the_clock_before_every_slope(monkeypatch):
    """The first step, all of the span, would have 930 slopes of a second each."""
    now = [0.0]
    monkeypatch.setattr(engines, "perf_counter", lambda: now[0])

    def slope(t, y):
        now[0] += 1.0
        return -y

    watch = engines.Stopwatch(PLAIN, 1.0, 5.0)
    with pytest.raises(engines.OutOfTime):
        engines.extrapolate(slope, np.array([1.0]), [1.0], 30, 0.0, watch)
    assert now[0] <= 7.0
    watch = engines.Stopwatch(PLAIN, 10.0, now[0])
    now[0] += 6.0
    with pytest.raises(engines.OutOfTime) as late:
        watch.check(2.0)
    assert late.value.needed == 30.0  # as the first fifth took


def test_bonds_whose_trial_steps_diverge_neither_hang_nor_abort(monkeypatch):
    """Three Morse bonds; the midpoint rule with a step of 6 takes e^r to numbers of any length."""
    bonds = lambda q: sum((1 - cb.math.exp(a + 1 - b)) ** 2 for a, b in pairwise(q))  # noqa: E731
    noise, p = np.random.default_rng(0).standard_normal((2, 4))
    q = np.arange(4) + noise
    hot = Mechanical(name="hot", potential=bonds, q=tuple(q), p=tuple(p), gamma=0.1, t_end=30.0).recorded()
    monkeypatch.setattr(engines, "perf_counter", clock := Ticks(1.0))
    with suppress(engines.OutOfTime):
        truth.extrapolation(hot, ["6.0", "30.0"], (), 20, deadline=100.0)
    assert clock.now < 110


def test_no_step_is_begun_that_nothing_could_interrupt(monkeypatch):
    """A right-hand side of a tenth of a second means steps of ten: on a clock that its calls move."""
    monkeypatch.setattr(references, "taylor", lambda *_, **__: pytest.fail("begun"))
    monkeypatch.setattr(references, "perf_counter", clock := Ticks(0.0))

    def slow(q):
        clock.now += 0.1 * (not isinstance(q[0], float))
        return (q[0],)

    scene = mine(lambda q: q[0] ** 2 / 2, gradient=slow)
    with pytest.raises(engines.OutOfTime):
        truth.live(scene, np.array([1.0]), (), deadline=clock.now + 15.0)
