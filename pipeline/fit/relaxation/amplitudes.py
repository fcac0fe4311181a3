"""Models of a film at each amplitude by itself: what a single average over the amplitudes hides (thesis, fig 4-8 and 4-9)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pipeline.fit.relaxation.identify import ORDERS, fit_corrected
from pipeline.fit.relaxation.metrics import Geometry
from pipeline.fit.relaxation.results import SpecimenFits
from pipeline.transform.averaging import average, group_by_amplitude
from pipeline.transform.response import FrequencyResponse
from schemas.errors import NotIdentifiableError

_FEWEST_LINES = 3
"""Frequencies of one amplitude below which a model of it says nothing of its own."""


@dataclass(frozen=True)
class AmplitudeFits:
    """The response at one amplitude of the input, and its models of every order; `recordings` went into it."""

    response: FrequencyResponse
    amplitude: float
    recordings: int
    fits: SpecimenFits


def fit_amplitudes(
    responses: Sequence[FrequencyResponse],
    *,
    orders: Sequence[int] = ORDERS,
    geometry: Geometry | None = None,
    specimen_id: str = "",
) -> tuple[AmplitudeFits, ...]:
    """Models of the film at each amplitude, smallest first.

    Parameters
    ----------
    responses : stiffness of the film, the rig taken out, (n,) N/mm each; those without amplitude are left aside
    orders : numbers of arms
    geometry : stretched length and section, for the modulus

    Returns
    -------
    One entry for each amplitude that was measured at three or more frequencies; none where fewer than two were

    Notes
    -----
    Amplitudes within 5 % of each other are one, as in averages. Where an order cannot be fitted at an amplitude, that amplitude
    has no entry.
    """
    groups = group_by_amplitude([r for r in responses if r.amplitude is not None])
    found = []
    for group in groups:
        one = average(group)
        if one.only_usable().frequency_hz.size < _FEWEST_LINES or one.amplitude is None:
            continue
        try:
            fits = fit_corrected(one, orders=orders, geometry=geometry, specimen_id=specimen_id)
        except NotIdentifiableError:
            continue
        found.append(AmplitudeFits(one, one.amplitude, len(group), fits))
    return tuple(found) if len(found) > 1 else ()
