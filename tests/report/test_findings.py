"""What the report says is computed over all rows: a row that contradicts a sentence changes it."""

from __future__ import annotations

import math
import re

import numpy as np
import pandas as pd
import pytest

from contactbench.measure.statistics import Verdict
from contactbench.report import (
    convergence,
    damping,
    ensemble,
    equal_cost,
    headline,
    kept,
    law_findings,
    laws,
    limits,
    stability,
    work_precision,
)
from contactbench.report.cells import DASH, Mark
from contactbench.report.contest import (
    CALLED_BACK,
    COMPILED,
    ENOUGH,
    EVALUATIONS,
    FIXED,
    KINDS,
    MARGINAL,
    TARGETS,
    Field,
    camps,
    reasons,
    standing,
    tally,
)
from contactbench.report.contest_views import costs_view, duel_view, losses_view, winners_view
from contactbench.report.figures import hard as figures_hard
from frames import frames, row, table

ROUND = 3e-15


def said(finding):
    return " ".join([finding.sentence, *finding.exceptions, finding.covers])


# -- laws ------------------------------------------------------------------------------------------
def kept_row(scene="central", method="contact-a", value=0.1, **more):
    return row(scene, method, value, solution_error=1e-3, momentum_law=ROUND, contact_drift=ROUND, **more)


def broken(scene="central", method="rk4", value=0.1, drift=1e-3, **more):
    return row(scene, method, value, solution_error=1e-3, momentum_law=drift, contact_drift=drift, **more)


LAWS = [
    kept_row(),
    kept_row(value=0.2),
    kept_row(method="contact-b"),
    broken(),
    broken("rigid_body", "heyoka-taylor", 1e-9, 7e-13 * 10),
]


def law(name, **tables):
    return next(f for f in law_findings.findings(frames(**tables)) if f.name == f"law_{name}")


def test_every_contact_method_keeps_a_law_when_every_row_says_so():
    finding = law("momentum_law", laws=LAWS)
    assert (
        "Every contact method keeps it to round-off in every judged run that promises it" in finding.sentence
    )
    assert "Of the other 2 methods none keeps it at every setting" in finding.sentence
    assert finding.exceptions == ()


@pytest.mark.parametrize("where", ["laws", "stability"])
def test_one_contradicting_row_changes_the_sentence_and_is_named(where):
    planted = {"laws": list(LAWS), "stability": []}
    planted[where].append(broken("needle", "contact-b", 0.4, 2e-4))
    finding = law("momentum_law", **planted)
    assert "Every contact method" not in said(finding)
    assert "in 3 of 4 runs" in finding.sentence
    assert any("`needle`" in e and "2.0e-04" in e and "contact-b" in e for e in finding.exceptions)


def test_another_method_that_keeps_a_law_is_named():
    finding = law(
        "contact_drift", laws=[*LAWS, kept_row(method="herglotz1"), kept_row("rigid_body", "herglotz1")]
    )
    assert "Of the other methods herglotz1 (variational) keeps it in 2 of 2 runs." in finding.sentence
    assert "Of the remaining 2 methods none keeps it at every setting" in finding.sentence


def test_round_off_on_a_single_scene_is_not_said_to_be_the_methods():
    """Weak damping may hide there what a method gets wrong."""
    weak = [kept_row("kepler_drag", "herglotz2", h) for h in (0.1, 0.2, 0.3)]
    elsewhere = broken("central", "herglotz2")
    finding = law("momentum_law", laws=[*LAWS, *weak, elsewhere])
    assert "herglotz2" not in finding.sentence
    assert "Of the other 3 methods none keeps it at every setting; 3 of their 6 runs" in finding.sentence
    finding = law("momentum_law", laws=[*LAWS, *weak, elsewhere, kept_row("needle", "herglotz2")])
    assert "herglotz2 (variational) keeps it in 4 of 5 runs" in finding.sentence
    finding = law("momentum_law", laws=[*LAWS, *weak])
    assert (
        "none keeps it at every setting (but for herglotz2, on `kepler_drag` alone); 3 of" in finding.sentence
    )


def test_runs_of_the_others_that_tell_nothing_are_counted():
    unsure = broken("oscillator", "cvode-adams", 1e-9, 3e-12) | {"contact_drift_uncertainty": 2e-12}
    finding = law("contact_drift", laws=[*LAWS, unsure])
    assert (
        "1 run of the others is undecided or known by an upper bound only, among them all of cvode-adams."
        in finding.sentence
    )
    ill = kept_row("kepler_drag", "rk4", 0.3) | {
        "contact_drift": 0.9, "map_growth": 7e51, "evaluations": 1000,
    }  # fmt: skip
    finding = law("contact_drift", laws=[*LAWS, unsure], stability=[ill])
    assert "2 runs of the others are undecided" in finding.sentence
    assert "of the others" not in law("contact_drift", laws=LAWS).sentence


def test_an_energy_that_is_exact_on_one_scene_only_is_said_with_the_scene():
    off = {"hamiltonian_law": 0.03}
    rows = [
        kept_row("rigid_body", "contact-a") | off | {"energy_law": ROUND},
        kept_row("particle", "contact-a") | off | {"energy_law": 0.02},
        kept_row("rigid_body", "contact-b") | off | {"energy_law": 0.01},
    ]
    (finding,) = (f for f in law_findings.findings(frames(laws=rows)) if f.name == "energies")
    assert "on `rigid_body` contact-a keeps it at every setting (part A is" in finding.sentence
    assert "while the H law is up to 3.0e-02 off" in finding.sentence
    rows[0] |= {"hamiltonian_law": 2e-12}  # just accurate
    (finding,) = (f for f in law_findings.findings(frames(laws=rows)) if f.name == "energies")
    assert "part A" not in finding.sentence


def test_the_modified_hamiltonian_is_compared_with_h_in_the_same_runs():
    def found(*rows):
        made = law_findings.findings(frames(laws=list(rows)))
        return next((f for f in made if f.name == "modified_hamiltonian"), None)

    def row(method, plain, fixed):
        return kept_row("central", method) | {"hamiltonian_law": plain, "modified_hamiltonian": fixed}

    rows = [row("contact-a", 2e-3, 1e-5), row("contact-a", 4e-3, 1e-6), row("contact-a", 1e-3, 1e-5)]
    finding = found(*rows)
    assert (
        "contact-a's decays as e^{−γt} 200 times as exactly as H in the median of 3 runs" in finding.sentence
    )
    assert "(100 to 4000 times)" in finding.sentence
    assert not finding.exceptions
    assert found(*rows, row("contact-b", 1e-6, 2e-6)).exceptions
    same = found(*rows, row("contact-b", 1e-6, 1e-6)).sentence  # no correction up to h⁴
    assert same == f"{finding.sentence} That of contact-b is H itself up to there."
    hard = [row("contact-a", 1e-3, 2e-3) | {"scene": "overdamped"}]
    (both,) = (
        f
        for f in law_findings.findings(frames(laws=rows, stability=hard))
        if f.name == "modified_hamiltonian"
    )
    assert len(both.exceptions) == 1
    assert found(row("contact-a", 1e-13, 1e-14)) is None  # round-off


