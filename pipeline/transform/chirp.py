"""Frequency response of a sweep, from a single one or from synchronised repeats, with its variance.

Single sweep: local polynomials over the spectrum of the whole record (`local_polynomial`). Repeats: the spectra are brought
to the same instant, averaged, and the scatter between repeats is the noise; H = ⟨Y⟩/⟨U⟩, never a mean of ratios. The
first repeat is compared with the later ones. Of a sweep of voltage the input is the square of what was measured: it sweeps twice
the frequency, and the frequency itself where the voltage has a bias. Periodic multisines belong to `sphs`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d

from pipeline.transform import local_polynomial, quality, repeats, sweeps
from pipeline.transform.channels import Drive, drive
from pipeline.transform.local_polynomial import LocalFit
from pipeline.transform.quality import input_noise, mark_tones, mark_weak, window_power
from pipeline.transform.response import FrequencyResponse
from pipeline.transform.sampling import Sampled, runs, sample, without_short_gaps
from pipeline.transform.spectrum import delay_between, length_for, low_bins, ramp_bins
from schemas.arrays import Bool, Complex, Float, Int
from schemas.errors import NotIdentifiableError
from schemas.recording import Recording

LINES = 100
HALF_WIDTH, SHORT_HALF_WIDTH = 12, 6
_ENOUGH_LINES = 40
"""Fewer lines than this with windows of ±12 bins: take ±6."""
_FEWEST_LINES = 5
_BIASED = 0.02
"""Bias over amplitude of a voltage from which its square also sweeps the frequency of the voltage itself."""
_REST_BESIDE_A_GAP = 25.0
"""So many times longer than elsewhere the input has to stand still beside a gap to be at rest: half a period of the lowest frequency,
through which no sweep stands still."""
_BEGINS_WITHIN, _ENDS_WITHIN = "the record begins within the sweep", "the record ends with the sweep"


@dataclass(frozen=True)
class _Spectra:
    """Spectra of the repeats, (repeats, bins) complex; bin k is at k/`duration_s`."""

    input: Complex
    output: Complex
    duration_s: float
    delays_s: Float
    drift: Float


def chirp_response(recording: Recording) -> tuple[FrequencyResponse, tuple[str, ...]]:
    """Response of a `chirp` recording at about 100 log-spaced lines, and warnings.

    Lines are at least 2n + 1 bins apart and therefore independent; a short record has fewer. Raises
    `NotIdentifiableError` for records that are too short, not excited, or without an unbroken sweep.
    """
    source = drive(recording)
    names = source.input.quantity, source.output.quantity
    sampled = sample({names[0]: source.input, names[1]: source.output}, recording.start_ns)
    warnings = list(sampled.notes)
    bands = _bands(recording, sampled, source)
    low, high = bands[0][0], bands[-1][1]
    if source.square:
        sampled = replace(sampled, values={**sampled.values, names[0]: sampled.values[names[0]] ** 2})
    finite = sampled.finite
    if not finite.all():
        sampled, found = without_short_gaps(sampled, high)
        warnings += found
        finite = sampled.finite
    pieces, amplitude, found = _pieces(recording, sampled, finite, names, low)
    warnings += found
    if pieces is None:
        response, amplitude, found = _broken(recording, sampled, source, bands)
        warnings += found
        return quality.judged(_named(response, recording, source, amplitude), sampled.band_hz), tuple(warnings)
    if len(pieces.first) == 1:
        piece = sampled.part(pieces.first[0], pieces.first[0] + pieces.length)
        response, found = _single(piece, pieces, source, low, high)
    else:
        response, found = _repeated(sampled, pieces, source, low, high)
    warnings += found
    response = _named(response, recording, source, amplitude)
    for begin, end in bands:
        response = quality.mark_clipped_sweep(response, recording, source, sampled, pieces, begin, end)
    return quality.judged(response, sampled.band_hz), tuple(warnings)


def _named(response: FrequencyResponse, recording: Recording, source: Drive, amplitude: float) -> FrequencyResponse:
    about = recording.metadata
    amplitude_of_input = None if source.square else amplitude
    return replace(
        response, recording_id=about.recording_id, specimen_id=about.specimen_id, amplitude=amplitude_of_input
    )


def _broken(
    recording: Recording, sampled: Sampled, source: Drive, bands: Sequence[tuple[float, float]]
) -> tuple[FrequencyResponse, float, list[str]]:
    """The response of a sweep that gaps cut, from its unbroken parts: each gives the frequencies that it sweeps itself.

    A gap so costs what it touches. Where several parts sweep a frequency the longest gives it. Also returns the amplitude of the input.
    Raises `NotIdentifiableError` where no part gives a response.
    """
    low, high = bands[0][0], bands[-1][1]
    finite = sampled.finite
    x = sampled.values[source.input.quantity]
    level = float(x[int(np.argmax(np.isfinite(x)))])
    parts = sorted(runs(finite), key=lambda part: part[0] - part[1])
    amplitude = sweeps.motion(np.where(np.isfinite(x), x, level)).amplitude
    found: list[tuple[int, FrequencyResponse]] = []
    warnings: list[str] = []
    failed: NotIdentifiableError | None = None
    used = 0
    for first, stop in parts:
        piece = sampled.part(first, stop)
        pieces = _rest_of(x[first:stop], level, amplitude)
        cut = first > 0, stop < finite.size
        try:
            response, said = _single(piece, pieces, source, low, high, cut=cut)
        except NotIdentifiableError as error:
            failed = failed or error
            continue
        swept = response.frequency_hz
        for begin, end in bands:
            inside = max(begin, float(swept[0])), min(end, float(swept[-1]))
            if inside[0] < inside[1]:
                response = quality.mark_clipped_sweep(response, recording, source, piece, pieces, *inside)
        new = np.ones(swept.size, dtype=bool)
        for _, other in found:
            new &= (swept < other.frequency_hz[0]) | (swept > other.frequency_hz[-1])
        if new.any():
            found.append((first, _with_lines(response, new)))
            warnings += [text for text in said if text not in warnings]
            used += stop - first
    if not found:
        raise failed or NotIdentifiableError("no unbroken part of the sweep")
    warnings.append(
        f"{len(parts) - 1} gaps cut the sweep: {len(found)} unbroken parts are used, each for the frequencies that it sweeps;"
        f" {100 * (1 - used / finite.size):.2g} % of the record is not"
    )
    return _joined([response for _, response in sorted(found, key=lambda one: one[0])]), amplitude, warnings


def _rest_of(x: Float, level: float, amplitude: float) -> sweeps.Slices:
    """An unbroken part as one sweep; rest counts as rest only at the level from which the film started."""
    part = sweeps.motion(x)
    before = part.first if abs(float(x[0]) - level) < 0.02 * amplitude else 0
    return sweeps.Slices((0,), x.size, before, x.size - part.stop, float(x.size))


_LISTED = ("half_width", "degree", "degrees_of_freedom")
"""Details that have a value for each line."""


def _with_lines(response: FrequencyResponse, chosen: Bool) -> FrequencyResponse:
    """The chosen lines, with what the details say of them."""
    listed = {name: np.array(response.details[name])[chosen].tolist() for name in _LISTED}
    return replace(response.select(chosen), details={**response.details, **listed})


def _joined(parts: Sequence[FrequencyResponse]) -> FrequencyResponse:
    """Responses of parts of one sweep, in the order of time, as one in the order of frequency."""
    order = np.argsort(np.concatenate([part.frequency_hz for part in parts]))

    def join(values: Iterable[Any]) -> Any:
        return np.concatenate([np.asarray(one) for one in values])[order]

    first, last = parts[0].details, parts[-1].details
    details = {
        **first,
        **{name: join(part.details[name] for part in parts).tolist() for name in _LISTED},
        "transient": any(part.details["transient"] for part in parts),
        "rest_after_s": last["rest_after_s"],
        "drift_per_s": [drift for part in parts for drift in part.details["drift_per_s"]],
    }
    return replace(
        parts[0],
        frequency_hz=join(part.frequency_hz for part in parts),
        value=join(part.value for part in parts),
        variance=join(part.variance for part in parts),
        usable=join(part.usable for part in parts),
        unusable_because=tuple(str(one) for one in join(part.unusable_because for part in parts)),
        effective_lines=float(order.size),
        details=details,
    )


def _bands(recording: Recording, sampled: Sampled, source: Drive) -> list[tuple[float, float]]:
    """Bands in Hz that the physical input sweeps, ascending: V = b + a sin φ squared holds 2ab sin φ and −a²/2 cos 2φ."""
    low, high = _band(recording, sampled, source)
    if not source.square:
        return [(low, high)]
    nyquist = 0.5 / sampled.interval_s
    voltage = sampled.values[source.input.quantity]
    voltage = voltage[np.isfinite(voltage)]
    bias, amplitude = float(voltage.max() + voltage.min()) / 2, float(np.ptp(voltage)) / 2
    twice = min(2 * low, nyquist), min(2 * high, nyquist)
    return [(low, high), twice] if abs(bias) > _BIASED * amplitude else [twice]


def _band(recording: Recording, sampled: Sampled, source: Drive) -> tuple[float, float]:
    """Excited band in Hz from the metadata, or from the spectrum of the input where they are silent."""
    nyquist = 0.5 / sampled.interval_s
    low, high = recording.metadata.frequency_start_hz, recording.metadata.frequency_stop_hz
    if low is not None and high is not None and low > high:
        low, high = high, low
    if low == 0:  # no record tells of less than one turn
        low = 1 / (sampled.count * sampled.interval_s)
    if low is None or high is None:
        x = np.nan_to_num(sampled.values[source.input.quantity] - np.nanmean(sampled.values[source.input.quantity]))
        power = np.abs(np.fft.rfft(x)) ** 2
        # A linear sweep has a flat power, a logarithmic one falls with 1/f: the root of f is fair to both.
        power *= np.sqrt(np.arange(power.size))
        smooth = uniform_filter1d(power, max(1, power.size // 2000))
        strong = runs(smooth >= 0.05 * np.median(smooth[smooth > 0.05 * smooth.max()]))
        first, stop = max(strong, key=lambda r: float(power[r[0] : r[1]].sum()))
        step = 1 / (x.size * sampled.interval_s)
        low = low if low is not None else max(first, 1) * step
        high = high if high is not None else (stop - 1) * step
    if low >= nyquist:
        raise NotIdentifiableError(
            f"the sweep from {low:g} to {high:g} Hz lies above half the sample rate, {nyquist:g} Hz"
        )
    return low, min(high, nyquist)


def _pieces(
    recording: Recording, sampled: Sampled, finite: Bool, names: tuple[str, str], low: float
) -> tuple[sweeps.Slices | None, float, list[str]]:
    """The repeats of the record without those that have gaps; None where none is whole.

    Also returns the amplitude of the input (half peak to peak).
    """
    metadata = recording.metadata
    warnings: list[str] = []
    x, whole = sampled.values[names[0]], bool(finite.all())
    if not finite.any():
        raise NotIdentifiableError(f"no instant at which both {names[0]} and {names[1]} have a value")
    level = float(x[int(np.argmax(np.isfinite(x)))])
    shown = x if whole else np.where(np.isfinite(x), x, level)
    moving = sweeps.motion(shown)
    period = None if metadata.period_s is None else metadata.period_s / sampled.interval_s
    pieces = sweeps.slices(
        shown, moving, period=period, repeats=metadata.repeats, least_rest=1 / (low * sampled.interval_s)
    )
    if metadata.repeats is not None and metadata.repeats > len(pieces.first):
        warnings.append(f"{len(pieces.first)} whole repeats found, the metadata give {metadata.repeats}")
    if pieces.leftover:
        warnings.append("the record ends within a further sweep, which is left out")
    if whole:
        return pieces, moving.amplitude, warnings
    unbroken = tuple(first for first in pieces.first if finite[first : first + pieces.length].all())
    if unbroken:
        warnings.append(f"{len(pieces.first) - len(unbroken)} repeats with gaps left out")
        return replace(pieces, first=unbroken), moving.amplitude, warnings
    return None, moving.amplitude, warnings


def _lines(duration_s: float, low: float, high: float, interval_s: float) -> tuple[Int, Int]:
    """Bins and half widths of the lines; raises when the record is too short for them."""
    first, last = max(low * duration_s, 1.0), high * duration_s
    last = min(last, 0.5 * duration_s / interval_s - SHORT_HALF_WIDTH)
    for half_width in (HALF_WIDTH, SHORT_HALF_WIDTH):
        if last - first > 2 * half_width:
            lines, widths = local_polynomial.log_lines(first, last, wanted=LINES, half_width=half_width)
            if lines.size >= (_ENOUGH_LINES if half_width == HALF_WIDTH else _FEWEST_LINES):
                return lines, widths
    needed = _FEWEST_LINES * (2 * SHORT_HALF_WIDTH + 1) / max(high - low, 1e-12)
    raise NotIdentifiableError(
        f"the sweep of {duration_s:.3g} s is too short for a response from {low:g} to {high:g} Hz",
        expected=f"at least {needed:.3g} s for {_FEWEST_LINES} independent lines",
    )


def _spectra(sampled: Sampled, pieces: sweeps.Slices, source: Drive, bins: int) -> _Spectra:
    """Spectra of every piece, freed of a straight drift of the rest level and brought to the instant of the first."""
    names = source.input.quantity, source.output.quantity
    used = length_for(pieces.length, bins)
    # Samples are left out of the rest only, and not of a period.
    whole = pieces.continuous or pieces.length - used > pieces.rest_after // 4
    used = pieces.length if whole else used
    duration = used * sampled.interval_s
    frequency = np.arange(bins) / duration
    align = source.sign * sampled.alignment(frequency, names[1], names[0])
    shape = len(pieces.first), bins
    u, y = np.empty(shape, dtype=complex), np.empty(shape, dtype=complex)
    drifts = np.zeros(shape[0])
    for p, first in enumerate(pieces.first):
        x, force = (sampled.values[q][first : first + used] for q in names)
        drift = _drift(force, pieces, used)
        u[p] = low_bins(x, bins, whole=whole)
        y[p] = low_bins(force, bins, whole=whole)
        if drift:
            y[p] -= drift * ramp_bins(used, bins)
        y[p] *= align
        drifts[p] = drift / sampled.interval_s
    delays = np.zeros(shape[0])
    for p in range(1, shape[0]):
        delays[p] = delay_between(u[p], u[0], frequency)
        back = np.exp(2j * np.pi * frequency * delays[p])
        u[p] *= back
        y[p] *= back
    return _Spectra(u, y, duration, delays, drifts)


def _drift(y: Float, pieces: sweeps.Slices, used: int) -> float:
    """Slope per sample between the rest levels before and after the sweep, 0 where it is not significant.

    Of the rest after the sweep the last half counts: the film relaxes in the first. Of the rest before it the first half
    counts: the sweep begins before it is seen to move.
    """
    after = pieces.rest_after - (pieces.length - used)
    if min(pieces.rest_before, after) < 32:
        return 0.0
    head, tail = y[: pieces.rest_before // 2], y[used - after // 2 :]
    change = float(tail.mean() - head.mean())
    error = np.sqrt(_mean_variance(head) + _mean_variance(tail))
    if abs(change) < 4 * error:
        return 0.0
    return change / (used - after / 4 - pieces.rest_before / 4)


def _mean_variance(values: Float) -> float:
    """Variance of a mean of correlated samples, from the means of eight blocks."""
    blocks = values[: values.size // 8 * 8].reshape(8, -1).mean(axis=1)
    return float(blocks.var(ddof=1)) / 8


def _reach(lines: Int, widths: Int, length: int) -> int:
    return int(min((lines + widths).max() + 2, length // 2 + 1))


def _single(
    sampled: Sampled,
    pieces: sweeps.Slices,
    source: Drive,
    low: float,
    high: float,
    *,
    cut: tuple[bool, bool] = (False, False),
) -> tuple[FrequencyResponse, list[str]]:
    """Of one sweep. `cut`: whether a gap stands before and behind it."""
    x, y = (sampled.values[q] for q in (source.input.quantity, source.output.quantity))
    ends = _unsettled_ends(x, y, pieces, 0.02 / (low * sampled.interval_s), cut)
    stated = low, high
    low, high = _swept(x, sampled.interval_s, {why for why, _ in ends}, stated)
    lines, widths = _lines(pieces.length * sampled.interval_s, low, high, sampled.interval_s)
    bins = _reach(lines, widths, pieces.length)
    at_zero = replace(pieces, first=(0,))
    spectra = _spectra(sampled, at_zero, source, bins)
    # A state that is off by Δ at an end of the record leaves a spectrum of about Δ/|1 − e^{−jωh}|.
    size = np.sqrt(sum(square for _, square in ends))
    scale = size / np.abs(np.expm1(-2j * np.pi * lines / y.size)) if ends else None
    fitted = local_polynomial.adaptive_fit(spectra.input[0], spectra.output[0], lines, widths, transient_scale=scale)
    warnings = [f"{why}: the transient is part of the estimate, which is less certain for it" for why, _ in ends]
    response = _response(source, spectra, lines, fitted, pieces, sampled.interval_s, transient=scale is not None)
    if ends:
        near = _cut_off(spectra.input[0], lines, fitted.half_width)
        if any(cut):
            duration = pieces.length * sampled.interval_s
            own = low if low > stated[0] else 0.0, high if high < stated[1] else np.inf
            near |= (lines - fitted.half_width < own[0] * duration) | (lines + fitted.half_width > own[1] * duration)
        response = response.mark(near, "the record begins or ends while the sweep passes here")
    noise = input_noise(x, at_zero, (low, high), sampled.interval_s, y.size)
    response = mark_tones(response, spectra.input[0], lines, fitted.half_width)
    return mark_weak(response, spectra.input[0], lines, fitted.half_width, noise), warnings


def _swept(x: Float, interval_s: float, ends: set[str], band: tuple[float, float]) -> tuple[float, float]:
    """The part of a band that a cut sweep passed: beyond it is what leaks from the cut end, which is no response."""
    first, last = (turns / interval_s for turns in sweeps.end_frequencies(x))
    low, high = band
    for cut, here, away in ((_BEGINS_WITHIN in ends, first, last), (_ENDS_WITHIN in ends, last, first)):
        if cut and low < here < high:
            low, high = (low, here) if here > away else (here, high)
    return low, high


def _cut_off(spectrum: Complex, lines: Int, half_width: Int) -> Bool:
    """Lines (L,) that the sweep passes so near to an end of the record that the window does not resolve the two.

    When the sweep passes is told by the slope of its phase, as a share of the record.
    """
    window = local_polynomial.windows(lines, half_width, spectrum.size)
    near = spectrum[window.index] * window.inside
    turn = np.angle((near[:, 1:] * near[:, :-1].conj()).sum(axis=1))
    passed = np.mod(-turn / (2 * np.pi), 1.0)
    return np.asarray(np.minimum(passed, 1 - passed) < 0.5 / half_width)


def _unsettled_ends(
    x: Float, y: Float, pieces: sweeps.Slices, least_rest: float, cut: tuple[bool, bool]
) -> list[tuple[str, float]]:
    """Ends of a record at which the film is not at rest, in words, with the mean square by which the output is off."""
    ends = []
    edge = max(8, y.size // 50)
    least = max(8.0, least_rest)
    level = float(y.mean())
    # A sweep begins at its middle, and the film at rest; a record that was cut out of a sweep begins anywhere.
    before, after = (least * _REST_BESIDE_A_GAP if beside else least for beside in cut)
    off = abs(float(x[0] - x.mean())) > 0.02 * float(x.max() - x.min())
    if pieces.rest_before < before and (cut[0] or off):
        ends.append((_BEGINS_WITHIN, float(np.mean((y[:edge] - level) ** 2))))
    if pieces.rest_after < after:
        ends.append((_ENDS_WITHIN, float(np.mean((y[-edge:] - level) ** 2))))
    if pieces.rest_after < 5 * least:
        return ends
    # One quarter of the rest against another: a film that still relaxes has not come to rest.
    rest = y[y.size - pieces.rest_after :]
    middle, last = rest[rest.size // 4 : rest.size // 2], rest[rest.size * 3 // 4 :]
    left = abs(float(middle.mean() - last.mean()))
    if left > max(0.01 * float(y.max() - y.min()), 5 * np.sqrt(_mean_variance(middle) + _mean_variance(last))):
        ends.append(("the film does not come to rest after the sweep", left**2))
    return ends


def _repeated(
    sampled: Sampled, pieces: sweeps.Slices, source: Drive, low: float, high: float
) -> tuple[FrequencyResponse, list[str]]:
    warnings: list[str] = []
    lines, widths = _lines(pieces.length * sampled.interval_s, low, high, sampled.interval_s)
    bins = _reach(lines, widths, pieces.length)
    spectra = _spectra(sampled, pieces, source, bins)
    step = float(np.mean(np.diff(spectra.delays_s))) / sampled.interval_s
    if pieces.continuous and abs(step) > 0.05:
        # Without rest the pieces must be whole periods: the phases between them tell the period better than anything.
        pieces = sweeps.periods(sampled.count, pieces.first[0], pieces.period + step, len(pieces.first))
        spectra = _spectra(sampled, pieces, source, bins)
    used = np.arange(len(pieces.first))
    details: dict[str, Any] = {}
    if pieces.continuous and used.size > 2:
        used = used[1:]
        warnings.append("the repeats follow each other without rest: the first, in which the film settles, is left out")
    fits = [
        local_polynomial.fit(spectra.input[p], spectra.output[p], local_polynomial.windows(lines, widths, bins))
        for p in used
    ]
    result, noise = repeats.synchronised(spectra.input[used], spectra.output[used], lines, widths)
    if used.size > 1:
        changed = repeats.first_against_later(fits, noise)
        details["first_repeat"] = changed
        details["repeat_gain"], details["repeat_gain_sd"] = repeats.repeat_gains(fits, result)
        if changed["p_value"] < repeats.CHANGED:
            percent = 100 * changed["relative_difference"]
            text = f"the first repeat differs from the later ones by {percent:.2g} % (p = {changed['p_value']:.1g})"
            if used.size > 2:
                used = used[1:]
                result, noise = repeats.synchronised(spectra.input[used], spectra.output[used], lines, widths)
                changed["left_out"] = True
                text += " and is left out of the average"
            warnings.append(text)
    response = _response(source, spectra, lines, result, pieces, sampled.interval_s, transient=False)
    single = noise.noise * used.size
    signal = np.abs(response.value) ** 2 * window_power(spectra.input[used].mean(axis=0), lines, result.half_width)
    response = replace(
        response,
        noise_variance=noise.variance,
        coherence=signal / (signal + single),
        repeats=int(used.size),
        details={**response.details, **details, "repeat_delay_s": [float(d) for d in spectra.delays_s]},
    )
    x = sampled.values[source.input.quantity]
    mean = spectra.input[used].mean(axis=0)
    floor = input_noise(x, pieces, (low, high), sampled.interval_s, pieces.length) / used.size
    response = mark_tones(response, mean, lines, result.half_width)
    return mark_weak(response, mean, lines, result.half_width, floor), warnings


def _response(
    source: Drive,
    spectra: _Spectra,
    lines: Int,
    fitted: LocalFit,
    pieces: sweeps.Slices,
    interval_s: float,
    *,
    transient: bool,
) -> FrequencyResponse:
    return FrequencyResponse(
        frequency_hz=lines / spectra.duration_s,
        value=fitted.value,
        variance=fitted.variance,
        usable=np.isfinite(fitted.value) & np.isfinite(fitted.variance),
        quantity=source.quantity,
        loading=source.loading,
        effective_lines=float(lines.size),
        details={
            "half_width": fitted.half_width.tolist(),
            "degree": fitted.degree.tolist(),
            "degrees_of_freedom": fitted.degrees_of_freedom.tolist(),
            "transient": transient,
            "rest_before_s": pieces.rest_before * interval_s,
            "rest_after_s": pieces.rest_after * interval_s,
            "drift_per_s": [float(d) for d in spectra.drift],
            "input_unit": source.input_unit,
            "output_unit": source.output_unit,
        },
    )
