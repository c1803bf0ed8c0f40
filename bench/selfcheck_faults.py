"""What the self-check of the gate plants, where it must show, and what it knows not to be seen."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from contactbench.gate.verdict import Line
from planted_faults import PLANTED

ROOT = Path(__file__).resolve().parents[1]


#: what is done beside a judgement: nothing more than the machine does anyway, or busy loops
AS_IT_WAS, LOADED = "as it was", "loaded"


@dataclass(frozen=True)
class Judgement:
    """One thing the gate judged: whether it was red, and in what words.

    wanted : none, all, 19 in 20, the more the better, or not seen.
    """

    part: str
    planted: str
    condition: str
    wanted: str
    red: bool
    words: str
    seconds: float


@dataclass(frozen=True)
class Task:
    """Some judgements that are made together.

    about : seconds it takes, roughly.  shared : whether others may run beside it.
    """

    name: str
    about: float
    judge: Callable[[], list[Judgement]]
    shared: bool = True


def said(line: Line) -> str:
    """A line of the gate in words."""
    words = asdict(line)
    return " ".join(
        words[name] for name in ("scene", "method", "measure", "before", "after", "change")
    ).strip()


#: ends with the process that began it, killed or not
BUSY = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: pass"


@contextmanager
def load() -> Iterator[None]:
    """Busy loops on all cores but one."""
    loops = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(max(1, (os.cpu_count() or 2) - 1))]
    try:
        yield
    finally:
        for process in loops:
            process.kill()
            process.wait()


@dataclass(frozen=True)
class Fault:
    """Something planted in one place by a call of `planted_faults`, and the method and measures that must give
    it away."""

    what: str
    planted: str
    method: str
    measures: frozenset[str]


FAULTS = tuple(
    Fault(what, planted, method, frozenset(measures.split()))
    for what, planted, method, measures in (
        ("order 2 replaced by order 1", "order_one()", PLANTED, "solution_error pairwise_order"),
        ("an extra gradient evaluation per step", "joints_left_apart()", PLANTED, "evaluations"),
        ("a status change: a scene refused", "refusal()", PLANTED, "status"),
        ("dropped rows: a method is gone", "no_bm4()", "contact-bm4", "method"),
        (
            "a drift that is no longer round-off: damping stronger by 1e-9", "stronger_damping()", PLANTED,
            "contact_drift",
        ),
    )
)  # fmt: skip


@dataclass(frozen=True)
class Moved:
    """One of the faults of `planted_faults.other_numbers`, and the line that must give it away.

    subject : what a line of it names, a scene, a method or its setting.
    """

    what: str
    table: str
    measure: str
    subject: str


#: all planted at once, each to be found by itself
OTHER = (
    Moved("a scene's damping, × 1.01", "definitions", "digest", "central"),
    Moved(
        "an ensemble, wrong by 1e-6 from its sixth member on", "ensemble", "member_deviation", "contact-rkn6"
    ),
    Moved("an adaptive solver's count, − 9 %", "work_precision", "evaluations", "scipy-dop853"),
    Moved("what a claim measures, × 1.03", "claims", "measured", "C25"),
    Moved("the energy along time, × 1.03", "laws_time", "energy", "rk4"),
    Moved("a figure's curves, × 1.03", "paper_figures", "y", "paper_3"),
    Moved("the time of a blow-up, × 1.03", "stability", "blow_up_time", "escape"),
    Moved("fitted orders, − 0.1", "convergence", "order", "rk4"),
)
#: the part of the smoke profile that visits them
OTHER_CELLS = (
    "(definition and central) or (test_ensemble and error) or (work_precision and particle and dop853 and not long) "
    "or (test_claim and C25) or paper_3 or (particle and rk4 and not long and (convergence or laws)) "
    "or (stability and escape and rk4)"
)
#: the same, so small, or on so different a machine, that the gate lets it pass
LITTLE = 1.005
UNSEEN = (
    Moved("what a claim measures, × 1.005", "claims", "measured", "C25"),
    Moved("the energy along time, × 1.005", "laws_time", "energy", "rk4"),
    Moved("a figure's curves, × 1.005", "paper_figures", "y", "paper_3"),
    Moved("the time of a blow-up, × 1.005", "stability", "blow_up_time", "escape"),
)
ELSEWHERE = Moved(
    "an adaptive solver's count, − 9 %, on another processor", "work_precision", "evaluations", "scipy-dop853"
)


@dataclass(frozen=True)
class Spent:
    """Time or memory planted in one of two trees: ``{tree}`` in the call is the tree's folder.

    method, scene, saves : the cell that must give it away.  seen : whether the gate claims to see it.
    """

    what: str
    planted: str
    measure: str
    method: str
    scene: str = "particle"
    saves: int = 1
    seen: bool = True


SPENT = (
    Spent("0.3 s more to compile", "dearer('contact-strang', '{tree}', 0.3)", "compilation", "contact-strang"),
    Spent(
        "10 kB left behind by every run", "dearer('contact-strang', '{tree}', leak=10_000)", "memory left behind",
        "contact-strang",
    ),
    Spent(
        "twice as slow on one scene only", "slower_sometimes('rk4', 2.0, 'central', 1, '{tree}')", "time", "rk4",
        "central",
    ),
    Spent(
        "twice as slow with many saved times only", "slower_sometimes('rk4', 2.0, 'particle', 100, '{tree}')", "time",
        "rk4", saves=1000,
    ),
    Spent(
        "0.05 s more to compile", "dearer('contact-abc', '{tree}', 0.05)", "compilation", "contact-abc", seen=False,
    ),
    Spent("1.1 times as slow", "slower(['contact-abc'], 1.1, '{tree}')", "time", "contact-abc", seen=False),
    Spent(
        "1 kB left behind by every run", "dearer('contact-bm4', '{tree}', leak=1_000)", "memory left behind",
        "contact-bm4", seen=False,
    ),
)  # fmt: skip