@pytest.mark.parametrize("law", ["contact_drift", "pairing_drift"])
def test_a_run_that_saves_nothing_but_what_has_faded_decides_nothing(law):
    def sentence(clamped):
        rows = [
            kept_row("central", m) | {law: 1e-15, "saved_times": 25, "derivative": "AD"}
            for m in ("contact-a", "contact-b")
        ]
        rows[1] |= {f"{law}_clamped": clamped}
        (found,) = (f for f in law_findings.findings(frames(laws=rows)) if f.name == f"law_{law}")
        return found

    assert "1 more" not in sentence(24.0).sentence
    assert "in all 1 run that can tell; 1 more are undecided" in sentence(25.0).sentence
    assert any("less than a thousandth of the terms is left" in e for e in sentence(25.0).exceptions)


def test_the_least_drift_of_the_others_is_over_all_scenes_and_settings_and_says_where():
    finding = law("contact_drift", laws=LAWS)
    assert "7.0e-12 (heyoka-taylor on `rigid_body`, step=1e-09)" in finding.sentence
    hard = [broken("oscillator", "heyoka-taylor", 1e-12, 2e-12, control="rtol")]
    finding = law("contact_drift", laws=LAWS, stability=hard)
    assert "2.0e-12 (heyoka-taylor on `oscillator`, rtol=1e-12)" in finding.sentence


def test_only_the_true_map_counts_and_the_frozen_one_is_the_cause():
    moving = kept_row(method="contact-c", control="rtol", value=1e-4) | {
        "contact_drift": 1.35e-5,
        "contact_drift_frozen": ROUND,
    }
    finding = law("contact_drift", laws=[*LAWS, moving])
    assert "Every contact method" not in finding.sentence
    (cause,) = finding.exceptions
    assert "contact-c" in cause
    assert "1.4e-05" in cause or "1.3e-05" in cause
    assert "with the steps held fixed it stays within round-off (at most 3.0e-15)" in cause
    worse = law("contact_drift", laws=[*LAWS, moving | {"contact_drift_frozen": 1e-6}])
    assert "held fixed" not in said(worse)


def test_where_no_contact_method_keeps_a_law_it_says_what_they_keep_there():
    quadratic = [
        kept_row("quadratic_damping", m)
        | {"momentum_law": 0.28, "contact_drift": 0.28, "distribution_drift": ROUND}
        for m in ("contact-a", "contact-b")
    ]
    finding = law("contact_drift", laws=[*LAWS, *quadratic])
    (cause,) = finding.exceptions
    assert "on `quadratic_damping` no contact method keeps it at every setting: 2 runs" in cause
    assert "the largest deviation 2.8e-01" in cause
    assert cause.endswith("kept there: ker η drift")
    lost = [r | {"distribution_drift": 1e-3} for r in quadratic]
    assert "kept there" not in said(law("contact_drift", laws=[*LAWS, *lost]))


def test_round_off_is_bounded_by_the_condition_number_or_it_is_an_exception():
    magnified = kept_row("kepler_drag") | {
        "contact_drift": 1e-9,
        "condition_number": 1e6,
        "evaluations": 1000,
    }
    finding = law("contact_drift", laws=LAWS, stability=[magnified])
    assert "up to: `kepler_drag` 1.0e-09 (growth 1.0e+06)" in said(finding)
    assert "Every contact method keeps it" in finding.sentence
    beyond = law("contact_drift", laws=LAWS, stability=[magnified | {"contact_drift": 1e-3}])
    assert "Every contact method keeps it" not in beyond.sentence
    assert any("whose map grows by 1.0e+06" in e for e in beyond.exceptions)
    map_of_its_own = magnified | {"map_growth": 10.0}  # the numerical map decides where it was measured
    assert (
        "Every contact method keeps it"
        not in law("contact_drift", laws=LAWS, stability=[map_of_its_own]).sentence
    )
    state = law("momentum_law", laws=LAWS, stability=[magnified | {"momentum_law": 1e-9}])
    assert "Every contact method keeps it" not in state.sentence  # J is not magnified by the motion


@pytest.mark.parametrize("method", ["contact-a", "contact-b", "herglotz1", "rk4"])
def test_where_round_off_may_be_anything_a_law_is_neither_kept_nor_broken(method):
    """The bound is ε · 1000 · 7e51 there: any deviation is below it, that of RK4 as well."""
    planted = kept_row("kepler_drag", method, 0.3) | {
        "contact_drift": 0.9, "distribution_drift": 0.9, "map_growth": 7e51, "evaluations": 1000,
    }  # fmt: skip
    alone = kept.measured(frames(stability=[planted]), "distribution_drift")
    assert alone[["kept", "undecided", "broken"]].iloc[0].tolist() == [False, True, False]
    assert kept.keepers(alone) == []
    finding = law("contact_drift", laws=LAWS, stability=[planted])
    assert "kepler_drag" not in finding.sentence
    if method.startswith("contact"):
        assert "keeps it to round-off in all 3 runs that can tell; 1 more are undecided." in finding.sentence
        (said_,) = finding.exceptions
        assert said_.startswith("undecided, because the problem is too ill-conditioned at these steps")
        assert "`kepler_drag` (1 run, growth up to 7.0e+51, deviation up to 9.0e-01)" in said_
    view = stability.scene_view(table("stability", [planted]), "kepler_drag")
    drift = next(c for h, c in zip(view.columns, view.rows[0], strict=True) if h.label == "contact drift")
    assert drift.text == "9.0e-01‡"
    assert Mark.kept not in drift.marks


def test_a_deviation_above_even_a_huge_bound_is_broken_and_round_off_is_kept_under_any():
    values, bounds = np.array([0.9, 1e-13, 1e-7, 1e-7]), np.array([1e-4, 1e40, 1e-5, 1e-6])
    shows, nothing = kept.decided(values, bounds)
    assert shows.tolist() == [False, True, False, True]
    assert nothing.tolist() == [False, False, True, False]


def test_a_variational_integrator_that_nearly_keeps_a_law_is_named_with_its_exceptions():
    rows = [kept_row(s, "herglotz1") for s in ("central", "particle", "critical")]
    near = kept_row("critical", "herglotz1", 0.3) | {"contact_drift": 2.16e-12}
    finding = law("contact_drift", laws=[*LAWS, *rows], stability=[near])
    assert (
        "herglotz1 (variational) keeps it in 3 of 4 runs (elsewhere, on `critical`, "
        "no more than 2.2 times the bound of round-off)" in finding.sentence
    )
    far = near | {"scene": "overdamped", "contact_drift": 1e274}
    finding = law("contact_drift", laws=[*LAWS, *rows], stability=[far])
    assert "in 3 of 4 runs (elsewhere, on `overdamped`, up to 1.0e+274)" in finding.sentence


