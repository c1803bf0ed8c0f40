"""One definition per scene, right on every kind of number, with derivatives that AD confirms, and a contract."""

import math
import re

import heyoka
import numpy as np
import pytest

import contactbench as cb
from cases import ALL_SCENES, TILTED, USER, bodies, by_name, chain, masses, random_state
from contactbench.peers.heyoka import taylor_system
from contactbench.scene import State, rotation_matrix, verify
from contactbench.scene.definition import verify_along, verify_at
from contactbench.testing import SCENE_RULES, Violation, check_scene
from contactbench.xla import jax, jnp

AD = 1e-13  # a handful of float64 operations on numbers of size one


def test_attitude_may_be_given_as_a_matrix_or_a_quaternion():
    body = cb.SCENES["rigid_body"]
    half = np.sqrt(0.5)
    quarter_turn = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    np.testing.assert_allclose(body.with_(R=quarter_turn).R, (half, 0, 0, half), atol=AD)
    np.testing.assert_allclose(rotation_matrix(body.with_(R=(half, 0, 0, half)).R), quarter_turn, atol=AD)


def springs(gradient, size=1, q=1.0):
    given = {"name": "springs", "q": (q,) * size, "p": (0.0,) * size, "t_end": 1.0}
    return cb.Mechanical(potential=lambda q: sum(x * x for x in q) / 2, gradient=gradient, **given)


@pytest.mark.parametrize("q", [0.0, 1.0])
@pytest.mark.parametrize(("size", "wrong"), [(1, 0), (2, 1), (4, 0), (4, 2)])
def test_a_gradient_wrong_in_any_one_component_is_refused(size, wrong, q):
    """Also where it is right at the start itself."""
    scene = springs(lambda q: tuple(1.01 * x if i == wrong else x for i, x in enumerate(q)), size, q)
    with pytest.raises(cb.BadInput, match=f"component {wrong + 1} is"):
        verify(scene)


def test_ctrl_c_in_a_force_is_no_bad_input():
    def interrupt(q):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        springs(interrupt)


def test_carry_decides_what_is_integrated():
    assert cb.SCENES["particle"].carry(None) == ("s",)
    assert cb.SCENES["rigid_body"].carry(("s", "R")) == ("R", "s")
    assert cb.SCENES["particle"].with_(kappa=1.0).carry(()) == ("s",)  # s is part of the dynamics
    with pytest.raises(cb.BadInput, match="can carry s"):
        cb.SCENES["particle"].carry(("R",))
    with pytest.raises(cb.BadInput, match="can carry R"):
        cb.SCENES["rigid_body_anisotropic"].carry(("s",))


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


# -- the contract ---------------------------------------------------------------------------------
@by_name(
    [
        *cb.SCENES.values(),
        chain(8),
        chain(8, "fixed", held=False, mass=masses(8)),
        bodies(4, 3),
        USER,
        TILTED,
        cb.SCENES["oscillator"].with_(name="moving", p=(0.7,)),
    ]
)
def test_a_scene_keeps_its_contract(scene):
    check_scene(scene)


def broken(**own):
    """A kind of scene that is mechanical but for some of its methods."""
    return type("Broken", (cb.Mechanical,), own)


def quartic(kind=cb.Mechanical, **changes):
    """V = q⁴/4, or what changes it."""
    functions = {
        "potential": lambda q: q[0] * q[0] * q[0] * q[0] / 4,
        "gradient": lambda q: (q[0] * q[0] * q[0],),
        "hessian": lambda q: ((3 * q[0] * q[0],),),
    }
    given = {"name": "planted", "gamma": 0.3, "q": (0.7,), "p": (0.4,), "s": 0.1, "t_end": 2.0}
    return kind(**given | functions | changes)


BROKEN = [
    (1, quartic(name="two words")),
    (2, quartic(broken(labels=lambda self, carry: cb.Mechanical.labels(self, carry)[:-1]))),
    (3, quartic(broken(number_names=lambda self: cb.Mechanical.number_names(self)[1:]))),
    (4, quartic(gradient=lambda q: (math.sin(q[0]),), potential=lambda q: -math.cos(q[0]), hessian=None)),
    (5, quartic(hessian=lambda q: ((2 * q[0] * q[0],),))),
    (5, quartic(potential=lambda q: q[0] * q[0] / 2, hessian=None)),
    (6, quartic(broken(hamiltonian=lambda self, x: cb.Mechanical.hamiltonian(self, x) + 1))),
    (7, quartic(broken(may_gain_energy=False), gamma=-0.3)),
    (7, cb.SCENES["particle"].with_(rotation_invariant=True)),
    (8, quartic(broken(displaced=lambda self, x, v, a: cb.Mechanical.displaced(self, x, v, 2 * a)))),
    (9, quartic(exact=lambda scene, t, mp: State(scene.q, scene.p, scene.s))),
    (9, quartic(exact=lambda scene, t, mp: State((scene.q[0] + 1,), None, None))),
]


