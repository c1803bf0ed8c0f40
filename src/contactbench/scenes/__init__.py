"""The registry of named scenes.  To add one: define it in a module here and list it below."""

from __future__ import annotations

from contactbench.errors import Registry
from contactbench.scene import Scene
from contactbench.scenes.hard import HARD
from contactbench.scenes.standard import STANDARD

SCENES = Registry("scene", Scene)
for _scene in (*STANDARD, *HARD):
    SCENES.add(_scene)


def standard_scenes() -> list[Scene]:
    """The registered scenes that every experiment runs: all but the hard ones."""
    return [scene for scene in SCENES.values() if not scene.hard]


def hard_scenes() -> list[Scene]:
    """The registered scenes of the stability experiment."""
    return [scene for scene in SCENES.values() if scene.hard]
