"""Computes the frozen references, and checks them.

    python references/generate.py [--check] [SCENE ...]

Every standard scene, and of the others those that have no closed form, on t_k = t_end·k/200 with all their
optional fields, in four steps:
heyoka's Taylor series at two precisions; the digits that agree; Gragg–Bulirsch–Stoer extrapolation
in mpmath, which shares nothing with heyoka but the scene; closed forms and invariants where there
are any.  A digit is stored only if all of them confirm it.  No method under test takes part.
Those others also get their condition number, and their time of blow-up if they have one.

--check computes everything afresh, compares it with the stored digits, prints one line per scene
and exits 1 on any difference.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import io
import json
import os
import platform
import sys
import time
from decimal import Decimal
from pathlib import Path
from typing import Any

import heyoka
import mpmath
import numpy as np

from contactbench import truth
from contactbench.scene import RigidBody, Scene, dot
from contactbench.scenes import SCENES
from contactbench.scenes.contact_systems import CONTACT_SYSTEMS
from contactbench.scenes.driven import DRIVEN
from contactbench.scenes.hard import HARD
from contactbench.scenes.standard import STANDARD, damped_oscillator

FOLDER = Path(__file__).resolve().parent
BITS = (200, 260)
INTERVALS = 200
EXTRAPOLATION_DIGITS = 45
STORED = 40  #: at most; fewer if fewer agree
NEEDED = 30
#: how far initial values are moved for the condition number
NUDGE = "1e-25"
FROZEN = (
    *STANDARD,
    *(scene for scene in DRIVEN if scene.exact is None),
    *CONTACT_SYSTEMS,
    *(scene for scene in HARD if scene.exact is not damped_oscillator),
)


def grid(scene: Scene) -> list[str]:
    """The grid times as exact decimal strings."""
    return [f"{(Decimal(repr(scene.t_end)) * k / INTERVALS).normalize():f}" for k in range(INTERVALS + 1)]


def print_columns(rows: truth.Rows, digits: int) -> list[list[str]]:
    """Every column to `digits` digits of its scale."""
    places = [truth.place(scale, digits) for scale in truth.scales(rows)]
    return [[truth.rounded(x, p) for x, p in zip(row, places, strict=True)] for row in rows]


def closed_form_agreement(scene: Scene, times: list[str], rows: truth.Rows) -> dict[str, int]:
    """Digits to which the computed fields agree with the closed form, by field."""
    if scene.exact is None:
        return {}
    context = truth.decimal_context(70)
    twin = truth.with_decimals(scene, context.mpf)
    states = [twin.exact(twin, context.mpf(t), context) for t in times]  # type: ignore[misc]
    agreement = {}
    for name in states[0]._fields:
        known = [getattr(state, name) for state in states]
        if known[0] is not None:
            ours = [twin.pack((getattr(twin.unpack(row, twin.carry()), name),)) for row in rows]
            agreement[name] = truth.agreeing_digits(ours, [twin.pack((x,)) for x in known], 65)
    return agreement


def invariant_agreement(scene: Scene, times: list[str], rows: truth.Rows) -> dict[str, int]:
    """Digits to which a body keeps |R| as it was at the start and, if damped isotropically, J e^{γt}."""
    if not isinstance(scene, RigidBody):
        return {}
    context = truth.decimal_context(70)
    twin = truth.with_decimals(scene, context.mpf)
    states = [twin.unpack([context.mpf(x) for x in row], twin.carry()) for row in rows]
    lengths = [[dot(x.R, x.R)] for x in states]
    agreement = {"|R|² = |R(0)|²": truth.agreeing_digits(lengths, lengths[:1] * len(rows), 65)}
    if scene.isotropic:
        grown = [
            [c * context.exp(twin.gamma * context.mpf(t)) for c in twin.momentum_at(x)]
            for t, x in zip(times, states, strict=True)
        ]
        start = twin.momentum_at(twin.initial(twin.carry()))
        # one scale for the three components of J: some of them start at nearly nothing
        size = max(map(abs, start))
        worst = max(truth.distance(row, start) for row in grown) / size
        agreement["J e^{γt} = J(0)"] = truth.agreeing_digits([[1 + worst]], [[context.mpf(1)]], 65)
    return agreement


def condition(scene: Scene, times: list[str], rows: truth.Rows) -> float:
    """max_t ‖∂x(t)/∂x(0)‖₂ by differences of step 10⁻²⁵ in 60 digits."""
    context = truth.decimal_context(70)
    start = [context.mpf(repr(x)) for x in scene.pack(scene.initial(scene.carry()))]
    step = context.mpf(NUDGE)
    columns = []
    for i in range(len(start)):
        moved = [context.nstr(x + step * (i == j), 60) for j, x in enumerate(start)]
        other = truth.taylor(scene, times, scene.carry(), BITS[1], start=moved)
        columns.append(
            [
                [float((a - b) / step) for a, b in zip(p, q, strict=True)]
                for p, q in zip(other, rows, strict=True)
            ]
        )
    return float(np.linalg.norm(np.array(columns).transpose(1, 2, 0), ord=2, axis=(1, 2)).max())


def before_blow_up(scene: Scene) -> tuple[list[str], dict[str, Any]]:
    """The grid as far as the trajectory is finite, and its time of blow-up, which both engines confirm."""
    times = grid(scene)
    low, high = (truth.taylor_blow_up(scene, bits) for bits in BITS)
    try:
        truth.extrapolation(scene, times[-1:], scene.carry(), EXTRAPOLATION_DIGITS, truth.BLOW_UP_COLLAPSE)
    except truth.BlowUp as found:
        second = found.time
    digits = min(truth.agreeing_digits([[x]], [[high]], STORED) for x in (low, second))
    if digits < NEEDED:
        raise RuntimeError(f"{scene.name}: only {digits} digits of the time of blow-up confirmed")
    known = {"time": truth.rounded(high, truth.place(high, digits)), "digits": digits}
    return [t for t in times if float(t) < float(high)], {"blow_up": known}


def parameters(scene: Scene) -> dict[str, Any]:
    """The scene's definition for human readers."""
    if isinstance(scene, RigidBody):
        damping = {"gamma": scene.gamma} if scene.isotropic else {"damping": scene.damping}
        return {"inertia": scene.inertia, **damping, "M": scene.M, "R": scene.R, "s": scene.s}
    damped = (name for name in ("gamma", "kappa", "mass") if hasattr(scene, name))
    names = tuple(dict.fromkeys((*damped, *scene.coefficients, *scene.initial_fields)))
    return dict(scene.parameters) | {name: getattr(scene, name) for name in names}  # type: ignore[attr-defined]


