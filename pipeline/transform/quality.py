"""What makes lines of a response unusable, and recordings unfit for one: clipping, noise of the output, missing excitation.

Noise on the input draws an estimate towards zero, which no residual shows; so lines at which the input stands neither above its
own noise nor above a hundredth of what it has elsewhere are no response, however small their standard error.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter1d

from pipeline.transform import local_polynomial
from pipeline.transform.channels import Drive
from pipeline.transform.response import FrequencyResponse
from pipeline.transform.sampling import Sampled
from pipeline.transform.sweeps import Slices
from schemas.arrays import Bool, Complex, Float, Int
from schemas.errors import NotIdentifiableError
from schemas.recording import Channel, Recording

WORST_RELATIVE_ERROR = 0.3
"""Standard error over magnitude beyond which a line is noise."""
LEAST_COHERENCE = 0.5
_FEWEST_LINES = 5
_AT_RANGE = 0.999
_FLAT = 8.0
"""So many times more samples at the extreme than one converter step below are a flat top; a sine has 2.4 times."""
_FEWEST_FLAT = 20
_LONGEST_RUN = 3


def flat_tops(values: Float, resolution: float | None = None) -> Bool:
    """Samples (n,) that sit on a flat top: at one extreme value far more often than just below it, several in a row.

    A flat bottom near zero is a slack film, not a converter at its end, and is not reported.
    """
    found = np.zeros(values.shape, dtype=bool)
    high, low = float(np.fmax.reduce(values)), float(np.fmin.reduce(values))
    largest = max(abs(high), abs(low))
    for sign, top in ((1.0, high), (-1.0, -low)):
        if not top > 0.01 * largest:
            continue
        near = np.flatnonzero(sign * values > top - 0.01 * largest)
        if near.size < _FEWEST_FLAT:
            continue
        step = resolution or _step(sign * values[near], 0.0)
        if not 0 < step < 0.005 * largest:
            # A converter so coarse that its last step is all that lies near the top: look as far below as it takes.
            step = max(resolution or 0.0, _step(sign * values[np.isfinite(values)], 1e-6 * largest))
            near = np.flatnonzero(sign * values > top - max(0.01 * largest, 2.5 * step))
        signed = sign * values[near]
        at = near[signed > top - step / 2]
        below = int(np.count_nonzero(signed > top - 1.5 * step)) - at.size
        if at.size < _FEWEST_FLAT or at.size <= _FLAT * below:
            continue
        breaks = np.flatnonzero(np.diff(at) > 1)
        if np.diff(np.concatenate([[-1], breaks, [at.size - 1]])).max() >= _LONGEST_RUN:
            found[at] = True
    return found


def _step(values: Float, least: float) -> float:
    """Step of the converter as values near the top show it."""
    levels = np.unique(values)
    return float(np.diff(levels[-50:]).min()) if levels.size > 1 else least


def overloaded(force: Channel, limit: float | None) -> Bool:
    """Samples (n,) beyond the load cell's range `limit` (N, None unknown) or on a flat top."""
    return _at_limit(force.values, force.resolution, limit)


def _at_limit(values: Float, resolution: float | None, limit: float | None) -> Bool:
    found = flat_tops(values, resolution)
    if limit is not None:
        found |= (values >= _AT_RANGE * limit) | (values <= -_AT_RANGE * limit)
    return found


def refuse_overload(recording: Recording, source: Drive, *, most: float = 0.001) -> tuple[str, ...]:
    """Warning for a few overloaded samples; raises `NotIdentifiableError` when more than the share `most` are."""
    bad = overloaded(source.output, _limit(recording, source))
    share = float(bad.mean())
    if share == 0:
        return ()
    level = float(np.nanmax(np.abs(source.output.values[bad])))
    text = f"{100 * share:.2g} % of the samples of {source.output.quantity} are at the limit of {level:.4g}"
    if share > most:
        raise NotIdentifiableError(
            f"the load cell is saturated: {text}" if source.output.quantity == "force" else f"saturated: {text}",
            where=recording.metadata.recording_id,
            expected="a signal within the range of its sensor",
            remedy="Repeat the test with a smaller amplitude or a larger load cell",
        )
    return (text,)


