"""``contactbench solve``: one scene, one method, once."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

from contactbench.cli.parsing import PICTURES, Command, add_files, add_parameters, assignments, writable


def solve(arguments: argparse.Namespace) -> int:
    """Solve a scene once and print where it ended."""
    writable("--plot", arguments.plot, PICTURES)
    writable("--out", arguments.out)
    import contactbench as cb

    scene = cb.SCENES[arguments.scene].with_(**assignments(arguments.set))
    if arguments.t_end is not None:
        scene = scene.with_(t_end=arguments.t_end)
    options = {k: getattr(arguments, k) for k in ("step", "rtol", "engine", "max_steps")}
    options = {k: v for k, v in options.items() if v is not None}
    if not (arguments.laws or arguments.plot or arguments.out):  # only the end matters
        options["save_at"] = [scene.t_end]
    solution = cb.solve(scene, arguments.method, **options)
    if arguments.out:
        solution.to_frame().to_csv(arguments.out, index=False, lineterminator="\n")
    if arguments.plot:
        plot(solution, arguments.plot)
    run = summary(solution)
    laws = solution.laws() if arguments.laws else None
    if arguments.json:
        print(json.dumps(run if laws is None else run | {"laws": deviations(laws)}, allow_nan=False))
    else:
        print("\n".join(f"{key:8} {value}" for key, value in run.items() if value not in (None, "")))
        for law in () if laws is None else laws.itertuples():
            bound = "≤ " if law.upper_bound else ""
            print(f"{law.Index:26} {bound}{law.deviation:.1e}  {law.note or law.definition}")
    return 0 if solution.ok else 1


def deviations(laws: Any) -> dict[str, float | None]:
    """Return deviations by name; null for what is not known."""
    return {name: value if math.isfinite(value) else None for name, value in laws["deviation"].items()}


def plot(solution: Any, path: Path) -> None:
    """Draw the motion and the energies against time."""
    from contactbench.report.draw import render
    from contactbench.report.drawing import Axis, Curve, Figure, Panel

    t, scene, states = tuple(solution.t.tolist()), solution.scene, solution.states()
    groups: dict[str, dict[str, Any]] = {}
    for name, values in zip(solution.labels, solution.y.T, strict=True):
        groups.setdefault(name[0], {})[name] = values
    groups["energies"] = {"H0": scene.energy(states)}
    if scene.is_contact and states.s is not None:
        groups["energies"]["H"] = scene.hamiltonian(states)

    def curve(i: int, name: str, values: Any) -> Curve:
        return Curve(t, tuple(values.tolist()), label=name, role=f"shade {i % 5}", markers=False)

    panels = tuple(
        Panel(
            "",
            Axis("t"),
            Axis(", ".join(group)),
            tuple(curve(i, *each) for i, each in enumerate(group.items())),
        )
        for group in groups.values()
    )
    title = f"{scene.name}: {solution.method}, {solution.setting}"
    render(Figure("run", title, panels, legend="each", across=2)).savefig(path)


def summary(solution: Any) -> dict[str, Any]:
    """Return final state, energies, momentum, counts and status as plain JSON values; null for not reached."""
    scene, out = solution.scene, {}
    if solution.ok:
        state = scene.unpack(tuple(solution.y[-1].tolist()), solution.carry)
        momentum = scene.momentum(state)
        out = {
            "state": dict(zip(solution.labels, solution.y[-1].tolist(), strict=True)),
            "H0": scene.energy(state),
            "H": scene.hamiltonian(state) if scene.is_contact else None,
            "J": None if momentum is None else list(momentum),
        }
    run = {name: getattr(solution, name) for name in ("method", "engine", "setting", "status", "message")}
    ended = {"status": str(solution.status), "t": solution.end_time}
    return {"scene": scene.name, **run, **ended, **out, "counts": solution.counts._asdict()}


EXAMPLES = """examples:
  contactbench solve particle contact-strang --step 0.01
  contactbench solve particle contact-rkn6 --rtol 1e-8           the step chosen from pilots
  contactbench solve particle cvode-bdf --rtol 1e-8 --t-end 100
  contactbench solve central contact-strang --step 0.01 --laws --plot run.svg --out run.csv
  contactbench solve particle rk4 --step 0.01 --set gamma=0.3 --set q=[1,0.5] --json | jq .H0

Exit status: 0 the run ended ok; 1 it did not (the status says how); 2 bad input."""


def add(command: Command) -> None:
    """Add the command and its options."""
    one = command("solve", solve, "solve one scene with one method and print where it ended", EXAMPLES)
    one.add_argument("scene", help="its name (contactbench list scenes)")
    one.add_argument("method", help="its name (contactbench list methods)")
    add_parameters(one)
    one.add_argument("--step", type=float, help="step size (fixed-step methods)")
    one.add_argument("--rtol", type=float, help="tolerance (adaptive methods; others choose a step from it)")
    one.add_argument("--t-end", type=float, help="end time")
    one.add_argument("--engine", help="numba, jax or python, where a method has several")
    one.add_argument("--max-steps", type=int, help="step budget")
    one.add_argument("--laws", action="store_true", help="how far the run is from every law of the scene")
    add_files(one, plot="motion and energies over time (.svg, .png, .pdf)", out="the saved states as CSV")
    one.add_argument("--json", action="store_true", help="print one JSON object")
