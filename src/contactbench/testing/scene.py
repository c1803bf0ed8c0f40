"""The rules of `scene.base.Scene`, by their numbers there; derivatives are central differences at 50 digits."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from contactbench.errors import BadInput, excerpt
from contactbench.numbers.protocol import Arithmetic
from contactbench.registry import NAME
from contactbench.scene import AnyState, Scene, verify
from contactbench.scene.definition import verify_along
from contactbench.testing.rules import Finding, follow, require
from contactbench.truth import decimal_context, with_decimals

if TYPE_CHECKING:
    from mpmath import MPContext

DIGITS = 50
#: central differences of step 10⁻¹⁵ at 50 digits: truncation 10⁻³⁰, cancellation 10⁻³⁵
DELTA = "1e-15"
#: a state given in float64 satisfies its constraints (a quaternion of length 1) to 10⁻¹⁶
CLOSE = 1e-12
STATES = 3


@dataclass(frozen=True)
class SceneCase:
    """A scene, also at 50 digits, and the largest gap of the rule that is followed, relative to the size."""

    scene: Scene
    measured: dict[str, float] = field(default_factory=dict, compare=False)

    @cached_property
    def xp(self) -> MPContext:
        return decimal_context(DIGITS)

    @cached_property
    def twin(self) -> Scene:
        return with_decimals(self.scene, self.xp.mpf)

    @cached_property
    def states(self) -> list[tuple[AnyState, AnyState]]:
        """Return states off the initial one along every tangent in turn: on floats, and the same at 50 digits."""
        rng, scene, states = np.random.default_rng(7), self.scene, []
        for _ in range(STATES):
            x = scene.initial(scene.carry())
            for i in range(len(scene.tangents(x))):
                x = scene.displaced(x, scene.tangents(x)[i], float(rng.uniform(-0.3, 0.3)))
            y = [float(c) for c in scene.pack(x)]
            states.append((self.read(y), self.read([self.xp.mpf(repr(c)) for c in y])))
        return states

    def read(self, y: Sequence[Arithmetic]) -> AnyState:
        state: AnyState = self.scene.unpack(y, self.scene.carry())
        return state

    def unit(self, j: int) -> AnyState:
        return self.read(
            [self.xp.mpf(int(i == j)) for i in range(len(self.scene.labels(self.scene.carry())))]
        )

    def moved(self, x: AnyState, v: AnyState, amount: Arithmetic) -> AnyState:
        pairs = zip(self.scene.pack(x), self.scene.pack(v), strict=True)
        return self.read([a + amount * b for a, b in pairs])

    def derivative(self, f: Callable[[Arithmetic], Iterable[Arithmetic]]) -> list[Arithmetic]:
        delta = self.xp.mpf(DELTA)
        return [(a - b) / (2 * delta) for a, b in zip(f(delta), f(-delta), strict=True)]

    def slope(
        self, f: Callable[[AnyState], Iterable[Arithmetic]], x: AnyState, v: AnyState
    ) -> list[Arithmetic]:
        return self.derivative(lambda d: f(self.moved(x, v, d)))

    def rate(self, x: AnyState) -> Arithmetic:
        """Return Γ' = ∂H/∂s."""
        along_s = self.unit(self.scene.labels(self.scene.carry()).index("s"))
        return self.slope(lambda x: [self.twin.hamiltonian_at(x)], x, along_s)[0]

    def near(self, a: Iterable[Arithmetic], b: Iterable[Arithmetic], what: str) -> None:
        a, b = list(a), list(b)
        size = max([1.0, *(float(abs(c)) for c in b)])
        gap = max(float(abs(p - q)) for p, q in zip(a, b, strict=True))
        self.measured["largest gap"] = max(gap / size, self.measured.get("largest gap", 0.0))
        require(gap < CLOSE * size, f"{what}: off by {gap:.1e}")


def declares(case: SceneCase) -> None:
    scene = case.scene
    require(isinstance(scene.name, str) and NAME.fullmatch(scene.name), f"name = {scene.name!r}")
    require(scene.t_end > 0, f"t_end = {scene.t_end!r}")
    require(all(hasattr(scene, field) for field in scene.initial_fields), f"fields {scene.initial_fields}")


