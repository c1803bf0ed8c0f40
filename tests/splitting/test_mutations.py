"""The tests' own sensitivity: every wrong sign in a subflow and every wrong coefficient is noticed.

Mutants are made one at a time, of the source (each + and − and unary minus) and of the data (each
coefficient by one part in a thousand), and shown to the properties of properties.py.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from types import ModuleType
from typing import Any

import pytest
from mpmath import mp

import contactbench as cb
import properties
from cases import few_slow
from contactbench.methods import herglotz
from contactbench.methods.contact import contact_method
from contactbench.splitting import dissipation, elliptic, flows, free_body
from contactbench.splitting.tables import COMPOSITIONS
from properties import BODY, CENTRAL, PARTICLE

STRUCTURED = [cb.METHODS[name] for name in ("contact-abc", "contact-strang", "herglotz1", "herglotz2")]
MUTATED = [
    (flows, ("kick", "drift", "damp", "drift_damp", "body_damp", "damped_time", "damping")),
    (flows, ("rotation", "spin", "turn_rate", "top_rate", "turn", "top")),
    (flows, ("_damp_constants", "_drift_damp_constants", "_body_damp_constants", "_over_D", "_pinney")),
    (flows, ("damp_log_factor", "linear_log_factor", "drift_damp_log_factor", "free_damp")),
    (elliptic, ("jacobi", "carlson", "arc", "bent_part")),
    (
        free_body,
        ("course", "free", "polar", "momentum", "precession", "phase", "sense", "attitude", "frame"),
    ),
    (free_body, ("handedness", "circled")),
    (dissipation, ("damped_by", "by_quadrature", "survival")),
    (flows, ("damp_generally", "general_log_factor")),
    (herglotz, ("explicit_kick", "implicit_kick")),
]
#: take ten seconds
LONG = [(module, names) for module, names in MUTATED if "course" in names]


def every(check: Callable[..., bool], *scenes: Any) -> bool:
    """Of the two whose A on a body is `free`, which has a property of its own, on the particle only."""
    own = [[s for s in scenes if not (method.name == "contact-abc" and s is BODY)] for method in STRUCTURED]
    return all(check(method, *mine) for method, mine in zip(STRUCTURED, own, strict=True))


PROPERTIES: dict[str, Callable[[], bool]] = {
    "own equations": lambda: (
        properties.mechanical_flows_solve_their_equations()
        and properties.body_flows_solve_their_equations()
        and properties.anisotropic_damping_solves_its_equation()
    ),
    "elliptic functions": lambda: (
        properties.carlsons_series_is_of_its_order()
        and properties.jacobi_functions_are_right()
        and properties.carlsons_integral_is_right()
    ),
    "free body": properties.free_body_solves_its_equations,
    "general damping": properties.general_damping_is_right,
    "own factor": properties.flows_know_their_factors,
    "arrays": properties.flows_agree_on_arrays,
    "conformal factor": lambda: every(properties.has_its_conformal_factor, PARTICLE, BODY),
    "momentum law": lambda: every(properties.has_its_momentum_law, CENTRAL, BODY),
    "order": lambda: every(properties.has_its_order, PARTICLE, BODY),
}


#: what the elliptic functions and the free body are asked; the first is the cheaper, but knows nothing of the body
OWN = {elliptic: ["elliptic functions", "free body"], free_body: ["free body"]}
COMMON = [which for which in PROPERTIES if which not in OWN[elliptic]]


def noticed(check: Callable[[], bool]) -> bool:
    """Whether a property fails or cannot even be evaluated."""
    try:
        with mp.workdps(50):
            return not check()
    except (ArithmeticError, ValueError, IndexError, TypeError):
        return True


# -- signs -----------------------------------------------------------------------------------------
def signs(tree: ast.AST) -> list[ast.AST]:
    """Every binary + and − and every unary minus."""
    return [
        node
        for node in ast.walk(tree)
        if (isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub))
        or (isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub))
    ]


def flipped(function: Callable[..., Any]) -> Iterator[tuple[str, Callable[..., Any]]]:
    """The function with one sign flipped, for each of its signs, and the line it happened on."""
    source = textwrap.dedent(inspect.getsource(function))
    for k in range(len(signs(ast.parse(source)))):
        tree = ast.parse(source)
        node: Any = signs(tree)[k]
        before = ast.unparse(node)
        if isinstance(node, ast.UnaryOp):
            node.op = ast.UAdd()
        else:
            node.op = ast.Sub() if isinstance(node.op, ast.Add) else ast.Add()
        namespace = dict(vars(inspect.getmodule(function)))  # type: ignore[arg-type]
        exec(compile(tree, f"<{function.__name__} mutant {k}>", "exec"), namespace)
        yield f"{function.__name__}: {before} → {ast.unparse(node)}", namespace[function.__name__]


#: where the functions are used: modules, and tables of flows
USERS = (elliptic, free_body, dissipation, flows, herglotz)
FLOWS = (flows.MECHANICAL, flows.GENERAL, flows.BODY, flows.ISOTROPIC)


def whole() -> list[dict[str, Any]]:
    """All that a mutant may take the place of."""
    return [*(dict(vars(module)) for module in USERS), *map(dict, FLOWS)]


def install(patch: pytest.MonkeyPatch, module: ModuleType, name: str, mutant: Callable[..., Any]) -> None:
    """Put a mutant wherever its original is used."""
    original = getattr(module, name)
    for user in USERS:
        if getattr(user, name, None) is original:
            patch.setattr(user, name, mutant)
    for table in FLOWS:
        for key, flow in table.items():
            uses = {f: mutant for f in ("constants", "apply", "log_factor") if getattr(flow, f) is original}
            patch.setitem(table, key, flow._replace(**uses))


def test_the_code_as_it_is_has_every_property():
    assert [name for name, check in PROPERTIES.items() if noticed(check)] == []
    assert [c.name for c in COMPOSITIONS if not properties.consistent(c)] == []
    for method in map(contact_method, COMPOSITIONS):
        assert properties.has_its_local_order(method, PARTICLE, BODY), method.name


@pytest.mark.parametrize(
    ("module", "names"), few_slow(MUTATED, *LONG), ids=[names[0] for _, names in MUTATED]
)
def test_every_flipped_sign_is_noticed(module, names, record_property):
    asked, code = OWN.get(module, COMMON), whole()
    caught: dict[str, str] = {}  #: by the first property that notices
    for name in names:
        for label, mutant in flipped(getattr(module, name)):
            with pytest.MonkeyPatch.context() as patch:
                install(patch, module, name, mutant)
                caught[label] = next((which for which in asked if noticed(PROPERTIES[which])), "")
    record_property("signs", (sum(map(bool, caught.values())), len(caught)))
    print(f"\nsigns: {Counter(caught.values())}")
    assert [label for label, found in caught.items() if not found] == []
    assert whole() == code  # again; `test_the_code_as_it_is_has_every_property` asks whether it is right


def test_the_source_really_is_parsed():
    assert (
        sum(len(list(flipped(getattr(module, name)))) for module, names in MUTATED for name in names) >= 130
    )


# -- coefficients ----------------------------------------------------------------------------------
RELATIVE = Fraction(1, 1000)


def changed(composition: Any, which: str, changes: dict[int, Fraction]) -> Any:
    stages = enumerate(getattr(composition, which))
    return replace(composition, **{which: tuple((name, c + changes.get(i, 0)) for i, (name, c) in stages)})


def unbalanced(composition: Any) -> Iterator[Any]:
    """One coefficient off, the sum broken."""
    for which in ("stages", "processor"):
        for i, (_, c) in enumerate(getattr(composition, which)):
            yield changed(composition, which, {i: c * RELATIVE})


def balanced(composition: Any) -> Iterator[Any]:
    """One coefficient off and the next of its kind off the other way, the sum kept."""
    for which in ("stages", "processor"):
        stages = getattr(composition, which)
        for i, (name, c) in enumerate(stages):
            later = [j for j in range(i + 1, len(stages)) if stages[j][0] == name]
            if later:
                yield changed(composition, which, {i: c * RELATIVE, later[0]: -c * RELATIVE})


@pytest.mark.parametrize("composition", COMPOSITIONS, ids=lambda c: c.name)
def test_every_wrong_coefficient_is_noticed(composition, record_property):
    mutants = list(unbalanced(composition))
    by_property = {"consistency": 0, "conformal factor": 0, "order": 0}
    missed = []
    for mutant in mutants:
        method = contact_method(mutant)
        checks = {
            "consistency": lambda m=mutant: properties.consistent(m),
            # only a coefficient of the damping enters the factor
            "conformal factor": lambda m=method: properties.has_its_conformal_factor(m, PARTICLE),
            "order": lambda m=method: properties.has_its_order(m, PARTICLE, n=20),
        }
        first = next((which for which, check in checks.items() if noticed(check)), None)
        if first is None:
            missed.append(mutant.run(1))
        else:
            by_property[first] += 1
    record_property("coefficients", (len(mutants) - len(missed), len(mutants)))
    print(f"\n{composition.name}: {len(mutants) - len(missed)} of {len(mutants)} noticed; {by_property}")
    assert missed == []


@pytest.mark.parametrize("composition", [c for c in COMPOSITIONS if c.palindromic], ids=lambda c: c.name)
@pytest.mark.quick(composition=("contact-strang", "contact-rkn6"))
def test_a_wrong_coefficient_that_keeps_the_sum_is_noticed_by_the_order(composition):
    """Not asked of `contact-printed`: of order 1 is any composition whose sums are right."""
    mutants = list(balanced(composition))
    assert mutants
    for mutant in mutants:
        assert properties.consistent(mutant)
        method = contact_method(mutant)
        assert noticed(lambda m=method: properties.has_its_local_order(m, PARTICLE)), mutant.run(1)
