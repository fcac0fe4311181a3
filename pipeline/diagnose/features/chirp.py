"""Features of sweeps: response in bands and harmonics, sweep by sweep, and what the mean force does.

The response of a band is the force projected on the part of the displacement in that band, ⟨u_b, F⟩/⟨u_b, x⟩, without what
a slow drift puts there. Bands do not overlap, so that their noise is independent. Harmonics are read where the sweep makes
them: in time windows, against multiples of the input's own phase.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pipeline.diagnose.features.blocks import Signals, block
from pipeline.diagnose.features.functionals import Component, stacked
from pipeline.diagnose.features.kinds import (
    CHIRP_HARMONIC,
    CHIRP_LEVEL,
    CHIRP_RESPONSE,
    REST_INPUT,
    FeatureBlock,
    NoiseSample,
)
from pipeline.diagnose.features.records import (
    CLEAR_OF_HARMONICS,
    Record,
    Start,
    find_start,
    read_band,
    record,
    rest_samples,
    strain_length_mm,
    white_sd,
)
from pipeline.diagnose.features.sweep_kernels import WITHIN, Bands, Piece, bands_of, harmonics_of
from pipeline.diagnose.rules import RULES
from pipeline.physics.rig import rig_prior
from pipeline.transform import sweeps
from pipeline.transform.channels import drive
from schemas.arrays import Complex, Float
from schemas.errors import NotIdentifiableError
from schemas.metadata import RigConstants
from schemas.recording import Recording

_SHIFT_CELLS = 40
"""Stretches of a sweep, of equal length, in which what shifts the mean force is taken as constant."""
_TOP = 0.5
"""Log frequency below the highest band that says how the film goes on above the sweep."""
_CAME_BACK = 6.0
"""Standard deviations of its noise within which a driven end is back where it began."""
_REMEMBERED = 3
"""Sweeps, the last one itself, in which all is that a film answers with while one passes: with all of many, time and memory would grow
as the square of their number."""


@dataclass(frozen=True)
class Sweep:
    """One sweep: samples first…stop−1 belong to it, it moves within start…end; `number` from 1. `before`: samples of the recording
    before those that are counted."""

    first: int
    stop: int
    start: int
    end: int
    number: int
    before: int = 0

    def since(self, sample: int) -> Sweep:
        """The same, counted from a sample on."""
        return replace(
            self,
            first=self.first - sample,
            stop=self.stop - sample,
            start=self.start - sample,
            end=self.end - sample,
            before=self.before + sample,
        )


def chirp_blocks(
    recording: Recording, nodes: Float
) -> tuple[list[FeatureBlock], list[NoiseSample], dict[str, float], list[str]]:
    """Blocks, noise, values by name, warnings of a `chirp`. Raises `NotIdentifiableError` where nothing can be read."""
    source, where = drive(recording), recording.metadata.recording_id
    names = source.input.quantity, source.output.quantity
    low, high = read_band(recording)
    found = record({names[0]: source.input, names[1]: source.output}, recording, highest_hz=high)
    pieces, amplitude = _sweeps(recording, found, found.values[names[0]])
    before = rest_samples(found.values[names[0]], back=int(0.25 / (low * found.interval_s)))
    start = find_start(before, RULES.features.chirp_rest, _rests_after(pieces))
    rest = start.samples
    x, y = found.values[names[0]] - _rest_position(found.values[names[0]], start), found.values[names[1]]
    y = y - y[:rest].mean()
    length = strain_length_mm(recording)
    # After a sweep the film still relaxes: a parabola takes that off.
    degree = 1 if start.rests else 2
    noise = [found.noise(q, v[s], degree=degree) for s in start.quiet for q, v in zip(names, (x, y), strict=True)]
    if not any(n is not None and n.quantity == names[1] for n in noise):
        noise = [found.noise_beyond(q, CLEAR_OF_HARMONICS * high) for q in names]
        if not start.quiet and None in noise:
            raise NotIdentifiableError(
                "no rest before the first sweep nor after one, and samples too rare for the noise beyond it",
                where=where,
                expected=f"at least {RULES.features.chirp_rest} samples of rest,"
                f" or more than {2 * CLEAR_OF_HARMONICS * high:.4g} samples a second",
            )
    warnings: list[str] = []
    signals = Signals(
        x, y, found.interval_s, nodes, (), found.channel_factor(names[1], names[0]), noise_sd=white_sd(y, start.quiet)
    )
    blocks: list[FeatureBlock] = []
    for i, sweep in enumerate(pieces):
        if found.lost[sweep.first : sweep.stop].any():
            warnings.append(f"sweep {sweep.number} has gaps and is left out")
            continue
        piece = _piece(signals, sweep, (low, high))
        bands = bands_of(piece)
        part = signals.output[sweep.first : sweep.stop]
        signals = replace(
            signals,
            components=_components(names, bands, part, recording.rig) + found.mains,
            largest_response=float(np.abs(bands.kernels @ part).max()),
        )
        recent = signals
        if len(pieces) > _REMEMBERED:
            since = pieces[max(i + 1 - _REMEMBERED, 0)].first
            recent = signals.during(since, sweep.stop)
            sweep = sweep.since(since)
        blocks.append(_response(recent, sweep, piece, bands, length))
        blocks += _harmonics(recent, sweep, piece, bands, length)
    if not blocks:
        raise NotIdentifiableError("every sweep has gaps", where=where)
    blocks += _levels(signals, found, pieces, rest if start.rests else None, amplitude / length)
    values = {
        "largest_strain": amplitude / length,
        "rest_force_n": float(found.values[names[1]][:rest].mean()),
        REST_INPUT: float(found.values[names[0]][:rest].mean()),
    }
    return blocks, [n for n in noise if n is not None], values, warnings


def _sweeps(recording: Recording, found: Record, x: Float) -> tuple[list[Sweep], float]:
    moving = sweeps.motion(x)
    metadata = recording.metadata
    period = None if metadata.period_s is None else metadata.period_s / found.interval_s
    cut = sweeps.slices(x, moving, period=period, repeats=metadata.repeats)
    pieces = []
    for number, first in enumerate(cut.first, start=1):
        stop = min(first + cut.length, x.size)
        inside = sweeps.motion(x[first:stop])
        pieces.append(Sweep(first, stop, first + inside.first, first + inside.stop, number))
    return pieces, moving.amplitude


def _rests_after(pieces: list[Sweep]) -> list[tuple[int, int]]:
    """Late halves of the rests after the sweeps, in samples."""
    return [(p.end + (p.stop - p.end) // 2, p.stop) for p in pieces]


def _rest_position(values: Float, start: Start) -> float:
    """Where the driven end rests: before the first sweep, else between the sweeps, if it comes back to where it began."""
    if start.rests or not start.quiet:
        return float(values[: start.samples].mean())
    between = np.concatenate([values[s] for s in start.quiet])
    back = abs(between.mean() - values[0]) < _CAME_BACK * between.std()
    return float(between.mean() if back else values[0])


def _components(names: tuple[str, str], bands: Bands, y: Float, rig: RigConstants) -> tuple[Component, ...]:
    """Noise of the force, and that of the displacement, which reaches the force through the response itself."""
    force, given = names[1], names[0]
    gain = _gain(bands.frequency, bands.kernels @ y, rig)
    return (
        Component(force, 0),
        Component(force, 1),
        Component(force, 2),
        Component(given, 0, gain),
        Component(given, 1, gain),
    )


def _gain(frequency: Float, response: Complex, rig: RigConstants) -> Callable[[Float], Float]:
    """|G| between the bands: with the resonance as the rig file has it, for bands are wider than it is."""
    order = np.argsort(frequency)
    x, response = np.log(frequency[order]), response[order]
    prior = rig_prior(rig)
    if prior is None:
        size = np.log(np.abs(response))
        return lambda f: np.asarray(np.exp(np.interp(np.log(f), x, size)))
    known = prior.rig
    clamp = known.clamp(2 * np.pi * frequency[order])
    clear = np.abs(clamp) > RULES.features.clear_response
    k = known.film_stiffness(response, clamp)

    top = clear & (x > x[clear][-1] - _TOP)
    middle, level = x[top].mean(), np.log(np.abs(k[top])).mean()
    phase = float(np.clip(np.angle(k[top].sum()), 0.0, np.pi / 2))
    rise = float((x[top] - middle) @ np.log(np.abs(k[top])) / max(np.sum((x[top] - middle) ** 2), 1e-9))
    # The slope of log |k| is the phase over 90° (Bode); where k begins to rise it is steeper.
    slope = float(np.clip(max(rise, phase / (np.pi / 2)), 0.0, 1.0))

    def gain(f: Float) -> Float:
        at = np.log(f)
        film = np.interp(at, x[clear], k[clear].real) + 1j * np.interp(at, x[clear], k[clear].imag)
        # The resonance with a stiff film may lie above the sweep.
        film = np.where(at > x[clear][-1], np.exp(level + slope * (at - middle) + 1j * phase), film)
        return np.abs(known.mechanical(film, known.clamp(2 * np.pi * f)))

    return gain


def _piece(signals: Signals, sweep: Sweep, band: tuple[float, float]) -> Piece:
    first = sweep.first
    return Piece(
        signals.input[first : sweep.stop], sweep.start - first, sweep.end - first, signals.interval_s, band[0], band[1]
    )


def _response(signals: Signals, sweep: Sweep, piece: Piece, bands: Bands, length: float) -> FeatureBlock:
    turn = np.ones(bands.frequency.size, dtype=complex) if signals.factor is None else signals.factor(bands.frequency)
    return block(
        CHIRP_RESPONSE,
        f"sweep {sweep.number}",
        signals,
        stacked(bands.kernels),
        sweep.first,
        is_complex=True,
        frequency=bands.frequency,
        amplitude=bands.amplitude / length,
        cycle=float(sweep.number),
        time=(sweep.before + sweep.first + bands.moment) * signals.interval_s,
        support={
            "profile_hz": bands.frequency,
            "profile_mm": bands.amplitude,
            "piece_mm": piece.input,
            "piece": np.array([piece.start, piece.end, piece.interval_s, piece.low_hz, piece.high_hz]),
            "piece_s": bands.moment * signals.interval_s,
            "turn_re": turn.real,
            "turn_im": turn.imag,
        }
        | _shifts(stacked(bands.kernels), sweep, bands),
    )


def _shifts(kernels: Float, sweep: Sweep, bands: Bands) -> dict[str, Float]:
    """How features (n, N) see a slow shift of the force while the sweep passes `shift_hz` (q,): `shift_weight` (n, q)."""
    edges = np.rint(np.linspace(sweep.start, sweep.end, _SHIFT_CELLS + 1)).astype(int) - sweep.first
    weight = np.add.reduceat(np.pad(kernels, ((0, 0), (0, 1))), edges, axis=1)[:, :-1]
    order = np.argsort(bands.moment)
    middle = (edges[1:] + edges[:-1]) / 2
    return {"shift_hz": np.interp(middle, bands.moment[order], bands.frequency[order]), "shift_weight": weight.ravel()}


def _harmonics(signals: Signals, sweep: Sweep, piece: Piece, bands: Bands, length: float) -> list[FeatureBlock]:
    """Second and third harmonic; none where the sweep is too short for them."""
    found = harmonics_of(piece, bands)
    if found is None:
        return []
    order = np.argsort(bands.moment)
    time, f = bands.moment[order], bands.frequency[order]
    rows, middle = stacked(found.kernels), found.within[:, WITHIN // 2]
    return [
        block(
            CHIRP_HARMONIC,
            f"sweep {sweep.number}",
            signals,
            rows,
            sweep.first,
            is_complex=True,
            frequency=middle,
            amplitude=np.interp(middle, f, bands.amplitude[order]) / length,
            cycle=float(sweep.number),
            time=(sweep.before + sweep.first + np.interp(middle, f, time)) * signals.interval_s,
            support={
                "order": found.order.astype(float),
                "within_hz": found.within.ravel(),
                "profile_hz": bands.frequency,
                "profile_mm": bands.amplitude,
            }
            | _shifts(rows, sweep, bands),
        )
    ]


def _levels(
    signals: Signals, found: Record, pieces: list[Sweep], rest: int | None, strain: float
) -> list[FeatureBlock]:
    """Mean force of each sweep and of the late rest after it, against the `rest` samples before the first, or, where there are none,
    against the last of these."""
    rows, cycles, times, moving = [], [], [], []
    spans = [
        (a, b, strained, float(sweep.number))
        for sweep in pieces
        for a, b, strained in (
            (sweep.start, sweep.end, strain),
            (sweep.end + (sweep.stop - sweep.end) // 2, sweep.stop, 0.0),
        )
        if b - a >= 8 and not found.lost[a:b].any()
    ]
    if rest is None and spans:
        first, stop, *_ = spans.pop()
    else:
        first, stop = 0, rest or 1
    for a, b, strained, number in spans:
        row = np.zeros(found.count)
        row[first:stop] = -1 / (stop - first)
        row[a:b] += 1 / (b - a)
        rows.append(row)
        cycles.append(number)
        times.append((a + b) / 2 * found.interval_s)
        moving.append(strained)
    if not rows:
        return []
    return [
        block(
            CHIRP_LEVEL,
            "mean force",
            signals,
            np.array(rows),
            0,
            is_complex=False,
            amplitude=np.array(moving),
            cycle=np.array(cycles),
            time=np.array(times),
            drifts=True,
        )
    ]
