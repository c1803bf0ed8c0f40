"""Fixed-step methods: an integrator is one function, or one short class, for all engines."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from contactbench.blame import UserError, their_code
from contactbench.checks import function, is_number, switch, text, whole
from contactbench.errors import BadInput, excerpt
from contactbench.methods.base import CALLBACKS, FAMILIES, METHODS, Method
from contactbench.methods.dense import Source
from contactbench.methods.fixed_step_run import EqualSteps, FixedStepRun
from contactbench.methods.loops import LOOPS, StepLoop, is_fixed
from contactbench.methods.prepared import Prepared, Request
from contactbench.methods.step_choice import ChosenStep
from contactbench.numbers.control import Repeat, repeat
from contactbench.numbers.dual import leaves
from contactbench.numbers.protocol import Arithmetic, Count, Namespace
from contactbench.registry import NAME
from contactbench.scene import AnyState, Scene
from contactbench.scene.base import TRIED, OwnState

Step = Callable[[Any, OwnState, Arithmetic, Namespace], OwnState]  # (scene, x, h, xp) -> x
Piece = Callable[[Scene, AnyState, Arithmetic, Namespace, Repeat], AnyState]  # (scene, x, h, xp, repeat) -> x
Factor = Callable[[Any, Arithmetic, Namespace], Arithmetic]  # (scene, h, xp) -> conformal factor of one step


@dataclass(frozen=True)
class FixedStep(Method):
    """A one-step method given by its step map ``step(scene, x, h, xp) -> x``.

    The map is written on the scene's own components, so it runs on Python floats, NumPy arrays (many trajectories),
    mpmath numbers, traced and recorded numbers alike; xp is the number namespace that goes with them.

    evaluations : number of evaluations of `kind` per step.  A method that merges the end of one step with the start of
    the next overrides `advance`, `pieces` and `counts` (see contact.py).
    """

    name: str
    order: int
    step: Step
    evaluations: int = 1
    #: kind of the evaluations: "rhs", "gradient" or "rotation"
    kind: str = "rhs"
    about: str = ""
    engines: tuple[str, ...] = tuple(LOOPS)
    family: str = "established"
    contact: bool = False  # every step is an exact conformal contact map with factor e^{−γh}
    symmetric: bool = False
    factor: Factor | None = None  # every step is a conformal contact map with this factor instead
    mission: bool = False
    adaptive = False
    #: longest step of the first pilot
    longest = math.inf
    tolerance = (
        "the error of the run at all saved times, relative to the largest state: pilots choose the step"
    )

    def prepare(self, request: Request) -> Prepared:
        if not is_fixed(self):  # a user's step map
            self.try_step(request.scene, request.carry, request.step)
        loop = LOOPS[request.engine](self, request)
        kind = ChosenStep if request.step is None else FixedStepRun
        return kind(self.name, request, self, loop)

    def source(self, request: Request) -> Source | None:
        if request.step is None or request.steps is not None:
            return None
        return EqualSteps.of(self, request)

    def run_of(self, request: Request, loop: StepLoop[Any]) -> FixedStepRun:
        return FixedStepRun(self.name, request, self, loop)

    def advance(
        self, scene: Scene, x: AnyState, h: Arithmetic, n: Count, xp: Namespace, repeat: Repeat = repeat
    ) -> OwnState:
        """Return the state after n ≥ 1 steps of size h."""
        after: AnyState = repeat.steps(n, lambda x: self.step(scene, x, h, xp), x, h)
        return after

    def pieces(self, scene: Scene, whole: bool) -> tuple[Piece | None, ...]:
        """Return the four pieces of an uninterrupted run, None for an empty one.

        The pieces are the opening of the run, the begin of each step, and, from the state after that, the way to the
        next step and the way to the state at the end of the step.  whole : the pieces in which `advance` is compiled.
        """
        return None, lambda scene, x, h, xp, repeat: self.advance(scene, x, h, 1, xp, repeat), None, None

    def conformal_factor(self, scene: Scene, h: Arithmetic, xp: Namespace = math) -> Arithmetic | None:
        """Return the constant c of Φ_h*η = c η, e^{−γh} for a `contact` method; None if the method claims none."""
        if self.refuses(scene) is not None or scene.conformal_rate is None:
            return None
        factor: Arithmetic | None = None
        if self.factor is not None:
            factor = self.factor(scene, h, xp)
        elif self.contact:
            factor = xp.exp(-scene.conformal_rate * h)
        return factor

    def composed(self, scene: Scene) -> bool:
        """Return whether the steps on an accepted scene are contact maps, with any conformal factor."""
        return scene.conformal_rate is not None and (self.contact or self.factor is not None)

    def modified_hamiltonian(self, scene: Scene, x: AnyState, h: float) -> Arithmetic | None:
        """Return the modified Hamiltonian H̃ at x of steps of size h; None if none is known."""
        return None

    def counts(self, scene: Scene, n: int, carry: Sequence[str] | None = None) -> int:
        """Return the evaluations in n uninterrupted steps; carry : as in `solve`."""
        return n * self.evaluations

    def keeping(self, scene: Scene) -> FixedStep:
        """Return the method for runs with many saved states, which cost it less."""
        return self

    def cost_of_saving(self, scene: Scene, carry: Sequence[str]) -> int:
        """Return the evaluations of a saved state: a run begins anew there."""
        return self.counts(scene, 1, carry) - self.per_step(scene, carry) if self.one_step else 0

    def per_step(self, scene: Scene, carry: Sequence[str] | None = None) -> int:
        return self.counts(scene, 2, carry) - self.counts(scene, 1, carry)

    def kind_on(self, scene: Scene) -> str:
        """Return the kind of the evaluations on this scene."""
        return self.kind

    def step_cost(self, scene: Scene, engine: str) -> float | None:
        return self.per_step(scene) if engine in CALLBACKS else None

    def try_step(self, scene: Scene, carry: tuple[str, ...], step: float | None = None) -> None:
        """Raise `BadInput` unless a user's step map keeps the fields of a state and evaluates as it declares."""
        x, h, what = scene.initial(carry), TRIED * scene.t_end, f"method {self.name!r}"
        twin, calls = with_counters(scene)
        try:
            with their_code(what):
                try:
                    after = self.advance(twin, x, min(h, step or h), 1, math)
                except ArithmeticError:  # Python's way to say inf; the run will end as diverged
                    return
        except UserError as error:
            raise UserError(f"{error}{expected(x, error.__cause__)}") from error.__cause__
        if type(after) is not type(x):
            raise BadInput(f"{what}: its step map returns {excerpt(after)}: must be a {type(x).__name__}")
        for name, old, new in zip(x._fields, x, after, strict=True):
            if not alike(old, new):
                must = f"must be like {excerpt(old)}"
                raise BadInput(f"{what}: its step map returns {name} = {excerpt(new)}: {must}")
        kind, declared = self.kind_on(scene), self.counts(scene, 1, carry)
        if any(calls.values()) and not self.iterates and calls.get(kind, declared) != declared:
            raise UserError(f"{what}: {miscounted(declared, kind, calls)}")


