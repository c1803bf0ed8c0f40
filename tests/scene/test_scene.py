"""One definition per scene, right on every kind of number, with derivatives that AD confirms."""

from __future__ import annotations

import heyoka
import numpy as np
import pytest

import contactbench as cb
from cases import ALL_SCENES, TILTED, by_name, random_state
from contactbench.peers.heyoka import taylor_system
from contactbench.scene import rotation_matrix, verify
from contactbench.xla import jax, jnp

AD = 1e-13  # a handful of float64 operations on numbers of size one


def test_tilted_damping_is_the_matrix_itself():
    x = random_state(TILTED, 6)
    expected = np.cross(x.M, np.array(x.M) / TILTED.inertia) - np.array(TILTED.damping) @ x.M
    np.testing.assert_allclose(TILTED.rhs(x).M, expected, rtol=AD, atol=AD)


def test_attitude_may_be_given_as_a_matrix_or_a_quaternion():
    body = cb.SCENES["rigid_body"]
    half = np.sqrt(0.5)
    quarter_turn = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    np.testing.assert_allclose(body.with_(R=quarter_turn).R, (half, 0, 0, half), atol=AD)
    np.testing.assert_allclose(rotation_matrix(body.with_(R=(half, 0, 0, half)).R), quarter_turn, atol=AD)


BODY, ANISOTROPIC = "rigid_body", "rigid_body_anisotropic"


@pytest.mark.parametrize(
    ("name", "changes", "says"),
    [
        ("particle", {"q": (1.0,)}, "q has 1 components and p 2"),
        ("particle", {"q": (1.0, 2.0, 3.0), "p": (0.0, 0.0, 0.0)}, "q = (1.0, 2.0, 3.0)"),
        ("particle", {"gama": 0.1}, "did you mean 'gamma'?"),
        (BODY, {"inertia": (1.0, -2.0, 3.0)}, "inertia = (1.0, -2.0, 3.0): all three moments must be > 0"),
        (BODY, {"R": ((1, 0, 0), (0, 1, 0), (0, 0, -1))}, "rotation matrix"),
        (BODY, {"gamma": 0.1, "damping": (1.0, 1.0, 1.0)}, "exactly one of gamma"),
        (ANISOTROPIC, {"damping": ((1, 2, 0), (0, 1, 0), (0, 0, 1))}, "symmetric positive semi-definite"),
        (ANISOTROPIC, {"damping": (1.0, 1.0, -0.1)}, "symmetric positive semi-definite"),
    ],
)
def test_bad_parameters_give_one_clear_line(name, changes, says):
    with pytest.raises(cb.BadInput) as caught:
        cb.SCENES[name].with_(**changes)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("size", "wrong"), [(n, i) for n in range(1, 5) for i in range(n)])
def test_a_gradient_wrong_in_any_one_component_is_refused(size, wrong):
    scene = cb.Mechanical(
        name="springs",
        potential=lambda q: sum(x * x for x in q) / 2,
        gradient=lambda q: tuple(1.01 * x if i == wrong else x for i, x in enumerate(q)),
        q=(1.0,) * size,
        p=(0.0,) * size,
        t_end=1.0,
    )
    with pytest.raises(cb.BadInput, match=f"component {wrong + 1} is"):
        verify(scene)


def test_ctrl_c_in_a_force_is_no_bad_input():
    def interrupt(q):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cb.Mechanical(
            name="slow", potential=lambda q: q[0], gradient=interrupt, q=(1.0,), p=(0.0,), t_end=1.0
        )


def test_with_changes_any_parameter_and_nothing_else():
    scene = cb.SCENES["particle"].with_(gamma=0.3, coupling=0.2, q=(1.0, 0.5), t_end=5.0)
    assert (scene.gamma, scene.parameters["coupling"], scene.t_end) == (0.3, 0.2, 5.0)
    assert cb.SCENES["particle"].gamma == 0.1
    assert scene.structure == cb.SCENES["particle"].structure  # no recompilation


def test_carry_decides_what_is_integrated():
    assert cb.SCENES["particle"].carry(None) == ("s",)
    assert cb.SCENES["rigid_body"].carry(("s", "R")) == ("R", "s")
    assert cb.SCENES["particle"].with_(kappa=1.0).carry(()) == ("s",)  # s is part of the dynamics
    with pytest.raises(cb.BadInput, match="can carry s"):
        cb.SCENES["particle"].carry(("R",))
    with pytest.raises(cb.BadInput, match="can carry R"):
        cb.SCENES["rigid_body_anisotropic"].carry(("s",))


@pytest.mark.parametrize(
    ("changes", "may"),
    [({"gamma": 0.1}, False), ({"gamma": 0.0}, True), ({"gamma": -0.1}, True), ({"kappa": 0.1}, True)],
)
def test_energy_is_bound_to_fall_only_under_a_constant_damping_above_zero(changes, may):
    """At γ = 0 the truth keeps H0, and half of a method's round-off raises it."""
    assert cb.SCENES["particle"].with_(**changes).may_gain_energy is may


@by_name(ALL_SCENES)
def test_same_right_hand_side_on_jax_and_heyoka(scene):
    """On arrays and decimal numbers: rule 4 of the contract."""
    x, carry = random_state(scene, 4), scene.optional
    y, expected = scene.pack(x), np.array(scene.pack(scene.rhs(x)))

    traced = jax.jit(
        lambda y, n: jnp.stack(scene.pack(scene.with_numbers(list(n)).rhs(scene.unpack(list(y), carry))))
    )
    np.testing.assert_allclose(traced(jnp.array(y), jnp.array(scene.numbers())), expected, rtol=AD, atol=AD)

    system = taylor_system(scene, carry, heyoka)
    field = heyoka.cfunc([e for _, e in system], [v for v, _ in system])
    state, time = np.array(scene.without_clock(y)), {} if scene.clock is None else {"time": y[scene.clock]}
    np.testing.assert_allclose(field(state, **time), scene.without_clock(expected), rtol=AD, atol=AD)
