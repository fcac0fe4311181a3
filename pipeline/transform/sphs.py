"""Response to a periodic multisine: best linear approximation, noise, and the distortion that a linear film has not.

The electrical input is the square of the measured voltage, never the voltage and never the command. Periods are
transformed one by one; what differs between them is noise, what answers at lines that were not excited is distortion
(Pintelon and Schoukens, System Identification, 2nd ed., chapter 4). Sweeps belong to `chirp`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import fdtri

from pipeline.transform import local_polynomial, quality, sweeps
from pipeline.transform.averaging import SAME_AMPLITUDE
from pipeline.transform.channels import Drive, drive
from pipeline.transform.periodic import (
    BestLinear,
    best_linear_approximation,
    excited_lines,
    line_spectra,
    period_starts,
    smoothed,
    without_drift,
)
from pipeline.transform.response import Distortion, FrequencyResponse
from pipeline.transform.sampling import Sampled, sample, without_short_gaps
from pipeline.transform.spectrum import delay_between
from schemas.arrays import Bool, Complex, Float, Int
from schemas.errors import NotIdentifiableError, PremiseError
from schemas.protocols import ELECTRICAL
from schemas.recording import Recording

_SETTLED = 1e-3
"""Level of the test of a leading period against the late ones, for all leading periods together."""
_OTHER_EXCITATION = 0.1
"""Relative change of the input's power from one period to the next that begins another realisation."""
_NEIGHBOURS = 9
_FEWEST_LINES = 5


@dataclass(frozen=True)
class _Periods:
    """Spectra of the periods, (periods, bins) complex amplitudes, and where they are in the record (samples)."""

    input: Complex
    output: Complex
    starts: Int
    period: float
    drift: float


def sphs_response(recording: Recording) -> tuple[FrequencyResponse, tuple[Distortion, ...], tuple[str, ...]]:
    """Response at the excited lines of an `sphs` recording, its distortions, and warnings.

    Raises `NotIdentifiableError` for less than one period, an input without lines in the band, or a saturated output.
    """
    source = drive(recording)
    where = recording.metadata.recording_id
    warnings = list(quality.refuse_overload(recording, source))
    names = source.input.quantity, source.output.quantity
    sampled = sample({names[0]: source.input, names[1]: source.output}, recording.start_ns)
    warnings += sampled.notes
    high = recording.metadata.frequency_stop_hz or 0.4 / sampled.interval_s
    sampled, notes = without_short_gaps(sampled, high)
    warnings += notes
    periods, notes = _periods(recording, sampled, source, high)
    warnings += notes
    u, y = periods.input, periods.output
    period_s = periods.period * sampled.interval_s
    lines = _lines(recording, u, period_s)
    groups, dropped, notes = _settled(u, y, lines)
    warnings += notes
    _check_periodic(u[:, lines], groups, period_s, where)
    result = best_linear_approximation([u[g][:, lines] for g in groups], [y[g][:, lines] for g in groups])
    used = np.concatenate(groups)
    distortions, odd_power = _distortions(u, y, groups, lines, result, period_s, source.output_unit)
    variance, origin = _variance(result, u[used].mean(axis=0)[lines], y[used].mean(axis=0)[lines], lines, odd_power)
    if origin == "neighbouring lines":
        warnings.append("one period holds no noise variance: it is estimated from neighbouring lines")
    noise = result.noise_variance if np.isfinite(result.noise_variance).all() else None
    signal = np.abs(result.value) ** 2
    shape = _waveform(sampled, source, periods, used)
    response = FrequencyResponse(
        frequency_hz=lines / period_s,
        value=result.value,
        variance=variance,
        usable=np.isfinite(result.value),
        quantity=source.quantity,
        loading=source.loading,
        noise_variance=noise,
        coherence=None if noise is None else signal / (signal + used.size * noise),
        effective_lines=float(lines.size),
        repeats=int(used.size),
        amplitude=shape["input_amplitude"],
        recording_id=where,
        specimen_id=recording.metadata.specimen_id,
        details={
            "period_s": period_s,
            "lines": lines.tolist(),
            "realisations": len(groups),
            "periods": [int(g.size) for g in groups],
            "settling_periods": dropped,
            "variance_from": origin,
            "variance_degrees_of_freedom": result.degrees_of_freedom,
            "drift": periods.drift,
            "input_unit": source.input_unit,
            "output_unit": source.output_unit,
            **shape,
            **_amplifier(recording, periods, sampled, lines),
        },
    )
    response = quality.mark_mains(response)
    return quality.judged(response, sampled.band_hz), distortions, tuple(warnings)


