"""Mains in the noise of a session: components of every block, silent until the hum of the force is known.

A hum is not locked to the drive, so that it raises the variance of all that is read off the force. Each block knows what a
sinusoid at a line of the mains, of amplitude 1 and of any phase, would add to its covariance; how strong it is only the rest tells.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from pipeline.diagnose.features.functionals import Component
from schemas.arrays import Float

MAINS_HZ = (50.0, 60.0)
"""Frequencies of the mains, Hz: which of them a laboratory has, its rests tell."""
HUM_HZ = tuple(n * f for f in MAINS_HZ for n in (1, 2))
"""Mains and their first harmonics, Hz."""
_LEAST_GAIN = 1e-3
"""Gain of a filter below which the mains do not pass it."""


def mains_of(gain: Callable[[Float], Float] | None = None) -> tuple[Component, ...]:
    """Components of the mains that `gain` (f in Hz → what is left of a sinusoid) lets pass."""
    return tuple(
        Component(_quantity(f), 0, gain, f)
        for f in HUM_HZ
        if gain is None or float(gain(np.array([f]))[0]) > _LEAST_GAIN
    )


def mains_components(amplitude_n: Mapping[float, float]) -> dict[str, float]:
    """Coefficients of the components by quantity, N², from amplitudes in N by frequency in Hz, one of `HUM_HZ` each.

    A hum of amplitude a at 50 Hz and b at 100 Hz that all recordings of a rig have is `{"mains50": a², "mains100": b²}`: with
    `NoiseLaw(np.full(recordings, a²), 0.0, 0.0)` under `(rig, "mains50")` in its laws a session whitens accordingly. Raises
    KeyError for other frequencies.
    """
    known = {f: _quantity(f) for f in HUM_HZ}
    return {known[f]: a**2 for f, a in amplitude_n.items()}


def _quantity(frequency_hz: float) -> str:
    return f"mains{frequency_hz:.0f}"
