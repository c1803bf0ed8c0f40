"""The paper's figures from the table of their data; corrected where the claim behind them fell."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np
import pandas as pd

from contactbench.report.chapters import chart
from contactbench.report.curves import floats
from contactbench.report.drawing import Axis, Curve, Figure, Panel

#: the shades of motions near axes 1, 2, 3: far apart
NEAR_AXIS = (1, 4, 3)


def curves(rows: pd.DataFrame, panel: str) -> Iterator[Curve]:
    """Yield the curves of a panel; a method beside laws of a set ("λ = 0.1, contact-strang") is points on its law."""
    part = rows[rows["panel"] == panel].sort_values("point", kind="stable")
    kinds = part.drop_duplicates("curve").set_index("curve")["kind"]
    ordered = [str(name) for name, kind in kinds.items() if kind == "law" and str(name).startswith("λ")]
    alone = set(kinds) == {"method"}  # nothing else for the points to lie on
    for name, points in part.groupby("curve", sort=False):
        kind, method = str(kinds[name]), ""
        label = re.sub(r"\bH0\b", "$H_0$", re.sub(r"(\w+\^\{[^}]*\})", r"$\1$", str(name)))
        role, own = kind, label
        if kind == "method":
            own, _, method = label.rpartition(", ")
        if own in ordered:
            role, method = f"shade {min(ordered.index(own), 4)}", ""
            label = own if kind == "law" else ""
        elif kind in ("conservative", "dissipative"):
            label = label.partition(", q(0)")[0]  # orbits of one kind are one entry
        elif kind in ("flow", "stable", "unstable"):
            label = kind
        single = len(points) == 1
        line, markers = not single and (kind != "method" or alone), single or kind == "method"
        places = floats(points["x"]), floats(points["y"])
        yield Curve(*places, label, method, "" if method else role, line, markers)


def flat(rows: pd.DataFrame, panel: str, title: str, x: Axis, y: Axis, equal: bool = False) -> Panel:
    return Panel(title, x, y, tuple(curves(rows, panel)), equal=equal)


# -- panels of single figures ----------------------------------------------------------------------
def orders(rows: pd.DataFrame) -> Panel:
    x, y = Axis("step size h", "log"), Axis(r"max $|H_0 - H_0^\ast|$ over [0, T]", "log")
    fitted = sorted({f"{order:.2f}" for order in rows[rows["panel"] == "convergence"]["z"]})
    return flat(rows, "convergence", f"energy error: orders {', '.join(fitted)}", x, y)


def by_axis(panel: Panel) -> Panel:
    shaded = (
        replace(curve, label=f"near axis {n + 1}", role=f"shade {NEAR_AXIS[n]}", markers=False)
        for n, curve in enumerate(panel.curves)
    )
    return replace(panel, curves=tuple(shaded))


def angles(rows: pd.DataFrame) -> Panel:
    found = []
    for name, points in rows[rows["panel"] == "momentum"].groupby("curve", sort=False):
        M = points.sort_values("point")[["x", "y", "z"]].to_numpy(dtype=float)
        size = np.linalg.norm(M, axis=1)
        cosine = np.clip(M[:, int(str(name)[-1]) - 1] / size, -1, 1)
        found.append(Curve(floats(size / size[0]), floats(np.degrees(np.arccos(cosine))), str(name)))
    x = Axis("‖M‖ / ‖M(0)‖ = exp(−γt)", inverted=True)
    y = Axis("angle between M and the axis it starts near, degrees")
    return Panel("", x, y, tuple(found))


def oblique(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the front of the sphere as seen from between axes 1 and 2, a little from above."""
    around, up = np.radians((52, 22))
    towards = rows["x"] * np.cos(around) + rows["y"] * np.sin(around)
    right = rows["y"] * np.cos(around) - rows["x"] * np.sin(around)
    front = towards * np.cos(up) + rows["z"] * np.sin(up) > 0
    return rows.assign(x=right.where(front), y=rows["z"] * np.cos(up) - towards * np.sin(up))


def sphere(rows: pd.DataFrame) -> Panel:
    panel = flat(oblique(rows), "sphere", "", Axis(""), Axis("axis 3, upwards"), equal=True)
    around = np.linspace(0, 2 * np.pi, 181)
    outline = Curve(floats(np.cos(around)), floats(np.sin(around)), role="guide", markers=False)
    return replace(panel, curves=(outline, *panel.curves))


def growth(rows: pd.DataFrame) -> Iterator[Panel]:
    by_kind = rows.assign(curve=rows["kind"])
    for panel in rows["panel"].unique():
        axis, _, cut = panel.partition(", ")
        first, second = (i for i in "123" if i != axis[-1])
        x, y = f"d{first}{first}", f"d{second}{second}"
        if cut == "full":
            x, y = f"{x} = {y}", f"d{first}{second}"
        found = [
            replace(curve, line=curve.role == "criterion", markers=curve.role != "criterion")
            for curve in curves(by_kind, panel)
        ]
        yield Panel(f"rotation about {axis}, {cut} D", Axis(x), Axis(y), tuple(found))


# -- the figures -----------------------------------------------------------------------------------
#: of each figure, how its panels are made from its rows; titles and captions are in chapters.toml
PLANS: dict[str, Callable[[pd.DataFrame], Iterable[Panel]]] = {
    "paper_2": lambda rows: [flat(rows, "phase", "", Axis("q"), Axis("p"), equal=True)],
    "paper_3": lambda rows: [flat(rows, "decay", "", Axis("t"), Axis("J(t) / J(0)", "log"))],
    "paper_4": lambda rows: [
        by_axis(flat(rows.assign(y=rows["z"]), "momentum", "", Axis("M₁"), Axis("M₃"), equal=True)),
        by_axis(angles(rows)),
    ],
    "paper_5": lambda rows: [sphere(rows)],
    "paper_7": lambda rows: [
        flat(rows, "energy", "energy at h = 0.01", Axis("t"), Axis("$H_0$", "log")),
        flat(rows, "ratio", "relative to exp(−γt)", Axis("t"), Axis("$H_0 / (H_0(0) e^{-γt}) - 1$")),
        orders(rows),
    ],
    "paper_8": lambda rows: [
        flat(rows, "phase", "", Axis("q₁"), Axis("p₁"), equal=True),
        flat(rows, "energy", "energy", Axis("t"), Axis("$H_0$")),
        flat(rows, "bounded", "energy error at γ = 0", Axis("t"), Axis("$H_0 / H_0(0) - 1$")),
    ],
    "paper_stability": growth,
}


def all_figures(table: pd.DataFrame) -> Iterator[Figure]:
    own = table[table["figure"].isin([*PLANS])]
    charts = (
        chart(str(name), PLANS[str(name)](rows), across=3) for name, rows in own.groupby("figure", sort=False)
    )
    return filter(None, charts)
