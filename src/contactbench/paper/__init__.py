"""The paper's claims, and some beyond it, each with a measurement and the verdict that follows from it."""

from contactbench.paper import geometry, integrator, rigid_body
from contactbench.paper.ledger import CLAIMS, Claim, Correction, Measurement, Verdict, verdict

for _name in sorted(CLAIMS):
    CLAIMS[_name] = CLAIMS.pop(_name)
