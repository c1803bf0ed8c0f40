"""How often a JAX program calls back, without its calling back: every callback becomes an addition.

A callback costs 20 µs, and JAX keeps no program that has one for other processes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from contactbench.xla import jax, jnp, lax


def count_callbacks(function: Callable[..., Any], *arguments: Any) -> tuple[Any, Any]:
    """What a traceable function returns, and how many `jax.debug.callback` it came by, which are not called.

    Raises `NotImplementedError` where one, or any other effect, is in a construct of JAX that has no rule here.
    """
    program, shape = jax.make_jaxpr(function, return_shape=True)(*arguments)
    outputs, number = evaluate(program, jax.tree.leaves(arguments), jnp.array(0))
    return jax.tree.unflatten(jax.tree.structure(shape), outputs), number


def evaluate(program: Any, inputs: Sequence[Any], number: Any) -> tuple[list[Any], Any]:
    """The outputs of a program, equation by equation, and the number of callbacks, those so far included."""
    jaxpr = program.jaxpr
    values = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*program.consts, *inputs], strict=True))

    def read(atom: Any) -> Any:
        return atom.val if hasattr(atom, "val") else values[atom]

    for equation in jaxpr.eqns:
        given = list(map(read, equation.invars))
        if equation.effects:
            found, number = count(equation.primitive.name, equation.params, given, number)
        else:
            parameters = equation.primitive.get_bind_params(equation.params)
            if isinstance(parameters, tuple):  # of older JAX: functions to be called, and the rest
                given, parameters = [*parameters[0], *given], parameters[1]
            found = equation.primitive.bind(*given, **parameters)
            found = found if equation.primitive.multiple_results else [found]
        values |= zip(equation.outvars, found, strict=True)
    return list(map(read, jaxpr.outvars)), number


def count(
    name: str, parameters: dict[str, Any], given: Sequence[Any], number: Any
) -> tuple[Sequence[Any], Any]:
    """The outputs of an equation with callbacks in it, and their number."""
    if name == "debug_callback":
        return (), number + 1
    if name in ("jit", "custom_jvp_call"):
        return evaluate(parameters["jaxpr" if name == "jit" else "call_jaxpr"], given, number)
    if name == "cond":
        branches = [lambda n, *x, each=each: evaluate(each, x, n) for each in parameters["branches"]]
        return lax.switch(given[0], branches, number, *given[1:])
    if name != "while" or parameters["cond_jaxpr"].effects:
        raise NotImplementedError(f"a callback, or another effect, inside {name}, or inside its condition")
    i = parameters["cond_nconsts"]
    j = i + parameters["body_nconsts"]
    return lax.while_loop(
        lambda state: evaluate(parameters["cond_jaxpr"], [*given[:i], *state[0]], 0)[0][0],
        lambda state: evaluate(parameters["body_jaxpr"], [*given[i:j], *state[0]], state[1]),
        (list(given[j:]), number),
    )
