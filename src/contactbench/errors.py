"""The two exceptions for bad input: one line with the value and the allowed values."""

from __future__ import annotations

import reprlib
from collections.abc import Iterable

#: most characters of a message, and of a value in it
LONGEST, SHOWN = 300, 80
#: most characters dropped to cut a message between words
WORD = 30


class BadInput(ValueError):
    """Refuse a value the library cannot work with.

    Parameters
    ----------
    message
        One line with the value and the allowed values; longer texts are cut in the middle.
    """

    def __init__(self, message: object) -> None:
        super().__init__(one_line(message))

    def __str__(self) -> str:  # KeyError, a base of UnknownName, would print its repr
        return str(self.args[0])


class UnknownName(BadInput, KeyError):
    """Refuse a name that is in no registry.

    Parameters
    ----------
    message
        One line that names the nearest name and all that are allowed.
    """


def one_line(message: object, longest: int = LONGEST) -> str:
    """Return the text on one line without control characters; the middle of a longer text is left out."""
    text = " ".join("".join(c if c.isprintable() else " " for c in str(message)).split())
    if len(text) <= longest:
        return text
    end = 2 * longest // 5  # it holds the allowed values
    head, tail = text[: longest - end - 3], text[-end:]
    cut, rest = head.rfind(" "), tail.find(" ")  # between words, unless they are long
    head = head[:cut] if len(head) - cut <= WORD else head
    return f"{head} … {tail[rest + 1 :] if 0 <= rest <= WORD else tail}"


_SHORT = reprlib.Repr(maxlevel=3, maxtuple=8, maxlist=8, maxdict=4, maxset=4, maxstring=SHOWN, maxother=SHOWN)


def excerpt(value: object) -> str:
    """Return the repr of any value, short and on one line."""
    try:
        return one_line(_SHORT.repr(value), SHOWN)
    except Exception:  # an int of thousands of digits, an object whose repr fails
        return f"<{type(value).__name__}>"


def unknown_name(kind: str, name: object, allowed: Iterable[str]) -> UnknownName:
    """Return the exception for a name that is not among the allowed ones."""
    from difflib import get_close_matches

    names = list(allowed)
    plain = {known.lower(): known for known in names}
    near = get_close_matches(name.lower(), plain, n=1, cutoff=0.5) if isinstance(name, str) else []
    hint = f"did you mean {plain[near[0]]!r}? " if near else ""
    return UnknownName(f"unknown {kind} {excerpt(name)}: {hint}choose from {', '.join(names)}")
