"""Any contact Hamiltonian H(q, p, s): its equations by reverse-mode differentiation of the recorded H."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from inspect import signature
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from contactbench.blame import their_code
from contactbench.checks import finite, function, is_number, switch, vector
from contactbench.errors import BadInput, excerpt
from contactbench.numbers.dual import leaves
from contactbench.numbers.protocol import Arithmetic, CannotRecord
from contactbench.scene.algebra import State, Vector, dot
from contactbench.scene.base import Check, Numeric, Sizes, as_formula, named_numbers, optional
from contactbench.scene.canonical import Canonical, angular_momentum
from contactbench.scene.scales import RATIO, SPANS
from contactbench.trace.formula import Formula, argument_names

#: most components of a state with a derived Jacobian
LARGEST_JACOBIAN = 65
#: the law of a symmetry must hold to this part of its terms, at POINTS states within SPREAD of the start
SYMMETRIC, SPREAD, POINTS = 1e-9, 0.1, 4


class Derivatives(NamedTuple):
    """Derivatives of H by (q, p, s): gradient, ∂H/∂s alone, Hessian; and whether ∂H/∂s depends on the state."""

    partials: Formula
    rate: Formula
    second: Formula | None
    rate_changes: bool


@lru_cache(256)
def derivatives_of(hamiltonian: Formula) -> Derivatives:
    """Return the derivatives of a recorded H(q, p, s); raise `CannotRecord` if one is not known."""
    flat = of_state(hamiltonian)
    size, second = sum(n or 1 for n in hamiltonian.arguments if isinstance(n, int)), None
    partials, rate = flat.gradient(), flat.derive(lambda rows: rows[0][-1])
    if size <= LARGEST_JACOBIAN:
        with suppress(CannotRecord):
            second = partials.hessian()
    state = argument_names(flat.arguments, ())
    return Derivatives(partials, rate, second, not read_by(rate).isdisjoint(state))


@lru_cache(256)
def slopes_of(momentum: Formula) -> Formula:
    """Return the derivatives of all components of J along (q, p, s), a row for each."""
    return of_state(momentum).derive(lambda rows: rows)


def of_state(made: Formula) -> Formula:
    """Return a formula of (q, p, s) as a formula of one tuple with all components."""
    return replace(made, arguments=(sum(n or 1 for n in made.arguments if isinstance(n, int)),))


def read_by(made: Formula) -> set[object]:
    """Return the names that a formula reads, including its arguments."""
    return {*leaves(made.results)}.union(*(each.value.operands for each in made.body))  # type: ignore[union-attr]


@dataclass(frozen=True, kw_only=True)
class ContactSystem(Canonical):
    """Describe a system with any contact Hamiltonian H(q, p, s) on T*Rⁿ × R.

    Its equations are q' = ∂H/∂p, p' = −∂H/∂q − p ∂H/∂s, s' = p·∂H/∂p − H, the derivatives by reverse mode through the
    operations of H (Bravetti, Cruz, Tapias, Ann. Phys. 376, 17 (2017), doi:10.1016/j.aop.2016.11.003, eqs. 40–42).
    Where H = h(q, p) + γ s, γ a number or a parameter, the conformal factor is e^{−γt}, and s need not be carried.
    Elsewhere it is e^{−∫∂H/∂s}.  H0 in the laws is H(q, p, 0).

    A general H has no known exact flows: its contact methods are those of `gauss`.

        ContactSystem(hamiltonian=lambda q, p, s: p[0] ** 2 / 2 - cb.math.cos(q[0]) + 0.1 * s * s,
                      q=(1.0,), p=(0.0,), s=0.5, t_end=20.0)

    Parameters
    ----------
    name, about, t_end, s, exact, scale, slows_after, hard, stiff, mission, pace
        As of `Scene`; the name is "contact_system" by default.
    hamiltonian
        ``H(q, p, s, **parameters) -> number``, plain arithmetic and `cb.math` on the components of the tuples q and p
        and on the number s, without branches on values.
    q, p
        Initial coordinates and momenta, n numbers each.
    parameters
        Numbers by name that the functions take.
    momentum
        ``J(q, p, s, **parameters)``, a number or a tuple of them, of a symmetry: {J, H} = 0 in the Jacobi bracket, so
        that J' = −J ∂H/∂s, which is tested near the start.  J is linear in p for a symmetry of the configuration space.

    Raises
    ------
    BadInput
        For lengths that differ, values that are not finite, an H that cannot be recorded or is constant, and a
        momentum without a symmetry.
    """

    name: str = "contact_system"
    hamiltonian: Callable[..., Arithmetic] = None  # type: ignore[assignment]
    q: Vector
    p: Vector
    momentum: Callable[..., Any] | None = None  # type: ignore[assignment]
    parameters: Mapping[str, float] = field(default_factory=dict)
    #: derivatives of the recorded H; None if it is recorded at every call
    derived: Derivatives | None = field(init=False, repr=False, compare=False, default=None)

    kind = "contact system"
    functions: ClassVar[dict[str, tuple[str, ...]]] = dict.fromkeys(
        ("hamiltonian", "momentum"), ("q", "p", "s", "**")
    )
    checks: ClassVar[dict[str, Check]] = {
        **Canonical.checks,
        "hamiltonian": function,
        "momentum": optional(function),
    }
    #: H may have no damping
    may_gain_energy = True

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, value in ((name, self._value(name)) for name in self.given):
            numbers = value if name == "momentum" and isinstance(value, tuple | list) else (value,)
            if not (numbers and all(map(is_number, numbers))):
                raise BadInput(f"{name}: must return a real number; it returns {excerpt(value)}")
        scene = self.recorded()
        if not self.has_users_functions:  # functions of this package never change
            self._fix("derived", scene.derived)
        found = read_by(scene._derived.partials)
        if found.isdisjoint(argument_names((2 * len(self.q) + 1,), ())) and not any(
            isinstance(x, float) and x for x in found
        ):
            raise BadInput(f"hamiltonian: depends on none of q, p and s: {excerpt(self.hamiltonian)}")
        if self.momentum is not None:
            with their_code(f"scene {self.name!r}"), np.errstate(all="ignore"):
                scene._require_symmetry()

    def _derive[Derived](self, name: str, derive: Callable[[Formula], Derived]) -> Derived:
        """Return derivatives of one of its functions; raise `BadInput` if it cannot be recorded or differentiated."""
        given, n = getattr(self, name), len(self.q)
        try:
            return derive(as_formula(given, (n, n, 0), self.parameters))
        except CannotRecord as why:
            wanted = "cannot be recorded and differentiated"
            raise BadInput(f"scene {self.name!r}: its {name} {wanted}: {why}") from why

    def recorded(self) -> Self:
        """Return the scene recorded, with its derivatives."""
        if self.derived is not None:
            return self
        scene = super().recorded()
        return scene._replaced(derived=scene._derive("hamiltonian", derivatives_of))

    @property
    def _derived(self) -> Derivatives:
        found = self.derived or self.recorded().derived
        assert found is not None
        return found

    # -- a symmetry ------------------------------------------------------------------------------
    def _require_symmetry(self) -> None:
        """Raise `BadInput` unless J' = −J ∂H/∂s at states near the start."""
        start = np.array(self.pack(self.initial(("s",))))
        size, rng = self.scales(self.initial(("s",)), self.t_end), np.random.default_rng(1)
        for y in (start + SPREAD * size * rng.uniform(-1, 1, len(start)) * (k > 0) for k in range(POINTS)):
            x = self.unpack(y.tolist(), ("s",))
            try:
                slope, rate, J = self.pack(self.rhs(x)), self.damping_at(x), self.momentum_at(x)
                rows = self._momentum_slopes(x)
            except (ArithmeticError, ValueError):  # where a function is not defined
                continue
            for row, value in zip(rows, J or (), strict=True):
                terms = [*(a * b for a, b in zip(row, slope, strict=True)), rate * value]
                off, most = abs(sum(terms)), sum(map(abs, terms))
                if off > SYMMETRIC * most and math.isfinite(most):
                    raise BadInput(
                        f"momentum: is none of a symmetry: J' + J ∂H/∂s = {sum(terms):.3g}, not 0, "
                        f"at q = {excerpt(x.q)}, p = {excerpt(x.p)}, s = {x.s:.6g}"
                    )

    def _momentum_slopes(self, x: State) -> Sequence[Vector]:
        rows: Sequence[Vector] = self._derive("momentum", slopes_of)(self._flat(x), **self.parameters)
        return rows

    def momentum_at(self, x: State) -> Vector | None:
        if self.momentum is None:
            return None
        value = self.momentum(x.q, x.p, self._action(x), **self.parameters)
        return tuple(value) if isinstance(value, tuple | list) else (value,)

    @property
    def has_momentum_law(self) -> bool:  # type: ignore[override]
        return self.momentum is not None

    def momentum_terms(self, x: State) -> Numeric:
        momenta, n = self.momentum_at(x) or (), len(self.q)
        total: Numeric = 0.0
        for J, row in zip(momenta, self._momentum_slopes(x), strict=True):
            total = total + (abs(J) + sum(abs(p * slope) for p, slope in zip(x.p, row[n:], strict=False)))
        return total

    # -- H and its derivatives -------------------------------------------------------------------
    def _action(self, x: State) -> Arithmetic:
        """Return s, or 0 if it is not carried: then only its own rate depends on it."""
        return 0.0 * x.p[0] if x.s is None else x.s

    def _flat(self, x: State) -> Vector:
        return (*x.q, *x.p, self._action(x))

    def hamiltonian_at(self, x: State) -> Arithmetic:
        return self.hamiltonian(x.q, x.p, self._action(x), **self.parameters)

    def partials_at(self, x: State) -> tuple[Vector, Vector, Arithmetic]:
        """Return ∂H/∂q, ∂H/∂p and ∂H/∂s."""
        n, found = len(self.q), self._derived.partials(self._flat(x), **self.parameters)
        return found[:n], found[n : 2 * n], found[2 * n]

    def damping_at(self, x: State) -> Arithmetic:
        rate: Arithmetic = self._derived.rate(self._flat(x), **self.parameters)
        return rate

    def rhs(self, x: State) -> State:
        H_q, H_p, H_s = self.partials_at(x)
        force = tuple(-a - p * H_s for a, p in zip(H_q, x.p, strict=True))
        return State(H_p, force, None if x.s is None else dot(x.p, H_p) - self.hamiltonian_at(x))

    @property
    def has_jacobian(self) -> bool:  # type: ignore[override]
        return self._derived.second is not None

    def jacobian(self, x: State) -> list[list[Arithmetic]] | None:
        second, n = self._derived.second, len(self.q)
        if second is None:
            return None
        hess = second(self._flat(x), **self.parameters)
        H_q, _, H_s = self.partials_at(x)
        size = 2 * n + (x.s is not None)
        rows: list[list[Arithmetic]] = [list(hess[n + i][:size]) for i in range(n)]
        for i, p in enumerate(x.p):
            row = [-hess[i][j] - p * hess[2 * n][j] for j in range(size)]
            row[n + i] = row[n + i] - H_s
            rows.append(row)
        if x.s is not None:
            row = [dot(x.p, [hess[n + i][j] for i in range(n)]) for j in range(size)]
            rows.append([*(a - b for a, b in zip(row, H_q, strict=False)), *row[n : 2 * n], row[2 * n] - H_s])
        return rows

    def sizes(self, x: State, end: float) -> Sizes:
        """Return the sizes of a throw with the initial force, as long as the force changes little."""

        def throw(span: float) -> State:
            p = tuple(p + span * f for p, f in zip(x.p, force, strict=True))
            half = x._replace(p=tuple((a + b) / 2 for a, b in zip(x.p, p, strict=True)))
            return State(tuple(q + span * v for q, v in zip(x.q, self.rhs(half).q, strict=True)), p, x.s)

        force: Any = self.rhs(x).p
        far, fast, pull = (np.abs(np.array(each, dtype=float)) for each in (x.q, x.p, force))
        start_momenta, moves = fast, fast + pull > 0
        for span in (end / RATIO**k for k in reversed(range(SPANS))):
            try:
                there = throw(span)
                change = np.abs(np.array(self.rhs(there).p, dtype=float) - force)
            except (ArithmeticError, ValueError):  # where a function is not defined
                break
            if not (change * span <= start_momenta + span / 2 * pull)[moves].all():
                break
            far = np.fmax(far, np.abs(np.array(there.q, dtype=float) - x.q))
            fast = start_momenta + span * pull
        return [*far, *fast], float(np.nanmax(far * fast))

    # -- laws --------------------------------------------------------------------------------------
    def energy(self, x: State) -> Numeric:
        return self.hamiltonian_at(x._replace(s=None))

    def hamiltonian_terms(self, x: State) -> Numeric:
        return abs(self.hamiltonian_at(x)) + abs(dot(x.p, self.partials_at(x)[1]))

    @property
    def nonlinear_damping(self) -> bool:  # type: ignore[override]
        return self._derived.rate_changes

    @property
    def conformal_rate(self) -> Numeric:
        return None if self.rate_changes else self.damping_at(State(self.q, self.p, self.s))


