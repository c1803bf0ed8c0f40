"""The ledger of claims: complete, computed, and sensitive to the formulas it judges."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cases import few_slow
from contactbench.methods import METHODS
from contactbench.methods.contact import contact_method
from contactbench.paper import CLAIMS, Correction, Verdict, geometry, integrator, rigid_body, verdict
from contactbench.paper.curves import FIGURES, rows
from contactbench.paper.integrator import ABC, PRINTED, STRANG, threshold, unconditional_from
from contactbench.paper.ledger import BOUNDS, Claim, Measurement
from contactbench.questions import paper
from contactbench.scene import Mechanical, RigidBody
from contactbench.splitting.tables import COMPOSITIONS
from contactbench.tables.declared import CLAIMS_TABLE, MOTION
from contactbench.tables.schema import BEYOND
from contactbench.tables.store import merge


def ids(*numbers):
    return [f"C{n:02d}" for n in numbers]


MORE = ["X01", "X02"]  #: beyond the paper
ALL = [*ids(*range(1, 61)), *MORE]
#: rows that take long
LONG = [name for name, item in CLAIMS.items() if item.dear]
TABLES = {composition.name: composition for composition in COMPOSITIONS}
REFUTED = ids(4, 10, 16, 19, 20, 21, 22, 33, 39, 40, 43, 45, 46, 47, 51, 53, 54, 58, 60)
CORRECTED = ids(5, 25, 27, 42, 44)


def expected(name):
    return "refuted" if name in REFUTED else "holds, corrected" if name in CORRECTED else "holds"


@cache
def measured(name):
    return CLAIMS[name].row()


# -- the rows --------------------------------------------------------------------------------------
def test_ids():
    assert set(FIGURES) == {name for item in CLAIMS.values() for name in item.figures} == set(paper.PLANS)
    assert list(CLAIMS) == ALL
    assert {name for name, claim in CLAIMS.items() if claim.where == BEYOND} == set(MORE)


@pytest.mark.parametrize("name", few_slow(ALL, *LONG))
def test_row(name):
    """Its verdict; a statement fails where it is refuted or mended, and what is measured of a correction holds."""
    row = measured(name)
    assert row["status"] == "ok", row
    assert math.isfinite(row["measured"])
    assert set(row) <= set(CLAIMS_TABLE.columns)
    assert row["verdict"] == expected(name), row["evidence"]
    assert ("fails" in row["evidence"]) == (name in [*REFUTED, *CORRECTED])
    assert "fails" not in row.get("corrected_evidence", "")
    assert bool(row["correction_kind"]) == bool(CLAIMS[name].correction) == ("corrected_evidence" in row)


#: other parameters than the table's: the verdict must not hang on those
OTHERS = [
    *((name, {"seed": 1}) for name in ids(1, 4)),
    *((name, {"seed": 3}) for name in ids(10, 50, 52, 55, 56, 59)),
    *((name, {"gamma": 0.3}) for name in ids(14, 25, 31)),
    *((name, {"seed": 3, "gamma": 0.5}) for name in ids(5, 6, 37, 39, 44, 45, 46, 47, 49, 54)),
    ("C29", {"gamma": 0.02, "q": (0.5, -0.8), "p": (0.4, 0.1)}),
    ("C32", {"gamma": 0.3, "q": (0.5, -0.8), "p": (0.4, 0.1)}),
    ("C08", {"gamma": 1.5, "overdamped": 5.0, "start": (0.3, -0.7)}),
    ("C11", {"seed": 3, "gamma": 0.3}),
    ("C13", {"gamma": 0.4}),
    ("C15", {"seed": 2, "gamma": 1.0, "inertia": (0.5, 2.5, 1.0)}),
    ("C16", {"seed": 2, "gamma": 0.3, "inertia": (2.0, 1.0, 2.5)}),
    ("C17", {"gamma": 0.3, "inertia": (0.7, 1.0, 1.5)}),
    ("C18", {"seed": 7, "inertia": (0.8, 1.0, 1.7)}),
    ("C19", {"seed": 0, "cases": 600}),
    ("C20", {"seed": 3, "inertia": (0.8, 1.2, 2.5), "size": 1.7}),
    ("C21", {"rates": (0.3, 0.7), "kernel": (1.0, 0.0, 1.0)}),
    ("C22", {"gamma": 0.03, "inertia": (0.5, 1.0, 1.4)}),
    ("C24", {"seed": 2, "gamma": 2.0}),
    ("C27", {"seed": 1, "gamma": 0.5}),
    ("C28", {"h": 0.1, "steps": 300}),
    ("C30", {"gamma": 0.05, "weak": 1e-4, "coarse": 0.05}),
    ("C36", {"weak": 0.35, "gammas": (0.0, 0.5, 3.0)}),
    ("C38", {"gamma": 0.3, "start": (0.5, -0.8)}),
    ("C40", {"kernel": (1.0, 0.0, 1.0), "rate": 0.3}),
    ("C41", {"seed": 2, "inertia": (0.8, 1.2, 1.9)}),
    ("C42", {"gamma": 0.5}),
    ("C43", {"weak": 1e-4, "coarse": 0.05}),
    ("C48", {"gamma": 1.0, "h": 0.3}),
    ("C51", {"scene": "central"}),
    ("C53", {"q": (0.5, -0.8), "p": (0.4, 0.1)}),
    ("C57", {"seed": 3, "gamma": 0.3, "inertia": (0.8, 1.2, 1.9)}),
    *((name, {"gamma": 0.3}) for name in ids(58, 60)),
    ("X01", {"gamma": 0.3, "weak": 3e-5, "steps": 400_000}),
    ("X02", {"rough": 1e-5, "fine": 1e-9}),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "parameters"), OTHERS, ids=[name for name, _ in OTHERS])
def test_a_verdict_does_not_hang_on_the_parameters(name, parameters):
    row = CLAIMS[name].row(**parameters)
    assert row["status"] == "ok", row
    assert row["verdict"] == expected(name), row["evidence"]
    assert "fails" not in row.get("corrected_evidence", "")


@pytest.mark.parametrize("bad", [PRINTED, ABC, STRANG])
def test_one_bad_contact_method_refutes_the_claim_of_all(bad, monkeypatch):
    drifts = dict.fromkeys([PRINTED, ABC, STRANG], 1e-16) | {bad: 3e-3}
    drifts |= {"rk4": 1e-2, "diffrax-tsit5": 2e-2}
    monkeypatch.setattr(integrator, "solve", lambda scene, name, **setting: name)
    monkeypatch.setattr(integrator, "LAWS", {"contact_drift": drifts.__getitem__})
    row = CLAIMS["C34"].row()
    assert (row["verdict"], row["measured"]) == ("refuted", 3e-3)
    drifts[bad] = 1e-16
    assert CLAIMS["C34"].row()["verdict"] == "holds"


# -- stability of the damped body's rotations ------------------------------------------------------
def test_an_extreme_axis_may_be_a_saddle():
    D, M = rigid_body.COUNTEREXAMPLE, [0.0, 0.0, 1.0]
    assert rigid_body.growth(D, M) == pytest.approx((math.sqrt(14 / 9) - 1) / 2, rel=1e-12)  # 0.1236
    end = rigid_body.momentum_at(D, [1e-6, 1e-6, 1.0], 400.0)
    assert end == pytest.approx([0.0, 0.0, -0.678774], abs=1e-6)
    assert rigid_body.growth(D, [0.0, 0.0, -1.0]) < 0  # the sign of M* matters


@pytest.mark.parametrize("axes", [(0,), (1,), (2,)])
@pytest.mark.parametrize("seed", [11, 12])
def test_criterion(axes, seed, monkeypatch):
    """Trace and determinant against the full 3×3 spectrum, and a formula without d_jk, which is wrong."""
    cases = rigid_body.random_equilibria(axes, 150, seed)
    assert {np.linalg.matrix_rank(D) for D, _, _ in cases} == {0, 1, 2}
    assert all(np.allclose(D @ M, 0, atol=1e-14) for D, _, M in cases)
    assert rigid_body.count_misjudged(cases) == 0
    exact = rigid_body.criterion
    monkeypatch.setattr(rigid_body, "criterion", lambda D, *more: exact(np.diag(np.diag(D)), *more))
    assert rigid_body.count_misjudged(cases) > 5


@pytest.mark.parametrize("claim", few_slow(["C19", "C20", "C50"], "C20", "C50"))
def test_what_needs_distinct_moments_is_measured_where_they_are_not(claim, monkeypatch):
    monkeypatch.setattr(rigid_body, "TIED", rigid_body.INERTIA)
    assert "fails" in CLAIMS[claim].row()["corrected_evidence"]


def test_one_rule_judges_the_composition_and_its_decay_alike():
    """The order of the flows is corrected in both, and what the text says of the integrator survives."""
    assert measured("C25")["verdict"] == measured("C27")["verdict"] == Verdict.corrected


def test_numbers_by_hand():
    """Steps of any size from a damping on; at t = 100 s = 1e-5, but ∫L = −0.025 and 0.5 is dissipated."""
    assert threshold() == pytest.approx(0.49134, abs=5e-6)
    assert unconditional_from("contact-printed") == pytest.approx(threshold(), abs=1e-6)
    assert "|s − ∫(T − V)|: 0.025 ≥" in measured("C38")["corrected_evidence"]


# -- the logic -------------------------------------------------------------------------------------
PASS, FAIL = Measurement("x", 0.0, "≤", 1.0, "test"), Measurement("x", 0.0, "≥", 1.0, "test")


@pytest.mark.parametrize(
    ("statement", "corrected", "kind", "expected"),
    [
        ([PASS], [], None, "holds"),
        *(([PASS], [PASS], kind, "holds") for kind in ("extends", "repairs", "sharpens")),
        ([PASS], [FAIL], "sharpens", "holds"),
        ([PASS, FAIL], [PASS], "repairs", "corrected"),
        ([PASS, FAIL], [PASS, FAIL], "repairs", "refuted"),
        ([FAIL], [PASS], "replaces", "refuted"),
        ([FAIL], [], None, "refuted"),
    ],
)
def test_verdict(statement, corrected, kind, expected):
    assert verdict(statement, corrected, kind and Correction[kind]) is Verdict[expected]


@pytest.mark.parametrize(
    ("measure", "message"),
    [
        (lambda: 1 / 0, "ZeroDivisionError"),
        (lambda: [math.nan], "not finite"),
        (lambda: [0.0, 0.0], "ValueError"),  # a number that the statement does not name
        (list, "ValueError"),
    ],
)
def test_what_cannot_be_measured_has_no_verdict(measure, message):
    row = Claim("C00", "", "", "", measure, measured=[["x", "≤", 1.0, "test"]]).row()
    assert (row["status"], "verdict" in row) == ("failed", False)
    assert message in row["message"]


def test_what_the_words_and_bounds_of_a_statement_come_from():
    rows = [["x at γ = %(gamma)g", "≤", "identity"], ["y of %(n)d", "≥", "computed"]]
    claim = Claim("C00", "", "", "", lambda gamma=0.1: [0.0, {"n": 3}, (1.0, gamma)], measured=rows)
    x, y = claim.measurements(gamma=0.5)
    assert (x.quantity, x.bound, x.passes) == ("x at γ = 0.5", BOUNDS["identity"][0], True)
    assert (y.quantity, y.bound, y.why, y.passes) == ("y of 3", 0.5, "computed", True)


# -- the verdicts follow the formulas --------------------------------------------------------------
def changed_flow(name, change):
    """A flow whose momentum is another function of the momentum before and after it."""
    flow = Mechanical.flows[name]

    def apply(scene, x, constants, xp):
        new = flow.apply(scene, x, constants, xp)
        return new._replace(p=tuple(change(a, b) for a, b in zip(x.p, new.p, strict=True)))

    return Mechanical.flows, name, flow._replace(apply=apply)


def frictionless(scene, x, rhs=Mechanical.rhs):
    return rhs(scene, x)._replace(p=tuple(-g for g in scene.dV(x.q)))


def without_s(scene, x, rhs=Mechanical.rhs):
    """s' = T − V: what accumulates does not decay."""
    return rhs(scene, x)._replace(s=scene.kinetic(x.p) - scene.V(x.q))


