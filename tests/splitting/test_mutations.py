"""The tests' own sensitivity: every wrong sign in a subflow and every wrong coefficient is noticed.

Mutants are made one at a time, of the source (each + and − and unary minus) and of the data (each
coefficient by one part in a thousand), and shown to the properties of properties.py.
"""

import __future__

import ast
import inspect
import textwrap

import pytest
from mpmath import mp

import contactbench as cb
import properties
from contactbench.methods import herglotz
from contactbench.methods.contact import contact_method
from contactbench.scene import flow as flow_module
from contactbench.scene import free_body, general_damping, mechanical, rigid_body
from contactbench.splitting.tables import COMPOSITIONS
from planted_faults import faulty
from properties import BODY, CENTRAL, PARTICLE

#: functions by the module that has them and what they compute
MUTATED = {
    "shared by flows": (flow_module, "damped_time damping linear_log_factor"),
    "mechanical flows": (mechanical, "kick drift damp drift_damp"),
    "body flows": (
        rigid_body,
        "rotation spin turn_rate top_rate turn top body_damp free_damp _body_damp_constants",
    ),
    "constants": (mechanical, "_damp_constants _drift_damp_constants _over_D _pinney"),
    "factors": (mechanical, "damp_log_factor drift_damp_log_factor"),
    "elliptic functions": (free_body, "jacobi carlson arc bent_part"),
    "free body": (free_body, "course free polar momentum precession phase sense attitude frame"),
    "handedness": (free_body, "handedness components"),
    "quadrature": (general_damping, "by_quadrature survival"),
    "general damping": (general_damping, "damp_generally general_log_factor"),
    "herglotz": (herglotz, "explicit_kick implicit_kick"),
}
STRUCTURED = [cb.METHODS[name] for name in ("contact-strang", "herglotz1", "herglotz2")]
ABC = cb.METHODS["contact-abc"]  # its A on a body is `free`, which has a property of its own


def structured(check, mechanical):
    return all(check(method, mechanical, BODY) for method in STRUCTURED) and check(ABC, mechanical)


ELLIPTIC = {
    "Carlson's series": properties.carlsons_series_is_of_its_order,
    "Jacobi's functions": properties.jacobi_functions_are_right,
    "Carlson's integral": properties.carlsons_integral_is_right,
}
FREE = {"free body": properties.free_body_solves_its_equations}
COMMON = {
    "mechanical flows": properties.mechanical_flows_solve_their_equations,
    "body flows": properties.body_flows_solve_their_equations,
    "anisotropic damping": properties.anisotropic_damping_solves_its_equation,
    "general damping": properties.general_damping_is_right,
    "smoothness": properties.flows_are_smooth_where_they_choose,
    "own factor": properties.flows_know_their_factors,
    "arrays": properties.flows_agree_on_arrays,
    "conformal factor": lambda: structured(properties.has_its_conformal_factor, PARTICLE),
    "momentum law": lambda: structured(properties.has_its_momentum_law, CENTRAL),
    "order": lambda: structured(properties.has_its_order, PARTICLE),
}
#: the properties that a group's mutants are shown to, the cheaper ones first
PROPERTIES = {"elliptic functions": ELLIPTIC | FREE, "free body": FREE, "handedness": FREE}


def notices(check):
    """Whether a property fails or cannot even be evaluated."""
    try:
        with mp.workdps(50):
            return not check()
    except (ArithmeticError, ValueError, IndexError, TypeError):
        return True


@pytest.mark.parametrize("name", ELLIPTIC | FREE | COMMON)
def test_the_code_as_it_is_has_every_property(name):
    assert not notices((ELLIPTIC | FREE | COMMON)[name])


@pytest.mark.parametrize("composition", COMPOSITIONS, ids=lambda c: c.name)
def test_every_composition_has_its_local_order(composition, mp50):
    assert properties.has_its_local_order(contact_method(composition), PARTICLE, BODY)


# -- signs -----------------------------------------------------------------------------------------
def signs(tree):
    return [
        node
        for node in ast.walk(tree)
        if isinstance(getattr(node, "op", None), ast.Add | ast.Sub | ast.USub)
        and isinstance(node, ast.BinOp | ast.UnaryOp)
    ]


def flipped(function):
    """The function with one sign flipped, for each of its signs, and the place."""
    source = textwrap.dedent(inspect.getsource(function))
    opposite = {ast.USub: ast.UAdd, ast.Add: ast.Sub, ast.Sub: ast.Add}
    for k in range(len(signs(ast.parse(source)))):
        tree = ast.parse(source)
        node = signs(tree)[k]
        before = ast.unparse(node)
        node.op = opposite[type(node.op)]()
        namespace = dict(vars(inspect.getmodule(function)))
        code = compile(
            tree, f"<{function.__name__} mutant {k}>", "exec", __future__.annotations.compiler_flag
        )
        exec(code, namespace)
        yield f"{function.__name__}: {before} → {ast.unparse(node)}", namespace[function.__name__]


#: where the functions are used: modules, and tables of flows
USERS = (flow_module, free_body, general_damping, herglotz, mechanical, rigid_body)
FLOWS = (cb.Mechanical.flows, cb.GeneralDamping.flows, rigid_body.BODY, rigid_body.ISOTROPIC)


def install(patch, original, mutant):
    """Put a mutant wherever its original is used."""
    for user in USERS:
        if getattr(user, original.__name__, None) is original:
            patch.setattr(user, original.__name__, mutant)
    for table in FLOWS:
        for key, flow in table.items():
            uses = {f: mutant for f in ("constants", "apply", "log_factor") if getattr(flow, f) is original}
            patch.setitem(table, key, flow._replace(**uses))


def mutants(group):
    module, names = MUTATED[group]
    originals = [getattr(module, name) for name in names.split()]
    return [(original, *mutant) for original in originals for mutant in flipped(original)]


@pytest.mark.parametrize("group", MUTATED)
@pytest.mark.quick(group=tuple(name for name in MUTATED if name != "free body"))  # takes ten seconds
def test_every_flipped_sign_is_noticed(group):
    checks = PROPERTIES.get(group, COMMON).values()
    missed = []
    for original, place, mutant in mutants(group):
        with pytest.MonkeyPatch.context() as patch:
            install(patch, original, mutant)
            missed += [] if any(map(notices, checks)) else [place]
    assert missed == []


def test_the_source_really_is_parsed():
    assert sum(len(mutants(group)) for group in MUTATED) >= 130


# -- coefficients ----------------------------------------------------------------------------------


def is_right(composition):
    """Sums, the factor, into which only coefficients of the damping enter, and the order."""
    method = contact_method(composition)
    return (
        properties.consistent(composition)
        and properties.has_its_conformal_factor(method, PARTICLE)
        and properties.has_its_order(method, PARTICLE)
    )


@pytest.mark.parametrize("composition", COMPOSITIONS, ids=lambda c: c.name)
def test_every_wrong_coefficient_is_noticed(composition):
    missed = [properties.run(m, 1) for m in faulty(composition) if not notices(lambda m=m: is_right(m))]
    assert missed == []
