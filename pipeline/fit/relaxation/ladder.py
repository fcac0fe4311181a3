"""How many arms does a master curve take? Error against the number of arms, far beyond the few that name a material.

Over many decades three arms are too few, and a publication gives dozens. What each number of arms reaches is then the answer,
not one of them. Does not belong here: orders 1 to 3 with intervals (`relaxation`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.fit.relaxation.identify import Rigs, film_stiffness, fit_specimen, per_recording
from pipeline.fit.relaxation.order import LEVEL
from pipeline.fit.relaxation.results import RelaxationFit, SpecimenFits
from pipeline.physics.film import RelaxationModel
from pipeline.physics.held_step import Hold, hold_stiffness
from pipeline.transform.relaxation import RelaxationCurve
from pipeline.transform.response import FrequencyResponse
from schemas.arrays import Float

ORDERS = (1, 2, 3, 4, 6, 8, 12, 16, 20, 24, 28, 32)
DECADES = 5.0
"""Decades of frequency from which on a ladder is worth its time."""


@dataclass(frozen=True)
class Rung:
    """What one number of arms reaches.

    `relative_error` root mean square of |model/measured − 1| over all lines, and all times of curves of the film alone; `r_squared_storage` and `_loss` of the
    real and the imaginary part, `r_squared_relaxation` of curves in time; None where there is none. `order_p_value`: of this
    number against one more. `model`: its springs and dampers.
    """

    model_order: int
    resolved_arms: int
    relative_error: float
    r_squared_storage: float | None
    r_squared_loss: float | None
    r_squared_relaxation: float | None
    order_p_value: float | None
    model: RelaxationModel


def wants_ladder(fits: SpecimenFits) -> bool:
    """The data reach over many decades, and the highest order that was fitted is rejected against the next."""
    last = fits.fits[-1]
    wide = fits.frequency_high_hz >= 10**DECADES * fits.frequency_low_hz
    return wide and last.order_p_value is not None and last.order_p_value < LEVEL


def ladder(
    responses: Sequence[FrequencyResponse],
    rig: Rigs = None,
    *,
    relaxations: Sequence[RelaxationCurve] = (),
    relaxation_rig: Rigs = None,
    orders: Sequence[int] = ORDERS,
) -> tuple[Rung, ...]:
    """A rung per order that the data can carry, from one to the most. Raises like `fit_specimen`."""
    rigs = per_recording(rig, len(responses))
    fits = fit_specimen(responses, rigs, relaxations=relaxations, relaxation_rig=relaxation_rig, orders=orders)
    films = [film_stiffness(r, c).only_usable() for r, c in zip(responses, rigs, strict=True)]
    curve_rigs = per_recording(relaxation_rig, len(relaxations))
    curves = [curve for curve, one in zip(relaxations, curve_rigs, strict=True) if one is None]
    return tuple(_rung(fit, films, curves) for fit in fits.fits)


def _rung(fit: RelaxationFit, films: Sequence[FrequencyResponse], relaxations: Sequence[RelaxationCurve]) -> Rung:
    pairs = [(fit.model.stiffness(film.frequency_hz), film.value) for film in films]
    curves = [_in_time(fit, curve) for curve in relaxations]
    squares = np.concatenate([np.abs(m / v - 1) ** 2 for m, v in (*pairs, *curves)] or [np.array([np.nan])])
    return Rung(
        model_order=fit.order,
        resolved_arms=fit.resolved_arms,
        relative_error=float(np.sqrt(np.mean(squares))),
        r_squared_storage=_explained([(m.real, v.real) for m, v in pairs]),
        r_squared_loss=_explained([(m.imag, v.imag) for m, v in pairs]),
        r_squared_relaxation=_explained(curves),
        order_p_value=fit.order_p_value,
        model=fit.model,
    )


def _in_time(fit: RelaxationFit, curve: RelaxationCurve) -> tuple[Float, Float]:
    """Model and measurement (p,) after the ramp of a curve of the film alone."""
    curve = curve.first_step()
    start, width = curve.window_s[:, 0] - curve.ramp_s, np.diff(curve.window_s, axis=1)[:, 0]
    good = curve.usable & (start >= 0)
    hold = Hold(start[good], width[good], curve.ramp_s)
    return hold_stiffness(fit.theta, fit.shape, hold)[0], curve.stiffness[good]


def _explained(pairs: Sequence[tuple[Float, Float]]) -> float | None:
    """R² of all pairs of model and measurement together; None where there is nothing to explain."""
    if not pairs:
        return None
    model, measured = (np.concatenate([pair[i] for pair in pairs]) for i in (0, 1))
    total = float(((measured - measured.mean()) ** 2).sum())
    return 1 - float(((measured - model) ** 2).sum()) / total if total > 0 else None
