"""Tables for the free body ∘ weak damping: they solve their conditions, and their error is ε hⁿ + ε² hᵐ."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import pytest
from mpmath import mp

import contactbench as cb
from contactbench.methods.contact import contact_method
from contactbench.splitting.composition import Composition
from contactbench.truth import decimal_context, with_decimals
from near_integrable import ABA84, ABA864, ABA1064, NEAR_INTEGRABLE

WEAK = cb.SCENES["rigid_body_anisotropic"]
tables = pytest.mark.parametrize("table", NEAR_INTEGRABLE, ids=lambda c: c.name)

#: a₁, b₁, a₂, b₂, … as printed; b₄ of (8,6,4) only as far as the copies of it do, which lack its 31st digit
PUBLISHED = {
    ABA84: [
        "0.07534696026989288842", "0.19022593937367661925", "0.51791685468825678230", "0.84652407044352625706",
        "-0.09326381495814967072", "-1.07350001963440575260",
    ],
    ABA864: [
        "0.0711334264982231177779387300061549964174", "0.183083687472197221961703757166430291072",
        "0.241153427956640098736487795326289649618", "0.310782859898574869507522291054262796375",
        "0.521411761772814789212136078067994229991", "-0.0265646185119588006972121379164987592663",
        "-0.333698616227678005726562603400438876027", "0.06539614228237341845597217939",
    ],
    ABA1064: [
        "0.03809449742241219545697532230863756534060", "0.09585888083707521061077150377145884776921",
        "0.1452987161169137492940200726606637497442", "0.2044461531429987806805077839164344779763",
        "0.2076276957255412507162056113249882065158", "0.2170703479789911017143385924306336714532",
        "0.4359097036515261592231548624010651844006", "-0.01737538195906509300561788011852699719871",
        "-0.6538612258327867093807117373907094120024",
    ],
}  # fmt: skip


def conditions(table: Composition, n: int, m: int) -> list[mp.mpf]:
    """What is left of the conditions on the terms in ε up to hⁿ and in ε² up to hᵐ; see the module of the tables."""
    a = [mp.mpf(c.numerator) / c.denominator for name, c in table.stages if name == "free"]
    b = [mp.mpf(c.numerator) / c.denominator for name, c in table.stages if name == "damp"]
    half = mp.mpf(1) / 2
    x = [mp.fsum(a[: i + 1]) - half for i in range(len(b))]

    def power(k: int) -> mp.mpf:
        """∫ y^k over [−½, ½]."""
        return (half ** (k + 1) - (-half) ** (k + 1)) / (k + 1)

    left = [mp.fsum(a) - 1]
    left += [mp.fsum(w * y**k for w, y in zip(b, x, strict=True)) - power(k) for k in range(n)]
    for degree in range(1, m - 2, 2):
        for k in range(degree + 1):
            found = mp.fsum(w * w * y**degree / 2 for w, y in zip(b, x, strict=True))
            for i in range(len(b)):
                found += mp.fsum(b[i] * b[j] * x[i] ** k * x[j] ** (degree - k) for j in range(i + 1, len(b)))
            true = (power(degree + 1) - (-half) ** (k + 1) * power(degree - k)) / (k + 1)
            left.append(found - true)
    return left


@tables
def test_the_coefficients_solve_their_conditions_to_48_digits(table, mp50):
    n, m = NEAR_INTEGRABLE[table]
    assert max(map(abs, conditions(table, n, m))) < mp50.mpf(10) ** -48
    assert max(map(abs, conditions(table, n + 2, m))) > 1e-9  # and no more than that
    assert max(map(abs, conditions(table, n, m + 2))) > 1e-9


@tables
def test_every_wrong_coefficient_breaks_a_condition(table, mp50):
    """One in a thousand on a pair of stages of one flow, the sum kept."""
    n, m = NEAR_INTEGRABLE[table]
    stages = list(table.stages)
    for i, (name, c) in enumerate(stages[: len(stages) // 2]):
        j = next(j for j in range(i + 1, len(stages)) if stages[j][0] == name)
        wrong = list(stages)
        wrong[i], wrong[j] = (name, c * 1001 / 1000), (name, stages[j][1] - c / 1000)
        mutant = Composition(table.name, 4, tuple(wrong), "")
        assert max(map(abs, conditions(mutant, n, m))) > 1e-8, (i, name)


@tables
def test_the_coefficients_are_the_published_ones(table):
    """To a few units of the last digit printed."""
    assert table.palindromic
    for (_, mine), printed in zip(table.stages, PUBLISHED[table], strict=False):
        digits = len(printed.partition(".")[2])
        assert abs(mine - Fraction(printed)) * 10**digits < 20


def parts(table: Composition, h: str, epsilon: str, context) -> list:
    """Odd and even part in ε of ‖Φ_h − Φ_{h/2}∘Φ_{h/2}‖ for damping ε D; without damping it is 0."""
    method = contact_method(table)
    defects = []
    for sign in (1, -1):
        twin = with_decimals(WEAK, context.mpf)
        twin = twin._replaced(rates=tuple(sign * context.mpf(epsilon) * rate for rate in twin.rates))
        x, step = twin.initial(()), context.mpf(h)
        once, twice = (method.advance(twin, x, step / k, k, context).M for k in (1, 2))
        defects.append([a - b for a, b in zip(once, twice, strict=True)])
    return [context.norm([(a + s * b) / 2 for a, b in zip(*defects, strict=True)]) for s in (-1, 1)]


@tables
def test_the_error_has_its_exponents_in_step_and_damping(table):
    """ε hⁿ + ε² hᵐ, from a step of 10⁻⁴ at 160 digits: the part odd in ε is the first, the even one the second."""
    context = decimal_context(160)
    coarse, fine, weaker = (
        parts(table, h, epsilon, context)
        for h, epsilon in (("1e-4", "1e-40"), ("0.5e-4", "1e-40"), ("1e-4", "1e-41"))
    )
    exponents = [float(context.log(a / b, 2)) - 1 for a, b in zip(coarse, fine, strict=True)]
    assert exponents == pytest.approx(NEAR_INTEGRABLE[table], abs=0.01)
    in_damping = [float(context.log10(a / b)) for a, b in zip(coarse, weaker, strict=True)]
    assert in_damping == pytest.approx([1, 2], abs=1e-6)


@tables
def test_the_tables_run_compiled_and_beat_the_palindrome_by_far_at_the_same_number_of_flows(table):
    """On weak damping, ε = 10⁻⁴: what they are for, counted in free flows."""
    scene = WEAK.with_(name="weak", damping=tuple(1e-4 * d for d in (0.05, 0.1, 0.3)), t_end=100.0)
    flows = sum(name == "free" for name, _ in table.stages) - 1
    cb.METHODS.add(contact_method(table))
    try:
        errors = [
            cb.LAWS["solution_error"](cb.solve(scene, name, step=h, save_at=[100.0], carry=()))
            for name, h in ((table.name, 1.0), ("contact-abc", 1.0 / flows))
        ]
    finally:
        cb.METHODS.pop(table.name)
    assert errors[0] < 1e-2 * errors[1]


def test_more_stages_give_more_at_equal_step():
    assert [len(c.stages) for c in NEAR_INTEGRABLE] == [11, 15, 17]
    assert all(len(a.stages) < len(b.stages) for a, b in pairwise(NEAR_INTEGRABLE))
