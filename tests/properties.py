"""What must hold of every subflow, composition and method, as functions that say whether it does.

Used by the tests, and by the mutation check, which counts how many planted errors they notice.
"""

from __future__ import annotations

import math
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
from mpmath import mp

import contactbench as cb
from cases import TILTED, in_mp, random_state
from contactbench.measure.precision import local_order, order_at
from contactbench.scene import cross, dot, quaternion_product
from contactbench.splitting import elliptic, flows
from contactbench.splitting.free_body import free
from decimals import contact_defect, momentum_defect

PARTICLE, BODY, CENTRAL = (cb.SCENES[name] for name in ("particle", "rigid_body", "central"))
ANISOTROPIC = cb.SCENES["rigid_body_anisotropic"]
BOTH_DAMPINGS = PARTICLE.with_(name="both dampings", mass=1.7, kappa=0.6, s=0.4)
NEGATIVE = PARTICLE.with_(name="negative", mass=1.7, gamma=2.0, kappa=-0.5, s=0.4)
HEAVY = PARTICLE.with_(name="heavy", mass=1.7)
H = "0.37"
#: central differences of step 10⁻¹⁵ at 50 digits: truncation 10⁻³⁰, cancellation 10⁻³⁵
DELTA, DIFFERENCED = 15, 25
ROUND_OFF = 45


def small(values: Any, digits: int) -> bool:
    """Whether all are below 10^{−digits} (nan is not)."""
    return all(abs(value) < mp.mpf(10) ** -digits for value in values)


def differences(f: Any, y: list[Any]) -> list[Any]:
    """∂f/∂y_i by central differences."""
    delta = mp.mpf(10) ** -DELTA

    def moved(i: int, d: Any) -> Any:
        return f([c + d * (k == i) for k, c in enumerate(y)])

    return [(moved(i, delta) - moved(i, -delta)) / (2 * delta) for i in range(len(y))]


def contact_field(scene: Any, hamiltonian: Any, x: Any) -> list[Any]:
    """Packed contact vector field of a Hamiltonian of the state, from its differences alone."""
    slopes = differences(lambda y: hamiltonian(scene.unpack(y, scene.optional)), scene.pack(x))
    d = scene.unpack(slopes, scene.optional)
    if isinstance(scene, cb.Mechanical):
        p = [-a - d.s * b for a, b in zip(d.q, x.p, strict=True)]
        return [*d.p, *p, dot(x.p, d.p) - hamiltonian(x)]
    M = [a - d.s * b for a, b in zip(cross(x.M, d.M), x.M, strict=True)]
    R = [c / 2 for c in quaternion_product(x.R, (0, *d.M))]
    return [*M, *R, dot(x.M, d.M) - hamiltonian(x)]


def residual(scene: Any, flow: Any, field: Any, h: Any) -> list[Any]:
    """dΦ_h/dh − X(Φ_h), `flow` a function of h and `field` of the state, both packed on return."""
    delta = mp.mpf(10) ** -DELTA
    slope = [(a - b) / (2 * delta) for a, b in zip(flow(h + delta), flow(h - delta), strict=True)]
    here = scene.unpack(flow(h), scene.carry())
    return [a - b for a, b in zip(slope, field(here), strict=True)]


def applied(scene: Any, name: str, x: Any, h: Any, xp: Any = mp) -> list[Any]:
    """The named subflow for time h, packed."""
    flow = flows.flows_of(scene)[name]
    return scene.pack(flow.apply(scene, x, flow.constants(scene, h, xp), xp))


def mechanical_flows_solve_their_equations() -> bool:
    for scene in (HEAVY, BOTH_DAMPINGS, NEGATIVE):
        exact, x = in_mp(scene, random_state(scene, 31))
        parts = {
            "drift": lambda x, s=exact: s.kinetic(x.p),
            "kick": lambda x, s=exact: s.V(x.q),
            "damp": lambda x, s=exact: s.dissipation(x.s),
            "drift_damp": lambda x, s=exact: s.kinetic(x.p) + s.dissipation(x.s),
        }
        for name in flows.flows_of(scene):
            flow = lambda h, name=name: applied(exact, name, x, h)  # noqa: E731, B023
            field = lambda x, name=name: contact_field(exact, parts[name], x)  # noqa: E731, B023
            if not small([a - b for a, b in zip(flow(mp.mpf(0)), scene.pack(x), strict=True)], ROUND_OFF):
                return False
            if not small(residual(exact, flow, field, mp.mpf(H)), DIFFERENCED):
                return False
    return True


