"""How a rule of a contract is followed: a function of a case that raises, and notes there what it measured.

Where it has nothing to say about a case it returns why.
"""

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
    rule, name, scene, measured
        Its number and name, where it was followed, and what was measured.
    engine
        Of a method; empty for a scene.
    not_here
        Why the rule does not apply there, or empty.
    """

    rule: int
    name: str
    engine: str
    scene: str
    measured: dict[str, float]
    not_here: str


def require(condition: object, message: str) -> None:
    """Raise `AssertionError` unless the condition holds; not by `assert`, which may be switched off."""
    if not condition:
        raise AssertionError(message)


def follow(
    rules: Mapping[int, Callable[..., str | None]], case: Any, what: str, engine: str = ""
) -> Iterator[Finding]:
    """Follow rules one after the other, up to the first that is broken."""
    for number, rule in rules.items():
        case.measured.clear()
        try:
            not_here = rule(case) or ""
        except Exception as error:
            reason = str(error) if isinstance(error, AssertionError) else f"{type(error).__name__}: {error}"
            raise Violation(number, f"{what}: {reason}") from error
        name = rule.__name__.replace("_", " ")
        yield Finding(number, name, engine, case.scene.name, dict(case.measured), not_here)
