"""Do two runs of the benchmark agree?  ``python bench/two_runs.py DIR DIR``.

Verdicts: pairs of scene and error by what either run says of them.  Times: how many cells of the second run differ from
the first by no more than the two margins allow.  Exit status 1 where a verdict turned round.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import numpy as np

from contactbench.measure.statistics import Verdict, margin
from contactbench.report.contest import KINDS, Field
from contactbench.results.store import read
from contactbench.results.tables import WORK_PRECISION


def verdicts(first, second):
    """How often each pair of verdicts was met, over the contests of both runs."""
    mine, theirs = first.contests(), second.contests()
    return Counter((mine[key].outcome, theirs[key].outcome) for key in mine.keys() & theirs.keys())


def within(first, second, kind, spreads):
    """Ratio of every cell's time in the second run to that in the first, and its margin; spreads : by engine."""
    key = list(WORK_PRECISION.key)
    cells = first[kind.compares(first)].merge(second, on=key, suffixes=("", "_2")).dropna(subset=[kind.cost])
    ratios = (cells[f"{kind.cost}_2"] / cells[kind.cost]).to_numpy(dtype=float)
    halves = cells[[kind.halves, f"{kind.halves}_2"]].to_numpy(dtype=float)
    margins = [margin(own, spreads[engine]) for own, engine in zip(halves, cells["engine"], strict=True)]
    return np.maximum(ratios, 1 / ratios), np.array(margins)


def main(folders):
    first, second = (read(WORK_PRECISION, Path(folder)) for folder in folders)
    turned = 0
    for kind in KINDS:
        fields = Field(first, kind), Field(second, kind)
        for (before, after), n in sorted(verdicts(*fields).items(), key=lambda item: -item[1]):
            print(f"{kind.title}: {before or 'nobody'} / {after or 'nobody'}: {n}")
            turned += n * ({before, after} == {Verdict.win, Verdict.loss})
        if kind.timed:
            engines = set.union(*(set(field.processes) for field in fields))
            widest = {e: max(field.processes.get(e, 1.0) for field in fields) for e in engines}
            for name, field in zip(folders, fields, strict=True):
                if field.margins:
                    half, most = np.quantile(field.margins, (0.5, 0.95))
                    print(
                        f"{kind.title}, {name}: margins ×{half:.3f} (half of the pairs), ×{most:.3f} (95 %)"
                    )
            ratios, margins = within(first, second, kind, widest)
            if len(ratios):
                inside = np.mean(ratios <= margins)
                print(f"{kind.title}: {inside:.1%} of {len(ratios)} cells within their margins")
    print(f"verdicts that turned round: {turned}")
    return int(turned > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:3]))
