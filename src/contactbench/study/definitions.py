"""What was run?  One cell: a scene or a method, with the digest of its definition."""

from __future__ import annotations

import contactbench as cb
from contactbench.measure import definition as definitions
from contactbench.results.tables import DEFINITIONS
from contactbench.study.experiment import Cell, Profile, Recorded, experiment


@experiment(
    lambda profile: [("scene", name) for name in cb.SCENES] + [("method", name) for name in cb.METHODS]
)
def definition(cell: Cell, profile: Profile) -> Recorded:
    kind, name = cell
    yield DEFINITIONS, definitions.row(cb.SCENES[name] if kind == "scene" else cb.METHODS[name])
