"""The registry of named scenes.  To add one: define it in a module here and list it below."""

from __future__ import annotations

from contactbench.errors import Registry
from contactbench.scene import Scene
from contactbench.scenes.standard import STANDARD

SCENES = Registry("scene", Scene)
for _scene in STANDARD:
    SCENES.add(_scene)