def compute(scene: Scene) -> tuple[str, dict[str, Any]]:
    """The text of the scene's CSV, and its entry in the manifest.

    Raises `RuntimeError` when fewer than 30 digits are confirmed.
    """
    carry, times, blow_up = scene.carry(), grid(scene), {}
    try:
        low, high = (truth.taylor(scene, times, carry, bits) for bits in BITS)
    except truth.BlowUp:
        times, blow_up = before_blow_up(scene)
        low, high = (truth.taylor(scene, times, carry, bits) for bits in BITS)
    second = truth.extrapolation(scene, times, carry, EXTRAPOLATION_DIGITS)
    agreeing = truth.agreeing_digits(low, high, BITS[0] * 3 // 10)
    confirmed = truth.agreeing_digits(second, high, EXTRAPOLATION_DIGITS)
    closed, invariants = closed_form_agreement(scene, times, high), invariant_agreement(scene, times, high)
    digits = min(STORED, agreeing, confirmed, *closed.values(), *invariants.values())
    if digits < NEEDED:
        raise RuntimeError(
            f"{scene.name}: only {digits} digits confirmed (precisions {agreeing}, second engine "
            f"{confirmed}, closed form {closed}, invariants {invariants})"
        )
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["t", *scene.labels(carry)])
    writer.writerows([t, *row] for t, row in zip(times, print_columns(high, digits), strict=True))
    versions = {"heyoka": heyoka.__version__, "mpmath": mpmath.__version__}
    entry = {
        "file": f"{scene.name}.csv",
        "sha256": hashlib.sha256(text.getvalue().encode()).hexdigest(),
        "scene_digest": truth.digest(scene),
        "kind": type(scene).__name__,
        "parameters": parameters(scene),
        "carry": carry,
        "grid": {"t_end": scene.t_end, "intervals": INTERVALS, "times": f"t_end·k/{INTERVALS}"},
        "digits": digits,
        "engine": {
            "tool": "heyoka.taylor_adaptive(fp_type=heyoka.real)",
            "precisions_bits": BITS,
            "agreeing_digits": agreeing,
        },
        "second_engine": {
            "tool": "Gragg–Bulirsch–Stoer extrapolation in mpmath, whole grid",
            "tolerance_digits": EXTRAPOLATION_DIGITS,
            "agreeing_digits": confirmed,
        },
        "closed_form_agreeing_digits": closed,
        "invariants_agreeing_digits": invariants,
        "versions": versions | {"python": platform.python_version()},
        **blow_up,
    }
    if scene not in STANDARD:
        entry["condition_number"] = condition(scene, times, high)
    return text.getvalue(), json.loads(json.dumps(entry))


