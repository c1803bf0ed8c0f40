"""The experiments, run for real on a small part, and the report made from their tables alone."""

from __future__ import annotations

import shutil

import pandas as pd
import pytest
from contactbench.report.documents import (
    decades,
    duration,
    equal_error,
    into_readme,
    losses,
    report,
    winners,
)

import contactbench as cb
from cases import bench, finished
from contactbench.gate.accuracy import accuracy
from contactbench.report import figures
from contactbench.report.stability import advice, error_and_cost, stability_document, strong_section, usable
from contactbench.results.schema import CONVERGENCE, STABILITY, TABLES, WORK_PRECISION, read

SMALL = "particle and not long and not limit and (strang or rk4 or cvode or heyoka)"


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    finished(bench(folder, SMALL))
    return folder


def test_a_partial_run_fills_its_part_of_every_table(results):
    work = read(WORK_PRECISION, results)
    assert set(work["scene"]) == {"particle"}
    assert set(work["method"]) == {"contact-strang", "rk4", "cvode-adams", "cvode-bdf", "heyoka-taylor"}
    assert (work["status"] == "ok").all()
    needed = [
        "solution_error", "steps", "evaluations", "compile_s", "first_call_s", "time_min_s", "time_median_s",
        "time_iqr_s", "rounds",
    ]  # fmt: skip
    assert work[needed].notna().all().all()
    assert (work["rounds"] >= 5).all()
    assert (work["time_min_s"] > 0).all()
    assert {"contact-strang", "rk4"} == set(read(CONVERGENCE, results)["method"])
    assert (results / "environment.json").exists()


def test_a_second_partial_run_leaves_the_other_rows_and_the_gate_sees_no_difference(results, tmp_path):
    before = read(WORK_PRECISION, results)
    shutil.copytree(results, tmp_path / "before")
    finished(bench(results, "work_precision and particle and rk4 and not long"))
    after = read(WORK_PRECISION, results)
    assert len(after) == len(before)
    same = after["method"] != "rk4"
    pd.testing.assert_frame_equal(after[same], before[same])
    assert set(after[~same]["run_id"]).isdisjoint(set(before[~same]["run_id"]))
    verdict = accuracy(tmp_path / "before", results)
    assert not verdict.red, verdict.as_markdown()
    assert verdict.lines == ()


def test_report_writes_documents_and_figures_from_the_tables(results):
    written = {path.name for path in report(results)}
    assert {"README.md", "convergence.md", "work_precision.md"} <= written
    text = (results / "README.md").read_text()
    assert "contact-strang" in text
    assert "nan" not in text
    for path in (results / "figures").glob("*.svg"):
        assert "<svg" in path.read_text()
    again = {path: path.read_bytes() for path in results.rglob("*.svg")}
    report(results)
    assert {path: path.read_bytes() for path in again} == again  # equal tables give equal files


def table(errors, times, method="rk4", engine="jax"):
    return pd.DataFrame({
        "scene": "s", "method": method, "engine": engine, "status": "ok", "solution_error": errors,
        "time_median_s": times, "rhs_equivalents": times, "track": "fixed",
    })  # fmt: skip


def test_equal_error_and_winners_name_the_faster_one():
    work = pd.concat([
        table([1e-2, 1e-8], [1e-3, 1e-1], "slow"),
        table([1e-2, 1e-4], [1e-4, 1e-3], "fast"),
    ])  # fmt: skip
    frame = equal_error(work, "s", "time_median_s").set_index("method")
    assert frame.loc["slow", 1e-3] > frame.loc["fast", 1e-3]
    assert pd.isna(frame.loc["fast", 1e-6])  # outside its data
    text = winners(work, "time_median_s", duration, ("jax",))
    assert "**fast**" in text
    assert "**slow**" in text  # the only one at 1e-6: a peer that wins is named


def test_losses_name_the_peer_that_wins_and_by_how_much():
    work = pd.concat([
        table([1e-2, 1e-6], [1e-3, 1e-1], "contact-strang"),
        table([1e-2, 1e-6], [1e-4, 1e-2], "rk4"),
    ])  # fmt: skip
    assert "rk4 ×10" in losses(work).markdown()
    assert "**100 µs (×0.10)**" not in decades(
        work, "s", "time_median_s", duration
    )  # 1e-2 is no decade of it
    assert "**316 µs (×0.10)**" in decades(work, "s", "time_median_s", duration)
    ahead = work.assign(method=work["method"].map({"contact-strang": "rk4", "rk4": "contact-strang"}))
    assert not losses(ahead).rows


