"""What is made once and used again: compiled programs, references."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any


class Cache[Made]:
    """The latest `size` things made, by key; None is no key: what has none is made anew every time."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.items: dict[Hashable, Made] = {}

    def __len__(self) -> int:
        return len(self.items)

    def get(self, key: Hashable | None, make: Callable[[], Made]) -> Made:
        """Return the object of a key, made if it is not there."""
        if key is None:
            return make()
        made = self.items.get(key)
        if made is None:
            made = self.items[key] = make()
            if len(self.items) > self.size:
                del self.items[next(iter(self.items))]
        return made


def key(identity: Hashable | None, *rest: Any) -> Hashable | None:
    """Return the key of what depends on a scene or a method, and more; None where the first of them is."""
    return None if identity is None else (identity, *rest)
