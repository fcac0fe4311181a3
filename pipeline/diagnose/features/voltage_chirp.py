"""Features of sweeps of the voltage: −F/V² and C/V² in bands, harmonics of the force, and what the amplifier makes of the command.

The input is the square of the measured voltage. It sweeps the frequency of the voltage where that has a bias, and twice that where
it has none; whatever else it holds passes through the functionals as it was. Before the sweep the voltage may be brought to its
bias: what the film still answers to that is simulated with the rest.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from pipeline.diagnose.features.blocks import Signals, block
from pipeline.diagnose.features.functionals import Component, stacked
from pipeline.diagnose.features.kinds import (
    VOLTAGE_CHIRP_AMPLIFIER,
    VOLTAGE_CHIRP_CAPACITANCE,
    VOLTAGE_CHIRP_HARMONIC,
    VOLTAGE_CHIRP_RESPONSE,
    FeatureBlock,
    NoiseSample,
)
from pipeline.diagnose.features.records import CLEAR_OF_HARMONICS, Record, read_band, record, white_sd
from pipeline.diagnose.features.sweep_kernels import WITHIN, Bands, Piece, bands_of, harmonics_of
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.simulation.nodes import response_nodes
from pipeline.transform.channels import drive
from pipeline.transform.sampling import runs
from pipeline.transform.sweeps import find_period
from schemas.arrays import Bool, Complex, Float, Int
from schemas.errors import NotIdentifiableError
from schemas.metadata import RigConstants
from schemas.recording import Recording

_STILL = 0.02
"""Share of its whole travel up to which the square of a voltage stands still."""
_STILL_TURNS = 0.25
"""Turns of the lowest frequency for which it does."""
_A_SWEEP = 0.5
"""Share of the longest motion from which another is a sweep as well; what is shorter brings the voltage to its bias, or away from it."""
_BIASED = 0.25
"""Bias over amplitude of a voltage from which its square sweeps the voltage's own frequency more strongly than twice that."""
_FEWEST_TURNS = 6.0
"""Fewest turns of a sweep that has a response: of fewer most is how it began and ended."""
_TURNED = 0.2
"""Share of its amplitude by which a wave has to be beyond its middle to have turned: less is noise."""


@dataclass(frozen=True)
class _Sweep:
    """A sweep: samples first … stop − 1 are its piece of the record, it moves in start … end − 1; `number` from 1."""

    first: int
    stop: int
    start: int
    end: int
    number: int


def voltage_chirp_blocks(
    recording: Recording, nodes: Float
) -> tuple[list[FeatureBlock], list[NoiseSample], dict[str, float], list[str]]:
    """Blocks, noise, values by name, warnings of an electrical `chirp`. Raises `NotIdentifiableError` where nothing can be read."""
    source, metadata = drive(recording), recording.metadata
    driven = read_band(recording)
    low, high = (2 * f for f in driven) if _is_doubled(source.input.values) else driven
    given, force = source.input.quantity, source.output.quantity
    channels = {given: source.input, force: source.output} | {
        q: recording.channels[q]
        for q in ("command", "capacitance")
        if q in recording.channels and recording.channels[q].values.size
    }
    found = record(channels, recording, highest_hz=high)
    kv = found.values[given]
    window = int(_STILL_TURNS / (low * found.interval_s))
    still = find_still(kv**2, window)
    pieces = _find_sweeps(kv**2, still, metadata.repeats, where=metadata.recording_id)
    quiet = _list_quiet(still, window)
    # A film still relaxes after its voltage has changed: a parabola takes that off.
    noise = [found.noise(q, found.values[q][s], degree=2) for q in channels for s in quiet]
    noise += [
        found.noise_beyond(q, CLEAR_OF_HARMONICS * high)
        for q in channels
        if not any(n is not None and n.quantity == q for n in noise)
    ]
    rest = quiet[0] if quiet and quiet[0].start == 0 else slice(0, 1)
    blocks: list[FeatureBlock] = []
    warnings: list[str] = []
    for sweep in pieces:
        if found.lost[sweep.first : sweep.stop].any():
            warnings.append(f"sweep {sweep.number} has gaps and is left out")
            continue
        turns = _count_half_turns(kv[sweep.start : sweep.end] ** 2) / 2
        if turns < _FEWEST_TURNS:
            warnings.append(f"sweep {sweep.number} ends after {turns:g} turns and is left out")
            continue
        blocks += _read_sweep(found, sweep, (low, high), driven, nodes, rest)
    if not blocks:
        raise NotIdentifiableError(
            "; ".join(warnings),
            where=metadata.recording_id,
            expected=f"a sweep without gaps of {_FEWEST_TURNS:g} turns or more",
        )
    values = {
        "largest_voltage_kv": float(np.abs(kv).max()),
        "exposure_kv2_s": float(np.sum(kv**2) * found.interval_s),
        "mean_squared_kv2": float(np.mean(kv[pieces[0].start : pieces[-1].end] ** 2)),
    }
    if rest.stop > 1:
        values["rest_force_n"] = float(found.values[force][rest].mean())
        if "capacitance" in channels:
            values["capacitance_rest_pf"] = float(found.values["capacitance"][rest].mean())
    return blocks, [n for n in noise if n is not None], values, warnings