def packs(case: SceneCase) -> None:
    scene = case.scene
    subsets = [names for n in range(len(scene.optional) + 1) for names in combinations(scene.optional, n)]
    for carry in {scene.carry(names) for names in subsets}:
        y, labels = scene.pack(scene.initial(carry)), scene.labels(carry)
        require(len(y) == len(labels), f"carry = {carry}: {len(y)} numbers, {labels}")
        x = scene.unpack(y, carry)
        require(list(scene.pack(x)) == list(y), f"carry = {carry}: {y} comes back as {scene.pack(x)}")
        require(len(scene.pack(scene.rhs(x))) == len(y), f"carry = {carry}: a slope of other fields")


def replaces_numbers(case: SceneCase) -> None:
    scene, x = case.scene, case.states[0][0]
    require(len(scene.number_names()) == len(scene.numbers()), "number_names and numbers differ in length")
    same = scene.with_numbers(scene.numbers())
    says = "with_numbers(numbers()) has another right-hand side"
    case.near(same.pack(same.rhs(x)), scene.pack(scene.rhs(x)), says)
    require(hash(same.structure) == hash(scene.structure), "with_numbers changes the structure")
    for name, number in zip(scene.number_names(), scene.numbers(), strict=True):
        if name:
            changed = scene.with_(**{name: number + 0.25})
            require(changed.numbers() != scene.numbers(), f"with_({name}=…) changes no number")


def is_one_definition(case: SceneCase) -> None:
    scene, twin = case.scene, case.twin
    functions: dict[str, Callable[[Scene, AnyState], Sequence[Arithmetic]]] = {
        "rhs": lambda scene, x: scene.pack(scene.rhs(x))
    }
    if scene.has_energy:
        functions["energy"] = lambda scene, x: [scene.energy(x)]
    if scene.is_contact:
        functions["hamiltonian_at"] = lambda scene, x: [scene.hamiltonian_at(x)]
    for x, z in case.states:
        pair = case.read([np.array([c, 2 * c]) for c in scene.pack(x)])
        for name, values in functions.items():
            plain = values(scene, x)
            first = [np.broadcast_to(np.asarray(c), 2)[0] for c in values(scene, pair)]
            case.near(first, plain, f"{name} on arrays")
            case.near(values(twin, z), plain, f"{name} on 50-digit numbers")


def derives(case: SceneCase) -> None:
    scene, twin = case.scene, case.twin
    verify(scene)
    verify_along(scene)
    for x, z in case.states:
        y = scene.pack(x)
        t = 0.0 if scene.clock is None else y[scene.clock]
        given = scene.slopes(t, scene.without_clock(y), scene.carry())
        case.near(given, scene.without_clock(scene.pack(scene.rhs(x))), "slopes are not those of rhs")
        rows = twin.jacobian(z)
        require((rows is not None) == scene.has_jacobian, f"has_jacobian = {scene.has_jacobian}")
        for j in range(len(y)) if scene.has_jacobian else ():
            column = case.slope(lambda z: scene.pack(twin.rhs(z)), z, case.unit(j))
            case.near([row[j] for row in rows], column, f"jacobian, column {j}")


def is_a_contact_system(case: SceneCase) -> str | None:
    """η(X) = −H and L_X η = −Γ' η, which is X = X_H and no other."""
    twin = case.twin
    if not case.scene.is_contact:
        return "no contact system"

    def lie_derivative(x: AnyState, v: AnyState) -> list[Arithmetic]:
        """Return that of η on v: its slope while x moves along X and v with the flow."""
        field = twin.rhs(x)
        pushed = case.read(case.slope(lambda x: twin.pack(twin.rhs(x)), x, v))
        return case.derivative(
            lambda d: [twin.contact_form(case.moved(x, field, d), case.moved(v, pushed, d))]
        )

    for _, x in case.states:
        rate = case.rate(x)
        case.near([twin.contact_form(x, twin.rhs(x))], [-twin.hamiltonian_at(x)], "η(X) is not −H")
        for v in twin.tangents(x):
            case.near(lie_derivative(x, v), [-rate * twin.contact_form(x, v)], "L_X η is not −Γ' η")
        if not twin.rate_changes:
            case.near([rate], [twin.conformal_rate], "conformal_rate is not ∂H/∂s")
    return None


