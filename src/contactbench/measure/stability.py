"""Linear stability: the one-step map of a fixed-step method on the damped oscillator, a 2×2 matrix.

q'' + γ q' + ω² q = 0.  Its eigenvalues decide everything: a spectral radius above one means unbounded
orbits, and beside e^{−γh/2} it tells numerical damping from antidamping.  No long orbit is needed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from contactbench.methods import METHODS
from contactbench.scene import Mechanical, State
from contactbench.scenes import SCENES

#: an eigenvalue this close to the unit circle counts as on it: square root of round-off
SLACK = 1e-7
#: step sizes ωh looked at for the limit, 1 % apart
SHORTEST, LONGEST, SCANNED = 1e-3, 1e3, 1400
#: plain elementwise functions: a vector of step sizes is then a scalar like any other
ELEMENTWISE = SimpleNamespace(exp=np.exp, expm1=np.expm1, sin=np.sin, cos=np.cos, where=np.where, inf=np.inf)


def oscillator(gamma: float, omega: float = 1.0) -> Mechanical:
    """The registered oscillator with these parameters."""
    return SCENES["oscillator"].with_(gamma=gamma, omega=omega)


def fixed_step_methods() -> list[Any]:
    """The registered fixed-step methods that take the oscillator."""
    return [m for m in METHODS.values() if not m.adaptive and m.refuses(SCENES["oscillator"]) is None]


def step_matrix(method: Any, gamma: float, omega: float, h: Any) -> np.ndarray:
    """The map (q, p) → (q, p) of one step of size h: (2, 2), or (k, 2, 2) for k step sizes."""
    scene, steps = oscillator(gamma, omega), np.asarray(h, dtype=float)
    columns = []
    with np.errstate(all="ignore"):  # e^{γ|a|h} of a negative substep may overflow: unstable, then
        for q, p in ((1.0, 0.0), (0.0, 1.0)):
            x = method.advance(scene, State((q,), (p,)), steps, 1, ELEMENTWISE)
            columns.append([*x.q, *x.p])
    entries = [np.broadcast_to(c, steps.shape) for column in columns for c in column]
    return np.moveaxis(np.array(entries).reshape(2, 2, *steps.shape), (0, 1), (-1, -2))


def eigenvalues(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The two eigenvalues of 2×2 matrices (…, 2, 2), the larger in absolute value first."""
    with np.errstate(all="ignore"):
        half = (matrix[..., 0, 0] + matrix[..., 1, 1]) / 2
        difference = (matrix[..., 0, 0] - matrix[..., 1, 1]) / 2
        root = np.sqrt(difference**2 + matrix[..., 0, 1] * matrix[..., 1, 0] + 0j)
        root = np.where((half.conj() * root).real < 0, -root, root)
        large = half + root
        det = matrix[..., 0, 0] * matrix[..., 1, 1] - matrix[..., 0, 1] * matrix[..., 1, 0]
        # the smaller from the determinant where that is not cancelled away itself
        small = np.where(np.abs(root.real) > 0, det / np.where(large != 0, large, 1), half - root)
    return large, small


def spectral_radius(method: Any, gamma: float, omega: float, h: Any) -> Any:
    """Largest |eigenvalue| of one step; inf where it is not finite."""
    large, small = eigenvalues(step_matrix(method, gamma, omega, h))
    radius = np.maximum(np.abs(large), np.abs(small))
    radius = np.where(np.isfinite(radius), radius, np.inf)
    return radius if radius.ndim else float(radius)


def true_radius(gamma: float, omega: float, h: float) -> float:
    """The same of the exact flow: e^{−γh/2}, or e^{−λh} with the slow rate λ where overdamped."""
    return math.exp(-slow_rate(gamma, omega) * h)


def slow_rate(gamma: float, omega: float = 1.0) -> float:
    """The rate at which motions die out: γ/2, less √(γ²/4 − ω²) where overdamped."""
    if gamma <= 2 * omega:
        return gamma / 2
    return omega**2 / (gamma / 2 + math.sqrt(gamma**2 / 4 - omega**2))


def stability_limit(method: Any, gamma: float, omega: float) -> float:
    """The step up to which orbits stay bounded: where an eigenvalue first leaves the unit circle.

    Steps are scanned 1 % apart up to ωh = 10³ and the border found is bisected: a window of instability
    narrower than that is passed over.  inf when none is found.
    """
    steps = np.geomspace(SHORTEST, LONGEST, SCANNED) / omega
    beyond = spectral_radius(method, gamma, omega, steps) > 1 + SLACK
    if not beyond.any():
        return math.inf
    first = int(np.argmax(beyond))
    if first == 0:
        return 0.0
    low, high = steps[first - 1], steps[first]
    while high - low > 1e-12 * high:
        middle = (low + high) / 2
        if spectral_radius(method, gamma, omega, middle) > 1 + SLACK:
            high = middle
        else:
            low = middle
    return float(low)


