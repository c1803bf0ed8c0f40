"""The settings that methods are tried at."""

from __future__ import annotations

import pytest

import contactbench as cb
from contactbench.measure.ladder import carried


@pytest.mark.parametrize(
    ("scene", "fields"), [("particle", ()), ("rigid_body", ("R",)), ("rigid_body_anisotropic", ())]
)
def test_the_attitude_is_carried_where_its_law_is_measured(scene, fields):
    assert carried(cb.SCENES[scene]) == fields
