"""Features of periodic multisines: response at the excited lines early and late, what answers at the others, the amplifier.

Periods are the unit: what changes from one to the next is taken out as a polynomial in time before the periods are averaged,
which leaves the lines exactly as they are. The input is the square of the measured voltage (or `input`, for systems of
another kind).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pipeline.diagnose.features.blocks import assembled
from pipeline.diagnose.features.functionals import Component, line_frequencies
from pipeline.diagnose.features.kinds import (
    SPHS_CAPACITANCE,
    SPHS_DETECTION,
    SPHS_RESPONSE,
    SPHS_VOLTAGE,
    FeatureBlock,
    NoiseSample,
)
from pipeline.diagnose.features.noise_density import MAINS_HZ, thinned
from pipeline.diagnose.features.records import Record, record
from pipeline.diagnose.features.whole_periods import is_whole, make_whole
from pipeline.diagnose.rules import RULES
from pipeline.physics.rig import rig_prior
from pipeline.transform.channels import drive
from pipeline.transform.periodic import excited_lines
from pipeline.transform.sweeps import find_period
from schemas.arrays import Bool, Complex, Float, Int
from schemas.errors import NotIdentifiableError
from schemas.metadata import RigConstants
from schemas.recording import Recording

_DEGREE = 5
"""Degree of the slow drift over a record that is taken off."""
_WAVE = 2048
"""Most samples of the stored period."""
_MAINS_HALF_HZ = 0.6
"""Half width about the mains in which no line is a feature, Hz."""
_LEAD_IN_S = 0.03
"""Time before the first period in which the amplifier may begin to move, s."""


@dataclass(frozen=True)
class _Periods:
    """Settled periods of a record, which begins to move at sample `onset`.

    `first` sample, `length` samples each, `count`; `lines` excited, `empty` not.
    """

    onset: int
    first: int
    length: int
    count: int
    period_s: float
    lines: Int
    empty: Int

    def frequency(self, lines: Int) -> Float:
        return lines / self.period_s


def sphs_blocks(
    recording: Recording, nodes: Float
) -> tuple[list[FeatureBlock], list[NoiseSample], dict[str, float], list[str]]:
    """Blocks, noise, values, warnings of an `sphs` recording. Raises `NotIdentifiableError` where nothing can be read."""
    source = drive(recording)
    given, force = source.input.quantity, source.output.quantity
    channels = {given: source.input, force: source.output}
    for q in ("command", "capacitance"):
        if source.square and q in recording.channels and recording.channels[q].values.size:
            channels[q] = recording.channels[q]
    high = recording.metadata.frequency_stop_hz or 0.1 / _interval(source.input.time_ns)
    channels, period_s = make_whole(channels, given, recording.metadata.period_s)
    found = record(channels, recording, highest_hz=high, period_s=period_s)
    if found.lost.any():
        raise NotIdentifiableError("a multisine with gaps has no whole periods", where=recording.metadata.recording_id)
    wave = found.values[given]
    periods = _periods(recording, found, wave, source.square, high, period_s)
    squared = wave**2 if source.square else wave
    warnings: list[str] = []
    rest = max(0, periods.onset - int(_LEAD_IN_S / found.interval_s))
    noise = [found.noise(q, found.values[q][:rest]) for q in channels if rest >= 32]
    factor = found.channel_factor(force, given)
    output = source.sign * found.values[force]
    noise.append(_off_lines(force, found, periods, output, squared, factor))
    halves = _halves(periods.count)
    kv = float(np.abs(wave).max()) if source.square else np.nan
    common = {
        "wave": _wave(wave, periods),
        "period_s": np.array([periods.period_s]),
    }
    if "command" in channels:
        common["command"] = _wave(found.values["command"], periods)
    blocks = []
    spectra = _Spectra(found, periods)
    for half, (a, b) in enumerate(halves):
        blocks.append(
            _response(
                SPHS_RESPONSE,
                force,
                given,
                spectra,
                output,
                squared,
                wave,
                factor,
                (a, b),
                half,
                kv,
                common,
                len(halves),
            )
        )
    if (
        periods.empty.size and periods.count >= RULES.features.periods
    ):  # fewer hold what the film still makes of its start
        blocks.append(_detection(force, given, spectra, output, squared, wave, factor, kv, common))
    if "capacitance" in channels:
        sensed = found.values["capacitance"]
        of_sensor = found.channel_factor("capacitance", given)
        for half, (a, b) in enumerate(halves):
            blocks.append(
                _response(
                    SPHS_CAPACITANCE,
                    "capacitance",
                    given,
                    spectra,
                    sensed,
                    squared,
                    wave,
                    of_sensor,
                    (a, b),
                    half,
                    kv,
                    common,
                    len(halves),
                )
            )
    if "command" in channels and np.ptp(found.values["command"]) > 0:
        made = _voltage(spectra, found, kv, common)
        blocks += [] if made is None else [made]
    values = {"rest_force_n": float(found.values[force][: max(rest, 1)].mean())} if rest >= 8 else {}
    if source.square:
        values |= {
            "largest_voltage_kv": kv,
            "exposure_kv2_s": float(np.sum(wave**2) * found.interval_s),
            "mean_squared_kv2": float(squared[periods.first :].mean()),
        }
    return blocks, [n for n in noise if n is not None], values, warnings


def _interval(time_ns: Int) -> float:
    return float(time_ns[-1] - time_ns[0]) / max(time_ns.size - 1, 1) * 1e-9


def _periods(
    recording: Recording, found: Record, wave: Float, square: bool, high: float, stated: float | None
) -> _Periods:
    metadata, where = recording.metadata, recording.metadata.recording_id
    samples = stated / found.interval_s if stated is not None else find_period(wave)
    if samples is None:
        raise NotIdentifiableError("no period found in the input", where=where)
    length = round(samples)
    if not is_whole(samples):
        raise NotIdentifiableError(
            f"a period of {samples:.6g} samples is not whole",
            where=where,
            expected="a whole number of samples per period",
        )
    size = np.abs(wave)
    # Periodicity is what tells the excitation from rest and lead-in.
    same = np.abs(wave[length:] - wave[:-length]) < 0.02 * size.max() if wave.size > 2 * length else np.zeros(1, bool)
    moving = np.flatnonzero(size > 0.02 * size.max())
    if not same.any() or not moving.size:
        raise NotIdentifiableError("fewer than two whole periods", where=where)
    differs = np.flatnonzero(~same[: same.size - 2])
    onset = max(
        int(moving[0]), int(differs[-1]) + 1 if differs.size and differs[-1] < 0.7 * same.size else int(moving[0])
    )
    available = (wave.size - onset) // length
    # The first period holds the start of the film, and the clamp rings on from it.
    dropped = max(1, int(np.ceil(_ringing_s(recording.rig) / (length * found.interval_s)))) if available > 2 else 0
    dropped = max(min(dropped, available - RULES.features.periods), min(1, available - 2), 0)
    count = available - dropped
    first = onset + dropped * length
    if count < 2:
        raise NotIdentifiableError(f"{count} settled periods", where=where, expected="at least 2")
    u = wave**2 if square else wave
    mean = u[first : first + count * length].reshape(count, length).mean(axis=0)
    amplitude = np.abs(np.fft.rfft(mean)) * 2 / length
    period_s = length * found.interval_s
    low = metadata.frequency_start_hz
    start = 1 if low is None else max(1, int(np.ceil(low * period_s - 0.01)))
    stop = int(np.floor(high * period_s + 0.01))
    lines = excited_lines(amplitude, start, stop, kind=metadata.lines, least=RULES.features.line_input)
    if lines.size < 3:
        raise NotIdentifiableError(f"the input excites {lines.size} lines", where=where, expected="at least 3")
    lines = lines[_away_from_mains(lines / period_s)]
    inside = np.arange(lines[0], lines[-1] + 1)
    empty = inside[~np.isin(inside, lines)]
    empty = empty[_away_from_mains(empty / period_s) & (amplitude[empty] < 0.2 * np.median(amplitude[lines]))]
    return _Periods(int(moving[0]), first, length, count, period_s, lines, empty)


def _ringing_s(rig: RigConstants) -> float:
    """Time in which the clamp's ringing falls to a hundredth, however light its damping may be."""
    prior = rig_prior(rig)
    if prior is None or prior.nominal[0] <= 0:
        return 0.0
    return float(np.log(100) / (prior.lightest_ratio * prior.rig.clamp_omega))


