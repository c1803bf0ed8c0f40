"""A comparison on one scene as text and plot, with what to take at each error."""

import numpy as np
import pandas as pd
import pytest

import contactbench as cb
from cases import Clock, reading
from contactbench.measure.statistics import WIDEST
from contactbench.report.look import CONTESTANTS
from contactbench.study import race
from contactbench.study.compare import frame_of
from frames import race_of, tried


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


# -- what to take at each error ----------------------------------------------------------------------
NAMES = ["rkn12", "contact-rkn8", "rk8", "cyrk-vern8", "cyrk-dop853", "heyoka-taylor", "scipy-dop853"]


def raced(times, errors=(1e-6,), names=NAMES, halves=1.0, kept="", why=()):
    """Return the frame of a race on the oscillator whose methods took so many µs; None: the error is not reached."""
    searches, clock, laws = race_of(*names, errors=errors, scene="oscillator"), {}, {}
    for each, own in zip(searches, times, strict=True):
        if own is None:
            tried(each, 1e-6, 3e-4)
            each.why = why or None
        else:
            attempt = tried(each, own * 1e-6, 5e-7, 0.75)
            clock[id(attempt)] = {"time_s": own * 1e-6, "halves": halves}
            if each.method.name == kept:
                laws[id(attempt)] = {"contact_drift": 1e-16, "contact_drift_kept": True}
    frame = frame_of(searches[0].question, searches, laws, clock)
    frame.attrs |= {"unbegun": [], "unrefined": [], "interrupted": False}
    frame.attrs["reference"]["confirmed"] = None
    return frame


def recommended(*given, **more):
    (found,) = raced(*given, **more).attrs["recommendation"]
    return found


def test_it_names_the_fastest_and_beside_it_a_contact_method_and_two_libraries():
    assert recommended([3.1, 4.34, 9.0, 5.89, 6.0, 6.82, 100.0], kept="contact-rkn8") == (
        "Take rkn12, step 0.75: 3.1 µs for 10⁻⁶; contact-rkn8 ×1.40 (keeps η); cyrk-vern8 ×1.90; "
        "heyoka-taylor ×2.20."
    )


def test_a_contact_method_that_leads_says_what_it_keeps():
    found = recommended([3.9, 3.1, 9.0, 5.89, 6.0, 6.82, 100.0], kept="contact-rkn8")
    assert found.startswith("Take contact-rkn8, step 0.75: 3.1 µs for 10⁻⁶ (keeps η); cyrk-vern8 ×1.90;")


def test_what_is_kept_is_never_named_as_a_drift():
    """ "keeps attitude drift" would read as its opposite."""
    frame = cb.compare("rigid_body", ["contact-strang"], [1e-2], budget=60.0)
    (found,), kept = frame.attrs["recommendation"], set(frame["laws_kept"][0].split(", "))
    assert {"J", "η", "RᵀR = 1"} <= kept
    assert "keeps" in found
    assert "drift" not in found + frame["laws_kept"][0]


def test_all_that_are_about_as_fast_are_named_and_noise_too():
    near = f"within {WIDEST - 1:.0%} of it"
    found = recommended([3.1, 3.13, 3.15, 3.17, 9.0, 3.18, 100.0])
    assert (
        f"; {near} contact-rkn8 ×1.01 (η not measured), rk8 ×1.02, cyrk-vern8 ×1.02 and heyoka-tay" in found
    )
    found = recommended([3.1, 9.0, 3.2, *[9.0] * 3, 100.0], halves=1.3)
    assert f"; {near} rk8 ×1.03;" in found
    assert found.endswith(
        "; who is fastest is undecided: times cannot be told apart within a factor of 1.45."
    )


def test_what_is_missing_to_say_so_is_said():
    missing = "Nothing to take for 10⁻⁶: the most accurate is rkn12, step 0.1, with 3.0e-04"
    assert recommended([None] * 7) == f"{missing}."
    found = recommended([None] * 7, why=("budget", "no time was left"))
    assert found == f"{missing}; 7 methods cut off for want of time (--budget)."
    searches = race_of("rk8", "rkn12", errors=(1e-6,), scene="oscillator")
    for each, evaluations in zip(searches, (2200, 1800), strict=True):
        tried(each, 1e-6, 3e-7, evaluations=evaluations)
    (found,) = frame_of(searches[0].question, searches, {}, {}).attrs["recommendation"]
    assert found.startswith("Take rkn12, step 0.1: 1800 evaluations for 10⁻⁶, the fewest; no time was left")
    found = recommended([3.1], errors=(1e-40,), names=["rkn12"])
    assert found.startswith("Nothing to take for 10⁻⁴⁰: the reference is known to ")


def test_a_race_of_many_prints_ten_rows_with_the_contestants_in_a_hundred_columns_sorted_by_time():
    names = [name for name in cb.METHODS if cb.METHODS[name].engines[0] == "llvm"]
    errors = (1e-3, 1e-5, 1e-6)
    frame = raced([50.0 - k for k in range(len(names))], errors=errors, names=names)
    text, every = race.text(frame), race.text(frame, every=True)
    assert max(map(len, [*text.splitlines(), *every.splitlines()])) <= 100
    table = text.split("\n\n")[0].splitlines()
    shown = [line.split()[0] for line in table[2:]]
    assert len(shown) == race.ROWS
    assert shown == [name for name in reversed(names) if name in shown]
    assert all({*group} & {*shown} for group in CONTESTANTS if {*group} & {*names})
    assert text.count("Take ") == len(errors)
    assert all(name in every for name in names)
    assert ("evaluations" in table[1], "setting" in every) == (False, True)


def test_what_was_not_begun_or_not_measured_is_said():
    frame = raced([3.1, *[9.0] * 6], names=NAMES)
    frame.attrs |= {"unbegun": ["rk4"], "unrefined": ["rk8"], "interrupted": True}
    text = " ".join(race.text(frame).split())
    assert text.startswith("Not begun, for want of time (--budget): rk4. Compiled")
    assert "No time was left to look for a cheaper setting of rk8." in text
    assert f"The laws of {', '.join(NAMES)} are not measured: no time was left." in text
    assert "Interrupted: the table shows the results until then." in text


@pytest.mark.slow
def test_a_whole_race_of_a_scene_ends_with_an_answer_for_each_error():
    frame = cb.compare("particle", budget=60.0)
    assert all(line.startswith("Take ") for line in frame.attrs["recommendation"])
