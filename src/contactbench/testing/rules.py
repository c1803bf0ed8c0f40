"""How a rule of a contract is written: a function that raises `Violation`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any


class Violation(AssertionError):
    """A rule of a contract is broken.

    rule : its number in the contract.
    """

    def __init__(self, rule: int, message: str) -> None:
        super().__init__(f"rule {rule}: {message}")
        self.rule = rule


def require(condition: Any, message: str) -> None:
    """Raises `AssertionError` unless the condition holds; not by `assert`, which may be switched off."""
    if not condition:
        raise AssertionError(message)


def follow(rules: Mapping[int, Callable[[Any], None]], case: Any, what: str) -> None:
    """Every rule on a case; raises `Violation` for the first that is broken, or that cannot be followed."""
    for number, rule in rules.items():
        try:
            rule(case)
        except Exception as error:
            reason = str(error) if isinstance(error, AssertionError) else f"{type(error).__name__}: {error}"
            raise Violation(number, f"{what}: {reason}") from error
