"""The free rigid body solved exactly: momentum by Jacobi's functions, attitude by an integral of the third kind.

Axes 1, 2, 3 by increasing moment of inertia, a = 1/I, differences of them a_ij = |a_i − a_j|.  M circles
axis i and never crosses the plane M_i = 0: (i, k) = (1, 3) or (3, 1) by the sign of D = a₁₂M₁² − a₂₃M₃².
With W = a_ik M_i² + a_2k M₂², V = a_i2 M₂² + a_ik M_k², both constant, λ² = a_i2 W, m = a_2k V/λ²,
1 − m = a_ik |D|/λ²; s, c, d = sn, cn, dn(λt | m); S = s/λ; N = c² + a_ik a_i2 M_i² S²:

    M₂ → (M₂ c d ± a_ik M_k M_i S)/N,   M_k → (M_k c ∓ a_i2 M₂ M_i S d)/N,   M_i → (M_i d ∓ a_2k M₂ M_k S c)/N,

upper signs where axes 1, 2, 3 are right-handed: the addition theorems, with no phase to be found and no
difference in N.  Landau, Lifshitz, Mechanics, §37.

The attitude turns M(t) into the constant R M.  Let C(z) take the direction z of M to an axis e, first about e and
then across it; then R(t) = R(0) C(z₀)⁻¹ Rot_e(ψ) C(z), ψ' = L (2E − a_e M_e²)/(L² − M_e²).  e = k where W ≥ V and e =
i elsewhere keeps z more than 45° away from e all the time, and the characteristic −ν of the integral in [−1, 0]: ν =
V/W or a_2k/a_i2, and ψ' = L (a_i or a_k) ± L a₁₃ ν sn²/(1 + ν sn²), where the second term is never more than half
of the first.  Celledoni, Fassò, Säfström, Zanna, SIAM J. Sci. Comput. 30, 2084 (2008), doi:10.1137/070704393; van
Zon, Schofield, J. Comput. Phys. 225, 145 (2007), doi:10.1016/j.jcp.2006.11.019.

Jacobi's functions and Carlson's integral of the third kind are plain arithmetic.  Moduli come with their complements,
m and m1 = 1 − m ≥ SMALLEST, so that nothing is lost towards m = 1.  Loops stop when they have converged; on arrays and
traced numbers they have a fixed length instead, enough for double precision.  Derivatives through the moduli are right
to ε/√(1 − m) alone: to 10⁻⁸ of a body 10⁻⁸ off its middle axis, whose values have all digits.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from contactbench.numbers.control import choose, scan, settle, unwind
from contactbench.numbers.protocol import Arithmetic, Condition, Namespace
from contactbench.scene.algebra import BodyState, Vector, dot, quaternion_product

if TYPE_CHECKING:
    from contactbench.scene.rigid_body import RigidBody

#: λt beyond which a body exactly on the middle axis is not followed (it stays; its derivative is e^{λt})
FARTHEST = 300.0


class Course(NamedTuple):
    """The constants of a motion, for ‖M‖ = 1.

    first : M circles axis 1, not 3.  about_k : e is k, not i (a sphere: the one farther from M).
    i2, k2, ik : differences of inverse moments.  V, W : see the module.
    rate, m, m1 : λ and the moduli.  still : λ = 0, nothing changes M.
    """

    first: Condition
    about_k: Condition
    i2: Arithmetic
    k2: Arithmetic
    ik: Arithmetic
    V: Arithmetic
    W: Arithmetic
    rate: Arithmetic
    m: Arithmetic
    m1: Arithmetic
    still: Condition


def handedness(scene: RigidBody) -> int:
    smallest, middle, _ = scene.by_inertia
    return 1 if middle == (smallest + 1) % 3 else -1


def course(scene: RigidBody, z: Vector, xp: Namespace) -> Course:
    I1, I2, I3 = (scene.inertia[axis] for axis in scene.by_inertia)
    z1, z2, z3 = (z[axis] for axis in scene.by_inertia)
    a12, a23, a13 = (I2 - I1) / (I1 * I2), (I3 - I2) / (I2 * I3), (I3 - I1) / (I1 * I3)
    D = a12 * z1 * z1 - a23 * z3 * z3
    first = D >= 0
    i2, k2 = choose(first, a12, a23, xp), choose(first, a23, a12, xp)
    zi, zk = choose(first, z1, z3, xp), choose(first, z3, z1, xp)
    W = a13 * zi * zi + k2 * z2 * z2
    V = i2 * z2 * z2 + a13 * zk * zk
    square = i2 * W
    still = square == 0
    square = choose(still, 1.0, square, xp)
    m1 = a13 * choose(first, D, -D, xp) / square
    m1 = choose(m1 > SMALLEST, m1, SMALLEST, xp)
    about_k = choose(V == 0, choose(W == 0, zk * zk <= zi * zi, W >= V, xp), W >= V, xp)
    rate = xp.sqrt(square)
    m, m1 = choose(still, 0.0, k2 * V / square, xp), choose(still, 1.0, m1, xp)
    return Course(first, about_k, i2, k2, a13, V, W, rate, m, m1, still)


def free(scene: RigidBody, x: BodyState, t: Arithmetic, xp: Namespace) -> BodyState:
    """Return the exact flow of ½ M·I⁻¹M for any time, up to round-off of the phase λt; ‖M‖ and J = R M are kept."""
    s = None if x.s is None else x.s + t * scene.kinetic(x)
    L, z, resting = polar(x.M, xp)
    tau = choose(resting, 0.0 * t, L * t, xp)
    motion = settle(course(scene, z, xp), xp)
    turned, passed = settle(momentum(scene, motion, z, tau, xp), xp)
    M = tuple(choose(resting, m, L * c, xp) for m, c in zip(x.M, turned, strict=True))
    if x.R is None:
        return BodyState(M, None, s)
    angle = precession(scene, motion, z, turned, tau, passed, xp)
    moved = attitude(scene, motion, z, turned, angle, xp)
    at_rest = (1.0, *(t * w / 2 for w in scene.angular_velocity(x.M)))  # its value and its derivative
    moved = tuple(choose(resting, a, b, xp) for a, b in zip(at_rest, moved, strict=True))
    return settle(BodyState(M, quaternion_product(x.R, moved), s), xp)


def polar(v: Vector, xp: Namespace) -> tuple[Arithmetic, Vector, Condition]:
    """Return ‖v‖, v/‖v‖, without underflow, and whether v is zero: then 1 and the first axis."""
    largest: Arithmetic = 0.0
    for c in v:
        size = choose(c < 0, -c, c, xp)
        largest = choose(size > largest, size, largest, xp)
    zero = largest == 0
    largest = choose(zero, 1.0, largest, xp)
    scaled = [choose(zero, float(axis == 0), c / largest, xp) for axis, c in enumerate(v)]
    size = xp.sqrt(dot(scaled, scaled))
    return largest * size, tuple(c / size for c in scaled), zero


def components(
    scene: RigidBody, motion: Course, z: Vector, xp: Namespace
) -> tuple[Arithmetic, Arithmetic, Arithmetic]:
    z1, z2, z3 = (z[axis] for axis in scene.by_inertia)
    return choose(motion.first, z1, z3, xp), z2, choose(motion.first, z3, z1, xp)


def clamp(v: Arithmetic, xp: Namespace) -> Arithmetic:
    return choose(v > FARTHEST, FARTHEST, choose(v < -FARTHEST, -FARTHEST, v, xp), xp)


def momentum(
    scene: RigidBody, motion: Course, z: Vector, tau: Arithmetic, xp: Namespace
) -> tuple[Vector, Vector]:
    """Return the direction of M at time tau; the argument v = λ·tau, its sn, cn and dn, and the quarter period K."""
    _, _, i2, k2, ik, _, _, rate, m, m1, still = motion
    zi, z2, zk = components(scene, motion, z, xp)
    v = choose(zi == 0, clamp(rate * tau, xp), rate * tau, xp)
    sn, cn, dn, K = jacobi(v, m, m1, xp)
    passed = (v, sn, cn, dn, K)
    S, cn, dn = (choose(still, a, b, xp) for a, b in ((tau, sn / rate), (1.0, cn), (1.0, dn)))
    side = handedness(scene) * S
    over = 1 / (cn * cn + ik * i2 * zi * zi * S * S)
    new2 = (z2 * cn * dn + side * ik * zk * zi) * over
    newk = (zk * cn - side * i2 * z2 * zi * dn) * over
    newi = (zi * dn - side * k2 * z2 * zk * cn) * over
    over = 1 / xp.sqrt(newi * newi + new2 * new2 + newk * newk)
    by_inertia = (choose(motion.first, newi, newk, xp), new2, choose(motion.first, newk, newi, xp))
    moved = dict(zip(scene.by_inertia, (c * over for c in by_inertia), strict=True))
    return tuple(moved[axis] for axis in range(3)), passed


def precession(
    scene: RigidBody,
    motion: Course,
    z: Vector,
    turned: Vector,
    tau: Arithmetic,
    passed: Vector,
    xp: Namespace,
) -> Arithmetic:
    """Return ψ, the angle by which the frame has turned about M.

    Of the bent part from u₀ to u₀ + v, that from 0 to v is an integral, and the addition theorem for Π has
    the rest, DLMF 19.11(i) written with Jacobi's functions; for ν ≤ 1 its arctangent never wraps.
    """
    first, about_k, i2, k2, ik, V, W, rate, m, m1, still = motion
    smallest, _, largest = (scene.inverse_inertia[axis] for axis in scene.by_inertia)
    whole, inner = choose(W == 0, 1.0, W, xp), choose(i2 == 0, 1.0, i2, xp)  # 0 only where nothing moves
    bend = choose(about_k, V / whole, k2 / inner, xp)
    base = choose(first, choose(about_k, smallest, largest, xp), choose(about_k, largest, smallest, xp), xp)
    v, sn, cn, dn, K = passed
    back = cn < 0  # v is an odd number of half periods from [−K, K], else an even one
    halves = 2 * xp.floor(v / (4 * K) + choose(back, 0.0, 0.5, xp)) + choose(back, 1.0, 0.0, xp)
    part = bent_part(choose(back, -sn, sn, xp), choose(back, -cn, cn, xp), dn, m, bend, xp)
    part = part + 2 * halves * bent_part(1.0, 0.0, xp.sqrt(m1), m, bend, xp)
    sn0, _, _ = phase(scene, motion, z, xp)
    sn1, cn1, dn1 = phase(scene, motion, turned, xp)
    zi = components(scene, motion, z, xp)[0]
    onward = choose(zi < 0, -handedness(scene), handedness(scene), xp)
    both = onward * sn0 * sn
    ratio = both * sn1 / (1 + bend * (sn1 * sn1 - both * cn1 * dn1))
    rest = onward * ratio * arc(bend * (1 + bend) * (m + bend) * ratio * ratio, xp)
    angle = base * tau + sense(motion, xp) * ik * bend * (part + rest) / rate
    steady = tau * dot(z, scene.angular_velocity(z))
    return choose(still, steady, choose(zi == 0, steady, angle, xp), xp)


def phase(
    scene: RigidBody, motion: Course, z: Vector, xp: Namespace
) -> tuple[Arithmetic, Arithmetic, Arithmetic]:
    zi, z2, zk = components(scene, motion, z, xp)
    sn, cn = z2 * xp.sqrt(motion.i2), zk * xp.sqrt(motion.ik)
    square = sn * sn + cn * cn
    axis = square == 0
    size = xp.sqrt(choose(axis, 1.0, square, xp))
    dn = choose(zi < 0, -zi, zi, xp) * xp.sqrt(motion.ik / choose(motion.W == 0, 1.0, motion.W, xp))
    return choose(axis, 0.0, sn / size, xp), choose(axis, 1.0, cn / size, xp), dn


def sense(motion: Course, xp: Namespace) -> Arithmetic:
    """Return the sign of the bent part of ψ: −1 if the axis e of the frame is axis 3, 1 if it is axis 1."""
    return choose(motion.first, 1.0, -1.0, xp) * choose(motion.about_k, -1.0, 1.0, xp)


def attitude(
    scene: RigidBody, motion: Course, z: Vector, turned: Vector, angle: Arithmetic, xp: Namespace
) -> Vector:
    """Return C(z)⁻¹ Rot_e(angle) C(turned) as a quaternion."""
    smallest, _, largest = scene.by_inertia
    on_smallest = sense(motion, xp) > 0

    def local(y: Vector) -> Vector:
        return tuple(choose(on_smallest, y[(smallest + j) % 3], y[(largest + j) % 3], xp) for j in range(3))

    w, *v = frame(local(z), xp)
    spun = quaternion_product((xp.cos(angle / 2), xp.sin(angle / 2), 0.0, 0.0), frame(local(turned), xp))
    w, *v = quaternion_product((w, *(-c for c in v)), spun)
    body = [choose(on_smallest, v[(j - smallest) % 3], v[(j - largest) % 3], xp) for j in range(3)]
    turn = (w, *body)
    # 1/‖turn‖ to first order: its error has one sign and adds up over many steps, on average 4·10⁻¹⁷ a turn
    # without this factor and 1.5·10⁻¹⁷ with it
    unit = (3 - dot(turn, turn)) / 2
    return tuple(unit * c for c in turn)


def frame(z: Vector, xp: Namespace) -> Vector:
    """Return C(z) for z = (cos θ, sin θ cos φ, sin θ sin φ), sin θ > 0: Rot₃(−θ) Rot₁(−φ), taking z to (1, 0, 0)."""
    across = xp.sqrt(z[1] * z[1] + z[2] * z[2])
    cos, sin = z[1] / across, z[2] / across
    tilt = xp.sqrt((1 + z[0]) / 2)
    ahead = cos >= 0
    large = xp.sqrt((1 + choose(ahead, cos, -cos, xp)) / 2)
    small = sin / (2 * large)
    half = (choose(ahead, large, small, xp), choose(ahead, small, large, xp))
    return quaternion_product((tilt, 0.0, 0.0, -across / (2 * tilt)), (half[0], -half[1], 0.0, 0.0))


# -- elliptic functions ----------------------------------------------------------------------------
Three = tuple[Arithmetic, Arithmetic, Arithmetic]
#: the smallest complement: quarter periods up to 323
SMALLEST = 1e-280
#: Landen steps and duplications to double precision from there; both only halve the exponent of a small
#: complement before they converge for good
LANDEN_STEPS, DUPLICATIONS = 12, 13


def jacobi(u: Arithmetic, m: Arithmetic, m1: Arithmetic, xp: Namespace) -> Vector:
    """Return sn, cn, dn of (u | m), and the quarter period K(m).

    Descending Landen transformations, DLMF 22.7.2–22.7.4 with 22.7.1 for the moduli: k → (1 − k')/(1 + k'),
    until sn, cn, dn are sin, cos, 1.  All terms are of one sign, so that cn and dn keep their relative
    accuracy where they are small.
    """

    def descend(x: Three) -> tuple[Three, Vector]:
        m, complement, scale = x
        over = 1 / (1 + complement)
        k, rest = m * over * over, 2 * complement * over  # the next modulus, and 1 less it
        return (k * k, 2 * xp.sqrt(complement) * over, scale / (2 * over)), (k, rest)

    def ascend(x: Three, moduli: Vector) -> Three:
        (sn, cn, dn), (k, rest) = x, moduli
        over = 1 / (1 + k * sn * sn)
        rising, falling, dn = (1 + k) * sn * over, cn * dn * over, (rest + k * cn * cn) * over
        # 1, but for errors that would treble every level
        over = 1 / xp.sqrt(rising * rising + falling * falling)
        return rising * over, falling * over, dn

    one = xp.cos(0 * u * m)  # as a number of the engine's kind
    start = (m * one, xp.sqrt(m1) * one, one)
    (_, _, scale), ladder = scan(descend, start, LANDEN_STEPS, lambda x: x[0], xp)
    sn, cn, dn = unwind(ascend, (xp.sin(u * scale), xp.cos(u * scale), one), ladder, xp)
    return sn, cn, dn, xp.pi / (2 * scale)


#: variables of its duplication: the arguments and their mean, roots, the factor of a term, the excess, the sum
Terms = tuple[Vector, Vector, Arithmetic, Arithmetic, Arithmetic]


def carlson(
    root_x: Arithmetic, root_y: Arithmetic, p: Arithmetic, excess: Arithmetic, xp: Namespace
) -> Arithmetic:
    """Return R_J(x, y, 1, p) from √x and √y; 0 ≤ x ≤ 1, 0 < y ≤ 1 ≤ p.

    excess : (p − x)(p − y)(p − 1) ≥ 0, which the caller knows without cancellation.  Duplication: Carlson, Numer.
    Algorithms 10, 13 (1995), doi:10.1007/BF02198293, algorithm for R_J; series to the seventh degree, DLMF 19.36.2.
    """
    one = xp.cos(0 * root_x * root_y * p)  # as a number of the engine's kind
    x, y = root_x * root_x * one, root_y * root_y * one
    mean = (x + y + 1 + 2 * p) / 5
    away = (mean - x, mean - y, mean - 1)

    def duplicate(carried: Terms) -> tuple[Terms, None]:
        (x, y, z, p, mean), (rx, ry, rz), fourth, excess, total = carried
        rp = xp.sqrt(p)
        d = (rp + rx) * (rp + ry) * (rp + rz)
        total = total + fourth * arc(excess / (d * d), xp) / d
        step = rx * ry + ry * rz + rz * rx
        x, y, z, p, mean = ((c + step) / 4 for c in (x, y, z, p, mean))
        roots = (xp.sqrt(x), xp.sqrt(y), xp.sqrt(z))
        return ((x, y, z, p, mean), roots, fourth / 4, excess / 64, total), None

    def left_out(carried: Terms) -> Arithmetic:
        """Return the size of the first term beyond the series; the one of p is at most 3/2 of the largest here."""
        (*_, mean), _, fourth, _, _ = carried
        share: Arithmetic = 2 * fourth * max(map(abs, away)) / mean
        return share**8

    start: Terms = ((x, y, one, p * one, mean), (root_x * one, root_y * one, one), one, excess * one, 0 * one)
    carried, _ = scan(duplicate, start, DUPLICATIONS, left_out, xp)
    (*_, mean), _, fourth, _, total = carried
    X, Y, Z = (fourth * c / mean for c in away)
    P = -(X + Y + Z) / 2
    product = X * Y * Z
    E2 = X * Y + Y * Z + Z * X - 3 * P * P
    E3 = product + 2 * E2 * P + 4 * P * P * P
    E4 = (2 * product + E2 * P + 3 * P * P * P) * P
    E5 = product * P * P
    series = 1 - 3 * E2 / 14 + E3 / 6 + 9 * E2 * E2 / 88 - 3 * E4 / 22 - 9 * E2 * E3 / 52 + 3 * E5 / 26
    series = series - E2 * E2 * E2 / 16 + 3 * E3 * E3 / 40 + 3 * E2 * E4 / 20 + 45 * E2 * E2 * E3 / 272
    series = series - 9 * (E3 * E4 + E2 * E5) / 68
    return fourth * series / (mean * xp.sqrt(mean)) + 6 * total


def arc(e: Arithmetic, xp: Namespace) -> Arithmetic:
    """Return R_C(1, 1 + e) = atan(√e)/√e, e ≥ 0."""
    flat = e == 0
    root = xp.sqrt(choose(flat, 1.0, e, xp))  # 1: no derivative of √0 is taken
    return choose(flat, 1.0, xp.atan(root) / root, xp)


def bent_part(
    sn: Arithmetic, cn: Arithmetic, dn: Arithmetic, m: Arithmetic, bend: Arithmetic, xp: Namespace
) -> Arithmetic:
    """Return ∫₀ᵘ sn²/(1 + ν sn²) du at the u ∈ [−K, K] of these sn, cn ≥ 0, dn; ν = bend ≥ 0.

    It is (u − Π(−ν; u | m))/ν without the cancellation: sn³ R_J(cn², dn², 1, 1 + ν sn²)/3, DLMF 19.25.14.
    """
    square = sn * sn
    excess = bend * (1 + bend) * (m + bend) * square * square * square
    return sn * square * carlson(cn, dn, 1 + bend * square, excess, xp) / 3
