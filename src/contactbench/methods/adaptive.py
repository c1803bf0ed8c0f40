"""A solver of any kind as a method: a function of a right-hand side, the saved times, a start and a tolerance."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from contactbench.methods.base import METHODS, Adaptive
from contactbench.methods.prepared import Outcome, Prepared, Request
from contactbench.scene.base import Scene
from contactbench.solution import Counts, Status

type Slope = Callable[[float, np.ndarray], np.ndarray]
#: f, the saved times (k,), y0 (d,) and rtol to the states at these times, (k, d)
type Solver = Callable[[Slope, np.ndarray, np.ndarray, float], Any]


class Spent(Exception):
    """The budget of evaluations is spent."""


class SolverRun(Prepared):
    """A run of a solver that is a function."""

    def __init__(self, method: SolverMethod, request: Request) -> None:
        super().__init__(method.name, request)
        self.solver, self.most = method.solver, method.evaluations_per_step * request.max_steps

    def integrate(self, y0: np.ndarray) -> Outcome:
        request, scene, calls = self.request, self.request.scene, 0
        start, y = scene.split_clock(y0)
        last = (0.0, y)

        def f(t: float, y: np.ndarray) -> np.ndarray:
            nonlocal calls, last
            if calls >= self.most:
                raise Spent
            calls, last = calls + 1, (float(t), y)
            return np.array(scene.slopes(start + t, scene.entries(y), request.carry))

        states: np.ndarray = np.empty((0, len(y)))
        status, message = Status.ok, ""
        try:
            found = self.solver(f, request.save_at, y, float(request.rtol or 0.0))
            states = np.array(found, dtype=np.float64).reshape(-1, len(y))
            if len(states) < len(request.save_at):
                status, message = Status.failed, f"the solver gave up by t = {last[0]:.6g}"
        except Spent:
            status, message = Status.budget, f"max_steps = {request.max_steps} spent at t = {last[0]:.6g}"
        except (ArithmeticError, ValueError, RuntimeError) as error:
            status, message = Status.failed, str(error)
        saved = scene.insert_clock(states, start, request.save_at[: len(states)])
        end = last[0], scene.insert_clock(np.asarray(last[1]), start, last[0])
        return self.finish(y0, saved, Counts(None, calls, rejected=None), status, message, end)


class SolverMethod(Adaptive):
    """A method with tolerances that is a function."""

    engines = ("python",)
    own_time = True

    def __init__(self, name: str, solver: Solver, order: int | None, evaluations: int, about: str) -> None:
        self.name, self.solver, self.order, self.about = name, solver, order, about
        self.evaluations_per_step = evaluations

    def prepare(self, request: Request) -> Prepared:
        return SolverRun(self, request)

    def step_cost(self, scene: Scene, engine: str) -> float | None:
        return float(self.evaluations_per_step)


def adaptive(
    name: str, *, order: int | None = None, evaluations: int = 6, about: str = ""
) -> Callable[[Solver], Solver]:
    """Return a decorator that registers a solver which chooses its own steps.

    Parameters
    ----------
    name
        Of the method.
    order
        Order of the solution that the steps continue from; None where it varies.
    evaluations
        About how many evaluations of the right-hand side a step takes: `max_steps` bounds their number by it.
    about
        What it is, with its source.

    Returns
    -------
    Callable
        Decorator of ``solver(f, t, y0, rtol) -> y``: right-hand side ``f(t, y)``, saved times (k,) since the start,
        initial state (d,), tolerance; the states at these times, (k, d), fewer where
        it gives up.  What it
        raises is the message of a failed run.

    Raises
    ------
    BadInput
        If a method has that name.

    Examples
    --------
    >>> import contactbench as cb
    >>> import numpy as np
    >>> from scipy.integrate import solve_ivp
    >>> @cb.adaptive("my-rk23", order=3, evaluations=3, about="Bogacki and Shampine's pair, by SciPy")
    ... def solver(f, t, y0, rtol):
    ...     return np.transpose(solve_ivp(f, (0, t[-1]), y0, "RK23", t_eval=t, rtol=rtol, atol=rtol).y)
    >>> cb.solve("oscillator", "my-rk23", rtol=1e-6).success
    True
    >>> _ = cb.METHODS.pop("my-rk23")
    """

    def register(solver: Solver) -> Solver:
        METHODS.add(SolverMethod(name, solver, order, evaluations, about))
        return solver

    return register
