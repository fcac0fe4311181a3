"""Frequencies at which a simulation computes responses, and the weights that carry its values to any other frequency.

Responses of film and rig are smooth in log frequency except near the clamp's resonance, so that the nodes are log-spaced and
dense there; between them a cubic runs through four nodes. One set of nodes serves all recordings of a rig, wherever its resonance may
turn out to be; once that is known, far fewer do (`fewer_nodes`).
"""

from __future__ import annotations

import math

import numpy as np
import scipy.sparse

from pipeline.physics.rig import rig_prior
from schemas.arrays import Complex, Float
from schemas.metadata import RigConstants

_LOWEST_HZ, _HIGHEST_HZ = 1e-4, 2e4
"""Lowest and highest frequency of nodes, Hz."""
_PER_DECADE = 24
"""Nodes per decade away from the resonance."""
_PER_WIDTH = 4.0
"""Nodes per half width of the lightest resonance that is expected."""
_RESONANCE = (0.75, 1.7)
"""Range about the clamp-alone frequency in which the resonance with a film may lie, with a clamp up to 1.7 times as heavy as stated."""
_GRADED = 0.06
"""Spacing over the distance from that range, both logarithmic: cubics then miss a pole there by 1e-5 of its part."""
POINTS = 8
"""Nodes that a polynomial runs through where they are few."""
_FEWER_PER_DECADE, _FEWER_PER_WIDTH, _FEWER_GRADED, _ABOUT = 20, 10.0, 0.1, 0.06
"""The same of few nodes about a resonance that is known, which stays within `_ABOUT` in log frequency if it is narrow."""
_NEEDED_PER_WIDTH = 7.0
"""Few nodes per half width of a resonance with which they still carry it."""


def response_nodes(rig: RigConstants) -> Float:
    """(J,) Hz ascending; the first is 0."""
    coarse = math.log(10) / _PER_DECADE
    end = math.log(_HIGHEST_HZ)
    start = math.log(_LOWEST_HZ)
    prior = rig_prior(rig)
    if prior is None or prior.nominal[0] <= 0:
        return np.concatenate([[0.0], np.exp(np.arange(start, end + coarse, coarse))])
    alone = math.log(prior.rig.clamp_omega / (2 * math.pi))
    low, high = alone + math.log(_RESONANCE[0]), alone + math.log(_RESONANCE[1])
    fine = prior.lightest_ratio / _PER_WIDTH
    return np.concatenate([[0.0], np.exp(_graded((start, end), (low, high), fine, coarse, _GRADED))])


def _graded(
    whole: tuple[float, float], dense: tuple[float, float], fine: float, coarse: float, grading: float
) -> Float:
    """Places (j,) from end to end, `fine` apart within `dense` and ever farther away from it, up to `coarse`."""
    x, (low, high) = [whole[0]], dense
    while x[-1] < whole[1]:
        # The distance is that of the next node where the range lies ahead.
        away = max(low - x[-1], x[-1] - high, 0.0)
        if x[-1] < low:
            away = max(0.0, (away - fine) / (1 + grading))
        x.append(x[-1] + min(coarse, fine + grading * away))
    return np.array(x)


def fewer_nodes(nodes: Float, impedance: Complex, ends: tuple[float, float]) -> Float:
    """(j,) Hz, ascending, between the ends: dense about the resonance of one film and rig, and towards it where it lies beyond an end.

    Parameters
    ----------
    nodes : (J,) Hz, of which the first may be 0, over any range that holds the ends
    impedance : (J,) 1 + (−Mω² + jωcL)/kL + k/kL at the nodes; its real part changes sign at the resonance. `carried` says of other
        films and rigs whether these nodes do for them, with polynomials through `POINTS` of them.
    ends : lowest and highest frequency that is needed, Hz; a lowest of 0 is a node
    """
    still = int(nodes[0] <= 0)
    x, z = np.log(nodes[still:]), impedance[still:]
    coarse = math.log(10) / _FEWER_PER_DECADE
    whole = (max(float(x[0]), math.log(ends[0])) if ends[0] > 0 else float(x[0])), math.log(ends[1])
    at = np.flatnonzero((z.real[:-1] > 0) != (z.real[1:] > 0))
    if at.size:
        i = int(at[0])
        width = abs(float(z.imag[i] * (x[i + 1] - x[i]) / (z.real[i + 1] - z.real[i])))
        middle = float(x[i])
        lightest = _PER_WIDTH * float(x[i + 1] - x[i])
        fine = min(max(width, lightest) / _FEWER_PER_WIDTH, coarse)
        found = _graded(whole, (middle - _ABOUT, middle + _ABOUT), fine, coarse, _FEWER_GRADED)
    else:
        found = np.arange(whole[0], whole[1] + coarse, coarse)
    return np.concatenate([np.zeros(int(ends[0] <= 0)), np.exp(found)])


class Elsewhere(Exception):
    """A resonance is narrower than few nodes carry it where it stands."""


def carried(impedance: Complex) -> None:
    """Raises `Elsewhere` where a resonance between few nodes is narrower than they need it, by (..., j) impedances at them.

    The real part changes sign at a resonance; its change from node to node there, over the imaginary part, is their distance in half
    widths.
    """
    real = impedance.real
    before, after = real[..., :-1], real[..., 1:]
    at = (after > 0) != (before > 0)
    change = after[at] - before[at]
    if np.any(_NEEDED_PER_WIDTH * np.abs(change) > np.abs(impedance.imag[..., 1:][at])):
        raise Elsewhere


def interpolation(nodes: Float, frequency: Float, points: int = 4) -> scipy.sparse.csr_array:
    """(m, J) weights that give values at (m,) Hz ≥ 0 from values at the nodes (J,): polynomials through that many nodes, in log
    frequency.

    Below the second node a straight line from the value at 0.
    """
    x, first = np.log(nodes[1:]), nodes[1]
    low = frequency < first
    at = np.log(np.maximum(frequency, first))
    left = np.clip(np.searchsorted(x, at, side="right") - points // 2, 0, x.size - points)
    stencil = left[:, None] + np.arange(points)
    corner = x[stencil]
    weights = np.ones((frequency.size, points))
    for i in range(points):
        for j in range(points):
            if i != j:
                weights[:, i] *= (at - corner[:, j]) / (corner[:, i] - corner[:, j])
    columns = stencil + 1
    if low.any():
        share = frequency[low] / first
        columns[low, 0], columns[low, 1] = 0, 1
        weights[low] = 0.0
        weights[low, 0], weights[low, 1] = 1 - share, share
    rows = np.repeat(np.arange(frequency.size), points)
    return scipy.sparse.csr_array((weights.ravel(), (rows, columns.ravel())), shape=(frequency.size, nodes.size))
