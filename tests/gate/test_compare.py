"""What turns the gate red on two folders of tables made up for it, and what does not."""

import json
import math

import pytest

from contactbench.gate.compare import compare_folders
from contactbench.tables.schema import TABLES, Rule
from contactbench.tables.store import merge
from made_up import CLAIM, ROWS, RUN, folder, row, same, without


@pytest.fixture
def baseline(tmp_path, only_tables):
    only_tables(*ROWS)
    return folder(tmp_path / "baseline")


def judge(baseline, change, path, **more):
    return compare_folders(baseline, folder(path / "fresh", change, **more))


def red(found):
    moved = found.moved[found.moved["red"]]
    return {*zip(moved["table"], moved["method"], moved["measure"], strict=True)}


def change(table, method, where=(), **values):
    """A change of one method's rows in one table, of those that have some values."""

    def changed(which, row):
        mine = (which, row["method"]) == (table, method) and {*where} <= {*row.items()}
        return {**row, **values} if mine else row

    return changed


def all_of(changes):
    def changed(which, row):
        for change in changes:
            row = row and change(which, row)
        return row

    return changed


LAWS, WORK, CLAIMS, ORDERS = "laws", "work_precision", "claims", "convergence"
FIT, NO_FIT = [("in_fit", True)], [("in_fit", False)]


def moved(table, method, where=(), **to):
    """A change of one method's rows in a table, and what is red: the first of its columns."""
    return change(table, method, where, **to), (table, method, next(iter(to)))


FAULTS = {
    "error": moved(LAWS, "rk4", solution_error=2.2e-5),
    "error gone down": moved(LAWS, "rk4", solution_error=4e-6),
    "at fifty digits": moved(ORDERS, "contact-o8", solution_error=1e-19),
    "not a number": moved(LAWS, "rk4", solution_error=math.nan),
    "round-off lost": moved(LAWS, "rk4", momentum_law=3e-12),
    "one gradient more": moved(WORK, "rk4", evaluations=801),
    "one step more of an adaptive solver": moved(WORK, "cvode-adams", steps=201),
    "status": moved(WORK, "rk4", status="diverged", solution_error=math.nan),
    "a refusal that ends well": moved(WORK, "cvode-bdf", status="ok"),
    "verdict of a claim": moved(CLAIMS, "any", verdict="refuted"),
    "what a claim measures": moved(CLAIMS, "any", measured=3e-12),
    "the bound of a claim": moved(CLAIMS, "any", bound=1e-11),
    "what is carried": moved(WORK, "rk4", carried="q p s"),
    "a larger profile": moved(LAWS, "rk4", profile="full"),
    "no profile": moved(LAWS, "rk4", profile=""),
    "slope": moved(ORDERS, "rk4", FIT, pairwise_order=3.8),
    "fitted order": moved(ORDERS, "rk4", NO_FIT, order=3.9),
    "dropped method": (without(method="contact-o8"), (ORDERS, "contact-o8", "row")),
    "dropped setting": (without(table=ORDERS, setting="step=0.8"), (ORDERS, "rk4", "row")),
    "dropped table": (without(table=LAWS), (LAWS, "", "table")),
}
#: faults that do not touch each other are judged together: reading the tables takes all the time
TOGETHER = [
    ("error", "at fifty digits", "one gradient more", "one step more of an adaptive solver", "slope"),
    ("error gone down", "round-off lost", "what is carried", "verdict of a claim", "fitted order"),
    ("not a number", "status", "a refusal that ends well", "the bound of a claim"),
]
TOGETHER += [(name,) for name in FAULTS if not any(name in names for names in TOGETHER)]


@pytest.mark.parametrize("names", TOGETHER, ids=" + ".join)
def test_every_kind_of_regression_is_red_and_named(names, baseline, tmp_path):
    changes, places = zip(*(FAULTS[name] for name in names), strict=True)
    found = judge(baseline, all_of(changes), tmp_path)
    assert red(found) == {*places}
    assert (found.status, json.loads(found.as_json())["red"]) == (1, True)
    cells = [{*map(str.strip, line.split("|")), ""} for line in found.as_markdown().splitlines()]
    assert all(any(set(where) <= line for line in cells) for where in places)