# -- a mass that depends on the configuration ----------------------------------------------------------
def kinetic_energy(M: Sequence[Vector], p: Vector) -> Arithmetic:
    """Return ½ pᵀM⁻¹p by M = L D Lᵀ, as ½ Σ y²/d with L y = p; only the lower triangle of M is read."""
    L: list[list[Arithmetic]] = []
    d: list[Arithmetic] = []
    y: list[Arithmetic] = []
    for i, row in enumerate(M):
        scaled: list[Arithmetic] = []  # row i of L D
        for j in range(i):
            scaled.append(row[j] - sum(a * b for a, b in zip(scaled, L[j], strict=True)))
        L.append([a / b for a, b in zip(scaled, d, strict=True)])
        d.append(row[i] - sum(a * b for a, b in zip(scaled, L[i], strict=True)))
        y.append(p[i] - sum(a * b for a, b in zip(L[i], y, strict=True)))
    return sum(a * a / b for a, b in zip(y, d, strict=True)) / 2  # type: ignore[return-value]


@dataclass(frozen=True)
class OnMetric:
    """H = ½ pᵀM(q)⁻¹p + V(q) + γ s + ½ κ s²; mass and potential get the parameters that they name."""

    mass: Callable[..., Sequence[Vector]]
    potential: Callable[..., Arithmetic]

    def __call__(
        self,
        q: Vector,
        p: Vector,
        s: Arithmetic,
        *,
        gamma: Arithmetic,
        kappa: Arithmetic = 0.0,
        **rest: Arithmetic,
    ) -> Arithmetic:
        kinetic = kinetic_energy(self.mass(q, **named(self.mass, rest)), p)
        energy = kinetic + self.potential(q, **named(self.potential, rest)) + gamma * s
        return energy if isinstance(kappa, float) and kappa == 0 else energy + kappa * s * s / 2


