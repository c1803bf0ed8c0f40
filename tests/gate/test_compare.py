"""What turns the gate red on two folders of tables made up for it, and what does not."""

import json
import math

import pytest

from contactbench.errors import BadInput
from contactbench.gate.compare import compare_folders
from contactbench.tables.schema import TABLES
from contactbench.tables.store import merge
from made_up import ROWS, RUN, folder, row, same, without


@pytest.fixture(scope="module")
def baseline(tmp_path_factory):
    return folder(tmp_path_factory.mktemp("gate") / "baseline")


@pytest.fixture
def judge(baseline, tmp_path):
    """Compare a folder of changed rows with the baseline."""

    def judge(change=same, before=baseline, **more):
        fresh = tmp_path / f"fresh{len([*tmp_path.iterdir()])}"
        return compare_folders(before, folder(fresh, change, **more))

    return judge


def red(found):
    moved = found.moved[found.moved["red"]]
    return {*zip(moved["table"], moved["method"], moved["measure"], strict=True)}


def change(table, method, where=(), **values):
    """A change of one method's rows in one table, of those that have some values."""

    def changed(which, row):
        mine = (which, row.get("method", "")) == (table, method) and {*where} <= {*row.items()}
        return {**row, **values} if mine else row

    return changed


def all_of(changes):
    def changed(which, row):
        for change in changes:
            row = row and change(which, row)
        return row

    return changed


ALL, END, FIT = [("saved", 25)], [("saved", 1)], [("in_fit", True)]


def moved(table, method, where=(), **to):
    """A change of one method's rows in a table, and what is red: the first of its columns."""
    return change(table, method, where, **to), (table, method, next(iter(to)))


FAULTS = {
    "error": moved("runs", "rk4", ALL, error=2.2e-5),
    "error gone down": moved("runs", "rk4", ALL, error=4e-6),
    "at fifty digits": moved("orders", "contact-o8", error=1e-19),
    "not a number": moved("runs", "rk4", ALL, error=math.nan),
    "round-off lost": moved("runs", "rk4", ALL, momentum_law=3e-12),
    "what is claimed": moved("runs", "rk4", ALL, momentum_law_claimed=False),
    "one gradient more": moved("runs", "rk4", END, evaluations=801.0),
    "one step more of an adaptive solver": moved("runs", "cvode-adams", END, steps=201),
    "status": moved("runs", "rk4", END, status="diverged", error=math.nan),
    "a refusal that ends well": moved("runs", "cvode-bdf", status="ok"),
    "how the truth ends": moved("runs", "rk4", END, truth="diverged"),
    "a larger profile": moved("runs", "rk4", ALL, profile="full"),
    "no profile": moved("runs", "rk4", ALL, profile=""),
    "fitted order": moved("orders", "rk4", FIT, order=3.9),
    "verdict of a claim": moved("claims", "", verdict="refuted"),
    "what a claim measures": moved("claims", "", measured=3e-12),
    "the bound of a claim": moved("claims", "", bound=1e-11),
    "dropped method": (without(method="contact-o8"), ("orders", "contact-o8", "row")),
    "dropped setting": (without(table="orders", step=0.8), ("orders", "rk4", "row")),
    "dropped table": (without(table="orders"), ("orders", "", "table")),
}


@pytest.mark.parametrize("name", FAULTS)
def test_every_kind_of_regression_is_red_and_named(name, baseline, tmp_path, only_tables):
    change, where = FAULTS[name]
    fresh = folder(tmp_path, change)
    only_tables(where[0])  # to read the others takes most of the time
    found = compare_folders(baseline, fresh)
    assert red(found) == {where}
    assert (found.status, json.loads(found.as_json())["red"]) == (1, True)
    cells = [{*map(str.strip, line.split("|")), ""} for line in found.as_markdown().splitlines()]
    assert any(set(where) <= line for line in cells)


