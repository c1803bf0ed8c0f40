"""Documents, figures and README agree with the tables, or `contactbench report --check` names each that does not."""

import re
import shutil

import pytest

from cases import REPOSITORY
from contactbench.cli import main
from contactbench.gate import trees
from contactbench.questions.write import README_PART
from contactbench.tables.declared import ORDERS, RUNS
from contactbench.tables.store import merge
from frames import row


def rows(method, order):
    """A method of an order, at three steps: what runs.csv and orders.csv have of it."""
    for h in (0.1, 0.01, 0.001):
        error = {"error": h**order / 10, "status": "ok"}
        laws = {"energy_law": h**order, "contact_drift": h**order, "evaluations": round(20 / h)}
        yield row("particle", method, h, profile="smoke", **error | laws)
        fit = {"order": order, "in_fit": True, "order_nominal": order}
        yield {"scene": "particle", "method": method, "engine": "llvm", "step": h} | error | fit


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A folder of tables with its documents, and a README beside it."""
    folder = tmp_path_factory.mktemp("project") / "results"
    made = [*rows("contact-strang", 2), *rows("rk4", 4)]
    merge(RUNS, made[::2], folder)
    merge(ORDERS, made[1::2], folder)
    (folder.parent / "README.md").write_text(f"before\n{README_PART[0]}outdated{README_PART[1]}\nafter\n")
    assert main(["report", "--results", str(folder), "--readme", str(folder.parent / "README.md")]) == 0
    return folder


@pytest.fixture
def results(whole, tmp_path):
    return shutil.copytree(whole.parent, tmp_path / "project") / "results"


def checked(results, capsys):
    """Exit status and lines of a check."""
    capsys.readouterr()
    status = main(["report", "--check", "--results", str(results)])
    return status, capsys.readouterr().out.splitlines()


def test_what_was_just_written_stands_in_the_readme(whole):
    text = (whole.parent / "README.md").read_text()
    assert (text[:7], text[-6:], "outdated" in text) == ("before\n", "after\n", False)
    assert "- Do the methods have the order they claim?" in text


def test_documents_point_to_what_is_there_alone(results, capsys):
    written = {path.name: path.read_text() for path in results.glob("*.md")}
    assert not [name for name, text in written.items() if "../docs/" in text]
    (results.parent / "docs").mkdir()
    (results.parent / "docs" / "reading.md").touch()
    status, lines = checked(results, capsys)
    assert (status, any("laws.md" in line for line in lines)) == (1, True)  # which has links then


def test_the_gate_sees_a_number_of_the_readme_that_the_tables_do_not_give(results):
    root = results.parent
    (root / "src").symlink_to(REPOSITORY / "src")
    text = (root / "README.md").read_text()
    assert "2 of 2" in text
    (root / "README.md").write_text(text.replace("2 of 2", "3 of 2"))
    (found,) = trees.check_report(root, results)
    assert "README.md: not what the tables say" in found["after"]


HARM = {
    "not what the tables say": lambda path: path.write_bytes(path.read_bytes().replace(b"0", b"1")),
    "no table gives it": lambda path: path.write_text(""),
    "missing": lambda path: path.unlink(),
}
FILES = (("laws.md", "../README.md"), ("old.md", "figures/old.svg"), ("cost.md", "figures/orders.svg"))


def test_each_file_that_differs_is_named_and_nothing_is_written(results, capsys):
    harmed = [
        ((results / name).resolve(), says) for says, names in zip(HARM, FILES, strict=True) for name in names
    ]
    for path, says in harmed:
        HARM[says](path)
    status, lines = checked(results, capsys)
    assert (status, sorted(lines)) == (1, sorted(f"{path}: {says}" for path, says in harmed))
    assert all(path.exists() == (says != "missing") for path, says in harmed)


def test_points_that_are_moved_are_seen_and_drawn_anew(results, capsys):
    figure = results / "figures" / "orders.svg"
    before = figure.read_text()
    points = re.compile(r'(<use xlink:href="#\w+" x="[\d.]+" y=")([\d.]+)')
    figure.write_text(points.sub(lambda found: f"{found[1]}{0.8 * float(found[2]):.6f}", before))
    assert figure.read_text() != before
    assert checked(results, capsys) == (1, [f"{figure}: not what the tables say"])
    assert main(["report", "--results", str(results)]) == 0
    assert figure.read_text() == before


def test_names_dates_and_last_digits_are_no_difference(results, capsys):
    figure = results / "figures" / "orders.svg"
    before = figure.read_text()
    text = re.sub(r"\b([a-z])[0-9a-f]{10}\b", lambda name: name[1] + name[0][:0:-1], before)
    text = re.sub(r"(\d+\.\d{6})(?=[\" ])", lambda place: f"{float(place[1]) + 2e-6:.6f}", text)
    figure.write_text(text.replace("<metadata>", "<metadata><!-- 2026-01-01 -->"))
    assert figure.read_text() != before
    assert checked(results, capsys)[0] == 0