ALLOWED = {
    "error within a factor of two": change(LAWS, "rk4", solution_error=1.9e-5),
    "round-off that stays so": change(LAWS, "rk4", momentum_law=9e-13),
    "slope outside the asymptotic range": change(ORDERS, "rk4", NO_FIT, pairwise_order=0.5),
    "time": change(WORK, "rk4", time_median_s=1.0),
    "message": change(WORK, "cvode-bdf", message="other words"),
    "far below the bound of a claim": change(CLAIMS, "any", measured=9e-16),
    "a smaller profile": change(WORK, "rk4", profile="smoke"),
    "a law that the baseline does not have": change(LAWS, "rk4", sphere_drift=1e-3),
}


def test_what_may_move_is_green(baseline, tmp_path):
    found = judge(baseline, all_of(ALLOWED.values()), tmp_path)
    assert found.moved.empty, found.moved


BLOW_UP = row(status="diverged", blow_up_time=2.0, end_time=2.0)
LIMIT = {"method": "rk4", "gamma": 1.0, "omega": 1.0, "profile": "smoke"}
POINT = {"figure": "f", "panel": "p", "curve": "c", "kind": "method", "profile": "smoke", "point": 0}
LOWER = {**CLAIM, "relation": "≥", "bound": 1.9, "measured": 2.0}
UPPER = {**CLAIM, "relation": "≤", "bound": 0.01, "measured": 2e-3}
CURVE = [{**POINT, "x": 1.0, "y": 1e-9}, {**POINT, "point": 1, "x": 0.0, "y": 1.0}]
ILL = row(end_error=1e-9, condition_number=1e6)
#: rows of a table, what moves in the first of them, how far it may, and what is too far
MOVES = {
    "round-off of an error": ("laws", [row(solution_error=2e-16)], "solution_error", 2e-14, 1e-13),
    "of an ill-conditioned motion": ("stability", [ILL], "end_error", 2e-8, 1e-7),
    "a limit": ("stability_limits", [{**LIMIT, "limit": 2.0}], "limit", 2.01, 2.03),
    "no limit": ("stability_limits", [{**LIMIT, "limit": math.inf}], "limit", math.inf, 2.0),
    "a point of a curve": ("paper_figures", CURVE, "y", 9e-3, 2e-2),
    "round-off on a curve": ("paper_figures", [{**POINT, "x": 0.0, "y": 2e-16}], "y", 3e-13, 2e-12),
    "energy along time": ("motion", [row(t=1.0, energy=0.5)], "energy", 0.504, 0.51),
    "the time of the blow-up": ("stability", [BLOW_UP], "blow_up_time", 2.01, 2.03),
    "how far a run got": ("stability", [BLOW_UP], "end_time", 2.1, 2.3),
    "how far a run got that ended well": ("stability", [row(end_time=2.0)], "end_time", 2.0, 2.001),
    "a lower bound": ("claims", [LOWER], "measured", 2.01, 2.03),
    "an upper bound": ("claims", [UPPER], "measured", 3.8e-3, 5e-3),
}


@pytest.mark.parametrize("case", MOVES)
def test_a_value_moves_within_its_limits_only(case, tmp_path, only_tables):
    name, rows, column, little, much = MOVES[case]
    table = TABLES[name]
    only_tables(name)

    def tables(path, value):
        path.mkdir()
        moved = [{**rows[0], column: value}, *rows[1:]]
        merge(table, [{k: v for k, v in r.items() if k in table.every_column} for r in moved], path)
        (path / "environment.json").write_text(json.dumps({"runs": [RUN]}))
        return path

    before = tables(tmp_path / "before", rows[0][column])
    assert compare_folders(before, tables(tmp_path / "little", little)).moved.empty
    moved = red(compare_folders(before, tables(tmp_path / "much", much)))
    assert {measure for *_, measure in moved} == {column}


