"""The coefficient tables solve the order conditions, and are the published ones.

In the free associative algebra of the two parts, words up to the order, n steps of a composition are a
product of exponentials and must equal exp(n(A + B)); processed ones for n = 1 and n = 2, from which
every n follows.  For Nyström tables it need only do so modulo the ideal of
[B, [B, [B, A]]], the bracket that vanishes for kicks.  No integration, no scene.
"""

from dataclasses import replace
from fractions import Fraction
from functools import cache
from itertools import product
from math import factorial

import pytest
from mpmath import mp

from contactbench.splitting.composition import Composition
from contactbench.splitting.tables import COMPOSITIONS, LINEAR
from properties import run

#: of fixed-point numbers: 66 digits after the point
BITS = 220
LETTERS = {"kick": "B", "drift_damp": "A"}
TWO_PART = [c for c in COMPOSITIONS if c.two_part]
#: B, [B, [B, [B, A]]] written out
BRACKET = {"BBBA": 1, "BBAB": -3, "BABB": 3, "ABBB": -1}

#: the first as printed, which say which of their solutions it is; the conditions hold for no other digit of the rest
PUBLISHED = {
    "contact-bm6": "0.0502627644003922 0.148816447901042 0.413514300428344 -0.132385865767784",
    "contact-rkn4": "0.0829844064174052 0.245298957184271 0.396309801498368 0.604872665711080",
    "contact-rkn6": "0.0414649985182624 0.123229775946271 0.198128671918067 0.290553797799558",
    # a Strang step of size γ1, then γ2, …: kicks are half sums, drifts the γ themselves
    "contact-o8": "0.06510124154444504043940882 0.13020248308889008087881763 0.34568273243199923272039104",
}


def words(length: int) -> list[str]:
    return ["".join(letters) for letters in product("AB", repeat=length)]


def expanded(composition: Composition, steps: int, degree: int) -> dict[str, mp.mpf]:
    """The product of exponentials, as coefficients of words up to `degree`.

    In integer multiples of 2^−BITS: each of some 10⁵ products is off by one at most.
    """
    x = {"": 1 << BITS}
    for name, c in run(composition, steps):
        letter = LETTERS[name]
        series = [
            (letter * k, (c.numerator**k << BITS) // (c.denominator**k * factorial(k)))
            for k in range(degree + 1)
        ]
        new: dict[str, int] = {}
        for word, value in x.items():
            for letters, factor in series[: degree - len(word) + 1]:
                longer = word + letters
                new[longer] = new.get(longer, 0) + (value * factor >> BITS)
        x = new
    return {word: mp.ldexp(mp.mpf(value), -BITS) for word, value in x.items()}


Row = dict[str, Fraction]


def reduced(row: Row, by: Row, word: str) -> Row:
    """The row less the multiple of another, whose entry at `word` is 1, that clears `word`."""
    if word not in row:
        return row
    factor = row[word]
    entries = {w: row.get(w, Fraction(0)) - factor * by.get(w, Fraction(0)) for w in {*row, *by}}
    return {w: value for w, value in entries.items() if value}


@cache
def functionals(length: int) -> list[Row]:
    """A basis of the functionals on words of a length that vanish on the ideal of the bracket."""
    pivots: dict[str, Row] = {}  # the ideal, in reduced row echelon form
    for before in range(length - 3):
        for u, v in product(words(before), words(length - 4 - before)):
            row = {u + word + v: Fraction(coefficient) for word, coefficient in BRACKET.items()}
            for word, pivot in pivots.items():
                row = reduced(row, pivot, word)
            if row:
                new = min(row)
                row = {word: value / row[new] for word, value in row.items()}
                pivots = {word: reduced(pivot, row, new) for word, pivot in pivots.items()} | {new: row}
    free = [word for word in words(length) if word not in pivots]
    return [
        {word: Fraction(1)} | {pivot: -row[word] for pivot, row in pivots.items() if word in row}
        for word in free
    ]


def defects(composition: Composition, highest: int) -> list[mp.mpf]:
    """The largest violated condition of each degree from 1 to `highest`."""
    largest = [mp.mpf(0)] * highest
    for n in (1, 2) if composition.processor else (1,):
        x = expanded(composition, n, highest)
        for degree in range(1, highest + 1):
            target = mp.mpf(n) ** degree / factorial(degree)
            errors = {word: x.get(word, 0) - target for word in words(degree)}
            violated = list(errors.values())
            if composition.nystrom and degree >= 4:
                violated = [
                    mp.fsum(errors[word] * f.numerator / f.denominator for word, f in functional.items())
                    for functional in functionals(degree)
                ]
            largest[degree - 1] = max(largest[degree - 1], *map(abs, violated))
    return largest


@pytest.mark.parametrize("composition", TWO_PART, ids=lambda c: c.name)
def test_the_order_conditions_hold_to_45_digits_up_to_the_order_and_no_further(composition, mp50):
    *held, next_one = defects(composition, composition.order + 1)
    assert max(held) < mp.mpf(10) ** -45
    assert next_one > mp.mpf(10) ** -9


@pytest.mark.parametrize("composition", [c for c in TWO_PART if c.nystrom], ids=lambda c: c.name)
def test_nystrom_tables_need_the_bracket_to_vanish(composition, mp50):
    """As general splittings they are of lower order: they are refused where the bracket is not zero."""
    plain = replace(composition, nystrom=False)
    assert max(defects(plain, composition.order - 1)) > mp.mpf(10) ** -6


@pytest.mark.parametrize("name", list(PUBLISHED))
def test_tables_are_the_published_ones(name):
    composition = next(c for c in COMPOSITIONS if c.name == name)
    assert composition.palindromic
    for (_, mine), printed in zip(composition.stages, PUBLISHED[name].split(), strict=False):
        unit = Fraction(1, 10 ** len(printed.partition(".")[2]))
        assert abs(mine - Fraction(printed)) < 7 * unit  # the conditions pin fewer digits than are printed


#: near-integrable ones: the order in h of the terms with one kick, with two, and with any number of them
NEAR = {"contact-aba864": (8, 6, 4), "contact-aba1064": (10, 6, 4)}


@pytest.mark.parametrize("name", NEAR)
def test_near_integrable_tables_are_of_their_orders_in_the_size_of_the_kicks(name, mp50):
    own = next(composition for composition in LINEAR if composition.name == name)
    letters = {"swing": "drift_damp"}
    own = replace(own, stages=tuple((letters.get(flow, flow), c) for flow, c in own.stages))
    highest = max(NEAR[name]) + 1
    coefficients = expanded(own, 1, highest)
    for kicks, order in enumerate(NEAR[name], 1):
        off = dict.fromkeys(range(1, highest + 1), mp.mpf(0))
        for degree in off:
            some = [w for w in words(degree) if w.count("B") == kicks]
            errors = (abs(coefficients.get(w, 0) - mp.mpf(1) / factorial(degree)) for w in some)
            off[degree] = max(errors, default=mp.mpf(0))
        assert max(off[degree] for degree in range(1, order + 1)) < mp.mpf(10) ** -37
        assert off[order + 1] > mp.mpf(10) ** -12
