"""The registry of named scenes.  To add one: define it in a module here and list it below."""

from __future__ import annotations

from contactbench.scene.base import SCENES
from contactbench.scenes.contact_systems import CONTACT_SYSTEMS
from contactbench.scenes.driven import DRIVEN
from contactbench.scenes.hard import HARD
from contactbench.scenes.standard import STANDARD

for _scene in (*STANDARD, *DRIVEN, *CONTACT_SYSTEMS, *HARD):
    SCENES.add(_scene)
