"""Do two runs of the benchmark agree?  ``python bench/two_runs.py DIR DIR``.

Winners: pairs of scene and error by who wins in either run.  Times: how many cells of the second run differ from
the first by no more than the two margins allow.  Exit status 1 where a winner turned round.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import numpy as np

from contactbench.measure.statistics import margin
from contactbench.results.contest import CONTACT, KINDS, OTHER, contestants, contests, costs
from contactbench.results.store import read
from contactbench.results.tables import WORK_PRECISION


def winners(first, second):
    """Return how often each pair of winners was met, over the contests of both runs."""
    both = first.merge(second, on=["scene", "error"], suffixes=("", "_2"))
    return Counter(zip(both["winner"], both["winner_2"], strict=True))


def spreads(rows, kind):
    """Return by what factor two processes differ, by engine."""
    return {str(engine): kind.process_spread(rows, engine) for engine in rows["engine"].unique()}


def within(first, second, kind, spreads):
    """Ratio of every cell's time in the second run to that in the first, and its margin; spreads : by engine."""
    key = list(WORK_PRECISION.key)
    cells = first[kind.compares(first)].merge(second, on=key, suffixes=("", "_2")).dropna(subset=[kind.cost])
    ratios = (cells[f"{kind.cost}_2"] / cells[kind.cost]).to_numpy(dtype=float)
    halves = cells[[kind.halves, f"{kind.halves}_2"]].to_numpy(dtype=float)
    margins = [margin(own, spreads[engine]) for own, engine in zip(halves, cells["engine"], strict=True)]
    return np.maximum(ratios, 1 / ratios), np.array(margins)


def main(folders):
    runs = [contestants(read(WORK_PRECISION, Path(folder))) for folder in folders]
    turned = 0
    for kind in KINDS:
        found = [contests(costs(run, kind)) for run in runs]
        for (before, after), n in winners(*found).most_common():
            print(f"{kind.title}: {before or 'nobody'} / {after or 'nobody'}: {n}")
            turned += n * ({before, after} == {CONTACT, OTHER})
        if kind.timed:
            each = [spreads(run[kind.compares(run)], kind) for run in runs]
            widest = {e: max(own.get(e, 1.0) for own in each) for e in set.union(*map(set, each))}
            for name, contest in zip(folders, found, strict=True):
                if len(margins := contest["margin"].dropna()):
                    half, most = np.quantile(margins, (0.5, 0.95))
                    print(
                        f"{kind.title}, {name}: margins ×{half:.3f} (half of the pairs), ×{most:.3f} (95 %)"
                    )
            ratios, margins = within(*runs, kind, widest)
            if len(ratios):
                inside = np.mean(ratios <= margins)
                print(f"{kind.title}: {inside:.1%} of {len(ratios)} cells within their margins")
    print(f"winners that turned round: {turned}")
    return int(turned > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:3]))