def body_flows_solve_their_equations() -> bool:
    """The two parts of the free body, which add up to its energy, and the damping; about each axis."""
    for inertia in ((0.8, 1.3, 2.1), (2.1, 0.8, 1.3), (1.3, 2.1, 0.8)):
        exact, x = in_mp(BODY.with_(inertia=inertia), random_state(BODY, 32))
        moments = list(map(mp.mpf, map(repr, inertia)))
        smallest, middle = (moments.index(i) for i in sorted(moments)[:2])
        slope = 1 / moments[smallest] - 1 / moments[middle]
        turn = lambda x, i=smallest, slope=slope: slope * x.M[i] ** 2 / 2  # noqa: E731
        parts = {
            "turn": turn,
            "top": lambda x, exact=exact, turn=turn: exact.energy(x) - turn(x),
            "damp": lambda x, exact=exact: exact.gamma * x.s,
        }  # `free` and `free_damp`: free_body_solves_its_equations
        for name, part in parts.items():
            flow = lambda h, name=name: applied(exact, name, x, h)  # noqa: E731, B023
            field = lambda x, part=part: contact_field(exact, part, x)  # noqa: E731, B023
            if not small(residual(exact, flow, field, mp.mpf(H)), DIFFERENCED):
                return False
    return True


def jacobi_functions_are_right(complements: Any = ("1", "0.6", "1e-3", "1e-16")) -> bool:
    """sn, cn, dn and K against mpmath, over several periods."""
    for m1 in map(mp.mpf, complements):
        with mp.workdps(80 + 2 * abs(int(mp.log10(m1)))):  # mpmath takes m, not 1 − m
            m, K = 1 - m1, mp.ellipk(1 - m1)
            points = [K * mp.mpf(x) for x in ("0.4", "-1.3", "2.1", "5.7")]
            truth = [[mp.ellipfun(kind, u, m=m) for kind in ("sn", "cn", "dn")] for u in points]
        for u, values in zip(points, truth, strict=True):
            mine = elliptic.jacobi(u, 1 - m1, m1, mp)
            if not small([a - b for a, b in zip(mine, [*values, K], strict=True)], ROUND_OFF):
                return False
    return True


def carlsons_integral_is_right() -> bool:
    for x, y, p in (("0", "0.3", "1.4"), ("0.2", "1", "1"), ("0.7", "0.1", "2"), ("1e-9", "1e-16", "1.001")):
        x, y, p = mp.mpf(x), mp.mpf(y), mp.mpf(p)
        mine = elliptic.carlson(mp.sqrt(x), mp.sqrt(y), p, (p - x) * (p - y) * (p - 1), mp)
        if not small([mine / mp.elliprj(x, y, 1, p) - 1], ROUND_OFF):
            return False
    return True


def carlsons_series_is_of_its_order() -> bool:
    """Each duplication divides its weight by 4 and what the series leaves out by 4⁸: no term of it is wrong."""

    class Fixed:
        def __getattr__(self, name: str) -> Any:
            return getattr(mp, name)

        def where(self, condition: Any, yes: Any, no: Any) -> Any:
            return yes if condition else no

    before, errors = elliptic.DUPLICATIONS, []
    x, y, p = mp.mpf("0.2"), mp.mpf("0.5"), mp.mpf("1.7")
    try:
        for elliptic.DUPLICATIONS in (6, 7):
            mine = elliptic.carlson(mp.sqrt(x), mp.sqrt(y), p, (p - x) * (p - y) * (p - 1), Fixed())
            errors.append(abs(mine - mp.elliprj(x, y, 1, p)))
    finally:
        elliptic.DUPLICATIONS = before
    return abs(mp.log(errors[0] / errors[1], 4) - 9) < 0.02


#: bodies of either handedness; momenta that circle the first and the last axis, each seen from either axis
MOTIONS = [
    ((2.1, 0.8, 0.9), (-0.15, -0.3, -0.9)),  # most wrong signs are noticed on the first
    ((0.8, 2.0, 2.1), (-0.2, 0.9, 0.3)), ((1.3, 2.1, 0.8), (0.9, -0.7, 0.8)), ((0.8, 1.3, 2.1), (-0.1, 0.4, 1.2)),
    ((0.8, 1.3, 2.1), (1.2, 0.3, -0.4)), ((2.1, 1.3, 0.8), (0.3, -0.2, 0.9)), ((1.3, 0.8, 2.1), (-0.6, 0.5, 0.4)),
]  # fmt: skip


