"""The end of a race: what to take at each error, or what is missing to say so; and how it comes to be decided."""

import math
from types import SimpleNamespace

import pandas as pd
import pytest

import contactbench as cb
from cases import mine
from contactbench.measure.clock import Race, Visit
from contactbench.study import race
from contactbench.study.compare import frame_of
from contactbench.study.recommendation import recommendation
from frames import race_of, tried

NAMES = ["rkn12", "contact-rkn8", "rk8", "cyrk-vern8", "cyrk-dop853", "heyoka-taylor", "scipy-dop853"]


def raced(times, errors=(1e-6,), names=NAMES, halves=1.0, kept="", cut=()):
    """Return the frame of a race on the oscillator whose methods took so many µs; None: the error is not reached."""
    race = race_of(*names, errors=errors, scene="oscillator")
    for each, own in zip(race.searches, times, strict=True):
        if each.method.name in cut:
            each.why = ("budget", "no time was left to begin it")
        elif own is None:
            tried(each, 1e-6, 3e-4)
        else:
            attempt, seconds = tried(each, own * 1e-6, 5e-7, 0.75), own * 1e-6
            clock = {"time_min_s": seconds, "time_median_s": seconds, "time_halves_ratio": halves}
            race.times[id(attempt)] = clock
            if each.method.name == kept:
                race.laws[id(attempt)] = {"contact_drift": 1e-16, "contact_drift_kept": True}
    return frame_of(race)


def test_it_names_the_fastest_and_beside_it_a_contact_method_and_two_libraries():
    (found,) = recommendation(raced([3.1, 4.34, 9.0, 5.89, 6.0, 6.82, 100.0], kept="contact-rkn8"))
    assert found == (
        "Take rkn12, step 0.75: 3.1 µs for 10⁻⁶; contact-rkn8 ×1.40, keeps η; cyrk-vern8 ×1.90; "
        "heyoka-taylor ×2.20."
    )


def test_a_contact_method_that_leads_says_what_it_keeps():
    (found,) = recommendation(raced([3.5, 3.1, 9.0, 5.89, 6.0, 6.82, 100.0], kept="contact-rkn8"))
    assert found.startswith("Take contact-rkn8, step 0.75: 3.1 µs for 10⁻⁶, keeps η; cyrk-vern8 ×1.90;")


def test_what_is_kept_is_never_named_as_a_drift():
    """ "keeps attitude drift" would read as its opposite."""
    frame = cb.compare("rigid_body", ["contact-strang"], [1e-2], budget=10.0)
    (found,), kept = frame.attrs["recommendation"], set(frame["laws_kept"][0].split(", "))
    assert {"J", "η", "RᵀR = 1"} <= kept
    assert "keeps" in found
    assert "drift" not in found + frame["laws_kept"][0]


def test_equal_ones_are_equal_within_their_margin_and_noise_is_named():
    (found,) = recommendation(raced([3.1, 9.0, 3.2, *[9.0] * 3, 100.0], halves=1.1))
    assert "; rk8 equal within ×1.15; contact-rkn8" in found
    (found,) = recommendation(raced([3.1, 9.0, 3.2, *[9.0] * 3, 100.0], halves=1.3))
    assert found.endswith(
        "whether faster with rk8 is undecided: times vary by ×1.45 on this machine, no more than ×1.2 decides."
    )


def test_a_rival_that_was_not_begun_is_named_and_a_slow_one_that_was_reached_by_nobody():
    (found,) = recommendation(raced([3.1, *[9.0] * 6], cut=("cyrk-vern8",)))
    assert "undecided" not in found  # the least that a call of that library takes is more
    (found,) = recommendation(raced([5.0, *[9.0] * 6], cut=("cyrk-vern8",)))
    assert found.endswith("; whether faster with cyrk-vern8 is undecided: no time was left (--budget).")
    (found,) = recommendation(raced([None] * 7))
    assert found == "Nothing to take for 10⁻⁶: the most accurate is rkn12, step 0.1, with 3.0e-04."
    race = race_of("rk8", "rkn12", errors=(1e-6,), scene="oscillator")
    for each, evaluations in zip(race.searches, (2200, 1800), strict=True):
        tried(each, 1e-6, 3e-7, evaluations=evaluations)
    (found,) = recommendation(frame_of(race))
    assert found.startswith(
        "Take rkn12, step 0.1: 1800 evaluations for 10⁻⁶, the fewest; no time was left to time it"
    )
    (found,) = recommendation(raced([3.1], errors=(1e-40,), names=["rkn12"]))
    assert found.startswith("Nothing to take for 10⁻⁴⁰: the reference is known to ")


