"""The Lie algebra that T + γs and V generate for polynomial potentials, and a method that rests on its relations.

An order puts as many conditions on a splitting of H into A = T + γs and B = V as a part of the Lie algebra that they
generate has dimensions: the span of the nested Jacobi brackets of so many A and B.  Linear relations that hold for
every V of a kind, such as {B, {B, {B, A}}} = 0 for all of them, save conditions.  Here they are counted without
rounding, as ranks of polynomials in q, p and s with rational coefficients.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

from contactbench.methods.contact import contact_method
from contactbench.numbers.protocol import Arithmetic
from contactbench.paper.geometry import SEED
from contactbench.paper.integrator import exact_order
from contactbench.paper.ledger import Evidence, claim
from contactbench.scene import Mechanical
from contactbench.splitting.composition import Composition, palindrome
from contactbench.splitting.modified import flow_of, logarithm
from contactbench.truth import decimal_context

#: coefficients by the exponents of q₁ … q_n, p₁ … p_n, s
Polynomial = dict[tuple[int, ...], Fraction]


def added(f: Polynomial, g: Polynomial, factor: Fraction | int = 1) -> Polynomial:
    total = {m: f.get(m, 0) + factor * g.get(m, 0) for m in f | g}
    return {m: Fraction(c) for m, c in total.items() if c}


def multiplied(f: Polynomial, g: Polynomial) -> Polynomial:
    found: Polynomial = {}
    for (a, c), (b, d) in itertools.product(f.items(), g.items()):
        m = tuple(i + j for i, j in zip(a, b, strict=True))
        found[m] = found.get(m, Fraction(0)) + c * d
    return {m: c for m, c in found.items() if c}


def derivative(f: Polynomial, i: int) -> Polynomial:
    return {(*m[:i], m[i] - 1, *m[i + 1 :]): c * m[i] for m, c in f.items() if m[i]}


def jacobi(f: Polynomial, g: Polynomial, n: int) -> Polynomial:
    """Return {f, g} = f_q·g_p − f_p·g_q + f_s (p·g_p − g) − g_s (p·f_p − f)."""

    def excess(h: Polynomial) -> Polynomial:
        """Return p·h_p − h."""
        return {m: c * (sum(m[n:-1]) - 1) for m, c in h.items() if sum(m[n:-1]) != 1}

    pairs = [(derivative(f, i), derivative(g, n + i), 1) for i in range(n)]
    pairs += [(derivative(f, n + i), derivative(g, i), -1) for i in range(n)]
    pairs += [(derivative(f, 2 * n), excess(g), 1), (derivative(g, 2 * n), excess(f), -1)]
    total: Polynomial = {}
    for a, b, sign in pairs:
        total = added(total, multiplied(a, b), sign)
    return total


def independent(polynomials: list[Polynomial]) -> list[Polynomial]:
    """Return the polynomials that are no linear combination of those before them, by elimination."""
    pivots: list[tuple[tuple[int, ...], Polynomial]] = []
    found = []
    for f in polynomials:
        rest = f
        for leading, row in pivots:
            rest = added(rest, row, -rest.get(leading, Fraction(0)))
        if rest:
            leading = min(rest)
            pivots.append((leading, {m: c / rest[leading] for m, c in rest.items()}))
            found.append(f)
    return found


def dimensions(degree: int, gamma: Fraction, seed: int, n: int = 2, brackets: int = 7) -> list[int]:
    """Return how many independent brackets of 1, 2, … factors T + γs and V have.

    degree : of V, a polynomial of n coordinates with all terms up to it, its coefficients whole numbers at random.  A
    relation that holds for all V holds for this one: the numbers are lower bounds, and exact but for bad luck.
    """
    rng = random.Random(seed)
    unit = [tuple(int(i == j) for j in range(2 * n + 1)) for i in range(2 * n + 1)]
    kinetic = {tuple(2 * k for k in unit[n + i]): Fraction(1, 2) for i in range(n)}
    drift = kinetic | ({unit[-1]: gamma} if gamma else {})
    powers = [m for m in itertools.product(range(degree + 1), repeat=n) if 0 < sum(m) <= degree]
    potential = {(*m, *[0] * (n + 1)): Fraction(rng.choice([-1, 1]) * rng.randint(1, 9)) for m in powers}
    generators = [drift, potential]
    last, found = generators, [2]
    for _ in range(brackets - 1):
        last = independent([jacobi(a, f, n) for a in generators for f in last])
        found.append(len(last))
    return found


# -- a method of order 6 for cubic potentials without damping -----------------------------------------
#: coefficients to start Newton's method from: of two kicks and drifts in turn, the others follow
START = ("0.6158150", "-0.4506223", "-0.2709868", "0.3860620", "0.4160251")


def conditions(*half: Any) -> list[Any]:
    """Return what must vanish for order 6 where {A, {A, {A, {A, B}}}} does: for cubic V at γ = 0."""
    words = logarithm(flow_of(palindrome_of(half)))

    def of(word: str) -> Any:
        return words[word + "AB"] - words.get(word + "BA", 0)

    return [of("A"), of("B"), of("AAB") + of("ABA"), of("BAA"), of("BAB") + of("BBA")]


def palindrome_of(half: Any) -> Any:
    """Return the stages as in `splitting.composition`, with numbers of any kind."""
    left = [*half, 0.5 - half[1] - half[3]]
    left.append(1 - 2 * sum(left[::2]))
    names = itertools.cycle(("kick", "drift_damp"))
    return tuple(zip(names, (*left, *left[-2::-1]), strict=False))


def for_cubic_potentials() -> Composition:
    context = decimal_context(60)
    half = context.findroot(conditions, START, solver="mdnewton", tol=1e-100)
    digits = [context.nstr(c, 55) for c in half]
    return Composition("cubic", 4, palindrome("kick", "drift_damp", digits), "made here", nystrom=True)


def henon_heiles(q: Sequence[Arithmetic]) -> Arithmetic:
    return (q[0] * q[0] + q[1] * q[1]) / 2 + q[0] * q[0] * q[1] - q[1] * q[1] * q[1] / 3


#: dimensions of the brackets of 1, …, 7 factors, by the degree of V: without damping, and with it
WITHOUT = {3: [2, 1, 2, 2, 3, 3, 6], 4: [2, 1, 2, 2, 4, 4, 8]}
WITH = [2, 1, 2, 2, 4, 5, 10]


@claim("X03")
def saved_conditions(seed: int = SEED, gamma: float = 0.1, damping: Fraction = Fraction(1, 3)) -> Evidence:
    """seed : of the potentials.  gamma : of the orders.  damping : of the dimensions."""
    for degree, without in WITHOUT.items():
        for name, rate, expected in (("undamped", Fraction(0), without), ("damped", damping, WITH)):
            found = dimensions(degree, rate, seed)
            yield {f"{name}_{degree}": " ".join(map(str, found))}
            yield max(abs(a - b) for a, b in zip(found, expected, strict=True))
    free = Mechanical(name="henon", potential=henon_heiles, q=(0.3, -0.2), p=(0.1, 0.4), t_end=2.0)
    method = contact_method(for_cubic_potentials())
    for scene, nominal in ((free.with_(gamma=0.0), 6), (free.with_(gamma=gamma), 4)):
        # the truth has thirty digits
        yield abs(exact_order(method, scene, times=2, coarsest=16, floor=1e-27) - nominal)
