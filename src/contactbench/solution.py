"""Results of runs: the saved states, the status and the cost."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from contactbench.errors import BadInput
from contactbench.notebook import html_table
from contactbench.scene import Scene, rotation_matrix
from contactbench.scene.base import OwnState

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from contactbench.methods.prepared import Patience, Prepared
    from contactbench.truth.reference import Reference


class Status(StrEnum):
    """Name the ways a run can end, by words that compare equal to their names.

    Attributes
    ----------
    ok
        All saved states are there.
    diverged
        Not finite, or beyond 10⁶ times the scale of q or p: the size of the start, one, or the size estimated from
        force and velocity at the start.
    budget
        The step or evaluation budget was spent.
    failed
        The solver gave up; its own words are in the message.
    timeout
        A limit of time was reached.
    unsupported
        The method does not apply to the scene; the message says why.
    """

    ok = "ok"
    diverged = "diverged"
    budget = "budget"
    failed = "failed"
    timeout = "timeout"
    unsupported = "unsupported"


class Counts(NamedTuple):
    """Count what a run cost; a count is None where the solver does not say.

    Attributes
    ----------
    steps, rejected
        Accepted and rejected steps.
    evaluations, kind
        Evaluations of "gradient" (∇V), "rhs" (the whole right-hand side), "taylor" (orders of Taylor coefficients;
        each costs about one rhs) or "rotation" (half an rhs; see `rhs_equivalents`).
    jacobians
        Evaluations of the Jacobian.
    """

    steps: int | None = 0
    evaluations: int | None = 0
    jacobians: int = 0
    rejected: int | None = 0
    kind: str = "rhs"

    @property
    def rhs_equivalents(self) -> float | None:
        """Return the evaluations on the scale of one right-hand side.

        A gradient counts as one (it is nearly all of a mechanical right-hand side); two rotations
        of the rigid body, which together apply its whole vector field once, count as one.
        """
        if self.evaluations is None:
            return None
        return self.evaluations / 2 if self.kind == "rotation" else float(self.evaluations)


#: components that are drawn
DRAWN = 8

#: controls of a method without step and tolerance, and of growing steps, which are given by their mean
EXACT, GROWING = "exact", "growing"


def setting_key(control: str, value: float) -> str:
    """Return the control and its value as in tables."""
    return control if control == EXACT else f"{control}={value:.6g}"


def keywords(control: str, value: float) -> dict[str, Any]:
    return {} if control == EXACT else {control: value}


class Differential(NamedTuple):
    """The derivative of the saved states of a numerical map along the m tangents at the start, or why it is missing.

    estimates : (l, k, d, m); one estimate to round-off, several by differences, or none.
    """

    source: str
    estimates: np.ndarray

    @property
    def taken(self) -> bool:
        return len(self.estimates) > 0

    @property
    def value(self) -> np.ndarray:
        """Return for every tangent the estimate that agrees best with the next, (k, d, m); `BadInput` if none."""
        if not self.taken:
            raise BadInput(f"no derivative of the numerical map: {self.source}")
        if len(self.estimates) == 1:
            return np.asarray(self.estimates[0])
        gaps = np.abs(np.diff(self.estimates, axis=0)).max(axis=(1, 2))
        return np.stack([self.estimates[best, :, :, j] for j, best in enumerate(closest(gaps))], axis=-1)


#: the error bar of a difference over the smallest disagreement of two estimates
SAFETY = 2.0


def closest(gaps: np.ndarray) -> np.ndarray:
    """Return for every tangent, (l, m), the estimate that differs least from the next; nan counts as infinite."""
    return np.argmin(np.where(np.isnan(gaps), np.inf, gaps), axis=0)


_new = object.__new__


@dataclass(repr=False)
class Solution:
    """Hold the saved states of one run.

    Attributes
    ----------
    scene, method, engine, carry
        What was solved, the names of the method and of the engine, and which of s and R were integrated.
    t, elapsed
        Saved times, (k,), and the same counted from the start; they differ where the scene does not start at 0.
    y, y0
        Packed states, (k, d), NaN after the end of a run that did not reach them, and the initial one, (d,).
    q, p, s, M, R
        Their parts, (k, n), (k, n), (k,), (k, 3) and (k, 3, 3); one the run did not carry is None.
    status, success, message, end_time
        How it ended, whether well, why, and how far it got, a time since the start.
    counts
        What it cost.
    step_chosen, step
        Of a method with fixed steps, the step that was asked for, or chosen from rtol, and the longest one taken,
        shorter where no whole number of steps leads from one saved time, the end included, to the next; nan of others.
    control, value
        What was set, "step", "rtol" or "exact", and its value.
    run
        The `Prepared` that made it, which can be differentiated.
    truth
        The `Reference` at its times, where it is known already, or why there is none; else the laws compute it.
    patience
        The limit of time while laws are measured.
    between
        Which states are interpolated, (k,); None if none is, see `interpolated`.
    """

    scene: Scene
    method: str
    engine: str
    carry: tuple[str, ...]
    t: np.ndarray
    y: np.ndarray
    y0: np.ndarray
    status: Status = Status.ok
    message: str = ""
    counts: Counts = field(default_factory=Counts)
    end_time: float = float("nan")
    run: Prepared | None = None
    control: str = EXACT
    value: float = 0.0
    step_chosen: float = float("nan")
    step: float = float("nan")
    truth: Reference | BadInput | None = None
    #: limit of time while laws are measured
    patience: Patience | None = None
    #: which states are interpolated; None of none
    between: np.ndarray | None = None

    @staticmethod
    def of(ending: dict[str, object], y: np.ndarray, y0: np.ndarray) -> Solution:
        """Return a solution from a dictionary of attributes and its states, three times as fast as the constructor."""
        made = _new(Solution)
        made.__dict__ = {**ending, "y": y, "y0": y0}
        return made

    @property
    def setting(self) -> str:
        return setting_key(self.control, self.value) if self.run is None else self.run.request.setting

    @property
    def interpolated(self) -> np.ndarray:
        """Return whether each saved state is interpolated between ends of steps, (k,), where steps ended elsewhere."""
        return np.zeros(len(self.y), dtype=bool) if self.between is None else self.between

    @property
    def ok(self) -> bool:
        return self.status is Status.ok

    @property
    def success(self) -> bool:
        """Return whether the run reached its end with all saved states, as SciPy calls it."""
        return self.ok

    @property
    def start_time(self) -> float:
        return self.scene.split_clock(self.y0)[0]

    @property
    def elapsed(self) -> np.ndarray:
        """Return the saved times since the start."""
        known = None if self.run is None else self.run.request.save_at
        return self.t - self.start_time if known is None or len(known) != len(self.t) else known

    def __repr__(self) -> str:
        setting, n = self.setting, self.counts.evaluations
        if self.run is not None and (atol := self.run.request.atol) is not None:
            least, most = np.min(atol), np.max(atol)
            setting += f", atol={least:.6g}" + (f" to {most:.6g}" if most > least else "")
        if self.control == "rtol" and not math.isnan(self.step):
            setting += f": step={self.step_chosen:.6g}"
        if self.step < self.step_chosen * (1 - 1e-9):
            setting += f", {self.step:.6g} taken to meet the saved times"
        why = f": {self.message}" if self.message else ""
        cost = "" if n is None else f", {n} evaluations ({self.counts.kind})"
        scene = f"{self.scene.name}{', undamped,' * self.scene.is_undamped}"
        return (
            f"<Solution of {scene} by {self.method} ({self.engine}, {setting}): "
            f"{self.status}{why}, {len(self.t)} states to t = {self.end_time + self.start_time:.10g}{cost}>"
        )

    def _repr_html_(self) -> str:
        ended = f"{self.status}{f': {self.message}' if self.message else ''}"
        rows = {"method": f"{self.method} ({self.engine}, {self.setting})", "status": ended}
        rows |= {"damping": "none"} if self.scene.is_undamped else {}
        rows["states"] = f"{len(self.t)}, to t = {self.end_time + self.start_time:g}"
        if self.counts.evaluations is not None:
            rows["evaluations"] = f"{self.counts.evaluations} ({self.counts.kind})"
        if self.ok:
            last = zip(self.labels[:12], self.y[-1], strict=False)
            rows["end"] = ", ".join(f"{name} = {y:.6g}" for name, y in last)
        return html_table(rows, self.scene.name)

    def plot(self) -> Figure:
        """Draw the run and return the matplotlib figure: the motion over time, its phase portrait, the energies.

        H0, and where the scene has a contact Hamiltonian with a known decay H beside its law H(0) e^{−∫Γ'}.
        """
        from matplotlib import pyplot

        figure, axes = pyplot.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
        marker = "o" if len(self.t) == 1 else None
        letter, motion = ("q", self.q) if self.q is not None else ("M", self.M)
        if motion is None and not self.scene.has_energy:  # equations, whose time is on the axis
            letter, motion = "y", np.array(self.scene.without_clock(list(self.y.T))).T
        momenta = self.p if letter == "q" else None
        if motion is not None:
            for i, column in enumerate(motion.T[:DRAWN]):
                axes[0].plot(self.t, column, marker=marker, label=f"{letter}{i + 1}")
                other = motion.T[(i + 1) % len(motion.T)] if momenta is None else momenta.T[i]
                axes[1].plot(column, other, marker=marker, label=f"{letter}{i + 1}")
        axes[0].set(xlabel="t", ylabel=letter)
        axes[1].set(
            xlabel=letter, ylabel=f"the next {letter}" if momenta is None else "p", title="phase portrait"
        )
        for label, values, style in self.energies():
            axes[2].plot(self.t, values, style, marker=marker, label=label)
        axes[2].set(xlabel="t", title="energies")
        for each in axes:
            if each.lines:
                each.legend(fontsize="small")
        ended = "" if self.ok else f"\n{self.status}: {self.message}"
        figure.suptitle(f"{self.scene.name}: {self.method}, {self.setting}{ended}")
        return figure

    def energies(self) -> list[tuple[str, np.ndarray, str]]:
        """Return H0, and H and its law where there are such, each with its label and the style of its line."""
        scene, x = self.scene, self.states()
        found = [("H0", np.asarray(scene.energy(x)), "-")] if scene.has_energy else []
        if not (scene.is_contact and x.s is not None):
            return found
        found.append(("H", np.asarray(scene.hamiltonian_at(x)), "-"))
        start = self.start()
        spent = scene.damped_by(start, self.elapsed, np) if scene.has_hamiltonian_law else None
        if spent is not None:
            found.append(("law of H", float(scene.hamiltonian_at(start)) * np.exp(-spent), ":"))
        return found

    def to_frame(self) -> pd.DataFrame:
        """Return the saved states, a row for each time: t, then the components by name (q1, …, p1, …, s)."""
        import pandas as pd

        columns = {name: c for name, c in zip(self.labels, self.y.T, strict=True) if name != "t"}
        return pd.DataFrame({"t": self.t, **columns})

    def laws(self, seconds: float = 60.0) -> pd.DataFrame:
        """Measure the deviation of the run from every law that applies to it, within a limit of seconds.

        See `contactbench.measure.laws.laws`.
        """
        from contactbench.measure.laws import laws  # which measures solutions

        return laws(self, seconds)

    @cached_property
    def differential(self) -> Differential:
        """Return dΦ of the numerical map, including the choice of steps."""
        if self.run is None:
            raise BadInput(f"{self.method} ({self.engine}): no derivative of the numerical map is available")
        return self.run.differential(self.y0, self, self.patience)

    @cached_property
    def at_steps(self) -> Solution:
        """Return the run saved at ends of its steps, where structure is judged; without dense output itself."""
        judged = getattr(self.run, "judged", None)
        if judged is None or not self.ok:
            return self
        again: Solution = judged.solved(self.y0, judged.integrate)
        return again

    @property
    def sensitivity(self) -> np.ndarray:
        """Return the derivative of the saved states along the scene's m tangents at the start, (k, d, m).

        Raises `BadInput` where there is none.
        """
        return self.differential.value

    @property
    def labels(self) -> list[str]:
        return self.scene.labels(self.carry)

    def _columns(self, prefix: str) -> np.ndarray | None:
        index = [i for i, name in enumerate(self.labels) if name.startswith(prefix)]
        return self.y[:, index] if index else None

    @property
    def q(self) -> np.ndarray | None:
        return self._columns("q")

    @property
    def p(self) -> np.ndarray | None:
        return self._columns("p")

    @property
    def M(self) -> np.ndarray | None:
        return self._columns("M")

    @property
    def s(self) -> np.ndarray | None:
        return self.y[:, -1] if "s" in self.carry else None

    @property
    def quaternion(self) -> np.ndarray | None:
        """Return the attitude as integrated, (k, 4), w first."""
        return self._columns("R_")

    @property
    def R(self) -> np.ndarray | None:
        """Return the attitude as matrices."""
        quaternion = self.quaternion
        if quaternion is None:
            return None
        return np.moveaxis(np.array(rotation_matrix(tuple(quaternion.T))), -1, 0)

    def states(self) -> OwnState:
        """Return all saved states at once: a state whose components are arrays over the saved times."""
        return self.scene.unpack(self.y.T, self.carry)

    def start(self) -> OwnState:
        """Return the initial state."""
        return self.scene.unpack(self.scene.entries(self.y0), self.carry)


#: a run has diverged if |q|, |p| or |M| exceed this many times their scale, which is at least the size of the start,
#: one, and the size of the motion estimated from the start (`Scene.scales`)
DIVERGENCE = 1e6
