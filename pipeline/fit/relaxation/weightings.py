"""Models of the film fitted with other weights than the noise's: every line alike, or every line by its share.

Weights by noise are right where the model is: they give the least uncertain parameters. A model of few arms is wrong somewhere,
and noise decides where: at the lines that are measured best, which need not be those that a controller needs. The tables of
the thesis (4.2 to 4.4) are of the other kinds. Their fits say nothing about noise, so that they choose no order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.fit.relaxation.assemble import assemble
from pipeline.fit.relaxation.identify import ORDERS, identify
from pipeline.fit.relaxation.metrics import Geometry
from pipeline.fit.relaxation.reference import find_reference, with_estimated_noise
from pipeline.fit.relaxation.results import CORRECTED, MECHANICAL, RELATIVE, UNIFORM, SpecimenFits
from pipeline.transform.response import FrequencyResponse
from schemas.arrays import Float

_FIRST = 0.01
"""Size of the errors before the misfit tells it, as a share of the median magnitude."""
_SAYS = {
    UNIFORM: "every line counts alike, in N/mm",
    RELATIVE: "every line counts alike, as a share of its magnitude",
}


def fit_weighted(
    response: FrequencyResponse,
    weighting: str,
    *,
    orders: Sequence[int] = ORDERS,
    geometry: Geometry | None = None,
    specimen_id: str = "",
) -> SpecimenFits:
    """Models of every order of a film's response with weights that do not follow its noise.

    Parameters
    ----------
    response : stiffness of the film, (n,) N/mm; its usable lines are taken, its variance is not
    weighting : `uniform`, least Σ|k_model − k|², or `relative`, least Σ|k_model/k − 1|²
    geometry : stretched length and section, for the modulus

    Returns
    -------
    SpecimenFits
        of method `corrected`; the uncertainties of the parameters follow from the misfit of the best relaxation of any order

    Raises
    ------
    NotIdentifiableError
        where nothing is usable or there are fewer values than parameters
    """
    alike = replace(response, variance=_variance(response, weighting), systematic=None, effective_lines=None)
    observations, warnings, _ = assemble([alike], [None], divided=True)
    every = frozenset(range(len(observations.groups)))
    found = identify(
        with_estimated_noise(find_reference(observations), every).observations,
        frozenset(),
        orders=orders,
        specimen_id=specimen_id,
        loading=MECHANICAL,
        method=CORRECTED,
        measured=[response.only_usable()],
        geometry=geometry,
    )
    said = f"weights are {weighting}: {_SAYS[weighting]}; ± follows from the misfit, and no test of the order is made"
    return replace(found, weighting=weighting, positivity=None, choices={}, warnings=(*warnings, said))


def _variance(response: FrequencyResponse, weighting: str) -> Float:
    """(n,) variances in the proportion of the weighting."""
    magnitude = np.abs(response.value)
    size = (
        magnitude if weighting == RELATIVE else np.full(magnitude.shape, float(np.median(magnitude[response.usable])))
    )
    return np.asarray((_FIRST * size) ** 2)
