"""How the report writes numbers."""

from __future__ import annotations

import math

import pandas as pd

DASH = "—"

SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def scientific(value: float, digits: int = 1) -> str:
    return DASH if pd.isna(value) else f"{value:.{digits}e}"


def duration(seconds: float) -> str:
    if pd.isna(seconds):
        return DASH
    seconds = float(f"{seconds:.3g}")
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 1e-9:.3g} ns"


def times(ratio: float) -> str:
    """Return a ratio: two decimals where they tell who is ahead, two digits above ten (×1.25, ×13, ×3100)."""
    if pd.isna(ratio):
        return DASH
    return f"×{ratio:.2f}" if ratio < 9.995 else f"×{float(f'{ratio:.2g}'):.0f}"


def count(value: float) -> str:
    if pd.isna(value):
        return DASH
    return f"{value:.0f}" if abs(value) < 1e4 else f"{value:,.0f}".replace(",", "\u202f")


def power(value: float) -> str:
    """Return 10⁻³ for 1e-3."""
    return "10" + str(round(math.log10(value))).translate(SUPERSCRIPTS)


def exact_power(value: float) -> str:
    """Return 10⁻³ for 1e-3 and 0.002 for 2e-3."""
    return power(value) if float(f"1e{round(math.log10(value))}") == value else f"{value:g}"


def readable(value: float) -> str:
    if value == round(value) and abs(value) < 1e6:
        return count(value)
    return f"{value:.4g}" if 1e-2 <= abs(value) < 1e4 else scientific(value)


def names(items: list[str], most: int = 0) -> str:
    """Return `a`, `b` and `c`; the first few where there are more than `most`."""
    if most and len(items) > most:
        return ", ".join(items[:most]) + f" and {len(items) - most} more"
    return " and ".join(filter(None, [", ".join(items[:-1]), *items[-1:]]))


def how_often(part: int, whole: int) -> str:
    """Return a share in words: always, nearly always (nine in ten), mostly (six), rarely (under four), never; in
    between as a count."""
    if part in (0, whole):
        return "never" if whole and not part else "always" if whole else "not measured"
    share = part / whole
    words = {0.9: "nearly always", 0.6: "mostly", 0.4: f"{part} of {whole}"}
    return next((word for least, word in words.items() if share >= least), "rarely")
