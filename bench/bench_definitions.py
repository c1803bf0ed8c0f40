"""What was run?  One cell: a scene or a method, with the digest of its definition."""

import contactbench as cb
from cells import cells
from contactbench.measure.definition import row
from contactbench.results.tables import DEFINITIONS


@cells(lambda profile: [("scene", name) for name in cb.SCENES] + [("method", name) for name in cb.METHODS])
def test_definition(cell, record):
    kind, name = cell
    record(DEFINITIONS, row(cb.SCENES[name] if kind == "scene" else cb.METHODS[name]))
