"""Orders of convergence, compositions let in by their order, and the ladders of settings."""

import itertools
import math

import numpy as np
import pytest

import contactbench as cb
import contactbench.measure.order as of_steps
from cases import bodies, scene_of
from contactbench.measure.laws import LAWS
from contactbench.measure.order import DIGITS, ROUND_OFF, fit_order
from contactbench.runs.search import Attempt, Question, Search
from contactbench.runs.settings import ENDS, carry_of, times, tolerances
from contactbench.scene.base import Elapsed
from contactbench.splitting.tables import COMPOSITIONS
from contactbench.truth import decimal_context

H = [0.8 / 2**k for k in range(9)]


@pytest.mark.parametrize("order", [1, 2, 4, 6, 8])
def test_order_of_a_clean_power_law(order):
    fit = fit_order(H, [3 * h**order for h in H])
    assert fit.order == pytest.approx(order, abs=1e-12)
    assert fit.uncertainty < 1e-11
    assert fit.last_slope == pytest.approx(order, abs=1e-12)
    assert math.isnan(fit.pairwise[0])  # nothing coarser to compare with
    np.testing.assert_allclose(fit.pairwise[1:], order)


def test_pre_asymptotic_points_and_the_round_off_plateau_are_left_out():
    errors = [h**4 * (1 + 30 * h**2) + 1e-10 for h in H]
    fit = fit_order(H, errors, floor=1e-9)
    assert abs(fit.order - 4) < fit.uncertainty < 0.2
    assert not fit.used[0]
    assert not fit.used[-1]
    assert fit.used.sum() == 4


@pytest.mark.parametrize("below", range(1, 7))
def test_no_order_rests_on_a_point_below_the_floor(below):
    """Of nine points; three above it are too few."""
    errors = np.array([h**4 * (1 + 0.3 * h**2) for h in H])
    floor = errors[-below]
    fit = fit_order(H, errors, floor)
    assert fit.used.sum() == (4 if below <= 5 else 0)
    assert not fit.used[errors <= floor].any()


def test_noise_has_no_order():
    rng = np.random.default_rng(0)
    found = [fit_order(H, rng.uniform(0.1, 1, len(H))).order for _ in range(50)]
    assert np.isnan(found).mean() > 0.9
    assert math.isnan(fit_order(H[:3], [h**2 for h in H[:3]]).order)  # three points are too few
    assert math.isnan(fit_order(H, [math.nan] * len(H)).order)


@pytest.mark.parametrize("power", [1, 2])
def test_the_uncertainty_covers_the_truth(power):
    """Random error constants of three powers, of either sign, and round-off: at most 3 % are missed,
    where a term happens to be cancelled by the next."""
    rng = np.random.default_rng(1)
    missed, total = 0, 0
    for _ in range(600):
        p, n = rng.integers(1, 9), rng.integers(5, 10)
        a = rng.normal(size=3) * rng.choice([0.3, 1.0, 3.0])
        h = np.array(H[:n])
        errors = h**p * np.abs(1 + sum(c * h ** (power * (i + 1)) for i, c in enumerate(a)))
        fit = fit_order(h, errors + 1e-14 * rng.random(n), 1e-12)
        if not math.isnan(fit.order):
            total += 1
            missed += abs(fit.order - p) > fit.uncertainty
    assert total > 480
    assert missed <= 0.03 * total


@pytest.mark.parametrize("ratio", [2.0, 1.5])
def test_the_uncertainty_has_the_worst_that_round_off_of_the_errors_does(ratio):
    """Of each error by a part of itself, floor/error, in the worst signs; to first order."""
    h = 0.1 * ratio ** np.arange(4)
    errors = h**4 * (1 + h**2)
    floor = errors[0] * 1e-6

    clean, blurred = fit_order(h, errors), fit_order(h, errors, floor)
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=4)))
    worst = max(abs(fit_order(h, errors + ROUND_OFF * floor * s).order - clean.order) for s in signs)
    assert blurred.uncertainty - clean.uncertainty == pytest.approx(worst, rel=1e-3)


# -- A composition from one's own coefficients -----------------------------------------------------
pytestmark = pytest.mark.usefixtures("registries")
#: those whose stages are kicks and drifts in turn, without a processor
PLAIN = [c for c in COMPOSITIONS if c.two_part and not c.processor]


def lists(known):
    """Its coefficients as a user has them: floats."""
    return {
        "kick": [float(c) for name, c in known.stages if name == "kick"],
        "drift": [float(c) for name, c in known.stages if name == "drift_damp"],
    }


@pytest.mark.parametrize("known", PLAIN, ids=lambda c: c.name)
def test_printed_coefficients_give_the_same_method(known):
    mine = cb.composition("mine", known.order, **lists(known), nystrom=known.nystrom)
    assert cb.METHODS["mine"] is mine
    assert (mine.family, mine.contact, mine.symmetric) == ("contact", True, True)
    ours, theirs = (cb.solve("central", name, step=0.5, save_at=[10.0]) for name in ("mine", known.name))
    np.testing.assert_allclose(ours.y, theirs.y, rtol=1e-12, atol=1e-12)
    assert LAWS["contact_drift"](ours) < 1e-12
    assert sum(c for name, c in mine.composition.stages if name == "kick") == 1  # whatever was rounded


