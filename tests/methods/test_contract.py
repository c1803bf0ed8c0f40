"""Every registered method keeps every rule of the contract, on every engine and kind of scene."""

from __future__ import annotations

import pytest

import contactbench as cb
from contactbench.testing.method import check_case, method_cases

CASES = [case for method in cb.METHODS.values() for case in method_cases(method)]


@pytest.mark.parametrize(
    "case", CASES, ids=lambda case: f"{case.method.name}-{case.engine}-{case.scene.name}"
)
def test_a_method_keeps_its_contract(case):
    check_case(case)
