"""Methods with an exact linear part: their flows, their orders at any damping, and where they are expanded."""

from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from mpmath import mp

import contactbench as cb
from contactbench.errors import BadInput
from contactbench.methods import contact_linear
from contactbench.scene.base import Elapsed
from contactbench.splitting import linear
from contactbench.splitting.linear import Split, expand
from contactbench.splitting.tables import LINEAR
from contactbench.truth import with_decimals
from properties import ROUND_OFF, close, contact_defect, contact_field, faulty, has_its_order, solves

METHODS = [cb.METHODS[composition.name] for composition in LINEAR]
LINEAR2, PLAIN = METHODS[:2]
PARTICLE = cb.SCENES["particle"]
CREEPING = PARTICLE.with_(name="creeping", gamma=50.0, t_end=200.0, s=0.3)
#: coupled modes of masses of their own: two that creep, one that swings
COUPLED = cb.Mechanical(
    name="coupled",
    potential=lambda q: (
        (q[0] ** 2 + 4 * q[1] ** 2 + q[0] * q[1] + 30 * q[2] ** 2) / 2
        + 0.3 * q[0] ** 2 * q[1]
        + 0.2 * q[0] * q[1] * q[2]
        + 0.05 * (q[0] + q[1] + q[2]) ** 4
    ),
    q=(1.0, 0.5, -0.1),
    p=(0.3, 0.0, 0.1),
    s=0.2,
    gamma=8.0,
    mass=(1.0, 2.0, 0.5),
    t_end=8.0,
)
#: ω² = 1 underdamped, critical, overdamped and fed; a saddle
OSCILLATORS = [
    cb.SCENES["oscillator"].with_(gamma=gamma) for gamma in (0.0, 0.3, 2.0, 2.0 + 1e-9, 50.0, -0.3)
]
SADDLE = cb.Mechanical(
    name="saddle", potential=lambda q: 3 - q[0] ** 2 / 2, q=(0.2,), p=(0.1,), s=0.4, gamma=1.5, t_end=4.0
)


def split_of(scene):
    return Split(with_decimals(scene, mp.mpf), expand(scene), mp)


def quadratic(split, x):
    d = split.positions(split.from_point(x.q))
    U = split.expansion.level + sum(k * c * c for k, c in zip(split.expansion.squares, d, strict=True)) / 2
    return split.scene.kinetic(x.p) + U + split.scene.gamma * x.s


def rest(split, x):
    return split.rest(x.q, True)[1]


def gradient_rest(split, h, x):
    force, W = split.rest(x.q, True)
    weights = Split.flows["gradient_kick"].constants(split, h, mp)[1]
    modes = split.momenta(force)
    return W - sum(w * m * m for w, m in zip(weights, modes, strict=True)) / (2 * h)


def flowed(split, name, x, h):
    flow = Split.flows[name]
    return flow.apply(split, x, flow.constants(split, h, mp), mp)


@pytest.mark.parametrize(
    "scene", [*OSCILLATORS, SADDLE, CREEPING, COUPLED], ids=lambda s: f"{s.name}-{s.gamma:g}"
)
def test_the_linear_part_is_an_exact_contact_flow(scene, mp50):
    split = split_of(scene)
    x, pack = split.scene.initial(("s",)), split.scene.pack

    def field(y):
        return contact_field(split.scene, partial(quadratic, split), split.scene.unpack(y, ("s",)))

    def flow(h):
        return pack(flowed(split, "swing", x, h))

    assert close(flow(mp.mpf(0)), pack(x), ROUND_OFF)
    assert solves(flow, field)


def test_kicks_are_flows_of_functions_of_the_position(mp50):
    """The potentials come out of the change of s, the forces out of their differences."""
    split = split_of(COUPLED)
    x, h = split.scene.initial(("s",)), mp.mpf("0.37")
    for name, potential in (
        ("kick", partial(rest, split)),
        ("gradient_kick", partial(gradient_rest, split, h)),
    ):
        after = flowed(split, name, x, h)
        slope = contact_field(split.scene, potential, x)
        moved = [b - a for a, b in zip(split.scene.pack(x), split.scene.pack(after), strict=True)]
        assert close(moved, [h * c for c in slope], 25)


@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)
@pytest.mark.parametrize("scene", [CREEPING, COUPLED], ids=lambda s: s.name)
def test_steps_are_contact_maps_under_strong_damping(method, scene):
    assert contact_defect(method, scene, "0.2", 3) < 1e-45


