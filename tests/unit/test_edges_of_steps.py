"""What is not known of an edge between two samples counts as noise of what rings after it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from pipeline.diagnose.features.step import edge_covariance

FINE = 64
"""Times per sample at which the clamp is followed."""
WINDOWS = [(102, 104), (104, 107), (107, 111), (111, 118), (118, 130), (130, 160)]


def ring(voltage: np.ndarray, hz: float, damping: float = 0.02) -> np.ndarray:
    """The force on a clamp that rings at `hz` per sample, to a voltage squared at the fine times."""
    w = 2 * np.pi * hz / FINE
    decay, turn = np.exp(-damping * w), np.cos(w * np.sqrt(1 - damping**2))
    back = np.array([1, -2 * decay * turn, decay**2])
    return np.asarray(lfilter([back.sum()], back, voltage))


@pytest.mark.parametrize("hz", [0.02, 0.05, 0.08])
@pytest.mark.parametrize("lag", [0.02, 0.4, 1.0])
def test_an_edge_between_two_samples_leaves_no_more_than_it_is_known_to(hz: float, lag: float) -> None:
    """Of a clamp that rings a sound session left ten times its noise, and was said to have something else wrong with it."""
    rows = np.zeros((len(WINDOWS), 160))
    for row, (a, b) in zip(rows, WINDOWS, strict=True):
        row[a:b] = 1 / (b - a)
    fine = np.arange(160 * FINE)
    left = []
    for late in np.arange(4) / 4 + 1 / 8:
        since = fine - (100 + late) * FINE
        made = np.where(since > 0, -np.expm1(-np.maximum(since, 0) / (lag * FINE)), 0.0)
        between = np.interp(fine, fine[::FINE], made[::FINE])
        output, simulated = (ring(v, hz)[::FINE] for v in (made, between))
        covariance = edge_covariance(rows, output, np.ones(len(rows)), 1 / np.sqrt(12)) + 3e-3**2 * np.eye(len(rows))
        missed = rows @ (output - simulated)
        left.append(missed @ np.linalg.solve(covariance, missed) / len(rows))
    assert np.mean(left) < 1.0
