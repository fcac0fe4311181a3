"""Where a linear simulation of a system's records is wrong: in bands about its resonance, and by how large the output
is.

Does not belong here: why (`system_mechanisms`).
"""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from pipeline.diagnose.results import Discrepancy
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.single.system_mechanisms import SystemQuestion
from schemas.arrays import Float

_BANDS = (
    (0.0, 0.7, "below its resonance"),
    (0.7, 1.4, "about its resonance"),
    (1.4, 2.5, "about twice its resonance"),
    (2.5, 3.5, "about three times its resonance"),
    (3.5, np.inf, "above that"),
)
"""Bands over the resonance: lower and upper end, and in words."""
_WINDOWS = 30
"""Stretches of a record that are sorted by the output."""
_THIRDS = ("where the output is smallest", "where it is middling", "where it is largest")


def list_system_discrepancies(question: SystemQuestion) -> tuple[Discrepancy, ...]:
    """Bands of frequency, and thirds of a record by its output, in which the linear simulation is wrong; worst first.

    χ² of a band is that of its spectral lines, two values each; that of a third, of its samples.

    Parameters
    ----------
    question : with the plain simulation of all records
    """
    found = []
    plain = question.simulations[0]
    for name, times, y, simulated, compared in zip(
        question.names, question.times, question.measured_outputs, plain.outputs, plain.compared, strict=True
    ):
        interval = float(times[1] - times[0])
        found += _test_bands(name, interval, y[compared], simulated[compared], question)
        found += _test_levels(name, y[compared], simulated[compared], question)
    return tuple(
        sorted((d for d in found if d.p_value < RULES.single.place_level), key=lambda d: -d.chi2 / d.degrees_of_freedom)
    )


def _test_bands(name: str, interval: float, y: Float, simulated: Float, question: SystemQuestion) -> list[Discrepancy]:
    resonance = question.angular_frequency / 2 / np.pi
    frequency = np.fft.rfftfreq(y.size, interval)[1:]
    measured, error = (2 * np.abs(np.fft.rfft(x)[1:]) ** 2 / y.size for x in (y, simulated - y))
    found = []
    for low, high, words in _BANDS:
        inside = (frequency >= low * resonance) & (frequency < high * resonance)
        if inside.any():
            last = min(high * resonance, float(frequency[-1]))
            where = f"{low * resonance:.3g} to {last:.3g} Hz"
            found.append(_make_discrepancy(name, where, words, measured[inside], error[inside], 2, question.sd))
    return found


def _test_levels(name: str, y: Float, simulated: Float, question: SystemQuestion) -> list[Discrepancy]:
    windows = np.array_split(np.arange(y.size), _WINDOWS)
    order = np.argsort([float(np.std(y[w])) for w in windows])
    found = []
    for words, third in zip(_THIRDS, np.array_split(order, len(_THIRDS)), strict=True):
        chosen = np.concatenate([windows[i] for i in third])
        largest = float(np.abs(y[chosen]).max() / question.amplitude)
        where = f"outputs up to {100 * largest:.0f} % of the largest"
        found.append(
            _make_discrepancy(name, where, words, y[chosen] ** 2, (simulated - y)[chosen] ** 2, 1, question.sd)
        )
    return found


def _make_discrepancy(
    name: str, where: str, words: str, measured: Float, error: Float, each: int, sd: float
) -> Discrepancy:
    """measured, error : (n,) squares, of `each` values"""
    square, freedom = float(error.sum()) / sd**2, each * error.size
    share = 100 * float(np.sqrt(error.sum() / measured.sum()))
    text = f"{words} ({where}), the linear simulation is wrong by {share:.2g} % of the output there"
    return Discrepancy(name, where, square, freedom, float(chi2.sf(square, freedom)), text)
