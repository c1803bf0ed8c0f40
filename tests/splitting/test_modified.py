"""The modified Hamiltonian of the splittings: its brackets, its order, and a million steps along which it decays."""

import math
from fractions import Fraction

import numpy as np
import pytest

import contactbench as cb
from cases import USER, random_state
from contactbench.methods.fixed_step import FixedStep
from contactbench.splitting import modified
from contactbench.splitting.modified import bracket, modified_hamiltonian, weights
from contactbench.splitting.tables import COMPOSITIONS
from contactbench.xla import jax, jnp

LAW = cb.LAWS["modified_hamiltonian"]
PARTICLE, CENTRAL = cb.SCENES["particle"], cb.SCENES["central"]
SCENES = [cb.SCENES["oscillator"], PARTICLE, CENTRAL.with_(mass=1.5), USER]
STRANG = next(c for c in COMPOSITIONS if c.name == "contact-strang")


def test_the_series_of_strang_is_the_one_that_is_printed_everywhere():
    """−1/24 [B, [B, A]] + 1/12 [A, [A, B]] and −1/720 [A, [A, [A, [A, B]]]] (Hairer, Lubich, Wanner, §III.4.2)."""
    found = weights(STRANG.stages)
    assert found["A"] == Fraction(1, 12)
    assert found["B"] == Fraction(1, 24)
    assert found["AAA"] == Fraction(-1, 720)


@pytest.mark.parametrize("letters", ["", "A", "B", "AA", "AB", "BA", "BB"])
@pytest.mark.quick(letters="BA")
def test_brackets_are_jacobis_on_the_whole_of_contact_space(letters):
    """By automatic differentiation of the full bracket in q, p and s."""
    scene, x = CENTRAL.with_(gamma=0.3, mass=1.5), random_state(CENTRAL, 8)
    A, B = (lambda y: scene.kinetic(tuple(y[2:4])) + scene.gamma * y[4]), (lambda y: scene.V(tuple(y[:2])))

    def jacobi(f, g):
        def value(y):
            p, df, dg = y[2:4], jax.grad(f)(y), jax.grad(g)(y)
            canonical = df[:2] @ dg[2:4] - df[2:4] @ dg[:2]
            return canonical + df[4] * (p @ dg[2:4] - g(y)) - dg[4] * (p @ df[2:4] - f(y))

        return value

    function = jacobi(A, B)
    for letter in reversed(letters):
        function = jacobi(A if letter == "A" else B, function)
    here = float(function(jnp.array([*x.q, *x.p, x.s])))
    assert bracket(scene, letters)(x.q, x.p) == pytest.approx(here, rel=1e-12, abs=1e-13)


# -- order -----------------------------------------------------------------------------------------
def deviation(scene, name, h, degree=modified.DEGREE):
    """max |H̃ e^{γt} / H̃(y₀) − 1|."""
    composition = next(c for c in COMPOSITIONS if c.name == name)
    solution = cb.solve(scene, name, step=h, save_at=0.4 * np.arange(1, 51))
    along, start = (
        modified_hamiltonian(scene, composition, x, h, degree) for x in (solution.states(), solution.start())
    )
    return np.abs(along * np.exp(scene.gamma * solution.t) / start - 1).max()


def order(scene, name, degree=modified.DEGREE):
    coarse, fine = (deviation(scene, name, h, degree) for h in (0.1, 0.05))
    return math.log2(coarse / fine)


#: degrees of the brackets that are kept, and the order that is left
ORDERS = [(scene.with_(t_end=20.0, s=0.2), "strang", n, n + 1) for scene in SCENES for n in (1, 3, 5)]
ORDERS += [(PARTICLE, "rkn4", n, n + 1) for n in (3, 5)]


@pytest.mark.parametrize(("scene", "name", "degree", "expected"), ORDERS)
def test_every_bracket_gains_two_orders(scene, name, degree, expected):
    """The first correction of a method of order four is the fifth."""
    assert order(scene, f"contact-{name}", degree) == pytest.approx(expected, abs=0.15)


# -- the law ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("method", [name for name, m in cb.METHODS.items() if isinstance(m, FixedStep)])
def test_the_law_is_blank_where_a_run_is_not_the_flow_of_one_function(method):
    """Neither for other methods, nor for stages before the first step, nor for three parts."""
    composition = getattr(cb.METHODS[method], "composition", None)
    stages = () if composition is None or composition.processor else tuple(composition.stages)
    one_function = {kind for kind, _ in stages} == {"kick", "drift_damp"} and stages == stages[::-1]
    found = LAW(cb.solve(PARTICLE, method, step=0.1, save_at=[10.0, 20.0]))
    assert math.isfinite(found) == one_function


def pendulum(xp):
    force = {"potential": lambda q: -xp.cos(q[0]), "gradient": lambda q: (xp.sin(q[0]),)}
    return cb.Mechanical(name="pendulum", **force, q=(1.0,), p=(0.0,), gamma=0.1, t_end=20.0)


def test_a_potential_needs_functions_of_dual_numbers_for_the_law():
    plain = cb.solve(pendulum(math), "contact-strang", step=0.1, save_at=[2.0], engine="python")
    assert np.isnan(LAW(plain))
    assert order(pendulum(cb.math), "contact-strang") == pytest.approx(6, abs=0.15)
