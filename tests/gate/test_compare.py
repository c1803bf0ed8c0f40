"""What turns the gate red on two folders of tables made up for it, and what does not."""

from __future__ import annotations

import json
import math

import pytest

import contactbench as cb
from contactbench.gate.compare import compare_folders
from contactbench.results.schema import TABLES, Rule
from contactbench.results.store import merge
from made_up import CLAIM, RUN, folder, row, setting


@pytest.fixture
def baseline(tmp_path):
    return folder(tmp_path / "baseline")


def same(which, row):
    return row


def judge(baseline, change, path, **more):
    return compare_folders(baseline, folder(path / "fresh", change, **more))


def red(found):
    moved = found.moved[found.moved["red"]]
    return {*zip(moved["table"], moved["method"], moved["measure"], strict=True)}


def in_fit(inside, **values):
    """A change of the rows of rk4 inside or outside the asymptotic range."""
    return lambda t, r: (
        {**r, **values} if (t, r["method"], r.get("in_fit")) == ("convergence", "rk4", inside) else r
    )


def without(**values):
    """A change that leaves rows out."""
    return lambda t, r: None if values.items() <= {"table": t, **r}.items() else r


def test_identical_tables_are_green(baseline, tmp_path):
    found = judge(baseline, same, tmp_path)
    assert found.status == 0
    assert found.moved.empty
    assert "9 rows of a smoke run" in found.as_markdown()  # the standard row is not expected