def cut_piece(given: Float, placed: Float, square: bool, clock: float = 1.0) -> Piece:
    """The sweep of a voltage or a command.

    Parameters
    ----------
    given : (n,) kV or V, with the rest about the sweep
    placed : (5,) first sample that moves, first that rests again, interval in s, lowest and highest frequency in Hz
    square : whether its square is the input
    clock : true frequencies over those that were claimed
    """
    start, end, interval, low, high = placed
    start, end = round(start), round(end)
    wave = given**2 if square else given
    level = wave[:start].mean() if start else wave.mean()
    return Piece(wave - level, start, end, float(interval), float(low), float(high), clock)


def find_still(values: Float, window: int) -> Bool:
    """Samples (n,) that are part of a stretch of so many samples in which a signal stands still."""
    window = max(window, 8)
    still = np.zeros(values.size, dtype=bool)
    if values.size < window:
        return still
    from scipy.ndimage import maximum_filter1d, minimum_filter1d  # most recordings need not wait for them

    travel = maximum_filter1d(values, window) - minimum_filter1d(values, window)
    held = travel <= _STILL * np.ptp(values)
    # The filters see as far to both sides: a still window is still in all of its samples.
    return np.asarray(maximum_filter1d(held.astype(np.uint8), window, mode="constant") > 0)


def _count_half_turns(wave: Float) -> int:
    """How often a wave (n,) goes from one side of its middle to the other."""
    away = wave - (wave.max() + wave.min()) / 2
    side = np.sign(away[np.abs(away) > _TURNED * np.ptp(wave) / 2])
    return int(np.count_nonzero(np.diff(side)))


def _is_doubled(kv: Float) -> bool:
    """Whether the square of a voltage sweeps twice its frequency: of one that has no bias, or little."""
    known = kv[np.isfinite(kv)]
    return bool(abs(known.max() + known.min()) <= _BIASED * np.ptp(known))


def _list_quiet(still: Bool, window: int) -> list[slice]:
    """Where a signal stands still without the window beside its motion: it leaves its rest long before it shows."""
    inner = [
        slice(first + (window if first else 0), stop - (window if stop < still.size else 0))
        for first, stop in runs(still)
    ]
    return [s for s in inner if s.stop - s.start >= RULES.features.chirp_rest]


