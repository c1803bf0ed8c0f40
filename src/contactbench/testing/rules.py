"""Check the rules of a contract: each is a function of a case that raises, or returns why it does not apply."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple


class Violation(AssertionError):
    """Report that a rule of a contract is broken.

    Parameters
    ----------
    rule
        Its number in the contract.
    message
        How it is broken.
    """

    def __init__(self, rule: int, message: str) -> None:
        super().__init__(f"rule {rule}: {message}")
        self.rule = rule


class Finding(NamedTuple):
    """Report a rule that is kept, or does not apply.

    Attributes
    ----------
    rule, engine, scene
        The number of the rule and where it was checked; no engine for a scene.
    not_here
        Why the rule does not apply there, or empty.
    """

    rule: int
    engine: str
    scene: str
    not_here: str


def require(condition: object, message: str) -> None:
    """Raise `AssertionError` unless the condition holds, also under ``python -O``, which drops assert statements."""
    if not condition:
        raise AssertionError(message)


def follow(
    rules: Mapping[int, Callable[[Any], str | None]], case: Any, what: str, engine: str = ""
) -> Iterator[Finding]:
    """Check rules in turn and stop at the first broken one; its docstring is the remedy in the message."""
    for number, rule in rules.items():
        try:
            not_here = rule(case) or ""
        except Exception as error:
            reason = str(error) if isinstance(error, AssertionError) else f"{type(error).__name__}: {error}"
            remedy = " ".join((rule.__doc__ or "").split())
            raise Violation(number, f"{what}: {reason}. {remedy}".rstrip()) from error
        yield Finding(number, engine, case.scene.name, not_here)
