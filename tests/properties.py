"""What must hold of every subflow, composition and method, as functions that say whether it does."""

import math
from dataclasses import replace
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
from mpmath import mp

import contactbench as cb
from cases import TILTED, in_mp, random_state
from contactbench.measure.order import DIGITS, march, order_at
from contactbench.numbers.control import XlaNumbers
from contactbench.numbers.protocol import Numbers, abilities
from contactbench.scene import Scene, cross, dot, free_body, quaternion_product
from contactbench.scene import flow as flow_module
from contactbench.scene.general_damping import decayed
from contactbench.splitting.composition import merge
from contactbench.truth import decimal_context, with_decimals
from contactbench.xla import jax

PARTICLE, BODY, CENTRAL = (cb.SCENES[name] for name in ("particle", "rigid_body", "central"))
ANISOTROPIC = cb.SCENES["rigid_body_anisotropic"]
BOTH_DAMPINGS = PARTICLE.with_(name="both dampings", mass=1.7, kappa=0.6, s=0.4)
NEGATIVE = PARTICLE.with_(name="negative", mass=1.7, gamma=2.0, kappa=-0.5, s=0.4)
HEAVY = PARTICLE.with_(name="heavy", mass=1.7)
FED = PARTICLE.with_(name="fed", gamma=-0.4)
H = "0.37"
#: central differences of step 10⁻¹⁵ at 50 digits: truncation 10⁻³⁰, cancellation 10⁻³⁵
DELTA, DIFFERENCED = 15, 25
ROUND_OFF = 45


def close(a, b, digits):
    """Whether two lists of numbers differ by less than 10^{−digits} (nan does not)."""
    return all(abs(x - y) < mp.mpf(10) ** -digits for x, y in zip(a, b, strict=True))


def slope(f, at):
    delta = mp.mpf(10) ** -DELTA
    return [(a - b) / (2 * delta) for a, b in zip(f(at + delta), f(at - delta), strict=True)]


def contact_field(scene, hamiltonian, x):
    """Packed contact vector field of a Hamiltonian of the state, from its differences alone."""
    y = scene.pack(x)

    def along(i, c):
        return [hamiltonian(scene.unpack([*y[:i], c, *y[i + 1 :]], scene.optional))]

    d = scene.unpack([slope(partial(along, i), c)[0] for i, c in enumerate(y)], scene.optional)
    if isinstance(scene, cb.Mechanical):
        p = [-a - d.s * b for a, b in zip(d.q, x.p, strict=True)]
        return [*d.p, *p, dot(x.p, d.p) - hamiltonian(x)]
    M = [a - d.s * b for a, b in zip(cross(x.M, d.M), x.M, strict=True)]
    R = [c / 2 for c in quaternion_product(x.R, (0, *d.M))]
    return [*M, *R, dot(x.M, d.M) - hamiltonian(x)]


def flowed(scene, name, x, h, xp=mp):
    flow = scene.flows[name]
    return scene.pack(flow.apply(scene, x, flow.constants(scene, h, xp), xp))


def solves(flow, field, h=H, digits=DIFFERENCED):
    """Whether dΦ_h/dh = X(Φ_h), `flow` a function of h and `field` of the packed state."""
    h = mp.mpf(h)
    return close(slope(flow, h), field(flow(h)), digits)


def subflow_solves(scene, name, x, hamiltonian):
    """Whether a subflow begins with the identity and follows the contact field of its Hamiltonian."""

    def field(y):
        return contact_field(scene, hamiltonian, scene.unpack(y, scene.carry()))

    flow = partial(flowed, scene, name, x)
    return close(flow(mp.mpf(0)), scene.pack(x), ROUND_OFF) and solves(flow, field)


def mechanical_flows_solve_their_equations(scenes=(HEAVY, BOTH_DAMPINGS, NEGATIVE, FED)):
    def solve(scene):
        exact, x = in_mp(scene, random_state(scene, 31))
        parts = {
            "drift": lambda x: exact.kinetic(x.p),
            "kick": lambda x: exact.V(x.q),
            "damp": lambda x: exact.dissipation(x.s),
            "drift_damp": lambda x: exact.kinetic(x.p) + exact.dissipation(x.s),
        }
        return all(subflow_solves(exact, name, x, part) for name, part in parts.items())

    return all(map(solve, scenes))


