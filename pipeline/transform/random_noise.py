"""Frequency response of a system driven by noise: averaged cross spectra, H1 with its variance and coherence, H2 beside it.

The record is cut into overlapping pieces under Hann windows. Neighbouring bins are averaged to about 100 lines, so that a
slow line is one bin of many pieces and a fast one many bins.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import fftconvolve

from pipeline.transform import quality
from pipeline.transform.channels import drive
from pipeline.transform.response import FrequencyResponse
from pipeline.transform.sampling import Sampled, runs, sample, without_short_gaps
from schemas.arrays import Complex, Float, Int
from schemas.errors import NotIdentifiableError
from schemas.recording import Recording

LINES = 100
PIECES = 16
"""Pieces side by side; with those that overlap them by half there are 31."""
_LEAST_PIECE, _FEWEST_PIECES = 64, 8
_SPILLED = 5.0
"""Times what side lobes may bring that a line must show: white noise shows 16 times that, the lines of a tone alone no more than it."""
_FIRST_BIN = 3
"""A Hann window spreads the level over the bins 0 to 2."""
_HIGHEST = 0.8
"""Share of half the sample rate up to which filters and clocks of usual loggers are trusted."""
_OVERLAP = 1 / 36
"""Squared correlation of the spectra of two pieces of noise that overlap by half, Hann (Welch 1967)."""
_NEXT_BIN, _SECOND_BIN = 4 / 9, 1 / 36
"""The same of neighbouring bins of one piece, and of bins two apart."""


def noise_response(recording: Recording) -> tuple[FrequencyResponse, tuple[str, ...]]:
    """Response of a `noise` recording.

    Parameters
    ----------
    recording : its channels of input and output

    Returns
    -------
    FrequencyResponse
        H1 = S_uy/S_uu at up to 100 lines, with coherence γ²; `details["h2_over_h1"]` is 1/γ² per line, by which noise on the
        input alone would have made H1 too small
    tuple of str
        warnings

    Raises
    ------
    NotIdentifiableError
        records that are too short, saturated, or without five lines of coherence

    Notes
    -----
    E|ΔH1|² = |H1|² (1 − γ²)/(γ² (n − 1)) with n independent averages (Bendat and Piersol, Random Data, 4th ed., eq 9.92).
    """
    source = drive(recording)
    warnings = list(quality.refuse_overload(recording, source))
    names = source.input.quantity, source.output.quantity
    sampled = sample({names[0]: source.input, names[1]: source.output}, recording.start_ns)
    sampled, found = without_short_gaps(sampled, _HIGHEST * 0.5 / sampled.interval_s)
    warnings += [*sampled.notes, *found]
    present = int(np.count_nonzero(sampled.finite))
    count = present // PIECES
    if count < _LEAST_PIECE:
        raise NotIdentifiableError(
            f"{present} samples of noise are too few for {PIECES} pieces",
            expected=f"at least {PIECES * _LEAST_PIECE} samples of both channels",
        )
    starts, found = _place_pieces(sampled, count)
    warnings += found
    u, y = (_spectra(sampled.values[name], starts, count) for name in names)
    edges = _edges(recording, count, sampled.interval_s)
    suu, syy = (np.add.reduceat((np.abs(s) ** 2).sum(axis=0), edges)[:-1] for s in (u, y))
    suy = np.add.reduceat((u.conj() * y).sum(axis=0), edges)[:-1]
    size = np.diff(edges)
    frequency = (edges[:-1] + (size - 1) / 2) / (count * sampled.interval_s)
    tiny = np.finfo(float).tiny
    value = source.sign * suy / np.maximum(suu, tiny) * sampled.alignment(frequency, names[1], names[0])
    coherence = np.abs(suy) ** 2 / np.maximum(suu * syy, tiny)
    n = _independent(starts, count, size)
    variance = np.abs(value) ** 2 * (1 - coherence) / np.maximum(coherence * (n - 1), tiny)
    response = FrequencyResponse(
        frequency_hz=frequency,
        value=value,
        variance=variance,
        usable=np.isfinite(value) & np.isfinite(variance) & (suu > 0),
        quantity=source.quantity,
        loading=source.loading,
        coherence=coherence,
        effective_lines=float(frequency.size),
        recording_id=recording.metadata.recording_id,
        specimen_id=recording.metadata.specimen_id,
        details={
            "h2_over_h1": (1 / np.maximum(coherence, tiny)).tolist(),
            "averages": n.tolist(),
            "input_unit": source.input_unit,
            "output_unit": source.output_unit,
        },
    )
    spilled = np.add.reduceat(_spill((np.abs(u) ** 2).sum(axis=0)), edges)[:-1]
    response = response.mark(
        suu < _SPILLED * spilled, "no excitation: the input shows no more than its windows spread from stronger lines"
    )
    tones = quality.find_tones((np.abs(u) ** 2).mean(axis=0))
    held = np.add.reduceat(tones.astype(float), edges)[:-1] > 0
    response = response.mark(held, quality.STEADY_TONE)
    return quality.judged(response, sampled.band_hz), tuple(warnings)


def _place_pieces(sampled: Sampled, count: int) -> tuple[Int, list[str]]:
    """(pieces,) first samples of pieces that overlap by half and hold no gap; a warning where that costs samples."""
    used = np.zeros(sampled.count, dtype=bool)
    starts = [
        first + np.arange(0, stop - first - count + 1, count // 2)
        for first, stop in runs(sampled.finite)
        if stop - first >= count
    ]
    placed = np.concatenate(starts) if starts else np.empty(0, dtype=np.int64)
    if placed.size < _FEWEST_PIECES:
        raise NotIdentifiableError(
            f"{placed.size} pieces of {count * sampled.interval_s:.3g} s fit between the gaps",
            expected=f"at least {_FEWEST_PIECES}",
        )
    for first in placed:
        used[first : first + count] = True
    lost = 1 - float(np.mean(used))
    gaps = not sampled.finite.all()
    return placed, [f"gaps: pieces lie between them, {100 * lost:.2g} % of the record is not used"] if gaps else []


def _spectra(values: Float, starts: Int, count: int) -> Complex:
    """(pieces, bins) spectra of pieces of `count` samples, each without its straight line."""
    pieces = values[starts[:, None] + np.arange(count)]
    line = np.vander(np.linspace(-1, 1, count), 2)
    pieces = pieces - (pieces @ np.linalg.pinv(line).T) @ line.T
    return np.asarray(np.fft.rfft(pieces * np.hanning(count + 1)[:-1], axis=1))


def _spill(power: Float) -> Float:
    """(bins,) power that a Hann window spreads to each bin from all others but its neighbours, at most.

    A tone lies up to half a bin beside the bin that shows it; side lobes: Harris 1978.
    """
    away = np.arange(2, power.size) - 0.5
    lobes = np.zeros(power.size)
    lobes[2:] = (np.pi * away * (away**2 - 1)) ** -2.0
    return np.asarray(fftconvolve(power, np.concatenate([lobes[:0:-1], lobes]), mode="same"))


def _edges(recording: Recording, count: int, interval_s: float) -> Int:
    """First bins of the lines and the end of the last, spaced by equal ratios where bins allow; within the stated band."""
    step = 1 / (count * interval_s)
    about = recording.metadata
    first, last = _FIRST_BIN, int(_HIGHEST * count / 2)
    if about.frequency_start_hz:
        first = max(first, int(np.ceil(about.frequency_start_hz / step)))
    if about.frequency_stop_hz:
        last = min(last, int(about.frequency_stop_hz / step))
    if last - first < 5:
        raise NotIdentifiableError(
            f"the band holds {max(last - first, 0)} lines {step:.3g} Hz apart", expected="at least 5: a longer record"
        )
    return np.unique(np.round(np.geomspace(first, last + 1, LINES + 1)).astype(np.int64))


def _independent(starts: Int, count: int, size: Int) -> Float:
    """(lines,) averages that are independent of each other, of overlapping pieces and neighbouring bins."""
    overlaps = int(np.count_nonzero(np.diff(starts) < count))
    over_time = starts.size / (1 + 2 * _OVERLAP * overlaps / starts.size)
    near = _NEXT_BIN * (size - 1) + _SECOND_BIN * np.maximum(size - 2, 0)
    return np.asarray(over_time * size / (1 + 2 * near / size))
