"""The table of the gate's self-check, which judges no run of the benchmark but the gate."""

from __future__ import annotations

from contactbench.results.columns import seconds, whole
from contactbench.results.schema import Column, table

#: why the columns of the self-check have no rule
OF_THE_GATE = "what the gate says of itself is not what it judges"

GATE_SELFCHECK = table(
    "gate_selfcheck",
    "false alarms of the regression gate on identical code, and planted faults it finds",
    {
        "part": Column("accuracy or speed"),
        "planted": Column("what was changed in the code the gate judges"),
        "condition": Column(
            "what was done beside it: as it was, no more than the machine did anyway; loaded, a busy loop on all "
            "cores but one"
        ),
        "wanted": Column(
            "how many of the runs should be red: none, all, 19 in 20; or not seen, which it does not claim to find",
            ungated=OF_THE_GATE,
        ),
        "runs": whole(
            "judgements: runs of the gate, or faults or loops, each judged once", ungated=OF_THE_GATE
        ),
        "red": whole(
            "how many were red, by a line that names the method and measure of what was planted",
            ungated=OF_THE_GATE,
        ),
        "seconds": seconds("one run of the gate, median"),
        "example": Column("what the first red one said", ungated=OF_THE_GATE),
    },
    key=("part", "planted", "condition"),
    version=2,
    benchmarked=False,
)
