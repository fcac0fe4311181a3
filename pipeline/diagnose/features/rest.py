"""Features of the rest: mains in the force; and of calibrations: the clamp's ring and the weights.

Mains are not locked to the drive, so that no line of a response shows them; the rest does. z = Φ⁻¹(p) of the power at a line of
the mains (50 or 60 Hz, and twice that) against that of its neighbourhood is standard normal without mains, whatever the noise is.
"""

from __future__ import annotations

import numpy as np
from scipy.special import fdtrc, fdtri, ndtr, ndtri

from pipeline.diagnose.features.blocks import UNIT_NOISE, assembled
from pipeline.diagnose.features.kinds import (
    FILED_RING_HZ,
    REST_HUM,
    RING_HZ,
    TAP_RING,
    WEIGHT_GAIN,
    FeatureBlock,
)
from pipeline.diagnose.features.records import find_converter_step, rest_samples
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.simulation.mains import HUM_HZ
from pipeline.transform.calibration import describe_contradiction, read_ring, weigh
from pipeline.transform.channels import drive
from pipeline.transform.sampling import sample
from schemas.arrays import Float
from schemas.recording import Recording

_NEAR, _FAR = 2, 14
"""Bins beside that of the mains that are its neighbourhood."""
_FEWEST = 12
"""Fewest bins of a neighbourhood that says how strong the noise is."""
_EXACT_Z = 4.0
"""Score up to which the null distribution is exact; beyond it the score grows as the amplitude over its noise."""
_HIGHEST_Z = 300.0
"""Largest score: more says no more."""
_BEFORE_S = 0.05
"""Time before an input begins that is no rest any more, s."""
_ROUNDING = 1e-12
"""Share of a channel's largest value below which what varies is rounding."""


def hum_block(recording: Recording) -> FeatureBlock | None:
    """Mains in the force before the test begins; None without such a rest, or sampled too slowly."""
    source = drive(recording)
    sampled = sample({source.input.quantity: source.input, source.output.quantity: source.output}, recording.start_ns)
    given = np.nan_to_num(
        sampled.values[source.input.quantity], nan=float(np.nanmean(sampled.values[source.input.quantity]))
    )
    stop = rest_samples(given, back=int(_BEFORE_S / sampled.interval_s))
    y = sampled.values[source.output.quantity][:stop]
    if not np.isfinite(y).all() or y.size * sampled.interval_s < RULES.features.hum_rest:
        return None
    n = np.arange(y.size) * sampled.interval_s
    largest = float(np.abs(y).max())
    y = y - np.polynomial.polynomial.polyval(n, np.polynomial.polynomial.polyfit(n, y, 2))
    step = find_converter_step(source.output.values)
    if float(np.abs(y).max()) <= max(_ROUNDING * largest, step):
        return None  # a rest without noise, or one that the converter hides, has no neighbourhood to hold the mains against
    z, variance, freedom = [], [], []
    for f in HUM_HZ:
        # Off-centre bins on both sides of the mains' own: the same transform, moved by whole bins; none near another line.
        step = 1 / (y.size * sampled.interval_s)
        offsets = np.concatenate([-np.arange(_NEAR, _FAR + 1), np.arange(_NEAR, _FAR + 1)]) * step
        others = np.array([other for other in HUM_HZ if other != f])
        apart = np.abs(f + offsets[:, None] - others).min(axis=1) > _NEAR * step
        # Hann bins share data with their neighbours, two thirds are independent.
        freedom.append(2 * float(apart.sum()) / 1.5)
        if f + offsets.max() > 0.45 / sampled.interval_s or f + offsets.min() < 2 * step or apart.sum() < _FEWEST:
            z.append(np.nan)
            variance.append(np.nan)
            continue
        window = 1 - np.cos(2 * np.pi * (np.arange(y.size) + 0.5) / y.size)
        turns = np.exp(-2j * np.pi * np.outer(np.concatenate([[0.0], offsets[apart]]) + f, n))
        amplitude = turns @ (y * window) * 2 / y.size
        power = np.abs(amplitude) ** 2
        near = float(power[1:].mean())
        z.append(float(_score(np.array(power[0] / near), np.array(freedom[-1]))))
        variance.append(near)
    known = np.isfinite(z)
    if not known.any():
        return None
    return assembled(
        REST_HUM,
        "rest before the test",
        np.array(z)[known],
        (UNIT_NOISE,),
        np.eye(int(known.sum()))[None],
        is_complex=False,
        frequency=np.array(HUM_HZ)[known],
        time=stop * sampled.interval_s / 2,
        support={"variance": np.array(variance)[known], "freedom": np.array(freedom)[known]},
    )


def _score(ratio: Float, freedom: Float) -> Float:
    """Standard normal score of the power of a line over the mean of its neighbours, for lines of noise.

    Φ⁻¹ of its F distribution up to a score of 4. From there on it grows by 1 where the amplitude grows by its own standard
    deviation, so that the score of strong mains has the standard deviation 1 as well (Rice distribution).
    """
    most = fdtri(2, freedom, ndtr(_EXACT_Z))
    amplitude = np.sqrt(2 * np.maximum(ratio, 0.0))
    exact = -ndtri(fdtrc(2, freedom, np.minimum(ratio, most)))
    beyond = np.maximum(amplitude - np.sqrt(2 * most), 0.0)
    return np.asarray(np.clip(exact + beyond, -_HIGHEST_Z, _HIGHEST_Z))


def hum_score(amplitude_n: Float, variance: Float, freedom: Float) -> Float:
    """Middle score of mains of that amplitude N (n,), 0 for none, beside noise of that variance of a line, N² (n,), which is known with
    so many degrees of freedom (n,)."""
    return _score(np.asarray(amplitude_n) ** 2 / variance + fdtri(2, freedom, 0.5), freedom)


def calibration_blocks(recording: Recording) -> tuple[list[FeatureBlock], dict[str, float], list[str]]:
    """The ring of the clamp (ln of its frequency in Hz, damping ratio) or the gain of the force channel, with values and warnings.

    A ring that contradicts the rig's file is no feature, for nothing can be simulated with such a file: its values say so.
    """
    values: dict[str, float] = {}
    if recording.metadata.protocol == "tap":
        found = read_ring(recording)
        if found.contradicts_file:
            values = {RING_HZ: found.frequency_hz, FILED_RING_HZ: found.expected_hz}
            return [], values, [describe_contradiction(found.frequency_hz, found.expected_hz)]
        value = np.array([np.log(found.frequency_hz), found.damping_ratio])
        variance = np.array(
            [(found.frequency_sd / found.frequency_hz) ** 2 + _REPEATABLE**2, found.damping_ratio_sd**2]
        )
        kind, label = TAP_RING, f"{found.taps} taps"
    else:
        weighed = weigh(recording)
        value = np.array([weighed.gain])
        variance = weighed.gain_sd**2 + (RULES.features.weight_sd * value) ** 2
        kind, label = WEIGHT_GAIN, f"{weighed.plateaus} levels"
    return [assembled(kind, label, value, (UNIT_NOISE,), np.diag(variance)[None], is_complex=False)], values, []


_REPEATABLE = 5e-4
"""Relative: how well the clamp's frequency repeats when a film is mounted, whose own mass moves with the clamp."""