@pytest.mark.parametrize("known", [c for c in PLAIN if c.order > 2], ids=lambda c: c.name)
def test_a_wrong_coefficient_is_not_let_in(known):
    wrong = lists(known)
    wrong["kick"][1] += 1e-3
    wrong["kick"][-2] -= 1e-3
    with pytest.raises(cb.BadInput, match=rf"order = {known.order}: measured [0-9.]+ on particle"):
        cb.composition("mine", known.order, **wrong, nystrom=known.nystrom)
    assert "mine" not in cb.METHODS


def test_an_order_is_neither_too_high_nor_too_low():
    for order in (1, 3, 4):
        with pytest.raises(cb.BadInput, match=rf"order = {order}: measured (1\.9|2\.0)"):
            cb.composition("mine", order, kick=[0.5, 0.5], drift=[1])


def test_a_nystrom_composition_must_say_so():
    known = next(c for c in PLAIN if c.nystrom)
    with pytest.raises(cb.BadInput, match="on rigid_body; nystrom=True"):
        cb.composition("mine", known.order, **lists(known))


@pytest.mark.parametrize(
    ("kick", "drift", "first"),
    [(["1/2", "1/2"], [1], "kick"), ([1], [0.5, 0.5], "drift_damp"), ([1], [1], "kick")],
)
def test_the_longer_list_begins(kick, drift, first):
    order = 1 if len(kick) == len(drift) else 2
    mine = cb.composition("mine", order, kick, drift)
    assert mine.composition.stages[0][0] == first
    assert mine.symmetric == (order == 2)
    for scene in ("particle", "rigid_body", "rigid_body_anisotropic"):
        assert cb.solve(scene, "mine", step=0.1, save_at=[1.0]).ok


# -- Ladders of tolerances -------------------------------------------------------------------------
PEERS = [m for m in cb.METHODS.values() if m.adaptive and m.family == "established"]


@pytest.mark.parametrize("method", PEERS, ids=lambda m: m.name)
def test_the_last_rung_is_the_end_of_the_range(method):
    values = tolerances(method)
    assert values[-1] == method.rtol_range[0] <= 1e-13
    assert values == sorted(set(values), reverse=True)
    assert {1e-3, 1e-6, 1e-13} <= {float(f"{v:.3g}") for v in values}


@pytest.fixture
def errors(monkeypatch):
    """Let attempts have errors that are a function of their setting."""

    def scripted(error):
        def attempt(search, value):
            search.attempts.append(Attempt(value, "", cb.Status.ok, "", 0.0, error(value)))
            return search.attempts[-1]

        monkeypatch.setattr(Search, "attempt", attempt)

    return scripted


def test_a_ladder_ends_where_the_error_stops_falling(errors):
    """At 10⁻¹² and 10⁻¹³ the error is 3·10⁻¹³: one rung that brings nothing is tried, and no more."""
    errors(lambda value: max(value, 3e-13))
    scene = cb.SCENES["oscillator"]
    question = Question(
        scene, cb.reference(scene, Elapsed(times(scene, ENDS)), carry_of(scene)), (1e-300,), 60.0
    )
    tried = list(Search(question, "heyoka-taylor").coarse_to_fine())
    assert tried[-1].value == pytest.approx(1e-14)
    assert all(math.isfinite(attempt.error) for attempt in tried)


@pytest.mark.parametrize(("unit", "longest"), [(1e9, 1000.0), (150.0, 100.0), (3.0, 3.125)])
def test_a_ladder_of_steps_begins_where_the_error_is_as_large_as_the_motion(errors, unit, longest):
    """At most one step from each of the five ends to the next; unit : the step of error 1, of a second-order method."""
    errors(lambda value: (value / unit) ** 2)
    search = Search(Question(bodies(6, 3, t_end=5000.0), None, (1e-3, 1e-6), 60.0), "contact-rkn6")
    list(search.turns())
    assert max(a.value for a in search.attempts) == longest
    assert search.best(1e-6) is not None


# -- two libraries of numbers of many digits -------------------------------------------------------
MANY = [
    *(("particle", name) for name in ("contact-rkn8", "rkn12", "rk8", "contact-gauss8")),
    *(("forced_pulsating", name) for name in ("contact-o8", "contact-gauss8")),
    *(
        ("thermostat", "rk8"),
        ("double_pendulum", "rk8"),
        ("heavy_top", "contact-bm6"),
        ("kepler", "contact-log8"),
    ),
]


@pytest.mark.parametrize(("scene", "method"), MANY)
def test_numbers_of_gmpy2_step_as_those_of_mpmath(scene, method, monkeypatch):
    pytest.importorskip("gmpy2")
    context = decimal_context(DIGITS)
    given = cb.METHODS[method], scene_of(scene), context.mpf("0.1"), 3, context
    fast = of_steps.march(*given)
    monkeypatch.setattr(of_steps, "fastest", lambda context: context)
    slow = of_steps.march(*given)
    assert max(abs(a - b) / (1 + abs(b)) for a, b in zip(fast, slow, strict=True)) < 10 ** (3 - DIGITS)
    assert any(a != b for a, b in zip(fast, given[1].pack(given[1].initial(given[1].carry())), strict=True))


def test_a_number_of_gmpy2_beyond_any_scale_ends_the_run():
    pytest.importorskip("gmpy2")
    with pytest.raises(OverflowError, match="beyond any scale"):
        of_steps.march(cb.METHODS["rk8"], cb.SCENES["double_pendulum"], "1e9", 10, decimal_context(DIGITS))
