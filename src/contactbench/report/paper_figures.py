"""The paper's figures, redrawn from the table `paper_figures` alone; nothing is solved here.

Where a claim behind a figure fell, the figure shows what is true beside what was claimed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from contactbench.report.figures import style

BLUE, ORANGE, GREY, BLACK = "#0077BB", "#CC3311", "#888888", "#000000"
#: stable and unstable differ in colour and in marker
STABILITY = {"stable": (BLUE, "o"), "unstable": (ORANGE, "X"), "neutral": (GREY, "s")}
SHADES = ["#000000", "#0077BB", "#33BBEE", "#009988", "#EE7733"]
DRAWN: dict[str, Callable[[pd.DataFrame], Figure]] = {}


def drawn(draw: Callable[[pd.DataFrame], Figure]) -> Callable[[pd.DataFrame], Figure]:
    """Register the drawing of a figure under the function's name."""
    DRAWN[draw.__name__] = draw
    return draw


def figures(table: pd.DataFrame) -> Iterator[tuple[str, Figure]]:
    """Every figure the table has data for, with its file name."""
    for name in dict.fromkeys(table["figure"]):
        if name in DRAWN:
            yield name, DRAWN[name](table[table["figure"] == name])


def curves(rows: pd.DataFrame, panel: str) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """Name, kind and points of each curve of a panel."""
    for name, points in rows[rows["panel"] == panel].groupby("curve", sort=False):
        yield str(name), str(points["kind"].iloc[0]), points.sort_values("point")


@drawn
def paper_2(rows: pd.DataFrame) -> Figure:
    """Oscillator: closed orbits and a spiral."""
    figure, axes = plt.subplots(figsize=(5.6, 5.2), layout="constrained")
    looks: dict[str, dict[str, Any]] = {
        "conservative": {"color": BLACK, "linewidth": 1.2},
        "dissipative": {"color": BLUE, "linestyle": "--"},
    }
    seen: dict[str, str] = {}
    for name, kind, points in curves(rows, "phase"):
        gamma = name.partition(",")[0]
        axes.plot(points["x"], points["y"], label=None if kind in seen else gamma, **looks[kind])
        axes.plot(points["x"].iloc[0], points["y"].iloc[0], ".", color=looks[kind]["color"])
        seen[kind] = gamma
    axes.plot(0, 0, "+", color=GREY)
    axes.set(xlabel="q", ylabel="p", aspect="equal", title="oscillator: closed orbits and spirals (figure 2)")
    axes.legend(loc="upper right", ncols=2)
    axes.set_ylim(-1.7, 1.95)
    return figure


@drawn
def paper_3(rows: pd.DataFrame) -> Figure:
    """Decay of the momentum map."""
    figure, axes = plt.subplots(figsize=(6.6, 4.6), layout="constrained")
    laws = [item for item in curves(rows, "decay") if item[1] == "law"]
    rates = {name: float(name.partition("= ")[2]) for name, _, _ in laws}
    for color, name in zip(SHADES, sorted(rates, key=lambda n: rates[n]), strict=False):
        law = next(points for other, _, points in laws if other == name)
        dash = "-" if rates[name] == 0 else "--"
        axes.plot(law["x"], law["y"], dash, color=color, linewidth=1.2, label=f"{name}: $e^{{-λt}}$")
        for other, kind, points in curves(rows, "decay"):
            if kind == "method" and other.startswith(name + ","):
                axes.plot(points["x"], points["y"], "o", color=color, markersize=4)
    method = next(name.partition(", ")[2] for name, kind, _ in curves(rows, "decay") if kind == "method")
    handles, labels = axes.get_legend_handles_labels()
    handles.append(Line2D([], [], marker="o", linestyle="", color=GREY, markersize=4))
    axes.legend(handles, [*labels, f"{method}, h = 0.1"], loc="lower left")
    axes.set(
        yscale="log", xlabel="t", ylabel="J(t) / J(0)", title="momentum map of the central force (figure 3)"
    )
    return figure