def test_the_processor_is_undone(mp50):
    split = split_of(CREEPING)
    x = split.scene.initial(("s",))
    settled = flowed(split, "settle", x, mp.mpf(3))
    assert max(map(abs, (a - b for a, b in zip(settled.p, x.p, strict=True)))) > 1e-3
    again = flowed(split, "unsettle", settled, mp.mpf(3))
    assert close(split.scene.pack(again), split.scene.pack(x), ROUND_OFF)


@pytest.mark.parametrize("composition", LINEAR, ids=lambda c: c.name)
def test_orders_at_fifty_digits_notice_every_wrong_coefficient(composition, mp50):
    def right(own):
        return has_its_order(contact_linear.linear_method(own), PARTICLE)

    assert right(composition)
    plain = replace(composition, processor=(), postprocessor=())
    assert not any(map(right, faulty(plain)[:4]))


@pytest.mark.parametrize("h", [0.05, 3.0, 700.0])
@pytest.mark.parametrize("scene", OSCILLATORS[:-1], ids=lambda s: f"{s.gamma:g}")
def test_linear_motion_is_exact_at_any_step(scene, h):
    times = h * np.arange(1, 5)
    solution = cb.solve(scene.with_(t_end=4 * h), LINEAR2, step=h, save_at=times)
    truth = cb.reference(scene, times).y
    assert np.abs(solution.y - truth).max() < 1e-14 * max(1, scene.gamma * h, h)


# -- strong damping --------------------------------------------------------------------------------
TRUTHS = {}


def truth(scene, times):
    """States by a pair of order eight, whose tolerance is the tightest."""
    key = scene.name, scene.gamma, *times
    if key not in TRUTHS:
        TRUTHS[key] = cb.solve(scene, "rkn12-10", rtol=1e-13, save_at=Elapsed(times)).y
    return TRUTHS[key]


def errors(scene, method, steps, count=10):
    """Return the largest errors of q and p at `count` times, by the number of steps between them."""
    times, n = scene.t_end / count * np.arange(1, count + 1), len(scene.q)
    found = []
    for each in steps:
        y = cb.solve(scene, method, step=scene.t_end / count / each, save_at=times).y
        off = np.abs(y - truth(scene, times)).max(axis=0)
        found.append((off[:n].max(), off[n : 2 * n].max()))
    return np.array(found)


def test_errors_at_gamma_50_are_those_of_the_derivation():
    q, p = errors(CREEPING, LINEAR2, (1, 2, 4, 8)).T
    assert q == pytest.approx([1.8e-4, 4.4e-5, 1.1e-5, 2.7e-6], rel=0.2)
    assert p == pytest.approx([4.2e-6, 1.05e-6, 2.6e-7, 6.5e-8], rel=0.2)
    counts = cb.solve(CREEPING, LINEAR2, step=20.0, save_at=[200.0]).counts
    assert (counts.steps, counts.evaluations) == (10, 20 + 4)


@pytest.mark.parametrize(("gamma", "end"), [(50.0, 200.0), (5.0, 40.0)])
def test_the_order_is_two_at_any_damping(gamma, end):
    """Halved steps divide the error by about four everywhere; without the processor there is a plateau."""
    scene, halved = CREEPING.with_(gamma=gamma, t_end=end), [2**k for k in range(13)]
    q = errors(scene, LINEAR2, halved)[:, 0]
    slopes = np.array([np.log2(a / b) for a, b in pairwise(q)])
    assert slopes.min() > 1.7
    assert slopes[:1] == pytest.approx([2.0], abs=0.1)
    assert slopes[-3:] == pytest.approx([2.0] * 3, abs=0.1)
    # of order one while γh > 1
    plain = errors(scene.with_(gamma=50.0, t_end=200.0), PLAIN, (1, 16))[:, 0]
    assert 4 < plain[0] / plain[1] < 32


@pytest.mark.parametrize(("constant", "factor"), [("NODES", 1.02), ("COTH", 1.02)])
def test_wrong_weights_are_noticed(constant, factor, monkeypatch):
    right = errors(CREEPING, LINEAR2, (64,))[0]
    if constant == "NODES":
        (first, weight), second = linear.NODES
        monkeypatch.setattr(linear, constant, ((first, factor * weight), second))
    else:
        monkeypatch.setattr(linear, "gradient_weight", lambda z, xp: factor / xp.sqrt(z))
    fresh = contact_linear.linear_method(LINEAR[0])
    assert (errors(CREEPING, fresh, (64,))[0] > 1.5 * right).any()


