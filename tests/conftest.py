"""Fixtures of the tests."""

from __future__ import annotations

import pytest
from mpmath import mp


@pytest.fixture
def mp50():
    """mpmath at 50 digits."""
    with mp.workdps(50):
        yield mp
