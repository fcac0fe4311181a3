"""Features of sinusoids: response, harmonics and mean force for groups of cycles; the capacitance where it is recorded.

Each group has its own least squares on a straight line and three harmonics. The start of the film from rest is in the
operators, so that the first cycle counts as much as the last.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pipeline.diagnose.features.blocks import Signals, block, cycle_groups
from pipeline.diagnose.features.functionals import Component, stacked
from pipeline.diagnose.features.kinds import (
    CYCLIC_CAPACITANCE,
    CYCLIC_HARMONIC,
    CYCLIC_LEVEL,
    CYCLIC_RESPONSE,
    REST_INPUT,
    FeatureBlock,
    NoiseSample,
)
from pipeline.diagnose.features.records import bode_gain, find_start, record, rest_samples, strain_length_mm
from pipeline.diagnose.rules import RULES
from pipeline.transform import sweeps
from pipeline.transform.channels import drive
from schemas.arrays import Bool, Complex, Float
from schemas.errors import NotIdentifiableError
from schemas.recording import Recording

_HARMONICS = 3
"""Highest harmonic of the force that is a feature."""
_ROOM = 1.2
"""Highest frequency of interest over that of the last harmonic: noise above it only leaks in, with a film that stiffens."""
_MANY_HARMONICS = 10
"""Harmonics that are taken off before noise is read off cycles themselves."""
_RESOLVING_REST_HZ = 4.0
"""Slow tests are sampled ten times as fast as this, so that the rest before them is seen."""


@dataclass(frozen=True)
class _Group:
    """Cycles first…last (from 1) in samples start…stop−1, with the kernels of harmonics 1 … 3 (3, n)."""

    first: int
    last: int
    start: int
    stop: int
    kernels: Complex

    @property
    def label(self) -> str:
        return f"cycle {self.first}" if self.first == self.last else f"cycles {self.first} to {self.last}"


def cyclic_blocks(
    recording: Recording, nodes: Float
) -> tuple[list[FeatureBlock], list[NoiseSample], dict[str, float], list[str]]:
    """Blocks, noise, values by name, warnings of a `cyclic`. Raises `NotIdentifiableError` where nothing can be read."""
    source, where = drive(recording), recording.metadata.recording_id
    names = source.input.quantity, source.output.quantity
    frequency = recording.metadata.frequency_hz
    if frequency is None:
        raise NotIdentifiableError("frequency_hz is missing", where=where)
    channels = {names[0]: source.input, names[1]: source.output}
    capacitance = recording.channels.get("capacitance")
    if capacitance is not None and capacitance.values.size:
        channels["capacitance"] = capacitance
    found = record(channels, recording, highest_hz=max(_ROOM * _HARMONICS * frequency, _RESOLVING_REST_HZ))
    given = found.values[names[0]]
    per_cycle = 1 / (frequency * found.interval_s)
    if per_cycle < RULES.features.per_cycle:
        raise NotIdentifiableError(
            f"{per_cycle:.3g} samples in a cycle", where=where, expected=f"at least {RULES.features.per_cycle}"
        )
    start = find_start(rest_samples(given, cycle=per_cycle), RULES.features.cyclic_rest, ())
    rest = start.samples
    x, y = (found.values[q] - found.values[q][:rest].mean() for q in names)
    moving = sweeps.motion(given)
    stated = recording.metadata.cycles
    whole = int(
        min(
            np.floor((moving.stop - rest) / per_cycle + 0.3),
            stated or RULES.features.most_cycles,
            RULES.features.most_cycles,
        )
    )
    groups = _groups(rest, per_cycle, whole, x.size, found.lost)
    if not groups:
        raise NotIdentifiableError("no cycle without a gap", where=where)
    factor = found.channel_factor(names[1], names[0])

    def quiet(values: Float) -> Float:
        """Noise of a channel: its rest, else what its last cycles leave of a sinusoid with many harmonics."""
        return values[start.quiet[0]] if start.quiet else _residual(values, groups[-1], per_cycle)

    signals = Signals(x, y, found.interval_s, nodes, found.mains, factor, slow=True, noise_sd=float(quiet(y).std()))
    length = strain_length_mm(recording)
    if "capacitance" in channels:
        sensed = found.values["capacitance"]
        sensing = replace(
            signals,
            output=sensed - sensed[:rest].mean(),
            components=(Component("capacitance", 0), Component("capacitance", 1)),
            factor=found.channel_factor("capacitance", names[0]),
            noise_sd=float(quiet(sensed).std()),
            largest_response=float(np.ptp(sensed) / np.ptp(x)),
        )
    blocks: list[FeatureBlock] = []
    # One sample is no level, least of all that at which the motion begins: without rest the last cycles are the reference.
    reference = (0, rest) if start.rests else (groups[-1].start, groups[-1].stop)
    for group in groups:
        blocks += _blocks(signals, group, names, frequency, length, reference)
        if "capacitance" in channels:
            blocks.append(_capacitance(sensing, group, frequency, length))
    noise = [found.noise(q, quiet(v)) for q, v in zip(names, (x, y), strict=True)]
    values = {
        "largest_strain": float(np.abs(x).max()) / length,
        "rest_force_n": float(found.values[names[1]][:rest].mean()),
        REST_INPUT: float(found.values[names[0]][:rest].mean()),
    }
    if "capacitance" in channels:
        values["capacitance_rest_pf"] = float(sensed[:rest].mean())
        noise += [found.noise("capacitance", quiet(sensed))]
    return blocks, [n for n in noise if n is not None], values, []


def _residual(values: Float, group: _Group, per_cycle: float) -> Float:
    """What a parabola and harmonics leave of a channel in a group of cycles: noise between the harmonics."""
    n = np.arange(group.start, group.stop)
    turn = 2 * np.pi * n / per_cycle
    highest = int(min(_MANY_HARMONICS, per_cycle // 3, n.size // 4))
    waves = [f(m * turn) for m in range(1, highest + 1) for f in (np.cos, np.sin)]
    design = np.column_stack([*np.polynomial.legendre.legvander(np.linspace(-1, 1, n.size), 2).T, *waves])
    solution = np.linalg.lstsq(design, values[n], rcond=None)[0]
    return np.asarray(values[n] - design @ solution)


def _groups(rest: int, per_cycle: float, whole: int, count: int, lost: Bool) -> list[_Group]:
    groups = []
    for a, b in cycle_groups(whole):
        start, stop = round(rest + a * per_cycle), min(round(rest + b * per_cycle), count)
        if lost[start:stop].any() or stop - start < 8:
            continue
        n = np.arange(start, stop)
        turn = 2 * np.pi * (n - rest) / per_cycle
        design = [np.ones(n.size), np.linspace(-1, 1, n.size)]
        for m in range(1, _HARMONICS + 1):
            design += [np.cos(m * turn), np.sin(m * turn)]
        solve = np.linalg.pinv(np.column_stack(design))
        groups.append(_Group(a + 1, b, start, stop, solve[2::2] - 1j * solve[3::2]))
    return groups


def _blocks(
    signals: Signals,
    group: _Group,
    names: tuple[str, str],
    frequency: float,
    length: float,
    reference: tuple[int, int],
) -> list[FeatureBlock]:
    window = slice(group.start, group.stop)
    first = complex(group.kernels[0] @ signals.input[window])
    response = group.kernels[:1] / first
    measured = complex((response @ signals.output[window])[0])
    gain = bode_gain(frequency, measured)
    force, given = names[1], names[0]
    components = (
        Component(force, 0),
        Component(force, 1),
        Component(force, 2),
        Component(given, 0, gain),
        Component(given, 1, gain),
        *signals.components,
    )
    signals = replace(signals, components=components, largest_response=abs(measured))
    cycle, time = (group.first + group.last) / 2, (group.start + group.stop) / 2 * signals.interval_s
    strain = abs(first) / length
    mean = float(signals.input[window].mean()) / length
    place = {"mean_strain": np.array([mean])}
    orders = np.arange(2, _HARMONICS + 1)
    turned = group.kernels[1:] * np.exp(-1j * np.angle(first) * orders)[:, None]
    made = [
        block(
            CYCLIC_RESPONSE,
            group.label,
            signals,
            stacked(response),
            group.start,
            is_complex=True,
            frequency=frequency,
            amplitude=strain,
            cycle=cycle,
            time=time,
            support=place,
        ),
        block(
            CYCLIC_HARMONIC,
            group.label,
            signals,
            stacked(turned),
            group.start,
            is_complex=True,
            frequency=frequency,
            amplitude=strain,
            cycle=cycle,
            time=time,
            support=place | {"order": orders.astype(float)},
        ),
    ]
    if (group.start, group.stop) != reference:
        a, b = reference
        level = np.zeros(max(group.stop, b))
        level[a:b] = -1 / (b - a)
        level[window] += 1 / (group.stop - group.start)
        made.append(
            block(
                CYCLIC_LEVEL,
                group.label,
                signals,
                level[None, :],
                0,
                is_complex=False,
                frequency=frequency,
                amplitude=strain,
                cycle=cycle,
                time=time,
                support=place,
                drifts=True,
            )
        )
    return made


def _capacitance(signals: Signals, group: _Group, frequency: float, length: float) -> FeatureBlock:
    """First and second harmonic of the capacitance over the displacement's fundamental, phases as for the force."""
    first = complex(group.kernels[0] @ signals.input[group.start : group.stop])
    turned = np.array([group.kernels[0] / first, group.kernels[1] * np.exp(-1j * np.angle(first)) / first])
    return block(
        CYCLIC_CAPACITANCE,
        group.label,
        signals,
        stacked(turned),
        group.start,
        is_complex=True,
        frequency=frequency * np.array([1.0, 2.0]),
        amplitude=abs(first) / length,
        cycle=(group.first + group.last) / 2,
        time=(group.start + group.stop) / 2 * signals.interval_s,
        support={"order": np.array([1.0, 2.0]), "input_mm": np.array([abs(first)])},
    )