def _away_from_mains(frequency: Float) -> Bool:
    away = np.ones(frequency.shape, dtype=bool)
    for mains in MAINS_HZ:
        away &= np.abs(frequency - mains) > _MAINS_HALF_HZ
    return away


def _halves(count: int) -> list[tuple[int, int]]:
    """Early and late periods; all together where there are fewer than four."""
    return [(0, count)] if count < 4 else [(0, count // 2), (count // 2, count)]


class _Spectra:
    """Lines of averaged periods, freed of what drifts from period to period."""

    def __init__(self, found: Record, periods: _Periods) -> None:
        self.found, self.periods = found, periods
        n, count, length = periods.count * periods.length, periods.count, periods.length
        degree = min(_DEGREE, count - 1)
        basis = np.polynomial.legendre.legvander(np.linspace(-1, 1, n), degree)[:, 1:]
        self._basis = basis.reshape(count, length, degree)
        rest = (self._basis - self._basis.mean(axis=0)).reshape(n, degree)
        self._solve = np.linalg.pinv(rest)

    def clean(self, values: Float) -> Float:
        """(periods, samples) without the polynomial that the change from period to period shows."""
        p = self.periods
        y = values[p.first : p.first + p.count * p.length].reshape(p.count, p.length)
        change = (y - y.mean(axis=0)).ravel()
        return np.asarray(y - self._basis @ (self._solve @ change))

    def lines(self, values: Float, span: tuple[int, int]) -> Complex:
        """Amplitudes of all lines of the mean of periods a…b−1."""
        mean = self.clean(values)[span[0] : span[1]].mean(axis=0)
        return np.asarray(np.fft.rfft(mean) * 2 / self.periods.length)


def _diagonal(spectra: _Spectra, lines: Int, span: tuple[int, int], scale: Float, exponents: tuple[int, ...]) -> Float:
    """(exponents, 2 lines) variance of real and imaginary part of a line's amplitude times `scale`, per coefficient."""
    p = spectra.periods
    samples = (span[1] - span[0]) * p.length
    f = p.frequency(lines)
    rows = []
    for e in exponents:
        density = np.ones_like(f) if e == 0 else f**-e / spectra.found.interval_s
        rows.append(np.tile(2 * density / samples * scale**2, 2))
    return np.array(rows)


def _mains(spectra: _Spectra, lines: Int, span: tuple[int, int], scale: Float, mains: tuple[Component, ...]) -> Float:
    """(mains, 2 lines) the same for sinusoids of amplitude 1: what of them leaks into lines they are not on."""
    p, interval_s = spectra.periods, spectra.found.interval_s
    samples = (span[1] - span[0]) * p.length
    rows = np.zeros((len(mains), 2 * lines.size))
    for row, c in zip(rows, mains, strict=True):
        near, weight = line_frequencies(c)
        gain = 1.0 if c.gain is None else c.gain(near)
        for sign in (-1.0, 1.0):
            turn = (near[None, :] + sign * p.frequency(lines)[:, None]) * interval_s
            leak = gain * np.sinc(samples * turn) / np.sinc(turn)
            row += np.tile(leak**2 @ weight / 2 * scale**2, 2)
    return rows


def _response(
    kind: str,
    quantity: str,
    given: str,
    spectra: _Spectra,
    output: Float,
    squared: Float,
    wave: Float,
    factor: Callable[[Float], Complex],
    span: tuple[int, int],
    half: int,
    kv: float,
    common: dict[str, Float],
    halves: int,
) -> FeatureBlock:
    p = spectra.periods
    lines = p.lines
    f = p.frequency(lines)
    u = spectra.lines(squared, span)[lines]
    value = spectra.lines(output, span)[lines] / u / factor(f)
    basis = _diagonal(spectra, lines, span, 1 / np.abs(u), (0, 1, 2))
    # Noise of the voltage is multiplied by twice the voltage when it is squared.
    noise_gain = np.sqrt(np.mean(4 * wave[p.first :] ** 2)) if given == "voltage" else 1.0
    through = _diagonal(spectra, lines, span, noise_gain * np.abs(value) / np.abs(u), (0,))
    mains = spectra.found.mains if kind == SPHS_RESPONSE else ()
    hum = _mains(spectra, lines, span, 1 / np.abs(u), mains)
    names = (*tuple(f"{quantity}/{e}" for e in (0, 1, 2)), f"{given}/0", *(c.name for c in mains))
    label = "all periods" if halves == 1 else ("early periods", "late periods")[half]
    middle = (span[0] + span[1]) / 2
    return assembled(
        kind,
        label,
        np.concatenate([value.real, value.imag]),
        names,
        np.concatenate([basis, through, hum]),
        is_complex=True,
        frequency=f,
        voltage=kv,
        cycle=middle,
        time=(p.first + middle * p.length) * spectra.found.interval_s,
        support=common | {"lines": lines.astype(float)},
    )


def _detection(
    quantity: str,
    given: str,
    spectra: _Spectra,
    output: Float,
    squared: Float,
    wave: Float,
    factor: Callable[[Float], Complex],
    kv: float,
    common: dict[str, Float],
) -> FeatureBlock:
    p = spectra.periods
    span = (0, p.count)
    u, y = spectra.lines(squared, span), spectra.lines(output, span)
    f, empty = p.frequency(p.lines), p.frequency(p.empty)
    response = y[p.lines] / u[p.lines] / factor(f)
    near = np.interp(empty, f, response.real) + 1j * np.interp(empty, f, response.imag)
    value = y[p.empty] / factor(empty) - near * u[p.empty]
    # About a resonance that is no wider than the lines lie apart, the response between them is not that of a straight line.
    bend = np.interp(empty, f[1:-1], np.abs(np.diff(response, 2))) / 8 * np.abs(u[p.empty])
    kept = bend < np.median(np.abs(value))
    lines, empty, near, value = p.empty[kept], empty[kept], near[kept], value[kept]
    basis = _diagonal(spectra, lines, span, np.ones(lines.size), (0, 1, 2))
    noise_gain = np.sqrt(np.mean(4 * wave[p.first :] ** 2)) if given == "voltage" else 1.0
    through = _diagonal(spectra, lines, span, noise_gain * np.abs(near), (0,))
    mains = spectra.found.mains
    hum = _mains(spectra, lines, span, np.ones(lines.size), mains)
    return assembled(
        SPHS_DETECTION,
        "lines not excited",
        np.concatenate([value.real, value.imag]),
        (*tuple(f"{quantity}/{e}" for e in (0, 1, 2)), f"{given}/0", *(c.name for c in mains)),
        np.concatenate([basis, through, hum]),
        is_complex=True,
        frequency=empty,
        voltage=kv,
        cycle=p.count / 2,
        time=(p.first + p.count * p.length / 2) * spectra.found.interval_s,
        support=common | {"lines": lines.astype(float), "excited": p.lines.astype(float)},
    )


def _voltage(spectra: _Spectra, found: Record, kv: float, common: dict[str, Float]) -> FeatureBlock | None:
    """Voltage over command where the command is strong."""
    p = spectra.periods
    span = (0, p.count)
    v, c = (spectra.lines(found.values[q], span) for q in ("voltage", "command"))
    size = np.abs(c[1 : p.lines[-1] + 1])
    lines = 1 + np.flatnonzero(size > RULES.features.sphs_command * size.max())
    lines = lines[_away_from_mains(p.frequency(lines))]
    if lines.size < 3:
        return None
    f = p.frequency(lines)
    value = v[lines] / c[lines] / found.channel_factor("voltage", "command")(f)
    own = _diagonal(spectra, lines, span, 1 / np.abs(c[lines]), (0, 1))
    other = _diagonal(spectra, lines, span, np.abs(value) / np.abs(c[lines]), (0, 1))
    return assembled(
        SPHS_VOLTAGE,
        "amplifier",
        np.concatenate([value.real, value.imag]),
        ("voltage/0", "voltage/1", "command/0", "command/1"),
        np.concatenate([own, other]),
        is_complex=True,
        frequency=f,
        voltage=kv,
        cycle=p.count / 2,
        time=(p.first + p.count * p.length / 2) * found.interval_s,
        support=common | {"lines": lines.astype(float)},
    )


def _off_lines(
    quantity: str, found: Record, p: _Periods, output: Float, squared: Float, factor: Callable[[Float], Complex]
) -> NoiseSample | None:
    """Noise of the output between the lines of the whole stretch of settled periods."""
    if p.count < 3:
        return None
    part = slice(p.first, p.first + p.count * p.length)
    s = np.linspace(-1, 1, p.count * p.length)
    y = output[part].reshape(p.count, p.length)
    y = (y - y.mean(axis=0)).ravel()
    basis = np.polynomial.legendre.legvander(s, min(_DEGREE, p.count - 1))
    basis = basis - np.tile(basis.reshape(p.count, p.length, -1).mean(axis=0), (p.count, 1))
    y = y - basis @ (np.linalg.pinv(basis) @ y)
    # Mains between the lines would leak far without a window.
    window = 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(y.size) + 0.5) / y.size)
    spectrum = np.fft.rfft(y * window)
    bins = np.arange(spectrum.size)
    f = bins / (y.size * found.interval_s)
    off = np.minimum(bins % p.count, p.count - bins % p.count)
    # The line beside a bin, where nothing is left, holds a sixth of what the window gathers.
    power = np.abs(spectrum) ** 2 / np.sum(window**2) * np.where(off == 1, 6 / 5, 1.0)
    # Slow changes of the lines themselves stand beside them; the polynomial is below its degree.
    kept = (off >= (2 if p.count >= 4 else 1)) & (bins > _DEGREE) & (bins < spectrum.size - 1)
    kept &= _away_from_mains(f)
    if found.thinned > 1:
        kept &= f < 0.35 / found.interval_s
    return thinned(
        quantity,
        found.interval_s,
        f[kept],
        power[kept],
        np.full(int(kept.sum()), 2 / 3),
        setting=found.setting(quantity),
    )


def _wave(values: Float, p: _Periods) -> Float:
    """The mean period from which higher frequencies than 1024 lines are left out."""
    mean = values[p.first : p.first + p.count * p.length].reshape(p.count, p.length).mean(axis=0)
    if mean.size <= _WAVE:
        return np.asarray(mean)
    return np.asarray(np.fft.irfft(np.fft.rfft(mean)[: _WAVE // 2], _WAVE) * (_WAVE / mean.size))