def sphere(axes: Axes, radius: float = 1.0) -> None:
    """A faint wire sphere."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 25), np.linspace(0, np.pi, 13))
    x, y, z = np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)
    axes.plot_wireframe(radius * x, radius * y, radius * z, color="#dddddd", linewidth=0.4)  # type: ignore[attr-defined]


def momentum_space(axes: Axes, label: str) -> None:
    axes.set(
        xlabel=f"{label}₁", ylabel=f"{label}₂", zlabel=f"{label}₃", xlim=(-1, 1), ylim=(-1, 1), zlim=(-1, 1)
    )
    axes.set_box_aspect((1, 1, 1))  # type: ignore[arg-type]
    axes.set_xticks([-1, 0, 1])
    axes.set_yticks([-1, 0, 1])
    axes.set_zticks([-1, 0, 1])  # type: ignore[attr-defined]


@drawn
def paper_4(rows: pd.DataFrame) -> Figure:
    """Damped body in momentum space, and its components near each axis."""
    figure = plt.figure(figsize=(13.5, 5.0))
    axes = figure.add_axes((0.0, 0.03, 0.42, 0.87), projection="3d")
    sphere(axes)
    across = figure.add_axes((0.5, 0.13, 0.48, 0.75))
    looks = dict(
        zip(
            ("near axis 1", "near axis 2", "near axis 3"),
            ((BLUE, "-"), (ORANGE, "-"), ("#009988", "-")),
            strict=True,
        )
    )
    for name, _, points in curves(rows, "momentum"):
        color, dash = looks[name]
        axes.plot(points["x"], points["y"], points["z"], dash, color=color, linewidth=1.1, label=name)
        axes.plot(*([v] for v in points[["x", "y", "z"]].iloc[0]), "o", color=color, markersize=4)
        M = points[["x", "y", "z"]].to_numpy()
        own = int(name[-1]) - 1
        cosine = M[:, own] / np.linalg.norm(M, axis=1)
        size = np.linalg.norm(M, axis=1)
        across.plot(size, np.degrees(np.arccos(np.clip(cosine, -1, 1))), dash, color=color, label=name)
    axes.plot([0], [0], [0], "k+", markersize=8)
    momentum_space(axes, "M")
    axes.view_init(elev=22, azim=-50)  # type: ignore[attr-defined]
    across.set_ylabel("angle of M with the axis it started near, degrees")
    across.set_xlabel("‖M‖ / ‖M(0)‖ = $e^{-γt}$ (time runs to the right)")
    across.set_ylim(0, 185)
    across.set_yticks(range(0, 181, 30))
    across.set_xlim(1, 0)
    across.legend(loc="upper left")
    figure.suptitle(
        "damped rigid body (figure 4, corrected): all decay to the origin; from near axis 2 the "
        "direction swings over\n"
        "to near −e₂, on its polhode, and does not settle on a stable axis"
    )
    return figure


@drawn
def paper_5(rows: pd.DataFrame) -> Figure:
    """Directions of M: relative equilibria on the sphere."""
    figure = plt.figure(figsize=(9.5, 5.6), layout="constrained")
    axes = figure.add_subplot(1, 1, 1, projection="3d", computed_zorder=False)
    elevation, azimuth = 22.0, 52.0
    axes.view_init(elev=elevation, azim=azimuth)  # type: ignore[attr-defined]
    axes.set_proj_type("ortho")  # type: ignore[attr-defined]  # near and far as the greys say
    e, a = np.radians([elevation, azimuth])
    towards = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    sphere(axes)
    rates = {name: points.iloc[0] for name, _, points in curves(rows, "rate")}
    for name, kind, points in curves(rows, "sphere"):
        xyz = points[["x", "y", "z"]].to_numpy()
        near = xyz @ towards > 0
        if kind == "flow":
            back, front = xyz.copy(), xyz.copy()
            back[near], front[~near] = np.nan, np.nan
            axes.plot(*back.T, color="#cccccc", linewidth=0.7, zorder=1)
            axes.plot(*front.T, color="#555555", linewidth=0.9, zorder=2)
            continue
        color, marker = STABILITY[kind]
        look = {"marker": marker, "markersize": 10, "color": color, "alpha": 1.0 if near[0] else 0.3}
        axes.plot(*xyz.T, linestyle="", markeredgecolor="white", zorder=3, **look)
        axes.text(
            *(1.28 * xyz[0]), f"{'+' if '+' in name else '−'}e{name[-1]}", ha="center", va="center", zorder=4
        )
    handles = []
    for kind, (color, marker) in STABILITY.items():
        mine = {name: row for name, row in rates.items() if row["kind"] == kind}
        if mine:
            numbers = sorted({name[-1] for name in mine})
            rate = max(row["z"] for row in mine.values())
            label = f"{kind} direction: axis {' and '.join(numbers)}, growth rate {abs(rate):.3g}"
            handles.append(
                Line2D([], [], linestyle="", marker=marker, color=color, markersize=9, label=label)
            )
    handles.append(Line2D([], [], color="#555555", label="flow of M/‖M‖ in damped time (grey: far side)"))
    figure.legend(handles=handles, loc="outside lower center", ncols=1)
    momentum_space(axes, "u")
    residual = max(row["y"] for row in rates.values())
    figure.suptitle(
        f"directions u = M/‖M‖ (figure 5, corrected): relative equilibria;\n"
        f"no equilibria, since ‖M'‖ = γ‖M‖ = {residual:.2g} on every axis of the unit sphere"
    )
    return figure


@drawn
def paper_7(rows: pd.DataFrame) -> Figure:
    """Energy along time, its distance from an exponential, and convergence."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(15, 4.8), layout="constrained")
    looks = {
        "truth": {"color": "#bbbbbb", "linewidth": 4},
        "law": {"color": ORANGE, "linestyle": ":", "linewidth": 1.6},
    }
    for panel, axes in (("energy", left), ("ratio", middle)):
        order = {"truth": 0, "law": 1, "method": 2}
        for name, kind, points in sorted(curves(rows, panel), key=lambda item: order[item[1]]):
            if kind == "method":
                first = name != "rk4"
                every = slice(0 if first else 1, None, 2)
                look = {**style(name), "linestyle": ""}
                axes.plot(points["x"].iloc[every], points["y"].iloc[every], label=name, **look)
            else:
                label = name.replace("e^{-γt}", "$e^{-γt}$")
                axes.plot(points["x"], points["y"], label=label, **looks[kind])
    middle.axhline(0, **looks["law"], label="H0(0) $e^{-γt}$")
    left.set(yscale="log", xlabel="t", ylabel="H0", title="energy at h = 0.01")
    middle.set(xlabel="t", ylabel="H0 / (H0(0) $e^{-γt}$) − 1", title="it is no exponential")
    left.legend()
    middle.legend(loc="lower center", ncols=2)
    middle.set_ylim(bottom=-0.075)
    for name, _, points in sorted(
        curves(rows, "convergence"), key=lambda item: item[2]["y"].iloc[0], reverse=True
    ):
        look = style(name)
        if name == "contact-strang":
            look |= {"markersize": 9, "markerfacecolor": "none", "linewidth": 0}
        right.plot(points["x"], points["y"], label=f"{name}: order {points['z'].iloc[0]:.2f}", **look)
    right.set(
        xscale="log",
        yscale="log",
        xlabel="step size h",
        ylabel="max |H0 − H0*| over [0, T]",
        title="convergence",
    )
    right.legend(loc="lower right")
    figure.suptitle("2-DOF particle, γ = 0.1, T = 20 (figure 7, corrected): orders 1, 2 and 4, not 2 and 2")
    return figure