def hard_rows(method, errors, times, **more):
    return pd.DataFrame({
        "scene": "kepler_drag", "method": method, "engine": "jax", "setting": "x", "status": "ok", "message": "",
        "solution_error": errors, "time_s": times, "rhs_equivalents": times, "end_error": errors,
        "condition_number": float("nan"), "momentum_law": more.get("law", 1e-3),
        "contact_drift": more.get("law", 1e-3),
    }).reindex(columns=list(STABILITY.columns))  # fmt: skip


def test_the_advice_names_peers_that_win_and_who_keeps_the_laws():
    hard = pd.concat([
        hard_rows("contact-adaptive", [1e-4, 1e-8], [3e-4, 9e-4], law=1e-15),
        hard_rows("heyoka-taylor", [1e-4, 1e-8], [1e-4, 3e-4]),
    ])  # fmt: skip
    empty = {name: pd.DataFrame(columns=list(t.columns)) for name, t in TABLES.items()}
    text = advice(empty | {"stability": hard})
    (kepler,) = (line for line in text.splitlines() if "kepler_drag" in line)
    assert "**heyoka-taylor**" in kepler  # a peer that wins is named, ours beside it
    assert "contact-adaptive" in kepler
    (laws,) = (line for line in text.splitlines() if "J and η" in line)
    assert "**contact-adaptive**" in laws
    assert "heyoka-taylor 1.0e-03" in laws
    assert advice(empty) == ""


def test_stability_document_is_written_from_its_tables_alone():
    """Each section from a few rows; a method that diverged, one that is unsupported."""
    empty = {name: pd.DataFrame(columns=list(t.columns)) for name, t in TABLES.items()}
    hard = pd.concat([
        hard_rows("contact-rkn6", [1e-4, 1e-8], [1.0, 2.0]), hard_rows("rk4", [1e-2, float("nan")], [1.0, 2.0]),
    ])  # fmt: skip
    hard.loc[hard["solution_error"].isna(), ["status", "message"]] = ["diverged", "left"]
    grid = [1e-3, 1e-2, 1e-1, 1.0]
    strong = pd.DataFrame({
        "method": ["contact-strang"] * 4 + ["contact-rkn6"] * 4, "gamma": 1.0, "damping_per_evaluation": grid * 2,
        "step": 1.0, "error": [1e-6, 1e-4, 1e-2, 1e-1, 1e-9, 1e-7, 1.0, float("inf")], "radius": 1.0,
    })  # fmt: skip
    text = stability_document(empty | {"stability": hard, "strong_damping": strong})
    assert "1e-02 / diverged" in text
    assert any(line.startswith("| contact-rkn6 ") and "0.01" in line for line in text.splitlines())
    assert usable(strong, "contact-rkn6", 1.0) == 1e-2
    assert "nan" not in text


def test_every_method_has_its_own_look():
    import contactbench as cb

    looks = [(figures.style(m)["color"], figures.style(m)["marker"]) for m in cb.METHODS]
    assert len(set(looks)) == len(looks)


@pytest.mark.parametrize(
    ("seconds", "text"), [(2.0, "2 s"), (1.5e-3, "1.5 ms"), (2e-5, "20 µs"), (float("nan"), "—")]
)
def test_durations_are_readable(seconds, text):
    assert duration(seconds) == text


def test_a_readme_without_its_marks_is_refused(tmp_path):
    (tmp_path / "README.md").write_text("nothing")
    with pytest.raises(cb.BadInput, match="once each"):
        into_readme(tmp_path / "README.md", tmp_path)


def test_a_cost_that_is_not_known_is_a_dash():
    row = {"status": "ok", "rate_error": 0.5, "evaluations": 80_000}
    frame = pd.DataFrame([row, row | {"evaluations": None}]).astype({"evaluations": "Int64"})
    assert error_and_cost(frame[:1]) == "5.0e-01 (8e+04)"
    assert error_and_cost(frame[1:]) == "5.0e-01 (—)"


def test_strong_damping_is_left_out_of_a_partial_run_without_strang():
    frame = pd.DataFrame(
        {"method": ["contact-o8"], "gamma": [5.0], "damping_per_evaluation": [1.0], "error": [0.1]}
    )
    assert list(strong_section(frame)) == []
