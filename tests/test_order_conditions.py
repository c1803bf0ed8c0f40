"""The coefficient tables solve the order conditions, and are the published ones.

In the free associative algebra of the two parts, words up to the order, a composition is a product of
exponentials and must equal exp(A + B).  For Nyström tables it need only do so modulo the ideal of
[B, [B, [B, A]]], the bracket that vanishes for kicks.  No integration, no scene.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import product
from math import factorial

import pytest
from mpmath import mp

from contactbench.composition import COMPOSITIONS, Composition

LETTERS = {"kick": "B", "drift_damp": "A"}
TWO_PART = [c for c in COMPOSITIONS if c.two_part]
#: B, [B, [B, [B, A]]] written out
BRACKET = {"BBBA": 1, "BBAB": -3, "BABB": 3, "ABBB": -1}

#: as printed; the rest of each table follows from symmetry and consistency
PUBLISHED = {
    "contact-bm4": [
        "0.0792036964311957", "0.209515106613362", "0.353172906049774", "-0.143851773179818", "-0.0420650803577195",
    ],
    "contact-bm6": [
        "0.0502627644003922", "0.148816447901042", "0.413514300428344", "-0.132385865767784", "0.0450798897943977",
        "0.067307604692185", "-0.188054853819569", "0.432666402578175", "0.541960678450780",
    ],
    "contact-rkn4": [
        "0.0829844064174052", "0.245298957184271", "0.396309801498368", "0.604872665711080", "-0.0390563049223486",
    ],
    "contact-rkn6": [
        "0.0414649985182624", "0.123229775946271", "0.198128671918067", "0.290553797799558", "-0.0400061921041533",
        "-0.127049212625417", "0.0752539843015807", "-0.246331761062075", "-0.0115113874206879", "0.357208872795928",
    ],
    # a Strang step of size γ1, then γ2, …: kicks are half sums, drifts the γ themselves
    "contact-o8": [
        "0.06510124154444504043940882", "0.13020248308889008087881763", "0.34568273243199923272039104",
        "0.56116298177510838456196441", "0.08584400956513054907694293", "-0.38947496264484728640807860",
    ],
}  # fmt: skip


def words(length: int) -> list[str]:
    return ["".join(letters) for letters in product("AB", repeat=length)]


def expanded(composition: Composition, degree: int) -> dict[str, mp.mpf]:
    """The product of exponentials, as coefficients of words up to `degree`."""
    x = {"": mp.mpf(1)}
    for name, c in composition.stages:
        letter, factor = LETTERS[name], mp.mpf(c.numerator) / c.denominator
        new: dict[str, mp.mpf] = {}
        for word, value in x.items():
            for k in range(degree - len(word) + 1):
                new[word + letter * k] = new.get(word + letter * k, 0) + value * factor**k / factorial(k)
        x = new
    return x


def functionals(length: int) -> list[list[Fraction]]:
    """A basis of the functionals on words of a length that vanish on the ideal of the bracket."""
    all_words = words(length)
    position = {word: i for i, word in enumerate(all_words)}
    rows = []
    for before in range(length - 3):
        for u in words(before):
            for v in words(length - 4 - before):
                row = [Fraction(0)] * len(all_words)
                for word, coefficient in BRACKET.items():
                    row[position[u + word + v]] += coefficient
                rows.append(row)
    pivots: list[int] = []
    for column in range(len(all_words)):
        pivot = next((r for r in range(len(pivots), len(rows)) if rows[r][column]), None)
        if pivot is None:
            continue
        here = len(pivots)
        rows[here], rows[pivot] = rows[pivot], rows[here]
        rows[here] = [value / rows[here][column] for value in rows[here]]
        for r in range(len(rows)):
            if r != here and rows[r][column]:
                rows[r] = [a - rows[r][column] * b for a, b in zip(rows[r], rows[here], strict=True)]
        pivots.append(column)
    basis = []
    for free in sorted(set(range(len(all_words))) - set(pivots)):
        functional = [Fraction(0)] * len(all_words)
        functional[free] = Fraction(1)
        for r, column in enumerate(pivots):
            functional[column] = -rows[r][free]
        basis.append(functional)
    return basis


def defect(composition: Composition, degree: int) -> mp.mpf:
    """The largest violated condition of a degree."""
    x, target = expanded(composition, degree), mp.mpf(1) / factorial(degree)
    errors = [x.get(word, 0) - target for word in words(degree)]
    if not composition.nystrom or degree < 4:
        return max(map(abs, errors))
    return max(
        abs(
            mp.fsum(
                mp.mpf(f.numerator) / f.denominator * e for f, e in zip(functional, errors, strict=True) if f
            )
        )
        for functional in functionals(degree)
    )


@pytest.mark.parametrize("composition", TWO_PART, ids=lambda c: c.name)
def test_the_order_conditions_hold_to_45_digits_up_to_the_order_and_no_further(composition, mp50):
    for degree in range(1, composition.order + 1):
        assert defect(composition, degree) < mp.mpf(10) ** -45, degree
    assert defect(composition, composition.order + 1) > mp.mpf(10) ** -9


@pytest.mark.parametrize("composition", [c for c in TWO_PART if c.nystrom], ids=lambda c: c.name)
def test_nystrom_tables_need_the_bracket_to_vanish(composition, mp50):
    """As general splittings they are of lower order: they are refused where the bracket is not zero."""
    plain = Composition(composition.name, composition.order, composition.stages, "")
    assert max(defect(plain, degree) for degree in range(1, composition.order + 1)) > mp.mpf(10) ** -6


@pytest.mark.parametrize("name", list(PUBLISHED))
def test_tables_are_the_published_ones(name):
    composition = next(c for c in COMPOSITIONS if c.name == name)
    assert composition.palindromic
    for (_, mine), printed in zip(composition.stages, PUBLISHED[name], strict=False):
        unit = Fraction(1, 10 ** len(printed.partition(".")[2]))
        assert abs(mine - Fraction(printed)) < 7 * unit  # the conditions pin fewer digits than are printed
