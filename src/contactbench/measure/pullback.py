"""Φ*η, the contact form pulled back by a numerical map, on the tangents at its start."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from contactbench.scene import norm
from contactbench.solution import SAFETY, Differential, Solution, closest


class Pullback(NamedTuple):
    """η(Φ)·DΦ at every saved time on the m tangents.

    values : (k, m).  form : η at the start, (m,).  terms : ‖|∂s| + ‖p‖‖∂q‖‖, the size of the terms that
    the values are differences of, (k,).  uncertainty : error bar of the values, in the norm over the
    tangents, (k,); None where the derivative is computed to round-off.
    """

    values: np.ndarray
    form: np.ndarray
    terms: np.ndarray
    uncertainty: np.ndarray | None


def pullback(solution: Solution, differential: Differential) -> Pullback | None:
    """The pull-back by a derivative of the run's map, None where it was not taken.

    Of several estimates of the derivative the one is used, for every tangent, that differs least from the
    next over all saved times, relative to the largest; `SAFETY` times that difference is the error bar.
    """
    if not differential.taken:
        return None
    scene, carry, start = solution.scene, solution.carry, solution.start()
    form = np.array([float(scene.contact_form(start, v)) for v in scene.tangents(start)])
    here = scene.unpack(tuple(differential.states.T), carry)
    # (l, k, d, m) → a state of arrays (l, m, k)
    pushed = scene.unpack(tuple(np.moveaxis(differential.estimates, (2, 3), (0, 2))), carry)
    values = np.asarray(scene.contact_form(here, pushed))
    terms = np.asarray(scene.contact_terms(here, pushed))
    if len(values) == 1:
        return Pullback(values[0].T, form, np.linalg.norm(terms[0], axis=0), None)
    gaps = np.abs(np.diff(values, axis=0))  # (l - 1, m, k)
    scale = np.abs(values[-1]).max(axis=0) + np.finfo(float).tiny
    best = closest((gaps / scale).max(axis=2))
    chosen = np.arange(len(best))
    return Pullback(
        values[best, chosen].T,
        form,
        norm(tuple(terms[best, chosen])),
        SAFETY * norm(tuple(gaps[best, chosen])),
    )


def growth(differential: Differential) -> float:
    """max ‖DΦ(t)‖₂ over the saved times: how much the numerical map magnifies an error in its start."""
    return float(np.linalg.norm(differential.value, ord=2, axis=(1, 2)).max())