def free_body_solves_its_equations() -> bool:
    """H0 alone, and with damping, for times before and after, within the first half period and not; M and s too."""
    for inertia, M in MOTIONS:
        body = BODY.with_(inertia=inertia, M=M, gamma=0.3, R=(0.1, 0.7, -0.5, 0.5), s=0.2)
        exact, x = in_mp(body, body.initial(body.carry()))
        parts = {"free": exact.energy, "free_damp": lambda x, s=exact: s.energy(x) + s.gamma * x.s}
        for name, part in parts.items():
            field = lambda x, part=part: contact_field(exact, part, x)  # noqa: E731, B023

            def flow(h: Any, name: str = name) -> list[Any]:
                return attitude_signed(applied(exact, name, x, h))  # noqa: B023

            if not small(
                [a - b for a, b in zip(flow(mp.mpf(0)), attitude_signed(exact.pack(x)), strict=True)],
                ROUND_OFF,
            ):
                return False
            for h in map(mp.mpf, ("0.37", "-2.3", "9.1")):
                if not small(residual(exact, flow, field, h), DIFFERENCED):
                    return False
                y = x  # in short pieces: a wrong number of half periods has no slope
                for _ in range(6):
                    y = exact.unpack(applied(exact, name, y, h / 6), body.carry())
                pieces = attitude_signed(exact.pack(y))
                if not small([a - b for a, b in zip(flow(h), pieces, strict=True)], ROUND_OFF - 2):
                    return False
    return True


def turns_have_length_one() -> bool:
    """In double precision, on average over 4000 turns: what is off has one sign and adds up along a run.

    Measured 1.5·10⁻¹⁷, and 4·10⁻¹⁷ where the turn is not scaled; the average itself is known to 10⁻¹⁸.
    """
    total, turns = Fraction(0), 1000
    for inertia, M in MOTIONS[:4]:
        body = BODY.with_(inertia=inertia, M=M)
        x = body.initial(("R",))
        for _ in range(turns):
            x = free(body, x._replace(R=(1.0, 0.0, 0.0, 0.0)), 0.1, math)
            total += (sum(Fraction(c) ** 2 for c in x.R) - 1) / 2
    return abs(total / (4 * turns)) < 2.5e-17


def attitude_signed(y: list[Any]) -> list[Any]:
    """A packed body state with the largest entry of its quaternion positive."""
    side = max(y[3:7], key=abs)
    return [*y[:3], *(c * side / abs(side) for c in y[3:7]), y[7]]


def flows_know_their_factors() -> bool:
    """∂s(h)/∂s = c + p(h)·∂q(h)/∂s by differences, which is Φ*η = c η on ∂_s."""
    for scene in (HEAVY, BOTH_DAMPINGS, NEGATIVE, BODY):
        exact, x = in_mp(scene, random_state(scene, 35))
        for name, flow in flows.flows_of(scene).items():
            for h in map(mp.mpf, ("0.37", "4.1")):  # γh weak and strong
                flowed = lambda s, name=name, h=h: applied(exact, name, x._replace(s=s), h)  # noqa: E731, B023
                delta = mp.mpf(10) ** -DELTA
                slope = [
                    (a - b) / (2 * delta)
                    for a, b in zip(flowed(x.s + delta), flowed(x.s - delta), strict=True)
                ]
                carry = scene.carry()
                pulled = exact.contact_form(exact.unpack(flowed(x.s), carry), exact.unpack(slope, carry))
                c = mp.exp(flow.log_factor(exact, x, h, mp))
                if not small([(pulled - c) / c], DIFFERENCED):
                    return False
    return True


def anisotropic_damping_solves_its_equation() -> bool:
    """A full D is held as the eigenvectors of float64: orthogonal to 16 digits, whatever the arithmetic."""
    for scene, digits in ((ANISOTROPIC, DIFFERENCED), (TILTED, 15)):
        exact, x = in_mp(scene, random_state(scene, 33))
        field = lambda x, s=exact: [*(-m for m in s.damp_matrix_function(x.M, lambda r: r)), 0, 0, 0, 0]  # noqa: E731
        flow = lambda h, s=exact, x=x: applied(s, "damp", x, h)  # noqa: E731
        if not small(residual(exact, flow, field, mp.mpf(H)), digits):
            return False
    return True