def _find_sweeps(squared: Float, still: Bool, repeats: int | None, *, where: str) -> list[_Sweep]:
    """The sweeps of a record, with half of the rest between one and the next. What is shorter than half of the longest motion is none."""
    moving = runs(~still)
    longest = max((stop - start for start, stop in moving), default=0)
    if not longest:
        raise NotIdentifiableError("the voltage does not move at all", where=where, expected="a sweep")
    spans: list[tuple[int, int, int, int]] = []
    for number, (start, end) in enumerate(moving):
        if end - start < _A_SWEEP * longest:
            continue
        before = moving[number - 1][1] if number else 0
        after = moving[number + 1][0] if number + 1 < len(moving) else squared.size
        first = start - (start - before) // 2 if number else 0
        spans.append((first, end + (after - end) // 2, start, end))
    if len(spans) == 1 and (repeats is None or repeats > 1):
        spans = _cut_repeats(squared, spans[0], repeats)
    return [_Sweep(*span, number) for number, span in enumerate(spans, start=1)]


def _cut_repeats(
    squared: Float, span: tuple[int, int, int, int], repeats: int | None
) -> list[tuple[int, int, int, int]]:
    """Sweeps that follow each other without rest, one by one."""
    first, stop, start, end = span
    period = (end - start) / repeats if repeats is not None else find_period(squared[start:end])
    count = 0 if period is None else round((end - start) / period)
    if period is None or count < 2:
        return [span]
    edges: Int = np.rint(start + period * np.arange(count + 1)).astype(np.int64)
    return [
        (first if i == 0 else int(a), stop if i == count - 1 else int(b), int(a), int(b))
        for i, (a, b) in enumerate(itertools.pairwise(edges))
    ]


@dataclass(frozen=True)
class _Read:
    """A sweep as its features are made: the record, its place in it, the input (N,) from the start of the record, and its bands.

    `noise_gain`: noise of the input over that of its channel.
    """

    found: Record
    sweep: _Sweep
    input: Float
    piece: Piece
    bands: Bands
    channel: str
    noise_gain: float
    support: dict[str, Float]

    def of(self, quantity: str, output: Float, nodes: Float) -> Signals:
        """Input and output of what one channel shows (N,), with the noise of both."""
        f, size = self.bands.frequency, np.abs(self.bands.kernels @ output[self.sweep.first : self.sweep.stop])
        order = np.argsort(f)
        log_f, log_size = np.log(f[order]), np.log(np.maximum(size[order], np.finfo(float).tiny))

        def gain(at: Float) -> Float:
            return np.asarray(self.noise_gain * np.exp(np.interp(np.log(at), log_f, log_size)))

        components = (*(Component(quantity, e) for e in (0, 1, 2)), Component(self.channel, 0, gain))
        is_force = quantity == "force"
        return Signals(
            self.input,
            output,
            self.found.interval_s,
            nodes,
            components + (self.found.mains if is_force else ()),
            self.found.channel_factor(quantity, self.channel),
            slow=True,
            noise_sd=white_sd(output, ()),
            largest_response=float(size.max()),
        )

    def make_block(self, kind: str, signals: Signals, *, voltage_kv: float) -> FeatureBlock:
        """The response in bands."""
        return self._make(kind, signals, self.bands.kernels, self.bands.frequency, self.support, voltage_kv)

    def make_harmonics(self, kind: str, signals: Signals, *, voltage_kv: float) -> list[FeatureBlock]:
        """Second and third harmonic of the output; none where the sweep is too short for them."""
        found = harmonics_of(self.piece, self.bands)
        if found is None:
            return []
        support = {"order": found.order.astype(float)}
        return [self._make(kind, signals, found.kernels, found.within[:, WITHIN // 2], support, voltage_kv)]

    def _make(
        self,
        kind: str,
        signals: Signals,
        kernels: Complex,
        frequency: Float,
        support: dict[str, Float],
        voltage_kv: float,
    ) -> FeatureBlock:
        order = np.argsort(self.bands.frequency)
        moment = np.interp(frequency, self.bands.frequency[order], self.bands.moment[order])
        return block(
            kind,
            f"sweep {self.sweep.number}",
            signals,
            stacked(kernels),
            self.sweep.first,
            is_complex=True,
            frequency=frequency,
            voltage=voltage_kv,
            cycle=float(self.sweep.number),
            time=(self.sweep.first + moment) * signals.interval_s,
            support=support,
        )


def _read(found: Record, sweep: _Sweep, channel: str, band: tuple[float, float], *, square: bool) -> _Read:
    """A sweep by the voltage, squared, or by the command."""
    placed = np.array([sweep.start - sweep.first, sweep.end - sweep.first, found.interval_s, *band])
    whole = found.values[channel]
    own = whole[sweep.first : sweep.stop]
    piece = cut_piece(own, placed, square)
    bands = bands_of(piece)
    # Noise of the voltage is multiplied by twice the voltage when it is squared.
    gain = float(np.sqrt(np.mean(4 * own**2))) if square else 1.0
    support = {
        "piece": placed,
        "piece_kv" if square else "piece_v": own,
        "piece_s": bands.moment * found.interval_s,
    }
    return _Read(found, sweep, whole**2 if square else whole, piece, bands, channel, gain, support)


def _read_sweep(
    found: Record, sweep: _Sweep, band: tuple[float, float], driven: tuple[float, float], nodes: Float, rest: slice
) -> list[FeatureBlock]:
    """Features of one sweep: of the force, and of capacitance and command where they are recorded.

    Parameters
    ----------
    band, driven : that of the square of the voltage, and that of the command, Hz
    nodes : of the response of film and rig, Hz
    rest : samples to which the output is referred
    """
    kv = float(np.abs(found.values["voltage"]).max())
    by_voltage = _read(found, sweep, "voltage", band, square=True)
    force = found.values["force"]
    signals = by_voltage.of("force", force[rest].mean() - force, nodes)
    blocks = [by_voltage.make_block(VOLTAGE_CHIRP_RESPONSE, signals, voltage_kv=kv)]
    blocks += by_voltage.make_harmonics(VOLTAGE_CHIRP_HARMONIC, signals, voltage_kv=kv)
    if "capacitance" in found.values:
        sensed = found.values["capacitance"]
        signals = by_voltage.of("capacitance", sensed - sensed[rest].mean(), nodes)
        blocks.append(by_voltage.make_block(VOLTAGE_CHIRP_CAPACITANCE, signals, voltage_kv=kv))
    if "command" in found.values and np.ptp(found.values["command"]) > 0:
        by_command = _read(found, sweep, "command", driven, square=False)
        signals = by_command.of("voltage", found.values["voltage"], response_nodes(RigConstants()))
        blocks.append(by_command.make_block(VOLTAGE_CHIRP_AMPLIFIER, signals, voltage_kv=kv))
    return blocks
