"""Compare the speed of the working tree with older revisions, each in a process of its own.

A round times every cell in shuffled order and the revisions of a cell directly after one another, so that other load on
the machine hits them alike.  Only the ratios of such pairs are judged, never a time.
"""

from __future__ import annotations

import json
import random
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from subprocess import PIPE
from typing import Any

import pandas as pd

from contactbench.errors import BadInput
from contactbench.gate import revisions
from contactbench.gate.compare import INCONCLUSIVE, Findings, rows_of
from contactbench.measure.statistics import PairedRatio, paired_ratio
from contactbench.methods import METHODS
from contactbench.scenes import SCENES
from contactbench.solution import setting_key

RATIO_LIMIT = 1.25
ROUNDS = 15
MOST_ROUNDS_UNTIL_DECIDED = 60
LONGEST_MESSAGE = 80

HEAD, BASE, PINNED = "tree", "base", "pinned"
#: the revision that the tree is compared with, and the number of the cell
type Pair = tuple[str, int]
type Send = Callable[[object], None]
type Receive = Callable[[], Any]

#: the finest setting of a method that takes at most this many seconds is timed
LONGEST_CALL = 3e-3
PREPARED = "prepared"
MANY_SAVED_TIMES = 1000


@dataclass(frozen=True)
class Cell:
    """Describe a call to time, of a prepared run or of a public function; saves : number of equidistant saved times."""

    scene: str
    method: str
    engine: str
    control: str
    value: float
    saves: int = 1
    call: str = PREPARED

    @property
    def kind(self) -> str:
        return self.method if self.call == PREPARED else self.call

    @property
    def setting(self) -> str:
        many = f", {self.saves} saved times" if self.saves > 1 else ""
        call = f", {self.call}" if self.call != PREPARED else ""
        return f"{setting_key(self.control, self.value)}{many}{call}"


def public() -> list[Cell]:
    """Return the public calls to time: on the second scene, and a reference in closed form on the first."""
    closed, scene = [*SCENES.values()][:2]
    method = next(m for m in METHODS.values() if m.contact and m.control == "step")
    cell = Cell(scene.name, method.name, method.engines[0], method.control, 0.1)
    short = replace(cell, value=scene.t_end / 12)  # so few steps that the overhead of the call shows
    cells = [replace(short, call=call) for call in ("run()", "run(q=…)", "bare")]
    cells += [replace(cell, call=call) for call in ("solve", "new scene", "import", "reference")]
    return [*cells, replace(cell, scene=closed.name, call="reference")]


def workload(times: pd.DataFrame, everywhere: bool = False) -> list[Cell]:
    """Return the cells to time, each at the finest setting that is fast enough.

    All methods on the first scene, also with many saved times, and on the longest; one per family on the others; the
    public calls.  everywhere : instead all methods on all scenes.
    """
    known = times[times["scene"].isin([*SCENES]) & times["method"].isin([*METHODS])]
    own = known["control"] == [METHODS[name].control for name in known["method"]]
    timed = known[own & (known["saved"] == 1) & (known["least_s"] <= LONGEST_CALL)].sort_values("least_s")
    slowest = timed.groupby(["scene", "method", "engine"], sort=False).tail(1).sort_index()
    cells = [Cell(r.scene, r.method, r.engine, r.control, float(r.setting)) for r in slowest.itertuples()]
    if everywhere or not cells:
        return cells
    scenes = list(dict.fromkeys(cell.scene for cell in cells))
    longest = max(scenes, key=lambda name: SCENES[name].t_end)
    first = {(cell.scene, METHODS[cell.method].family): cell for cell in reversed(cells)}.values()
    chosen = [cell for cell in cells if cell.scene in (scenes[0], longest) or cell in first]
    default = [cell for cell in cells if cell.engine == METHODS[cell.method].engines[0]]
    many = [replace(cell, saves=MANY_SAVED_TIMES) for cell in default if cell.scene == scenes[0]]
    return [*chosen, *many, *public()]


def too_few(cells: Sequence[Cell], timed: Collection[int]) -> tuple[str, ...]:
    left_out = sorted({cell.kind for cell in cells} - {cells[i].kind for i in timed})
    few = [f"only {len(timed)} of {len(cells)} cells timed"] if 2 * len(timed) < len(cells) else []
    return (*few, *([f"no cell timed of {', '.join(left_out)}"] if left_out else []))