def body_flows_solve_their_equations():
    """The two parts of the free body, which add up to its energy, and the damping; about each axis."""

    def solve(inertia):
        exact, x = in_mp(BODY.with_(inertia=inertia), random_state(BODY, 32))
        smallest, middle, _ = sorted(range(3), key=lambda i: inertia[i])
        moments = [mp.mpf(repr(moment)) for moment in inertia]
        rate = 1 / moments[smallest] - 1 / moments[middle]

        def turn(x):
            return rate * x.M[smallest] ** 2 / 2

        parts = {
            "turn": turn,
            "top": lambda x: exact.energy(x) - turn(x),
            "damp": lambda x: exact.gamma * x.s,
        }  # `free` and `free_damp`: free_body_solves_its_equations
        return all(subflow_solves(exact, name, x, part) for name, part in parts.items())

    return all(map(solve, ((0.8, 1.3, 2.1), (2.1, 0.8, 1.3), (1.3, 2.1, 0.8))))


def jacobi_functions_are_right(complements=("1", "0.6", "1e-3", "1e-16", "1e-120")):
    """sn, cn, dn and K against mpmath, over several periods."""

    def is_right(m1):
        with mp.workdps(80 + 2 * abs(int(mp.log10(m1)))):  # mpmath takes m, not 1 − m
            m, K = 1 - m1, mp.ellipk(1 - m1)
            points = [K * mp.mpf(x) for x in ("0.4", "-1.3", "2.1", "5.7")]
            truth = [[mp.ellipfun(kind, u, m=m) for kind in ("sn", "cn", "dn")] for u in points]
        mine = [free_body.jacobi(u, 1 - m1, m1, mp) for u in points]
        return all(close(a, [*b, K], ROUND_OFF) for a, b in zip(mine, truth, strict=True))

    return all(map(is_right, map(mp.mpf, complements)))


class Fixed(Numbers):
    """A namespace of plain numbers that takes the branches and loops of arrays."""

    def __init__(self, xp):
        self.xp, self.abilities = xp, abilities(xp)._replace(branch=False)

    def __getattr__(self, name):
        return getattr(self.xp, name)

    @staticmethod
    def where(condition, yes, no):
        return yes if condition else no


def carlson(x, y, p, xp=mp):
    return free_body.carlson(mp.sqrt(x), mp.sqrt(y), p, (p - x) * (p - y) * (p - 1), xp)


def carlsons_integral_is_right():
    cases = ("0 0.3 1.4", "0.2 1 1", "0.7 0.1 2", "1e-9 1e-16 1.001")
    given = [list(map(mp.mpf, case.split())) for case in cases]
    return all(close([carlson(x, y, p) / mp.elliprj(x, y, 1, p)], [1], ROUND_OFF) for x, y, p in given)


def carlsons_series_is_of_its_order():
    """Each duplication divides its weight by 4 and what the series leaves out by 4⁸: no term of it is wrong."""
    before, errors = free_body.DUPLICATIONS, []
    x, y, p = mp.mpf("0.2"), mp.mpf("0.5"), mp.mpf("1.7")
    try:
        for free_body.DUPLICATIONS in (6, 7):
            errors.append(abs(carlson(x, y, p, Fixed(mp)) - mp.elliprj(x, y, 1, p)))
    finally:
        free_body.DUPLICATIONS = before
    return abs(mp.log(errors[0] / errors[1], 4) - 9) < 0.02


#: inertia and momentum: bodies of either handedness; momenta that circle the first and the last axis, seen from each
MOTIONS = [
    ((2.1, 0.8, 0.9), (-0.15, -0.3, -0.9)),  # most wrong signs are noticed on the first
    ((0.8, 2.0, 2.1), (-0.2, 0.9, 0.3)),
    ((1.3, 2.1, 0.8), (0.9, -0.7, 0.8)),
    ((0.8, 1.3, 2.1), (-0.1, 0.4, 1.2)),
    ((0.8, 1.3, 2.1), (1.2, 0.3, -0.4)),
    ((2.1, 1.3, 0.8), (0.3, -0.2, 0.9)),
    ((1.3, 0.8, 2.1), (-0.6, 0.5, 0.4)),
]


