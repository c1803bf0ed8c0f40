"""The registry of named scenes.  To add one: define it in a module here and list it below."""

from __future__ import annotations

from contactbench.errors import BadInput, Registry, excerpt
from contactbench.scene import Scene
from contactbench.scenes.driven import DRIVEN
from contactbench.scenes.hard import HARD
from contactbench.scenes.many import MANY
from contactbench.scenes.standard import STANDARD

SCENES = Registry("scene", Scene)
for _scene in (*STANDARD, *DRIVEN, *HARD, *MANY):
    SCENES.add(_scene)


def scene_of(scene: object) -> Scene:
    """Return a scene, itself or by name, its functions recorded; else raise `UnknownName` with a suggestion."""
    if isinstance(scene, str):
        scene = SCENES[scene]
    if not isinstance(scene, Scene):
        raise BadInput(f"scene = {excerpt(scene)}: must be a scene or the name of one: {', '.join(SCENES)}")
    return scene.recorded()


def scenes_of(experiment: str) -> list[Scene]:
    """Return the registered scenes that an experiment runs."""
    hard = experiment == "stability"
    return [
        s for s in SCENES.values() if experiment in s.experiments or (not s.experiments and s.hard == hard)
    ]