def mark_clipped_sweep(
    response: FrequencyResponse,
    recording: Recording,
    source: Drive,
    sampled: Sampled,
    pieces: Slices,
    low: float,
    high: float,
) -> FrequencyResponse:
    """Marks the lines that the sweep passes while the output is clipped.

    Raises `NotIdentifiableError` when that is more than half of them.
    """
    bad = _at_limit(sampled.values[source.output.quantity], source.output.resolution, _limit(recording, source))
    if not bad.any():
        return response
    clipped = np.zeros(response.frequency_hz.shape, dtype=bool)
    start, stop = recording.metadata.frequency_start_hz, recording.metadata.frequency_stop_hz
    down = start is not None and stop is not None and start > stop
    kinds = (recording.metadata.sweep,) if recording.metadata.sweep else ("linear", "log")
    active = max(pieces.length - pieces.rest_before - pieces.rest_after, 1)
    for first in pieces.first:
        where = np.flatnonzero(bad[first : first + pieces.length])
        progress = np.clip((where - pieces.rest_before) / active, 0.0, 1.0)
        progress = np.unique(np.rint((1 - progress if down else progress) * 1000)) / 1000
        for kind in kinds:
            passed = low * (high / low) ** progress if kind == "log" else low + (high - low) * progress
            near = np.abs(response.frequency_hz[:, None] / passed[None, :] - 1).min(axis=1, initial=np.inf)
            clipped |= near < 0.03
    if clipped.mean() > 0.5:
        raise NotIdentifiableError(
            f"the load cell is saturated during {100 * clipped.mean():.0f} % of the sweep",
            where=recording.metadata.recording_id,
            expected="a force within the range of the load cell",
            remedy="Repeat the test with a smaller amplitude or a larger load cell",
        )
    return response.mark(clipped, "clipped: the output was at its limit while the sweep passed here")


def judged(response: FrequencyResponse, band_hz: float) -> FrequencyResponse:
    """Marks what lies beyond the clock's band, in the noise or without coherence.

    Raises `NotIdentifiableError` when fewer than five lines (all of them, where there are fewer) remain.
    """
    response = response.mark(response.frequency_hz > band_hz, f"above {band_hz:.4g} Hz, which the sampling carries")
    relative = response.standard_error / np.maximum(np.abs(response.value), np.finfo(float).tiny)
    response = response.mark(relative > WORST_RELATIVE_ERROR, "noise: standard error above 30 % of the response")
    if response.coherence is not None:
        response = response.mark(response.coherence < LEAST_COHERENCE, f"coherence below {LEAST_COHERENCE:g}")
    lines, left = response.frequency_hz.size, int(response.usable.sum())
    if left < min(_FEWEST_LINES, lines):
        reasons = Counter(r for text in response.unusable_because for r in text.split("; ") if r)
        worst, count = reasons.most_common(1)[0]
        raise NotIdentifiableError(
            f"{left} of {lines} lines are usable; {count} are not because of: {worst}",
            where=response.recording_id or "",
            expected=f"at least {min(_FEWEST_LINES, lines)} usable lines",
            remedy="Check that the input was driven in the stated band and that the output was connected",
        )
    return response


def _limit(recording: Recording, source: Drive) -> float | None:
    return recording.rig.load_cell_range_n if source.output.quantity == "force" else None


_WEAK_INPUT = 0.1
"""Input spectrum below this share (−20 dB) of its median in the band is no excitation."""
_TONE, _TONE_BINS = 20.0, 2
"""A bin of the input with so many times the power of every bin of its window that is further away than this is a tone; what leaks
from it there is at most a fiftieth, and the ripple of a sweep's spectrum is a factor of four."""
STEADY_TONE = "no excitation: a steady tone stands above what was driven"
"""Why a line is not used in which a tone, as of the mains, stands above what the input excites."""
_NOISE_TONE, _NOISE_TONE_BINS, _NOISE_AROUND = 5.0, 2, 12
"""The same of the mean over many pieces of noise, whose bins scatter by less: so many times the largest of as many bins on each side, but for
those that a window of Hann spreads a tone to."""
_MAINS_HZ, _MAINS_HARMONICS, _MAINS_WITHIN = (50.0, 60.0), 10, 0.004
"""Mains, harmonics of them, and share by which their frequency wanders at most (EN 50160: 1 % for 99.5 % of a year, 0.2 Hz as a rule)."""
_MAINS_BESIDE, _MAINS_OFF, _MAINS_OVER = 4, 6.0, 3.0
"""Lines on each side of a mains line that tell its value; standard deviations beyond which it is off, and how many times more than the largest
that is missed so around it, as near a resonance."""
_NOISY_INPUT = 0.1
"""Share of noise in the power of the input (−10 dB) from which on it is no excitation."""
_FEWEST_AT_REST = 64
_FEWEST_BINS = 5


def window_power(spectrum: Complex, lines: Int, half_width: Int) -> Float:
    """Mean |U|² over the windows, (L,)."""
    window = local_polynomial.windows(lines, half_width, spectrum.size)
    return np.asarray((np.abs(spectrum[window.index] * window.inside) ** 2).sum(axis=1) / window.inside.sum(axis=1))