def without_torque(scene, x, rhs=RigidBody.rhs):
    """Without M × Ω every axis is as good as another: the intermediate one is no saddle."""
    return rhs(scene, x)._replace(M=tuple(-d for d in scene.damp_matrix_function(x.M, lambda rate: rate)))


def undamped(scene, x, rhs=RigidBody.rhs):
    return rhs(scene, x)._replace(M=tuple(rhs(scene.with_(gamma=0.0), x).M))


def without_friction(hamiltonian, equations=geometry.contact_equations):
    """Hamilton's equations in place of the contact equations: p' without −p H_s."""

    def field(y):
        n = (len(y) - 1) // 2
        rate = geometry.gradient(hamiltonian)(y)[-1]
        return equations(hamiltonian)(y).at[n : 2 * n].add(rate * y[n : 2 * n])

    return geometry.Field(field)


def halved_action(scene, t, *carry, reference=geometry.reference):
    """An action that does not decay as Herglotz's does."""
    true = reference(scene, t, *carry)
    return replace(true, y=true.y * [1.0, 1.0, 0.5])


PALINDROME = contact_method(replace(TABLES[ABC], name=PRINTED))
#: what is changed, its name there, what takes its place, and the verdicts then
CHANGES = [
    # p is damped twice: J decays at the wrong rate
    (*changed_flow("damp", lambda a, b: b * b / a), {"C24": "refuted", "C27": "refuted"}),
    # half a kick: no Verlet at γ = 0, not the motion RK4 finds, not variational
    (*changed_flow("kick", lambda a, b: (a + b) / 2), dict.fromkeys(ids(28, 29, 48), "refuted")),
    (Mechanical, "rhs", frictionless, {"C03": "refuted", "C06": "refuted"}),
    (Mechanical, "rhs", without_s, dict.fromkeys(ids(3, 27, 37), "refuted")),
    (RigidBody, "rhs", without_torque, dict.fromkeys(ids(15, 50, 56), "refuted")),
    (RigidBody, "rhs", undamped, dict.fromkeys(ids(17, 57), "refuted")),
    (RigidBody, "momentum", lambda scene, x: x.M, {"C11": "refuted"}),  # the body's, for the momentum map
    (geometry, "reference", halved_action, {"C38": "refuted"}),
    (METHODS, PRINTED, PALINDROME, {"C25": "holds"}),
    (integrator, "PRINTED", "rk4", {"C43": "holds", "C52": "refuted"}),  # RK4 lowers H0 in every step
    (geometry, "off_decay", lambda *_: 1.0, {"C58": "holds"}),  # a law that fails fills no gap
    (geometry, "eta", lambda y, eta=geometry.eta: eta(y) * y[0], {"C55": "refuted"}),
]


