"""Documents, figures and README agree with the tables, or `contactbench report --check` names each that does not."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from contactbench.cli import main
from contactbench.report.write import README_PART
from contactbench.results.store import merge
from contactbench.results.tables import CONVERGENCE, LAWS_TABLE, WORK_PRECISION

TESTS = Path(__file__).parents[1]


def rows(method, family, order):
    """A method of an order, at three steps."""
    return [
        {
            "scene": "particle", "method": method, "family": family, "engine": "jax", "control": "step",
            "value": h, "step": h, "setting": f"step={h}", "status": "ok", "solution_error": h**order / 10,
            "energy_law": h**order, "contact_drift": 1e-15 if family == "contact" else h**order,
            "evaluations": round(20 / h), "rhs_equivalents": 20 / h, "steps": round(20 / h),
            "time_min_s": 1e-5 / h, "time_median_s": 1e-5 / h, "time_halves_ratio": 1.02, "order": order,
            "last_slope": order, "in_fit": True, "order_nominal": order, "profile": "smoke",
        }
        for h in (0.1, 0.01, 0.001)
    ]  # fmt: skip


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A folder of tables with its documents, and a README beside it."""
    folder = tmp_path_factory.mktemp("project") / "results"
    made = rows("contact-strang", "contact", 2) + rows("rk4", "established", 4)
    for table in (CONVERGENCE, LAWS_TABLE, WORK_PRECISION):
        known = [{name: row[name] for name in row if name in table.every_column} for row in made]
        merge(table, known, folder)
    (folder.parent / "README.md").write_text(f"before\n{README_PART[0]}{README_PART[1]}\nafter\n")
    assert main(["report", "--results", str(folder), "--readme", str(folder.parent / "README.md")]) == 0
    return folder


def checked(results, capsys):
    """Exit status and lines of a check."""
    capsys.readouterr()
    readme = str(results.parent / "README.md")
    status = main(["report", "--check", "--results", str(results), "--readme", readme])
    return status, capsys.readouterr().out.splitlines()


def test_what_was_just_written_agrees(results, capsys):
    assert checked(results, capsys) == (0, ["Documents, figures and tables agree."])


CHANGES = {
    "a number in a document": ("convergence.md", "not what the tables say"),
    "a number on the page": ("report.html", "not what the tables say"),
    "a number in the README": ("../README.md", "not what the tables say"),
    "a figure of other data": ("figures/convergence.svg", "not what the tables say"),
    "a document that no table gives": ("old.md", "no table gives it"),
    "a figure that no table gives": ("figures/old.svg", "no table gives it"),
}


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.quick(
    change=("a number in a document", "a figure of other data", "a document that no table gives")
)
def test_each_file_that_differs_is_named(change, results, capsys):
    name, why = CHANGES[change]
    path = (results / name).resolve()
    before = path.read_bytes() if path.exists() else None
    path.write_bytes((before or b"").replace(b"0", b"1"))
    try:
        assert checked(results, capsys) == (1, [f"{path}: {why}"])
    finally:
        path.unlink() if before is None else path.write_bytes(before)


@pytest.fixture
def vector(results):
    """One of the figures, to be changed; whole again after the test."""
    path = results / "figures" / "convergence.svg"
    before = path.read_text()
    yield path
    path.write_text(before)


def test_points_that_are_moved_are_seen_and_drawn_anew(vector, results, capsys):
    before = vector.read_text()
    points = re.compile(r'(<use xlink:href="#\w+" x="[\d.]+" y=")([\d.]+)')
    vector.write_text(points.sub(lambda found: f"{found[1]}{0.8 * float(found[2]):.6f}", before))
    assert vector.read_text() != before
    assert checked(results, capsys) == (1, [f"{vector}: not what the tables say"])
    assert main(["report", "--results", str(results)]) == 0
    assert vector.read_text() == before


def test_names_dates_and_last_digits_are_no_difference(vector, results, capsys):
    text = re.sub(r"\b([a-z])[0-9a-f]{10}\b", lambda name: name[1] + name[0][:0:-1], vector.read_text())
    text = re.sub(r"(\d+\.\d{6})(?=[\" ])", lambda place: f"{float(place[1]) + 2e-6:.6f}", text)
    text = text.replace("<metadata>", "<metadata><!-- 2026-01-01 -->")
    assert set(text.splitlines()).isdisjoint(
        {line for line in vector.read_text().splitlines() if "<use" in line}
    )
    vector.write_text(text)
    assert checked(results, capsys)[0] == 0


@pytest.mark.parametrize("name", ["laws.md", "figures/convergence.svg"])
def test_a_missing_file_is_named_and_nothing_is_written(name, results, capsys):
    path = results / name
    before = path.read_bytes()
    path.unlink()
    assert checked(results, capsys) == (1, [f"{path}: missing"])
    assert not path.exists()
    path.write_bytes(before)


def test_a_table_that_has_moved_on_leaves_its_documents_behind(results, capsys):
    before = {path: path.read_bytes() for path in results.glob("*.csv")}
    (row, *_) = rows("rk4", "established", 4)
    row = {name: value for name, value in row.items() if name in LAWS_TABLE.every_column}
    merge(LAWS_TABLE, [{**row, "energy_law": 0.5}], results)
    try:
        status, lines = checked(results, capsys)
        assert status == 1
        assert f"{results / 'laws.md'}: not what the tables say" in lines
    finally:
        for path, content in before.items():
            path.write_bytes(content)


def test_no_test_reads_what_the_benchmark_writes():
    """The tables of a clone may be those of any run."""
    folder = 'REPOSITORY / "' + 'results"'
    assert not [path.name for path in TESTS.rglob("*.py") if folder in path.read_text()]
