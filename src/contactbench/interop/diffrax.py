"""Run the integrators inside `diffrax.diffeqsolve`: differentiable, vmappable, with diffrax's adjoints and saving."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np

from contactbench.checks import missing
from contactbench.errors import BadInput, excerpt, unknown_name
from contactbench.methods.contact import ContactMethod
from contactbench.methods.prepared import METHODS
from contactbench.numbers import quadrature
from contactbench.numbers.control import XlaNumbers
from contactbench.scene import Scene
from contactbench.scene.base import OwnState, scene_of
from contactbench.scene.flow import damped_time
from contactbench.splitting.composition import Composition, Plan, Stage, arrange
from contactbench.xla import configure

if lacks := missing("diffrax"):
    raise ImportError(lacks)
configure()

import diffrax  # noqa: E402
import equinox as eqx  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
from jax.flatten_util import ravel_pytree  # noqa: E402
from jaxtyping import PyTree  # noqa: E402

__all__ = ["Contact", "terms_of"]

#: steps are equal up to this relative difference, the round-off of times
EQUAL = 1e-9
#: relative differences up to which terms are linear: more than single precision has
LINEAR = 1e-6
#: flows of a turn of the loop over alternating stages: a long step written out takes half a minute to compile
PAIR = 2
XP = XlaNumbers()

#: real numbers of diffrax
Real = int | float | jax.Array | np.ndarray
Term = diffrax.AbstractTerm[Any, Any]
#: the velocity, and the force and the damping together
Terms = tuple[Term, diffrax.MultiTerm[tuple[Term, Term]]]


def moved(y: PyTree, slope: PyTree, factor: Real = 1.0) -> PyTree:
    return jax.tree.map(lambda a, b: a + factor * b, y, slope)


def depends_on_time(function: Callable[[Real], PyTree], t: Real) -> bool:
    traced = jax.make_jaxpr(function)(t).jaxpr
    (time,) = traced.invars
    read = [*(x for equation in traced.eqns for x in equation.invars), *traced.outvars]
    return any(x is time for x in read)


def three_terms(terms: Terms) -> tuple[Term, Term, Term]:
    velocity, on_momentum = terms
    return velocity, *on_momentum.terms


class Flows:
    """The exact subflows of three terms on y = (q, p), each over a part of a step from time t on."""

    def __init__(self, terms: Terms, t: Real, y: PyTree, args: PyTree) -> None:
        self.velocity, self.force, self.damping = three_terms(terms)
        self.args, ones = args, jax.tree.map(jnp.ones_like, y[1])
        #: −1 where diffrax goes back in time: the times it gives ascend, and the control of a term has the sign
        self.sign = self.velocity.contr(t, t + 1.0)

        def rates(t: Real) -> PyTree:
            """Return the rate of damping of each momentum, from momenta of ones."""
            return jax.tree.map(lambda slope: -self.sign * slope, self.damping.vf(t, ones, args))

        self.rates, self.changes = rates, depends_on_time(rates, jnp.asarray(t, dtype=float))

    def are_others(self, t: Real, p: PyTree) -> jax.Array:
        """Return whether, on two momenta, the damping is not −rate p or the velocity not linear."""
        flat, tree = ravel_pytree(p)
        one, two = (tree((k + jnp.arange(1.0, flat.size + 1) ** k).astype(flat.dtype)) for k in (1, 2))
        velocity_of_both = self.velocity.vf(t, moved(one, two), self.args)
        velocities = moved(*(self.velocity.vf(t, p, self.args) for p in (one, two)))
        damped = jax.tree.map(lambda rate, p: -self.sign * rate * p, self.rates(t), two)

        def differ(a: PyTree, b: PyTree) -> jax.Array:
            gap, size = (jnp.linalg.norm(ravel_pytree(x)[0]) for x in (moved(a, b, -1.0), b))
            return jnp.asarray(gap > LINEAR * size)

        return differ(self.damping.vf(t, two, self.args), damped) | differ(velocities, velocity_of_both)

    def spent(self, t: Real, h: Real) -> tuple[PyTree, PyTree]:
        """Return ∫γ over a part of a step and φ = ∫e^{−∫γ}, the time of undamped motion, for each momentum."""
        leaves, structure = jax.tree.flatten(self.rates(t))
        if self.changes:
            rate_of = [lambda t, i=i: jax.tree.leaves(self.rates(t))[i] for i in range(len(leaves))]
            each = [quadrature.integrals(rate, t, h, XP) for rate in rate_of]
        else:
            each = [(rate * h, damped_time(rate, h, XP)) for rate in leaves]
        total, phi = (jax.tree.unflatten(structure, part) for part in zip(*each, strict=True))
        return total, phi

    def kick(self, t: Real, y: PyTree, h: Real) -> PyTree:
        q, p = y
        return q, moved(p, self.force.vf(t, q, self.args), self.sign * h)

    def drift(self, t: Real, y: PyTree, h: Real) -> PyTree:
        q, p = y
        return moved(q, self.velocity.vf(t, p, self.args), self.sign * h), p

    def damp(self, t: Real, y: PyTree, h: Real) -> PyTree:
        q, p = y
        total, _ = self.spent(t, h)
        return q, jax.tree.map(lambda p, G: p + jnp.expm1(-G) * p, p, total)

    def drift_damp(self, t: Real, y: PyTree, h: Real) -> PyTree:
        """Return q + velocity(φ p) and e^{−∫γ} p, which is exact if the velocity is linear in p."""
        (q, p), (_, phi) = y, self.spent(t, h)
        worth = jax.tree.map(lambda phi, p: phi * p, phi, p)
        return self.damp(t, (moved(q, self.velocity.vf(t, worth, self.args), self.sign), p), h)

    def run(self, stages: Sequence[Stage], t: Real, y: PyTree, h: Real) -> tuple[Real, PyTree]:
        """Apply stages, in a loop where their flows alternate; return the time and the state after them."""
        if len(stages) > PAIR and len(stages) % PAIR:
            return self.run(stages[1:], *self.run(stages[:1], t, y, h), h)
        names = [name for name, _ in stages]
        alternate = len(stages) > PAIR and names == names[:PAIR] * (len(stages) // PAIR)

        def round_of(
            carried: tuple[Real, PyTree], coefficients: jax.Array
        ) -> tuple[tuple[Real, PyTree], None]:
            t, y = carried
            for name, coefficient in zip(names, coefficients, strict=False):
                y = getattr(self, name)(t, y, coefficient * h)
                t = t + coefficient * h if name in CLOCKS else t
            return (t, y), None

        coefficients = jnp.array([float(c) for _, c in stages])
        if not alternate:
            return round_of((t, y), coefficients)[0]
        return jax.lax.scan(round_of, (t, y), coefficients.reshape(-1, PAIR))[0]


OTHERS = (
    "cb.diffrax.Contact: damping must be −rate p, with a rate for each momentum (a full matrix: turn q and p to its "
    "axes), and velocity linear in p; solve other terms with diffrax's own solvers"
)
#: the flows in which time passes, as in `Driven`
CLOCKS = ("damp", "drift_damp")


def time_of(stages: Sequence[Stage]) -> float:
    """Return the time of stages in units of the step; every step counts anew, without round-off."""
    return float(sum(coefficient for flow, coefficient in stages if flow in CLOCKS))


class ContactSolver(diffrax.AbstractSolver):  # type: ignore[type-arg]
    """A contact splitting integrator for three terms on y = (q, p); see `Contact`."""

    composition: Composition = eqx.field(static=True)

    term_structure: ClassVar[Any] = (
        diffrax.AbstractTerm,
        diffrax.MultiTerm[tuple[diffrax.AbstractTerm, diffrax.AbstractTerm]],  # type: ignore[type-arg]
    )
    interpolation_cls: ClassVar[Any] = diffrax.ThirdOrderHermitePolynomialInterpolation

    @property
    def plan(self) -> Plan:
        return arrange(self.composition.stages, self.composition.processor)

    def order(self, terms: Terms) -> int:
        return self.composition.order

    def init(self, terms: Terms, t0: Real, t1: Real, y0: PyTree, args: PyTree) -> PyTree:
        """Return the solver state: the kernel's state, and the size of a step."""
        t0, h = jnp.asarray(t0, dtype=float), jnp.asarray(t1 - t0, dtype=float)
        flows = Flows(terms, t0, y0, args)
        y0 = eqx.error_if(y0, flows.are_others(t0, y0[1]), OTHERS)
        return flows.run(self.plan.opening, t0, y0, h)[1], h

    def step(
        self,
        terms: Terms,
        t0: Real,
        t1: Real,
        y0: PyTree,
        args: PyTree,
        solver_state: PyTree,
        made_jump: bool | jax.Array | np.ndarray,
    ) -> tuple[PyTree, None, dict[str, PyTree], PyTree, Any]:
        """Take a step; if its size has changed, open the run anew."""
        plan, (y, before), t0, h = self.plan, solver_state, jnp.asarray(t0, dtype=float), t1 - t0
        flows = Flows(terms, t0, y0, args)
        anew = made_jump | (jnp.abs(h - before) > EQUAL * jnp.abs(h))
        y = jax.lax.cond(anew, lambda: flows.run(plan.opening, t0, y0, h)[1], lambda: y)
        t, y = flows.run(plan.inner, t0 + time_of(plan.opening) * h, y, h)
        _, y1 = flows.run(plan.closing, t, y, h)
        k0, k1 = (self.func(terms, *end, args) for end in ((t0, y0), (t1, y1)))
        slopes = {name: jax.tree.map(lambda k: flows.sign * h * k, k) for name, k in (("k0", k0), ("k1", k1))}
        _, ahead = flows.run(plan.joint, t, y, h)
        return y1, None, {"y0": y0, "y1": y1} | slopes, (ahead, h), diffrax.RESULTS.successful

    def func(self, terms: Terms, t0: Real, y0: PyTree, args: PyTree) -> PyTree:
        velocity, force, damping = three_terms(terms)
        q, p = y0
        return velocity.vf(t0, p, args), moved(force.vf(t0, q, args), damping.vf(t0, p, args))


