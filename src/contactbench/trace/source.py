"""Recorded source: what stands before it, what of it is needed, and how Python itself runs it."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from typing import Any

from contactbench.trace.recording import FUNCTIONS

NAMES = re.compile(r"[a-z]+\d+")
#: what the program imports
PREAMBLE = (
    f"from math import {', '.join(FUNCTIONS)}, atan2, hypot, inf, nan\n\nLARGEST = {sys.float_info.max!r}\n"
)


def needed(lines: Sequence[str]) -> list[str]:
    """Straight-line code without what nothing reads."""
    kept, read = [], {"out"}
    for line in reversed(lines):
        target, _, text = line.partition(" = ")
        if target.strip().partition("[")[0] in read:
            kept.append(line)
            read |= {*NAMES.findall(text)}
    return kept[::-1]


def executed(text: str) -> dict[str, Any]:
    """The names that source defines when run by Python itself."""
    scope: dict[str, Any] = {}
    exec(PREAMBLE + text, scope)
    return scope


def executed_on_lists(text: str) -> dict[str, Any]:
    """The same for functions of arrays, which become lists of lists: ``w[u, i]`` is ``w[u][i]``."""
    return executed(re.sub(r"\[(\w+), ", r"[\1][", text))
