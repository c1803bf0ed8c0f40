"""Which runs keep a law, as the columns of the tables say; and what a method does at a given cost."""

from __future__ import annotations

import numpy as np
import pandas as pd

from contactbench.measure.law import OF_THE_STATE, WRECKED
from contactbench.questions.contest import by_pilots, floats
from contactbench.solution import EXACT
from contactbench.tables.declared import RUNS
from contactbench.tables.schema import Column, Rule

#: runs with laws are saved at so many times
SAVED = 25
#: saved times of the contest for a curve, and the errors between which its runs are timed
CURVE, CURVE_ERRORS = 1000, (1e-8, 1e-5)
#: numbers of evaluations at which methods are compared
COSTS = tuple(part * 10.0**k for k in range(1, 7) for part in (1, 2, 5))
#: in logarithms a smaller deviation counts as this one
NOTHING = 1e-17


def structural_laws() -> dict[str, Column]:
    """Return the laws of the map itself, which a method either keeps or not whatever its error."""
    return {name: column for name, column in RUNS.columns.items() if column.rule is Rule.structure}


def law_label(law: str) -> str:
    known = RUNS.columns.get(law)
    return known.label if known and known.label else law.replace("_", " ")


def law_rows(runs: pd.DataFrame, law: str) -> pd.DataFrame:
    """Return the runs that have a value of a law.

    Columns beside theirs: law; value; claimed; kept; judged (the run follows the motion); undecided (it is judged, and
    cannot tell); broken.
    """
    rows = runs[(runs["status"] == "ok") & runs[law].notna()]
    follows = rows["error"] <= WRECKED if law in OF_THE_STATE else rows["bound"].notna()
    kept = rows[f"{law}_kept"]
    own = {"law": law, "value": rows[law], "claimed": rows[f"{law}_claimed"], "kept": kept.fillna(False)}
    own |= {"judged": kept.notna() | follows, "undecided": kept.isna() & follows}
    return rows.assign(**own, broken=kept.eq(False).fillna(False)).astype(
        dict.fromkeys(("kept", "broken"), bool)
    )


# -- equal cost ------------------------------------------------------------------------------------
def met_cost(rows: pd.DataFrame) -> float:
    """Return the number of evaluations that most methods have runs below and above, the smallest of several."""
    ok = rows[(rows["status"] == "ok") & rows["evaluations"].notna()]
    spans = ok.groupby("method")["evaluations"].agg(["min", "max"]).astype(float)
    met = [int(((spans["min"] <= cost) & (cost <= spans["max"])).sum()) for cost in COSTS]
    return COSTS[met.index(max(met))]


def at_cost(own: pd.DataFrame, evaluations: float, columns: list[str]) -> pd.Series | None:
    """Return what a method does at a cost: log–log between its runs, at the end of their range where that is near.

    own : runs of one method on one scene.  The series has `evaluations`, the columns, and of each law with a column
    `_kept` whether both runs beside the cost keep it.
    """
    ok = own[(own["status"] == "ok") & ~by_pilots(own)]
    ok = ok[ok["evaluations"].notna() | (ok["control"] == EXACT)]
    if not len(ok):
        return None
    ok = ok.sort_values("evaluations", kind="stable").drop_duplicates("evaluations")
    spent = np.nan_to_num(floats(ok["evaluations"]))
    cost = float(np.clip(evaluations, spent[0], spent[-1]))
    beside = ok.iloc[
        [max(0, int(np.searchsorted(spent, cost, "right")) - 1), int(np.searchsorted(spent, cost))]
    ]
    found: dict[str, object] = {"evaluations": cost}
    for name in columns:
        values = floats(ok[name])
        known = ~np.isnan(values)
        logs = np.log(np.maximum(values[known], NOTHING))
        at = np.log(np.maximum(spent[known], 1.0))
        found[name] = float(np.exp(np.interp(np.log(max(cost, 1.0)), at, logs))) if known.any() else np.nan
        if f"{name}_kept" in ok:
            found[f"{name}_kept"] = bool(beside[f"{name}_kept"].fillna(False).all())
    return pd.Series(found)