def test_a_peer_that_reaches_round_off_is_counted_and_no_smallest_deviation_below_it_is_told():
    tiny = broken("underflow", "heyoka-taylor", 2e-16, 2e-17, control="rtol")
    finding = law("contact_drift", laws=LAWS, stability=[tiny, tiny | {"value": 1e-4, "contact_drift": 1e-4}])
    assert "1 of their 4 runs reach round-off" in finding.sentence
    assert "2.0e-17" not in said(finding)


def test_what_differences_resolve_stands_beside_the_numbers():
    by_differences = {"derivative": "central differences of the solver, 60 runs"}
    rows = [
        broken("oscillator", "cvode-adams", e, d) | {"contact_drift_uncertainty": u, **by_differences}
        for e, d, u in ((1e-6, 1e-5, 1e-10), (1e-7, 1e-6, 3e-9), (1e-8, 4e-12, 1e-8))
    ]
    finding = law("contact_drift", laws=[*LAWS, *rows])
    assert (
        "3 runs by differences of the solver, which resolve nothing below their error bar" in finding.covers
    )
    assert "1e-10 at best, 3e-09 in the median; 1 of them known as an upper bound only" in finding.covers
    assert "by differences" not in law("contact_drift", laws=LAWS).covers
    assert "by differences" not in law("momentum_law", laws=[*LAWS, *rows]).covers  # J needs no derivative


def test_what_is_kept_instead_is_not_said_of_a_map_that_does_not_keep_it():
    rows = [
        kept_row("quadratic_damping", m)
        | {"contact_drift": 0.28, "distribution_drift": d, "distribution_drift_frozen": f}
        for m, d, f in (("contact-a", ROUND, None), ("contact-c", 1e-3, ROUND))
    ]
    cause = law("contact_drift", laws=rows).exceptions[0]
    assert "kept there: J law and ker η drift (contact-c with the steps held fixed)" in cause
    rows[1] |= {"distribution_drift": None, "distribution_drift_frozen": None}
    assert "ker η drift (not measured for contact-c)" in law("contact_drift", laws=rows).exceptions[0]


def test_an_upper_bound_is_no_least_drift():
    unsure = broken("oscillator", "cvode-adams", 1e-9, 3e-12) | {"contact_drift_uncertainty": 2e-12}
    finding = law("contact_drift", laws=[*LAWS, unsure])
    assert "7.0e-12 (heyoka-taylor" in finding.sentence
    assert "1 of them known as an upper bound only" in finding.covers


def test_what_was_not_measured_is_said():
    blind = kept_row(method="contact-c") | {"contact_drift": None}
    finding = law("contact_drift", laws=[*LAWS, blind])
    assert "not measured: contact-c" in finding.covers
    assert finding.sentence.startswith("Every contact method it was measured for keeps it")


def test_h_is_kept_by_nobody_and_how_far_the_contact_methods_are_off_is_said():
    rows = [
        kept_row("particle") | {"hamiltonian_law": 0.15, "energy_law": 0.02},
        broken("particle") | {"hamiltonian_law": 1e-3},
    ]
    (finding,) = (f for f in law_findings.findings(frames(laws=rows)) if f.name == "energies")
    assert (
        "H law: no method keeps it to round-off at every setting; "
        "the contact methods are up to 1.5e-01 off (contact-a on `particle`" in finding.sentence
    )
    rows[0]["hamiltonian_law"] = ROUND
    (finding,) = (f for f in law_findings.findings(frames(laws=rows)) if f.name == "energies")
    assert "H law: contact-a keeps it to round-off (on `particle`)." in finding.sentence
    assert "off" not in finding.sentence.partition("H law: contact-a keeps it to round-off")[2]  # of whom?
    hard = kept_row("tumbling") | {"hamiltonian_law": ROUND, "energy_law": ROUND}
    (finding,) = (
        f for f in law_findings.findings(frames(laws=rows, stability=[hard])) if f.name == "energies"
    )
    assert "H law: contact-a keeps it to round-off (on `particle` and `tumbling`)." in finding.sentence
    assert "on the standard scenes" in finding.covers
    hard["hamiltonian_law"] = 7.0
    (finding,) = (
        f for f in law_findings.findings(frames(laws=rows, stability=[hard])) if f.name == "energies"
    )
    assert "H law: no method keeps it" in finding.sentence  # the hard scenes count
    assert (
        "7.0e+00" not in finding.sentence.partition("H law: no method")[2]
    )  # but not how far one is off there
    hard |= {"energy_law": ROUND}
    assert "on `tumbling` contact-a keeps it at every setting (part A is" in finding.sentence
    other = kept_row("particle", "contact-b") | {"hamiltonian_law": 0.3, "energy_law": 0.02}
    (finding,) = (f for f in law_findings.findings(frames(laws=[*rows, other])) if f.name == "energies")
    assert "the other contact methods are up to 3.0e-01 off (contact-b on `particle`" in finding.sentence


def test_clamped_and_uncertain_entries_are_marked():
    clamped = kept_row() | {"contact_drift": 0.5, "contact_drift_clamped": 3}
    view = laws.law_view(frames(laws=[clamped]), "contact_drift", kept.structural()["contact_drift"])
    (cell,) = view.rows[0][1:]
    assert cell.text == "5.0e-01†"
    assert cell.marks == {Mark.clamped}
    rows = [clamped, broken(drift=1e-8) | {"contact_drift_uncertainty": 2e-9}]
    equal = frames(decay_laws=[r | {"cost": 30.0} for r in rows])
    shown = equal_cost.equal_cost_view(equal["decay_laws"], equal)
    assert [r[-1].text for r in shown.rows] == ["5.0e-01†", "1.0e-08 ± 2e-09"]
    assert Mark.kept in shown.rows[0][-2].marks  # its J law


def test_the_table_that_stands_first_has_order_and_laws_of_every_method():
    rows = [
        r | {"cost": 30.0, "rhs_equivalents": 800.0, "energy_law": 1e-4, "hamiltonian_law": 2e-4}
        for s in ("central", "rigid_body") for r in (kept_row(s), broken(s))
    ]  # fmt: skip
    orders = [
        row("central", "contact-a", h, solution_error=h**2, order=2.0, last_slope=1.98, order_nominal=2)
        for h in (0.1, 0.2)
    ]
    tables = frames(decay_laws=rows, convergence=orders, laws=LAWS)
    for parts in (headline.sections(tables), headline.excerpt(tables)):
        first = next(p for p in parts if hasattr(p, "columns"))
        assert first.name == "overview"
        heads = [(h.group, h.label) for h in first.columns]
        assert next(label for group, label in heads if group == "central") == "order"
        assert len([1 for group, _ in heads if group == "rigid_body"]) == 5
        assert [r[0].text for r in first.rows] == ["contact-a", "rk4"]
        assert [r[1].text for r in first.rows] == ["2.00", DASH]  # no ladder of the other one
    assert "`central` 800" in next(p for p in headline.sections(tables) if hasattr(p, "columns")).meaning


