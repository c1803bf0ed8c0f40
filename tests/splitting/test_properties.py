"""The subflows and compositions have every property of properties.py, which notice every wrong coefficient.

Wrong signs in the sources are planted by bench/mutation.py.
"""

import pytest

import contactbench as cb
import properties
from contactbench.methods.contact import contact_method
from contactbench.splitting.tables import COMPOSITIONS
from properties import BODY, CENTRAL, PARTICLE, faulty

STRUCTURED = [cb.METHODS[name] for name in ("contact-strang", "herglotz1", "herglotz2")]
ABC = cb.METHODS["contact-abc"]  # its A on a body is `free`, which has a property of its own


def structured(check, mechanical):
    return all(check(method, mechanical, BODY) for method in STRUCTURED) and check(ABC, mechanical)


PROPERTIES = {
    "Carlson's series": properties.carlsons_series_is_of_its_order,
    "Jacobi's functions": properties.jacobi_functions_are_right,
    "Carlson's integral": properties.carlsons_integral_is_right,
    "free body": properties.free_body_solves_its_equations,
    "mechanical flows": properties.mechanical_flows_solve_their_equations,
    "body flows": properties.body_flows_solve_their_equations,
    "anisotropic damping": properties.anisotropic_damping_solves_its_equation,
    "general damping": properties.general_damping_is_right,
    "smoothness": properties.the_damped_time_is_smooth,
    "arrays": properties.flows_agree_on_arrays,
    "conformal factor": lambda: structured(properties.has_its_conformal_factor, PARTICLE),
    "momentum law": lambda: structured(properties.has_its_momentum_law, CENTRAL),
    "order": lambda: structured(properties.has_its_order, PARTICLE),
}


@pytest.mark.parametrize("name", PROPERTIES)
def test_the_code_as_it_is_has_every_property(name, mp50):
    assert PROPERTIES[name]()


def is_right(composition):
    """Sums, the factor, into which only coefficients of the damping enter, and the order."""
    method = contact_method(composition)
    return (
        properties.consistent(composition)
        and properties.has_its_conformal_factor(method, PARTICLE)
        and properties.has_its_order(method, PARTICLE)
    )


@pytest.mark.parametrize("composition", COMPOSITIONS, ids=lambda c: c.name)
def test_every_wrong_coefficient_is_noticed(composition, mp50):
    assert is_right(composition)
    assert [properties.run(wrong, 1) for wrong in faulty(composition) if is_right(wrong)] == []