def input_noise(x: Float, pieces: Slices, band: tuple[float, float], interval_s: float, count: int) -> float:
    """E|U|² per bin of what the input shows in the band while it rests before the sweep, for a piece of `count` samples.

    0 where there is too little rest to tell.
    """
    first = pieces.first[0]
    rest = x[first : first + pieces.rest_before * 3 // 4]
    rest = rest[np.isfinite(rest)]
    if rest.size < _FEWEST_AT_REST:
        return 0.0
    power = np.abs(np.fft.rfft(rest - rest.mean())) ** 2
    frequency = np.fft.rfftfreq(rest.size, interval_s)
    inside = (frequency > 0) & (frequency >= band[0]) & (frequency <= band[1])
    chosen = inside if inside.sum() >= _FEWEST_BINS else frequency > 0
    return float(power[chosen].mean()) / rest.size * count


def mark_tones(response: FrequencyResponse, spectrum: Complex, lines: Int, half_width: Int) -> FrequencyResponse:
    """Marks lines in whose window one bin of the input stands far above all others: a steady tone, as of the mains.

    A sweep excites neighbouring bins alike. A tone on input and output is coherent, and its ratio is no response.

    Parameters
    ----------
    spectrum : (bins,) of the input
    lines, half_width : (L,) bins of the lines, and bins on each side that their windows hold
    """
    window = local_polynomial.windows(lines, half_width, spectrum.size)
    power = np.abs(spectrum[window.index] * window.inside) ** 2
    peak = power.argmax(axis=1)
    beside = np.abs(np.arange(power.shape[1]) - peak[:, None]) > _TONE_BINS
    others = np.where(beside, power, 0.0).max(axis=1)
    return response.mark(power.max(axis=1) > _TONE * others, STEADY_TONE)


def find_tones(power: Float) -> Bool:
    """Bins of the mean power spectrum of a noise in which a steady tone stands, with those that its window spreads it to.

    Parameters
    ----------
    power : (bins,) of the input, mean over pieces under a window of Hann

    Returns
    -------
    (bins,)
    """
    padded = np.pad(power, _NOISE_AROUND)
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * _NOISE_AROUND + 1)
    beside = np.abs(np.arange(-_NOISE_AROUND, _NOISE_AROUND + 1)) > _NOISE_TONE_BINS
    is_tone = power > _NOISE_TONE * around[:, beside].max(axis=1)
    # What is slow beside a piece leaks into the first bins, which have no neighbours below.
    is_tone[: _NOISE_TONE_BINS + 1] = False
    return np.asarray(maximum_filter1d(is_tone.astype(np.uint8), 2 * _NOISE_TONE_BINS + 1) > 0)


def mark_mains(response: FrequencyResponse) -> FrequencyResponse:
    """Marks lines of a multisine at mains frequencies whose value stands off the course of the lines beside it.

    Mains that fall on a line are the same in every period, so that no scatter shows them. A film's response is smooth from line to line: what a
    parabola through the neighbours misses at a mains line is held against what such parabolas miss around it.

    Parameters
    ----------
    response : at ascending lines of a multisine
    """
    f, g = response.frequency_hz, response.value
    if f.size < 2 * _MAINS_BESIDE + 3:
        return response
    spacing = np.gradient(f)
    near = np.zeros(f.size, dtype=bool)
    for mains in _MAINS_HZ:
        turns = np.maximum(np.rint(f / mains), 1.0)
        near |= (np.abs(f - mains * turns) < np.maximum(0.5 * spacing, _MAINS_WITHIN * f)) & (turns <= _MAINS_HARMONICS)
    missed, expected = np.full(f.size, np.nan), np.full(f.size, np.nan)
    for i in range(f.size):
        beside = np.arange(max(i - _MAINS_BESIDE, 0), min(i + _MAINS_BESIDE + 1, f.size))
        # Of other mains lines nothing is learned.
        beside = beside[(beside != i) & ~near[beside]]
        if beside.size < 4:
            continue
        x = (f[beside] - f[i]) / np.ptp(f[beside])
        at_zero = np.linalg.pinv(np.vander(x, 3))[2]
        missed[i] = abs(g[i] - at_zero @ g[beside])
        expected[i] = np.sqrt(response.variance[i] + at_zero**2 @ response.variance[beside])
    off = np.zeros(f.size, dtype=bool)
    for i in np.flatnonzero(near & np.isfinite(missed)).tolist():
        around = np.arange(max(i - 2 * _MAINS_BESIDE, 0), min(i + 2 * _MAINS_BESIDE + 1, f.size))
        others = missed[around[~near[around]]]
        usual = float(np.nanmax(others)) if np.isfinite(others).any() else 0.0
        off[i] = missed[i] > max(_MAINS_OFF * expected[i], _MAINS_OVER * usual)
    return response.mark(off, "mains: the line stands off the lines beside it, which the mains do not touch")


def mark_weak(
    response: FrequencyResponse, spectrum: Complex, lines: Int, half_width: Int, noise: float
) -> FrequencyResponse:
    """Marks lines that the input does not excite; what its noise takes from the others goes into the variance.

    Noise on the input draws the estimate towards zero by its share of the power, which no residual shows.
    """
    power = window_power(spectrum, lines, half_width)
    share = noise / np.maximum(power, np.finfo(float).tiny)
    bias = np.abs(response.value) ** 2 * np.minimum(share, 1.0) ** 2
    response = replace(response, variance=response.variance + bias)
    response = response.mark(share > _NOISY_INPUT, "no excitation: the input is not 10 dB above its own noise")
    return response.mark(
        power < _WEAK_INPUT**2 * np.median(power), "no excitation: input 20 dB below its median in the band"
    )