def test_of_a_larger_run_the_larger_profiles_rows_are_expected(baseline, tmp_path):
    small = {"keep": lambda row: row["profile"] == "smoke"}
    assert judge(baseline, same, tmp_path, **small).moved.empty
    large = judge(baseline, same, tmp_path / "again", **small, run={**RUN, "profile": "standard"})
    assert large.moved[["table", "setting", "result"]].values.tolist() == [[WORK, "step=0.01", "missing"]]


@pytest.mark.parametrize(
    ("method", "steps", "run", "is_red"),
    [
        ("cvode-adams", 219, {"isa": "y"}, False),
        ("cvode-adams", 221, {"isa": "y"}, True),
        ("rk4", 201, {"isa": "y"}, True),
        ("cvode-adams", 219, {"isa": ""}, False),  # nobody knows its processor
        ("cvode-adams", 201, {"packages": {"jax": "1", "pandas": "2"}}, True),  # which solves nothing
        ("cvode-adams", 201, {"packages": {"jax": "2"}}, False),
    ],
)
def test_counts_of_adaptive_solvers_may_move_elsewhere(method, steps, run, is_red, baseline, tmp_path):
    """By a tenth on another machine."""
    found = judge(baseline, change(WORK, method, steps=steps), tmp_path, run={**RUN, **run})
    assert bool(found.red) is is_red


@pytest.mark.parametrize(
    ("evaluations", "is_red"), [(2166, False), (2290, False), (2292, True), (2070, True)]
)
def test_counts_of_iterations_may_move_elsewhere(evaluations, is_red, tmp_path, only_tables):
    """By a twentieth on another machine, where rounding decides how often a step iterates; not at all on the same."""
    only_tables(*ROWS)

    def iterates(evaluations):
        own = {"method": "contact-gauss4", "evaluations": evaluations}
        return lambda which, row: row | own if (which, row["method"]) == (WORK, "rk4") else row

    before, now = folder(tmp_path / "before", iterates(2182)), iterates(evaluations)
    assert bool(judge(before, now, tmp_path, run={**RUN, "isa": "y"}).red) is is_red
    assert red(judge(before, now, tmp_path / "here")) == {
        (WORK, "contact-gauss4", "evaluations")
    }  # exact here


@pytest.mark.parametrize(("spread", "is_red"), [(0.0, True), (0.04, True), (0.6, False)])
def test_counts_may_move_by_what_roundings_were_measured_to_do_to_them(spread, is_red, tmp_path, only_tables):
    only_tables(*ROWS)
    before = folder(tmp_path / "before", change(WORK, "cvode-adams", evaluations_spread=spread))
    now = change(WORK, "cvode-adams", evaluations_spread=spread, evaluations=1200)
    assert bool(judge(before, now, tmp_path, run={**RUN, "isa": "y"}).red) is is_red
    assert judge(before, now, tmp_path / "here").red  # where there are no other roundings


def test_a_column_that_is_lost_is_red(baseline, tmp_path):
    had = folder(tmp_path / "had", change(LAWS, "rk4", sphere_drift=1e-3))
    assert red(compare_folders(had, baseline)) == {(LAWS, "rk4", "sphere_drift")}


def test_new_rows_are_not_judged(baseline, tmp_path):
    fresh = folder(tmp_path / "fresh")
    merge(TABLES[LAWS], [row("mine", solution_error=1.0)], fresh)
    found = compare_folders(baseline, fresh)
    assert found.moved.empty
    assert "1 have no baseline yet" in found.compared[0]


@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
def test_every_column_has_a_rule_or_says_why_none(table):
    for name, column in table.every_column.items():
        judged = name not in table.key and not column.timed
        assert (column.rule is None) == bool(column.ungated) or not judged, name
        assert (column.rule is Rule.time) <= column.timed <= (column.rule in (None, Rule.time)), name
    assert {name for name in table.columns if name.endswith("_s")} <= set(table.timed)
