"""Readings of a force-map recording: drop of tension in both directions, each time the voltage is on.

Belongs here: from samples to one reading per cycle and direction. Does not belong here: means, permittivity and
comparisons (`pipeline.fit.force.force_map`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from pipeline.transform.step import measure_steps
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError
from schemas.recording import Channel, Recording

Samples = tuple[Float, Float]
"""(time in s, value)."""
_LEVEL_S = 0.5
_EDGE_S = 0.01
_UP = 0.98


@dataclass(frozen=True)
class ForceReading:
    """One cycle of the voltage: drop of tension in N (positive) with the standard deviation of its levels, at kV."""

    direction: int
    cycle: int
    force_n: float
    force_sd_n: float
    voltage_kv: float


@dataclass(frozen=True, kw_only=True)
class ForceMapReadings:
    """Readings of one specimen at one pair of pre-stretches, with what a prediction needs.

    Sizes in mm: `film_thickness_mm` undeformed and of all layers together, active sizes in the state they were drawn (`active_drawn`). None where
    the metadata does not say.
    """

    recording_id: str
    specimen_id: str
    configuration: str | None
    campaign: str | None
    stretch_1: float | None
    stretch_2: float | None
    layers: int
    film_thickness_mm: float | None
    active_length_mm: float | None
    active_width_mm: float | None
    active_drawn: str | None
    stated_permittivity: float | None
    readings: tuple[ForceReading, ...]
    warnings: tuple[str, ...] = ()


def measure_force_map(recording: Recording) -> ForceMapReadings:
    """One reading per cycle and direction of a `force_map` recording.

    A reading is the difference of the levels before the voltage comes on and before it goes off. The film goes on
    relaxing from its pre-stretch meanwhile: the rest level at the time of the second level is interpolated between the
    rests before and after the cycle.

    Raises `NotIdentifiableError` when the voltage makes no step or neither direction has usable samples.
    """
    metadata = recording.metadata
    readings: list[ForceReading] = []
    warnings: list[str] = []
    for direction in (1, 2):
        channel = recording.channels.get(f"force_{direction}")
        if channel is None:
            warnings.append(f"no channel force_{direction}")
            continue
        view = {"voltage": recording.channels["voltage"], "force": replace(channel, quantity="force")}
        found = _readings(replace(recording, channels=view), direction)
        readings += found
        if not found:
            warnings.append(f"force_{direction}: no usable reading")
    if not readings:
        raise NotIdentifiableError(
            "no usable reading in either direction",
            where=metadata.recording_id,
            expected="levels before and during at least one voltage step",
        )
    return ForceMapReadings(
        recording_id=metadata.recording_id,
        specimen_id=metadata.specimen_id,
        configuration=metadata.configuration,
        campaign=metadata.campaign,
        stretch_1=metadata.stretch_1,
        stretch_2=metadata.lateral_stretch,
        layers=metadata.layers or 1,
        film_thickness_mm=metadata.film_thickness_mm,
        active_length_mm=metadata.active_length_mm,
        active_width_mm=metadata.active_width_mm,
        active_drawn=metadata.active_drawn,
        stated_permittivity=metadata.relative_permittivity,
        readings=tuple(readings),
        warnings=tuple(warnings),
    )


def _readings(recording: Recording, direction: int) -> list[ForceReading]:
    """Readings of all steps in the voltage of a recording with one force."""
    start = recording.start_ns
    voltage, force = (_finite(recording.channels[name], start) for name in ("voltage", "force"))
    levels = [
        level
        for step in measure_steps(recording).steps
        if (level := _levels(step.cycle, step.start_s, step.end_s, voltage, force)) is not None
    ]
    slopes = [(after.rest_n - before.rest_n) / (after.on_s - before.on_s) for before, after in pairwise(levels)]
    slopes = [*slopes, slopes[-1]] if slopes else [0.0] * len(levels)
    return [
        ForceReading(
            direction,
            level.cycle,
            level.rest_n + slope * (level.read_s - level.on_s) - level.force_n,
            level.sd_n,
            level.voltage_kv,
        )
        for level, slope in zip(levels, slopes, strict=True)
    ]


@dataclass(frozen=True)
class _Levels:
    """One cycle: edge in s, tension before it and while the voltage is on.

    `read_s` is as far after the window of the second as `on_s` is after the window of the first.
    """

    cycle: int
    on_s: float
    read_s: float
    rest_n: float
    force_n: float
    sd_n: float
    voltage_kv: float


def _levels(cycle: int, on: float, off: float, voltage: Samples, force: Samples) -> _Levels | None:
    """Levels of one cycle between two 50 % crossings of the voltage; None with too few samples.

    The voltage has long left its level when it crosses 50 % on its way down, so the level while on is read before it
    leaves 98 %.
    """
    span = min(_LEVEL_S, 0.2 * (off - on))
    times, volts = voltage
    on_phase = (times > on) & (times < off)
    if not on_phase.any():
        return None
    up = times[on_phase & (volts >= _UP * float(np.median(volts[on_phase])))]
    last = float(up[-1]) if up.size else off
    volts_on = volts[(times > last - span) & (times < last)]
    before, during = (force[1][(force[0] > end - span) & (force[0] < end)] for end in (on - _EDGE_S, last))
    if min(before.size, during.size, volts_on.size) < 2:
        return None
    noise = [float(np.std(np.diff(x))) / math.sqrt(2 * x.size) for x in (before, during)]
    return _Levels(
        cycle,
        on,
        last + _EDGE_S,
        float(before.mean()),
        float(during.mean()),
        math.hypot(*noise),
        float(np.sqrt(np.mean(volts_on**2))),
    )


def _finite(channel: Channel, start_ns: int) -> Samples:
    """Seconds since `start_ns`, known delay taken off, and values of the finite samples."""
    keep = np.isfinite(channel.values)
    seconds = (channel.time_ns[keep] - start_ns) * 1e-9 - (channel.delay_s or 0.0)
    return seconds.astype(np.float64), channel.values[keep]