def slow_rate_ratio(method: Any, gamma: float, h: float) -> float:
    """The decay rate of the slow mode under a method, over the true one; nan where there is none.

    The slow mode is the eigenvalue nearest to the true e^{−λh}; a negative or complex one alternates or
    oscillates, and has no rate of creep.
    """
    exact = true_radius(gamma, 1.0, h)
    slow = min(eigenvalues(step_matrix(method, gamma, 1.0, h)), key=lambda value: abs(complex(value) - exact))
    if abs(slow.imag) > 1e-12 or slow.real <= 0:
        return math.nan
    return -math.log(slow.real) / h / slow_rate(gamma)


# -- theory ----------------------------------------------------------------------------------------
Limit = Callable[[float, float], float]


def merged_limit(gamma: float, omega: float) -> float:
    """B½ AC B½: an eigenvalue −1 where ω²h tanh(γh/2) = 2γ; 2/ω as γ → 0, 2γ/ω² as γ → ∞."""
    if gamma == 0:
        return 2 / omega
    return root(
        lambda h: omega**2 * h * math.tanh(gamma * h / 2) - 2 * gamma, 2 / omega + 2 * gamma / omega**2
    )


def printed_limit(gamma: float, omega: float) -> float:
    """B½ C A B½ in the printed order: (ωh)² = 2 (1 + e^{γh})."""
    return root(
        lambda h: (omega * h) ** 2 * math.exp(-gamma * h) - 2 * (1 + math.exp(-gamma * h)), 10 / omega
    )


def herglotz1_limit(gamma: float, omega: float) -> float:
    """An eigenvalue −1 where ω²h² + 2γh = 4."""
    return 4 / (gamma + math.hypot(gamma, 2 * omega))


def rk4_limit(gamma: float, omega: float) -> float:
    """|1 + z + z²/2 + z³/6 + z⁴/24| = 1 for z = h λ, λ² + γλ + ω² = 0."""
    rates = np.roots([1.0, gamma, omega**2])

    def growth(h: float) -> float:
        z = h * rates
        return float(np.abs(1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4)))).max()) - 1

    return root(growth, 3 / omega)


def root(f: Callable[[float], float], scale: float) -> float:
    """The smallest root above 10⁻³·scale of a function negative there; inf where there is none below 10·scale."""
    from scipy.optimize import brentq

    grid = np.geomspace(1e-3, 10, 4000) * scale
    signs = np.array([f(h) > 1e-12 for h in grid])
    if not signs.any():
        return math.inf
    k = int(np.argmax(signs))
    return float(grid[0]) if k == 0 else float(brentq(f, grid[k - 1], grid[k], xtol=1e-13))


#: the limit a method has by theory, by name; the kick-drift-kick palindrome has 2/ω whatever damps between
THEORY: dict[str, Limit] = {
    "contact-printed": printed_limit,
    "contact-abc": lambda gamma, omega: 2 / omega,
    "contact-strang": merged_limit,
    "rk4": rk4_limit,
    "herglotz1": herglotz1_limit,
    "herglotz2": lambda gamma, omega: 2 / omega,
}


# -- strong damping --------------------------------------------------------------------------------
def flow_matrix(gamma: float, omega: float, t: float) -> np.ndarray:
    """The exact flow of (q, p) over t."""
    from scipy.linalg import expm

    return expm(np.array([[0.0, 1.0], [-(omega**2), -gamma]]) * t)


def propagation_error(method: Any, gamma: float, h: float) -> float:
    """‖Mⁿ − Φ_T‖₂/‖Φ_T‖₂ with nh = T as near as can be to the time in which a motion falls by e.

    inf where the powers overflow.
    """
    n = max(1, round(1 / slow_rate(gamma) / h))
    exact = flow_matrix(gamma, 1.0, n * h)
    with np.errstate(all="ignore"):
        power = np.linalg.matrix_power(step_matrix(method, gamma, 1.0, h), n)
        if not np.isfinite(power).all():
            return math.inf
        return float(np.linalg.norm(power - exact, 2) / np.linalg.norm(exact, 2))