def write(path: Path, text: str) -> None:
    """Replace a file as a whole, so that a killed run leaves the old one."""
    fresh = path.with_suffix(".tmp")
    fresh.write_text(text, encoding="utf-8", newline="\n")
    os.replace(fresh, path)


def stored_manifest(folder: Path) -> dict[str, Any]:
    path = folder / "MANIFEST.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {"schema": 1, "scenes": {}}


def generate(scene: Scene, folder: Path = FOLDER) -> str:
    """Compute and store one scene; returns what happened in one line."""
    text, entry = compute(scene)
    write(folder / entry["file"], text)
    document = stored_manifest(folder)
    entries = document["scenes"] | {scene.name: entry}
    document["scenes"] = {s.name: entries[s.name] for s in FROZEN if s.name in entries}
    write(folder / "MANIFEST.json", json.dumps(document, indent=1, ensure_ascii=False) + "\n")
    return f"{entry['digits']} digits stored"


def differences(stored: str, fresh: str, digits: int) -> list[str]:
    """Where two tables differ by more than one unit of the last stored digit of their column."""
    (header, *old), (fresh_header, *new) = (list(csv.reader(io.StringIO(x))) for x in (stored, fresh))
    if header != fresh_header or [row[0] for row in old] != [row[0] for row in new]:
        return ["columns or times differ"]
    found = []
    for j, label in enumerate(header[1:], start=1):
        scale = max(abs(Decimal(row[j])) for row in new)
        unit = Decimal(1).scaleb(scale.adjusted() + 1 - digits) if scale else Decimal(0)
        for a, b in zip(old, new, strict=True):
            if abs(Decimal(a[j]) - Decimal(b[j])) > unit:
                found.append(f"{label} at t = {a[0]}: stored {a[j]}, computed {b[j]}")
    return found


def missing(scene: Scene, folder: Path = FOLDER) -> str | None:
    """Why a scene has no stored reference, and the command that makes it; None where it has one."""
    entry = stored_manifest(folder)["scenes"].get(scene.name)
    if entry is None or not (folder / entry["file"]).is_file():
        why = "nothing is stored"
    elif entry["scene_digest"] != truth.digest(scene):
        why = "the scene's definition has changed since"
    else:
        return None
    return f"{why}; run python references/generate.py {scene.name}"


def check(scene: Scene, folder: Path = FOLDER) -> list[str]:
    """What is wrong with a stored scene, one line each; empty when all is well."""
    if why := missing(scene, folder):
        return [why]
    entry = stored_manifest(folder)["scenes"][scene.name]
    stored = (folder / entry["file"]).read_bytes()
    found = []
    if hashlib.sha256(stored).hexdigest() != entry["sha256"]:
        found.append(f"{entry['file']} does not match its SHA-256 in the manifest")
    text, fresh = compute(scene)
    if fresh["digits"] < entry["digits"]:
        found.append(f"only {fresh['digits']} of {entry['digits']} stored digits confirmed")
    return found + differences(stored.decode(), text, min(fresh["digits"], entry["digits"]))


def main(arguments: list[str] | None = None) -> int:
    names = [scene.name for scene in FROZEN]
    parser = argparse.ArgumentParser(description="Compute the frozen references, or check them.")
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"of {', '.join(names)}; default all")
    parser.add_argument("--check", action="store_true", help="recompute and compare, write nothing")
    options = parser.parse_args(arguments)
    if unknown := [name for name in options.scenes if name not in names]:
        parser.error(f"no frozen scene {unknown[0]!r}: choose from {', '.join(names)}")
    wrong = 0
    for name in options.scenes or names:
        print(f"{name} …", end=" ", file=sys.stderr, flush=True)
        start = time.perf_counter()
        try:
            found = check(SCENES[name]) if options.check else []
            line = "; ".join(found[:3]) or "ok" if options.check else generate(SCENES[name])
        except RuntimeError as error:
            found, line = [str(error)], str(error)
        wrong += bool(found)
        print(f"{time.perf_counter() - start:.1f} s", file=sys.stderr, flush=True)
        print(f"{name}: {line}", flush=True)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