LAWS, WORK, CLAIMS, ORDERS = "laws", "work_precision", "claims", "convergence"
FAULTS = {
    "error": (setting(LAWS, "rk4", solution_error=2.2e-5), (LAWS, "rk4", "solution_error")),
    "error gone down": (setting(LAWS, "rk4", solution_error=4e-6), (LAWS, "rk4", "solution_error")),
    "at fifty digits": (
        setting(ORDERS, "contact-o8", solution_error=1e-19),
        (ORDERS, "contact-o8", "solution_error"),
    ),
    "not a number": (setting(LAWS, "rk4", solution_error=math.nan), (LAWS, "rk4", "solution_error")),
    "round-off lost": (setting(LAWS, "rk4", momentum_law=3e-12), (LAWS, "rk4", "momentum_law")),
    "slope": (in_fit(True, pairwise_order=3.8), (ORDERS, "rk4", "pairwise_order")),
    "fitted order": (in_fit(False, order=3.9), (ORDERS, "rk4", "order")),
    "one gradient more": (setting(WORK, "rk4", evaluations=801), (WORK, "rk4", "evaluations")),
    "one step more of an adaptive solver": (
        setting(WORK, "cvode-adams", steps=201),
        (WORK, "cvode-adams", "steps"),
    ),
    "status": (setting(WORK, "rk4", status="diverged", solution_error=math.nan), (WORK, "rk4", "status")),
    "a refusal that ends well": (setting(WORK, "cvode-bdf", status="ok"), (WORK, "cvode-bdf", "status")),
    "verdict of a claim": (setting(CLAIMS, "any", verdict="refuted"), (CLAIMS, "any", "verdict")),
    "what a claim measures": (setting(CLAIMS, "any", measured=3e-12), (CLAIMS, "any", "measured")),
    "the bound of a claim": (setting(CLAIMS, "any", bound=1e-11), (CLAIMS, "any", "bound")),
    "what is carried": (setting(WORK, "rk4", carried="q p s"), (WORK, "rk4", "carried")),
    "a larger profile": (setting(LAWS, "rk4", profile="full"), (LAWS, "rk4", "profile")),
    "no profile": (setting(LAWS, "rk4", profile=""), (LAWS, "rk4", "profile")),
    "dropped method": (without(method="contact-o8"), (ORDERS, "contact-o8", "row")),
    "dropped setting": (without(table=ORDERS, setting="step=0.8"), (ORDERS, "rk4", "row")),
    "dropped table": (without(table=LAWS), (LAWS, "", "table")),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_every_kind_of_regression_is_red_and_named(fault, baseline, tmp_path):
    change, where = FAULTS[fault]
    found = judge(baseline, change, tmp_path)
    assert red(found) == {where}
    assert (found.status, json.loads(found.as_json())["red"]) == (1, True)
    assert any(
        set(where) <= {*map(str.strip, line.split("|")), ""} for line in found.as_markdown().splitlines()
    )


ALLOWED = {
    "error within a factor of two": setting(LAWS, "rk4", solution_error=1.9e-5),
    "round-off that stays so": setting(LAWS, "rk4", momentum_law=9e-13),
    "slope outside the asymptotic range": in_fit(False, pairwise_order=0.5),
    "time": setting(WORK, "rk4", time_median_s=1.0),
    "message": setting(WORK, "cvode-bdf", message="other words"),
    "far below the bound of a claim": setting(CLAIMS, "any", measured=9e-16),
    "a smaller profile": setting(WORK, "rk4", profile="smoke"),
    "a law that the baseline does not have": setting(LAWS, "rk4", momentum_balance=1e-3),
}


@pytest.mark.parametrize("change", ALLOWED.values(), ids=ALLOWED)
def test_what_may_move_is_green(change, baseline, tmp_path):
    assert judge(baseline, change, tmp_path).moved.empty


BLOW_UP = row(status="diverged", blow_up_time=2.0, end_time=2.0)
LIMIT = {"method": "rk4", "gamma": 1.0, "omega": 1.0, "profile": "smoke"}
POINT = {"figure": "f", "panel": "p", "curve": "c", "kind": "method", "profile": "smoke", "point": 0}
MEMBERS = row(question="error", trajectories=8, cores=1, member_deviation=1e-15)
#: rows of a table, what moves in the first of them, how far it may, and what is too far
MOVES = {
    "round-off of an error": ("laws", [row(solution_error=2e-16)], "solution_error", 2e-14, 1e-13),
    "of an ill-conditioned motion": (
        "stability",
        [row(end_error=1e-9, condition_number=1e6)],
        "end_error",
        2e-8,
        1e-7,
    ),
    "a limit": ("stability_limits", [{**LIMIT, "limit": 2.0}], "limit", 2.01, 2.03),
    "no limit": ("stability_limits", [{**LIMIT, "limit": math.inf}], "limit", math.inf, 2.0),
    "a point of a curve": (
        "paper_figures",
        [{**POINT, "x": 1.0, "y": 1e-9}, {**POINT, "point": 1, "x": 0.0, "y": 1.0}],
        *("y", 9e-3, 2e-2),
    ),
    "round-off on a curve": ("paper_figures", [{**POINT, "x": 0.0, "y": 2e-16}], "y", 3e-13, 2e-12),
    "energy along time": ("laws_time", [row(t=1.0, energy=0.5)], "energy", 0.504, 0.51),
    "the time of the blow-up": ("stability", [BLOW_UP], "blow_up_time", 2.01, 2.03),
    "how far a run got": ("stability", [BLOW_UP], "end_time", 2.1, 2.3),
    "how far a run got that ended well": ("stability", [row(end_time=2.0)], "end_time", 2.0, 2.001),
    "members of an ensemble": ("ensemble", [MEMBERS], "member_deviation", 5e-13, 3e-12),
    "a lower bound": (
        "claims",
        [{**CLAIM, "relation": "≥", "bound": 1.9, "measured": 2.0}],
        "measured",
        2.01,
        2.03,
    ),
    "an upper bound": (
        "claims",
        [{**CLAIM, "relation": "≤", "bound": 0.01, "measured": 2e-3}],
        "measured",
        3.8e-3,
        5e-3,
    ),
}


@pytest.mark.parametrize("case", MOVES)
def test_a_value_moves_within_its_limits_only(case, tmp_path):
    name, rows, column, little, much = MOVES[case]

    def tables(path, value):
        path.mkdir()
        first = {**rows[0], column: value}
        table = TABLES[name]
        merge(
            table,
            [{k: v for k, v in each.items() if k in table.every_column} for each in (first, *rows[1:])],
            path,
        )
        (path / "environment.json").write_text(json.dumps({"runs": [RUN]}))
        return path

    before = tables(tmp_path / "before", rows[0][column])
    assert compare_folders(before, tables(tmp_path / "little", little)).moved.empty
    assert {measure for *_, measure in red(compare_folders(before, tables(tmp_path / "much", much)))} == {
        column
    }


def test_of_a_larger_run_the_larger_profiles_rows_are_expected(baseline, tmp_path):
    small = {"keep": lambda row: row["profile"] == "smoke"}
    assert not judge(baseline, same, tmp_path, **small).red
    large = judge(baseline, same, tmp_path / "again", **small, run={**RUN, "profile": "standard"})
    assert large.moved[["table", "setting", "result"]].values.tolist() == [[WORK, "step=0.01", "missing"]]


def test_the_worst_row_stands_for_a_measure(baseline, tmp_path):
    def change(which, row):
        grown = (
            {**row, "solution_error": row["solution_error"] * (30 if row.get("in_fit") else 3)}
            if (which == ORDERS and row["method"] == "rk4")
            else row
        )
        return grown

    (line,) = judge(baseline, change, tmp_path).moved.to_dict("records")
    assert (line["setting"], line["before"], line["after"], line["rows"]) == (
        "step=0.1",
        "1e-05",
        "0.0003",
        2,
    )


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
def test_counts_of_adaptive_solvers_may_move_by_a_tenth_on_another_machine(
    method, steps, run, is_red, baseline, tmp_path
):
    found = judge(baseline, setting(WORK, method, steps=steps), tmp_path, run={**RUN, **run})
    assert bool(found.red) is is_red


@pytest.mark.parametrize(("spread", "is_red"), [(0.0, True), (0.04, True), (0.6, False)])
def test_counts_may_move_by_what_roundings_were_measured_to_do_to_them(spread, is_red, tmp_path):
    before = folder(tmp_path / "before", setting(WORK, "cvode-adams", evaluations_spread=spread))
    now = setting(WORK, "cvode-adams", evaluations_spread=spread, evaluations=1200)
    assert bool(judge(before, now, tmp_path, run={**RUN, "isa": "y"}).red) is is_red
    assert judge(before, now, tmp_path / "here").red  # where there are no other roundings


def test_a_column_that_is_lost_is_red(baseline, tmp_path):
    had = folder(tmp_path / "had", setting(LAWS, "rk4", momentum_balance=1e-3))
    assert red(compare_folders(had, baseline)) == {(LAWS, "rk4", "momentum_balance")}


def test_new_rows_are_not_judged(baseline, tmp_path):
    fresh = folder(tmp_path / "fresh")
    merge(TABLES[LAWS], [row("mine", solution_error=1.0)], fresh)
    found = compare_folders(baseline, fresh)
    assert found.moved.empty
    assert "1 have no baseline yet" in found.compared[0]


@pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
def test_every_column_has_a_rule_or_says_why_none(table):
    judged = {
        name: column
        for name, column in table.every_column.items()
        if name not in table.key and not column.timed
    }
    assert [name for name, column in judged.items() if (column.rule is None) != bool(column.ungated)] == []
    assert not {name for name, column in table.columns.items() if column.timed and column.rule}
    assert {name for name in table.columns if name.endswith("_s")} <= set(table.timed)


def test_the_rules_are_those_of_the_laws():
    rules = TABLES[LAWS].rules
    assert {name: rules[name] for name in cb.LAWS} == {
        name: Rule[law.gate.value] for name, law in cb.LAWS.items()
    }