def test_the_cost_that_most_methods_meet_is_shown_first():
    rows = [
        kept_row() | {"cost": 30.0},
        kept_row() | {"cost": 100.0},
        broken() | {"cost": 30.0},
        broken() | {"cost": 100.0},
    ]
    assert set(equal_cost.chosen_cost(table("decay_laws", rows))["cost"]) == {100.0}
    rows[3]["status"] = "failed"
    assert set(equal_cost.chosen_cost(table("decay_laws", rows))["cost"]) == {30.0}


# -- order -----------------------------------------------------------------------------------------
def ladder(method="contact-a", order=2.0, nominal=2, scene="particle", **more):
    return [
        row(scene, method, h, solution_error=h**order, step=h, in_fit=True, order=order, last_slope=order - 0.01,
            order_uncertainty=0.001, order_nominal=nominal, **more)
        for h in (0.1, 0.2, 0.4)
    ]  # fmt: skip


def test_orders_that_disagree_are_named_with_their_last_slope():
    (finding,) = convergence.findings(frames(convergence=ladder()))
    assert "in 1 of 1 pairs" in finding.sentence
    assert finding.exceptions == ()
    (finding,) = convergence.findings(frames(convergence=[*ladder(), *ladder("rk4", 3.5, 4)]))
    assert "in 1 of 2 pairs" in finding.sentence
    assert finding.exceptions == ("rk4 on `particle`: 3.50, claimed 4, last pairwise slope 3.49",)


def test_no_interval_is_claimed_and_both_slopes_are_shown():
    orders, slopes, *_ = convergence.sections(frames(convergence=ladder()))
    assert orders.rows[0][2].text == "2.00 ± 0.00"
    assert slopes.rows[0][2].text == "1.990"
    assert "95" not in orders.meaning + slopes.meaning


def test_counts_are_over_claimed_runs_and_a_second_number_for_the_rest():
    def run(scene, claimed, keeps, clamped=0, judged=True):
        found = {
            "claimed": claimed,
            "kept": keeps,
            "undecided": False,
            "bound": 1e-12 if judged else math.nan,
        }
        told = {f"contact_drift_{what}": value for what, value in found.items()}
        return row(scene, "contact-a", len(rows), contact_drift=1e-15 if keeps else 1e-3, solution_error=1e-3,
                   saved_times=25, contact_drift_clamped=clamped, **told)  # fmt: skip

    rows = []
    for given in [
        *[("linear", True, True, 0, True)] * 3, *[("linear", True, True, 2, True)] * 2,
        *[("nonlinear", False, False, 0, True)] * 3, ("nonlinear", False, True, 0, True),
        ("linear", True, False, 0, False),
    ]:  # fmt: skip
        rows.append(run(*given))
    found = law_findings.law_finding(frames(laws=rows), "contact_drift")
    assert "every judged run that promises it" in found.sentence
    assert "Where it is not promised they keep it in 1 of 4 runs." in found.sentence
    assert "2 of these runs rest on times" in found.sentence
    assert found.covers.startswith("9 runs")
    assert not found.exceptions
    rows.append(run("linear", True, False))
    found = law_findings.law_finding(frames(laws=rows), "contact_drift")
    assert "in 5 of 6 runs" in found.sentence
    assert found.exceptions


# -- cost at equal error ---------------------------------------------------------------------------
def costs(method, factor=1.0, scene="s", engine="jax", finest=1e-13, **more):
    """A ladder whose cost is `factor` at an error of 1e-1, and rises by a quarter each decade."""
    rows, error = [], 1e-1
    while error >= finest * 0.999:
        cost = factor * 1.25 ** (-1 - round(math.log10(error)))
        rows.append(
            row(scene, method, error, engine=engine, solution_error=error, time_median_s=cost * 1e-3,
                time_min_s=cost * 1e-3, rhs_equivalents=cost * 100, **more)
        )  # fmt: skip
        error /= 10
    return rows


