"""Solvers in C and C++ that get the scene as C functions: no Python between them and the scene."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from threading import Lock
from types import ModuleType
from typing import Any

import numpy as np

from contactbench.methods.prepared import Outcome
from contactbench.peers.base import PeerRun
from contactbench.peers.c_functions import c_functions
from contactbench.solution import Counts, Status

#: what a compiled call returns of a run, followed by the packed state reached
FACTS = ("flag", "reached", "saved", "steps", "evaluations", "jacobians", "rejected")
KNOWN = len(FACTS)


@dataclass
class CompiledPeer(PeerRun):
    """A run of a compiled solver; a library's own class connects it and reads how it ended."""

    def __post_init__(self) -> None:
        super().__post_init__()
        scene = self.request.scene
        self.functions = c_functions(scene, self.request.carry)
        self.compile_s = self.functions.compile_s
        self.data = self.functions.data(scene.numbers())
        self.clock, self.end = -1 if scene.clock is None else scene.clock, float(self.request.save_at[-1])
        self.final_only = len(self.later) == 1
        self.alone = Lock()  # memory may be shared by the calls: those from several threads take turns
        self.calls, self.arguments = self.connect()

    @abstractmethod
    def connect(self) -> tuple[ModuleType, tuple[Any, ...]]:
        """The library's compiled `to_end`, `at_times` and `in_a_loop`, and their arguments but states and times."""

    @abstractmethod
    def ending(self, flag: int) -> tuple[Status, str]:
        """How a run ended, by the flag that the library returned, and its message."""

    def counts(self, steps: int, evaluations: int, jacobians: int, rejected: float) -> Counts:
        return Counts(steps, evaluations, jacobians, int(rejected))

    def bare(self, y0: np.ndarray) -> np.ndarray:
        return self.calls.to_end(y0, *self.arguments)[KNOWN:]

    def many(self, starts: np.ndarray) -> np.ndarray:
        """`FACTS` and final state, (n, KNOWN + d), of one start (n, d) after the other, in a compiled loop."""
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