def Contact(method: str) -> ContactSolver:
    """Return a solver for ``diffeqsolve(terms, solver, t0, t1, dt0, (q, p), args, ConstantStepSize())``.

    The terms are (velocity, MultiTerm(force, damping)), those of `diffrax.SemiImplicitEuler` with a damping: q' =
    velocity(t, p), linear in p; p' = force(t, q) + damping(t, p), the last −γ p, −γ(t) p, or of a rate for each
    momentum.  With one rate and a force that is a gradient every step is part of a contact map, less the action s.
    q and p may be any trees of arrays of double precision.

    The states are those of ``cb.solve(…, carry=())`` at the same steps, to round-off.  Give a dt0 that divides the
    span: else diffrax's first two steps are of other sizes than the rest, and a run whose steps change is opened
    anew.  The kernel of a processed method is solver state, and y postprocessed.  Adjoints, `vmap` and `SaveAt` are
    diffrax's.  Between steps it interpolates by cubics, whose error is of order h⁴ and which are no contact map
    (``SaveAt(steps=True)`` and ``t1=True`` need none).

    Parameters
    ----------
    method
        The name of a composition of kicks, drifts and damping.

    Returns
    -------
    ContactSolver
        A solver of diffrax's, of constant steps.

    Raises
    ------
    BadInput
        For a method that is no composition of kicks, drifts and damping.

    Examples
    --------
    >>> import contactbench as cb, diffrax, jax
    >>> terms, solver = cb.diffrax.terms_of("oscillator"), cb.diffrax.Contact("contact-strang")
    >>> steps, y0 = diffrax.ConstantStepSize(), (jax.numpy.ones(1), jax.numpy.zeros(1))
    >>> sol = diffrax.diffeqsolve(terms, solver, 0, 1, 0.125, y0, stepsize_controller=steps)
    >>> int(sol.stats["num_steps"])
    8
    """
    chosen = METHODS[method]
    if not isinstance(chosen, ContactMethod):
        names = ", ".join(name for name, each in METHODS.items() if isinstance(each, ContactMethod))
        why = f"method = {method!r}: no composition of kicks, drifts and damping; choose from {names}"
        raise BadInput(why)
    return ContactSolver(chosen.composition)


