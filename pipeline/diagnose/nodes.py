"""Frequencies at which a simulation computes responses, and the weights that carry its values to any other frequency.

Responses of film and rig are smooth in log frequency except near the clamp's resonance, so that the nodes are log-spaced and
dense there; between them a cubic runs through four nodes. One set of nodes serves all recordings of a rig.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from pipeline.fit.rig import rig_prior
from schemas.metadata import RigConstants

Float = NDArray[np.float64]

_LOWEST_HZ, _HIGHEST_HZ = 1e-4, 2e4
_PER_DECADE = 24
_PER_WIDTH = 4.0
"""Nodes per half width of the lightest resonance that is expected."""
_RESONANCE = (0.75, 1.7)
"""Range about the clamp-alone frequency in which the resonance with a film may lie, with a clamp up to 1.7 times as heavy as stated."""
_GRADED = 0.06
"""Spacing over the distance from that range, both logarithmic: cubics then miss a pole there by 1e-5 of its part."""


def response_nodes(rig: RigConstants) -> Float:
    """(J,) Hz ascending; the first is 0."""
    coarse = math.log(10) / _PER_DECADE
    end = math.log(_HIGHEST_HZ)
    x = [math.log(_LOWEST_HZ)]
    prior = rig_prior(rig)
    if prior is None or prior.nominal[0] <= 0:
        return np.concatenate([[0.0], np.exp(np.arange(x[0], end + coarse, coarse))])
    mass, stiffness = prior.nominal[:2]
    alone = 0.5 * math.log(stiffness / mass) - math.log(2 * math.pi)
    low, high = alone + math.log(_RESONANCE[0]), alone + math.log(_RESONANCE[1])
    fine = prior.lightest_ratio / _PER_WIDTH
    while x[-1] < end:
        # The distance is that of the next node where the range lies ahead.
        away = max(low - x[-1], x[-1] - high, 0.0)
        if x[-1] < low:
            away = max(0.0, (away - fine) / (1 + _GRADED))
        x.append(x[-1] + min(coarse, fine + _GRADED * away))
    return np.concatenate([[0.0], np.exp(np.array(x))])


def interpolation(nodes: Float, frequency: Float) -> scipy.sparse.csr_array:
    """(m, J) weights that give values at (m,) Hz ≥ 0 from values at the nodes (J,): cubics in log frequency.

    Below the second node a straight line from the value at 0.
    """
    x, first = np.log(nodes[1:]), nodes[1]
    low = frequency < first
    at = np.log(np.maximum(frequency, first))
    left = np.clip(np.searchsorted(x, at, side="right") - 2, 0, x.size - 4)
    stencil = left[:, None] + np.arange(4)
    corner = x[stencil]
    weights = np.ones((frequency.size, 4))
    for i in range(4):
        for j in range(4):
            if i != j:
                weights[:, i] *= (at - corner[:, j]) / (corner[:, i] - corner[:, j])
    columns = stencil + 1
    if low.any():
        share = frequency[low] / first
        columns[low, 0], columns[low, 1] = 0, 1
        weights[low] = 0.0
        weights[low, 0], weights[low, 1] = 1 - share, share
    rows = np.repeat(np.arange(frequency.size), 4)
    return scipy.sparse.csr_array((weights.ravel(), (rows, columns.ravel())), shape=(frequency.size, nodes.size))
