"""Counting callbacks without calling back."""

from __future__ import annotations

import pytest

from contactbench.peers.diffrax import count_callbacks
from contactbench.xla import jax, jnp, lax

LIMIT = 100.0


def marked(x):
    jax.debug.callback(lambda: None)
    return 1.5 * x + 1


@jax.custom_jvp
def twice(x):
    return marked(marked(x))


twice.defjvp(lambda x, v: (twice(*x), 2.25 * v[0]))


def doubled(x):
    """Up to `LIMIT`, one evaluation a turn."""
    return lax.while_loop(lambda y: y < LIMIT, marked, x)


def in_branches(x):
    return lax.switch(jnp.int32(x), [lambda y: y, marked, lambda y: doubled(marked(y))], x)


def turns(x):
    """How often `doubled` evaluates."""
    number = 0
    while x < LIMIT:
        x, number = 1.5 * x + 1, number + 1
    return number


@pytest.mark.parametrize(
    ("function", "expected"),
    [
        (lambda x: x, lambda x: 0),
        (marked, lambda x: 1),
        (twice, lambda x: 2),
        (jax.jit(marked), lambda x: 1),
        (doubled, turns),
        (lambda x: marked(jax.jit(doubled)(marked(x))), lambda x: 2 + turns(1.5 * x + 1)),
        (in_branches, lambda x: [0, 1, 1 + turns(1.5 * x + 1)][int(x)]),
    ],
    ids=["none", "plain", "custom derivative", "jit", "loop", "nested", "branches"],
)
@pytest.mark.parametrize("x", [0.5, 1.5, 2.5])
def test_every_evaluation_counts_once_and_changes_nothing(function, expected, x):
    y, number = jax.jit(lambda x: count_callbacks(function, x))(x)
    assert int(number) == expected(x)
    assert float(y) == float(function(x))


@pytest.mark.parametrize(
    ("function", "where"),
    [
        (lambda x: lax.scan(lambda y, _: (marked(y), None), x, None, length=3)[0], "scan"),
        (lambda x: lax.while_loop(lambda y: marked(y) < 1, lambda y: y + 1, x), "condition"),
    ],
    ids=["scan", "condition"],
)
def test_what_has_no_rule_is_refused(function, where):
    with pytest.raises(NotImplementedError, match=where):
        count_callbacks(function, 0.5)
