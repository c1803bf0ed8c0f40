"""Claims about the damped rigid body (§4 of the paper)."""
from contactbench.claims.ledger import claim  # noqa: F401
