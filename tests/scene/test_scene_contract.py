"""Every registered scene, and shapes the registry does not have, keep every rule of the contract."""

from __future__ import annotations

import contactbench as cb
from cases import TILTED, USER, by_name
from contactbench.testing import check_scene


@by_name([*cb.SCENES.values(), USER, TILTED])
def test_a_scene_keeps_its_contract(scene):
    check_scene(scene)
