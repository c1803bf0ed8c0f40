"""A work–precision race on one scene, the user's own for example: `compare`."""

from contactbench.race.compare import compare

__all__ = ["compare"]