def test_those_not_expected_to_lead_wait_and_do_not_leave_it_undecided():
    names = ["contact-rkn8", "rk4"]
    for leading, unbegun in (((), names), (("rk4",), ["rk4"])):
        race = race_of(*names, errors=(1e-3,), scene="oscillator", leading=leading)
        race.left = lambda part: 0.0
        race.search()
        assert race.unbegun == unbegun
        assert {*frame_of(race)["reason"]} == {"no time was left to begin it"}
        least = frame_of(race).set_index("method")["at_least"]
        assert math.isnan(least["contact-rkn8"]) == bool(leading)
        assert least["rk4"] == 0.0
    race = race_of(*names, errors=(1e-3,), scene="oscillator", leading=("rk4",))
    race.search()
    assert race.searches[1].done  # and then the other
    assert race.searches[0].attempts


def test_the_leaders_are_visited_until_it_is_decided_and_the_field_no_more():
    """Two that differ by 2 % behind noise of 30 %, and one three times as slow."""
    schedule = race_of("rk4", "rk8", "rkn8", errors=(1e-3,), scene="oscillator")
    timed = [id(tried(each, 1e-6, 1e-4)) for each in schedule.searches]
    noise = iter(k % 97 / 97 * 0.3 for k in range(7, 10**6, 31))

    def call(seconds):
        return SimpleNamespace(
            visit=lambda rounds=3: Visit([seconds * (1 + next(noise))]), warm_up=lambda: 0.0
        )

    race = Race([call(1.0), call(1.02), call(3.0)])
    race.visits = [[Visit([1.3 * s]), Visit([s])] for s in (1.0, 1.02, 3.0)]
    assert schedule.unsettled(race, timed) == [0, 1]
    schedule.settle(race, timed, math.inf)
    first, second, field = map(len, race.visits)
    assert first == second >= 10
    assert field == 2
    assert schedule.unsettled(race, timed) == []


def test_a_race_of_many_prints_ten_rows_in_a_hundred_columns_sorted_by_time():
    names = [name for name in cb.METHODS if cb.METHODS[name].engines[0] == "llvm"]
    errors = (1e-3, 1e-5, 1e-6)
    frame = raced([50.0 - k for k in range(len(names))], errors=errors, names=names)
    frame.attrs["recommendation"] = [*recommendation(frame)]
    text, every = race.text(frame), race.text(frame, every=True)
    assert max(map(len, [*text.splitlines(), *every.splitlines()])) <= 100
    table = text.split("\n\n")[0].splitlines()
    assert [line.split()[0] for line in table[2:]] == names[: -race.ROWS - 1 : -1]
    *_, taken, further = text.split("\n\n")
    assert taken.count("Take ") == len(errors)
    assert further.endswith("problems.md")
    assert all(name in every for name in names)
    assert "evaluations" not in table[1]


@pytest.mark.slow
def test_a_whole_race_of_ones_own_scene_ends_in_time_with_an_answer_for_each_error():
    scene = mine(lambda q: q[0] ** 4 / 4 - q[0] ** 2 / 2.1, q=1.5, t_end=20.0, gamma=0.21)
    frame = cb.compare(scene, budget=60.0)
    assert frame.attrs["seconds"] <= 1.05 * 60.0
    assert all(line.startswith("Take ") for line in frame.attrs["recommendation"])
    assert isinstance(frame, pd.DataFrame)
