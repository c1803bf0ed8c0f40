"""The settings that methods are tried at."""

from __future__ import annotations

import pytest

import contactbench as cb
from contactbench.measure.ladder import carried, work_ladder


@pytest.mark.parametrize(
    ("scene", "fields"), [("particle", ()), ("rigid_body", ("R",)), ("rigid_body_anisotropic", ())]
)
def test_the_attitude_is_carried_where_its_law_is_measured(scene, fields):
    assert carried(cb.SCENES[scene]) == fields


def test_ladders_halve_from_four_on_a_body_and_go_by_roots_of_two_from_order_six_on():
    body, particle = cb.SCENES["rigid_body"], cb.SCENES["particle"]
    assert work_ladder(body, 2) == pytest.approx([4.0, 2.0, *(0.8 / 2**k for k in range(9))])
    assert work_ladder(particle, 2) == pytest.approx([0.8 / 2**k for k in range(9)])
    counts = [particle.t_end / step for step in work_ladder(particle, 6)]
    assert counts == pytest.approx(
        [5, 10, 20, 25, 35, 50, 70, 100, 140, 200]
    )  # multiples of five near 6.25 · 2^(k/2)