#: kind of evaluation → its name in messages
COUNTED = {"rhs": "right-hand side", "gradient": "gradient"}


def with_counters(scene: Scene, plain: bool = False) -> tuple[Scene, dict[str, int]]:
    """Return a scene that counts the calls of its right-hand side and its gradient; plain : of floats alone."""
    calls = {"rhs": 0}

    def counted(kind: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def count(*arguments: Any, **parameters: Any) -> Any:
            calls[kind] += 1
            if plain:
                float(leaves(arguments)[0])
            return function(*arguments, **parameters)

        return count

    for kind in ("gradient", "rhs"):
        if (function := getattr(scene, kind, None)) is not None:
            calls[kind] = 0
            scene = scene._replaced(**{kind: counted(kind, function)})
    return scene, calls


def miscounted(declared: int, kind: str, calls: dict[str, int]) -> str:
    found = ", ".join(f"{COUNTED[name]} {count}" for name, count in calls.items())
    right = f"evaluations={calls[kind]}" if calls[kind] else 'kind="gradient"'
    return f"declares {declared} evaluations of the {COUNTED[kind]} a step; counted: {found}: declare {right}"


def expected(x: AnyState, error: BaseException | None) -> str:
    """Return a hint for an error inside a step map: its arguments, and the functions of a scene it may call."""
    if "positional argument" in str(error):
        calls = (
            "scene.rhs(x), scene.V(q), scene.dV(q) and scene.velocity(p), which know the scene's parameters"
        )
        return f"; a step map is called with scene, x, h, xp, and may call {calls}"
    if not isinstance(error, TypeError | AttributeError | IndexError | ValueError):
        return ""
    kind = type(x).__name__
    return (
        f"; x = {excerpt(x)}: vectors are tuples, fields not carried are None, scene.rhs(x) is a {kind} too"
    )


def alike(old: object, new: object) -> bool:
    if old is None or new is None:
        return old is new
    if isinstance(old, tuple):
        return isinstance(new, tuple) and len(new) == len(old) and all(map(alike, old, new))
    return is_number(new)


#: largest order and number of evaluations of a step
MOST = 10**4


def _one_of(allowed: tuple[str, ...]) -> Callable[[str, object], None]:
    def check(name: str, value: object) -> None:
        if not isinstance(value, str) or value not in allowed:
            raise BadInput(f"{name} = {excerpt(value)}: must be one of {', '.join(allowed)}")

    return check


#: properties that a step map may declare → their checks
CLAIMS: dict[str, Callable[[str, object], object]] = {
    "kind": _one_of(("rhs", "gradient", "rotation")),
    "family": _one_of(FAMILIES),
    "contact": switch,
    "symmetric": switch,
    "factor": function,
}


def fixed_step(
    name: str, order: int, *, evaluations: int = 1, about: str = "", **claims: Any
) -> Callable[[Step], Step]:
    """Return a decorator that registers ``step(scene, x, h, xp) -> x`` as a method.

    It then runs on every engine and appears in every table, figure and test.

    Parameters
    ----------
    name
        A key in tables and a word on the command line.
    order
        Order of convergence.
    about
        One line with the source.
    evaluations
        Number of evaluations in a step, of the right-hand side or of the `kind` among the claims.
    **claims
        The properties it declares: kind, family, contact, symmetric, factor.

    Returns
    -------
    Callable
        The decorator, which returns the step map as it is.

    Raises
    ------
    BadInput
        For a name that is taken, an order or number that is not whole and > 0, and an unknown claim.

    Examples
    --------
    >>> import contactbench as cb
    >>> @cb.fixed_step("my-euler", order=1, about="explicit Euler")
    ... def euler(scene, x, h, xp):
    ...     return cb.shifted(x, h, scene.rhs(x))
    >>> cb.solve("oscillator", "my-euler", step=0.01).ok
    True
    """

    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise BadInput(f"method name {excerpt(name)}: must be letters, digits, '_', '.', '+', '-'")
    order, evaluations = whole("order", order, MOST), whole("evaluations", evaluations, MOST)
    text("about", about)
    for claim, value in claims.items():
        if claim not in CLAIMS:
            raise BadInput(f"{excerpt(claim)}: a step map declares {', '.join(CLAIMS)}")
        CLAIMS[claim](claim, value)

    def register(step: Step) -> Step:
        function("step map", step)
        METHODS.add(FixedStep(name, order, step, evaluations, about=about, **claims))
        return step

    return register