@pytest.mark.parametrize(("rule", "scene"), BROKEN, ids=[f"{rule}-{i}" for i, (rule, _) in enumerate(BROKEN)])
def test_a_broken_rule_is_named(rule, scene):
    with pytest.raises(Violation) as caught:
        check_scene(scene)
    assert caught.value.rule == rule, caught.value


def test_every_rule_has_a_scene_that_breaks_it():
    assert {rule for rule, _ in BROKEN} == set(SCENE_RULES)


# -- functions that fit each other near the start and not along the motion --------------------------
SPRING = {"name": "mine", "q": (0.5,), "p": (1.0,), "t_end": 4.0}


def beyond(x, edge):
    """0 up to an edge, and smooth."""
    above = (x - edge + abs(x - edge)) / 2
    return above * above * above


def general(slope=lambda s: 0.1 + 0.2 * s):
    functions = {"damping": lambda s: 0.1 * s + 0.1 * s * s, "damping_slope": slope}
    return cb.GeneralDamping(potential=lambda q: q[0] * q[0] / 2, s=3.0, **functions, **SPRING)


def central(**changes):
    given = {
        "potential": lambda q: (q[0] * q[0] + q[1] * q[1]) / 2 + beyond(-q[0], 0.5),
        "gradient": lambda q: (q[0] - 3 * (beyond(-q[0], 0.5) ** 2) ** (1 / 3), q[1]),
    }
    return cb.Mechanical(name="mine", q=(1.0, 0.0), p=(0.3, 0.8), t_end=6.0, **given | changes)


WRONG = {
    "slope": (general(slope=lambda s: 0.1 + 0.2 * s + beyond(2 - s, 0)), "damping_slope is not"),
    "symmetry": (central(rotation_invariant=True), "exerts a torque"),
    "gradient": (central(gradient=lambda q: (q[0] if q[0] > -0.6 else 2 * q[0], q[1])), "gradient is not"),
}


def test_a_damping_whose_slope_fits_is_taken():
    verify(general())
    verify_along(general())


@pytest.mark.parametrize(("scene", "says"), WRONG.values(), ids=WRONG)
def test_a_part_that_is_wrong_away_from_the_start_is_refused_along_the_motion(scene, says):
    verify(scene)
    with pytest.raises(cb.BadInput, match=re.escape(says)):
        verify_along(scene)
    run = cb.prepare(scene, "scipy-dop853", rtol=1e-8, save_at=scene.t_end * np.arange(1, 9) / 8)()
    with pytest.raises(cb.BadInput, match=re.escape(says)):
        verify_at(scene, run.y)
    assert math.isfinite(run.y[-1, 0])


WELL = {"name": "well", "potential": lambda q: q[0] ** 2 / 2, "q": (1.0,), "p": (0.0,)}
PUSHED = {"name": "pushed", "potential": lambda q, t: q[0] ** 2 / 2 + t * q[0], "q": (1.0,), "p": (0.0,)}


def test_a_span_of_time_stands_for_the_start_and_the_duration():
    assert cb.Mechanical(**WELL, t_span=(0, 20)).t_end == 20
    assert cb.Mechanical(**WELL, t_span=None, t_end=20.0).t_end == 20
    pushed = cb.Driven(**PUSHED, t_span=(1, 60))
    assert (pushed.t, pushed.t_end) == (1, 59)
    again = pushed.with_(t_span=(2, 5))
    assert (again.t, again.t_end) == (2, 3)
    assert cb.Equations(name="e", rhs=lambda t, y: (-t * y[0],), y0=(1.0,), t_span=(1, 2)).t == 1


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"t_span": (1, 20)}, "must begin at 0"),
        ({"t_span": (0, -1)}, "must end later"),
        ({"t_span": (0, math.inf)}, r"t_span\[1\] = inf"),
        ({"t_span": 5}, "must be 2 numbers"),
        ({"t_span": (0, 5), "t_end": 5.0}, "t_end, not both"),
    ],
)
def test_a_span_that_is_none_is_refused(given, says):
    with pytest.raises(cb.BadInput, match=says):
        cb.Mechanical(**WELL, **given)
