"""The heavy top: its torque is the potential's derivative, and what it keeps is known in closed form."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import contactbench as cb
from contactbench.scene import rotation_matrix
from contactbench.testing import check_scene

TOP = cb.SCENES["heavy_top"]
#: three moments, a centre of mass off every axis, an attitude of no symmetry
GENERAL = TOP.with_(
    weight=1.7,
    inertia=(1.0, 1.7, 0.6),
    axis=(0.3, -0.4, 0.8),
    M=(0.4, -0.7, 1.1),
    R=Rotation.from_rotvec([0.4, 1.0, -0.3]).as_matrix(),
)
#: gravity's gradient on it, too
SATELLITE = GENERAL.with_(
    potential=lambda u: 0.6 * sum(i * c * c for i, c in zip((1.0, 1.7, 0.6), u, strict=True))
)
CONTACT = [name for name, method in cb.METHODS.items() if method.contact and method.refuses(TOP) is None]


def test_it_keeps_the_rules_of_scenes():
    check_scene(SATELLITE)


@pytest.mark.parametrize(("scene", "gradient"), [(GENERAL, 0.0), (SATELLITE, 1.2)])
def test_the_solution_is_that_of_matrices(scene, gradient):
    """By SciPy, with a rotation matrix and the cross products written out with NumPy."""
    inertia, axis, up = np.array(GENERAL.inertia), np.array(GENERAL.axis), np.array([0.0, 0.0, 1.0])

    def rhs(t, y):
        M, R, s = y[:3], y[3:12].reshape(3, 3), y[12]
        omega, u = M / inertia, R.T @ up
        torque = np.cross(u, GENERAL.weight * axis + gradient * inertia * u)
        V = GENERAL.weight * u @ axis + gradient / 2 * u @ (inertia * u)
        ds = M @ omega / 2 - V - GENERAL.gamma * s
        dM, dR = np.cross(M, omega) + torque - GENERAL.gamma * M, R @ np.cross(np.eye(3), omega)
        return np.concatenate([dM, dR.ravel(), [ds]])

    start = np.concatenate([GENERAL.M, np.array(rotation_matrix(GENERAL.R)).ravel(), [GENERAL.s]])
    own = solve_ivp(rhs, (0, 5.0), start, "DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    found = cb.solve(scene, "contact-bm6", step=0.05, save_at=[5.0])
    x = GENERAL.unpack(found.y[-1].tolist(), found.carry)
    assert np.allclose([*x.M, *np.ravel(rotation_matrix(x.R)), x.s], own, rtol=0, atol=1e-9)


def test_the_spin_of_lagranges_top_decays_alone():
    """M·χ has no torque where two moments are equal."""
    found = cb.reference(TOP, np.linspace(0, 20, 5)).states()
    assert np.allclose(found.M[2], 2.0 * np.exp(-TOP.gamma * np.linspace(0, 20, 5)), rtol=1e-14)


def test_it_refuses_what_it_has_no_law_for():
    with pytest.raises(cb.BadInput, match=r"its potential cannot be differentiated: .*float"):
        TOP.with_(potential=lambda u: float(u[0]) ** 2)
    with pytest.raises(cb.BadInput, match="of a heavy top it is isotropic"):
        TOP.with_(damping=(0.1, 0.2, 0.3))
    assert "isotropic damping" in cb.METHODS["contact-exact"].refuses(TOP)
