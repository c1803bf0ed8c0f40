"""The commands ``contactbench solve | compare | check``."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from contactbench.cli.parsing import assignments, print_json, writable
from contactbench.cli.printing import print_item
from contactbench.errors import BadInput, unknown_name
from contactbench.files import replacing

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from contactbench.scene import Scene
    from contactbench.solution import Solution

#: endings of plots
PICTURES = (".svg", ".png", ".pdf")
#: most components printed as a whole; number printed of a larger state
PRINTED, SOME = 64, 4


def write_csv(frame: pd.DataFrame, path: Path) -> None:
    with replacing(path) as file:
        frame.to_csv(file, index=False, lineterminator="\n")


def write_picture(figure: Figure, path: Path) -> None:
    with replacing(path, mode="wb") as file:
        figure.savefig(file, format=path.suffix[1:].lower())


def scene_of(arguments: argparse.Namespace) -> Scene:
    """Return the scene NAME, or NAME from FILE for FILE:NAME, with the changes of --set."""
    from contactbench.plugins import load_file
    from contactbench.scenes import SCENES

    path, _, name = arguments.scene.rpartition(":")
    if not path and name.endswith(".py"):
        raise BadInput(f"scene {name}: add the name of a scene that the file registers, as in {name}:NAME")
    if path:
        load_file(Path(path))
    scene: Scene = SCENES[name].with_(**assignments(arguments.set))
    return scene


def solve(arguments: argparse.Namespace) -> int:
    writable("--plot", arguments.plot, PICTURES)
    writable("--out", arguments.out)
    import contactbench as cb

    scene = scene_of(arguments)
    if arguments.t_end is not None:
        scene = scene.with_(t_end=arguments.t_end)
    options = {name: getattr(arguments, name) for name in ("step", "rtol", "engine", "max_steps")}
    options = {name: value for name, value in options.items() if value is not None}
    if arguments.carry is not None:
        options["carry"] = tuple(filter(None, arguments.carry.split(",")))
    if not (arguments.laws or arguments.plot or arguments.out):  # only the end matters
        from contactbench.scene.base import Elapsed

        options["save_at"] = Elapsed([scene.t_end])
    solution = cb.solve(scene, arguments.method, **options)
    if arguments.out:
        write_csv(solution.to_frame(), arguments.out)
    if arguments.plot:
        write_picture(solution.plot(), arguments.plot)
    run = summary(solution)
    laws = solution.laws() if arguments.laws else None
    if arguments.json:
        if laws is not None:
            deviations = laws["deviation"].items()
            run["laws"] = {name: value if math.isfinite(value) else None for name, value in deviations}
        print_json(run, arguments)
    else:
        state = run.get("state")
        if isinstance(state, dict) and len(state) > PRINTED:
            some = ", ".join(f"{name!r}: {value!r}" for name, value in list(state.items())[:SOME])
            run["state"] = f"{some}, … {len(state)} numbers; all of them with --json or --out"
        run["scene"] = f"{scene.name}{', undamped' * scene.is_undamped}"
        for key, value in run.items():
            if value not in (None, ""):
                print_item(f"{key:8} ", value, 9)
        for law in () if laws is None else laws.itertuples():
            value = f"{'≤ ' if law.upper_bound else ''}{law.deviation:.1e}"
            print_item(f"{law.Index:26} {value}  ", law.note or law.definition, 29 + len(value))
    return 0 if solution.ok else 1


def summary(solution: Solution) -> dict[str, object]:
    scene = solution.scene
    out: dict[str, object] = {}
    if solution.ok:
        y = solution.y[-1].tolist()
        state = scene.unpack(scene.entries(solution.y[-1]), solution.carry)
        momentum = scene.momentum_at(state)
        out = {
            "state": dict(zip(solution.labels, y, strict=True)),
            "H0": float(scene.energy(state)) if scene.has_energy else None,
            "H": float(scene.hamiltonian_at(state)) if scene.is_contact and state.s is not None else None,
            "J": None if momentum is None else list(map(float, momentum)),
        }
    run = {name: getattr(solution, name) for name in ("method", "engine", "setting", "status", "message")}
    ended = {"status": str(solution.status), "t": solution.end_time + solution.start_time}
    return {"scene": scene.name, **run, **ended, **out, "counts": solution.counts._asdict()}


def compare(arguments: argparse.Namespace) -> int:
    for option, kinds in (("plot", PICTURES), ("csv", ())):
        writable(f"--{option}", getattr(arguments, option), kinds)
    one_core()
    import contactbench as cb
    from contactbench.study import race

    scene = scene_of(arguments)
    methods = arguments.method + arguments.more or ("all" if arguments.all else None)
    budget = None if arguments.budget is None else duration(arguments.budget)
    asked = {"progress": not arguments.quiet, "saved": arguments.saved}
    frame = cb.compare(scene, methods, numbers(arguments.error), budget, **asked)
    if arguments.csv:
        write_csv(frame, arguments.csv)
    if arguments.plot and (figure := race.figure(frame)) is not None:
        from contactbench.report.draw import render

        write_picture(render(figure), arguments.plot)
    if arguments.json:
        known = {name: value for name, value in frame.attrs.items() if name != "runs"}
        rows = json.loads(frame.to_json(orient="records", double_precision=15))
        print_json({**known, "rows": rows}, arguments)
    else:
        options = [f"--plugin {file}" for file in arguments.plugin] + [
            f"--set {each}" for each in arguments.set
        ]
        print(race.text(frame, arguments.all, " ".join([arguments.scene, *options])))
    return 130 if frame.attrs["interrupted"] else int(not frame["time_s"].notna().any())


def numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise BadInput(f"--error {text}: must be errors separated by commas, as in 1e-3,1e-6") from None


def duration(text: str) -> float:
    units = {"s": 1.0, "m": 60.0}
    number, unit = (text[:-1], units[text[-1]]) if text[-1:] in units else (text, 1.0)
    try:
        return float(number) * unit
    except ValueError:
        raise BadInput(f"--budget {text}: must be a time, as in 60s or 2m") from None


def one_core() -> None:
    """Bind the process to one core before JAX starts threads, which cost more than they save on small programs."""
    if hasattr(os, "sched_setaffinity") and "jax" not in sys.modules:
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


ROW = "{:>4}  {:9} {:24} "


def check(arguments: argparse.Namespace) -> int:
    import contactbench as cb
    from contactbench.testing import Violation, method_findings, scene_findings

    name, engines = arguments.name, arguments.engine or None
    if name in cb.METHODS:
        findings = method_findings(cb.METHODS[name], engines)
    elif name in cb.SCENES:
        if engines:
            raise BadInput(f"--engine {engines[0]}: {name} is a scene, which has none")
        findings = scene_findings(cb.SCENES[name])
    else:
        raise unknown_name("method or scene", name, [*cb.METHODS, *cb.SCENES])
    print(ROW.format("rule", "engine", "scene") + "result")
    try:
        for *where, not_here in findings:
            label = ROW.format(*where)
            print_item(label, f"does not apply: {not_here}" if not_here else "kept", len(label))
            sys.stdout.flush()
    except Violation as broken:
        print(f"contactbench: {broken}", file=sys.stderr)
        return 1
    for engine in cb.METHODS[name].engines if name in cb.METHODS and not engines else ():
        if lacks := cb.METHODS[name].lacks(engine):
            print(f"left out: engine {engine}, {lacks}")
    return 0