CHANGED = [(*change, claim, then) for *change, verdicts in CHANGES for claim, then in verdicts.items()]


@pytest.mark.quick(claim=tuple({*ALL} - {*LONG, "C50"}))
@pytest.mark.parametrize(("place", "name", "change", "claim", "then"), CHANGED)
def test_a_wrong_formula_changes_the_verdict(place, name, change, claim, then, monkeypatch, fresh):
    put = monkeypatch.setitem if isinstance(place, dict) else monkeypatch.setattr
    put(place, name, change)
    assert CLAIMS[claim].row().get("verdict") == then != expected(claim)


#: what is changed, and the claims whose correction, or statement, fails then
CORRECTIONS = [
    (geometry, "contact_equations", without_friction, ("C44", "C46", "C47", "C49")),
    (geometry, "eta", lambda y, eta=geometry.eta: 2 * eta(y) + y, ("C45",)),  # has another Lie derivative
    (RigidBody, "momentum", lambda scene, x: x.M, ("C16",)),
]
CASES = [(*change, claim) for *change, claims in CORRECTIONS for claim in claims]


@pytest.mark.quick(claim=("C46", "C49", "C16"))
@pytest.mark.parametrize(("place", "name", "change", "claim"), CASES)
def test_a_wrong_formula_breaks_the_correction(place, name, change, claim, monkeypatch, fresh):
    monkeypatch.setattr(place, name, change)
    row = CLAIMS[claim].row()
    assert "fails" in row.get("corrected_evidence", row["evidence"])
    assert row["verdict"] == "refuted"


def test_a_method_unstable_where_the_splitting_is_not_refutes_stability(monkeypatch):
    """Explicit Euler."""
    monkeypatch.setattr(integrator, "PRINTED", "rk4")
    monkeypatch.setattr(integrator, "radius", lambda method, gamma, h: np.hypot(1, h))
    monkeypatch.setattr(integrator, "border", lambda method, gamma: 2.0)
    monkeypatch.setattr(integrator, "unconditional_from", lambda method: 0.0)
    assert CLAIMS["C36"].row()["verdict"] == "refuted" != expected("C36")


def test_an_integrator_of_another_order_fills_no_gap(monkeypatch):
    monkeypatch.setattr(integrator, "PUBLISHED", {"herglotz1": 2019})
    assert CLAIMS["C51"].row(scene="central")["verdict"] == "holds"


# -- the figures ----------------------------------------------------------
@pytest.mark.parametrize("name", few_slow(FIGURES, "paper_stability"))
def test_figures(name, tmp_path):
    frame = merge(MOTION, rows(name), tmp_path)
    assert frame[["x", "y"]].map(math.isfinite).all(axis=None)
    (figure,) = paper.all_figures(frame)
    assert figure.name == name
    assert figure.panels
    assert all(panel.curves for panel in figure.panels)
