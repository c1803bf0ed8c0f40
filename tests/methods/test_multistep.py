"""The coefficients of multistep methods follow from α; what they cost, and what they have no map for."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

import contactbench as cb
from contactbench.measure.laws import absolute_error

NAMES = "quinlan-tremaine8", "quinlan-tremaine12", "stormer12"
#: half of the symmetric β, with their denominator, as printed
PRINTED = {
    "quinlan-tremaine8": (12096, (17671, -23622, 61449, -50516)),
    "quinlan-tremaine12": (
        53222400,
        (90987349, -229596838, 812627169, -1628539944, 2714971338, -3041896548),
    ),
}
#: Störmer's formula in backward differences (Hairer, Nørsett, Wanner I, §III.10)
DIFFERENCES = (
    "1 0 1/12 1/12 19/240 3/40 863/12096 275/4032 33953/518400 8183/129600 3250433/53222400 4671/78848"
)


@pytest.mark.parametrize("name", PRINTED)
def test_the_forces_of_symmetric_methods_are_the_printed_ones(name):
    denominator, half = PRINTED[name]
    half = [Fraction(c, denominator) for c in half]
    assert cb.METHODS[name].beta == [*half, *half[-2::-1]]
    assert (1, *cb.METHODS[name].alpha) == (1, *cb.METHODS[name].alpha)[::-1]


def test_stormers_forces_are_those_of_its_backward_differences():
    powers, beta = [Fraction(1)], [Fraction(0)] * 12
    for sigma in map(Fraction, DIFFERENCES.split()):
        beta = [b + sigma * p for b, p in zip(beta, [*powers, *[Fraction(0)] * 12], strict=False)]
        powers = [a - b for a, b in zip([*powers, 0], [0, *powers], strict=True)]
    assert cb.METHODS["stormer12"].beta == beta


@pytest.mark.parametrize("name", NAMES)
def test_momenta_and_actions_are_exact_on_polynomials(name):
    """h z' from the last increment and z''; ∫ g over ten steps: both of a higher degree than the method's own."""
    method = cb.METHODS[name]
    K = method.forces
    for d in range(2, K + 3):
        second = [Fraction(d * (d - 1) * (10 - j) ** (d - 2)) for j in range(K + 1)]
        found = 10**d - 9**d + sum(c * a for c, a in zip(method.velocity, second, strict=True))
        assert found == d * 10 ** (d - 1)

    def ends(n, d):
        return sum(c * Fraction(n - j) ** d for j, c in enumerate(method.quadrature))

    for d in range(K + 1):
        inner = sum(i**d for i in range(1, 11))
        assert inner + ends(10, d) - ends(0, d) == Fraction(10 ** (d + 1), d + 1)


#: steps over the whole run, and twice the error measured
LONG = {
    "quinlan-tremaine8": (32_000, 8.5e-9),
    "quinlan-tremaine12": (16_000, 2.4e-9),
    "stormer12": (16_000, 7.2e-8),
}


@pytest.mark.parametrize("name", NAMES)
def test_a_long_run_takes_one_gradient_a_step(name):
    scene, (n, bound) = cb.SCENES["particle_long"], LONG[name]
    solution = cb.solve(scene, name, step=scene.t_end / n, save_at=[scene.t_end])
    error, size = absolute_error(solution)
    assert error.max() / size < bound
    assert n < solution.counts.evaluations == cb.METHODS[name].counts(scene, n) < n + 350
    starts = cb.solve(scene, name, step=scene.t_end / n, save_at=scene.t_end * np.arange(1, 5) / 4)
    assert starts.counts.evaluations - n == 4 * (solution.counts.evaluations - n)


def test_the_energy_of_a_symmetric_method_has_no_drift_at_a_step_that_stormers_does_not_bear():
    scene, errors = cb.SCENES["central"].with_(gamma=0.0, t_end=2000.0), []
    for t in np.linspace(100, 2000, 20):
        end = cb.solve(scene, "quinlan-tremaine12", step=0.1, save_at=[t], carry=()).y[-1]
        x = scene.unpack(end.tolist(), ())
        errors.append(abs(scene.energy(x) - scene.energy(scene.initial(()))))
    assert max(errors[10:]) < 2 * max(errors[:10]) < 1e-4  # measured: 1.3 times as large
    assert cb.solve(scene, "stormer12", step=0.1, save_at=[2000.0]).status is cb.Status.diverged


@pytest.mark.parametrize("name", NAMES)
def test_what_it_has_no_formula_for_is_refused_in_one_line(name):
    with pytest.raises(cb.BadInput, match="a step needs those before it"):
        cb.step_map("particle", name)
    with pytest.raises(cb.BadInput, match="no clean power of its step"):
        cb.prepare("particle", name, rtol=1e-6)
    refusals = dict.fromkeys(
        ("rigid_body", "quadratic_damping", "forced_oscillator"), "forces that depend on q alone"
    )
    for scene, reason in (refusals | {"fput": "no loop over sites"}).items():
        solution = cb.solve(scene, name, step=0.1)
        assert solution.status is cb.Status.unsupported
        assert reason in solution.message
    ahead = cb.SCENES["oscillator"].with_(gamma=2.0, t_end=701.0)
    assert "takes γ t up to 1400" in cb.solve(ahead, name, step=0.1).message