def free_body_solves_its_equations():
    """H0 alone, and with damping, for times before and after, within the first half period and not; M and s too."""

    def solve(motion):
        inertia, M = motion
        body = BODY.with_(inertia=inertia, M=M, gamma=0.3, R=(0.1, 0.7, -0.5, 0.5), s=0.2)
        exact, x = in_mp(body, body.initial(body.carry()))
        parts = {"free": exact.energy, "free_damp": lambda x: exact.energy(x) + exact.gamma * x.s}
        return all(is_flow(exact, x, *part) for part in parts.items())

    def is_flow(exact, x, name, part):
        def flow(h):
            return signed(flowed(exact, name, x, h))

        def field(y):
            return contact_field(exact, part, exact.unpack(y, exact.carry()))

        def pieces(h):
            """In short pieces: a wrong number of half periods has no slope."""
            y = x
            for _ in range(6):
                y = exact.unpack(flowed(exact, name, y, h / 6), exact.carry())
            return signed(exact.pack(y))

        times = list(map(mp.mpf, ("0.37", "-2.3", "9.1")))
        return close(flow(mp.mpf(0)), signed(exact.pack(x)), ROUND_OFF) and all(
            solves(flow, field, h) and close(flow(h), pieces(h), ROUND_OFF - 2) for h in times
        )

    return all(map(solve, MOTIONS))


def signed(y):
    """A packed body state with the largest entry of its quaternion positive."""
    side = max(y[3:7], key=abs)
    return [*y[:3], *(c * side / abs(side) for c in y[3:7]), y[7]]


def anisotropic_damping_solves_its_equation():
    """A full D is held as the eigenvectors of float64: orthogonal to 16 digits, whatever the arithmetic."""

    def solve(scene, digits):
        exact, x = in_mp(scene, random_state(scene, 33))

        def field(y):
            return [*(-m for m in exact.damp_matrix_function(tuple(y[:3]), lambda rate: rate)), 0, 0, 0, 0]

        return solves(partial(flowed, exact, "damp", x), field, digits=digits)

    return solve(ANISOTROPIC, DIFFERENCED) and solve(TILTED, 15)


def cubic_flow(s, h, xp):
    """s' = −s/10 − s³/4 in closed form."""
    return xp.exp(-h / 10) * s / xp.sqrt(1 - 5 * s * s * xp.expm1(-h / 5) / 2)


GENERAL = cb.GeneralDamping(
    name="general",
    **{name: getattr(CENTRAL, name) for name in ("potential", "gradient", "parameters")},
    q=(1.0, 0.0),
    p=(0.3, 0.8),
    s=0.7,
    t_end=4.0,
    damping=lambda s: s / 10 + s * s * s / 4,
    damping_slope=lambda s: 0.1 + 3 * s * s / 4,
)


def general_damping_is_right():
    """By quadrature on doubles, against the closed form and its slope ∂s(h)/∂s, which p decays by; at rest too."""

    def is_right(s, h):
        x, damp = GENERAL.initial(("s",))._replace(s=s), GENERAL.flows["damp"]
        mine = damp.apply(GENERAL, x, damp.constants(GENERAL, h, math), math)
        with mp.workdps(40):
            flow = partial(cubic_flow, h=mp.mpf(h), xp=mp)
            true, factor = flow(mp.mpf(s)), mp.diff(flow, s)
        mine = [mine.s, *mine.p, decayed(GENERAL, s, h, math)[1]]
        return close(mine, [true, *(factor * p for p in x.p), mp.log(factor)], 10)

    return all(is_right(s, h) for s, h in ((0.7, 0.3), (-0.4, 0.8), (2.0, 0.8), (0.6, -0.2), (0.0, 0.5)))


def the_damped_time_is_smooth():
    """Derivatives of φ(h) by γ at γ = 0, where it chooses."""
    h = 0.7

    def clock(gamma):
        return flow_module.damped_time(gamma, h, XlaNumbers())

    with jax.enable_x64(True):
        mine = jax.jit(jax.grad(clock))(0.0), jax.jit(jax.grad(jax.grad(clock)))(0.0)
    return close(map(float, mine), (-(h**2) / 2, h**3 / 3), 10)


def flows_agree_on_arrays():
    """NumPy arrays, which take the branches traced numbers take, against mpmath."""

    def agrees(scene, name):
        x = random_state(scene, 34)
        exact, z = in_mp(scene, x)
        twin = scene.with_numbers([np.float64(v) for v in scene.numbers()])
        arrays = scene.unpack([np.array([v, v]) for v in scene.pack(x)], scene.carry())
        mine = np.array(flowed(twin, name, arrays, np.float64(H), np))
        truth = np.array([float(c) for c in flowed(exact, name, z, mp.mpf(H))])
        return np.allclose(mine, truth[:, None], rtol=1e-13, atol=1e-13)

    scenes = (HEAVY, BOTH_DAMPINGS, NEGATIVE, BODY)
    return all(agrees(scene, name) for scene in scenes for name in scene.flows)


