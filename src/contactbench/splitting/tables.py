"""The compositions that come with the package, from tables.toml: their coefficients are data."""

from __future__ import annotations

import tomllib
from fractions import Fraction
from importlib.resources import files

from contactbench.splitting.composition import Composition, balance, palindrome, strang_composition

PARTS = ("kick", "drift_damp")


def declare(
    name: str,
    order: int,
    source: str,
    nystrom: bool = False,
    first: str = PARTS[0],
    stages: str = "",
    half: str = "",
    strang: str = "",
    inner: bool = False,
    processor: str = "",
) -> Composition:
    """Return a composition from its entry in tables.toml, which says what the fields are."""
    second = PARTS[first == PARTS[0]]
    around = balance(first, second, processor.split()) if processor else ()
    if half:
        return Composition(name, order, palindrome(first, second, half.split()), source, nystrom, around)
    if stages:
        words = stages.split()
        written = tuple((flow, Fraction(c)) for flow, c in zip(words[::2], words[1::2], strict=True))
        return Composition(name, order, written, source, nystrom)
    outer = [Fraction(c) for c in strang.split()][:: -1 if inner else 1]
    gammas = [*outer, 1 - 2 * sum(outer), *reversed(outer)]
    return Composition(name, order, strang_composition(gammas), source, nystrom)


DECLARED = tomllib.loads(files(__package__).joinpath("tables.toml").read_text(encoding="utf-8"))
COMPOSITIONS = tuple(declare(name, **entry) for name, entry in DECLARED.items())
PRINTED, ABC, STRANG, BM4, BM6, RKN4, RKN6, RKN8, O8, YOSHIDA6, SRKN14A, B19 = COMPOSITIONS