def named(function: Callable[..., object], parameters: Mapping[str, Arithmetic]) -> dict[str, Arithmetic]:
    """Return the parameters that a function takes by name."""
    taken = signature(function).parameters
    every = any(each.kind is each.VAR_KEYWORD for each in taken.values())
    return {name: value for name, value in parameters.items() if every or name in taken}


def rotations(q: Vector, p: Vector, s: Arithmetic, **_: Arithmetic) -> Vector | None:
    """Return the momentum map of the rotations of q."""
    return angular_momentum(q, p)


def on_metric(
    *,
    mass: Callable[..., Sequence[Vector]],
    potential: Callable[..., Arithmetic] | None = None,
    gamma: float = 0.0,
    kappa: float = 0.0,
    rotation_invariant: bool = False,
    parameters: Mapping[str, float] | None = None,
    **given: Any,
) -> ContactSystem:
    """Return the contact system of `OnMetric`; raise `BadInput` unless its mass is symmetric positive definite."""
    for name in given.keys() & {"gradient", "hessian"}:
        raise BadInput(f"{name}: is derived where the mass depends on q")
    own_potential = function("potential", potential)
    q, known = vector("q", given.get("q", ())), named_numbers("parameters", parameters or {})
    for name in known.keys() & {"gamma", "kappa"}:
        raise BadInput(f"parameter {name!r}: must have a name of its own")
    with their_code("mass"):
        rows = mass(q, **named(mass, known))
    try:
        M = np.array([list(row) for row in rows], dtype=float)
        symmetric = M.shape == (len(q),) * 2 and np.allclose(M, M.T, rtol=1e-12)
        fits = symmetric and np.linalg.eigvalsh(M).min() > 0
    except (TypeError, ValueError, np.linalg.LinAlgError):
        fits = False
    if not fits:
        wanted = f"must be {len(q)} rows of {len(q)} numbers, symmetric and positive definite"
        wanted = "must be one row of one number, as in ((m,),), positive" if len(q) == 1 else wanted
        raise BadInput(f"mass: is {excerpt(rows)} at q = {excerpt(q)}: {wanted}")
    own = {"gamma": finite("gamma", gamma)} | ({"kappa": finite("kappa", kappa)} if kappa else {})
    if switch("rotation_invariant", rotation_invariant):
        if len(q) not in (2, 3):
            raise BadInput(f"rotation_invariant = True: needs 2 or 3 coordinates, not {len(q)}")
        given["momentum"] = rotations
    return ContactSystem(hamiltonian=OnMetric(mass, own_potential), parameters=own | known, **given)