def compare_speed(root: Path, tree: Path, cells: Sequence[Cell], pin: str = "") -> Findings:
    pairs, incomplete = {(BASE, i) for i in range(len(cells))}, list[str]()
    with ExitStack() as stack:
        trees = {HEAD: root, BASE: tree}
        if pin and (commit := revisions.commit(root, pin)):
            trees[PINNED] = stack.enter_context(revisions.checkout(root, commit))
            pairs |= {(PINNED, i) for i, cell in enumerate(cells) if cell.call != PREPARED}
        elif pin:
            incomplete = [f"the pinned revision {pin[:12]} is not in this clone; git fetch origin {pin}"]
        first, refused = time_pairs(trees, cells, pairs, root)
        suspects = {pair for pair, ratio in first.items() if ratio.low > RATIO_LIMIT}
        again = time_pairs(trees, cells, suspects, root)[0] if suspects else {}
    rows, calls, ratios = [], list[str](), dict[int, PairedRatio]()
    for (side, i), ratio in sorted(first.items()):
        cell, result = cells[i], decide(ratio, again.get((side, i)))
        if result != "pass":
            after = f"×{ratio.ratio:.2f} (×{ratio.low:.2f} … ×{ratio.high:.2f})"
            row = {name: getattr(cell, name) for name in ("scene", "method", "engine", "setting")}
            row |= {"between": f"{side} → tree", "measure": "time", "before": "×1", "after": after}
            rows.append(row | {"result": result, "red": result == "slower"})
        if side == BASE:
            ratios[i] = ratio
        else:
            calls.append(f"{cell.call} on {cell.scene} ×{ratio.ratio:.2f}")
    middle = median(ratio.ratio for ratio in ratios.values()) if ratios else 1.0
    notes = [f"speed: {len(ratios)} of {len(cells)} cells timed, median ratio {middle:.3f} to the base"]
    if calls:
        notes.append(f"speed to the pinned {pin[:12]}: {', '.join(calls)}")
    elif PINNED in trees:
        incomplete.append(f"no call timed beside the pinned {pin[:12]}")
    reasons = Counter(
        f"not timed on the {side}: {why[:LONGEST_MESSAGE]}" for (side, _), why in refused.items()
    )
    notes += [f"{count} cells {why}" for why, count in reasons.items()]
    return Findings(rows_of(*rows), tuple(notes), (*too_few(cells, ratios), *incomplete))


def decide(first: PairedRatio, again: PairedRatio | None) -> str:
    """Return the verdict; "slower" needs a second measurement in fresh processes with another memory layout."""
    if first.high <= RATIO_LIMIT:
        return "pass"
    slower = first.low > RATIO_LIMIT and again is not None and again.low > RATIO_LIMIT
    return "slower" if slower else INCONCLUSIVE


def time_pairs(
    trees: Mapping[str, Path], cells: Sequence[Cell], pairs: Collection[Pair], root: Path | None = None
) -> tuple[dict[Pair, PairedRatio], dict[Pair, str]]:
    """Time the tree against each (revision, cell) pair; return the ratios, and the reasons of untimed cells."""
    from tqdm import tqdm

    draw = random.Random(0)
    # the tree times every cell that any other revision times
    asked = {side: sorted({i for one, i in pairs if side in (one, HEAD)}) for side in trees}
    refused: dict[Pair, str] = {}
    with ExitStack() as stack:
        used = [side for side in asked if asked[side]]
        sides = {side: stack.enter_context(timing_process(trees[side], root)) for side in used}
        for side, (send, _) in sides.items():  # all compile at once
            send({i: asdict(cells[i]) for i in asked[side]})
        for side, (_, receive) in sides.items():
            answer = receive()
            if revisions.ours(trees[side]) and not Path(answer["code"]).is_relative_to(trees[side]):
                raise BadInput(f"{trees[side]}: the timing process imports {answer['code']} instead")
            refused |= {(side, int(i)): why for i, why in answer["refused"].items()}
        ask = [pair for pair in sorted(pairs) if not {pair, (HEAD, pair[1])} & refused.keys()]
        times: dict[Pair, tuple[list[float], list[float]]] = {pair: ([], []) for pair in ask}
        ratios: dict[Pair, PairedRatio] = {}
        for done in tqdm(range(1, MOST_ROUNDS_UNTIL_DECIDED + 1), "timing", unit="round", disable=None):
            numbers = sorted({i for _, i in ask})
            for i in draw.sample(numbers, len(numbers)):
                now = [HEAD, *(side for side, j in ask if j == i)]
                fastest = {}
                for side in draw.sample(now, len(now)):
                    send, receive = sides[side]
                    send(i)
                    fastest[side] = min(receive())  # the repeat that nothing interrupted
                for side in now[1:]:
                    for own, seconds in zip(times[side, i], (fastest[side], fastest[HEAD]), strict=True):
                        own.append(seconds)
            if done % ROUNDS == 0:
                ratios |= {pair: paired_ratio(*times[pair]) for pair in ask}
                ask = [pair for pair in ask if ratios[pair].low <= RATIO_LIMIT < ratios[pair].high]
    return ratios, refused


@contextmanager
def timing_process(tree: Path, root: Path | None = None) -> Iterator[tuple[Send, Receive]]:
    command = [sys.executable, "-P", str(Path(__file__).with_name("speed_worker.py"))]
    with (
        tempfile.TemporaryFile("w+") as errors,
        tempfile.TemporaryDirectory(prefix="contactbench-caches-") as caches,
    ):
        # each side compiles for itself: caches are not shared
        names = ("CONTACTBENCH_CACHE", "NUMBA_CACHE_DIR", "JAX_COMPILATION_CACHE_DIR")
        variables = revisions.environment(tree, root) | dict.fromkeys(names, caches)
        process = subprocess.Popen(
            command, text=True, bufsize=1, env=variables, cwd=tree, stdin=PIPE, stdout=PIPE, stderr=errors
        )
        to, out = process.stdin, process.stdout
        assert to is not None
        assert out is not None

        def send(request: object) -> None:
            to.write(json.dumps(request) + "\n")

        def receive() -> Any:
            line = out.readline()
            if line:
                return json.loads(line)
            errors.seek(0)
            last = (errors.read().strip() or f"exit {process.wait()}").splitlines()[-1]
            raise BadInput(f"{tree}: the timing process ended: {last}")

        try:
            yield send, receive
        finally:
            process.kill()
            process.wait()
