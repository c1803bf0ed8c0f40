"""Scenes: what is solved.

A scene is its energy, force and right-hand side, written once as plain arithmetic on tuples of
components.  The same functions run on Python floats, NumPy arrays (one array per component: an
ensemble), JAX tracers, mpmath numbers and heyoka expressions, because every number a scene holds
can be replaced (`Scene.with_numbers`) by a number of another kind.

Conventions: contact form η = ds − p·dq, contact Hamiltonian H = H0 + Γ(s), Γ(s) = γ s + ½ κ s²;
q' = ∂H/∂p, p' = −∂H/∂q − p Γ'(s), s' = p·∂H/∂p − H  (paper, §2.3, eq. (23)).
"""

from contactbench.scene.algebra import (
    AnyState,
    BodyState,
    DrivenState,
    State,
    Vector,
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
from contactbench.scene.base import Cache, Scene, System, key
from contactbench.scene.definition import verify
from contactbench.scene.driven import Driven
from contactbench.scene.flow import Flow
from contactbench.scene.general_damping import GeneralDamping
from contactbench.scene.heavy_top import HeavyTop
from contactbench.scene.mechanical import Mechanical
from contactbench.scene.rigid_body import RigidBody
