"""Read the compositions, whose coefficients are in compositions.toml."""

from __future__ import annotations

import tomllib
from fractions import Fraction
from importlib.resources import files
from typing import Any

from contactbench.splitting.composition import Composition, Stage, balance, palindrome, strang_composition


def listed(text: str) -> tuple[Stage, ...]:
    words = text.split()
    return tuple((flow, Fraction(part)) for flow, part in zip(words[::2], words[1::2], strict=True))


def composition(name: str, given: dict[str, Any]) -> Composition:
    first, second = given.get("flows", "kick drift_damp").split()
    if "half" in given:
        stages = palindrome(first, second, given["half"].split())
    elif "strang" in given:
        outer = [Fraction(c) for c in given["strang"].split()]
        stages = strang_composition([*outer, 1 - 2 * sum(outer), *reversed(outer)])
    else:
        stages = listed(given["stages"])
    before, after = (listed(given.get(name, "")) for name in ("before", "after"))
    if "processor" in given:
        before = balance(first, second, given["processor"].split())
    known = {key: given.get(key, False) for key in ("nystrom", "mission")}
    return Composition(
        name, given["order"], stages, given["source"], processor=before, postprocessor=after, **known
    )


_entries = tomllib.loads(files(__package__).joinpath("compositions.toml").read_text(encoding="utf-8"))
_all = {name: composition(name, given) for name, given in _entries.items()}
#: those with the exact flow of a linear part, and the others
LINEAR = tuple(own for own in _all.values() if any(flow == "swing" for flow, _ in own.stages))
COMPOSITIONS = tuple(own for own in _all.values() if own not in LINEAR)
O8 = _all["contact-o8"]