def _periods(recording: Recording, sampled: Sampled, source: Drive, high: float) -> tuple[_Periods, list[str]]:
    """Spectra of all periods that have no gap; the period is refined from the phases between them."""
    metadata, notes = recording.metadata, []
    interval = sampled.interval_s
    x, finite = sampled.values[source.input.quantity], sampled.finite
    if not finite.any():
        raise NotIdentifiableError("no instant at which both channels have a value", where=metadata.recording_id)
    shown = x if finite.all() else np.where(np.isfinite(x), x, x[int(np.isfinite(x).argmax())])
    moving = sweeps.motion(shown)
    stated = None if metadata.period_s is None else metadata.period_s / interval
    period = stated if stated is not None else sweeps.find_period(shown[moving.first : moving.stop])
    if period is None:
        # Rest is at least a fiftieth of the record; less is an excitation that crosses its mean.
        at_ends = moving.first < 0.02 * shown.size and moving.stop > 0.98 * shown.size
        period = float(shown.size if at_ends else moving.stop - moving.first)
        notes.append("no period found: the whole excitation is taken as one")
    bins = int(np.clip(np.ceil(2.2 * high * period * interval) + 2, 2, max(period // 2, 2)))
    for _ in range(3):
        starts = _starts(moving, shown.size, period, interval, metadata.recording_id)
        found = _transformed(sampled, source, starts, float(starts[0]), period, bins, finite)
        step = _period_error(found.input, np.arange(bins) / period)
        if abs(step) < 0.02:
            break
        period += step
    if found.starts.size < starts.size:
        notes.append(f"{starts.size - found.starts.size} periods with gaps left out")
    if metadata.periods is not None and starts.size < metadata.periods:
        notes.append(f"{starts.size} whole periods found, the metadata give {metadata.periods}")
    return found, notes


def _starts(moving: sweeps.Motion, samples: int, period: float, interval_s: float, where: str) -> Int:
    """First samples of the whole periods of the excitation; rest before and after it is none."""
    onset = float(moving.first)
    # An excitation that begins near zero is seen a little late; a whole number of periods to the end tells.
    spare = (samples - onset) / period
    if np.ceil(spare) - spare < 0.05:
        onset = max(0.0, samples - np.ceil(spare) * period)
    count = int(np.floor((samples - onset) / period + 1e-6))
    if count < 1:
        raise NotIdentifiableError(
            f"the excitation lasts {spare:.3g} periods of {period * interval_s:.4g} s",
            where=where,
            expected="at least one whole period",
        )
    starts = period_starts(onset, period, count, samples)
    excited: Int = starts[(starts + 0.9 * period <= moving.stop) | (np.arange(starts.size) == 0)]
    return excited


def _transformed(
    sampled: Sampled,
    source: Drive,
    starts: Int,
    onset: float,
    period: float,
    bins: int,
    finite: Bool,
) -> _Periods:
    length = round(period)
    whole = np.array([bool(finite[s : s + length].all()) for s in starts])
    if not whole.any():
        raise NotIdentifiableError("every period of the excitation has a gap", expected="one period without a gap")
    starts = starts[whole]
    given, found = source.input.quantity, source.output.quantity
    x = sampled.values[given]
    force, drift = without_drift(sampled.values[found], starts, period)
    u = line_spectra(x * x if source.square else x, starts, onset, period, bins)
    y = line_spectra(force, starts, onset, period, bins)
    y = y * (source.sign * sampled.alignment(np.arange(bins) / (period * sampled.interval_s), found, given))
    return _Periods(u, y, starts, period, drift)


def _period_error(u: Complex, cycles_per_sample: Float) -> float:
    """Mean delay in samples from each period of the input to the next of the same excitation."""
    delays = []
    for before, after in zip(u[:-1, 1:], u[1:, 1:], strict=True):
        delay = delay_between(after, before, cycles_per_sample[1:])
        aligned = after * np.exp(2j * np.pi * cycles_per_sample[1:] * delay)
        if float(np.sum(np.abs(aligned - before) ** 2)) < _OTHER_EXCITATION * float(np.sum(np.abs(before) ** 2)):
            delays.append(delay)
    return float(np.mean(delays)) if delays else 0.0


def _lines(recording: Recording, u: Complex, period_s: float) -> Int:
    metadata = recording.metadata
    first = max(1, int(np.ceil((metadata.frequency_start_hz or 0.0) * period_s - 0.01)))
    stop = metadata.frequency_stop_hz
    last = u.shape[1] - 1 if stop is None else int(np.floor(stop * period_s + 0.01))
    size = np.sqrt((np.abs(u) ** 2).mean(axis=0))
    # Several periods tell excitation from noise; of a single one only the strong lines are believed.
    least = 1e-3 if u.shape[0] > 1 else 0.05
    lines = excited_lines(size, max(first, 1), last, kind=metadata.lines, least=least)
    if u.shape[0] > 1:
        error = np.sqrt((np.abs(u - u.mean(axis=0)) ** 2).sum(axis=0) / (u.shape[0] - 1) / u.shape[0])
        # Realisations differ in phase, which is no noise: compare with the rms, not with the mean.
        lines = lines[size[lines] > np.minimum(5 * error[lines], 0.99 * size[lines])]
    if lines.size < _FEWEST_LINES:
        raise NotIdentifiableError(
            f"the input excites {lines.size} lines between {first / period_s:.4g} and {last / period_s:.4g} Hz",
            where=metadata.recording_id,
            expected=f"at least {_FEWEST_LINES} lines of a multisine",
            remedy="Check that the drive was on and that period and band in the metadata are those of the test",
        )
    return lines


def _settled(u: Complex, y: Complex, lines: Int) -> tuple[list[Int], list[int], list[str]]:
    """Settled periods of each realisation (indices), how many were dropped from each, and notes.

    A new realisation begins where the input changes. Leading periods are dropped until one differs from the late ones
    by no more than the noise, which the late ones show.
    """
    x = u[:, lines]
    power = float(np.mean(np.sum(np.abs(x) ** 2, axis=1)))
    change = np.sum(np.abs(np.diff(x, axis=0)) ** 2, axis=1) > _OTHER_EXCITATION * power
    parts = np.split(np.arange(u.shape[0]), np.flatnonzero(change) + 1)
    longest = max(p.size for p in parts)
    groups, dropped, notes = [], [], []
    single = sum(part.size < 2 <= longest for part in parts)
    if single:
        notes.append(f"{single} single period{'s' * (single > 1)} between two excitations left out")
    for part in parts:
        if part.size < 2 <= longest:
            continue
        settled = _first_settled(x[part], y[part][:, lines])
        groups.append(part[settled:])
        dropped.append(settled)
    if longest == 2:
        notes.append("two periods cannot tell settling from noise: both are used")
    return groups, dropped, notes


def _check_periodic(u: Complex, groups: list[Int], period_s: float, where: str) -> None:
    """Raises `NotIdentifiableError` where the periods of the input (periods, lines) are not alike.

    Groups are the periods of each excitation: where every one is another, nothing repeats.
    """
    if u.shape[0] > 1 and max(group.size for group in groups) == 1:
        raise NotIdentifiableError(
            f"no two periods of {period_s:.4g} s of the input are alike",
            where=where,
            expected="a multisine that repeats itself",
            remedy="Correct period_s; a noise is of the protocol noise, a sweep of the protocol chirp",
        )
    for group in groups:
        mean = u[group].mean(axis=0)
        share = (u[group] @ mean.conj()).real / float(np.sum(np.abs(mean) ** 2))
        if np.abs(share - 1).max() > SAME_AMPLITUDE:
            raise PremiseError(
                f"the input goes from {100 * share.min():.0f} to {100 * share.max():.0f} % of its mean from period to period",
                where=where,
                expected="a multisine that repeats itself",
                remedy="Cut the recording into one for each amplitude",
            )


def _first_settled(u: Complex, y: Complex) -> int:
    periods, count = y.shape
    if periods < 3:
        return 0
    late: int = max(2, (periods + 1) // 2)
    g = y[-late:].mean(axis=0) / u[-late:].mean(axis=0)
    rest = y - g * u
    power = np.abs(rest[-late:] - rest[-late:].mean(axis=0)) ** 2
    noise = smoothed(power.sum(axis=0) / (late - 1))
    leading: int = periods - late
    # Smoothing over five lines multiplies the degrees of freedom, at most.
    limit = fdtri(2 * count, 2 * count * (late - 1), 1 - _SETTLED / leading)
    expected = np.maximum(noise * (1 + 1 / late), np.finfo(float).tiny)
    for p in range(leading):
        if float(np.mean(np.abs(rest[p] - rest[-late:].mean(axis=0)) ** 2 / expected)) <= limit:
            return p
    return leading


def _distortions(
    u: Complex, y: Complex, groups: list[Int], lines: Int, result: BestLinear, period_s: float, unit: str
) -> tuple[tuple[Distortion, ...], Float | None]:
    """Output at lines that were not excited, after taking off what the imperfect input puts there; noise beside it.

    Also returns the power at left-out odd lines beyond noise, brought to the excited lines: the stochastic nonlinearity
    that falls on them. None without such lines.
    """
    span = np.arange(1, min(int(lines[-1]) + 2, u.shape[1]))
    rest = np.setdiff1d(span, lines)
    sparse = bool((lines % 2 == 1).all())
    kinds = (("even", rest[rest % 2 == 0]), ("odd", rest[(rest % 2 == 1) & (rest > lines[0])])) if sparse else ()
    rows, odd_power = [], None
    at_lines = np.interp(rest, lines, result.value.real) + 1j * np.interp(rest, lines, result.value.imag)
    levels = np.array([np.abs((y[g][:, rest] - at_lines * u[g][:, rest]).mean(axis=0)) ** 2 for g in groups])
    level = dict(zip(rest.tolist(), np.sqrt(levels.mean(axis=0)).tolist(), strict=True))
    for kind, chosen in kinds:
        if chosen.size:
            values = np.array([level[int(k)] for k in chosen])
            rows.append(Distortion(kind, chosen / period_s, values, unit))
            if kind == "odd" and np.isfinite(result.output_noise).all():
                noise = np.interp(chosen, lines, result.output_noise) * len(groups)
                beyond = np.interp(lines, chosen, smoothed(values**2 - noise))
                odd_power = np.maximum(beyond, 0.0)
    if np.isfinite(result.output_noise).all():
        rows.append(Distortion("noise", lines / period_s, np.sqrt(result.output_noise), unit))
    return tuple(rows), odd_power


def _variance(result: BestLinear, u: Complex, y: Complex, lines: Int, odd_power: Float | None) -> tuple[Float, str]:
    """Whole variance of the response and where it comes from."""
    if np.isfinite(result.distortion_variance).all():
        return result.variance, "realisations"
    if np.isfinite(result.noise_variance).all():
        if odd_power is None:
            return result.variance, "periods"
        return result.variance + odd_power / np.abs(u) ** 2, "periods and left-out odd lines"
    fitted = local_polynomial.fit(u, y, local_polynomial.neighbours(lines, _NEIGHBOURS))
    return smoothed(fitted.noise) / np.abs(u) ** 2, "neighbouring lines"


def _waveform(sampled: Sampled, source: Drive, periods: _Periods, used: Int) -> dict[str, float]:
    """Amplitude, rms and crest factor of the alternating part of input and output over the settled periods."""
    at = periods.starts[used][:, None] + np.arange(round(periods.period))
    x = sampled.values[source.input.quantity][at].mean(axis=0)
    x = x * x if source.square else x
    x = x - x.mean()
    out = sampled.values[source.output.quantity][at].mean(axis=0)
    rms = float(np.sqrt(np.mean(x**2)))
    return {
        "input_amplitude": float(np.ptp(x)) / 2,
        "input_rms": rms,
        "output_rms": float(out.std()),
        "crest_factor": float(np.abs(x).max()) / rms,
    }


def _amplifier(recording: Recording, periods: _Periods, sampled: Sampled, lines: Int) -> dict[str, Any]:
    """What the amplifier does from command to monitored voltage, where the command was recorded."""
    command = recording.channels.get("command")
    if recording.metadata.loading != ELECTRICAL or command is None or command.values.size == 0:
        return {}
    both = sample({"voltage": recording.channels["voltage"], "command": command}, recording.start_ns)
    if not both.finite.all() or abs(both.interval_s / sampled.interval_s - 1) > 1e-9:
        return {}
    shift = round((both.start_s["voltage"] - sampled.start_s["voltage"]) / both.interval_s)
    starts = periods.starts - shift
    starts = starts[(starts >= 0) & (starts + round(periods.period) <= both.count)]
    if starts.size == 0:
        return {}
    bins = int(lines[-1]) + 1
    v, c = (
        line_spectra(both.values[q], starts, float(starts[0]), periods.period, bins).mean(axis=0)
        for q in ("voltage", "command")
    )
    frequency = np.arange(bins) / (periods.period * both.interval_s)
    v = v * both.alignment(frequency, "voltage", "command")
    strong = lines[np.abs(c[lines]) > 0.1 * np.abs(c[lines]).max()]
    ratio = v[strong] / c[strong]
    return {
        "amplifier_frequency_hz": frequency[strong].tolist(),
        "amplifier_gain_kv_per_v": np.abs(ratio).tolist(),
        "amplifier_phase_deg": np.degrees(np.angle(ratio)).tolist(),
        "amplifier_delay_s": delay_between(v[strong], c[strong], frequency[strong]),
    }
