"""States as tuples of components, and the little algebra they need: vectors, quaternions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, Protocol, Self

import numpy as np

from contactbench.checks import real_array
from contactbench.errors import BadInput, excerpt
from contactbench.numbers.protocol import Arithmetic, Vector

#: allowed error of a given attitude
ROUNDED = 1e-6


class AnyState(Protocol):
    """A state of some kind of scene: a NamedTuple of vectors and numbers; a field that is not carried is None."""

    @property
    def _fields(self) -> tuple[str, ...]: ...
    @property
    def s(self) -> Any: ...
    def _replace(self, *args: Any, **changes: Any) -> Self: ...
    def __iter__(self) -> Iterator[Any]: ...


class State(NamedTuple):
    """State of a mechanical scene: q and p are n-tuples, s a number or None when not carried."""

    q: Vector
    p: Vector
    s: Any = None


class DrivenState(NamedTuple):
    """State of a driven scene: q, p and s as of a mechanical one, and the time t."""

    q: Vector
    p: Vector
    t: Arithmetic
    s: Any = None


class BodyState(NamedTuple):
    """State of a rigid body: momentum M, attitude R as a quaternion (w, x, y, z), s; R, s None if not carried."""

    M: Vector
    R: Vector | None = None
    s: Any = None


def shifted[X: AnyState](x: X, h: Arithmetic, slope: X) -> X:
    """Return x + h·slope, component by component.

    Parameters
    ----------
    x
        A state of a scene, a NamedTuple of tuples and numbers; a field that is not carried is None.
    h
        A number, the length of the step.
    slope
        A state of the same fields, such as ``scene.rhs(x)``.

    Returns
    -------
    NamedTuple
        A state of the same fields; a field that is not carried is left alone.

    Raises
    ------
    ValueError
        Where a field of x and of the slope differ in length.

    Examples
    --------
    >>> import contactbench as cb
    >>> scene = cb.SCENES["oscillator"]
    >>> x = scene.initial(())
    >>> cb.shifted(x, 0.0, scene.rhs(x)) == x
    True
    """
    moved: list[object] = []
    for part, rate in zip(x, slope, strict=True):
        if isinstance(part, tuple):
            moved.append(tuple(a + h * b for a, b in zip(part, rate, strict=True)))
        else:
            moved.append(None if part is None else part + h * rate)
    return type(x)(*moved)


def scaled(c: Arithmetic | Vector, v: Sequence[Arithmetic]) -> Vector:
    """Return c v; component by component where c is a tuple."""
    if isinstance(c, tuple):
        return tuple(a * b for a, b in zip(c, v, strict=True))
    return tuple(c * b for b in v)


def added(a: Sequence[Arithmetic], b: Sequence[Arithmetic]) -> Vector:
    return tuple(x + y for x, y in zip(a, b, strict=True))


def times(c: Arithmetic | Vector, factor: Arithmetic) -> Arithmetic | Vector:
    """Return c · factor, for a tuple entry by entry."""
    return tuple(a * factor for a in c) if isinstance(c, tuple) else c * factor


def dot(a: Sequence[Arithmetic], b: Sequence[Arithmetic]) -> Arithmetic:
    """Return a·b, summed left to right."""
    total = a[0] * b[0]
    for x, y in zip(a[1:], b[1:], strict=True):
        total = total + x * y
    return total


def norm(a: Vector) -> Any:
    return dot(a, a) ** 0.5


def cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def quaternion_product(a: Vector, b: Vector) -> Vector:
    """Return the Hamilton product a ⊗ b of quaternions (w, x, y, z)."""
    w = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    y = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    z = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]
    return (w, x, y, z)


def conjugate(R: Vector) -> Vector:
    """Return the quaternion of the inverse rotation."""
    return (R[0], -R[1], -R[2], -R[3])


def rotation_matrix(R: Vector) -> tuple[Vector, Vector, Vector]:
    """Return the 3×3 matrix of a quaternion, not normalised: a drift of its length shows in RᵀR − 1 and in J = R M."""
    w, x, y, z = R
    return (
        (w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z),
    )


def rotate(R: Vector, v: Vector) -> Vector:
    return tuple(dot(row, v) for row in rotation_matrix(R))


def quaternion_of(value: object) -> Vector:
    """Return the quaternion of an attitude given as 1, a quaternion or a rotation matrix, to within `ROUNDED`."""
    wanted, off = "1, a unit quaternion (w, x, y, z) or a 3×3 rotation matrix", ""
    given = real_array("R", value, wanted)
    if given.ndim == 0 and given == 1:
        return (1.0, 0.0, 0.0, 0.0)
    if given.shape == (4,):
        length = float(np.linalg.norm(given))
        if abs(length - 1) <= ROUNDED:
            return tuple((given if abs(length - 1) < 1e-12 else given / length).tolist())
        off = f"its length is {length:.9g}; "
    if given.shape == (3, 3):
        from scipy.spatial.transform import Rotation

        far, turns = float(np.abs(given.T @ given - np.eye(3)).max()), np.linalg.det(given) > 0
        if far <= ROUNDED and turns:
            return tuple(Rotation.from_matrix(given).as_quat(scalar_first=True).tolist())
        off = f"RᵀR is off the identity by {far:.2g}; " if far > ROUNDED else "it is a reflection; "
    raise BadInput(f"R = {excerpt(value)}: {off}must be {wanted}, to {ROUNDED:g}")
