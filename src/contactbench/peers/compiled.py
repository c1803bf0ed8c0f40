"""Solvers in C and C++ that get the scene as C functions: no Python between them and the scene."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from threading import Lock
from typing import Any, Self

import numpy as np

from contactbench.methods.prepared import Outcome, Prepared
from contactbench.peers.abi import KNOWN
from contactbench.peers.c_functions import c_functions, clock_of, derivative
from contactbench.peers.variational import SOURCE, run_variational, variational_request
from contactbench.solution import Counts, Status


@dataclass
class CompiledPeer(Prepared):
    """A run of a compiled solver; a library's own class connects it and reads how it ended."""

    solver: str

    sensitivity_source = SOURCE
    #: the library's compiled calls, `to_end`, `at_times` and `in_a_loop`, and their arguments but states and times
    calls: Any = None
    arguments: tuple[Any, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        scene = self.request.scene
        self.functions = c_functions(scene, self.request.carry)
        self.compile_s = self.functions.compile_s
        self.data = self.functions.data(scene.numbers())
        self.clock, self.end = clock_of(scene), float(self.request.save_at[-1])
        self.final_only = len(self.later) == 1
        self.alone = Lock()  # memory may be shared by the calls: those from several threads take turns
        self.connect()

    @abstractmethod
    def connect(self) -> None:
        """Set `calls` and `arguments`."""

    @abstractmethod
    def ending(self, flag: int) -> tuple[Status, str]:
        """How a run ended, by the flag that the library returned, and its message."""

    def counts(self, steps: int, evaluations: int, jacobians: int, rejected: float) -> Counts:
        return Counts(steps, evaluations, jacobians, int(rejected))

    def bare(self, y0: np.ndarray) -> np.ndarray:
        return self.calls.to_end(y0, *self.arguments)[KNOWN:]

    def many(self, starts: np.ndarray) -> np.ndarray:
        """Return `FACTS` and final state, (n, KNOWN + d), of one start (n, d) after the other, in a compiled loop."""
        return self.calls.in_a_loop(np.ascontiguousarray(starts), *self.arguments)

    def integrate(self, y0: np.ndarray) -> Outcome:
        with self.alone:
            if self.final_only:
                facts = self.calls.to_end(y0, *self.arguments)
                rows = facts[None, KNOWN:]
            else:
                rows = np.empty((len(self.later), len(y0)))
                facts = self.calls.at_times(y0, self.later, rows, *self.arguments)
        flag, reached, saved, steps, evaluations, jacobians, rejected = facts[:KNOWN].tolist()
        counts = self.counts(int(steps), int(evaluations), int(jacobians), rejected)
        status, message = self.ending(int(flag))
        rows = self.from_start(y0, rows[: int(saved)])
        if status is Status.ok:
            return self.finish(y0, rows, counts)
        stopped = reached, facts[KNOWN:]
        return self.finish(y0, rows, counts, status, f"{message} (t = {reached:.6g})", stopped)

    def variational(self) -> Self:
        """Return the same run of the scene together with its tangent vectors."""
        carry = self.request.carry
        return replace(
            self, request=variational_request(self.request, lambda scene, x: derivative(scene, x, carry))
        )

    def linearised(self, y0: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return run_variational(self.variational(), y0)