def run(composition, n):
    """The stages of n steps, from start to end."""
    return merge((*composition.processor, *composition.stages * n, *reversed(composition.processor)))


def consistent(composition):
    """Whether each part of the Hamiltonian acts for one whole step."""
    total = {}
    for name, coefficient in run(composition, 1):
        for part in name.split("_"):
            total[part] = total.get(part, 0) + coefficient
    return total == {"kick": 1, "drift": 1, "damp": 1}


def faulty(composition):
    """The composition with one coefficient a part in a thousand larger, for each of them."""
    found = []
    for which in ("stages", "processor"):
        stages = getattr(composition, which)
        for k, (name, c) in enumerate(stages):
            other = (*stages[:k], (name, c * Fraction(1001, 1000)), *stages[k + 1 :])
            found.append(replace(composition, **{which: other}))
    return found


def runs_on(method, *scenes):
    return [scene for scene in scenes if method.refuses(scene) is None]


def has_its_order(method, *scenes):
    """The claimed order, to 0.1, from 20, 40 and 80 steps to t = 1."""
    scenes = runs_on(method, *scenes)
    return all(abs(order_at(method, scene, 1.0, 20) - method.order) < 0.1 for scene in scenes)


def has_its_conformal_factor(method, *scenes):
    defects = [contact_defect(method, scene, "0.2", 2) for scene in runs_on(method, *scenes)]
    return close(defects, [0] * len(defects), ROUND_OFF)


def has_its_momentum_law(method, *scenes):
    defects = [momentum_defect(method, scene, "0.2", 4) for scene in runs_on(method, *scenes)]
    return close(defects, [0] * len(defects), ROUND_OFF)


# -- of numerical maps in extended precision ---------------------------------------------------------
#: a map is differentiated by central differences of step 10^{-50} at 150 digits: truncation and
#: cancellation both leave 10^{-100}
DERIVATIVE_DIGITS = 150
DIFFERENCE = -50


def pullback(method: Any, scene: Scene, step: str, n: int) -> tuple[list[Any], list[Any]]:
    """η(Φ)·DΦ and η at the start, each on the scene's tangents, for n steps; mpmath numbers."""
    context = decimal_context(DERIVATIVE_DIGITS)
    twin = with_decimals(scene, context.mpf)
    x = twin.initial(scene.carry())
    start, delta = twin.pack(x), context.mpf(10) ** DIFFERENCE
    end = twin.unpack(march(method, scene, step, n, context), scene.carry())
    pulled, form = [], []
    for v in twin.tangents(x):
        ahead, behind = (
            march(
                method, scene, step, n, context, [a + d * b for a, b in zip(start, twin.pack(v), strict=True)]
            )
            for d in (delta, -delta)
        )
        pushed = [(a - b) / (2 * delta) for a, b in zip(ahead, behind, strict=True)]
        pulled.append(twin.contact_form(end, twin.unpack(pushed, scene.carry())))
        form.append(twin.contact_form(x, v))
    return pulled, form


def contact_defect(method: Any, scene: Scene, step: str, n: int) -> Any:
    """‖Φ*η − cⁿ η‖ / ‖cⁿ η‖ for n steps, c the method's own conformal factor."""
    context = decimal_context(DERIVATIVE_DIGITS)
    pulled, form = pullback(method, scene, step, n)
    twin = with_decimals(scene, context.mpf)
    factor = method.conformal_factor(twin, context.mpf(step), context) ** n
    difference = context.norm([a - factor * b for a, b in zip(pulled, form, strict=True)])
    return difference / abs(factor) / context.norm(form)


def momentum_defect(method: Any, scene: Scene, step: str, n: int) -> Any:
    """‖J(y_n) − cⁿ J(y_0)‖ / ‖cⁿ J(y_0)‖ after n steps, c the method's own conformal factor."""
    context = decimal_context(DIGITS)
    twin = with_decimals(scene, context.mpf)
    before = twin.momentum_at(twin.initial(scene.carry()))
    after = twin.momentum_at(twin.unpack(march(method, scene, step, n, context), scene.carry()))
    factor = method.conformal_factor(twin, context.mpf(step), context) ** n
    assert before is not None
    assert after is not None
    difference = context.norm([a - factor * b for a, b in zip(after, before, strict=True)])
    return difference / abs(factor) / context.norm(before)
