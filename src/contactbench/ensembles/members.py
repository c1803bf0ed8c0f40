"""What an ensemble is given: initial states and parameters, one entry per trajectory."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from contactbench.errors import BadInput, array, excerpt, finite, unknown_name
from contactbench.scene import BodyState, DrivenState, Scene, State, quaternion_of


def members(
    scene: Scene, carry: tuple[str, ...], given: Any, parameters: Mapping[str, Any]
) -> tuple[np.ndarray, dict[int, np.ndarray]]:
    """Return packed initial states (d, n), and by its place among the scene's numbers each parameter (n,)."""
    if isinstance(given, State | BodyState | DrivenState):
        given = {name: value for name, value in given._asdict().items() if value is not None}
    if not isinstance(given, Mapping):
        raise BadInput(f"initial_conditions = {type(given).__name__}: must be a state of the scene or a dict")
    if not isinstance(parameters, Mapping):
        raise BadInput(f"parameters = {excerpt(parameters)}: must be a dict of arrays by name")
    for name in given:
        if name not in scene.initial_fields:
            raise unknown_name(f"initial value of scene {scene.name!r}", name, scene.initial_fields)
    columns: dict[str, np.ndarray] = {}
    carried = {name for name, part in scene.initial(carry)._asdict().items() if part is not None}
    for name in scene.initial_fields:
        if name not in carried:
            continue
        default = getattr(scene, name)
        value = given.get(name, default)
        if not isinstance(default, tuple):
            columns[name] = _column(name, value)
            continue
        try:
            parts = tuple(value)
        except TypeError:  # one number: the identity may be written as 1
            parts = quaternion_of(value) if name == "R" else (value,)
        if len(parts) != len(default):
            wanted = f"{len(default)} components, each a number or an array"
            raise BadInput(f"{name}: must be {wanted}; got {len(parts)}")
        columns |= {f"{name}[{i}]": _column(f"{name}[{i}]", part) for i, part in enumerate(parts)}
    states = list(columns)
    columns |= {name: _parameter(scene, name, value) for name, value in parameters.items()}
    sizes = {name: len(column) for name, column in columns.items() if column.ndim}
    if len(set(sizes.values())) != 1:
        told = ", ".join(f"{name} {size}" for name, size in sizes.items()) or "none is an array"
        raise BadInput(f"initial_conditions: arrays of one length, one entry per trajectory; got {told}")
    (n,) = set(sizes.values())
    if n == 0:
        raise BadInput("initial_conditions: no trajectories, arrays of length 0")
    y0 = np.array([np.broadcast_to(columns[name], n) for name in states])
    if "R" in carry:
        length = np.linalg.norm(y0[3:7], axis=0)
        if (worst := np.abs(length - 1).max()) > 1e-12:
            raise BadInput(f"R: must be unit quaternions (w, x, y, z); one is off by {worst:.3g}")
    places = scene.number_names()
    return y0, {places.index(name): np.broadcast_to(columns[name], n) for name in parameters}


def _column(name: str, value: Any) -> np.ndarray:
    """Return a number or a one-dimensional array of finite numbers, or `BadInput`."""
    column = array(name, value, "a number or an array of numbers")
    if column.ndim > 1:
        raise BadInput(f"{name}: must be a number or an array (n,), got shape {column.shape}")
    if not np.isfinite(column).all():
        where = int(np.argmin(np.isfinite(column)))
        raise BadInput(f"{name}: must be finite numbers, entry {where} is {column.flat[where]}")
    return column


def _parameter(scene: Scene, name: str, value: Any) -> np.ndarray:
    """Return values of a parameter, each of which the scene accepts without becoming another problem."""
    allowed = [known for known in scene.number_names() if known]
    if name not in allowed:
        raise unknown_name(f"parameter of an ensemble of scene {scene.name!r}", name, allowed)
    column = _column(name, value)
    for extreme in (column.min(initial=np.inf), column.max(initial=-np.inf)) if column.size else ():
        if scene.with_(**{name: finite(name, extreme)}).structure != scene.structure:
            raise BadInput(f"{name}: {extreme} makes scene {scene.name!r} another problem; change the scene")
    return column