def cubic_flow(s: Any, h: Any, xp: Any) -> Any:
    """s' = −s/10 − s³/4 in closed form."""
    return xp.exp(-h / 10) * s / xp.sqrt(1 - 5 * s * s * xp.expm1(-h / 5) / 2)


GENERAL = cb.GeneralDamping(
    name="general", potential=CENTRAL.potential, gradient=CENTRAL.gradient, parameters=CENTRAL.parameters,
    q=(1.0, 0.0), p=(0.3, 0.8), s=0.7, t_end=4.0,
    damping=lambda s: s / 10 + s * s * s / 4, damping_slope=lambda s: 0.1 + 3 * s * s / 4,
)  # fmt: skip


def general_damping_is_right() -> bool:
    """By quadrature on doubles, against the closed form and its slope ∂s(h)/∂s, which p decays by; at rest too."""
    damp = flows.GENERAL["damp"]
    for s, h in ((0.7, 0.3), (-0.4, 0.8), (2.0, 0.8), (0.6, -0.2), (0.0, 0.5)):
        x = GENERAL.initial(("s",))._replace(s=s)
        mine = damp.apply(GENERAL, x, damp.constants(GENERAL, h, math), math)
        with mp.workdps(40):
            flow = partial(cubic_flow, h=mp.mpf(h), xp=mp)
            true, factor = flow(mp.mpf(s)), mp.diff(flow, s)
        gaps = [mine.s - true, *(a - factor * b for a, b in zip(mine.p, x.p, strict=True))]
        gaps.append(damp.log_factor(GENERAL, x, h, math) - mp.log(factor))
        if not small(gaps, 10):
            return False
    return True


def flows_agree_on_arrays() -> bool:
    """NumPy arrays (an ensemble), which take the branches traced numbers take, against mpmath."""
    for scene in (HEAVY, BOTH_DAMPINGS, NEGATIVE, BODY):
        x = random_state(scene, 34)
        exact, z = in_mp(scene, x)
        twin = scene.with_numbers([np.float64(v) for v in scene.numbers()])
        ensemble = scene.unpack([np.array([v, v]) for v in scene.pack(x)], scene.carry())
        for name in flows.flows_of(scene):
            mine = np.array(applied(twin, name, ensemble, np.float64(H), np))
            truth = np.array([float(c) for c in applied(exact, name, z, mp.mpf(H))])
            if not np.allclose(mine, truth[:, None], rtol=1e-13, atol=1e-13):
                return False
    return True


def parts_applied(composition: Any) -> dict[str, Any]:
    """For how many steps each part of the Hamiltonian acts in one step."""
    total: dict[str, Any] = {}
    for name, coefficient in composition.run(1):
        for part in name.split("_"):
            total[part] = total.get(part, 0) + coefficient
    return total


def consistent(composition: Any) -> bool:
    return parts_applied(composition) == {"kick": 1, "drift": 1, "damp": 1}


def runs_on(method: Any, *scenes: Any) -> list[Any]:
    return [scene for scene in scenes if method.refuses(scene) is None]


def has_its_order(method: Any, *scenes: Any, n: int = 20) -> bool:
    """The claimed order, to 0.1, from n, 2n and 4n steps to t = 1."""
    return all(
        abs(order_at(method, scene, 1.0, n) - method.order) < 0.1 for scene in runs_on(method, *scenes)
    )


def has_its_local_order(method: Any, *scenes: Any) -> bool:
    """The claimed order, to 0.01, of a step of 10⁻⁶: its own error is as small as the step."""
    return all(abs(local_order(method, scene) - method.order) < 0.01 for scene in runs_on(method, *scenes))


def has_its_conformal_factor(method: Any, *scenes: Any) -> bool:
    return small([contact_defect(method, scene, "0.2", 2) for scene in runs_on(method, *scenes)], ROUND_OFF)


def has_its_momentum_law(method: Any, *scenes: Any) -> bool:
    return small([momentum_defect(method, scene, "0.2", 4) for scene in runs_on(method, *scenes)], ROUND_OFF)
