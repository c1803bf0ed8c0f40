"""The experiments, run for real on a small part, and the report made from their tables alone."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

import contactbench as cb
from cases import REPOSITORY, bench, finished
from contactbench.report import write
from contactbench.results.store import read
from contactbench.results.tables import CONVERGENCE, WORK_PRECISION

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
    needed = "solution_error steps evaluations compile_s first_call_s time_median_s time_halves_ratio rounds"
    assert work[needed.split()].notna().all().all()
    assert work["time_process_ratio"].notna().any()
    assert (work["visits"] >= 8).all()
    assert (work["rounds"] >= work["visits"]).all()
    assert (work["time_min_s"] <= work["time_median_s"]).all()
    assert (work["time_min_s"] > 0).all()
    assert {"contact-strang", "rk4"} == set(read(CONVERGENCE, results)["method"])
    assert (results / "environment.json").exists()


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


# -- the project's README --------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "most"), [("README.md", 150), ("results/README.md", 120)])
def test_a_readme_is_short(name, most):
    assert len((REPOSITORY / name).read_text().splitlines()) <= most


def test_the_computed_part_replaces_what_stands_between_the_marks(tmp_path, results):
    readme = tmp_path / "README.md"
    begin, end = write.README_PART
    readme.write_text(f"before\n{begin}old\n{end}after\n")
    text = write.with_answers(readme, write.tables(results))
    assert text.startswith(f"before\n{begin}")
    assert text.endswith(f"{end}after\n")
    assert "old" not in text
    assert "| Do the methods have the order they claim?" in text
    readme.write_text(text)
    assert write.with_answers(readme, write.tables(results)) == text


def test_a_readme_without_its_marks_is_refused(tmp_path):
    (tmp_path / "README.md").write_text("nothing")
    with pytest.raises(cb.BadInput, match="once each"):
        write.with_answers(tmp_path / "README.md", {})
