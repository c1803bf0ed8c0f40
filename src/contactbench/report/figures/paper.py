"""The paper's figures from the table of their data; corrected where the claim behind them fell.

A figure the table has and SHAPES does not is drawn with a panel per panel and its curves as they are.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from contactbench.report.curves import floats
from contactbench.report.drawing import Axis, Curve, Figure, Heat, Note, Panel

UNIT = (-1.0, 1.0)
SPHERE_TICKS = ((-1.0, "−1"), (0.0, "0"), (1.0, "1"))


@dataclass(frozen=True)
class Shape:
    """How a panel of the table is drawn: title, axes, and what else `Panel` takes."""

    title: str
    x: Axis
    y: Axis
    more: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Plan:
    """A figure: its title, caption and panels; `also` makes panels that need more than the curves."""

    title: str
    panels: dict[str, Shape]
    caption: str = ""
    also: Callable[[pd.DataFrame], Iterator[Panel]] = lambda rows: iter(())


def curves(rows: pd.DataFrame, panel: str) -> Iterator[Curve]:
    """The curves of a panel: a method has its own look, an ordered set its shades, the others that of their kind.

    A method beside laws of a set ("λ = 0.1, contact-strang") is points on its law.
    """
    part = rows[rows["panel"] == panel]
    kinds = part.drop_duplicates("curve").set_index("curve")["kind"]
    ordered = [str(name) for name, kind in kinds.items() if kind == "law" and str(name).startswith("λ")]
    lines = set(kinds) == {"method"}  # nothing else for the points to lie on
    for name, points in part.groupby("curve", sort=False):
        points = points.sort_values("point")
        label, kind, single = with_mathtext(str(name)), str(kinds[name]), len(points) == 1
        own, _, method = label.rpartition(", ") if kind == "method" else (label, "", "")
        role = f"shade {min(ordered.index(own), 4)}" if own in ordered else kind
        points_only = single or (kind == "method" and not lines)
        yield Curve(
            floats(points["x"]), floats(points["y"]), "" if method and own in ordered else label,
            "" if own in ordered else method, "" if method and own not in ordered else role,
            line=not points_only, markers=single or kind == "method",
            dashed=kind in ("dissipative", "criterion"), z=floats(points["z"]) if points["z"].notna().all() else (),
        )  # fmt: skip


def with_mathtext(label: str) -> str:
    """Powers and H0 as mathtext."""
    return re.sub(r"\bH0\b", "$H_0$", re.sub(r"(\w+\^\{[^}]*\})", r"$\1$", label))


def kinds_told(rows: pd.DataFrame, found: Iterable[Curve]) -> tuple[Curve, ...]:
    """Directions on the sphere by their kind, with the growth rate the table has; one entry for the flow."""
    rates = rows[rows["panel"] == "rate"]
    told = {}
    for kind, part in rates.groupby("kind", sort=False):
        axes = sorted({str(name)[-1] for name in part["curve"]})
        told[str(kind)] = (
            f"{kind} direction: axis {' and '.join(axes)}, growth rate {abs(part['z']).max():.3g}"
        )
    return tuple(replace(c, label=told.get(c.role, "flow" if c.role == "flow" else c.label)) for c in found)


def momentum(letter: str) -> dict[str, Axis]:
    return {
        name: Axis(f"{letter}{digit}", limits=UNIT, ticks=SPHERE_TICKS)
        for name, digit in zip("xyz", "₁₂₃", strict=True)
    }


def on_sphere(letter: str, title: str, view: tuple[float, float]) -> Shape:
    axes = momentum(letter)
    return Shape(title, axes["x"], axes["y"], {"z": axes["z"], "sphere": True, "equal": True, "view": view})


#: the shades of motions near axes 1, 2, 3: far apart
NEAR_AXIS = (1, 4, 3)


def angles(rows: pd.DataFrame) -> Iterator[Panel]:
    """The angle of M with the axis it started near, against ‖M‖, which falls as e^{−γt}."""
    found: list[Curve] = []
    for name, points in rows[rows["panel"] == "momentum"].groupby("curve", sort=False):
        M = points.sort_values("point")[["x", "y", "z"]].to_numpy(dtype=float)
        size = np.linalg.norm(M, axis=1)
        cosine = np.clip(M[:, int(str(name)[-1]) - 1] / size, -1, 1)
        found.append(
            Curve(tuple(size / size[0]), tuple(np.degrees(np.arccos(cosine))), str(name),
                  role=f"shade {NEAR_AXIS[len(found) % 3]}", markers=False)
        )  # fmt: skip
    degrees = Axis("angle of M with its first axis, degrees", limits=(0.0, 185.0))
    yield Panel(
        "direction", Axis("‖M‖ / ‖M(0)‖ = exp(−γt)", inverted=True, limits=(0.0, 1.0)), degrees, tuple(found)
    )


def growth(rows: pd.DataFrame) -> Iterator[Panel]:
    """Growth rates over two entries of D, with the criterion where the table has one.

    Panels are called "axis i", or "axis i, diagonal" and "axis i, full" for the two slices of D.
    """
    sample = rows[rows["curve"] == "growth rate"]
    for panel, part in sample.groupby("panel", sort=False):
        grid = part.pivot(index="y", columns="x", values="z")
        values = tuple(tuple(map(float, line)) for line in grid.to_numpy())
        heat = Heat(
            floats(grid.columns),
            floats(grid.index),
            values,
            "largest transverse growth rate",
            "growth rate 0",
        )
        axis, _, slice_ = str(panel).partition(", ")
        first, second = (i for i in "123" if i != axis[-1])
        full = (f"d{first}{first} = d{second}{second}", f"d{first}{second}")
        labels = full if slice_ == "full" else (f"d{first}{first}", f"d{second}{second}")
        lines = (c for c in curves(rows[rows["curve"] != "growth rate"], str(panel)))
        yield Panel(
            f"rotation about {panel}", Axis(labels[0]), Axis(labels[1]),
            tuple(replace(c, label="criterion") for c in lines), heat=heat,
        )  # fmt: skip


PLANS = {
    "paper_2": Plan(
        "Oscillator: closed orbits and spirals (figure 2)",
        {"phase": Shape("", Axis("q"), Axis("p"), {"equal": True, "notes": (Note(0, 0, "+"),)})},
    ),
    "paper_3": Plan(
        "Momentum map of the central force (figure 3)",
        {"decay": Shape("", Axis("t"), Axis("J(t) / J(0)", "log"))},
        "Lines: exp(−λt); points: the method.",
    ),
    "paper_4": Plan(
        "Damped rigid body (figure 4, corrected)", {"momentum": on_sphere("M", "momentum space", (22.0, -50.0))},
        "All decay to the origin; the direction stays on its polhode, and from near axis 2 it does not settle on a "
        "stable axis.", angles,
    ),
    "paper_5": Plan(
        "Directions u = M/‖M‖ (figure 5, corrected)", {"sphere": on_sphere("u", "relative equilibria", (22.0, 52.0))},
        "Relative equilibria, no equilibria: on every axis ‖M'‖ = γ‖M‖.",
    ),
    "paper_7": Plan(
        "2-DOF particle, γ = 0.1, T = 20 (figure 7, corrected)",
        {
            "energy": Shape("energy at h = 0.01", Axis("t"), Axis("$H_0$", "log")),
            "ratio": Shape("$H_0$ does not decay exponentially", Axis("t"), Axis("$H_0 / (H_0(0) e^{-γt}) - 1$")),
            "convergence": Shape(
                "convergence", Axis("step size h", "log"), Axis(r"max $|H_0 - H_0^\ast|$ over [0, T]", "log")
            ),
        },
    ),
    "paper_8": Plan(
        "contact-printed on the 2-DOF particle, h = 0.01 (figure 8, corrected)",
        {
            "phase": Shape("phase portrait: the γ = 0 orbit does not close", Axis("q₁"), Axis("p₁"), {"equal": True}),
            "energy": Shape("energy", Axis("t"), Axis("$H_0$")),
            "bounded": Shape("energy error at γ = 0: bounded", Axis("t"), Axis("$H_0 / H_0(0) - 1$")),
        },
    ),
    "paper_stability": Plan("Rotations in ker D, I = (1, 2, 3), $\\Vert M_*\\Vert = 1$", {}, "Red: unstable.", growth),
}  # fmt: skip


def with_orders(rows: pd.DataFrame, panel: str, found: tuple[Curve, ...]) -> tuple[Curve, ...]:
    """A convergence panel names the fitted order of each curve, its third coordinate."""
    if panel != "convergence":
        return found
    return tuple(replace(c, note=f"{c.z[0]:.2f}", z=()) if c.z else c for c in found)


def figure(name: str, rows: pd.DataFrame) -> Figure:
    """One figure of the table."""
    there = list(dict.fromkeys(rows["panel"]))
    plan = PLANS.get(name) or Plan(name, {panel: Shape(panel, Axis("x"), Axis("y")) for panel in there})
    panels = []
    for panel, shape in plan.panels.items():
        if panel not in there:
            continue
        found = with_orders(rows, panel, tuple(curves(rows, panel)))
        if "rate" in there:
            found = kinds_told(rows, found)
        if panel == "momentum":  # each by its own colour, as in the panel of angles
            found = tuple(replace(c, role=f"shade {NEAR_AXIS[n % 3]}") for n, c in enumerate(found))
        if shape.more.get("z") is None:
            found = tuple(replace(c, z=()) for c in found)
        panels.append(Panel(shape.title, shape.x, shape.y, found, **shape.more))
    drawn = (*panels, *plan.also(rows))
    solid = any(panel.z is not None for panel in drawn)
    mapped = any(panel.heat is not None for panel in drawn)
    return Figure(
        name, plan.title, drawn, plan.caption, legend="each" if mapped else "shared",
        source="paper_figures.csv", size=(6.4, 4.4) if len(drawn) == 1 or solid else (4.8, 3.9),
    )  # fmt: skip


def all_figures(table: pd.DataFrame) -> Iterator[Figure]:
    """Every figure the table has data for."""
    for name, rows in table.groupby("figure", sort=False):
        made = figure(str(name), rows)
        if made.panels:
            yield made