def has_its_laws(case: SceneCase) -> None:
    scene, twin = case.scene, case.twin
    for x, z in case.states:
        field = twin.rhs(z)
        if not scene.may_gain_energy:
            growth = case.slope(lambda z: [twin.energy(z)], z, field)[0]
            require(growth <= CLOSE, f"H0 grows, {float(growth):.1e}, though it may not")
        if scene.has_momentum_law and scene.is_contact:
            slope = case.slope(lambda z: twin.momentum_at(z) or (), z, field)
            case.near(slope, [-case.rate(z) * c for c in twin.momentum_at(z) or ()], "J' is not −Γ' J")
        v, terms = scene.tangents(x)[0], []
        if scene.is_contact:
            terms += [("hamiltonian_terms < |H|", scene.hamiltonian_terms(x), scene.hamiltonian_at(x))]
            terms += [("contact_terms < |η(v)|", scene.contact_terms(x, v), scene.contact_form(x, v))]
        if (momentum := scene.momentum_at(x)) is not None:
            terms += [("momentum_terms < ‖J‖", scene.momentum_terms(x), math.hypot(*momentum))]
        for says, all_of_it, value in terms:
            require(all_of_it >= abs(value) - CLOSE * max(1.0, abs(value)), says)


def has_tangents(case: SceneCase) -> None:
    scene = case.scene
    for x, _ in case.states:
        tangents = scene.tangents(x)
        rows = np.array([scene.pack(v) for v in tangents], dtype=float)
        require(np.linalg.matrix_rank(rows) == len(tangents), "tangents that depend on each other")
        for v, row in zip(tangents, rows, strict=True):
            ahead, behind = (np.array(scene.pack(scene.displaced(x, v, d)), float) for d in (1e-5, -1e-5))
            gap = np.abs((ahead - behind) / 2e-5 - row).max()
            require(gap < 1e-9, f"displaced leaves along another tangent, off by {gap:.1e}")
        slope = np.array(scene.pack(scene.rhs(x)), dtype=float)
        if scene.clock is not None:  # tangents do not move the time
            require(slope[scene.clock] == 1, f"t' = {slope[scene.clock]}")
            slope[scene.clock] = 0
        rest = np.abs(slope - rows.T @ np.linalg.lstsq(rows.T, slope, rcond=None)[0]).max()
        require(rest < CLOSE * max(1.0, np.abs(slope).max()), "the right-hand side is no tangent")


def solves_its_equations(case: SceneCase) -> str | None:
    """Compare the closed form, where there is one, with the initial state and the slope of the equations."""
    twin, xp, exact = case.twin, case.xp, case.scene.exact
    if exact is None:
        return "no closed form"
    start, t = twin.initial(twin.carry()), xp.mpf(repr(case.scene.t_end)) / 7
    here = exact(twin, t, xp)
    known = [name for name, part in here._asdict().items() if part is not None]

    def flat(state: AnyState) -> list[Arithmetic]:
        parts = (getattr(state, name) for name in known)
        return [c for part in parts for c in (part if isinstance(part, tuple) else (part,))]

    case.near(flat(exact(twin, xp.mpf(0), xp)), flat(start), "exact starts elsewhere")
    field = twin.rhs(start._replace(**{name: getattr(here, name) for name in known}))
    slope = case.derivative(lambda d: flat(exact(twin, t + d, xp)))
    case.near(slope, flat(field), "exact does not solve the equations")
    return None


EQUATIONS = (declares, packs, replaces_numbers, is_one_definition, derives)
STRUCTURE = (is_a_contact_system, has_its_laws, has_tangents, solves_its_equations)
SCENE_RULES: dict[int, Callable[[SceneCase], str | None]] = dict(enumerate((*EQUATIONS, *STRUCTURE), start=1))


def scene_findings(scene: Scene) -> Iterator[Finding]:
    return follow(SCENE_RULES, SceneCase(scene), scene.name)


def check_scene(scene: Scene) -> list[Finding]:
    """Follow every rule of `scene.base.Scene`.

    Parameters
    ----------
    scene
        Itself, such as ``cb.SCENES["mine"]``.

    Returns
    -------
    list of Finding
        The rules that were followed, and what was measured.

    Raises
    ------
    Violation
        Where a rule is broken.
    BadInput
        For what is no scene.

    Examples
    --------
    >>> import contactbench as cb
    >>> from contactbench.testing import check_scene
    >>> [finding.rule for finding in check_scene(cb.SCENES["oscillator"])]
    [1, 2, 3, 4, 5, 6, 7, 8, 9]
    """
    if not isinstance(scene, Scene):
        raise BadInput(f"scene = {excerpt(scene)}: must be a scene, such as cb.SCENES['particle']")
    return list(scene_findings(scene))