def test_several_modes_are_of_order_two_too():
    scene = COUPLED.with_(gamma=50.0, t_end=100.0)
    q = errors(scene, LINEAR2, (8, 16, 32))[:, 0]
    assert all(a / b > 3.4 for a, b in pairwise(q))


# -- the expansion ---------------------------------------------------------------------------------
def well(potential, q, **given):
    return cb.Mechanical(name="well", potential=potential, q=q, p=(0.0,) * len(q), t_end=1.0, **given)


@pytest.mark.parametrize(
    ("scene", "about", "squares"),
    [
        (well(lambda q: -cb.math.cos(q[0]), (2.0,)), (0.0,), (1.0,)),
        (well(lambda q: (q[0] ** 2 - 1) ** 2 / 4, (1.5,)), (1.0,), (2.0,)),
        (well(lambda q: (q[0] ** 2 - 1) ** 2 / 4, (-0.1,)), (-1.0,), (2.0,)),
        (well(lambda q: (1 - cb.math.exp(-q[0])) ** 2 / 2, (-0.7,), mass=4.0), (0.0,), (0.25,)),
        (well(lambda q: q[0] ** 2 / 2 + 5 * q[1] ** 2 + 3 * q[0], (0.3, 0.1)), (-3.0, 0.0), (1.0, 10.0)),
        (well(lambda q: cb.math.exp(5 * q[0]), (0.2,)), (0.2,), (0.0,)),  # no minimum
    ],
    ids=["pendulum", "right well", "left well", "morse", "shifted", "wall"],
)
def test_a_potential_is_expanded_about_the_minimum_downhill(scene, about, squares):
    expansion = expand(scene)
    assert expansion.about == pytest.approx(about, abs=1e-8)
    assert expansion.squares == pytest.approx(squares, abs=1e-6)


def test_the_point_may_be_given_and_is_checked():
    scene = well(lambda q: (q[0] ** 2 - 1) ** 2 / 4, (0.5,), gamma=20.0)
    runs = [
        cb.solve(scene, LINEAR2, step=0.01, save_at=[1.0], about=about).y for about in (None, (1.0,), (-1.0,))
    ]
    assert np.abs(runs[0] - runs[1]).max() < 1e-14
    assert 1e-14 < np.abs(runs[0] - runs[2]).max() < 1e-2
    with pytest.raises(BadInput, match="about"):
        cb.solve(scene, LINEAR2, step=0.01, about=(0.0, 1.0))
    with pytest.raises(BadInput, match="expands nothing"):
        cb.solve(scene, "contact-strang", step=0.01, about=(0.0,))


def test_it_refuses_what_has_no_such_part():
    assert "needs" in LINEAR2.refuses(cb.SCENES["rigid_body"])
    assert "needs" in LINEAR2.refuses(cb.SCENES["quadratic_damping"])
    assert LINEAR2.refuses(cb.SCENES["kepler"]) is None


def test_an_expansion_beside_the_centre_of_symmetry_claims_no_momentum():
    scene = cb.Mechanical(
        name="hat",
        potential=lambda q: (q[0] ** 2 + q[1] ** 2 - 1) ** 2 / 4,
        gamma=0.1,
        q=(1.2, 0.1),
        p=(0.1, 0.5),
        t_end=5.0,
        rotation_invariant=True,
    )
    claimed = cb.LAWS["momentum_law"].claimed
    runs = [cb.solve(scene, name, step=0.1) for name in ("contact-linear2-plain", "contact-strang")]
    assert [claimed(run) for run in runs] == [False, True]
    assert cb.LAWS["momentum_law"](runs[1]) < 1e-13
    assert cb.LAWS["momentum_law"](runs[0]) > 1e-4


def test_a_start_at_the_minimum_of_a_potential_is_not_solved_by_its_linear_part():
    pendulum = cb.Mechanical(
        name="swing", potential=lambda q: -cb.math.cos(q[0]), q=(0.0,), p=(1.0,), t_end=9.0
    )
    method = cb.METHODS["contact-linear2"]
    assert [method.solves(scene) for scene in (pendulum, cb.SCENES["oscillator"])] == [False, True]