def terms_of(scene: Scene | str) -> Terms:
    """Return the terms of a scene; ``args`` are its parameters by name, or None for its own.

    Parameters
    ----------
    scene
        A mechanical or driven scene with linear damping, itself or its name.

    Returns
    -------
    tuple
        The velocity, and force and damping as a `MultiTerm`, for `Contact`.

    Raises
    ------
    BadInput
        For a scene that is not mechanical, or whose damping is not linear, and for args that are none of its
        parameters.

    Examples
    --------
    >>> import contactbench as cb, jax
    >>> velocity, momentum_terms = cb.diffrax.terms_of("oscillator")
    >>> velocity.vf(0.0, jax.numpy.ones(1), None).shape
    (1,)
    """
    scene = scene_of(scene)
    if not scene.separable or scene.nonlinear_damping:
        why = "its damping depends on s" if scene.separable else f"it is of kind {scene.kind!r}"
        raise BadInput(f"scene {scene.name!r} has no terms on (q, p) alone: {why}; cb.step_map takes it")
    names, own = scene.number_names(), scene.numbers()
    known = {*names} - {"", "kappa"}  # κ is 0 here

    def twin(args: PyTree) -> PyTree:
        given = {} if args is None else args
        if not isinstance(given, dict):
            raise BadInput(f"args = {excerpt(args)}: must be parameters by name, as {{'gamma': 0.3}}")
        for name in given:
            if name not in known:
                raise unknown_name("parameter", name, sorted(known))
        return scene.with_numbers([given.get(name, x) for name, x in zip(names, own, strict=True)])

    def state(t: Real, q: PyTree, p: PyTree) -> OwnState:
        return scene.unpack(scene.with_clock([*q, *p], t), ())

    def velocity(t: Real, p: PyTree, args: PyTree) -> PyTree:
        return jnp.stack(twin(args).velocity(tuple(p)))

    def force(t: Real, q: PyTree, args: PyTree) -> PyTree:
        return -jnp.stack(twin(args).gradient_at(state(t, q, q)))

    def damping(t: Real, p: PyTree, args: PyTree) -> PyTree:
        return -twin(args).damping_at(state(t, p, p)) * p

    return diffrax.ODETerm(velocity), diffrax.MultiTerm(diffrax.ODETerm(force), diffrax.ODETerm(damping))
