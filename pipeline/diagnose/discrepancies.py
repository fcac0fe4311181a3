"""What the plain simulation gets wrong, place by place, in numbers and words."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.diagnose import features
from pipeline.diagnose.extend import ExtendedFit
from pipeline.diagnose.results import Discrepancy
from pipeline.diagnose.session import Place, Session
from pipeline.diagnose.structure import block_probability

Float = NDArray[np.float64]

NOISE_SPREAD = 0.3
"""Relative standard deviation of a block's noise variance: short rests do not say it better."""
_WORDS = {
    features.CHIRP_RESPONSE: "the response F/x₀ of the sweep",
    features.CHIRP_HARMONIC: "the harmonics of the force in the sweep",
    features.CHIRP_LEVEL: "the mean force of the sweeps",
    features.SPHS_RESPONSE: "the response −F/V²",
    features.SPHS_DETECTION: "the lines that were not excited",
    features.SPHS_VOLTAGE: "the voltage over the command",
    features.SPHS_CAPACITANCE: "the capacitance over V²",
    features.CYCLIC_RESPONSE: "the response F/x₀ of the cycles",
    features.CYCLIC_HARMONIC: "the harmonics of the force of the cycles",
    features.CYCLIC_LEVEL: "the mean force of the cycles",
    features.CYCLIC_CAPACITANCE: "the capacitance of the cycles",
    features.STEP_FORCE: "the force after the edges of the voltage",
    features.STEP_CAPACITANCE: "the capacitance after the edges of the voltage",
    features.STEP_VOLTAGE: "the voltage after the edges of the command",
    features.RELAXATION_FORCE: "the force after the step of displacement",
    features.CYCLE_FORCE: "the force of the load–unload cycle",
    features.REST_HUM: "the mains in the rest",
    features.TAP_RING: "the clamp's ring after a tap",
    features.WEIGHT_GAIN: "the reading of the weights",
}
_PARTS = 3
"""Bands or spans of log time into which the features of a block are split."""
_SPLIT_FROM = 12


def discrepancies(fit: ExtendedFit) -> tuple[Discrepancy, ...]:
    """Every block of the session in its bands or spans of time, with χ² and a sentence; worst first.

    All are listed, also those within the noise: a page chooses by p-value, which counts the noise's own uncertainty.
    """
    session = fit.of.session
    simulated = fit.of.predict(fit.x)
    found = []
    for p in session.places:
        for where, rows in _spans(p):
            r = fit.misfit[p.first + rows]
            chi2 = float(r @ r)
            probability = block_probability(chi2, rows.size, NOISE_SPREAD)
            statement = _statement(session, p, rows, simulated[p.first + rows], where, probability)
            found.append(
                Discrepancy(
                    session.recordings[p.recording].recording_id, where, chi2, rows.size, probability, statement
                )
            )
    return tuple(sorted(found, key=lambda d: (d.p_value, -d.chi2 / d.degrees_of_freedom)))


def described(kind: str) -> str:
    """A kind of features in words."""
    return _WORDS[kind]


def _spans(p: Place) -> list[tuple[str, NDArray[np.int64]]]:
    """Label and rows of the parts of a block: bands for responses, spans of time for courses."""
    rows = np.arange(p.block.size)
    f, t = p.block.frequency_hz, p.block.time_s
    if p.block.size < _SPLIT_FROM:
        return [(p.block.label, rows)]
    if np.isfinite(f).all() and (f > 0).all() and np.ptp(np.log(f)) > 0:
        return [(f"{p.block.label}, {_range(f[own], 'Hz')}", own) for own in _split(np.log(f), rows)]
    if np.isfinite(t).all() and np.ptp(t) > 0:
        since = t - t.min()
        return [(f"{p.block.label}, {_range(since[own], 's')}", own) for own in _split(t, rows)]
    return [(p.block.label, rows)]


def _split(along: Float, rows: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    edges = np.linspace(along.min(), along.max(), _PARTS + 1)
    number = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, _PARTS - 1)
    return [rows[number == i] for i in range(_PARTS) if (number == i).any()]


def _range(values: Float, unit: str) -> str:
    low, high = float(values.min()), float(values.max())
    return f"{low:.3g} to {high:.3g} {unit}" if high > low * 1.0001 else f"{low:.3g} {unit}"


def _statement(
    session: Session, p: Place, rows: NDArray[np.int64], simulated: Float, where: str, probability: float
) -> str:
    """A sentence with size, sign where there is one, and how many times the noise."""
    value = p.block.value[rows]
    sd = session.sd[p.first + rows]
    difference = simulated - value
    rms = float(np.sqrt(np.mean((difference / sd) ** 2)))
    subject = f"{_WORDS[p.block.kind][0].upper()}{_WORDS[p.block.kind][1:]} ({where})"
    if probability > 0.01:
        return f"{subject} is simulated within the noise."
    if p.block.kind == features.REST_HUM:
        return f"{subject}: there is more power at the mains' frequency than in its neighbourhood."
    size = float(np.sqrt(np.mean(value**2)))
    relative = float(np.sqrt(np.mean(difference**2)) / size) if size > 0 else float("nan")
    mean = float(np.mean(difference / sd))
    lean = ""
    if abs(mean) > 0.7 * rms and not p.block.is_complex:
        lean = ", simulated too high" if mean * float(np.sign(np.mean(value))) > 0 else ", simulated too low"
    share = f"{_figure(100 * relative)} % of it" if relative < 3 else "more than there is"
    return f"{subject} is missed by {share}{lean}: {_figure(rms)} times the noise."


def _figure(value: float) -> str:
    """Two digits without powers of ten: "1.3", "27", "2700"."""
    rounded = float(f"{value:.2g}")
    return f"{rounded:.0f}" if rounded >= 10 else f"{rounded:g}"
