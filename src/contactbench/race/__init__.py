"""A work–precision race on one scene, the user's own for example: `comparison.compare`."""
