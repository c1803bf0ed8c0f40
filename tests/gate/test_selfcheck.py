"""The self-check of the gate: what it plants is what it says, and its document says what it does not see."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import contactbench as cb
import gate_selfcheck
import made_up
import planted_faults
import properties
import selfcheck_accuracy
import selfcheck_cells
import selfcheck_faults
import selfcheck_speed
import selfcheck_tables
from contactbench.gate.verdict import Line
from contactbench.report import gate_selfcheck as room
from contactbench.report import markdown
from contactbench.results.selfcheck import GATE_SELFCHECK
from contactbench.results.store import read
from contactbench.splitting.tables import COMPOSITIONS
from selfcheck_faults import Judgement, Task

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
    calls = {fault.what: fault.planted for fault in selfcheck_faults.FAULTS}
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
    assert selfcheck_accuracy.found_as(line, claim)
    for other in ({"setting": "C2"}, {"measure": "verdict"}, {"table": "laws"}):
        assert not selfcheck_accuracy.found_as(Line(**{**vars(line), **other}), claim)
    fault = next(fault for fault in selfcheck_faults.SPENT if fault.saves > 1)
    slow = Line(
        fault.measure, "", "", "", "slower", True, fault.scene, fault.method, setting="1000 saved times"
    )
    assert selfcheck_speed.gives_away(slow, fault)
    for other in ({"setting": ""}, {"red": False}, {"method": "rk5"}):
        assert not selfcheck_speed.gives_away(Line(**{**vars(slow), **other}), fault)


def test_what_is_timed_together_is_planted_in_different_methods():
    found = selfcheck_speed.batches(selfcheck_faults.SPENT)
    assert sorted(id(fault) for batch in found for fault in batch) == sorted(map(id, selfcheck_faults.SPENT))
    for batch in found:
        assert len({fault.method for fault in batch}) == len(batch)


# -- cells and folders -----------------------------------------------------------------------------
def test_cells_run_with_a_fault_differ_where_it_is_and_leave_nothing_registered(tmp_path):
    cells = [("convergence", ("particle", name)) for name in ("contact-abc", "contact-strang")]
    whole = dict(cb.METHODS)
    selfcheck_cells.run(tmp_path / "truth", "", cells)
    selfcheck_cells.run(tmp_path / "wrong", "wrong_coefficients({'contact-abc': 0})", cells)
    selfcheck_cells.run(tmp_path / "again", "", cells)
    assert dict(cb.METHODS) == whole
    assert {line.method for line in selfcheck_accuracy.red(tmp_path / "truth", tmp_path / "wrong")} == {
        "contact-abc"
    }
    assert selfcheck_accuracy.red(tmp_path / "truth", tmp_path / "again") == []


def test_a_method_that_is_gone_has_no_cells_any_more(tmp_path):
    cells = [("laws", ("particle", name)) for name in ("contact-bm4", "contact-strang")]
    selfcheck_cells.run(tmp_path / "truth", "", cells)
    selfcheck_cells.run(tmp_path / "gone", "no_bm4()", cells)
    (line,) = selfcheck_accuracy.red(tmp_path / "truth", tmp_path / "gone")[:1]
    assert (line.method, line.verdict) == ("contact-bm4", "missing")


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    return selfcheck_tables.Folders(
        made_up.committed(tmp_path_factory.mktemp("tables")), tmp_path_factory.mktemp("folders")
    )


def test_the_committed_tables_against_themselves_are_green(folders):
    (one,) = selfcheck_tables.unchanged(folders)
    assert (one.red, one.words) == (False, "")


@pytest.mark.parametrize("fault", selfcheck_tables.DOCTORED, ids=lambda fault: fault.what)
@pytest.mark.share(3)
def test_doctored_tables_are_given_away(fault, folders):
    (one,) = selfcheck_tables.doctored(fault, folders, fault.what.replace(" ", "-"))
    assert one.red
    assert one.words


# -- journal and table -----------------------------------------------------------------------------
def judgement(planted="a fault", red=True, words="a line", wanted="all", **more):
    values = {"part": "accuracy", "condition": "as it was", "seconds": 1.0, **more}
    return Judgement(planted=planted, red=red, words=words, wanted=wanted, **values)


QUESTION = {"commit": "c", "parts": ["accuracy"], "runs": 1}


def test_a_killed_self_check_goes_on_where_it_was(tmp_path):
    path = tmp_path / "journal" / "self.jsonl"
    journal = gate_selfcheck.Journal(path, QUESTION)
    journal.add("one", [judgement()])
    journal.add("two", [judgement("b"), judgement("c", red=False)])
    with path.open("a") as file:
        file.write('{"task": "three", "judged": [{"pa')
    again = gate_selfcheck.Journal(path, QUESTION)
    assert again.done == journal.done
    again.add("three", [judgement("d")])  # the line cut short is gone
    assert list(gate_selfcheck.Journal(path, QUESTION).done) == ["one", "two", "three"]
    assert gate_selfcheck.Journal(path, {**QUESTION, "commit": "d"}).done == {}


def test_what_is_done_is_not_done_again_and_what_fails_loses_nothing(tmp_path):
    asked = []

    def task(name, shared=True, fails=False):
        def judge():
            asked.append(name)
            if fails:
                raise RuntimeError("killed")
            return [judgement(name)]

        return Task(name, 1.0, judge, shared)

    journal = gate_selfcheck.Journal(tmp_path / "self.jsonl", QUESTION)
    with pytest.raises(RuntimeError):
        gate_selfcheck.work_off(
            [task("one"), task("two", False), task("three", False, True)], journal, tmp_path
        )
    again = gate_selfcheck.Journal(tmp_path / "self.jsonl", QUESTION)
    gate_selfcheck.work_off([task("one"), task("two", False), task("three", False)], again, tmp_path)
    assert asked == ["one", "two", "three", "three"]
    assert set(read(GATE_SELFCHECK, tmp_path)["planted"]) == {"one", "two", "three"}


def test_the_table_counts_and_a_whole_self_check_removes_what_is_no_longer_planted(tmp_path):
    gate_selfcheck.write([judgement("gone")], tmp_path, whole=False)
    judged = [
        judgement(seconds=3.0),
        judgement(red=False, words="", seconds=1.0),
        judgement("nothing", False, "", "none"),
    ]
    made = gate_selfcheck.write(judged, tmp_path, whole=True)
    frame = read(GATE_SELFCHECK, tmp_path).set_index("planted")
    assert set(frame.index) == {"a fault", "nothing"}
    assert tuple(frame.loc["a fault", ["runs", "red", "seconds", "example"]]) == (2, 1, 2.0, "a line")
    assert [bool(gate_selfcheck.wrong(row)) for row in made] == [True, False]


@pytest.mark.parametrize(
    ("wanted", "red", "fine"),
    [("none", 0, True), ("none", 1, False), ("all", 20, True), ("all", 19, False), ("19 in 20", 19, True),
     ("19 in 20", 18, False), ("the more the better", 0, True), ("not seen", 0, True), ("not seen", 1, False)],
)  # fmt: skip
def test_a_row_is_as_wanted_or_not(wanted, red, fine):
    row = {"part": "", "planted": "", "condition": "", "wanted": wanted, "red": red, "runs": 20}
    assert (gate_selfcheck.wrong(row) == "") == fine


def test_its_document_counts_alarms_and_faults_and_says_what_is_not_seen():
    rows = gate_selfcheck.rows([
        judgement("nothing", False, "", "none"), judgement("nothing", True, "cried wolf", "none"),
        judgement("a fault", True, "a|b"), judgement("a fault", True, "c"),
        judgement("a hair", False, "", "not seen"),
    ])  # fmt: skip
    tables = {"gate_selfcheck": pd.DataFrame(rows)}
    text = markdown.parts(room.sections(tables))
    (finding,) = room.findings(tables)
    assert "1 false alarms in 2 judgements of identical code; 2 of 2 planted faults found" in finding.sentence
    assert "It does not see: a hair" in finding.sentence
    assert "1 false alarms in 2 judgements; 2 of 2 planted faults found" in text
    assert "cried wolf" in text
    assert "a\\|b" in text
    assert finding.exceptions == ()
