"""The experiments, run for real on a small part, and the report made from their tables alone."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys

import pandas as pd
import pytest

import contactbench as cb
from cases import REPOSITORY, bench, finished
from contactbench.gate.compare import compare_folders
from contactbench.report import glossary, markdown, write
from contactbench.report.cells import Cell, Head, Mark, View, number, word
from contactbench.report.drawing import Figure
from contactbench.report.numbers import count, duration, names, power, times
from contactbench.report.rooms import ROOMS, Finding, Section, Text, figures, rooms, slug
from contactbench.results.schema import TABLES
from contactbench.results.store import read
from contactbench.results.tables import CONVERGENCE, WORK_PRECISION
from contactbench.scenes import hard_scenes, standard_scenes
from contactbench.scenes.driven import DRIVEN
from frames import frames, row

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
        "time_iqr_s", "time_halves_ratio", "rounds",
    ]  # fmt: skip
    assert work[needed].notna().all().all()
    assert work["time_process_ratio"].notna().any()
    assert (work["visits"] >= 8).all()
    assert (work["rounds"] >= work["visits"]).all()
    assert (work["time_min_s"] <= work["time_median_s"]).all()
    assert (work["time_min_s"] > 0).all()
    assert {"contact-strang", "rk4"} == set(read(CONVERGENCE, results)["method"])
    assert (results / "environment.json").exists()


@pytest.mark.slow
def test_a_second_partial_run_leaves_the_other_rows_and_the_gate_sees_no_difference(results, tmp_path):
    before = read(WORK_PRECISION, results)
    shutil.copytree(results, tmp_path / "before")
    finished(bench(results, "work_precision and particle and rk4 and not long"))
    after = read(WORK_PRECISION, results)
    assert len(after) == len(before)
    same = after["method"] != "rk4"
    pd.testing.assert_frame_equal(after[same], before[same])
    assert compare_folders(tmp_path / "before", results).moved.empty


REGISTRIES = {"methods": cb.METHODS, "scenes": cb.SCENES}


def test_report_writes_documents_and_figures_from_the_tables(results):
    written = {path.name for path in write.report(results, REGISTRIES)}
    assert {"README.md", "convergence.md", "work_precision.md", "glossary.md", "report.html"} <= written
    text = (results / "README.md").read_text()
    assert "contact-strang" in text
    for path in results.glob("*.md"):
        assert not re.search(r"\bnan\b", path.read_text()), path
    for path in (results / "figures").glob("*.svg"):
        assert "<svg" in path.read_text()
    again = {path: path.read_bytes() for path in (*results.rglob("*.svg"), *results.glob("*.md"))}
    for path in results.rglob("*.svg"):
        path.unlink()  # one that shows the same would not be drawn again
    write.report(results, REGISTRIES)
    assert {path: path.read_bytes() for path in again} == again  # equal tables give equal files


def test_the_report_needs_no_solver():
    """Its modules import neither JAX nor a peer."""
    code = (
        "import sys; import contactbench.report.write; "
        "print(sorted({'jax', 'diffrax', 'sksundae', 'heyoka'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


# -- rooms -----------------------------------------------------------------------------------------
SOME = {
    "work_precision": [
        row("particle", m, e, solution_error=e, time_median_s=1e-3, time_min_s=1e-3, rhs_equivalents=100.0)
        for m in ("contact-a", "rk4") for e in (1e-2, 1e-5)
    ],
    "laws": [row("central", "contact-a", 0.1, solution_error=1e-3, contact_drift=1e-15, momentum_law=1e-15)],
    "convergence": [row("particle", "contact-a", 0.1, solution_error=1e-3, order=2.0, order_nominal=2, step=0.1)],
    "stability": [row("critical", "rk4", 0.1, solution_error=1e-3, rhs_equivalents=10.0)],
    "stability_limits": [{"method": "rk4", "family": "established", "gamma": 0.0, "omega": 1.0, "limit": 2.8,
        "windows": ""}],
    "damping_rates": [
        row("overdamped", "rk4", 0.1, experiment="overdamped", t_end=100.0, damping_per_step=5.0, evaluations=10,
            ratio=1.0, rate_error=1e-3)
    ],
    "ensemble": [
        row("particle", "rk4", 0.1, question="error", solution_error=1e-3, trajectories=10, cores=1, evaluations=10,
            time_median_s=1.0, time_min_s=1.0)
    ],
    "long_time": [
        row("duffing", method, 0.1, quantity="mean H0 at phase 0", reference=method == "rk4", evaluations_per_time=8.0,
            jacobians_per_time=0.0, trajectories=8, periods=4, mean=0.04, error=1e-3)
        for method in ("contact-a", "rk4")
    ],
    "claims": [{"id": "C01", "where": "§2", "claim": "all is well", "verdict": "holds", "status": "ok",
        "measured": 1.0}],
    "definitions": [
        {"scene": "central", "method": "", "declared": "gamma=0.1", "digest": "0123456789abcdef"},
        {"scene": "", "method": "rk4", "declared": "order=4", "digest": "fedcba9876543210"},
    ],
}  # fmt: skip


def parts_in(items):
    for item in items:
        yield item
        if isinstance(item, Section):
            yield from parts_in(item.parts)


@pytest.mark.parametrize("name", ROOMS)
def test_a_room_speaks_from_its_own_table_alone_and_is_silent_without(name):
    assert not ROOMS[name].speaks(frames())
    first = ROOMS[name].tables[0]
    alone = frames(**{first: SOME[first]})
    assert ROOMS[name] in rooms(alone)
    text = markdown.document(ROOMS[name], ROOMS[name].sections(alone), tuple(ROOMS[name].findings(alone)))
    assert text.startswith(f"# {ROOMS[name].title}\n")
    assert not re.search(r"\bnan\b", text)


def test_names_of_views_and_figures_are_unique_but_for_a_figure_shown_twice():
    everything = frames(**SOME)
    found = [part for room in rooms(everything) for part in parts_in(room.sections(everything))]
    views = [part.name for part in found if isinstance(part, View)]
    assert len(views) == len(set(views)), sorted(v for v in views if views.count(v) > 1)
    drawn = {}
    for figure in (part for part in found if isinstance(part, Figure)):
        assert repr(drawn.setdefault(figure.name, figure)) == repr(figure)  # nan is nan


def test_every_table_is_read_by_a_room_and_every_room_reads_tables():
    read_ = {name for room in ROOMS.values() for name in room.tables}
    assert read_ == set(TABLES)


def test_the_headline_lists_the_documents_first_and_says_that_nothing_has_a_unit():
    everything = frames(**SOME)
    text = markdown.document(ROOMS["headline"], ROOMS["headline"].sections(everything))
    lines = [line for line in text.splitlines() if line]
    documents = [room.file for room in rooms(everything) if room.name != "headline"]
    assert len(documents) == 10
    for line, name in zip(lines[1:], documents, strict=False):
        assert f"[{name}]({name})" in line
    assert "dimensionless" in text
    assert text.count("Where the contact methods lose") == 1
    others = (r for r in rooms(everything) if r.name != "headline")
    assert not any(
        "## Where the contact methods lose" in markdown.parts(r.sections(everything)) for r in others
    )


def test_definitions_are_listed_by_kind_each_with_its_digest():
    room = ROOMS["definitions"]
    _, scenes, methods = room.sections(frames(definitions=SOME["definitions"]))
    assert [[cell.text for cell in line] for line in scenes.rows] == [
        ["central", "`0123456789abcdef`", "`gamma=0.1`"]
    ]
    assert [[cell.text for cell in line] for line in methods.rows] == [
        ["rk4", "`fedcba9876543210`", "`order=4`"]
    ]


def test_raw_rows_are_left_to_their_csv():
    rows = [row("central", f"m{i}", 0.1, solution_error=1e-3, contact_drift=1e-4) for i in range(300)]
    text = markdown.document(ROOMS["laws"], ROOMS["laws"].sections(frames(laws=rows)))
    assert "In [laws.csv](laws.csv)" in text
    assert text.count("| m7 ") == 2  # one line for each of the two laws


def test_the_glossary_has_every_method_scene_and_column():
    text = markdown.parts(glossary.sections(REGISTRIES))
    for name in (*cb.METHODS, *cb.SCENES):
        assert re.search(rf"^\| {re.escape(name)} ", text, re.M), name
    for name, steps in (("contact-exact", "exact"), ("contact-adaptive", "adaptive"), ("rk4", "fixed")):
        (line,) = re.findall(rf"^\| {name} .*$", text, re.M)
        assert f"| {steps} " in line
    for table in TABLES.values():
        assert all(f"`{column}`" in text for column in table.columns)


# -- markdown --------------------------------------------------------------------------------------
def test_marks_are_seen_and_a_bar_does_not_break_a_table():
    cells = (
        word("a|b", Mark.best), word("c", Mark.tie), word("d", Mark.exception), word("e", Mark.bound), word("f",
        link="x.md"),
    )  # fmt: skip
    heads = tuple(Head(str(i), words=True) for i in range(5))
    text = markdown.parts([View("v", "Title", "What it means.", heads, (cells,))])
    assert text.splitlines()[-1].split(" | ") == ["| **a\\|b**", "*c*", "d !", "e", "[f](x.md) |"]
    assert text.startswith("## Title\n\nWhat it means.\n\n| 0 ")
    assert "None." in markdown.parts([View("v", "Title", "", heads, ())])


def test_a_wide_table_is_split_at_its_groups():
    heads = (Head("method", words=True), *(Head(f"{k}", group=f"scene {s}") for s in range(5) for k in "abc"))
    rows = (tuple(Cell(str(i)) for i in range(len(heads))),)
    text = markdown.parts([View("v", "Title", "", heads, rows)])
    tables = text.split("\n\n")[1:]
    assert len(tables) == 2
    assert all(t.startswith("| method | scene") for t in tables)
    assert "scene 4: c" in tables[1]


def test_a_view_with_a_row_of_another_length_is_refused():
    with pytest.raises(ValueError, match="do not have 2 cells"):
        View("v", "t", "", (Head("a"), Head("b")), ((Cell("x"),),))


def test_sections_nest_and_findings_name_their_exceptions():
    finding = Finding("f", "Law", "It is kept.", "3 runs", ("not on `x`",))
    room = ROOMS["laws"]
    text = markdown.document(
        room, [Section("One", (Section("Two", (Text("said", ("a", "b")),)),))], [finding]
    )
    assert "- **Law.** It is kept. Exceptions: not on `x`. *(3 runs.)*" in text
    assert text.index("## One") < text.index("### Two") < text.index("said\n\n- a\n- b")


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(2.0, "2 s"), (1.5e-3, "1.5 ms"), (2e-5, "20 µs"), (9.9999e-7, "1 µs"), (float("nan"), "—")],
)
def test_durations_are_readable(seconds, text):
    assert duration(seconds) == text


@pytest.mark.parametrize(
    ("ratio", "text"),
    [(1.254, "×1.25"), (9.994, "×9.99"), (12.6, "×13"), (3123.0, "×3100"), (float("nan"), "—")],
)
def test_ratios_are_readable(ratio, text):
    assert times(ratio) == text


def test_numbers_and_lists_are_readable():
    assert count(1234.0) == "1234"
    assert count(26104.4) == "26\u202f104"
    assert power(1e-12) == "10⁻¹²"
    assert names(["a"]) == "a"
    assert names(["a", "b", "c"]) == "a, b and c"
    assert names(["a", "b", "c"], 2) == "a, b and 1 more"
    assert number(float("inf"), str).text == "∞"
    assert number(float("inf"), str).value > number(1e300, str).value
    assert number(float("nan"), str).text == "—"
    assert slug("C01 · holds, corrected") == "c01--holds-corrected"
    assert list(figures([])) == []


# -- the project's README --------------------------------------------------------------------------
def test_no_measured_number_stands_outside_the_computed_part_of_the_readme():
    text = (REPOSITORY / "README.md").read_text()
    begin, end = write.README_PART
    prose = text.partition(begin)[0] + text.partition(end)[2]
    prose = re.sub(r"```.*?```", "", prose, flags=re.S)
    measured = re.findall(
        r"\d(?:\.\d+)?e-\d+|\d+(?:\.\d+)? ?[µmn]s\b|×\s?\d+(?:\.\d+)?\b|\d+(?:\.\d+)?×", prose
    )
    assert not measured


def test_what_is_compared_is_counted():
    prose = (REPOSITORY / "docs" / "benchmark.md").read_text()
    words = {6: "six", 7: "seven", 9: "nine", 16: "sixteen"}
    assert f"on {words[len(standard_scenes())]} scenes" in prose
    assert f"on {words[len(DRIVEN)]} scenes with time" in prose
    assert f"on {words[len(hard_scenes())]} hard scenes" in prose
    frozen = {path.stem for path in (REPOSITORY / "references").glob("*.csv")}
    assert f"true trajectories of {len(frozen)} of the {len(cb.SCENES)} scenes" in prose
    rest = [cb.SCENES[name] for name in cb.SCENES if name not in frozen]
    assert f"The other {words[len(rest)]} are known in closed form" in prose
    assert all(scene.exact is not None for scene in rest)


def test_the_computed_part_replaces_what_stands_between_the_marks(tmp_path, results):
    readme = tmp_path / "README.md"
    begin, end = write.README_PART
    readme.write_text(f"before\n{begin}old\n{end}after\n")
    write.into_readme(readme, results, write.tables(results))
    text = readme.read_text()
    assert text.startswith(f"before\n{begin}")
    assert text.endswith(f"{end}after\n")
    assert "old" not in text
    assert "dimensionless" in text
    write.into_readme(readme, results, write.tables(results))
    assert readme.read_text() == text


def test_a_readme_without_its_marks_is_refused(tmp_path):
    (tmp_path / "README.md").write_text("nothing")
    with pytest.raises(cb.BadInput, match="once each"):
        write.into_readme(tmp_path / "README.md", tmp_path, {})