ALLOWED = {
    "error within a factor of two": change("runs", "rk4", ALL, error=1.9e-5),
    "round-off that stays so": change("runs", "rk4", ALL, momentum_law=9e-13),
    "time": change("times", "rk4", least_s=1.0),
    "message": change("runs", "cvode-bdf", message="other words"),
    "far below the bound of a claim": change("claims", "", measured=9e-16),
    "a smaller profile": change("runs", "rk4", [("profile", "standard")], profile="smoke"),
    "a law that the baseline does not have": change("runs", "rk4", ALL, sphere_drift=1e-3),
    "a run without a clock": without(table="times"),
}


def test_what_may_move_is_green(judge):
    found = judge(all_of(ALLOWED.values()))
    assert found.moved.empty, found.moved


CLAIM, LIMIT = (
    ROWS["claims"][0],
    {"question": "stability", "scene": "oscillator", "method": "rk4", "gamma": 0.0},
)
LOWER, UPPER = CLAIM | {"relation": "≥", "bound": 1.9}, CLAIM | {"bound": 0.01}
POINT = {"figure": "f", "panel": "p", "curve": "c", "kind": "method", "point": 0}
CURVE = [{**POINT, "x": 1.0, "y": 1e-9}, {**POINT, "point": 1, "x": 0.0, "y": 1.0}]
BLOW_UP = row(status="diverged", end_time=2.0)
CORRECTED = LOWER | {"corrected_relation": "≤", "corrected_bound": 0.01, "corrected_measured": 2e-3}
#: rows of a table, what moves in the first of them from where, how far it may, and what is too far
MOVES = {
    "round-off of an error": ("runs", [row(error=2e-16)], "error", 2e-14, 1e-13),
    "of an ill-conditioned motion": ("runs", [row(error=1e-9, condition=1e6)], "error", 2e-8, 1e-7),
    "a limit": ("limits", [LIMIT | {"measured": 2.0}], "measured", 2.01, 2.03),
    "no limit": ("limits", [LIMIT | {"measured": math.inf}], "measured", math.inf, 2.0),
    "a point of a curve": ("motion", CURVE, "y", 9e-3, 2e-2),
    "round-off on a curve": ("motion", [{**POINT, "x": 0.0, "y": 2e-16}], "y", 3e-13, 2e-12),
    "how far a run got": ("runs", [BLOW_UP], "end_time", 2.1, 2.3),
    "how far a run got that ended well": ("runs", [row(end_time=2.0)], "end_time", 2.0, 2.001),
    "a lower bound": ("claims", [LOWER | {"measured": 2.0}], "measured", 2.01, 2.03),
    "an upper bound": ("claims", [UPPER | {"measured": 2e-3}], "measured", 3.8e-3, 5e-3),
    "a corrected bound": ("claims", [CORRECTED], "corrected_measured", 3.8e-3, 5e-3),
}


def tables(path, **rows):
    """A folder of these rows alone."""
    for name, each in rows.items():
        merge(TABLES[name], each, path)
    (path / "environment.json").write_text(
        json.dumps({"runs": [RUN | {"tables": dict.fromkeys(rows, "whole")}]})
    )
    return path


@pytest.mark.parametrize("case", MOVES)
def test_a_value_moves_within_its_limits_only(case, tmp_path, only_tables):
    name, rows, column, little, much = MOVES[case]
    only_tables(name)
    before = tables(tmp_path / "before", **{name: rows})
    little, much = (
        tables(tmp_path / str(value), **{name: [{**rows[0], column: value}, *rows[1:]]})
        for value in (little, much)
    )
    assert compare_folders(before, little).moved.empty
    assert {measure for *_, measure in red(compare_folders(before, much))} == {column}


