"""Scenes: an energy, a force and a right-hand side, written once as plain arithmetic on tuples of components.

The contact form is η = ds − p·dq and the contact Hamiltonian H = H0 + Γ(s), Γ(s) = γ s + ½ κ s²; then q' = ∂H/∂p,
p' = −∂H/∂q − p Γ'(s), s' = p·∂H/∂p − H (paper, §2.3, eq. (23)).
"""

from contactbench.scene.algebra import (
    AnyState,
    BodyState,
    DrivenState,
    State,
    Vector,
    added,
    cross,
    dot,
    norm,
    quaternion_of,
    quaternion_product,
    rotate,
    rotation_matrix,
    scaled,
    shifted,
    times,
)
from contactbench.scene.base import Cache, Scene, key
from contactbench.scene.contact_system import ContactSystem
from contactbench.scene.definition import verify
from contactbench.scene.driven import Driven
from contactbench.scene.equations import Equations
from contactbench.scene.flow import Flow
from contactbench.scene.general_damping import GeneralDamping
from contactbench.scene.heavy_top import HeavyTop
from contactbench.scene.mechanical import Mechanical
from contactbench.scene.rigid_body import RigidBody
from contactbench.scene.spheres import Spheres
