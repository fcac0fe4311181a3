"""Readings of a force-map recording: drop of tension in both directions, each time the voltage is on.

Belongs here: from samples to one reading per cycle and direction. Does not belong here: means, permittivity and
comparisons (`pipeline.fit.force.force_map`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pipeline.transform.static_force import fit_static_force
from pipeline.transform.step import measure_steps
from pipeline.transform.step_edges import Edges, describe_unsteady, on_phases
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError
from schemas.recording import Channel, Recording

Samples = tuple[Float, Float]
"""(time in s, value)."""
_SETTLED_S = 0.1
"""Time after an edge in which the clamp rings and the converter of the voltage settles."""
_UP = 0.98


@dataclass(frozen=True)
class ForceReading:
    """One cycle of the voltage: drop of tension in N (positive) with its standard deviation, at kV."""

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

    The film goes on relaxing from its pre-stretch while the voltage is on: its drift is fitted before, during and after at once
    (`static_force`), so that one time of voltage suffices.

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
        found, said = _readings(replace(recording, channels=view), direction)
        readings += found
        warnings += [f"force_{direction}: {text}" for text in said]
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


def _readings(recording: Recording, direction: int) -> tuple[list[ForceReading], list[str]]:
    """Readings of all steps in the voltage of a recording with one force, and what is to be said of them."""
    start = recording.start_ns
    voltage, force = (_finite(recording.channels[name], start) for name in ("voltage", "force"))
    phases = on_phases(*voltage)
    steps = measure_steps(recording).steps
    times = [
        on for step in steps if (on := _time_of_voltage(step.cycle, step.start_s, step.end_s, voltage)) is not None
    ]
    if not times:
        return [], ["no usable reading"]
    unsteady = [(step.cycle, describe_unsteady(*voltage, phases[step.cycle - 1])) for step in steps]
    said = [f"cycle {cycle}: {text}" for cycle, text in unsteady if text]
    settle_s = max(_SETTLED_S, *(one.settle_s for one in times))
    for cycle in sorted({*range(1, len(phases) + 1)} - {one.cycle for one in times}):
        begins = "" if phases[cycle - 1].has_rest else " begins with the record, without a level before it, and"
        said.append(f"cycle {cycle}{begins} gives no reading: what it shows is left out")
        force = _without(force, phases[cycle - 1], settle_s)
    try:
        found = fit_static_force(*force, [(one.on_s, one.off_s) for one in times], settle_s)
    except NotIdentifiableError as error:
        return [], [f"no usable reading: {error.problem}"]
    return [
        ForceReading(direction, one.cycle, float(value), float(sd), one.voltage_kv)
        for one, value, sd in zip(times, found.force_n, found.force_sd_n, strict=True)
    ], said


@dataclass(frozen=True)
class _TimeOfVoltage:
    """One cycle: when the voltage begins to rise and to fall, in s, longest time that it is on its way, root mean square at its level."""

    cycle: int
    on_s: float
    off_s: float
    settle_s: float
    voltage_kv: float


def _time_of_voltage(cycle: int, on: float, off: float, voltage: Samples) -> _TimeOfVoltage | None:
    """What the voltage does between two 50 % crossings; None with too few samples.

    It has long left its level when it crosses 50 %: it is on from where it leaves 2 % to where it leaves 98 %.
    """
    times, volts = voltage
    on_phase = (times > on) & (times < off)
    if not on_phase.any():
        return None
    level = float(np.median(volts[on_phase]))
    up = times[on_phase & (np.abs(volts) >= _UP * abs(level))]
    if up.size < 2:
        return None
    down = np.abs(volts) < (1 - _UP) * abs(level)
    still, gone = times[(times < on) & down], times[(times > off) & down]
    begin, end = float(still[-1]) if still.size else on, float(up[-1])
    settle = max(float(up[0]) - begin, float(gone[0]) - end if gone.size else 0.0)
    inside = volts[(times >= up[0]) & (times <= end)]
    return _TimeOfVoltage(cycle, begin, end, settle, float(np.sqrt(np.mean(inside**2))))


def _without(force: Samples, phase: Edges, settle_s: float) -> Samples:
    """Samples outside an on-phase and of what settles after it: else its force would pass for drift of the rest."""
    times, values = force
    keep = (times < phase.on) | (times > phase.off + settle_s)
    return times[keep], values[keep]


def _finite(channel: Channel, start_ns: int) -> Samples:
    """Seconds since `start_ns`, known delay taken off, and values of the finite samples."""
    keep = np.isfinite(channel.values)
    seconds = (channel.time_ns[keep] - start_ns) * 1e-9 - (channel.delay_s or 0.0)
    return seconds.astype(np.float64), channel.values[keep]