@pytest.mark.parametrize(
    ("made", "fresh", "missing"),
    [
        ("smoke", "smoke", {"orders"}),
        ("smoke", "standard", {"orders", "runs"}),
        ("standard", "smoke", set()),  # only the rows of `runs` say by which profile they are made
        ("standard", "standard", {"orders", "runs"}),
    ],
)
def test_a_run_has_to_make_the_rows_of_its_profile(made, fresh, missing, judge, tmp_path):
    before = folder(tmp_path / "before", run={**RUN, "profile": made})
    gone = all_of([without(profile="standard"), without(table="orders", step=0.8)])
    found = judge(gone, before, run={**RUN, "profile": fresh})
    assert ({*found.moved["table"]}, {*found.moved["result"]}) == (missing, {"missing"} if missing else set())


ADAPTIVE, GAUSS = ("cvode-adams", "rtol=1e-06"), ("contact-gauss4", "step=0.1")


@pytest.mark.parametrize(
    ("which", "steps", "run", "is_red"),
    [
        (ADAPTIVE, 219, {"isa": "y"}, False),
        (ADAPTIVE, 221, {"isa": "y"}, True),
        (ADAPTIVE, 219, {"isa": ""}, False),  # nobody knows its processor
        (ADAPTIVE, 201, {"packages": {"jax": "1", "pandas": "2"}}, True),  # which solves nothing
        (ADAPTIVE, 201, {"packages": {"jax": "2"}}, False),
        (("rk4", "step=0.1"), 201, {"isa": "y"}, True),
        (("contact-strang", "rtol=1e-06"), 219, {"isa": "y"}, False),  # its pilots choose
        (GAUSS, 209, {"isa": "y"}, False),  # how often it iterates
        (GAUSS, 212, {"isa": "y"}, True),
        (GAUSS, 201, {}, True),
    ],
)
def test_counts_may_move_elsewhere_where_rounding_decides_them(
    which, steps, run, is_red, tmp_path, only_tables
):
    """By a tenth on another machine, of iterations by a twentieth."""
    only_tables("runs")
    before, after = (tables(tmp_path / str(n), runs=[row(*which, steps=n)]) for n in (200, steps))
    made = {**RUN, **run, "tables": {"runs": "whole"}}
    (after / "environment.json").write_text(json.dumps({"runs": [made]}))
    assert bool(compare_folders(before, after).red) is is_red


def test_counts_of_limits_may_move_elsewhere_by_what_the_method_is(tmp_path):
    def limits(more):
        return [LIMIT | {"method": name, "evaluations": 100.0 + more} for name in ("rk4", "cvode-adams")]

    before, after = (tables(tmp_path / str(more), limits=limits(more)) for more in (0, 5))
    assert len(red(compare_folders(before, after))) == 2
    (after / "environment.json").write_text(json.dumps({"runs": [{**RUN, "isa": "y"}]}))
    assert red(compare_folders(before, after)) == {("limits", "rk4", "evaluations")}


def test_a_column_that_is_lost_is_red_and_new_rows_are_not_judged(baseline, tmp_path):
    had = folder(tmp_path / "had", change("runs", "rk4", ALL, sphere_drift=1e-3))
    merge(TABLES["runs"], [row("mine", error=1.0)], had)
    assert {("runs", "rk4", "sphere_drift"), ("runs", "mine", "row")} == red(compare_folders(had, baseline))
    found = compare_folders(baseline, had)
    assert found.moved.empty
    assert "1 have no baseline yet" in found.notes[0]


def test_a_table_of_another_layout_is_not_compared(judge, tmp_path):
    before = folder(tmp_path / "older")
    orders = before / "orders.csv"
    orders.write_text(orders.read_text().replace("step,", "steps,"))
    assert judge(before=before).moved.empty
    assert red(judge(change("runs", "rk4", ALL, error=1.0), before)) == {("runs", "rk4", "error")}


def test_nothing_to_compare_is_an_error(judge, tmp_path):
    with pytest.raises(BadInput, match="no row that a run"):
        judge(before=tables(tmp_path, runs=[row("another", profile="full")]))


@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
def test_every_column_has_a_rule_or_says_why_none(table):
    for name, column in table.columns.items():
        judged = name not in table.key and not column.timed
        assert (column.rule is None) == bool(column.ungated) or not judged, name
        assert column.rule is None or not column.timed, name
