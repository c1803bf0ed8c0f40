"""Jacobi's elliptic functions and Carlson's integral of the third kind in plain arithmetic of a number namespace.

Moduli come with their complements, m and m1 = 1 − m ≥ SMALLEST, so that nothing is lost towards m = 1.
Loops stop when they have converged; on arrays and traced numbers they have a fixed length instead,
enough for double precision.
"""

from __future__ import annotations

from typing import Any

from contactbench.numbers.control import choose, scan, unwind

#: the smallest complement: quarter periods up to 323
SMALLEST = 1e-280
#: Landen steps and duplications to double precision from there; both only halve the exponent of a small
#: complement before they converge for good
LANDEN_STEPS, DUPLICATIONS = 12, 13


def jacobi(u: Any, m: Any, m1: Any, xp: Any) -> tuple[Any, Any, Any, Any]:
    """Return sn, cn, dn of (u | m), and the quarter period K(m).

    Descending Landen transformations, DLMF 22.7.2–22.7.4 with 22.7.1 for the moduli: k → (1 − k')/(1 + k'),
    until sn, cn, dn are sin, cos, 1.  All terms are of one sign, so that cn and dn keep their relative
    accuracy where they are small.
    """

    def descend(x: Any) -> tuple[Any, Any]:
        m, complement, scale = x
        over = 1 / (1 + complement)
        k, rest = m * over * over, 2 * complement * over  # the next modulus, and 1 less it
        return (k * k, 2 * xp.sqrt(complement) * over, scale / (2 * over)), (k, rest)

    def ascend(x: Any, moduli: Any) -> Any:
        (sn, cn, dn), (k, rest) = x, moduli
        over = 1 / (1 + k * sn * sn)
        rising, falling, dn = (1 + k) * sn * over, cn * dn * over, (rest + k * cn * cn) * over
        over = 1 / xp.sqrt(
            rising * rising + falling * falling
        )  # 1, but for errors that would treble every level
        return rising * over, falling * over, dn

    one = xp.cos(0 * u * m)  # as a number of the engine's kind
    start = (m * one, xp.sqrt(m1) * one, one)
    (_, _, scale), ladder = scan(descend, start, LANDEN_STEPS, lambda x: x[0], xp)
    sn, cn, dn = unwind(ascend, (xp.sin(u * scale), xp.cos(u * scale), one), ladder, xp)
    return sn, cn, dn, xp.pi / (2 * scale)


def carlson(root_x: Any, root_y: Any, p: Any, excess: Any, xp: Any) -> Any:
    """Return R_J(x, y, 1, p) from √x and √y; 0 ≤ x ≤ 1, 0 < y ≤ 1 ≤ p.

    excess : (p − x)(p − y)(p − 1) ≥ 0, which the caller knows without cancellation.
    Duplication: Carlson, Numer. Algorithms 10, 13 (1995), doi:10.1007/BF02198293, algorithm for R_J;
    series to the seventh degree, DLMF 19.36.2.
    """
    one = xp.cos(0 * root_x * root_y * p)  # as a number of the engine's kind
    x, y = root_x * root_x * one, root_y * root_y * one
    mean = (x + y + 1 + 2 * p) / 5
    away = (mean - x, mean - y, mean - 1)

    def duplicate(carried: Any) -> tuple[Any, None]:
        (x, y, z, p, mean), (rx, ry, rz), fourth, excess, total = carried
        rp = xp.sqrt(p)
        d = (rp + rx) * (rp + ry) * (rp + rz)
        total = total + fourth * arc(excess / (d * d), xp) / d
        step = rx * ry + ry * rz + rz * rx
        x, y, z, p, mean = ((c + step) / 4 for c in (x, y, z, p, mean))
        roots = (xp.sqrt(x), xp.sqrt(y), xp.sqrt(z))
        return ((x, y, z, p, mean), roots, fourth / 4, excess / 64, total), None

    def left_out(carried: Any) -> Any:
        """Return the size of the first term beyond the series; that of p is at most 3/2 of the largest here."""
        (*_, mean), _, fourth, _, _ = carried
        return (2 * fourth * max(map(abs, away)) / mean) ** 8

    start = ((x, y, one, p * one, mean), (root_x * one, root_y * one, one), one, excess * one, 0 * one)
    ((*_, mean), _, fourth, _, total), _ = scan(duplicate, start, DUPLICATIONS, left_out, xp)
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


def arc(e: Any, xp: Any) -> Any:
    """Return R_C(1, 1 + e) = atan(√e)/√e, e ≥ 0."""
    flat = e == 0
    root = xp.sqrt(choose(flat, 1.0, e, xp))  # 1: no derivative of √0 is taken
    return choose(flat, 1.0, xp.atan(root) / root, xp)


def bent_part(sn: Any, cn: Any, dn: Any, m: Any, bend: Any, xp: Any) -> Any:
    """Return ∫₀ᵘ sn²/(1 + ν sn²) du at the u ∈ [−K, K] of these sn, cn ≥ 0, dn; ν = bend ≥ 0.

    It is (u − Π(−ν; u | m))/ν without the cancellation: sn³ R_J(cn², dn², 1, 1 + ν sn²)/3, DLMF 19.25.14.
    """
    square = sn * sn
    excess = bend * (1 + bend) * (m + bend) * square * square * square
    return sn * square * carlson(cn, dn, 1 + bend * square, excess, xp) / 3
