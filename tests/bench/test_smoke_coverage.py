"""What the smoke profile does not meet is named: a column, a scene, a method on an engine."""

from __future__ import annotations

import pandas as pd
import pytest

from contactbench.results.tables import WORK_PRECISION
from smoke_coverage import missing

ROWS = pd.DataFrame(
    {
        "profile": ["smoke", "smoke", "standard"],
        "scene": ["particle", "central", "central"],
        "method": ["rk4", "contact-rkn6", "rk4"],
        "engine": ["numba", "numba", "numba"],
        "message": ["a word", "", ""],
        "fixed_s": [1.0, None, 2.0],
    }
)


def test_nothing_is_missing_where_smoke_meets_everything():
    assert missing(WORK_PRECISION, ROWS) == set()


@pytest.mark.parametrize(
    ("column", "values", "lost"),
    [
        ("message", ["", "", "a word"], "message"),
        ("fixed_s", [None, None, 2.0], "fixed_s"),
        ("scene", ["particle", "central", "rigid_body"], "rigid_body"),
        ("engine", ["numba", "numba", "python"], "rk4 on python"),
        ("method", ["rk4", "contact-rkn6", "heyoka-taylor"], "heyoka-taylor on numba"),
    ],
)
def test_what_only_a_larger_profile_has_is_named(column, values, lost):
    assert missing(WORK_PRECISION, ROWS.assign(**{column: values})) == {(WORK_PRECISION.name, lost)}


@pytest.mark.parametrize(("method", "lost"), [("rk4", set()), ("diffrax-tsit5", {"diffrax-tsit5 on jax"})])
def test_the_engine_that_cross_checks_need_not_meet_every_method(method, lost):
    rows = ROWS.assign(method=["rk4", "contact-rkn6", method], engine=["numba", "numba", "jax"])
    assert missing(WORK_PRECISION, rows) == {(WORK_PRECISION.name, what) for what in lost}