def test_dop853_is_one_contestant_where_engines_do_not_matter():
    """In the cheaper of its two shapes, and two where times are compared."""
    shapes = [*costs("scipy-dop853", 2.0, engine="python"), *costs("cyrk-dop853", 3.0, engine="c++")]
    work = table("work_precision", [*costs("contact-a", 4.0), *shapes])
    field = Field(work, EVALUATIONS)
    assert field.methods == ["contact-a", "dop853"]
    assert camps(field.contests().values()) == {"dop853": 4}
    alone = Field(table("work_precision", shapes[: len(shapes) // 2]), EVALUATIONS)
    at = ("s", 1e-6)
    assert field.leads[at].costs["dop853"].value == alone.leads[at].costs["dop853"].value
    assert Field(work, COMPILED).methods == ["contact-a", "cyrk-dop853"]
    assert Field(work, CALLED_BACK).methods == ["scipy-dop853"]


@pytest.mark.parametrize(
    ("factor", "outcome"), [(1.1, "win"), (1.03, "tie"), (1 / 1.03, "tie"), (1 / 1.1, "loss")]
)
def test_win_tie_and_loss_of_the_contact_methods(factor, outcome):
    work = table("work_precision", [*costs("contact-a"), *costs("rk4", factor)])
    field = Field(work, COMPILED)
    assert {c.outcome for c in field.contests().values()} == {outcome}
    sentence, _ = standing(field)
    numbers = re.findall(r"cheapest in (\d+) of 4 .*?(\d+) are ties .* cheapest in (\d+)", sentence)
    assert numbers == [tuple(str(4 * (outcome == o)) for o in ("win", "tie", "loss"))]
    assert "are ties (within 4 %)" in sentence
    text = winners_view(field, "w", "t", "").rows[0][1].text
    assert ("tie (4 %): contact-a and rk4" in text or "tie (4 %): rk4 and contact-a" in text) == (
        outcome == "tie"
    )
    assert bool(losses_view([field], "l", "").rows) == (outcome == "loss")
    assert bool(reasons([field])) == (outcome == "loss")


def test_losses_are_counted_among_the_pairs_that_some_method_reaches():
    rows = [r for m, f in (("contact-a", 2.0), ("rk4", 1.0)) for r in costs(m, f, finest=1e-10)]
    (sentence,) = reasons([Field(table("work_precision", rows), COMPILED)])
    assert "3 of 3 pairs of scene and error lost" in sentence


def test_a_margin_is_of_its_pair_and_of_two_processes():
    rows = [*costs("contact-a"), *costs("rk4", 1.1)]
    rows += [r for m in ("contact-a", "rk4") for r in costs(m, scene="noisy", time_halves_ratio=1 / 1.08)]
    field = Field(table("work_precision", rows), COMPILED)
    outcomes = {
        scene: {c.outcome for (s, _), c in field.contests().items() if s == scene} for scene in ("s", "noisy")
    }
    assert outcomes == {"s": {Verdict.win}, "noisy": {Verdict.tie}}  # noise elsewhere widens no margin
    assert field.margins[0] == pytest.approx(1.04)  # the other has cells of its own
    assert field.margins[-1] == pytest.approx(math.exp(math.hypot(math.log(1.04), 2**0.5 * math.log(1.08))))
    apart = Field(table("work_precision", [r | {"time_process_ratio": 1.12} for r in rows]), COMPILED)
    assert {c.outcome for (s, _), c in apart.contests().items() if s == "s"} == {Verdict.tie}
    assert {
        c.outcome for c in Field(table("work_precision", rows[:26]), EVALUATIONS).contests().values()
    } == {"tie"}


def test_a_cell_too_noisy_to_judge_says_so():
    """Halves that differ by two are no tie with what costs 1.1 times as much, and a win beside 100 times as much."""
    noisy = costs("contact-a", time_halves_ratio=2.0)
    field = Field(table("work_precision", [*noisy, *costs("rk4", 1.1), *costs("cvode-bdf", 100.0)]), COMPILED)
    contests = field.contests().values()
    assert {c.outcome for c in contests} == {Verdict.undecided}
    assert {c.verdict("contact-a", "cvode-bdf") for c in contests} == {Verdict.win}
    assert tally(contests).undecided == len(contests)
    assert "4 are too noisy to judge" in standing(field)[0]
    text = winners_view(field, "w", "t", "").rows[0][1].text
    assert text.startswith("undecided (×2.00): contact-a and rk4")
    unknown = costs("contact-a", time_halves_ratio=math.nan)  # visited once
    field = Field(table("work_precision", [*unknown, *costs("rk4", 1.1)]), COMPILED)
    assert {c.outcome for c in field.contests().values()} == {Verdict.undecided}


def test_kinds_of_engine_are_never_mixed():
    work = table("work_precision", [*costs("contact-a"), *costs("scipy-dop853", 1000.0, engine="python")])
    assert Field(work, COMPILED).contested == []  # nobody to compare with
    assert standing(Field(work, COMPILED)) is None
    assert Field(work, CALLED_BACK).contested == []
    assert Field(work, EVALUATIONS).contested == ["s"]
    for view in (
        p for p in headline.excerpt(frames(work_precision=work.to_dict("records"))) if hasattr(p, "rows")
    ):
        assert not ("Time" in view.title and "scipy" in str(view.rows))


@pytest.mark.parametrize("engine", ["c", "cyrk", "llvm", "numba"])
def test_a_compiled_row_takes_part_whoever_it_is(engine):
    work = table("work_precision", [*costs("contact-a"), *costs("scipy-dop853", 0.5, engine=engine)])
    field = Field(work, COMPILED)
    assert {c.best(contact=False) for c in field.contests().values()} == {"scipy-dop853"}
    assert tally(field.contests().values()).losses == len(TARGETS)


def test_ours_is_the_declared_family_and_not_a_name():
    rows = [*costs("contact-a", 2.0), *costs("mine", 1.0)]
    other = table("work_precision", rows)
    assert {c.outcome for c in Field(other, COMPILED).contests().values()} == {"loss"}
    declared = table("work_precision", [r | {"family": "contact"} for r in rows] + costs("rk4", 3.0))
    assert {c.outcome for c in Field(declared, COMPILED).contests().values()} == {"win"}
    assert Field(declared, COMPILED).leads["s", 1e-3].best(contact=True) == "mine"
    herglotz = table("work_precision", [*costs("contact-a", 2.0), *costs("herglotz1", 1.0)])
    assert {c.outcome for c in Field(herglotz, COMPILED).contests().values()} == {"loss"}


def test_loops_and_chosen_steps_are_no_contestants():
    rows = [*costs("contact-a"), *costs("rk4", 2.0), *costs("limit-c", 0.1, engine="c")]
    rows += [r | {"variant": "chosen", "setting": "chosen " + r["setting"]} for r in costs("rk4", 0.1)]
    assert {c.outcome for c in Field(table("work_precision", rows), COMPILED).contests().values()} == {"win"}


@pytest.mark.parametrize("status", ["budget", "timeout"])
def test_a_dash_says_whether_we_cut_the_run(status):
    coarse = [*costs("contact-a"), *costs("scipy-dop853", finest=1e-6)]
    finer = row("s", "scipy-dop853", 1e-9, status=status, message="max_steps spent")
    for rows, expected in ((coarse, DASH), ([*coarse, finer], status)):
        view = costs_view(Field(table("work_precision", rows), COMPILED), "s", "")
        (cells,) = (r for r in view.rows if r[0].text == "scipy-dop853")
        assert [c.text for c in cells[3:]] == [expected, expected]
    coarser = row("s", "scipy-dop853", 0.5, status=status)  # what was cut is no finer than what ended
    view = costs_view(Field(table("work_precision", [*coarse, coarser]), COMPILED), "s", "")
    (cells,) = (r for r in view.rows if r[0].text == "scipy-dop853")
    assert [c.text for c in cells[3:]] == [DASH, DASH]


def test_a_cost_of_something_more_accurate_is_marked_as_a_bound():
    rows = [r for r in costs("contact-a") if r["solution_error"] < 1e-4]
    view = costs_view(Field(table("work_precision", [*rows, *costs("rk4")]), COMPILED), "s", "")
    cell = view.rows[0][1]
    assert cell.text.startswith("≤ ")
    assert Mark.bound in cell.marks


def test_decade_by_decade_the_best_of_each_camp_and_a_ratio_anyone_can_read():
    work = table("work_precision", [*costs("contact-a"), *costs("contact-b", 2.0), *costs("rk4", 3100.0)])
    view = duel_view(Field(work, COMPILED), "s", "")
    line = view.rows[0]
    assert [c.text for c in line[3:]] == ["×3100", "contact"]
    assert line[1].text.startswith("contact-a")
    assert line[2].text.startswith("rk4")


def test_kinds_stand_side_by_side_and_say_what_they_are():
    assert [k.name for k in KINDS] == ["evaluations", "compiled", "marginal", "callbacks"]
    found = work_precision.findings(frames(work_precision=[*costs("contact-a"), *costs("rk4", 2.0)]))
    assert [f.name for f in found] == ["cost_evaluations", "cost_compiled"]


# -- stability -------------------------------------------------------------------------------------
def test_hard_scenes_are_compared_at_equal_error_and_not_at_the_finest_setting():
    """A peer stopped early has a larger smallest error, and is cheaper at every error it reaches."""
    rows = [
        {k: v for k, v in r.items() if not k.startswith("time_")}
        for r in [
            *costs("contact-o8", 2.0, "saddle_edge"),
            *costs("heyoka-taylor", 1.0, "saddle_edge", finest=1e-10),
        ]
    ]
    view = winners_view(Field(table("stability", rows), EVALUATIONS), "w", "t", "", headline.problem)
    (line,) = view.rows
    assert line[0].text == "at the edge of escape (`saddle_edge`)"
    assert ["heyoka-taylor" in c.text for c in line[1:]] == [True, True, True, False]


def test_rates_are_compared_at_equal_cost_and_ties_are_named():
    common = {"experiment": "overdamped", "t_end": 100.0}
    rows = [
        row(
            "overdamped", "contact-a", 0.5, **common, damping_per_step=25.0, evaluations=200, rate_error=1e-4
        ),
        row("overdamped", "rk4", 0.5, **common, damping_per_step=25.0, evaluations=200, rate_error=1.5e-4),
        row("overdamped", "scipy-radau", 1e-9, control="rtol", **common, evaluations=2000, rate_error=1e-10),
    ]
    view = damping.rates_view(table("damping_rates", rows))
    assert (
        "tie (×2.00): contact-a and rk4 1.0e-04" in view.rows[0][1].text
    )  # ten times dearer is no equal cost
    rows[2]["evaluations"] = 210
    view = damping.rates_view(table("damping_rates", rows))
    assert "scipy-radau 1.0e-10" in view.rows[0][1].text


def test_endings_name_who_has_no_bad_one_or_that_there_is_nobody():
    good, bad = (
        row("critical", "contact-a", 0.1, solution_error=1e-3),
        row("critical", "rk4", 0.1, status="diverged"),
    )
    right = row("escape", "rk4", 0.1, status="diverged", blow_up_time=1.5)
    many = [
        row("critical", m, 0.1, status="diverged") for m in ("rk4", "herglotz1", "herglotz2", "contact-a")
    ]
    (finding,) = (f for f in stability.findings(frames(stability=many)) if f.name == "endings")
    assert "Most of the others: rk4 1, herglotz1 1, herglotz2 1 and contact-a 1;" in finding.sentence  # a tie
    (finding,) = (f for f in stability.findings(frames(stability=[good, right])) if f.name == "endings")
    assert (
        "2 of 2 runs end as the true motion does, accurate or not. All runs of contact-a and rk4 do."
        in finding.sentence
    )
    (finding,) = (f for f in stability.findings(frames(stability=[good, bad])) if f.name == "endings")
    assert "All runs of contact-a do. Most of the others: rk4 1; by kind" in finding.sentence
    wrong = row(
        "escape", "contact-a", 0.1, solution_error=1.0, blow_up_time=1.5
    )  # ended although the motion does not
    (finding,) = (f for f in stability.findings(frames(stability=[wrong, bad])) if f.name == "endings")
    assert "No method has all of its runs among them." in finding.sentence


def test_blow_up_is_one_line_per_method_and_each_criterion_has_its_own_columns():
    rows = [
        row(
            "escape", "rk4", h, status="diverged", blow_up_time=2.0, end_time=2.0 + end, rhs_equivalents=8 / h
        )
        for h, end in ((0.2, -0.1), (0.1, 0.1), (0.05, -0.04))
    ]
    view = stability.blow_up_view(table("stability", rows))
    (line,) = view.rows
    said = ["-2.000 %", "-5.000 %", "+5.000 %"]  # finest, earliest, latest
    assert [c.text for c in line[1:]] == ["diverged", *said, DASH, DASH, DASH]
    assert [head.label for head in view.columns[2:]] == ["finest", "earliest", "latest"] * 2
    assert "by 2.000 %, as the finest runs have it" in view.meaning
    others = [r | {"method": "cvode-adams", "control": "rtol"} for r in rows]
    ours = [r | {"method": "contact-adaptive", "family": "contact", "control": "rtol"} for r in rows]
    first, second, third = stability.blow_up_view(table("stability", [*rows, *others, *ours])).rows
    assert first == line
    assert [c.text for c in second[1:]] == ["diverged", DASH, DASH, DASH, *said]
    assert [c.text for c in third[1:]] == ["diverged", *said, DASH, DASH, DASH]
    drawn = [p for f in figures_hard.hard(table("stability", [*rows, *others, *ours])) for p in f.panels]
    assert [{c.method for c in p.curves} for p in drawn] == [{"rk4", "contact-adaptive"}, {"cvode-adams"}]


def test_the_settings_of_a_ladder_are_in_its_heads():
    rows = [
        *(row("critical", "rk4", h, solution_error=h, end_time=8.0, rhs_equivalents=32 / h) for h in (2, 0.4)),
        *(row("critical", "contact-a", h, solution_error=h, end_time=8.0, rhs_equivalents=8 / h) for h in (0.4, 0.1)),
        *(row("critical", m, e, control="rtol", solution_error=e) for m, es in
          (("cvode-adams", (1e-4, 1e-14)), ("heyoka-taylor", (1e-4, 2.3e-16))) for e in es),
        row("needle", "rk4", 0.3, solution_error=0.1, end_time=8.0, rhs_equivalents=100.0),
    ]  # fmt: skip
    assert stability.rungs(table("stability", rows[:8])) == ["h/n 0.5, rtol 1e-04", "h/n 0.1, rtol 1e-14"]
    view = stability.map_view(table("stability", rows))
    assert [(h.group, h.label) for h in view.columns[1:]] == [
        ("critical", "h/n 0.5, rtol 1e-04"), ("critical", "h/n 0.1, rtol 1e-14"), ("needle", "h/n 0.08"),
    ]  # fmt: skip


def test_hard_scenes_are_drawn_by_kind_and_a_scene_of_ones_own_is_among_others():
    rows = [
        row(s, "rk4", 0.1, solution_error=1e-3, rhs_equivalents=80.0) for s in ("mine", "needle", "critical")
    ]
    drawn = {f.name: [p.title for p in f.panels] for f in figures_hard.hard(table("stability", rows))}
    assert drawn == {"hard_damping": ["critical"], "hard_bodies": ["needle"], "hard_others": ["mine"]}


def test_what_was_not_run_is_no_ending():
    spent = row("critical", "scipy-radau", 1e-4, control="rtol", status="budget", end_time=3.0)
    never = [
        row("critical", "scipy-radau", e, control="rtol", status="budget", message="not run")
        for e in (1e-7, 1e-10)
    ]
    good = row("critical", "rk4", 0.1, solution_error=1e-3, end_time=10.0)
    (finding,) = (
        f for f in stability.findings(frames(stability=[good, spent, *never])) if f.name == "endings"
    )
    assert finding.sentence.startswith("1 of 2 runs end as the true motion does")
    assert "by kind budget 1 (budget: our own limit)" in finding.sentence
    assert "2 settings not run: a looser tolerance had spent the budget" in finding.sentence
    (finding,) = (f for f in stability.findings(frames(stability=[good, spent])) if f.name == "endings")
    assert "not run" not in finding.sentence


def test_a_scene_out_of_reach_is_a_sentence_and_no_row():
    rows = [
        row("needle", "rk4", 0.1, solution_error=1e-3),
        *(row("needle", m, 0.1, status="unsupported", message="no body") for m in ("herglotz1", "herglotz2")),
    ]
    view = stability.scene_view(table("stability", rows), "needle")
    assert [line[0].text for line in view.rows] == ["rk4"]
    assert view.meaning == "Out of reach of herglotz1 and herglotz2 (no body)."


def test_the_worst_of_a_law_is_bold_only_where_every_run_keeps_it():
    rows = [
        kept_row("needle") | {"momentum_law": 2e-12, "evaluations": 20_000},
        kept_row("needle", value=0.2) | {"momentum_law": 1.5e-12, "evaluations": 10},
    ]

    def cell(rows):
        view = stability.scene_view(table("stability", rows), "needle")
        return next(c for h, c in zip(view.columns, view.rows[0], strict=True) if h.label == "J law")

    assert cell(rows).text == "2.0e-12"
    assert Mark.kept not in cell(rows).marks
    assert Mark.kept in cell(rows[:1]).marks


def test_the_first_loss_of_stability_is_marked_where_there_are_windows():
    rows = [
        {"method": "contact-bm6", "family": "contact", "gamma": 0.0, "omega": 1.0, "limit": 3.134,
            "windows": "3.134…3.163"},
        {"method": "rk4", "family": "established", "gamma": 0.0, "omega": 1.0, "limit": 2.785, "windows": ""},
    ]  # fmt: skip
    view = limits.limit_view(table("stability_limits", rows), "limit", "limits", "t")
    assert [Mark.exception in r[1].marks for r in view.rows] == [True, False]
    assert limits.windows_view(table("stability_limits", rows)).rows[0][-1].text == "3.134…3.163"


def test_where_negative_substeps_stop_paying():
    grid = [1e-3, 1e-2, 1e-1, 1.0]
    errors = {"contact-strang": [1e-6, 1e-4, 1e-2, 1e-1], "contact-rkn6": [1e-9, 1e-7, 1.0, float("inf")]}
    rows = [
        {"method": m, "family": "contact", "gamma": 1.0, "damping_per_evaluation": d, "step": 1.0, "error": e,
            "radius": 1.0}
        for m, es in errors.items() for d, e in zip(grid, es, strict=True)
    ]  # fmt: skip
    assert damping.usable(table("strong_damping", rows), "contact-rkn6", 1.0) == 1e-2
    late = [r | {"error": e} for r, e in zip(rows[4:], [1e-5, 1e-5, 1e-5, 1e-5], strict=True)]
    assert (
        damping.usable(table("strong_damping", [*rows[:4], *late]), "contact-rkn6", 1.0) == 0
    )  # worse at first
    alone = table("strong_damping", [r for r in rows if r["method"] == "contact-rkn6"])
    assert list(damping.strong_parts(alone)) == []  # nothing to compare with


# -- ensembles -------------------------------------------------------------------------------------
def test_a_trajectory_at_equal_error_names_ties():
    def runs(method, factor, variant=""):
        return [
            row("particle", method, e, variant=variant, question="error", trajectories=1000, cores=1, solution_error=e,
                time_min_s=factor * 1e-3 / e**0.1, evaluations=100)
            for e in (1e-2, 1e-13)
        ]  # fmt: skip

    (finding,) = ensemble.findings(frames(ensemble=[*runs("contact-a", 1.0), *runs("rk4", 1.03)]))
    assert "10⁻³ tie (4 %): contact-a and rk4" in finding.sentence
    (finding,) = ensemble.findings(frames(ensemble=[*runs("contact-a", 1.0), *runs("rk4", 0.5, "vmap")]))
    assert "10⁻³ rk4 vmap" in finding.sentence


def test_ensembles_stand_beside_c_loops_and_a_fall_of_throughput_is_told():
    def run(method, seconds, **more):
        return row("particle", method, 0.1, engine="numba", trajectories=100, cores=1, evaluations=10,
                   time_median_s=seconds, time_min_s=seconds) | more  # fmt: skip

    arithmetic = [
        run("contact-a", 8e-7, question="arithmetic"),
        run("contact-a", 9e-7, question="arithmetic", engine="jax"),
        run("limit-c", 1e-6, question="arithmetic", variant="contact-a plain"),
        run("limit-c", 5e-7, question="arithmetic", variant="contact-a tiled"),
    ]
    cores = [run("contact-a", t, question="cores", cores=c) for c, t in ((1, 1e-6), (2, 8e-7))]
    (finding,) = ensemble.findings(frames(ensemble=[*arithmetic, *cores]))
    assert "contact-a (numba) 0.8 ns, ×0.80 (plain) and ×1.60 (tiled)." in finding.sentence
    assert "On 2 cores contact-a (numba) has ×1.25 the throughput of 1." in finding.sentence

    def meaning(*rates):
        size = [
            run("contact-a", n / r, question="size", trajectories=n)
            for n, r in zip((10, 100, 1000), rates, strict=True)
        ]
        view = ensemble.growth_view(ensemble.timed(table("ensemble", size)), "size", "trajectories", "t")
        return view.meaning

    assert "falls" not in meaning(1e6, 2e6, 2e6)
    assert "from 100 to 1000 trajectories it falls to ×0.98, within the margin of 4 %" in meaning(
        1e6, 2e6, 1.96e6
    )
    assert "from 100 to 1000 trajectories it falls to ×0.50, more than the margin of 4 %" in meaning(
        1e6, 2e6, 1e6
    )


def calls(method, whole, share, marginal):
    """Whole calls of 1000 trajectories at two settings; the looser one is the cheaper."""
    return [
        row("particle", method, e, question="error", trajectories=1000, cores=1, solution_error=e, evaluations=100,
            time_min_s=whole * factor, fixed_s=whole * factor * part, marginal_s=marginal)
        for e, factor, part in ((1e-4, 1.0, share), (1e-13, 3.0, share / 3))
    ]  # fmt: skip


def test_the_fixed_share_of_an_ensemble_is_that_of_the_settings_that_win():
    one = calls("contact-a", 1e-3, 0.6, 4e-7)
    (finding,) = ensemble.findings(frames(ensemble=[*one, *calls("rk4", 9e-3, 0.1, 8e-6)]))
    assert "10⁻³ contact-a ≤ 1 µs (60 % fixed)" in finding.sentence
    assert "10⁻¹² contact-a" in finding.sentence
    assert "(20 % fixed)" in finding.sentence
    assert "One more trajectory" not in finding.sentence  # nobody else is cheapest by marginal cost
    (finding,) = ensemble.findings(frames(ensemble=[*one, *calls("rk4", 9e-3, 0.1, 1e-7)]))
    assert "One more trajectory, without what every call takes: 10⁻³ rk4 ≤ 100 ns" in finding.sentence
    view = ensemble.error_view(ensemble.timed(table("ensemble", one)))
    assert [FIXED in cell.text for cell in view.rows[0][3:]] == [True, False, False, False]
    unknown = [r | {"fixed_s": None, "marginal_s": None} for r in one]
    (finding,) = ensemble.findings(frames(ensemble=unknown))
    assert "fixed" not in said(finding)


# -- tables ----------------------------------------------------------------------------------------
def test_a_closed_form_is_exact_and_not_adaptive():
    rows = [
        kept_row("central", "contact-exact", 0, control="exact", cost=30.0),
        kept_row("central", "contact-c", 1e-9, control="rtol", cost=30.0),
    ]
    view = equal_cost.overview(frames(decay_laws=rows))
    assert [line[1].text for line in view.rows] == ["exact", "adaptive"]


def test_what_is_bold_at_equal_cost_is_what_its_sentence_says():
    """At most 1e-12, or ε times the evaluations: 2.2e-12 for ten thousand."""
    rows = [
        kept_row("central", m, cost=30.0) | {"momentum_law": 2e-12, "evaluations": n}
        for m, n in (("contact-a", 10_000), ("contact-b", 100))
    ]
    view = equal_cost.overview(frames(decay_laws=rows))
    bold = [Mark.kept in next(c for c in line if c.text == "2.0e-12").marks for line in view.rows]
    assert bold == [True, False]
    assert "at most 1e-12, or ε times the evaluations" in view.meaning


def test_marginal_cost_ranks_anew_and_a_cost_that_is_mostly_fixed_is_marked():
    """The cheaper call of two is the dearer one as soon as runs are long."""
    quick = [r | {"fixed_s": 0.2 * r["time_min_s"], "marginal_s": 2.0} for r in costs("contact-a")]
    slow = [r | {"fixed_s": 0.9 * r["time_min_s"], "marginal_s": 1.0} for r in costs("rk4", 2.0)]
    work = table("work_precision", [*quick, *slow]).assign(marginal_halves_ratio=1.0)
    whole, marginal = Field(work, COMPILED), Field(work, MARGINAL)
    assert {c.outcome for c in whole.contests().values()} == {"win"}
    assert {c.outcome for c in marginal.contests().values()} == {"loss"}
    marked = {line[0].text: {FIXED in c.text for c in line[1:]} for line in costs_view(whole, "s", "").rows}
    assert marked == {"contact-a": {False}, "rk4": {True}}
    assert not any(FIXED in c.text for line in costs_view(marginal, "s", "").rows for c in line)
    noisy = work.assign(marginal_halves_ratio=[1.0, 3.0] * (len(work) // 2))
    assert Verdict.undecided in {c.outcome for c in Field(noisy, MARGINAL).contests().values()}
    lost = work.assign(marginal_s=-1.0)  # lost in noise: no cost, rather than the least
    assert not any(c.decided for c in Field(lost, MARGINAL).contests().values())
    vague = work.assign(marginal_halves_ratio=[math.nan if m == "rk4" else 1.0 for m in work["method"]])
    assert all(set(c.costs) == {"contact-a"} for c in Field(vague, MARGINAL).contests().values())


def test_one_more_trajectory_has_a_table_of_its_own():
    """Whole calls and marginal cost rank differently where one method's calls have a large fixed cost."""

    def runs(method, whole, marginal):
        return [
            {k: v for k, v in r.items() if k != "rhs_equivalents"}
            | {
                "question": "error",
                "trajectories": 100,
                "cores": 1,
                "time_min_s": whole,
                "marginal_s": marginal,
                "marginal_halves_ratio": 1.0,
            }
            for r in costs(method)
        ]

    timed = ensemble.timed(table("ensemble", [*runs("contact-a", 2.0, 1e-3), *runs("rk4", 1.0, 5e-3)]))
    firsts = []
    for marginal in (False, True):
        view = ensemble.error_view(timed, marginal)
        firsts.append([line[0].text for line in view.rows if Mark.best in line[-1].marks])
    assert firsts == [["rk4"], ["contact-a"]]
    vague = timed.assign(
        marginal_halves_ratio=[math.nan if m == "contact-a" else 1.0 for m in timed["method"]]
    )
    assert [line[0].text for line in ensemble.error_view(vague, True).rows] == ["rk4"]
    unknown = ensemble.timed(table("ensemble", [r | {"marginal_s": math.nan} for r in runs("rk4", 1.0, 0.0)]))
    assert ensemble.error_view(unknown, marginal=True) is None


def test_laws_along_time_are_alternatives_by_the_name_of_their_scene():
    rows = [row(s, "rk4", 0.1, t=1.0, energy_deviation=1e-3) for s in ("particle", "central")]
    (along,) = (p for p in laws.sections(frames(laws_time=rows)) if getattr(p, "title", "") == "Along time")
    assert [(s.title, s.choice) for s in along.parts] == [("particle", "scene"), ("central", "scene")]


@pytest.mark.parametrize(
    ("value", "bound", "judged"),
    [
        (1e-8, 9e-7, (True, False)),
        (1e-8, 2e-6, (False, True)),  # any method might pass
        (1e-13, 2e-6, (True, False)),  # round-off, whatever it may grow to
        (1e-5, 1e-6, (False, False)),
    ],
)
def test_a_bound_above_a_millionth_decides_nothing(value, bound, judged):
    assert kept.decided(value, bound) == judged


def test_the_margin_of_a_pair_is_that_of_its_noisier_engine():
    """What two processes differ by is known engine by engine, where enough of its cells were timed twice."""
    rows = [
        {"scene": "particle", "method": method, "family": family, "engine": engine, "control": "rtol",
         "value": 10.0**-k,
         "variant": "", "status": "ok", "solution_error": 10.0**-k, "time_min_s": k * factor, "fixed_s": 0.0,
         "time_halves_ratio": 1.0, "time_process_ratio": ratio}
        for method, family, engine, factor, ratio in (
            ("contact-a", "contact", "numba", 1e-6, 1.01), ("b", "established", "c", 1.06e-6, 1.02),
            ("c", "established", "jax", 1.07e-6, 1.10),
        )
        for k in range(1, ENOUGH + 6)
    ]  # fmt: skip
    field = Field(pd.DataFrame(rows), COMPILED)
    assert field.processes == pytest.approx({"numba": 1.01, "c": 1.02, "jax": 1.10})
    lead = field.leads["particle", 1e-6]
    assert lead.verdicts == {"contact-a": "tie", "b": "loss", "c": "tie"}
    assert lead.margin("contact-a", "b") == pytest.approx(1.03)
    few = pd.DataFrame(rows).assign(
        time_process_ratio=lambda f: f["time_process_ratio"].where(f["value"] > 1e-3)
    )
    assert list(Field(few, COMPILED).processes.values()) == pytest.approx([1.10] * 3)
