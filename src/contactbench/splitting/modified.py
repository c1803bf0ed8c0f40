"""The modified Hamiltonian of a splitting: the numerical flow is its exact flow, up to a power of h.

A composition of kicks B = V and damped drifts A = T + γs is the flow, for the time h, of

    H̃ = A + B + Σ h^{n−1} Z_n(A, B),   n = 2, 3, …,   (Baker, Campbell, Hausdorff)

with Z_n a Lie polynomial of degree n in the Jacobi bracket {f, g} = f_q·g_p − f_p·g_q + f_s (p·g_p − g) −
g_s (p·f_p − f).  The coefficients come from the logarithm of the product of exponentials in the free associative
algebra, the words of it turned into nested brackets by Dynkin's theorem: Z_n = (1/n) Σ c_w {w₁, {w₂, … {…, w_n}}}.
The functions come from dual numbers.

{A, B} does not depend on s; for any such g, {A, g} = −(v·g_q − γ p·g_p) − γ g and {B, g} = ∇V·g_p, v = p/m, which
again do not.  Hence ∂H̃/∂s = γ, and H̃ decays as e^{−γt} along the numerical solution, as H does along the true one:
Hairer, Lubich, Wanner, Geometric Numerical Integration, §IX, for the contact case Vermeeren, Bravetti, Seri,
J. Phys. A 52, 445206 (2019), doi:10.1088/1751-8121/ab4767.

The composition must be a palindrome: terms of even degree vanish, and with them the sign in [X_f, X_g] = ±X_{f, g}.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from functools import cache
from math import factorial
from typing import Any

from contactbench.numbers.dual import Dual, slope, value
from contactbench.numbers.protocol import Arithmetic, Vector
from contactbench.scene import Mechanical, State, dot, scaled
from contactbench.scene.base import Numeric
from contactbench.splitting.composition import Composition, Stage

#: words of A and B, with coefficients
Words = dict[str, Fraction]
LETTERS = {"drift_damp": "A", "kick": "B"}
#: highest degree of the brackets: H̃ up to h⁴ with an error O(h⁶)
DEGREE = 5


def product(a: Words, b: Words) -> Words:
    found: Words = {}
    for left, c in a.items():
        for right, d in b.items():
            if len(left) + len(right) <= DEGREE:
                found[left + right] = found.get(left + right, Fraction(0)) + c * d
    return found


def flow_of(stages: Iterable[Stage]) -> Words:
    whole: Words = {"": Fraction(1)}
    for name, c in stages:
        powers = {LETTERS[name] * k: c**k / factorial(k) for k in range(DEGREE + 1)}
        whole = product(whole, powers)
    return whole


def logarithm(series: Words) -> Words:
    rest = {word: c for word, c in series.items() if word}
    found: Words = {}
    power: Words = {"": Fraction(1)}
    for k in range(1, DEGREE + 1):
        power = product(power, rest)
        for word, c in power.items():
            found[word] = found.get(word, 0) - c * Fraction((-1) ** k, k)
    return found


@cache
def weights(stages: tuple[Stage, ...]) -> Words:
    """Return the nonzero factors of {w₁, {… {w_k, {A, B}}}} in H̃, by w₁…w_k."""
    words = logarithm(flow_of(stages))
    found = {
        word[:-2]: (words[word] - words.get(word[:-2] + "BA", Fraction(0))) / len(word)
        for word in words
        if len(word) > 2 and word.endswith("AB")
    }
    # {B, {B, {A, B}}} = 0: {A, B} is linear in p
    return {word: c for word, c in found.items() if c and not word.endswith("BB")}


def bracket(scene: Mechanical, letters: str) -> Callable[[Vector, Vector], Arithmetic]:
    """Return {w₁, {w₂, … {w_k, {A, B}}}} as a function of q and p."""
    if not letters:
        return lambda q, p: -(dot(scene.dV(q), scaled(scene.inverse_mass, p)) + scene.gamma * scene.V(q))
    inner = bracket(scene, letters[1:])

    def kicked(q: Vector, p: Vector) -> Arithmetic:
        return slope(inner(lift(q, [0.0] * len(q)), lift(p, scene.dV(q))))

    def drifted(q: Vector, p: Vector) -> Arithmetic:
        velocity, loss = (scaled(c, p) for c in (scene.inverse_mass, -scene.gamma))
        found = inner(lift(q, velocity), lift(p, loss))
        return -(slope(found) + scene.gamma * value(found))

    return drifted if letters[0] == "A" else kicked


def lift(x: Vector, direction: Sequence[Arithmetic]) -> Vector:
    """Return the vector as dual numbers that vary in a direction."""
    return tuple(Dual(a, b) for a, b in zip(x, direction, strict=True))


def modified_hamiltonian(
    scene: Any, composition: Composition, x: State, h: Arithmetic, degree: int = DEGREE
) -> Numeric:
    """Return H̃ at x for steps h, by brackets of up to `degree` parts, with an error O(h^{degree+1}); needs s."""
    total = scene.hamiltonian_at(x)
    for letters, c in weights(composition.stages).items():
        n = len(letters) + 2
        if n <= degree:
            total = total + float(c) * h ** (n - 1) * bracket(scene, letters)(x.q, x.p)
    return total
