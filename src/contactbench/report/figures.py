"""The figures, drawn from the tables alone.  One colour and marker per method, the same everywhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

# Okabe–Ito and Tol's vibrant set: distinguishable with the common colour-vision deficiencies, and
# never by colour alone (each method has its own marker; ours are filled, peers hollow).
STYLES = {
    "contact-printed": ("#882255", "X"),
    "contact-abc": ("#0077BB", "s"),
    "contact-strang": ("#33BBEE", "o"),
    "contact-bm4": ("#004488", "^"),
    "contact-bm6": ("#004488", "v"),
    "contact-rkn4": ("#228833", "D"),
    "contact-rkn6": ("#4477AA", "*"),
    "contact-rkn8": ("#CC6677", "p"),
    "contact-o8": ("#AA3377", "P"),
    "contact-adaptive": ("#BB5566", "8"),
    "rk4": ("#000000", "x"),
    "herglotz1": ("#661100", "d"),
    "herglotz2": ("#6699CC", "H"),
    "scipy-dop853": ("#CC3311", "^"),
    "scipy-radau": ("#EE7733", "v"),
    "cvode-adams": ("#AA4499", "<"),
    "cvode-bdf": ("#DDAA33", ">"),
    "diffrax-tsit5": ("#009988", "D"),
    "diffrax-dopri8": ("#117733", "P"),
    "diffrax-kvaerno5": ("#999933", "h"),
    "heyoka-taylor": ("#EE3377", "*"),
}
# for methods that are not ours to know: a plug-in's, in the order they are met
SPARE = [("#332288", "p"), ("#888888", "8"), ("#44AA99", "p"), ("#A6761D", "8"), ("#D95F82", "p")]
_met: dict[str, tuple[str, str]] = {}
TRACKS = {
    "compiled (jax, llvm)": ("jax", "llvm"),
    "Python callbacks (python, c+python)": ("python", "c+python"),
}
ROUND_OFF = 2.2e-16

plt.rcParams.update(
    {
        "figure.dpi": 110,
        "savefig.bbox": "tight",
        "font.size": 10,
        "axes.grid": True,
        "grid.color": "#e6e6e6",
        "grid.linewidth": 0.6,
        "axes.axisbelow": True,
        "legend.frameon": False,
        "svg.hashsalt": "contactbench",
        "svg.fonttype": "none",
    }
)


def style(method: str) -> dict[str, Any]:
    """Colour and marker of a method; a method unknown here gets the next spare ones."""
    if method not in STYLES:
        _met.setdefault(method, SPARE[len(_met) % len(SPARE)])
    color, marker = STYLES.get(method) or _met[method]
    face = color if method.startswith("contact-") or method not in STYLES else "white"
    return {"color": color, "marker": marker, "markerfacecolor": face, "markersize": 5.5, "linewidth": 1.3}


def ordered(frame: pd.DataFrame) -> list[str]:
    """The methods of a table, in the order of its rows."""
    return list(dict.fromkeys(frame["method"]))


def formula(definition: str) -> str:
    """A definition without the conditions that follow its semicolon: short enough for an axis."""
    return definition.partition(";")[0]


def shared_legend(figure: Figure, methods: list[str], columns: int = 4) -> None:
    """One legend below all panels."""
    handles = [Line2D([], [], label=name, **style(name)) for name in methods]
    figure.legend(handles=handles, loc="outside lower center", ncols=columns)


def work_precision(frame: pd.DataFrame, scene: str, labels: dict[str, str]) -> Figure:
    """Cost against error for one scene: compiled time, callback time, evaluations."""
    rows = frame[(frame["scene"] == scene) & (frame["status"] == "ok")]
    rows = rows[rows["track"].isin(["fixed", "adaptive"])]
    figure, axes = plt.subplots(1, 3, figsize=(13.5, 4.6), layout="constrained")
    error = rows["solution_error"].clip(lower=ROUND_OFF / 4)
    rows = rows.assign(error=error)
    for panel, (title, engines) in zip(axes, TRACKS.items(), strict=False):
        track = rows[rows["engine"].isin(engines)]
        for method in ordered(track):
            for _, line in track[track["method"] == method].groupby("engine", sort=False):
                panel.plot(line["error"], line["time_median_s"] * 1e3, **style(method))
        panel.set(title=title, ylabel="median time per solve, ms")
    for method in ordered(rows):
        mine = rows[rows["method"] == method]
        line = mine[mine["engine"] == mine["engine"].iloc[0]]
        axes[2].plot(line["error"], line["rhs_equivalents"], **style(method))
    axes[2].set(title="evaluations (engine does not matter)", ylabel="right-hand sides or equivalents")
    for panel in axes:
        panel.set(xscale="log", yscale="log", xlabel=labels["solution_error"].partition(" over ")[0])
        panel.invert_xaxis()
    figure.suptitle(f"{scene}: cost against error (more accurate to the right, cheaper below)")
    shared_legend(figure, ordered(rows), 6)
    return figure


def convergence(frame: pd.DataFrame, labels: dict[str, str]) -> Figure:
    """Error against step size, a panel per scene, with slopes 1, 2 and 4 for the eye."""
    scenes = list(dict.fromkeys(frame["scene"]))
    rows = -(-len(scenes) // 3)
    figure, grid = plt.subplots(rows, 3, figsize=(13.5, 4.0 * rows), layout="constrained", squeeze=False)
    for panel in grid.flat[len(scenes) :]:
        panel.set_axis_off()
    for panel, scene in zip(grid.flat, scenes, strict=False):
        part = frame[(frame["scene"] == scene) & (frame["status"] == "ok")]
        for method in ordered(part):
            line = part[part["method"] == method]
            panel.plot(line["step"], line["solution_error"], **style(method))
            order = line["order"].iloc[0]
            if np.isfinite(order):
                last = line.iloc[-1]
                panel.annotate(
                    f"{order:.2f}", (last["step"], last["solution_error"]), fontsize=8,
                    xytext=(-4, 0), textcoords="offset points", ha="right", va="center",
                    color=style(method)["color"],
                )  # fmt: skip
        panel.set(xscale="log", yscale="log", title=scene, xlabel="step size h")
        panel.margins(x=0.16)
        panel.set_ylabel(labels["solution_error"])
    figure.suptitle("error against step size; the number at each curve is its fitted order")
    shared_legend(figure, ordered(frame), 4)
    return figure


def laws_along_time(frame: pd.DataFrame, scene: str, labels: dict[str, str]) -> Figure:
    """The deviations from the H0, H, J and contact laws along time."""
    rows = frame[(frame["scene"] == scene) & (frame["status"] == "ok")]
    panels = {
        "energy_deviation": "energy H0",
        "hamiltonian_deviation": "contact Hamiltonian H",
        "momentum_deviation": "momentum map J",
        "contact_deviation": "contact form η",
    }
    panels = {column: title for column, title in panels.items() if rows[column].notna().any()}
    figure, axes = plt.subplots(1, len(panels), figsize=(4.2 * len(panels), 4.4), layout="constrained")
    for panel, (column, title) in zip(np.atleast_1d(axes), panels.items(), strict=True):
        for method in ordered(rows):
            line = rows[rows["method"] == method]
            panel.plot(line["t"], line[column].clip(lower=ROUND_OFF / 4), **style(method), markevery=4)
        panel.axhspan(ROUND_OFF / 4, 1e-12, color="#f0f4ff", zorder=0)
        panel.set(yscale="log", title=title, xlabel="t", ylabel=labels[column])
    settings = ", ".join(dict.fromkeys(rows["setting"]))
    figure.suptitle(f"{scene}: deviation from each law along time ({settings}; shaded: round-off)")
    shared_legend(figure, ordered(rows), max(3, 2 * len(panels) - 1))
    return figure


def structure(frame: pd.DataFrame, labels: dict[str, str]) -> Figure:
    """Contact drift and momentum law against solution error: who keeps structure when inaccurate."""
    figure, axes = plt.subplots(1, 2, figsize=(12, 4.8), layout="constrained")
    rows = frame[frame["status"] == "ok"]
    panels: list[tuple[Axes, str, str]] = [
        (axes[0], "contact_drift", "central"),
        (axes[1], "momentum_law", "rigid_body"),
    ]
    for panel, column, scene in panels:
        part = rows[(rows["scene"] == scene) & rows[column].notna()]
        for method in ordered(part):
            line = part[part["method"] == method]
            panel.plot(line["solution_error"], line[column].clip(lower=ROUND_OFF / 4), **style(method))
        panel.axhspan(ROUND_OFF / 4, 1e-12, color="#f0f4ff", zorder=0)
        panel.set(xscale="log", yscale="log", title=scene)
        panel.set(xlabel=labels["solution_error"], ylabel=f"{column}: {formula(labels[column])}")
        panel.invert_xaxis()
    axes[0].text(0.02, 0.03, "round-off", transform=axes[0].transAxes, color="#5566aa")
    figure.suptitle("structure against accuracy, same runs: a structural law does not care for the error")
    shared_legend(figure, ordered(rows), 6)
    return figure


def ensemble(frame: pd.DataFrame, labels: dict[str, str]) -> Figure:
    """Time per trajectory against error; throughput against trajectories and against cores."""
    figure, axes = plt.subplots(1, 3, figsize=(13.5, 4.4), layout="constrained")
    rows = frame[frame["status"] == "ok"]
    rows = rows.assign(each=rows["time_median_s"] / rows["trajectories"])
    rows = rows.assign(shape=rows["setting"].str.rpartition(" ")[0])
    part = rows[rows["track"] == "error"]
    for (method, shape), line in part.groupby(["method", "shape"], sort=False):
        dashes = "--" if shape == "vmap" else "-"
        axes[0].plot(line["solution_error"], line["each"] * 1e6, **style(method), linestyle=dashes)
    axes[0].set(
        title="one core (dashed: every trajectory its own steps)", ylabel="time per trajectory, µs",
        xlabel=labels["solution_error"].partition(" over ")[0], xscale="log", yscale="log",
    )  # fmt: skip
    axes[0].invert_xaxis()
    for panel, track in zip(axes[1:], ("size", "cores"), strict=True):
        column = "trajectories" if track == "size" else "cores"
        part = rows[rows["track"] == track].sort_values(column)
        for method in ordered(part):
            line = part[part["method"] == method]
            throughput = (line["evaluations"] / line["each"]).astype(float)
            panel.plot(line[column].astype(float), throughput, **style(method))
            if track == "cores":
                ideal = line["cores"].astype(float) * throughput.iloc[0] / line["cores"].iloc[0]
                panel.plot(line["cores"].astype(float), ideal, color="#999999", linestyle=":", zorder=0)
        panel.set(xscale="log", xlabel=column, ylabel="gradients × trajectories per second")
        panel.set_ylim(bottom=0)
    axes[1].set(title="number of trajectories")
    axes[2].set(title="cores (dotted: proportional)", xscale="linear")
    axes[2].xaxis.get_major_locator().set_params(integer=True)
    figure.suptitle("ensembles of the particle")
    shared_legend(figure, [method for method in ordered(rows) if method != "limit-c"], 6)
    return figure


def panels(count: int, columns: int, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    """A figure of so many panels in rows of `columns`, and its panels."""
    rows = -(-count // columns)
    shape = (columns * size[0], rows * size[1])
    figure, grid = plt.subplots(rows, columns, figsize=shape, layout="constrained", squeeze=False)
    for spare in grid.flat[count:]:
        spare.set_axis_off()
    return figure, list(grid.flat[:count])


def hard_scenes(frame: pd.DataFrame, labels: dict[str, str]) -> Figure:
    """Error against evaluations on every hard scene that has runs which ended well."""
    rows = frame[frame["status"] == "ok"]
    scenes = list(dict.fromkeys(rows["scene"]))
    figure, grid = panels(len(scenes), 4, (4.0, 3.4))
    for panel, scene in zip(grid, scenes, strict=True):
        part = rows[rows["scene"] == scene]
        for method in ordered(part):
            line = part[part["method"] == method].sort_values("rhs_equivalents")
            panel.plot(line["rhs_equivalents"], line["solution_error"].clip(1e-16, 1e6), **style(method))
        panel.set(xscale="log", yscale="log", title=scene, xlabel="evaluations", ylabel="solution error")
    figure.suptitle(f"hard scenes: {labels['solution_error']} against evaluations, runs that ended ok")
    shared_legend(figure, ordered(rows), 6)
    return figure


def stability_map(frame: pd.DataFrame) -> Figure:
    """Largest bounded step over damping, measured and by theory, and per evaluation."""
    figure, axes = plt.subplots(1, 2, figsize=(12.5, 5.0), layout="constrained")
    rows = frame[frame["gamma"] > 0].assign(
        ratio=lambda f: f["gamma"] / f["omega"], scaled=lambda f: f["limit"] * f["omega"],
        predicted=lambda f: f["theory"] * f["omega"], each=lambda f: f["per_evaluation"] * f["omega"],
    )  # fmt: skip
    for method in ordered(rows):
        line = rows[rows["method"] == method].sort_values("ratio").drop_duplicates("ratio")
        look = style(method)
        axes[0].plot(line["ratio"], line["scaled"], **look)
        axes[0].plot(line["ratio"], line["predicted"], "--", color="#444444", linewidth=0.9)
        axes[1].plot(line["ratio"], line["each"], **look)
    axes[0].plot([], [], "--", color="#444444", linewidth=0.9, label="theory")
    axes[0].legend(loc="lower left")
    for panel, ylabel in zip(axes, ("ω × largest step", "ω × largest step per evaluation"), strict=True):
        panel.set(xscale="log", yscale="log", xlabel="γ/ω", ylabel=ylabel)
    figure.suptitle(
        "largest step with a bounded orbit of q'' + γq' + ω²q = 0 (curves that end: no limit found)"
    )
    shared_legend(figure, ordered(rows), 6)
    return figure


def one_step(frame: pd.DataFrame) -> Figure:
    """Spectral radius of the one-step map over the true one: below 1 damping, above 1 antidamping."""
    gammas = [gamma for gamma in (0.0, 0.1, 1.0, 10.0, 50.0) if gamma in set(frame["gamma"])]
    figure, grid = panels(len(gammas), 3, (4.6, 3.8))
    for panel, gamma in zip(grid, gammas, strict=True):
        part = frame[frame["gamma"] == gamma]
        for method in ordered(part):
            line = part[part["method"] == method].sort_values("step")
            panel.plot(line["step"], (line["radius"]).clip(1e-3, 5), **style(method), markevery=8)
        truth = part.drop_duplicates("step").sort_values("step")
        panel.plot(truth["step"], truth["true_radius"], "--", color="#444444", linewidth=1.6)
        panel.axhline(1.0, color="#bbbbbb", linewidth=0.8)
        panel.set(
            xscale="log",
            title=f"γ = {gamma:g}",
            xlabel="step size h",
            ylabel="largest |eigenvalue|",
            ylim=(0, 2),
        )
    figure.suptitle(
        "one-step map of the oscillator; dashed: the exact flow (below: numerical damping, above: antidamping)"
    )
    shared_legend(figure, ordered(frame), 6)
    return figure


def strong_damping(frame: pd.DataFrame, labels: dict[str, str]) -> Figure:
    """Error against the damping between two evaluations."""
    gammas = sorted(frame["gamma"].unique())
    figure, grid = panels(len(gammas), 2, (6.2, 4.0))
    for panel, gamma in zip(grid, gammas, strict=True):
        part = frame[frame["gamma"] == gamma]
        for method in ordered(part):
            line = part[part["method"] == method].sort_values("damping_per_evaluation")
            error = line["error"].where(np.isfinite(line["error"]))
            panel.plot(line["damping_per_evaluation"], error.where(error < 1e4), **style(method), markevery=4)
        panel.set(
            xscale="log", yscale="log", title=f"γ = {gamma:g}", xlabel="γh per evaluation", ylim=(1e-16, 1e2)
        )
        panel.set_ylabel("relative error")
    figure.suptitle(f"equal cost under strong damping: {labels['error']}")
    shared_legend(figure, ordered(frame), 6)
    return figure


def figures(
    tables: dict[str, pd.DataFrame], labels: Callable[[str], dict[str, str]]
) -> Iterator[tuple[str, Figure]]:
    """Every figure the tables allow, with its file name."""
    work, laws, time = tables["work_precision"], tables["laws"], tables["laws_time"]
    for scene in dict.fromkeys(work["scene"]):
        if (work[work["scene"] == scene]["status"] == "ok").any():
            yield f"work_precision_{scene}", work_precision(work, scene, labels("work_precision"))
    if len(tables["convergence"]):
        yield "convergence", convergence(tables["convergence"], labels("convergence"))
    if (tables["ensemble"]["status"] == "ok").any():
        yield "ensemble", ensemble(tables["ensemble"], labels("ensemble"))
    if len(laws):
        yield "structure", structure(laws, labels("laws"))
    if (tables["stability"]["status"] == "ok").any():
        yield "hard_scenes", hard_scenes(tables["stability"], labels("stability"))
    if len(tables["stability_limits"]):
        yield "stability_map", stability_map(tables["stability_limits"])
    if len(tables["one_step"]):
        yield "one_step", one_step(tables["one_step"])
    if len(tables["strong_damping"]):
        yield "strong_damping", strong_damping(tables["strong_damping"], labels("strong_damping"))
    for scene in dict.fromkeys(time[time["status"] == "ok"]["scene"]):
        yield f"laws_{scene}", laws_along_time(time, scene, labels("laws_time"))


def save(figure: Figure, folder: Path, name: str) -> None:
    """Write SVG and PNG without timestamps, so that equal tables give equal files."""
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / f"{name}.svg", metadata={"Date": None})
    figure.savefig(folder / f"{name}.png", metadata={"Software": None})
    plt.close(figure)
