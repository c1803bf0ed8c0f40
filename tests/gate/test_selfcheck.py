"""The self-check of the gate: what it plants is what it says, and its document says what it does not see."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import contactbench as cb
import gate_selfcheck
import planted_faults
import properties
import selfcheck_faults
from contactbench.gate.verdict import Line
from contactbench.report import gate_selfcheck as room
from contactbench.report import markdown
from contactbench.splitting.tables import COMPOSITIONS

REPOSITORY = Path(__file__).parents[2]


@pytest.mark.parametrize("composition", COMPOSITIONS, ids=lambda c: c.name)
def test_every_coefficient_of_a_composition_has_a_fault_of_its_own(composition):
    wrong = planted_faults.faulty(composition)
    printed = len(composition.stages) // 2 - 1 if len(composition.stages) > 5 else len(composition.stages)
    assert len(wrong) == printed + max(0, len(composition.processor) - 2)
    assert len({(each.stages, each.processor) for each in [composition, *wrong]}) == len(wrong) + 1
    for each in wrong:  # what is implied follows, and the sums do not give a long composition away
        assert properties.consistent(each) == (len(composition.stages) > 5)


@pytest.fixture
def methods():
    """The registry, whole again after the test."""
    kept = dict(cb.METHODS)
    yield cb.METHODS
    cb.METHODS.clear()
    cb.METHODS.update(kept)


def planted(call, methods):
    """A solution of contact-strang before a fault is planted, and one after it."""

    def solution():
        return cb.solve("particle", "contact-strang", step=0.1, save_at=[20.0])

    before = solution()
    exec(f"planted_faults.{call}", {"planted_faults": planted_faults})
    return before, solution()


def test_faults_planted_by_plug_ins_are_what_they_are_called(methods):
    calls = {fault.what: fault.planted for fault in selfcheck_faults.FAULTS if isinstance(fault.planted, str)}
    assert len(calls) == len(selfcheck_faults.FAULTS) - 1
    whole = dict(methods)
    seen = {}
    for what, call in calls.items():
        seen[what] = (*planted(call, methods), "contact-bm4" in methods)
        methods.update(whole)
    error, drift = cb.LAWS["solution_error"], cb.LAWS["contact_drift"]
    before, after, _ = seen["order 2 replaced by order 1"]
    assert error(after) > 5 * error(before)  # of order h against h²: 6.9 times, measured
    before, after, _ = seen["an extra gradient evaluation per step"]
    assert (before.counts.evaluations, after.counts.evaluations) == (201, 400)
    np.testing.assert_allclose(after.y, before.y, rtol=0, atol=1e-13)
    assert seen["a status change: a scene refused"][1].status is cb.Status.unsupported
    before, after, _ = seen["a drift that is no longer round-off: damping stronger by 1e-9"]
    assert drift(before) < 1e-13
    assert drift(after) == pytest.approx(1e-9 * cb.SCENES["particle"].gamma * 20, rel=1e-3)
    assert [what for what, (*_, there) in seen.items() if not there] == ["dropped rows: a method is gone"]


def test_what_the_self_check_patches_is_still_there_to_be_changed():
    patches = [f.planted for f in selfcheck_faults.FAULTS if isinstance(f.planted, selfcheck_faults.Patch)]
    assert len(patches) == 1
    for patch in patches:
        assert (REPOSITORY / patch.file).read_text().count(patch.old) == 1, patch
        assert patch.new != patch.old


def test_what_is_planted_at_once_is_in_nothing_but_what_it_says(methods, monkeypatch):
    """Faults in measures, claims, figures, counts, scenes and ensembles; see `planted_faults.other_numbers`."""
    import contactbench.measure.laws as laws
    import contactbench.measure.order as order
    import contactbench.truth as truth
    from contactbench.claims import CLAIMS, curves

    scenes, figures, claims = dict(cb.SCENES), dict(curves.FIGURES), dict(CLAIMS)
    for module, name in ((laws, "energies"), (order, "fit_order"), (truth, "blow_up_time"), (cb, "ensemble")):
        monkeypatch.setattr(module, name, getattr(module, name))  # as it was, after the test
    start = {"q": (np.linspace(0.9, 1.1, 8), 0.5)}

    def seen():
        solution = cb.solve("particle", "rk4", step=0.1, save_at=[20.0])
        return {
            "central": cb.SCENES["central"].gamma,
            "scipy-dop853": cb.solve(
                "particle", "scipy-dop853", rtol=1e-6, save_at=[20.0]
            ).counts.evaluations,
            "C25": CLAIMS["C25"].row()["measured"],
            "rk4": float(laws.energies(solution)[0][0]),
            "paper_3": [row["y"] for row in curves.rows("paper_3")][1],
            "escape": float(truth.blow_up_time(cb.SCENES["escape"])[0]),
            "order": order.fit_order([0.4, 0.2, 0.1, 0.05], [0.16, 0.04, 0.01, 0.0025]).order,
            "member": np.array(cb.ensemble("particle", "rk4", start, step=0.1, progress=False).final.q[0]),
        }

    before = seen()
    try:
        planted_faults.other_numbers(1.03)
        after = seen()
    finally:
        for registry, kept in ((cb.SCENES, scenes), (curves.FIGURES, figures), (CLAIMS, claims)):
            registry.clear()
            registry.update(kept)
    changed = {name: after[name] / before[name] for name in before if name not in ("order", "member")}
    assert changed == pytest.approx(
        {"central": 1.01, "scipy-dop853": 0.91, "C25": 1.03, "rk4": 1.03, "paper_3": 1.03, "escape": 1.03},
        rel=2e-3,
    )
    assert after["order"] - before["order"] == pytest.approx(-0.1, abs=1e-9)
    moved = after["member"] / before["member"] - 1
    np.testing.assert_allclose(moved, [0] * 5 + [1e-6] * 3, atol=1e-12)


def test_a_fault_is_found_by_its_own_line_only():
    claim = next(fault for fault in selfcheck_faults.OTHER if fault.table == "claims")
    line = Line("measured", "1", "2", "", "moved", True, table="claims", setting="C25")
    assert gate_selfcheck.found_as(line, claim)
    for other in ({"setting": "C2"}, {"measure": "verdict"}, {"table": "laws"}):
        assert not gate_selfcheck.found_as(Line(**{**vars(line), **other}), claim)


def test_what_is_timed_together_is_planted_in_different_methods():
    found = gate_selfcheck.batches(selfcheck_faults.SPENT)
    assert sorted(id(fault) for batch in found for fault in batch) == sorted(map(id, selfcheck_faults.SPENT))
    for batch in found:
        assert len({fault.method for fault in batch}) == len(batch)


def test_its_document_counts_alarms_and_faults_and_says_what_is_not_seen():
    rows = [
        gate_selfcheck.outcome(
            "accuracy", "nothing", "idle", "none", [(False, ""), (True, "cried wolf")], 1.0
        ),
        gate_selfcheck.outcome("accuracy", "a fault", "idle", "all", [(True, "a|b"), (True, "c")], 2.0),
        gate_selfcheck.outcome("accuracy", "a hair", "idle", "not seen", [(False, "")], 2.0),
    ]
    tables = {"gate_selfcheck": pd.DataFrame(rows)}
    text = markdown.parts(room.sections(tables))
    (finding,) = room.findings(tables)
    assert "1 false alarms in 2 judgements of identical code; 2 of 2 planted faults found" in finding.sentence
    assert "It does not see: a hair" in finding.sentence
    assert "1 false alarms in 2 judgements; 2 of 2 planted faults found" in text
    assert "cried wolf" in text
    assert "a\\|b" in text
    assert finding.exceptions == ()
