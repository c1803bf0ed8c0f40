"""Kernels do compiled what Python does."""

from __future__ import annotations

import math

import numpy as np
import pytest

from contactbench.numbers.protocol import CannotRecord
from contactbench.trace.form import execute
from contactbench.trace.kernel import Kernel

LARGEST = 4
FAR = math.inf


@Kernel
def mixed(given, out):  # type: ignore[no-untyped-def]
    """Loops, conditions, whole numbers, constants of the module."""
    total = 0.0
    n = len(given)
    k = 0
    while k + 1 < n and given[k] < LARGEST:
        k += 1
    for i in range(n):
        x = given[n - 1 - i]
        if x > 0 and not x > LARGEST:
            total += sqrt(x) / 2  # noqa: F821
        elif x == 0 or x != x:
            total -= 1.5
        else:
            j = int(given[i])
            total += given[j] if j >= 0 else -x
    out[0] = total
    out[1] = k
    out[k] *= 3
    out[n] = FAR if total > 0 else abs(total)


def test_a_kernel_is_the_function_it_is_written_as() -> None:
    given = np.array([1.0, 2.0, 3.0, 0.0, 6.0, -2.0])
    mixed.function.__globals__["sqrt"] = math.sqrt
    native, python, printed = np.ones((3, 7))
    mixed(given, native)
    mixed.function(given, python)
    read = printed.tolist()
    execute(mixed.form)(given.tolist(), read)
    assert native.tolist() == python.tolist() == read
    assert native[0] == pytest.approx((1 + math.sqrt(2) + math.sqrt(3)) / 2 - 1.5 + 2 + 3)


def test_a_statement_that_is_no_arithmetic_is_refused() -> None:
    def with_a_list(out):  # type: ignore[no-untyped-def]
        out[0] = [1.0]

    with pytest.raises(CannotRecord, match="no List"):
        Kernel(with_a_list).form  # noqa: B018


def test_python_runs_a_kernel_where_nothing_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    def twice(out):  # type: ignore[no-untyped-def]
        out[0] = 2 * out[0]

    def refuse(form: object) -> None:
        raise CannotRecord("nothing is compiled")

    monkeypatch.setattr("contactbench.trace.kernel.compile_function", refuse)
    out = np.array([1.25])
    Kernel(twice)(out)
    assert out[0] == 2.5
