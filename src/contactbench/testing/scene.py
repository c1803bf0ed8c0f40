"""Check the rules of `scene.base.Scene`, by their numbers there; derivatives are central differences at 50 digits."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np

from contactbench.errors import BadInput, excerpt
from contactbench.numbers.protocol import Arithmetic
from contactbench.registry import NAME
from contactbench.scene import AnyState, Scene, verify
from contactbench.scene.definition import verify_along
from contactbench.testing.rules import Finding, follow, require
from contactbench.truth import decimal_context, with_decimals

XP = decimal_context(50)
#: truncation 10⁻³⁰, cancellation 10⁻³⁵
DELTA = XP.mpf("1e-15")
#: a state given in float64 satisfies its constraints (a quaternion of length 1) to 10⁻¹⁶
CLOSE = 1e-12
STATES = 3


@dataclass(frozen=True)
class SceneCase:
    """Hold a scene, its twin at 50 digits, and some states away from the initial one."""

    scene: Scene

    @cached_property
    def twin(self) -> Scene:
        return with_decimals(self.scene, XP.mpf)

    @cached_property
    def states(self) -> list[tuple[AnyState, AnyState]]:
        """Return states off the initial one along every tangent in turn: on floats, and the same at 50 digits."""
        rng, scene, states = np.random.default_rng(7), self.scene, []
        for _ in range(STATES):
            x = scene.initial(scene.carry())
            for i in range(len(scene.tangents(x))):
                x = scene.displaced(x, scene.tangents(x)[i], float(rng.uniform(-0.3, 0.3)))
            y = [float(c) for c in scene.pack(x)]
            states.append((self.read(y), self.read([XP.mpf(repr(c)) for c in y])))
        return states

    def read(self, y: Sequence[Arithmetic]) -> AnyState:
        state: AnyState = self.scene.unpack(y, self.scene.carry())
        return state

    def slope(
        self, f: Callable[[AnyState], Iterable[Arithmetic]], x: AnyState, v: Iterable[Arithmetic]
    ) -> list[Arithmetic]:
        """Return the derivative of f at x along the packed vector v."""
        pairs = list(zip(self.scene.pack(x), v, strict=True))
        return derivative(lambda d: f(self.read([a + d * b for a, b in pairs])))

    def rate(self, x: AnyState) -> Arithmetic:
        """Return Γ' = ∂H/∂s."""
        along_s = [int(label == "s") for label in self.scene.labels(self.scene.carry())]
        return self.slope(lambda x: [self.twin.hamiltonian_at(x)], x, along_s)[0]


def derivative(f: Callable[[Arithmetic], Iterable[Arithmetic]]) -> list[Arithmetic]:
    return [(a - b) / (2 * DELTA) for a, b in zip(f(DELTA), f(-DELTA), strict=True)]


def require_near(a: Iterable[Arithmetic], b: Iterable[Arithmetic], what: str) -> None:
    a, b = list(a), list(b)
    size, gap = max([1.0, *map(abs, b)]), max(abs(p - q) for p, q in zip(a, b, strict=True))
    require(gap < CLOSE * size, f"{what}: off by {float(gap):.1e}")


def declares(case: SceneCase) -> None:
    """Give it a name of letters, digits, "_", ".", "+", "-", and `initial_fields` that it has."""
    scene = case.scene
    require(isinstance(scene.name, str) and NAME.fullmatch(scene.name), f"name = {scene.name!r}")
    require(all(hasattr(scene, field) for field in scene.initial_fields), f"fields {scene.initial_fields}")


def packs(case: SceneCase) -> None:
    """Make `pack` and `unpack` each other's inverse, in the order of `labels`."""
    scene = case.scene
    subsets = [names for n in range(len(scene.optional) + 1) for names in combinations(scene.optional, n)]
    for carry in {scene.carry(names) for names in subsets}:
        y, labels = scene.pack(scene.initial(carry)), scene.labels(carry)
        x = scene.unpack(y, carry)
        sizes = len(y) == len(labels) == len(scene.pack(scene.rhs(x)))
        require(sizes and list(scene.pack(x)) == list(y), f"carry = {carry}: {y} comes back as {x}, {labels}")


def replaces_numbers(case: SceneCase) -> None:
    """Let `with_numbers` and `with_` replace every number of the scene, and nothing else."""
    scene, x = case.scene, case.states[0][0]
    same = scene.with_numbers(scene.numbers())
    require_near(same.pack(same.rhs(x)), scene.pack(scene.rhs(x)), "with_numbers(numbers())")
    for name, number in zip(scene.number_names(), scene.numbers(), strict=True):
        changed = not name or scene.with_(**{name: number + 0.25}).numbers() != scene.numbers()
        require(changed, f"with_({name}=…) changes no number")


def is_one_definition(case: SceneCase) -> None:
    """Write functions as plain arithmetic on components, with those of cb.math, without `if` and float()."""
    functions: dict[str, Callable[[Any, AnyState], Sequence[Arithmetic]]] = {
        "rhs": lambda scene, x: scene.pack(scene.rhs(x)),
        "energy": lambda scene, x: [scene.energy(x)] if scene.has_energy else [0],
        "hamiltonian_at": lambda scene, x: [scene.hamiltonian_at(x)] if scene.is_contact else [0],
    }
    for x, z in case.states:
        pair = case.read([np.array([c, 2 * c]) for c in case.scene.pack(x)])
        for name, values in functions.items():
            plain = values(case.scene, x)
            first = [np.broadcast_to(np.asarray(c), 2)[0] for c in values(case.scene, pair)]
            require_near(first, plain, f"{name} on arrays")
            require_near(values(case.twin, z), plain, f"{name} on 50-digit numbers")


