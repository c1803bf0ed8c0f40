"""Fixtures of the tests."""

from __future__ import annotations

from collections import defaultdict
from zlib import crc32

import pytest
from mpmath import mp

from contactbench.methods import METHODS
from contactbench.plugins import OWN
from contactbench.scenes import SCENES


@pytest.hookimpl(tryfirst=True)  # before pytest leaves out what is slow
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Of the cases of a test marked ``share(n)`` all but one in n are slow, none for it with a user's method or scene.

    Where cases have a method they are counted for each method alone, so that every one has a quick case.  From which
    case on they are counted is different from test to test and from method to method.  A case that is named alone
    is not slow for it.
    """
    cases = defaultdict(list)
    for item in items:
        mark = item.get_closest_marker("share")
        if mark and not has_a_users(item):
            method = getattr(item.callspec.params.get("method"), "name", "")
            cases[item.nodeid.partition("[")[0], method, *mark.args].append(item)
    for (name, method, n), found in cases.items():
        for k, item in enumerate(found, crc32(f"{name} {method}".encode())):
            if k % min(n, len(found)):
                item.add_marker("slow")


def has_a_users(item: pytest.Item) -> bool:
    """Whether a test is about something registered that is not ours."""
    names = {
        getattr(value, "name", value)
        for value in item.callspec.params.values()
        if hasattr(value, "name") or isinstance(value, str)
    }
    return bool(names & {*METHODS, *SCENES} - OWN)


@pytest.fixture
def mp50():
    """mpmath at 50 digits."""
    with mp.workdps(50):
        yield mp
