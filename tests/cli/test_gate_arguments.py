"""What the gate's command line takes for a time."""

import argparse

import pytest

from contactbench.cli.gate import seconds


def test_a_budget_is_a_positive_number_of_seconds():
    assert seconds("180") == 180.0
    for text in ("0", "-1", "nan", "soon"):
        with pytest.raises(argparse.ArgumentTypeError):
            seconds(text)
