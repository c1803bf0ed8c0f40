"""A comparison on one scene as text and plot."""

import numpy as np
import pandas as pd
import pytest

import contactbench as cb
from cases import Clock, reading
from contactbench.study import race


@pytest.fixture(scope="module")
def frame():
    with reading(Clock()):
        return cb.compare("oscillator", ["contact-strang", "rk4", "contact-exact"], (1e-2, 1e-4), budget=60.0)


def test_text_has_every_time_and_the_plot_every_kind(frame):
    text = race.text(frame, every=True)
    for run in frame[frame["status"] == "ok"].itertuples():
        assert run.setting in text
    assert "contact-exact: unsupported" in text
    assert [panel.title for panel in race.figure(frame).panels] == ["Compiled", "Evaluations"]


def test_a_law_there_was_no_time_for_is_not_called_broken(frame):
    own = frame[frame["method"] == "contact-strang"].copy()
    assert race.kept_laws(own) == "η"
    for rows, kept in (
        (own.index[0], "η"),
        (own.index, "η not measured"),
    ):  # at one of the two errors, at both
        own.loc[rows, ["contact_drift", "laws_kept"]] = [np.nan, ""]
        assert race.kept_laws(own) == kept
    assert race.kept_laws(frame[frame["method"] == "rk4"]) == "none"


def test_a_curve_says_what_an_error_costs_and_never_turns_back():
    errors = [1e-1, 3e-1, 1e-3, 1e-2, 1e-4, 1e-9]
    tried = pd.DataFrame({"method": ["a"] * 5 + ["b"], "error": errors, "cost": [1, 2, 3, 4, 5, 9]})
    front = race.front(tried)
    assert front.query("method == 'a'")["cost"].tolist() == [1, 3, 5]
    assert len(front) == 4
