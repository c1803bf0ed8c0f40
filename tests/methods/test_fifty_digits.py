"""Every method with a conformal factor in 50-digit arithmetic: order, contact form, momentum map."""

import pytest

import contactbench as cb
from cases import pairs
from contactbench.methods.fixed_step import FixedStep
from properties import contact_defect, momentum_defect

METHODS = [m for m in cb.METHODS.values() if isinstance(m, FixedStep) and (m.contact or m.factor)]
PARTICLE, BODY, CENTRAL = (cb.SCENES[name] for name in ("particle", "rigid_body", "central"))
#: other parameters, mass and inertia ratios included; a generic attitude
HEAVY = PARTICLE.with_(name="heavy", gamma=0.35, mass=1.6, coupling=-0.15, q=(0.7, -0.4), p=(0.5, 0.2), s=0.3)
SLENDER = BODY.with_(
    name="slender", gamma=0.3, inertia=(0.8, 1.1, 2.5), M=(-0.6, 0.4, 0.9), R=(0.5, 0.5, -0.5, 0.5), s=0.2
)
SCENES = [PARTICLE, HEAVY, BODY, SLENDER]
BEYOND = 1e-45  # 50 digits less what a few hundred operations on numbers of size one lose


@pairs(METHODS, SCENES)
@pytest.mark.quick(scene="heavy")
@pytest.mark.quick(method="contact-rkn4", scene="slender")
def test_map_is_conformal_contact_with_the_claimed_factor(method, scene):
    """Five steps of size 0.2 as one map, at 150 digits."""
    assert contact_defect(method, scene, "0.2", 5) < BEYOND


@pairs(METHODS, [CENTRAL, CENTRAL.with_(name="soft", gamma=0.4, stiffness=0.3, p=(-0.2, 0.9)), BODY, SLENDER])
def test_momentum_map_decays_by_the_claimed_factor(method, scene):
    assert momentum_defect(method, scene, "0.2", 20) < BEYOND