@drawn
def paper_8(rows: pd.DataFrame) -> Figure:
    """The two limits of the splitting integrator."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(15, 4.8), layout="constrained")
    looks = {
        "conservative": {"color": BLUE, "linewidth": 0.8},
        "dissipative": {"color": ORANGE, "linewidth": 1.3},
    }
    for panel, axes in (("phase", left), ("energy", middle), ("bounded", right)):
        for name, kind, points in curves(rows, panel):
            axes.plot(points["x"], points["y"], label=name, **looks[kind])
    left.set(xlabel="q₁", ylabel="p₁", aspect="equal", title="phase portrait: the γ = 0 orbit does not close")
    left.legend(loc="upper right", ncols=2)
    left.set_ylim(top=1.45)
    middle.set(xlabel="t", ylabel="H0", title="energy")
    middle.legend(loc="center right")
    right.set(xlabel="t", ylabel="H0 / H0(0) − 1", title="energy error at γ = 0: bounded")
    right.ticklabel_format(axis="y", style="sci", scilimits=(0, 0))
    figure.suptitle("contact-printed on the 2-DOF particle, h = 0.01 (figure 8, corrected)")
    return figure


@drawn
def paper_stability(rows: pd.DataFrame) -> Figure:
    """Growth rates of anisotropically damped rotations, with the corrected criterion.

    One row for diagonal D, one for D with a full transverse block; a column for each axis in ker D.
    """
    figure, grid = plt.subplots(2, 3, figsize=(14.5, 9.4), layout="constrained")
    sample = rows[rows["curve"] == "growth rate"]
    limit = 2 * float(sample["z"].max())  # so that growth is seen; faster decay is drawn in one colour
    norm = TwoSlopeNorm(0.0, -limit, limit)
    places = ("smallest inertia", "intermediate", "largest inertia")
    for line_of, slice_ in zip(grid, ("diagonal", "full"), strict=True):
        for axis, (axes, place) in enumerate(zip(line_of, places, strict=True)):
            panel = f"axis {axis + 1}, {slice_}"
            points = sample[sample["panel"] == panel].pivot(index="y", columns="x", values="z")
            image = axes.pcolormesh(
                points.columns, points.index, points.to_numpy(), cmap="RdBu_r", norm=norm, shading="nearest"
            )
            borders = [line for _, kind, line in curves(rows, panel) if kind == "criterion"]
            for line in borders:
                axes.plot(line["x"], line["y"], color=BLACK, linestyle="--", linewidth=1.5, zorder=3)
            if borders:
                axes.contour(
                    points.columns, points.index, points.to_numpy(), [0.0], colors="#DDAA33", linewidths=4
                )
                axes.plot([], [], color="#DDAA33", linewidth=4, label="growth rate 0, computed")
                axes.plot([], [], color=BLACK, linestyle="--", label="criterion det = 0")
                axes.legend(loc="upper right" if slice_ == "diagonal" else "upper left", frameon=True)
            j, k = (i for i in "123" if i != str(axis + 1))
            label = {
                "diagonal": (f"d{j}{j}", f"d{k}{k}"),
                "full": (f"d{j}{j} = d{k}{k}", f"d{j}{k}"),
            }[slice_]
            axes.set(xlabel=label[0], ylabel=label[1], title=f"axis {axis + 1} ({place}), {slice_} D")
            axes.grid(visible=False)
    figure.colorbar(
        image, ax=list(grid.flat), label="largest transverse growth rate (red: unstable)", shrink=0.9
    )
    figure.suptitle(
        "steady rotations about an axis in ker D, I = (1, 2, 3), M* = +e_i.  Above: diagonal D.  Below: the slice of "
        "full D ≥ 0\nwith equal rates, |off-diagonal| ≤ rate.  Not shown: unequal rates with an off-diagonal, other "
        "I, other M*"
    )
    return figure
