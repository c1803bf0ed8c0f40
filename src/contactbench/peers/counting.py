"""How often a JAX program calls back, without its calling back: every callback becomes an addition.

A callback costs 20 µs, and JAX keeps no program that has one for other processes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from contactbench.xla import jax, jnp, lax

#: a function of the parameters of an equation, its inputs and the number so far: its outputs and the number
Rule = Callable[[dict[str, Any], Sequence[Any], Any], tuple[Sequence[Any], Any]]


def count_callbacks(function: Callable[..., Any], *arguments: Any) -> tuple[Any, Any]:
    """What a traceable function returns, and how many `jax.debug.callback` it came by, which are not called.

    Raises `NotImplementedError` where one, or any other effect, is in a construct of JAX that has no rule here.
    """
    program, shape = jax.make_jaxpr(function, return_shape=True)(*arguments)
    outputs, number = _closed(program, jax.tree.leaves(arguments), jnp.array(0))
    return jax.tree.unflatten(jax.tree.structure(shape), outputs), number


def _closed(program: Any, inputs: Sequence[Any], number: Any) -> tuple[list[Any], Any]:
    """A program evaluated equation by equation; of all that has effects only callbacks are known."""
    jaxpr = program.jaxpr
    values = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*program.consts, *inputs], strict=True))

    def read(atom: Any) -> Any:
        return atom.val if hasattr(atom, "val") else values[atom]

    found: Sequence[Any]
    for equation in jaxpr.eqns:
        name, given = equation.primitive.name, list(map(read, equation.invars))
        if name == "debug_callback":
            number, found = number + 1, ()
        elif not equation.effects:
            parameters = equation.primitive.get_bind_params(equation.params)
            if isinstance(parameters, tuple):  # of older JAX: functions to be called, and the rest
                functions, parameters = parameters
                given = [*functions, *given]
            found = equation.primitive.bind(*given, **parameters)
            found = found if equation.primitive.multiple_results else [found]
        elif name in RULES:
            found, number = RULES[name](equation.params, given, number)
        else:
            raise NotImplementedError(f"a callback, or another effect, inside {name}")
        values |= zip(equation.outvars, found, strict=True)
    return list(map(read, jaxpr.outvars)), number


def _while(parameters: dict[str, Any], given: Sequence[Any], number: Any) -> tuple[Sequence[Any], Any]:
    if parameters["cond_jaxpr"].effects:
        raise NotImplementedError("a callback inside the condition of a loop")
    i = parameters["cond_nconsts"]
    j = i + parameters["body_nconsts"]

    def body(state: Any) -> Any:
        return _closed(parameters["body_jaxpr"], [*given[i:j], *state[0]], state[1])

    def goes_on(state: Any) -> Any:
        return _closed(parameters["cond_jaxpr"], [*given[:i], *state[0]], 0)[0][0]

    return lax.while_loop(goes_on, body, (list(given[j:]), number))


def _cond(parameters: dict[str, Any], given: Sequence[Any], number: Any) -> tuple[Sequence[Any], Any]:
    def branch(program: Any) -> Callable[..., Any]:
        return lambda number, *inputs: _closed(program, inputs, number)

    return lax.switch(given[0], [branch(program) for program in parameters["branches"]], number, *given[1:])


#: by the name of the primitive
RULES: dict[str, Rule] = {
    "jit": lambda parameters, given, number: _closed(parameters["jaxpr"], given, number),
    "custom_jvp_call": lambda parameters, given, number: _closed(parameters["call_jaxpr"], given, number),
    "while": _while,
    "cond": _cond,
}
