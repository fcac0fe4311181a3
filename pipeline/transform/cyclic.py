"""Response of a sinusoid at one frequency: harmonics by least squares, cycle by cycle and over the settled ones.

The samples keep their own times: no common clock is needed, and jitter or lost samples do no harm. Other periodic signals
belong to `sphs`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pipeline.transform import quality
from pipeline.transform.averaging import SAME_AMPLITUDE
from pipeline.transform.channels import Drive, drive
from pipeline.transform.harmonics import Harmonics, harmonics, refined_frequency, slow_terms
from pipeline.transform.response import Distortion, FrequencyResponse
from pipeline.transform.sampling import seconds
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError, PremiseError
from schemas.numbers import ordinal
from schemas.recording import Channel, Recording

SETTLING_CYCLES = 2
_FEWEST_CYCLES = 3
_UNSEEN = 0.15
"""Share of a cycle that may be missing at the ends of the motion."""
_NEVER_STILL = 0.1
"""Least over largest amplitude of cycles that are those of a sinusoid, and no noise or another frequency."""
_SINUSOID = 0.05
"""Largest harmonic of an input, over its fundamental, that is still called a sinusoid."""
_ONE_LINE, _FEWEST_SAMPLES = 0.9, 16
"""Share of the power at one line of a spectrum, of so many samples at least, from which the input is a sinusoid of that frequency."""
_MOST_CYCLES = 100
"""Cycles that are evaluated one by one, evenly spread where there are more."""


def cyclic_response(
    recording: Recording,
) -> tuple[FrequencyResponse, tuple[Distortion, ...], tuple[str, ...]]:
    """Response at the frequency of a `cyclic` recording, its harmonics, and warnings.

    Whole cycles after the first two are used, as few as one. Each channel is fitted with the harmonics 1 to 5 and with
    slow terms, drift and what is left of the film's start; the frequency is refined on the input first, because a
    crosshead is rarely exact. `noise_variance` has the noise alone, `variance` also what the choice of the slow terms
    changes. Raises
    `NotIdentifiableError` for fewer than three cycles, for no motion and for a saturated force.
    """
    source, origin = drive(recording), recording.start_ns
    where = recording.metadata.recording_id
    warnings = list(quality.refuse_overload(recording, source))
    t_x, x = seconds(source.input, origin)
    t_y, y = seconds(source.output, origin)
    frequency, begin, end = _cycles(t_x, x, recording)
    found_cycles = (min(end, float(t_y[-1])) - begin) * frequency
    # A cycle that begins and ends at its lowest point is hardly seen to move there.
    whole = int(np.floor(found_cycles + _UNSEEN))
    begin -= max(0.0, whole - found_cycles) / 2 / frequency
    if whole < _FEWEST_CYCLES:
        raise NotIdentifiableError(
            f"{whole} whole cycles at {frequency:.4g} Hz", where=where, expected=f"at least {_FEWEST_CYCLES}"
        )
    stated = recording.metadata.cycles
    if stated is not None and whole < stated:
        warnings.append(f"{whole} whole cycles found, the metadata give {stated}")
    first, last = begin + SETTLING_CYCLES / frequency, begin + whole / frequency
    frequency = refined_frequency(t_x, x, frequency, first, last)
    estimate = _estimate((t_x, x), (t_y, y), frequency, first, last, source.sign)
    if estimate is None:
        raise NotIdentifiableError(
            f"too few samples per cycle at {frequency:.4g} Hz", where=where, expected="at least 4 per cycle"
        )
    given, found = estimate.input, estimate.output
    u = given.amplitude[0]
    low, high = _amplitude_range(t_x, x, frequency, begin, whole)
    changing = f"the amplitude goes from {low:.3g} to {high:.3g} {source.input_unit} from cycle to cycle"
    if abs(u) < 5 * np.sqrt(given.variance[0]) or abs(u) == 0:
        _refuse_another_frequency(t_x, x, frequency, first, last, where)
        if low > _NEVER_STILL * high:
            raise PremiseError(
                changing, where=where, expected="one amplitude", remedy="Cut the recording into one for each amplitude"
            )
        raise PremiseError(
            f"the input does not move at {frequency:.4g} Hz: amplitude {abs(u):.3g} ± {np.sqrt(given.variance[0]):.2g}",
            where=where,
            expected="a sinusoid well above the noise",
        )
    if high - low > SAME_AMPLITUDE * (high + low) / 2:
        warnings.append(f"{changing}: the response is that of all together")
    warnings += _name_harmonics(given)
    details = _details(recording, source, given, found, frequency, whole)
    details |= _change(t_x, x, t_y, y, frequency, begin, whole, source.sign)
    length = recording.metadata.stretched_length_mm
    strain = recording.metadata.strain_pp
    if length is not None and source.input.quantity == "displacement":
        amplitude = abs(u) / length
    else:
        amplitude = strain / 2 if strain is not None else float(abs(u))
    response = FrequencyResponse(
        frequency_hz=np.array([frequency]),
        value=np.array([estimate.value]),
        variance=np.array([estimate.noise_variance + estimate.transient_variance]),
        usable=np.array([True]),
        quantity=source.quantity,
        loading=source.loading,
        noise_variance=np.array([estimate.noise_variance]),
        effective_lines=1.0,
        repeats=whole - SETTLING_CYCLES,
        amplitude=float(amplitude),
        recording_id=where,
        specimen_id=recording.metadata.specimen_id,
        details=details,
    )
    response = quality.judged(response, float("inf"))
    return response, _distortions(source, estimate.value, given, found, frequency), tuple(warnings)


def _amplitude_range(time: Float, x: Float, frequency: float, begin: float, whole: int) -> tuple[float, float]:
    """Least and largest amplitude of the settled cycles, each by itself; zero where they cannot be told."""
    chosen = np.unique(np.rint(np.linspace(SETTLING_CYCLES, whole - 1, min(whole, _MOST_CYCLES))).astype(int)).tolist()
    spans = ((begin + cycle / frequency, begin + (cycle + 1) / frequency) for cycle in chosen)
    found = [one for first, last in spans if (one := harmonics(time, x, frequency, first, last)) is not None]
    sizes = [float(abs(one.amplitude[0])) for one in found]
    return (min(sizes), max(sizes)) if sizes else (0.0, 0.0)


def _refuse_another_frequency(time: Float, x: Float, frequency: float, first: float, last: float, where: str) -> None:
    """Raises `NotIdentifiableError` with the frequency at which the input does move, where that is another than the stated one."""
    steps = np.linspace(first, last, int(np.count_nonzero((time >= first) & (time <= last))))
    if steps.size < _FEWEST_SAMPLES:
        return
    moving = np.interp(steps, time, x)
    power = np.abs(np.fft.rfft((moving - moving.mean()) * np.hanning(steps.size))) ** 2
    best = min(max(int(power.argmax()), 1), power.size - 2)
    beside = power[max(0, best - 2) : best + 3].sum()
    # The maximum of a Hann window's main lobe, whose logarithm is about a parabola.
    low, middle, high = np.log(np.maximum(power[best - 1 : best + 2], np.finfo(float).tiny))
    found = (
        (best + 0.5 * (low - high) / min(low - 2 * middle + high, -1e-9))
        * (steps.size - 1)
        / steps.size
        / (last - first)
    )
    if beside > _ONE_LINE * power.sum() and abs(found - frequency) > 2 / (last - first):
        raise NotIdentifiableError(
            f"the input moves at {found:.3g} Hz and not at {frequency:.4g} Hz",
            where=where,
            expected="a sinusoid of the frequency that is stated",
            remedy="Correct frequency_hz, or the time unit",
        )


def _name_harmonics(given: Harmonics) -> list[str]:
    """A note where the input is far from a sinusoid."""
    shares = np.abs(given.amplitude[1:] / given.amplitude[0])
    if not shares.size or shares.max() < _SINUSOID:
        return []
    order = int(shares.argmax())
    return [f"the input is no sinusoid: its {ordinal(order + 2)} harmonic is {100 * shares[order]:.0f} % of it"]


@dataclass(frozen=True)
class _Estimate:
    """Response with the harmonics behind it; `transient_variance` is the square of what the slow terms may change."""

    input: Harmonics
    output: Harmonics
    value: complex
    noise_variance: float
    transient_variance: float


def _estimate(
    given: tuple[Float, Float], found: tuple[Float, Float], frequency: float, first: float, last: float, sign: float
) -> _Estimate | None:
    """Response over the window with the slow terms that leave the least error, noise and transient together.

    The richest terms of those that the window carries judge the poorer: what they change beyond their own noise is
    transient that the poorer ones leave in. The richest are judged by the ones before them.
    """
    tried = []
    for slow in slow_terms((last - first) * frequency):
        x = harmonics(*given, frequency, first, last, slow=slow)
        y = harmonics(*found, frequency, first, last, slow=slow)
        if x is None or y is None:
            continue
        u = x.amplitude[0]
        k = sign * y.amplitude[0] / u if u else 0j
        noise = float((y.variance[0] + abs(k) ** 2 * x.variance[0]) / abs(u) ** 2) if u else float("inf")
        tried.append(_Estimate(x, y, complex(k), noise, 0.0))
    if not tried:
        return None
    best = tried[-1]
    judged = []
    for i, one in enumerate(tried):
        other = best if one is not best else tried[max(i - 1, 0)]
        beyond = max(abs(one.value - other.value) ** 2 - max(best.noise_variance - one.noise_variance, 0.0), 0.0)
        judged.append(replace(one, transient_variance=beyond))
    return min(judged, key=lambda e: e.noise_variance + e.transient_variance)


def _cycles(time: Float, x: Float, recording: Recording) -> tuple[float, float, float]:
    """Frequency (stated, or from the spectrum), first and last instant of the motion."""
    where = recording.metadata.recording_id
    amplitude = float(x.max() - x.min()) / 2 if x.size else 0.0
    if x.size < 16 or amplitude == 0:
        raise PremiseError("the input does not move", where=where, expected="a sinusoid")
    edge = max(4, x.size // 500)
    moving = np.flatnonzero(np.abs(x - np.median(x[:edge])) > 0.02 * amplitude)
    still = np.flatnonzero(np.abs(x - np.median(x[-edge:])) > 0.02 * amplitude)
    first = max(int(moving[0]) - 1, 0)
    last = min(int(still[-1]) + 1, x.size - 1)
    begin, end = float(time[first]), float(time[last])
    stated = recording.metadata.frequency_hz
    if stated is not None:
        return stated, begin, end
    grid = np.linspace(begin, end, int(min(2**16, 4 * (last - first + 1))))
    values = np.interp(grid, time, x)
    spectrum = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(grid.size)))
    k = int(spectrum[1:].argmax()) + 1
    if 0 < k < spectrum.size - 1:
        low, mid, high = np.log(np.maximum(spectrum[k - 1 : k + 2], np.finfo(float).tiny))
        curvature = low - 2 * mid + high
        shift = 0.5 * (low - high) / curvature if curvature < 0 else 0.0
    else:
        shift = 0.0
    return (k + shift) / (end - begin), begin, end


def _change(
    t_x: Float, x: Float, t_y: Float, y: Float, frequency: float, begin: float, whole: int, sign: float
) -> dict[str, Any]:
    """Response of each cycle by itself; the first against the last is softening, or the start of the film."""
    values, errors = [], []
    chosen = np.unique(np.rint(np.linspace(0, whole - 1, min(whole, _MOST_CYCLES))).astype(int)).tolist()
    for cycle in chosen:
        first = begin + cycle / frequency
        last = first + 1 / frequency
        given = harmonics(t_x, x, frequency, first, last)
        found = harmonics(t_y, y, frequency, first, last)
        if given is None or found is None or given.amplitude[0] == 0:
            return {}
        k = sign * found.amplitude[0] / given.amplitude[0]
        values.append(complex(k))
        errors.append(float(np.sqrt(found.variance[0] + abs(k) ** 2 * given.variance[0]) / abs(given.amplitude[0])))
    ratio = values[0] / values[-1]
    return {
        "cycle_number": [cycle + 1 for cycle in chosen],
        "cycle_real": [v.real for v in values],
        "cycle_imag": [v.imag for v in values],
        "cycle_standard_error": errors,
        "first_over_last": abs(ratio),
        "first_over_last_sd": abs(ratio)
        * float(np.hypot(errors[0] / abs(values[0]), errors[-1] / abs(values[-1])))
        / np.sqrt(2),
    }


def _details(
    recording: Recording, source: Drive, given: Harmonics, found: Harmonics, frequency: float, whole: int
) -> dict[str, Any]:
    details: dict[str, Any] = {
        "frequency_hz": frequency,
        "frequency_stated_hz": recording.metadata.frequency_hz,
        "cycles": whole,
        "settling_cycles": SETTLING_CYCLES,
        "mean_input": given.mean,
        "mean_output": found.mean,
        "input_amplitude": float(abs(given.amplitude[0])),
        "input_harmonics": [float(abs(a / given.amplitude[0])) for a in given.amplitude[1:]],
        "input_unit": source.input_unit,
        "output_unit": source.output_unit,
    }
    capacitance = recording.channels.get("capacitance")
    if capacitance is not None and capacitance.values.size:
        details |= _capacitance(capacitance, recording, given, frequency, whole)
    return details


def _capacitance(
    channel: Channel, recording: Recording, given: Harmonics, frequency: float, whole: int
) -> dict[str, Any]:
    """Harmonics of the sensing region: its wave distorts when electrodes degrade."""
    time, values = seconds(channel, recording.start_ns)
    if time.size < 16:
        return {}
    last = float(time[-1])
    first = last - (whole - SETTLING_CYCLES) / frequency
    found = harmonics(time, values, frequency, first, last)
    if found is None:
        return {}
    ratio = found.amplitude[0] / given.amplitude[0]
    return {
        "capacitance_mean_pf": found.mean,
        "capacitance_amplitude_pf": float(abs(found.amplitude[0])),
        "capacitance_per_input_pf": float(abs(ratio)),
        "capacitance_phase_deg": float(np.degrees(np.angle(ratio))),
        "capacitance_harmonics": [float(abs(a / found.amplitude[0])) for a in found.amplitude[1:]],
        "capacitance_harmonics_sd": [float(np.sqrt(v / 2) / abs(found.amplitude[0])) for v in found.variance[1:]],
    }


def _distortions(
    source: Drive, k: complex, given: Harmonics, found: Harmonics, frequency: float
) -> tuple[Distortion, ...]:
    """Harmonics of the output that those of the input do not explain, and the noise in the same places."""
    count = min(given.amplitude.size, found.amplitude.size)
    orders = np.arange(2, count + 1)
    # The response at m f is not known from this recording; that at f removes most of what the input puts there.
    level: Float = np.abs(source.sign * found.amplitude[1:count] - k * given.amplitude[1:count])
    noise: Float = np.sqrt(found.variance[1:count])
    rows = []
    lines = frequency * orders.astype(float)
    for kind, chosen in (("even", orders % 2 == 0), ("odd", orders % 2 == 1)):
        if chosen.any():
            rows.append(Distortion(kind, lines[chosen], level[chosen], source.output_unit, orders[chosen]))
    if orders.size:
        rows.append(Distortion("noise", lines, noise, source.output_unit, orders))
    return tuple(rows)