def derives(case: SceneCase) -> None:
    """Correct the derivative, or leave it out: it is derived from the operations of the function."""
    scene, twin = case.scene, case.twin
    verify(scene)
    verify_along(scene)
    for x, z in case.states:
        y = scene.pack(x)
        t = 0.0 if scene.clock is None else y[scene.clock]
        given = scene.slopes(t, scene.without_clock(y), scene.carry())
        require_near(given, scene.without_clock(scene.pack(scene.rhs(x))), "slopes are not those of rhs")
        rows = twin.jacobian(z)
        require((rows is not None) == scene.has_jacobian, f"has_jacobian = {scene.has_jacobian}")
        for j in range(len(y)) if rows is not None else ():
            column = case.slope(lambda z: twin.pack(twin.rhs(z)), z, [int(i == j) for i in range(len(y))])
            require_near([row[j] for row in rows], column, f"jacobian, column {j}")


def is_a_contact_system(case: SceneCase) -> str | None:
    """Make `rhs` the contact field of `hamiltonian`: η(X) = −H and L_X η = −Γ' η, Γ' = ∂H/∂s."""
    twin, eta = case.twin, case.twin.contact_form
    if not case.scene.is_contact:
        return "no contact system"

    def eta_of(v: AnyState) -> Callable[[AnyState], list[Arithmetic]]:
        return lambda x: [eta(x, v)]

    for _, x in case.states:
        rate, field = case.rate(x), twin.rhs(x)
        require_near([eta(x, field)], [-twin.hamiltonian_at(x)], "η(X) is not −H")
        for v in twin.tangents(x):
            pushed = case.slope(lambda x: twin.pack(twin.rhs(x)), x, twin.pack(v))
            (moved,) = case.slope(eta_of(v), x, twin.pack(field))  # (L_X η)(v) = X(η(v)) + η(DX v)
            require_near([moved + eta(x, case.read(pushed))], [-rate * eta(x, v)], "L_X η is not −Γ' η")
        if not twin.rate_changes:
            require_near([rate], [twin.conformal_rate], "conformal_rate is not ∂H/∂s")
    return None


def has_its_laws(case: SceneCase) -> None:
    """Take back the symmetry (rotation_invariant, momentum), or say by `may_gain_energy` that energy may grow."""
    scene, twin = case.scene, case.twin
    for _, x in case.states:
        field = twin.pack(twin.rhs(x))
        if not scene.may_gain_energy:
            (growth,) = case.slope(lambda x: [twin.energy(x)], x, field)
            require(growth <= CLOSE, f"H0 grows, {float(growth):.1e}, though it may not")
        if scene.has_momentum_law and scene.is_contact:
            slope, rate = case.slope(lambda x: twin.momentum_at(x) or (), x, field), case.rate(x)
            require_near(slope, [-rate * c for c in twin.momentum_at(x) or ()], "J' is not −Γ' J")


def has_tangents(case: SceneCase) -> None:
    """Let `tangents` be a basis in which the right-hand side lies, and `displaced` leave along them."""
    scene, twin = case.scene, case.twin

    def curve(x: AnyState, v: AnyState) -> Callable[[Any], list[Arithmetic]]:
        return lambda d: twin.pack(twin.displaced(x, v, d))

    for x, z in case.states:
        rows = np.array([scene.pack(v) for v in scene.tangents(x)], dtype=float)
        require(np.linalg.matrix_rank(rows) == len(rows), "tangents that depend on each other")
        for v in twin.tangents(z):
            require_near(derivative(curve(z, v)), twin.pack(v), "displaced leaves along another tangent")
        slope = np.array(scene.pack(scene.rhs(x)), dtype=float)
        if scene.clock is not None:  # tangents do not move the time
            require(slope[scene.clock] == 1, f"t' = {slope[scene.clock]}")
            slope[scene.clock] = 0
        inside = rows.T @ np.linalg.lstsq(rows.T, slope, rcond=None)[0]
        require_near(inside, slope, "the right-hand side is no tangent")


def solves_its_equations(case: SceneCase) -> str | None:
    """Correct `exact`, whose t is the time since the start, or leave it out."""
    twin, exact = case.twin, case.scene.exact
    if exact is None:
        return "no closed form"
    start, t = twin.initial(twin.carry()), XP.mpf(repr(case.scene.t_end)) / 7
    known = {name: part for name, part in exact(twin, t, XP)._asdict().items() if part is not None}

    def flat(state: AnyState) -> list[Arithmetic]:
        return list(Scene.pack([getattr(state, name) for name in known]))

    require_near(flat(exact(twin, XP.mpf(0), XP)), flat(start), "exact starts elsewhere")
    slope = derivative(lambda d: flat(exact(twin, t + d, XP)))
    require_near(slope, flat(twin.rhs(start._replace(**known))), "exact does not solve the equations")
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
        The rules that were followed.

    Raises
    ------
    Violation
        Where a rule is broken.
    BadInput
        If the argument is no scene.

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
