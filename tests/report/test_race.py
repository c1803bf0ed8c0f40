"""A comparison on one scene as text, page and plot."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest

import contactbench as cb
from contactbench.report import race


@pytest.fixture(scope="module")
def frame():
    return cb.compare("oscillator", ["contact-strang", "rk4", "contact-exact"], (1e-2, 1e-4), budget=60.0)


def test_text_and_page_have_every_time_with_its_setting_and_the_figure_every_kind(frame):
    text, page = race.text(frame), race.html(frame)
    for row in frame[frame["status"] == "ok"].itertuples():
        assert row.method in page
        assert f"{row.setting}, {row.error_reached:.1e}" in text
    assert "contact-exact: unsupported" in text
    assert re.findall(r'src="([^,"]*)', page) == ["data:image/svg+xml;base64"]  # one file, nothing to fetch
    assert [panel.title for panel in race.figure(frame).panels] == ["Compiled", "Evaluations"]


def test_a_law_there_was_no_time_for_is_not_called_broken(frame):
    own = frame[frame["method"] == "contact-strang"].copy()
    assert "contact drift" in race.kept_by(own)
    own.loc[own.index[0], ["contact_drift", "laws_kept"]] = [np.nan, ""]  # measured at one of the two errors
    assert "contact drift" in race.kept_by(own)
    own["contact_drift"], own["laws_kept"] = np.nan, ""
    assert "not measured: contact drift" in race.kept_by(own)
    assert race.kept_by(frame[frame["method"] == "rk4"]) == "none"


def test_a_curve_says_what_an_error_costs_and_never_turns_back():
    errors = [1e-1, 3e-1, 1e-3, 1e-2, 1e-4, 1e-9]
    tried = pd.DataFrame({"method": ["a"] * 5 + ["b"], "error": errors, "cost": [1, 2, 3, 4, 5, 9]})
    front = race.front(tried)
    assert front.query("method == 'a'")["cost"].tolist() == [1, 3, 5]
    assert len(front) == 4
