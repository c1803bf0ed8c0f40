"""The paper's figures from the table of their data; corrected where the claim behind them fell."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from contactbench.report.curves import floats
from contactbench.report.drawing import Axis, Curve, Figure, Heat, Panel

SPHERE_TICKS = ((-1.0, "−1"), (0.0, "0"), (1.0, "1"))
#: the shades of motions near axes 1, 2, 3: far apart
NEAR_AXIS = (1, 4, 3)


def curves(rows: pd.DataFrame, panel: str) -> Iterator[Curve]:
    """Yield the curves of a panel.

    A method has its own look, an ordered set (λ = …) its shades, the others that of their kind.  A method beside the
    laws of a set ("λ = 0.1, contact-strang") is points on its law.
    """
    part = rows[rows["panel"] == panel]
    kinds = part.drop_duplicates("curve").set_index("curve")["kind"]
    ordered = [str(name) for name, kind in kinds.items() if kind == "law" and str(name).startswith("λ")]
    alone = set(kinds) == {"method"}  # nothing else for the points to lie on
    for name, points in part.groupby("curve", sort=False):
        points = points.sort_values("point")
        kind, label, method = str(kinds[name]), with_mathtext(str(name)), ""
        role, own = kind, label
        if kind == "method":
            own, _, method = label.rpartition(", ")
        if own in ordered:
            role, method = f"shade {min(ordered.index(own), 4)}", ""
            label = own if kind == "law" else ""
        elif kind in ("conservative", "dissipative"):
            label = label.partition(", q(0)")[0]  # orbits of one kind are one entry
        single = len(points) == 1
        yield Curve(
            floats(points["x"]),
            floats(points["y"]),
            label,
            method,
            "" if method else role,
            line=not single and (kind != "method" or alone),
            markers=single or kind == "method",
            z=floats(points["z"]) if points["z"].notna().all() else (),
        )


def with_mathtext(label: str) -> str:
    """Return a label with powers and H0 as mathtext."""
    return re.sub(r"\bH0\b", "$H_0$", re.sub(r"(\w+\^\{[^}]*\})", r"$\1$", label))


def flat(rows: pd.DataFrame, panel: str, title: str, x: Axis, y: Axis, **more: Any) -> Panel:
    """Return a panel of the table as it is."""
    return Panel(title, x, y, tuple(replace(curve, z=()) for curve in curves(rows, panel)), **more)


def solid(rows: pd.DataFrame, panel: str, letter: str, view: tuple[float, float]) -> Panel:
    """Return a panel of curves in or on the unit sphere."""
    x, y, z = (Axis(f"{letter}{digit}", limits=(-1.0, 1.0), ticks=SPHERE_TICKS) for digit in "₁₂₃")
    return Panel("", x, y, tuple(curves(rows, panel)), z=z, sphere=True, equal=True, view=view)


# -- panels of single figures ----------------------------------------------------------------------
def orders(rows: pd.DataFrame) -> Panel:
    """Return the convergence of figure 7, its fitted orders (the third coordinate) in the title."""
    x, y = Axis("step size h", "log"), Axis(r"max $|H_0 - H_0^\ast|$ over [0, T]", "log")
    fitted = sorted({f"{curve.z[0]:.2f}" for curve in curves(rows, "convergence") if curve.z})
    return flat(rows, "convergence", f"orders {', '.join(fitted)}", x, y)


def by_axis(panel: Panel) -> Panel:
    """Return the motions of figure 4 in the shades of their first axes."""
    shaded = (
        replace(curve, role=f"shade {NEAR_AXIS[n % 3]}", markers=False)
        for n, curve in enumerate(panel.curves)
    )
    return replace(panel, curves=tuple(shaded))


def angles(rows: pd.DataFrame) -> Panel:
    """Return the angle of M with the axis it started near, against ‖M‖, which falls as exp(−γt)."""
    found = []
    for name, points in rows[rows["panel"] == "momentum"].groupby("curve", sort=False):
        M = points.sort_values("point")[["x", "y", "z"]].to_numpy(dtype=float)
        size = np.linalg.norm(M, axis=1)
        cosine = np.clip(M[:, int(str(name)[-1]) - 1] / size, -1, 1)
        found.append(Curve(floats(size / size[0]), floats(np.degrees(np.arccos(cosine))), str(name)))
    x = Axis("‖M‖ / ‖M(0)‖ = exp(−γt)", inverted=True, limits=(0.0, 1.0))
    y = Axis("angle of M with its first axis, degrees", limits=(0.0, 185.0))
    return Panel("", x, y, tuple(found))


def with_rates(rows: pd.DataFrame, panel: Panel) -> Panel:
    """Return the directions of figure 5, one entry for each kind, with its axes and growth rate."""
    labels = {"flow": "flow"}
    for kind, part in rows[rows["panel"] == "rate"].groupby("kind", sort=False):
        axes = " and ".join(sorted({str(name)[-1] for name in part["curve"]}))
        labels[str(kind)] = f"{kind} direction: axis {axes}, growth rate {abs(part['z']).max():.3g}"
    return replace(panel, curves=tuple(replace(c, label=labels.get(c.role, c.label)) for c in panel.curves))


def growth(rows: pd.DataFrame) -> Iterator[Panel]:
    """Yield growth rates over two entries of D, with the criterion where the table has one.

    Panels are called "axis i", or "axis i, diagonal" and "axis i, full" for the two slices of D.
    """
    sample = rows[rows["curve"] == "growth rate"]
    lines = rows[rows["curve"] != "growth rate"]
    for panel, part in sample.groupby("panel", sort=False):
        grid = part.pivot(index="y", columns="x", values="z")
        values = tuple(tuple(map(float, line)) for line in grid.to_numpy())
        heat = Heat(floats(grid.columns), floats(grid.index), values, "growth rate")
        axis, _, cut = str(panel).partition(", ")
        first, second = (i for i in "123" if i != axis[-1])
        x, y = f"d{first}{first}", f"d{second}{second}"
        if cut == "full":
            x, y = f"{x} = {y}", f"d{first}{second}"
        found = tuple(replace(c, label="criterion") for c in curves(lines, str(panel)))
        yield Panel(f"rotation about {panel}", Axis(x), Axis(y), found, heat=heat)


# -- the figures -----------------------------------------------------------------------------------
@dataclass(frozen=True)
class Plan:
    """A figure: its title, how its panels are made from its rows, and its caption."""

    title: str
    panels: Callable[[pd.DataFrame], list[Panel]]
    caption: str = ""
    more: dict[str, Any] = field(default_factory=dict)


def phase(rows: pd.DataFrame, panel: str, letters: tuple[str, str] = ("q", "p")) -> Panel:
    """Return a phase portrait."""
    return flat(rows, panel, "", Axis(letters[0]), Axis(letters[1]), equal=True)


PLANS = {
    "paper_2": Plan(
        "Oscillator: closed orbits without damping, spirals with it (figure 2)",
        lambda rows: [phase(rows, "phase")],
    ),
    "paper_3": Plan(
        "Central force: J decays as exp(−λt), and so does that of the method (figure 3)",
        lambda rows: [flat(rows, "decay", "", Axis("t"), Axis("J(t) / J(0)", "log"))],
        "Lines: exp(−λt); points: contact-strang.",
    ),
    "paper_4": Plan(
        "Damped rigid body: all decays, and no direction near axis 2 settles (figure 4, corrected)",
        lambda rows: [by_axis(solid(rows, "momentum", "M", (22.0, -50.0))), by_axis(angles(rows))],
        "The direction stays on its polhode.",
    ),
    "paper_5": Plan(
        "Directions u = M/‖M‖: relative equilibria, axis 2 unstable (figure 5, corrected)",
        lambda rows: [with_rates(rows, solid(rows, "sphere", "u", (22.0, 52.0)))],
        "Relative equilibria, no equilibria: on every axis ‖M'‖ = γ‖M‖.",
    ),
    "paper_7": Plan(
        "2-DOF particle, γ = 0.1: H₀ does not decay exponentially (figure 7, corrected)",
        lambda rows: [
            flat(rows, "energy", "energy at h = 0.01", Axis("t"), Axis("$H_0$", "log")),
            flat(rows, "ratio", "beside exp(−γt)", Axis("t"), Axis("$H_0 / (H_0(0) e^{-γt}) - 1$")),
            orders(rows),
        ],
    ),
    "paper_8": Plan(
        "contact-printed on the particle: at γ = 0 the energy error is bounded (figure 8, corrected)",
        lambda rows: [
            phase(rows, "phase", ("q₁", "p₁")),
            flat(rows, "energy", "energy", Axis("t"), Axis("$H_0$")),
            flat(rows, "bounded", "energy error at γ = 0", Axis("t"), Axis("$H_0 / H_0(0) - 1$")),
        ],
    ),
    "paper_stability": Plan(
        "Rotations in ker D, I = (1, 2, 3): where they are unstable (red)",
        lambda rows: list(growth(rows)),
        "Gold: growth rate 0; dashed: the criterion.",
    ),
}


def figure(name: str, rows: pd.DataFrame) -> Figure:
    """Return one figure of the table; one without a plan has a panel per panel and its curves as they are."""
    plan = PLANS.get(name) or Plan(
        name, lambda rows: [flat(rows, p, p, Axis("x"), Axis("y")) for p in dict.fromkeys(rows["panel"])]
    )
    panels = tuple(panel for panel in plan.panels(rows) if panel.curves or panel.heat)
    return Figure(name, plan.title, panels, plan.caption, 3)


def all_figures(table: pd.DataFrame) -> Iterator[Figure]:
    """Yield every figure the table has data for."""
    found = (figure(str(name), rows) for name, rows in table.groupby("figure", sort=False))
    yield from (each for each in found if each.panels)
