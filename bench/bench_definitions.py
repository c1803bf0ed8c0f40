"""What was run?  One cell: a scene or a method, with the digest of its definition."""

from __future__ import annotations

import contactbench as cb
from cells import cells
from contactbench.measure.definition import method_row, scene_row
from contactbench.results.tables import DEFINITIONS


@cells(lambda profile: [("scene", name) for name in cb.SCENES] + [("method", name) for name in cb.METHODS])
def test_definition(cell, record):
    kind, name = cell
    record(DEFINITIONS, **(scene_row(cb.SCENES[name]) if kind == "scene" else method_row(cb.METHODS[name])))
